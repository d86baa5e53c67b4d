//! Cameras: projecting and unprojecting undo each other over the whole field of view, and outside it there is no ray.
#![allow(clippy::unwrap_used)]

use std::f64::consts::PI;

use gedepth_core::camera::{
    BrownConrady, CameraModel, ImageSize, Intrinsics, KannalaBrandt, Pinhole, Pixel,
};
use gedepth_core::{CameraFrame, Direction, Point};
use proptest::prelude::*;

fn size() -> ImageSize {
    ImageSize::new(1920, 1080).unwrap()
}

fn intrinsics() -> impl Strategy<Value = Intrinsics> {
    (200.0..3000.0, 0.9..1.1, 0.0..1919.0, 0.0..1079.0, -5.0..5.0).prop_map(
        |(focal, aspect, cx, cy, skew)| {
            Intrinsics::new(size(), focal, focal * aspect, cx, cy)
                .and_then(|k| k.with_skew(skew))
                .unwrap()
        },
    )
}

/// Real lenses' coefficients and beyond.
fn brown_conrady() -> impl Strategy<Value = BrownConrady> {
    let tangential = -2e-3..2e-3;
    let five = (
        -0.6..0.4,
        -0.5..2.5,
        tangential.clone(),
        tangential.clone(),
        -1.1..0.5,
    )
        .prop_map(|(k1, k2, p1, p2, k3)| [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]);
    let eight = (
        -0.5..20.0,
        -0.5..20.0,
        tangential.clone(),
        tangential,
        -0.1..2.0,
        (-0.5..20.0, -0.5..20.0, -0.1..5.0),
    )
        .prop_map(|(k1, k2, p1, p2, k3, (k4, k5, k6))| [k1, k2, p1, p2, k3, k4, k5, k6]);
    (intrinsics(), prop_oneof![five, eight])
        .prop_map(|(intrinsics, c)| BrownConrady::rational(intrinsics, c).unwrap())
}

fn kannala_brandt() -> impl Strategy<Value = KannalaBrandt> {
    (intrinsics(), prop::array::uniform4(-0.15..0.15))
        .prop_map(|(intrinsics, k)| KannalaBrandt::new(intrinsics, k).unwrap())
}

/// A direction at `share` of the field of view from the axis.
fn at(camera: &dyn CameraModel, share: f64, azimuth: f64) -> [f64; 3] {
    let angle = camera.field_of_view().radians() * share;
    [
        angle.sin() * azimuth.cos(),
        angle.sin() * azimuth.sin(),
        angle.cos(),
    ]
}

fn angle_between(a: [f64; 3], b: [f64; 3]) -> f64 {
    let cross = [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ];
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    cross.iter().map(|c| c * c).sum::<f64>().sqrt().atan2(dot)
}

fn round_trip(
    camera: &dyn CameraModel,
    share: f64,
    azimuth: f64,
    distance: f64,
) -> Result<(), TestCaseError> {
    let ray = at(camera, share, azimuth);
    let [x, y, z] = ray.map(|c| c * distance);
    let pixel = camera.project(Point::new(x, y, z));
    prop_assert!(pixel.is_some(), "no pixel at {share} of the field of view");
    let back = camera.unproject(pixel.unwrap());
    prop_assert!(back.is_some(), "no ray at {share} of the field of view");
    let back = back.unwrap().vector();
    prop_assert!((back.length() - 1.0).abs() < 1e-12);
    let off = angle_between(ray, back.to_array());
    prop_assert!(
        off < 1e-8,
        "off by {off} rad at {share} of the field of view"
    );
    // The same ray as a point at z = 1, or none if it does not point forward.
    let forward = camera.forward_ray(pixel.unwrap());
    if back.z > 1e-5 {
        let forward = forward.unwrap();
        prop_assert!((forward.x * back.z - back.x).abs() < 1e-12);
        prop_assert!((forward.y * back.z - back.y).abs() < 1e-12);
    } else if back.z <= 0.0 {
        prop_assert!(forward.is_none());
    }
    Ok(())
}

/// Whatever ray a pixel gives must fall on that pixel again.
fn never_a_wrong_ray(camera: &dyn CameraModel, pixel: Pixel) -> Result<(), TestCaseError> {
    if let Some(ray) = camera.unproject(pixel) {
        let r = ray.vector() * 7.0;
        let back = camera.project(Point::new(r.x, r.y, r.z));
        prop_assert!(back.is_some());
        let back = back.unwrap();
        prop_assert!((back.u - pixel.u).abs() < 1e-5 && (back.v - pixel.v).abs() < 1e-5);
        let angle = angle_between([0.0, 0.0, 1.0], ray.vector().to_array());
        prop_assert!(angle <= camera.field_of_view().radians() + 1e-9);
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn pinhole_round_trip(
        k in intrinsics(), share in 0.0..0.999, azimuth in 0.0..2.0 * PI, distance in 0.01..1e4,
    ) {
        round_trip(&Pinhole::new(k), share, azimuth, distance)?;
    }

    #[test]
    fn brown_conrady_round_trip(
        camera in brown_conrady(), share in 0.0..0.99, azimuth in 0.0..2.0 * PI, distance in 0.01..1e4,
    ) {
        round_trip(&camera, share, azimuth, distance)?;
    }

    #[test]
    fn kannala_brandt_round_trip(
        camera in kannala_brandt(), share in 0.0..0.999, azimuth in 0.0..2.0 * PI, distance in 0.01..1e4,
    ) {
        round_trip(&camera, share, azimuth, distance)?;
    }

    #[test]
    fn no_pixel_gets_a_wrong_ray(
        brown in brown_conrady(), fisheye in kannala_brandt(), u in -3000.0..5000.0, v in -3000.0..5000.0,
    ) {
        never_a_wrong_ray(&brown, Pixel::new(u, v))?;
        never_a_wrong_ray(&fisheye, Pixel::new(u, v))?;
    }

    /// No two points inside the field of view fall on one pixel: a finer look than the round trip.
    #[test]
    fn distortion_does_not_fold(
        camera in brown_conrady(), a in 0.0..1.0_f64, b in 0.0..1.0_f64, azimuth in 0.0..2.0 * PI,
    ) {
        prop_assume!((a - b).abs() > 1e-3);
        let radius = |share: f64| {
            let [x, y, z] = at(&camera, share, azimuth);
            let p = camera.project(Point::new(x, y, z)).unwrap();
            let c = camera.project(Point::new(0.0, 0.0, 1.0)).unwrap();
            let m = camera.intrinsics().matrix();
            let y = (p.v - c.v) / m[1][1];
            ((p.u - c.u - m[0][1] * y) / m[0][0]) * azimuth.cos() + y * azimuth.sin()
        };
        prop_assert_eq!(radius(a * 0.999) < radius(b * 0.999), a < b);
    }

    /// What happens to a picture happens to where points fall in it.
    #[test]
    fn intrinsics_follow_the_picture(
        k in intrinsics(), x in -1.0..1.0, y in -0.6..0.6,
        left in 0_u32..900, top in 0_u32..500, width in 1_u32..1000, height in 1_u32..500, factor in 1_u32..9,
    ) {
        let before = k.pixel(x, y);
        let part = ImageSize::new(width, height).unwrap();
        let close = |a: Pixel, u: f64, v: f64| (a.u - u).abs() < 1e-6 && (a.v - v).abs() < 1e-6;

        let cropped = k.crop(left, top, part).unwrap();
        prop_assert_eq!(cropped.size(), part);
        prop_assert!(close(cropped.pixel(x, y), before.u - f64::from(left), before.v - f64::from(top)));

        // The picture's area, which begins half a pixel before the first centre, is what scales.
        let resized = k.resize(part).unwrap();
        let (sx, sy) = (f64::from(width) / 1920.0, f64::from(height) / 1080.0);
        prop_assert_eq!(resized.size(), part);
        prop_assert!(close(resized.pixel(x, y), (before.u + 0.5) * sx - 0.5, (before.v + 0.5) * sy - 0.5));

        let binned = k.bin(factor).unwrap();
        let s = 1.0 / f64::from(factor);
        prop_assert_eq!((binned.size().width(), binned.size().height()), (1920 / factor, 1080 / factor));
        prop_assert!(close(binned.pixel(x, y), (before.u + 0.5) * s - 0.5, (before.v + 0.5) * s - 0.5));

        let mirrored = k.flip_horizontally();
        prop_assert!(close(mirrored.pixel(x, y), 1919.0 - before.u, before.v));
        let (back_x, back_y) = mirrored.image_plane(mirrored.pixel(x, y));
        prop_assert!((back_x - x).abs() < 1e-9 && (back_y - y).abs() < 1e-9);
        let flipped = k.flip_vertically();
        prop_assert!(close(flipped.pixel(x, y), before.u, 1079.0 - before.v));
    }
}

/// Pixel (0, 0) is the centre of the first pixel: halving a picture puts it a quarter of a pixel before the new centre.
#[test]
fn pixel_centres() {
    let k = Intrinsics::new(ImageSize::new(8, 6).unwrap(), 10.0, 10.0, 3.5, 2.5).unwrap();
    assert_eq!(
        Intrinsics::centred(ImageSize::new(8, 6).unwrap(), 10.0).unwrap(),
        k
    );
    let half = k.resize(ImageSize::new(4, 3).unwrap()).unwrap();
    assert_eq!(
        half.matrix(),
        [[5.0, 0.0, 1.5], [0.0, 5.0, 1.0], [0.0, 0.0, 1.0]]
    );
    assert_eq!(half, k.bin(2).unwrap());
    assert!(k.size().contains(Pixel::new(-0.5, -0.5)));
    assert!(k.size().contains(Pixel::new(7.49, 5.49)));
    for outside in [(7.5, 0.0), (0.0, 5.5), (-0.51, 0.0), (0.0, -0.51)] {
        assert!(!k.size().contains(Pixel::new(outside.0, outside.1)));
    }
}

/// OpenCV's documented equations, evaluated by hand for one point of the image plane: (0.3, -0.2).
#[test]
fn brown_conrady_by_hand() {
    let unit = Intrinsics::new(ImageSize::new(10, 10).unwrap(), 1.0, 1.0, 0.0, 0.0).unwrap();
    let c = [-0.3, 0.1, 0.001, -0.002, 0.05, 0.02, -0.01, 0.003];
    let camera = BrownConrady::rational(unit, c).unwrap();
    let pixel = camera.project(Point::new(0.6, -0.4, 2.0)).unwrap();
    // r^2 = 0.13: (1 - 0.039 + 0.00169 + 0.00010985) / (1 + 0.0026 - 0.000169 + 0.000006591)
    let g: f64 = 0.962_799_85 / 1.002_437_591;
    let u = 0.3 * g + 2.0 * 0.001 * 0.3 * -0.2 - 0.002 * (0.13 + 2.0 * 0.09);
    let v = -0.2 * g + 0.001 * (0.13 + 2.0 * 0.04) + 2.0 * -0.002 * 0.3 * -0.2;
    assert!((pixel.u - u).abs() < 1e-12 && (pixel.v - v).abs() < 1e-12);
    let five = BrownConrady::new(unit, [-0.3, 0.1, 0.001, -0.002, 0.05]).unwrap();
    let zeros = BrownConrady::rational(unit, [-0.3, 0.1, 0.001, -0.002, 0.05, 0.0, 0.0, 0.0]);
    assert_eq!(five, zeros.unwrap());
}

/// Without coefficients the fisheye is equidistant: the radius is the angle itself, behind the camera too.
#[test]
fn equidistant_fisheye() {
    let k = Intrinsics::new(
        ImageSize::new(1000, 1000).unwrap(),
        100.0,
        100.0,
        499.5,
        499.5,
    )
    .unwrap();
    let camera = KannalaBrandt::new(k, [0.0; 4]).unwrap();
    for degrees in [0.0_f64, 1e-6, 30.0, 60.0, 90.0, 120.0, 178.0] {
        let t = degrees.to_radians();
        let pixel = camera.project(Point::new(0.0, t.sin(), t.cos())).unwrap();
        assert!((pixel.u - 499.5).abs() < 1e-9);
        assert!((pixel.v - 499.5 - 100.0 * t).abs() < 1e-9, "{degrees}");
        let ray = camera.unproject(pixel).unwrap().vector();
        assert!(
            (ray.y - t.sin()).abs() < 1e-12 && (ray.z - t.cos()).abs() < 1e-12,
            "{degrees}"
        );
    }
    assert!((camera.field_of_view().degrees() - 179.0).abs() < 1e-9);
    assert!(camera.project(Point::new(0.0, 0.0, -1.0)).is_none());
    assert!(camera.project(Point::new(0.0, 0.0, 0.0)).is_none());
    assert!(
        camera
            .unproject(Pixel::new(499.5, 499.5 + 100.0 * PI))
            .is_none()
    );
    assert!(camera.unproject(Pixel::new(f64::NAN, 0.0)).is_none());
}

/// A lens of a real car (PandaSet's front camera) whose polynomial turns back: found, and nothing claimed beyond.
#[test]
fn a_folding_lens() {
    let k = Intrinsics::new(size(), 1970.0131, 1970.0091, 970.0002, 483.2988).unwrap();
    let camera = BrownConrady::new(k, [-0.5894, 0.66, 0.0011, -0.001, -1.0088]).unwrap();
    // The least positive root of d/dr r (1 + k1 r^2 + k2 r^4 + k3 r^6), from NumPy; the image there is at 0.5265393.
    let turn = 0.717_647_125_093_394_1_f64.atan().to_degrees();
    let edge = camera.field_of_view().degrees();
    assert!(
        edge < turn && edge > turn - 1.0,
        "{edge} degrees, turns at {turn}"
    );
    assert!(camera.project(Point::new(0.8, 0.0, 1.0)).is_none());
    for (u, v) in [(0.0, 483.3), (1919.0, 483.3), (970.0, 0.0), (970.0, 1079.0)] {
        assert!(camera.unproject(Pixel::new(u, v)).is_some(), "({u}, {v})");
    }
    // The upper left corner is 0.55 from the principal point: the polynomial never gets there.
    assert!(camera.unproject(Pixel::new(0.0, 0.0)).is_none());
    // Past the turning point's image there is none.
    assert!(
        camera
            .unproject(Pixel::new(970.0 + 1970.0 * 0.54, 483.3))
            .is_none()
    );
}

/// A lens out of centre folds where its tangential part points away from: at radius r there the Jacobian's determinant is
/// (1 - 6 p r) (1 - 2 p r), and 0.001 ends the field of view.
#[test]
fn a_tangential_lens_folds_on_one_side() {
    let k = Intrinsics::centred(size(), 1000.0).unwrap();
    let p = 0.3;
    let radius = (8.0 - (64.0 - 48.0 * 0.999_f64).sqrt()) / 24.0 / p;
    for meridian in 0..32 {
        let side = 2.0 * PI * f64::from(meridian) / 32.0;
        let lens = [0.0, 0.0, -p * side.sin(), -p * side.cos(), 0.0];
        let camera = BrownConrady::new(k, lens).unwrap();
        let off = camera.field_of_view().radians() - radius.atan();
        assert!(off.abs() < 1e-9, "meridian {meridian}: off by {off}");
    }
}

/// Coefficients so large that all of the field of view is a fraction of a degree.
#[test]
fn strong_lenses_round_trip() {
    for (k1, focal) in [(1e4, 4000.0), (-1e4, 1e5), (1e6, 4e4), (1e3, 1000.0)] {
        let k = Intrinsics::centred(size(), focal).unwrap();
        let camera = KannalaBrandt::new(k, [k1, 0.0, 0.0, 0.0]).unwrap();
        for u in 0..size().width() {
            let pixel = Pixel::new(f64::from(u), 100.0);
            if let Some(ray) = camera.unproject(pixel) {
                let back = camera.project(Point::from_vector(ray.vector())).unwrap();
                let off = (back.u - pixel.u).abs().max((back.v - pixel.v).abs());
                assert!(off < 1e-4, "k1 = {k1}: off by {off} pixels in column {u}");
            }
        }
    }
}

/// A pinhole has a ray for every pixel, also where its centre is far outside of the picture; a lens' rays at
/// 90 degrees, for all that can be told, do not point forward.
#[test]
fn rays_far_from_the_axis() {
    let k = Intrinsics::new(size(), 0.5, 0.5, -1e6, 0.0).unwrap();
    let ray = Pinhole::new(k).forward_ray(Pixel::new(0.0, 0.0));
    assert_eq!(ray.map(|ray| (ray.x, ray.y)), Some((2e6, 0.0)));
    let k = Intrinsics::centred(size(), 100.0).unwrap();
    for k1 in [0.0, 12.0] {
        let camera = KannalaBrandt::new(k, [k1, 0.0, 0.0, 0.0]).unwrap();
        let centre = camera.project(Point::new(0.0, 0.0, 1.0)).unwrap();
        let at = |x: f64| camera.project(Point::new(x, 0.0, 1.0)).unwrap().u - centre.u;
        for x in [1e9, 1e12] {
            let pixel = Pixel::new(centre.u + at(x), centre.v);
            assert_eq!(camera.forward_ray(pixel), None, "k1 = {k1}, x = {x}");
        }
        let ray = camera.forward_ray(Pixel::new(centre.u + at(1e4), centre.v));
        assert!((ray.unwrap().x - 1e4).abs() < 1.0);
    }
}

/// What is behind, beside or nowhere falls on no pixel.
#[test]
fn outside_the_field_of_view() {
    let k = Intrinsics::centred(size(), 1000.0).unwrap();
    let cameras: [&dyn CameraModel; 3] = [
        &Pinhole::new(k),
        &BrownConrady::new(k, [0.0; 5]).unwrap(),
        &KannalaBrandt::new(k, [-0.2, 0.0, 0.0, 0.0]).unwrap(),
    ];
    for camera in cameras {
        for (x, y, z) in [
            (0.0, 0.0, -1.0),
            (1.0, 0.0, -0.1),
            (0.0, 0.0, 0.0),
            (f64::NAN, 0.0, 1.0),
            (0.0, 0.0, f64::NAN),
            (f64::INFINITY, 0.0, 1.0),
            (0.0, 1.0, 1e-320),
        ] {
            let pixel = camera.project(Point::new(x, y, z));
            assert_eq!(pixel, None, "({x}, {y}, {z})");
        }
        let nowhere = Pixel::new(f64::INFINITY, 0.0);
        assert!(camera.unproject(nowhere).is_none());
        assert!(camera.forward_ray(nowhere).is_none());
        assert_eq!(camera.size(), size());
    }
    // The slope of t (1 - 0.2 t^2) is 0.01 at t = sqrt(0.99 / 0.6).
    let edge = cameras[2].field_of_view().radians();
    assert!((edge - 1.284_523_26).abs() < 1e-6);
    assert_eq!(cameras[0].field_of_view().degrees(), 90.0);
    assert_eq!(cameras[0].as_pinhole(), Some(&k));
    assert_eq!(cameras[1].as_pinhole(), None);
}

/// A lens moves with its picture.
#[test]
fn lenses_keep_their_coefficients() {
    let k = Intrinsics::centred(size(), 1000.0).unwrap();
    let half = k.resize(ImageSize::new(960, 540).unwrap()).unwrap();
    let point = Point::<CameraFrame>::new(0.3, 0.2, 1.0);
    let brown = BrownConrady::new(k, [-0.3, 0.1, 1e-3, 1e-3, 0.0]).unwrap();
    let fisheye = KannalaBrandt::new(k, [0.02, 0.01, 0.0, 0.0]).unwrap();
    let pairs: [(&dyn CameraModel, &dyn CameraModel); 3] = [
        (&Pinhole::new(k), &Pinhole::new(k).with_intrinsics(half)),
        (&brown, &brown.with_intrinsics(half)),
        (&fisheye, &fisheye.with_intrinsics(half)),
    ];
    for (whole, half) in pairs {
        let (whole, half) = (whole.project(point).unwrap(), half.project(point).unwrap());
        assert!((half.u - ((whole.u + 0.5) / 2.0 - 0.5)).abs() < 1e-9);
        assert!((half.v - ((whole.v + 0.5) / 2.0 - 0.5)).abs() < 1e-9);
    }
    assert_eq!(brown.with_intrinsics(half).intrinsics(), &half);
    assert_eq!(fisheye.with_intrinsics(half).intrinsics(), &half);
    assert_eq!(Pinhole::new(half).intrinsics(), &half);
    assert_eq!(Intrinsics::from_matrix(size(), k.matrix()).unwrap(), k);
    let direction: Direction<CameraFrame> = Direction::new(0.0, 3.0, 4.0).unwrap();
    assert!((direction.vector() * 5.0 - glam::DVec3::new(0.0, 3.0, 4.0)).length() < 1e-14);
}
