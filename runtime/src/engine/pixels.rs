//! The first layer's bytes straight from a picture's: what QuantizeLinear makes of functions of each byte, from tables.

use super::layer::Quantization;

/// What becomes of a picture's pixels: four bytes each, one a channel.
#[derive(Debug)]
pub(crate) struct Pixels {
    quantization: Quantization,
    size: [usize; 2],
    /// For red, green and blue: what each byte becomes, at its channel's place among the four.
    colours: Box<[[u32; 256]; 3]>,
    /// The byte of the channel that does not come from the picture, row by row, and its place among the four.
    constant: (Vec<u8>, usize),
}

impl Pixels {
    /// Of pictures of `[height, width]`; every channel is zero.
    pub(crate) fn new(quantization: Quantization, size: [usize; 2]) -> Self {
        Self {
            quantization,
            size,
            colours: Box::new([[0; 256]; 3]),
            constant: (vec![0; size[0] * size[1]], 3),
        }
    }

    /// `channel` is `value` of the byte of red, green or blue (`colour` 0, 1, 2).
    pub(crate) fn set_colour(&mut self, channel: usize, colour: usize, value: impl Fn(u8) -> f32) {
        for (byte, entry) in (0..=255).zip(&mut self.colours[colour]) {
            *entry = u32::from(self.quantization.byte(value(byte))) << (8 * channel);
        }
    }

    /// Row `y` of `channel` is these values, whatever the picture.
    pub(crate) fn set_constant_row(&mut self, channel: usize, y: usize, values: &[f32]) {
        let (bytes, place) = &mut self.constant;
        let row = bytes[y * self.size[1]..][..self.size[1]].iter_mut();
        for (byte, &value) in row.zip(values) {
            *byte = self.quantization.byte(value);
        }
        *place = channel;
    }

    /// Row `y` from planes of f32.
    #[cfg(test)]
    pub(super) fn quantize(&self, planes: &[f32], y: usize, out: &mut [u8]) {
        let [height, width] = self.size;
        for (channel, plane) in planes.chunks_exact(height * width).enumerate() {
            for (x, value) in plane[y * width..][..width].iter().enumerate() {
                out[4 * x + channel] = self.quantization.byte(*value);
            }
        }
    }

    /// Row `y`, to be written.
    pub(super) fn row<'a>(&'a self, y: usize, out: &'a mut [u8]) -> PixelRow<'a> {
        let (constant, place) = &self.constant;
        PixelRow {
            colours: &self.colours,
            constant: &constant[y * self.size[1]..][..self.size[1]],
            shift: 8 * place,
            out: out.as_chunks_mut().0,
        }
    }
}

/// A row of the first layer's bytes.
pub(crate) struct PixelRow<'a> {
    colours: &'a [[u32; 256]; 3],
    constant: &'a [u8],
    shift: usize,
    out: &'a mut [[u8; 4]],
}

impl PixelRow<'_> {
    /// Writes all of it: `pixels` are red, green, blue and a byte that is not read.
    pub(crate) fn write(self, pixels: &[[u8; 4]]) {
        let [reds, greens, blues] = self.colours;
        let sources = pixels.iter().zip(self.constant);
        for (out, (&[red, green, blue, _], &constant)) in self.out.iter_mut().zip(sources) {
            let pixel = reds[usize::from(red)]
                | greens[usize::from(green)]
                | blues[usize::from(blue)]
                | u32::from(constant) << self.shift;
            *out = pixel.to_le_bytes();
        }
    }
}
