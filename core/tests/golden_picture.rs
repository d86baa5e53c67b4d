//! A whole picture fused as the reference implementation fuses it, against the depth that it gave. Its recordings are not
//! part of this repository: looked for in `../shared/golden` beside it.
//!
//! The judge is the same fusion in `f64`. With the positions of samples rounded to `f32`, as PyTorch has them when it
//! resizes, it gives the recorded depth; with exact ones it gives ours. Between the two, 146 of 107 008 pixels differ
//! by more than 1e-4 of the depth and 4 mm at most, where depth jumps from pixel to pixel: ours is the nearer one.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::io::Read;
use std::path::Path;

use gedepth_core::camera::ImageSize;
use gedepth_core::fusion::{
    DecodeAt, DepthRange, HeadMap, ReferenceFusion, Samples, SlopeHead, reference_scratch_len,
};
use gedepth_core::slope::{SlopeClasses, SlopeSign};
use gedepth_core::table::GroundView;
use gedepth_core::{Angle, Error};

const INPUT: (usize, usize) = (1216, 352);
const DECODER: (usize, usize) = (608, 176);
const LOGITS: (usize, usize) = (304, 88);

/// The `f32` array `name` of a NumPy archive.
fn array(archive: &[u8], name: &str, length: usize) -> Vec<f32> {
    let entry = format!("{name}.npy");
    // A local header of ZIP: 30 bytes, of which the last four are the lengths of name and extra field; then those.
    let header = (0..archive.len() - 30)
        .find(|at| {
            archive[*at..].starts_with(b"PK\x03\x04")
                && archive[at + 30..].starts_with(entry.as_bytes())
        })
        .unwrap();
    let short = |at: usize| usize::from(u16::from_le_bytes([archive[at], archive[at + 1]]));
    let data = header + 30 + short(header + 26) + short(header + 28);
    let mut bytes = Vec::new();
    flate2::read::DeflateDecoder::new(&archive[data..])
        .read_to_end(&mut bytes)
        .unwrap();
    // NumPy's own header comes before the values.
    bytes[bytes.len() - 4 * length..]
        .as_chunks::<4>()
        .0
        .iter()
        .map(|value| f32::from_le_bytes(*value))
        .collect()
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().copied().map(f64::from).collect()
}

/// How a resized map's samples lie.
#[derive(Clone, Copy, PartialEq)]
enum Positions {
    HalfPixel,
    Corners,
    /// Corners aligned, and `f32` as in PyTorch.
    CornersInF32,
}

/// Bilinear, in `f64`.
fn resized(
    map: &[f64],
    from: (usize, usize),
    to: (usize, usize),
    positions: Positions,
) -> Vec<f64> {
    let sample = |i: usize, n: usize, m: usize| {
        let (target, last) = (i as f64, n as f64 - 1.0);
        let at = match positions {
            Positions::HalfPixel => (target + 0.5) * n as f64 / m as f64 - 0.5,
            Positions::Corners => target * last / (m as f64 - 1.0),
            Positions::CornersInF32 => f64::from((n as f32 - 1.0) / (m as f32 - 1.0) * i as f32),
        };
        let at = at.clamp(0.0, last);
        (at as usize, (at as usize + 1).min(n - 1), at.fract())
    };
    let mut out = Vec::with_capacity(to.0 * to.1);
    for v in 0..to.1 {
        let (above, below, down) = sample(v, from.1, to.1);
        for u in 0..to.0 {
            let (left, right, across) = sample(u, from.0, to.0);
            let row = |y: usize| {
                map[y * from.0 + left] * (1.0 - across) + map[y * from.0 + right] * across
            };
            out.push(row(above) * (1.0 - down) + row(below) * down);
        }
    }
    out
}

/// The judge.
struct Oracle {
    attention: Vec<f64>,
    residual: Vec<f64>,
}

impl Oracle {
    /// Depth at the decoder's size and at the input's, from the ground's depths.
    fn fuse(&self, ground: &[f64], positions: Positions) -> (Vec<f64>, Vec<f64>) {
        let down = |map: &[f64]| resized(map, INPUT, DECODER, positions);
        let product: Vec<f64> = ground
            .iter()
            .zip(&self.attention)
            .map(|(z, m)| z * m)
            .collect();
        let half: Vec<f64> = (self.residual.iter().zip(down(&self.attention)))
            .zip(down(&product))
            .map(|((r, m), z)| r * (1.0 - m) + z + 1e-3)
            .collect();
        let clamped: Vec<f64> = half.iter().map(|z| z.clamp(1e-3, 80.0)).collect();
        (half, resized(&clamped, DECODER, INPUT, positions))
    }
}

/// Slopes in degrees, positive uphill: softmax over the upsampled logits of 11 classes from -5 to 5 degrees.
fn slopes(logits: &[f32]) -> Vec<f64> {
    let pixels = INPUT.0 * INPUT.1;
    let (mut sum, mut weighted) = (vec![0.0; pixels], vec![0.0; pixels]);
    for (class, logits) in logits.chunks_exact(LOGITS.0 * LOGITS.1).enumerate() {
        for (i, logit) in resized(&wide(logits), LOGITS, INPUT, Positions::HalfPixel)
            .iter()
            .enumerate()
        {
            sum[i] += logit.exp();
            weighted[i] += logit.exp() * (class as f64 - 5.0);
        }
    }
    weighted.iter().zip(&sum).map(|(w, s)| w / s).collect()
}

/// The largest difference, metres, and how many are beyond 1e-4 of the depth.
fn compare(
    depth: impl IntoIterator<Item = f32>,
    judge: impl IntoIterator<Item = f64>,
) -> (f64, usize) {
    let (mut largest, mut count) = (0.0, 0);
    for (a, b) in depth.into_iter().zip(judge) {
        let off = (f64::from(a) - b).abs();
        largest = f64::max(largest, off);
        count += usize::from(off > 1e-4 * b.abs());
    }
    (largest, count)
}

fn assert_close(
    depth: impl IntoIterator<Item = f32>,
    judge: impl IntoIterator<Item = f64>,
    metres: f64,
) {
    let (largest, count) = compare(depth, judge);
    assert!(
        largest <= metres && count == 0,
        "{largest} m off, {count} pixels by more than 1e-4"
    );
}

/// Every second row and column: what is recorded of maps of the input's size.
fn thinned<T: Copy>(map: &[T]) -> impl Iterator<Item = T> + '_ {
    let rows = map.chunks_exact(INPUT.0).step_by(2);
    rows.flat_map(|row| row.iter().copied().step_by(2))
}

#[test]
fn fused_as_the_reference_does() -> Result<(), Error> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/golden");
    let Ok(fusion) = fs::read(folder.join("fusion.npz")) else {
        println!("skipped: no recordings in {}", folder.display());
        return Ok(());
    };
    let adaptive = fs::read(folder.join("slope_adaptive.npz")).unwrap();
    let channels = fs::read(folder.join("input_channels_kitti.npz")).unwrap();
    let (pixels, half_pixels) = (INPUT.0 * INPUT.1, DECODER.0 * DECODER.1);
    let plane = array(&channels, "ground_raw", pixels);
    let logits = array(&adaptive, "slope_logits", 11 * LOGITS.0 * LOGITS.1);
    let attention = array(&adaptive, "attention", pixels);
    let residual = array(&fusion, "residual_half", half_pixels);
    let judge = Oracle {
        attention: wide(&attention),
        residual: wide(&residual),
    };

    let size = |(width, height): (usize, usize)| ImageSize::new(width as u32, height as u32);
    let (input, decoder) = (size(INPUT)?, size(DECODER)?);
    let inverse: Vec<f32> = plane.iter().map(|z| 1.0 / z).collect();
    let ground = GroundView::from_values(&inverse, input, 1.578)?;
    let residual = HeadMap::new(Samples::F32(&residual), 1, decoder)?;
    let attention = HeadMap::new(Samples::F32(&attention), 1, input)?;
    let ours = ReferenceFusion::new(1.65, 200.0, DepthRange::new(1e-3, 80.0)?)?;
    let mut depth = vec![0.0; pixels];

    // Vanilla. Depth at the input's size was not recorded.
    let cut = |z: f64| if (0.0..=200.0).contains(&z) { z } else { 0.0 };
    let planar: Vec<f64> = wide(&plane).into_iter().map(cut).collect();
    let (half, _) = judge.fuse(&planar, Positions::CornersInF32);
    assert_close(
        array(&fusion, "depth_half_vanilla", half_pixels),
        half,
        3e-5,
    );
    let (_, full) = judge.fuse(&planar, Positions::Corners);
    let mut scratch = vec![0.0; reference_scratch_len(input, 608, 0, 0)];
    ours.vanilla(&ground, &residual, &attention, &mut scratch, &mut depth)?;
    assert_close(depth.iter().copied(), full, 3e-5);

    // Adaptive. Next to 200 m, the limit, the recording's own f32 ground is 0.7 mm off.
    let degrees = slopes(&logits);
    for (angle, recorded) in degrees.iter().zip(array(&adaptive, "slope_deg", pixels)) {
        assert!((angle - f64::from(recorded)).abs() < 1e-5);
    }
    let sloped: Vec<f64> = wide(&plane)
        .iter()
        .zip(&degrees)
        .map(|(z, degrees)| cut(1.65 / (1.65 / z + degrees.to_radians().tan())))
        .collect();
    assert_close(
        array(&adaptive, "ground_adaptive", pixels),
        sloped.iter().copied(),
        1e-3,
    );
    let recorded = array(&fusion, "depth_full_adaptive", half_pixels);
    let (half, full) = judge.fuse(&sloped, Positions::CornersInF32);
    assert_close(
        array(&fusion, "depth_half_adaptive", half_pixels),
        half,
        1e-3,
    );
    assert_close(recorded.iter().copied(), thinned(&full), 2e-4);

    let angles: Vec<Angle> = (-5..=5)
        .map(|d| Angle::from_degrees(f64::from(d)))
        .collect();
    let classes = SlopeClasses::<11>::new(&angles, SlopeSign::UphillPositive)?;
    let slope = SlopeHead {
        map: HeadMap::new(Samples::F32(&logits), 11, size(LOGITS)?)?,
        classes: &classes,
        decode_at: DecodeAt::OutputSize,
    };
    let mut scratch = vec![0.0; reference_scratch_len(input, 608, 304, 11)];
    ours.adaptive(
        &ground,
        &residual,
        &attention,
        &slope,
        &mut scratch,
        &mut depth,
    )?;
    let (_, full) = judge.fuse(&sloped, Positions::Corners);
    assert_close(depth.iter().copied(), full, 2e-4);
    let (largest, count) = compare(recorded, thinned(&depth).map(f64::from));
    assert!(
        largest < 5e-3 && count < 200,
        "{largest} m off, {count} pixels by more than 1e-4"
    );
    Ok(())
}
