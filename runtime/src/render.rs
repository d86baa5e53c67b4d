//! Depth as files for people and programs: 16-bit PNG, colours with a scale bar.

use font8x8::UnicodeFonts;
use image::{GrayImage, ImageBuffer, Luma, Rgb, RgbImage};

/// Depths that the colour scale spans, metres; its ends hold for what lies beyond.
const COLOUR_RANGE_M: (f32, f32) = (2.0, 80.0);
/// Depths that the scale bar names, metres.
const TICKS_M: [f32; 6] = [2.0, 5.0, 10.0, 20.0, 40.0, 80.0];
/// Height of the scale bar below the picture, pixels.
const BAR_HEIGHT: u32 = 32;
/// Side of a character, pixels.
const GLYPH: u32 = 8;

/// A map of `width * height` numbers, row by row from the top left.
#[derive(Clone, Copy, Debug)]
pub struct Map<'a> {
    /// Width in pixels.
    pub width: u32,
    /// The numbers; their count is a multiple of the width.
    pub values: &'a [f32],
}

impl Map<'_> {
    fn height(&self) -> u32 {
        (self.values.len() / self.width.max(1) as usize) as u32
    }

    fn image<P: image::Pixel>(&self, pixel: impl Fn(f32) -> P) -> ImageBuffer<P, Vec<P::Subpixel>> {
        ImageBuffer::from_fn(self.width, self.height(), |u, v| {
            pixel(self.values[v as usize * self.width as usize + u as usize])
        })
    }
}

/// Depth in KITTI's convention: 16 bits, metres x 256 to the nearest, 0 where there is none.
/// Depths of 256 m and more are stored as the greatest value.
pub fn depth_16bit(depth: Map<'_>) -> ImageBuffer<Luma<u16>, Vec<u16>> {
    depth.image(|metres| Luma([(metres * 256.0).round() as u16]))
}

/// Depth in colours (red near, blue far, logarithmic), black where there is none, above a scale bar.
pub fn depth_colours(depth: Map<'_>) -> RgbImage {
    let colours = depth.image(|metres| {
        if metres > 0.0 {
            colour(metres)
        } else {
            Rgb([0; 3])
        }
    });
    let mut picture = RgbImage::from_pixel(depth.width, depth.height() + BAR_HEIGHT, Rgb([255; 3]));
    image::imageops::replace(&mut picture, &colours, 0, 0);
    scale_bar(&mut picture, depth.height());
    picture
}

/// Attention in 0 to 1 as grey, white where the ground is trusted.
pub fn attention(attention: Map<'_>) -> GrayImage {
    attention.image(|m| Luma([(m * 255.0).round() as u8]))
}

/// Position of a depth on the scale, 0 to 1.
fn position(metres: f32) -> f32 {
    let (near, far) = COLOUR_RANGE_M;
    ((metres / near).ln() / (far / near).ln()).clamp(0.0, 1.0)
}

fn colour(metres: f32) -> Rgb<u8> {
    // Turbo runs from blue to red; near is red. Its nearly black ends are left out: black is for no depth.
    let c = colorous::TURBO.eval_continuous(f64::from(0.95 - 0.88 * position(metres)));
    Rgb([c.r, c.g, c.b])
}

/// Draws the scale below row `top`: a strip of colours, and ticks with their metres.
fn scale_bar(picture: &mut RgbImage, top: u32) {
    let width = picture.width();
    let (near, far) = COLOUR_RANGE_M;
    let span = (width.saturating_sub(1)).max(1) as f32;
    for u in 0..width {
        let strip = colour(near * (far / near).powf(u as f32 / span));
        for v in top + 4..top + 16 {
            picture.put_pixel(u, v, strip);
        }
    }
    let mut free_from = 0;
    for metres in TICKS_M {
        let u = (position(metres) * width.saturating_sub(1) as f32).round() as u32;
        for v in top + 12..top + 20 {
            picture.put_pixel(u, v, Rgb([0; 3]));
        }
        let label = format!("{metres} m");
        let label_width = GLYPH * label.len() as u32;
        let left = u
            .saturating_sub(label_width / 2)
            .min(width.saturating_sub(label_width));
        // A narrow picture has no room for all of them.
        if left >= free_from && label_width <= width {
            write_text(picture, left, top + 22, &label);
            free_from = left + label_width + GLYPH;
        }
    }
}

fn write_text(picture: &mut RgbImage, left: u32, top: u32, text: &str) {
    for (i, character) in text.chars().enumerate() {
        let Some(rows) = font8x8::BASIC_FONTS.get(character) else {
            continue;
        };
        for (v, row) in rows.iter().enumerate() {
            for u in (0..GLYPH).filter(|u| row >> u & 1 == 1) {
                let at = (left + GLYPH * i as u32 + u, top + v as u32);
                if let Some(pixel) = picture.get_pixel_mut_checked(at.0, at.1) {
                    *pixel = Rgb([0; 3]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No tick of the scale is beside the picture.
    #[test]
    fn every_width_has_a_scale() {
        for width in (1..300).chain([4000]) {
            let values = vec![10.0; 3 * width as usize];
            let picture = depth_colours(Map {
                width,
                values: &values,
            });
            assert_eq!(picture.width(), width);
            assert_eq!(picture.get_pixel(width - 1, 2), &colour(10.0));
        }
    }
}
