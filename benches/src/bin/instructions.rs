//! What `.ci/instructions` counts the instructions of: `instructions CASE` runs one case once, `instructions` lists them.
//!
//! Only what runs inside [`counted`] counts; the rest makes ready. No case depends on time, on threads, or on what the
//! processor has beyond AVX2.
#![allow(clippy::expect_used)]

use std::hint::black_box;
use std::path::Path;
use std::process::ExitCode;

use gedepth::{Calibration, Engine, Estimator, Kernel, Model, OutputSize, Picture, picture};
use gedepth_core::camera::{
    BrownConrady, CameraModel, ImageSize, Intrinsics, KannalaBrandt, Pinhole,
};
use gedepth_core::fusion::{
    AttentionHead, AttentionUnit, DecodeAt, DepthRange, FusedMaps, Fusion, HeadMap, ResidualHead,
    ResidualUnit, Samples, SlopeHead, Upsampling, scratch_len,
};
use gedepth_core::slope::{SlopeClasses, SlopeSign};
use gedepth_core::table::{FixedView, GroundCoefficients, GroundRows, GroundView, RayView};
use gedepth_core::{Angle, Ground};

const WIDTH: u32 = 1216;
const HEIGHT: u32 = 352;
const CLASSES: usize = 11;

const CASES: [(&str, fn()); 14] = [
    ("table_pinhole", || table(&pinhole())),
    ("table_pinhole_u16", fixed_point),
    ("table_kannala_brandt", || table(&kannala_brandt())),
    ("table_brown_conrady", || table(&brown_conrady())),
    ("table_rebuild", rebuild),
    // As callers get it that are compiled for any x86-64, and as the runtime does, for AVX2.
    ("fusion_baseline_sse2", || fusion(Mode::Baseline, fuse)),
    ("fusion_vanilla_sse2", || fusion(Mode::Vanilla, fuse)),
    ("fusion_adaptive_sse2", || fusion(Mode::Adaptive, fuse)),
    ("fusion_baseline", || fusion(Mode::Baseline, fuse_avx2)),
    ("fusion_vanilla", || fusion(Mode::Vanilla, fuse_avx2)),
    ("fusion_adaptive", || fusion(Mode::Adaptive, fuse_avx2)),
    ("fusion_adaptive_resized", || {
        // To a picture whose size is no multiple of the heads'.
        let picture = ImageSize::new(1242, 375).expect("a valid size");
        fusion_to(picture, Mode::Adaptive, fuse_avx2)
    }),
    // Picture to depth: resampling, the network, and fusion at the network's size.
    ("picture_avx2", || network(Kernel::Avx2, (320, 96))),
    ("picture_portable", || network(Kernel::Portable, (160, 64))),
];

fn main() -> ExitCode {
    let Some(asked) = std::env::args().nth(1) else {
        for (name, _) in CASES {
            println!("{name}");
        }
        return ExitCode::SUCCESS;
    };
    let Some((_, case)) = CASES.into_iter().find(|(name, _)| *name == asked) else {
        eprintln!("there is no case {asked:?}");
        return ExitCode::FAILURE;
    };
    case();
    ExitCode::SUCCESS
}

/// `.ci/instructions` has callgrind collect in here, by the name.
#[inline(never)]
fn counted(work: &mut dyn FnMut()) {
    work();
    // So that the call above is no jump to the end of this function.
    black_box(());
}

fn size() -> ImageSize {
    ImageSize::new(WIDTH, HEIGHT).expect("a valid size")
}

fn ground() -> Ground {
    Ground::from_mounting(1.65, Angle::from_degrees(0.6), Angle::from_degrees(-0.5))
        .expect("valid mounting")
}

fn intrinsics(size: ImageSize) -> Intrinsics {
    Intrinsics::new(size, 721.5, 721.5, 596.6, 149.9).expect("valid intrinsics")
}

fn pinhole() -> Pinhole {
    Pinhole::new(intrinsics(size()))
}

/// It sees 92 degrees to the sides.
fn kannala_brandt() -> KannalaBrandt {
    let wide = Intrinsics::centred(size(), 350.0).expect("valid intrinsics");
    KannalaBrandt::new(wide, [0.02, -0.01, 0.004, -0.0008]).expect("valid coefficients")
}

fn brown_conrady() -> BrownConrady {
    BrownConrady::new(intrinsics(size()), [-0.3, 0.12, 0.0005, -0.0004, -0.02])
        .expect("valid coefficients")
}

fn table<C: CameraModel>(camera: &C) {
    let mut memory = vec![0.0; GroundView::len(size())];
    let ground = ground();
    counted(&mut || {
        GroundView::build(black_box(&mut memory), black_box(camera), &ground)
            .expect("enough memory");
    });
    black_box(memory);
}

fn fixed_point() {
    let mut memory = vec![0; FixedView::<256, 255>::len(size())];
    let (camera, ground) = (pinhole(), ground());
    counted(&mut || {
        FixedView::<256, 255>::build(black_box(&mut memory), black_box(&camera), &ground)
            .expect("enough memory");
    });
    black_box(memory);
}

fn rebuild() {
    let mut memory = vec![0.0; RayView::len(size())];
    let rays = RayView::build(&mut memory, &kannala_brandt()).expect("enough memory");
    let mut memory = vec![0.0; GroundView::len(size())];
    let ground = ground();
    counted(&mut || {
        GroundView::rebuild(black_box(&mut memory), black_box(&rays), &ground)
            .expect("enough memory");
    });
    black_box(memory);
}

#[derive(Clone, Copy)]
enum Mode {
    Baseline,
    Vanilla,
    Adaptive,
}

/// Smooth, bounded values that differ from pixel to pixel.
fn wave(count: usize, scale: f32, offset: f32) -> Vec<f32> {
    (0..count)
        .map(|i| (i as f32 * 0.37).sin() * scale + offset)
        .collect()
}

/// What a fusion reads and writes.
struct Maps<'a> {
    fusion: Fusion,
    ground: GroundCoefficients,
    residual: ResidualHead<'a>,
    attention: AttentionHead<'a>,
    slope: SlopeHead<'a>,
    scratch: Vec<f32>,
    depth: Vec<f32>,
}

/// At the network's size.
fn fusion(mode: Mode, fuse: fn(&mut Maps<'_>, Mode)) {
    fusion_to(size(), mode, fuse);
}

/// Residual and attention at half the network's size, the slope at an eighth: as the shipped networks have them.
fn fusion_to(output: ImageSize, mode: Mode, fuse: fn(&mut Maps<'_>, Mode)) {
    let degrees = Angle::from_degrees;
    let classes = SlopeClasses::uniform(
        degrees(-5.0),
        degrees(5.0),
        CLASSES,
        SlopeSign::DownhillPositive,
    )
    .expect("valid classes");
    let head = |divisor| ImageSize::new(WIDTH / divisor, HEIGHT / divisor).expect("a valid size");
    let (half, eighth) = (head(2), head(8));
    let residual = wave(half.pixels(), 1.0, 2.5);
    let attention = wave(half.pixels(), 4.0, 0.0);
    let slope = wave(eighth.pixels() * CLASSES, 3.0, 0.0);
    let map = |values, channels, size| {
        HeadMap::new(Samples::F32(values), channels, size).expect("as many values as the size says")
    };
    let decode_at = DecodeAt::HeadSize;
    let mut maps = Maps {
        fusion: Fusion::new(
            Upsampling::HalfPixel,
            DepthRange::new(1e-3, 80.0).expect("a valid range"),
            200.0,
        )
        .expect("a valid limit"),
        ground: GroundCoefficients::new(&intrinsics(output), &ground()),
        residual: ResidualHead {
            map: map(&residual, 1, half),
            unit: ResidualUnit::LogMetres,
            decode_at,
        },
        attention: AttentionHead {
            map: map(&attention, 1, half),
            unit: AttentionUnit::Logit,
            decode_at,
        },
        slope: SlopeHead {
            map: map(&slope, CLASSES, eighth),
            classes: &classes,
            decode_at,
        },
        scratch: vec![0.0; scratch_len(output, WIDTH, CLASSES)],
        depth: vec![0.0; output.pixels()],
    };
    counted(&mut || fuse(black_box(&mut maps), mode));
    black_box(maps.depth);
}

#[inline(always)]
fn inlined(maps: &mut Maps<'_>, mode: Mode) {
    let Maps {
        fusion,
        ground,
        residual,
        attention,
        slope,
        scratch,
        depth,
    } = maps;
    let out = FusedMaps {
        depth,
        attention: None,
        ground: None,
    };
    match mode {
        Mode::Baseline => fusion.baseline(ground.size(), residual, scratch, out.depth),
        Mode::Vanilla => fusion.vanilla(ground, residual, attention, scratch, out),
        Mode::Adaptive => fusion.adaptive(ground, residual, attention, slope, scratch, out),
    }
    .expect("valid fusion");
}

fn fuse(maps: &mut Maps<'_>, mode: Mode) {
    inlined(maps, mode);
}

/// How the runtime gets vectors out of core's plain loops.
#[cfg(target_arch = "x86_64")]
fn fuse_avx2(maps: &mut Maps<'_>, mode: Mode) {
    #[target_feature(enable = "avx2")]
    fn wide(maps: &mut Maps<'_>, mode: Mode) {
        inlined(maps, mode);
    }
    assert!(is_x86_feature_detected!("avx2"), "the processor has AVX2");
    // SAFETY: the processor has what `wide` is compiled for, as was just asked.
    unsafe { wide(maps, mode) }
}

#[cfg(not(target_arch = "x86_64"))]
fn fuse_avx2(maps: &mut Maps<'_>, mode: Mode) {
    inlined(maps, mode);
}

fn network(kernel: Kernel, network: (u32, u32)) {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/scenes/street");
    let image = picture::read(&scene.join("image.png")).expect("the shipped picture");
    let picture = Picture::from(&image);
    let calibration = Calibration::read(&scene.join("calibration.json")).expect("its calibration");
    let engine = Engine::Quantized { kernel, threads: 1 };
    let model = Model::embedded().expect("the embedded model");
    let mut estimator = Estimator::new(
        &model.with_engine(engine),
        &calibration,
        picture.size(),
        Some(network),
        OutputSize::Network,
    )
    .expect("an estimator");
    counted(&mut || {
        estimator.run(picture).expect("depth");
    });
}
