//! How the core's work grows: ground tables with pixels and camera, adaptive fusion with slope classes.
//!
//! ```text
//! cargo run --release -p gedepth-benches --bin core_scaling [-- RUNS [WIDTHxHEIGHT...]]
//! ```
//!
//! One line each: `table CAMERA WIDTH HEIGHT` or `fusion CLASSES WIDTH HEIGHT`, then microseconds on one core, the least and
//! the median. All take turns, so that a machine that slows down slows all of them. `scaling.py` draws it.

use std::error::Error;
use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

use gedepth_core::camera::{BrownConrady, ImageSize, Intrinsics, KannalaBrandt, Pinhole};
use gedepth_core::fusion::{
    AttentionHead, AttentionUnit, DecodeAt, DepthRange, FusedMaps, Fusion, HeadMap, ResidualHead,
    ResidualUnit, Samples, SlopeHead, Upsampling, scratch_len,
};
use gedepth_core::slope::{SlopeClasses, SlopeSign};
use gedepth_core::table::GroundView;
use gedepth_core::{Angle, Ground};

/// Of the depth that is fused; residual and attention come at a half of it, slope at an eighth.
const FUSED: (u32, u32) = (1216, 352);
/// Spread over 10 degrees. At most 64 are allowed.
const CLASSES: [usize; 5] = [5, 11, 21, 41, 61];

type Failure = Box<dyn Error>;

/// Does its work once.
type Work = Box<dyn FnMut() -> Result<(), gedepth_core::Error>>;

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("core_scaling: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let runs: usize = arguments.next().map_or(Ok(20), |runs| runs.parse())?;
    let mut sizes = arguments
        .map(|size| {
            let (width, height) = size.split_once('x').ok_or("sizes are WIDTHxHEIGHT")?;
            Ok((width.parse()?, height.parse()?))
        })
        .collect::<Result<Vec<(u32, u32)>, Failure>>()?;
    if sizes.is_empty() {
        sizes = vec![(320, 96), (640, 192), FUSED];
    }
    let mut works: Vec<(String, Work)> = Vec::new();
    for &(width, height) in &sizes {
        for (camera, work) in tables(width, height)? {
            works.push((format!("table {camera} {width} {height}"), work));
        }
    }
    for classes in CLASSES {
        let name = format!("fusion {classes} {} {}", FUSED.0, FUSED.1);
        works.push((name, fusion(classes)?));
    }
    let mut times = vec![Vec::with_capacity(runs); works.len()];
    for turn in 0..=runs {
        for ((_, work), times) in works.iter_mut().zip(&mut times) {
            let clock = Instant::now();
            work()?;
            let time = clock.elapsed().as_secs_f64() * 1e6;
            // The first turn finds memory that was never touched.
            if turn > 0 {
                times.push(time);
            }
        }
    }
    for ((name, _), mut times) in works.into_iter().zip(times) {
        times.sort_by(f64::total_cmp);
        let (Some(least), Some(median)) = (times.first(), times.get(times.len() / 2)) else {
            return Err("at least one run is needed".into());
        };
        println!("{name} {least:.1} {median:.1}");
    }
    Ok(())
}

/// As in the bench `core`, at any size.
fn tables(width: u32, height: u32) -> Result<[(&'static str, Work); 3], Failure> {
    let size = ImageSize::new(width, height)?;
    let ground = ground()?;
    let pixels = f64::from(width) / f64::from(FUSED.0);
    let [u, v] = [f64::from(width) * 0.49, f64::from(height) * 0.43];
    let narrow = Intrinsics::new(size, 721.5 * pixels, 721.5 * pixels, u, v)?;
    let wide = Intrinsics::centred(size, 350.0 * pixels)?;
    let pinhole = Pinhole::new(narrow);
    let fisheye = KannalaBrandt::new(wide, [0.02, -0.01, 0.004, -0.0008])?;
    let distorted = BrownConrady::new(narrow, [-0.3, 0.12, 0.0005, -0.0004, -0.02])?;
    let memory = || vec![0.0_f32; size.pixels()];
    let (mut first, mut second, mut third) = (memory(), memory(), memory());
    Ok([
        (
            "pinhole",
            Box::new(move || {
                GroundView::build(black_box(&mut first), black_box(&pinhole), &ground).map(|_| ())
            }),
        ),
        (
            "Kannala-Brandt",
            Box::new(move || {
                GroundView::build(black_box(&mut second), black_box(&fisheye), &ground).map(|_| ())
            }),
        ),
        (
            "Brown-Conrady",
            Box::new(move || {
                GroundView::build(black_box(&mut third), black_box(&distorted), &ground).map(|_| ())
            }),
        ),
    ])
}

fn ground() -> Result<Ground, gedepth_core::Error> {
    Ground::from_mounting(1.65, Angle::from_degrees(0.6), Angle::from_degrees(-0.5))
}

/// What adaptive fusion reads.
struct Heads {
    residual: Vec<f32>,
    attention: Vec<f32>,
    half: ImageSize,
    slope: Vec<f32>,
    eighth: ImageSize,
    classes: SlopeClasses,
}

impl Heads {
    #[inline(always)]
    fn fuse(
        &self,
        fusion: &Fusion,
        ground: &GroundView<'_>,
        scratch: &mut [f32],
        depth: &mut [f32],
    ) -> Result<(), gedepth_core::Error> {
        let decode_at = DecodeAt::HeadSize;
        let classes = self.classes.radians().len();
        fusion.adaptive(
            ground,
            &ResidualHead {
                map: HeadMap::new(Samples::F32(&self.residual), 1, self.half)?,
                unit: ResidualUnit::LogMetres,
                decode_at,
            },
            &AttentionHead {
                map: HeadMap::new(Samples::F32(&self.attention), 1, self.half)?,
                unit: AttentionUnit::Logit,
                decode_at,
            },
            &SlopeHead {
                map: HeadMap::new(Samples::F32(&self.slope), classes, self.eighth)?,
                classes: &self.classes,
                decode_at,
            },
            scratch,
            FusedMaps {
                depth,
                attention: None,
                ground: None,
            },
        )
    }
}

/// Fuses with the vectors that the runtime uses.
fn fuse(
    heads: &Heads,
    fusion: &Fusion,
    ground: &GroundView<'_>,
    scratch: &mut [f32],
    depth: &mut [f32],
) -> Result<(), gedepth_core::Error> {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn avx2(
            heads: &Heads,
            fusion: &Fusion,
            ground: &GroundView<'_>,
            scratch: &mut [f32],
            depth: &mut [f32],
        ) -> Result<(), gedepth_core::Error> {
            heads.fuse(fusion, ground, scratch, depth)
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the only condition on calling `avx2` is that the CPU has it, which was just asked.
            return unsafe { avx2(heads, fusion, ground, scratch, depth) };
        }
    }
    heads.fuse(fusion, ground, scratch, depth)
}

fn fusion(classes: usize) -> Result<Work, Failure> {
    let (width, height) = FUSED;
    let size = ImageSize::new(width, height)?;
    let [half, eighth] = [2, 8].map(|stride| ImageSize::new(width / stride, height / stride));
    let (half, eighth) = (half?, eighth?);
    let [first, last] = [-5.0, 5.0].map(Angle::from_degrees);
    let heads = Heads {
        residual: wave(half.pixels(), 1.0, 2.5),
        attention: wave(half.pixels(), 4.0, 0.0),
        half,
        slope: wave(eighth.pixels() * classes, 3.0, 0.0),
        eighth,
        classes: SlopeClasses::uniform(first, last, classes, SlopeSign::DownhillPositive)?,
    };
    let camera = Pinhole::new(Intrinsics::new(size, 721.5, 721.5, 596.6, 149.9)?);
    let (ground, range) = (ground()?, DepthRange::new(1e-3, 80.0)?);
    let fusion = Fusion::new(Upsampling::HalfPixel, range, 200.0)?;
    let mut memory = vec![0.0_f32; size.pixels()];
    let mut scratch = vec![0.0; scratch_len(size, half.width(), classes)];
    let mut depth = vec![0.0; size.pixels()];
    let mounted = ground.height() as f32;
    GroundView::build(&mut memory, &camera, &ground)?;
    Ok(Box::new(move || {
        let ground = GroundView::from_values(&memory, size, mounted)?;
        let (scratch, depth) = (&mut scratch, black_box(&mut depth));
        fuse(black_box(&heads), &fusion, &ground, scratch, depth)
    }))
}

/// Smooth, bounded values that differ from pixel to pixel.
fn wave(count: usize, scale: f32, offset: f32) -> Vec<f32> {
    (0..count)
        .map(|i| (i as f32 * 0.37).sin() * scale + offset)
        .collect()
}
