//! Where the ground ends in the picture: its vanishing line.

use core::cmp::Ordering;

use glam::{DVec2, DVec3};
use heapless::Vec;

use super::Ground;
use crate::Point;
use crate::camera::{CameraModel, Pixel};
use crate::scalar::{atan2, sin_cos, sqrt};

/// Sines of angles that are those of rounding: a pixel so near the line is on it.
const LEVEL: f64 = 1e-12;

/// More crossings of a line and a picture's border than any sensible lens makes.
const CROSSINGS: usize = 8;

impl Ground {
    /// The two end points of the vanishing line in the picture: where it crosses the frame of outermost pixel centres, or
    /// the edge of the field of view inside it. `None` if the picture shows no more than one such point: all ground, all
    /// sky, or one pixel.
    ///
    /// The line is straight for a pinhole, curved otherwise; where a distortion makes it cross more than twice these are
    /// the two points farthest apart. The left end comes first.
    pub fn vanishing_line<C: CameraModel + ?Sized>(&self, camera: &C) -> Option<[Pixel; 2]> {
        let mut ends: Vec<Pixel, CROSSINGS> = Vec::new();
        self.cross_frame(camera, &mut ends);
        self.cross_field_of_view(camera, &mut ends);
        let distance = |a: Pixel, b: Pixel| DVec2::new(a.u - b.u, a.v - b.v).length();
        let mut line = None;
        let mut longest = 1e-6;
        for a in &ends {
            for b in &ends {
                if distance(*a, *b) > longest {
                    longest = distance(*a, *b);
                    line = Some([*a, *b]);
                }
            }
        }
        line.map(|[a, b]| {
            if (a.u, a.v) <= (b.u, b.v) {
                [a, b]
            } else {
                [b, a]
            }
        })
    }

    /// Whether the pixel's ray dips below the vanishing line, is on it, or rises above.
    fn side<C: CameraModel + ?Sized>(&self, camera: &C, pixel: Pixel) -> Option<Ordering> {
        let dip = self.down.vector().dot(camera.unproject(pixel)?.vector());
        Some(match dip {
            _ if dip > LEVEL => Ordering::Greater,
            _ if dip < -LEVEL => Ordering::Less,
            _ => Ordering::Equal,
        })
    }

    /// Crossings of the frame, walked clockwise from pixel to pixel.
    fn cross_frame<C: CameraModel + ?Sized>(&self, camera: &C, ends: &mut Vec<Pixel, CROSSINGS>) {
        let (right, bottom) = (camera.size().width() - 1, camera.size().height() - 1);
        let pixel = |u: u32, v: u32| Pixel::new(f64::from(u), f64::from(v));
        let walk = (0..right)
            .map(|u| pixel(u, 0))
            .chain((0..bottom).map(|v| pixel(right, v)))
            .chain((1..=right).rev().map(|u| pixel(u, bottom)))
            .chain((0..=bottom).rev().map(|v| pixel(0, v)))
            // Back to where the walk began, for a frame that is one row high.
            .chain(core::iter::once(pixel(0, 0)));
        let mut before: Option<(Pixel, Ordering)> = None;
        for here in walk {
            let side = self.side(camera, here);
            if let (Some((last, last_side)), Some(side)) = (before, side)
                && last_side != side
            {
                // Full: more crossings than a lens makes; the first ones stand.
                let _ = ends.push(self.between(camera, last, here));
            }
            before = side.map(|side| (here, side));
        }
    }

    /// Halves the way between two neighbours that are not on the same side of the line, to where the first one's ends.
    fn between<C: CameraModel + ?Sized>(&self, camera: &C, mut a: Pixel, mut b: Pixel) -> Pixel {
        let side = self.side(camera, a);
        for _ in 0..60 {
            let middle = Pixel::new(0.5 * (a.u + b.u), 0.5 * (a.v + b.v));
            if self.side(camera, middle) == side {
                a = middle;
            } else {
                b = middle;
            }
        }
        b
    }

    /// Crossings of the field of view's cone that lie inside the picture (fisheyes with an image circle).
    fn cross_field_of_view<C: CameraModel + ?Sized>(
        &self,
        camera: &C,
        ends: &mut Vec<Pixel, CROSSINGS>,
    ) {
        // down . (sin t cos a, sin t sin a, cos t) = 0 on the cone at t: two azimuths a, if any.
        let down = self.down.vector();
        let across = DVec2::new(down.x, down.y);
        let (sin, cos) = sin_cos(camera.field_of_view().radians() * (1.0 - 1e-12));
        let cosine = -down.z * cos / (sin * across.length());
        // NaN or infinite when looking straight down or up.
        if !(-1.0..=1.0).contains(&cosine) {
            return;
        }
        let middle = atan2(across.y, across.x);
        let half = atan2(sqrt(1.0 - cosine * cosine), cosine);
        for azimuth in [middle - half, middle + half] {
            let (sin_azimuth, cos_azimuth) = sin_cos(azimuth);
            let ray = DVec3::new(sin * cos_azimuth, sin * sin_azimuth, cos);
            if let Some(pixel) = camera.project(Point::from_vector(ray))
                && camera.size().contains(pixel)
            {
                let _ = ends.push(pixel);
            }
        }
    }
}
