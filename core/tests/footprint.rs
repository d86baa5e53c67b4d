//! What types and calls cost in memory: the numbers in the crate's documentation.
#![allow(clippy::unwrap_used)]

use std::mem::size_of;

use gedepth_core::camera::{BrownConrady, ImageSize, Intrinsics, KannalaBrandt, Pinhole, Pixel};
use gedepth_core::fusion::{
    AttentionHead, DepthRange, FusedMaps, Fusion, HeadMap, ReferenceFusion, ResidualHead, SlopeHead,
};
use gedepth_core::metrics::{
    ByDistance, ByRegion, CloudMatches, CloudMetrics, Crop, DepthErrors, DepthMetrics, Evaluation,
};
use gedepth_core::slope::SlopeClasses;
use gedepth_core::table::{
    Coverage, FixedView, GroundCoefficients, GroundLut, GroundView, KittiLut, RayLut, RayView,
    RowLut, RowTolerance, RowView,
};
use gedepth_core::{
    Angle, CameraFrame, Direction, Error, Extrinsics, Ground, GroundPlane, Mounting, Point,
};

/// 64-bit targets; where pointers are shorter, types that borrow are smaller.
#[test]
#[cfg(target_pointer_width = "64")]
fn sizes() {
    let sizes = [
        ("Angle", size_of::<Angle>(), 8),
        ("Point", size_of::<Point<CameraFrame>>(), 24),
        ("Direction", size_of::<Direction<CameraFrame>>(), 24),
        ("Error", size_of::<Error>(), 32),
        ("ImageSize", size_of::<ImageSize>(), 8),
        ("Pixel", size_of::<Pixel>(), 16),
        ("Intrinsics", size_of::<Intrinsics>(), 48),
        ("Pinhole", size_of::<Pinhole>(), 48),
        ("BrownConrady", size_of::<BrownConrady>(), 120),
        ("KannalaBrandt", size_of::<KannalaBrandt>(), 312),
        ("Extrinsics", size_of::<Extrinsics>(), 168),
        ("Mounting", size_of::<Mounting>(), 32),
        ("GroundPlane", size_of::<GroundPlane>(), 32),
        ("Ground", size_of::<Ground>(), 32),
        ("GroundView", size_of::<GroundView<'_>>(), 32),
        ("GroundLut<1000>", size_of::<GroundLut<1000>>(), 4000 + 16),
        ("FixedView", size_of::<FixedView<'_, 256, 255>>(), 32),
        ("KittiLut<1000>", size_of::<KittiLut<1000>>(), 2000 + 16),
        ("RowView", size_of::<RowView<'_>>(), 32),
        ("RowLut<1000>", size_of::<RowLut<1000>>(), 4000 + 16),
        ("RowTolerance", size_of::<RowTolerance>(), 16),
        ("RayView", size_of::<RayView<'_>>(), 40),
        ("RayLut<1000>", size_of::<RayLut<1000>>(), 8000 + 12),
        ("GroundCoefficients", size_of::<GroundCoefficients>(), 40),
        ("Coverage", size_of::<Coverage>(), 16),
        ("SlopeClasses", size_of::<SlopeClasses>(), 264),
        ("HeadMap", size_of::<HeadMap<'_>>(), 40),
        ("ResidualHead", size_of::<ResidualHead<'_>>(), 56),
        ("AttentionHead", size_of::<AttentionHead<'_>>(), 48),
        ("SlopeHead", size_of::<SlopeHead<'_>>(), 56),
        ("DepthRange", size_of::<DepthRange>(), 8),
        ("Fusion", size_of::<Fusion>(), 24),
        ("FusedMaps", size_of::<FusedMaps<'_>>(), 48),
        ("ReferenceFusion", size_of::<ReferenceFusion>(), 16),
        ("DepthErrors", size_of::<DepthErrors>(), 80),
        ("DepthMetrics", size_of::<DepthMetrics>(), 72),
        ("ByDistance<8>", size_of::<ByDistance<8>>(), 8 * 84),
        ("ByRegion<8>", size_of::<ByRegion<8>>(), 8 * 80),
        ("Evaluation", size_of::<Evaluation>(), 24),
        ("Crop", size_of::<Crop>(), 16),
        ("CloudMatches", size_of::<CloudMatches>(), 32),
        ("CloudMetrics", size_of::<CloudMetrics>(), 32),
    ];
    for (name, size, expected) in sizes {
        assert_eq!(size, expected, "{name}");
    }
}

/// Measured by running calls on a stack of our own that was painted before.
#[cfg(all(target_os = "linux", not(debug_assertions)))]
mod stack {
    use std::hint::black_box;

    use gedepth_core::camera::CameraModel;
    use gedepth_core::fusion::{
        AttentionUnit, DecodeAt, ResidualUnit, Samples, Upsampling, reference_scratch_len,
        scratch_len,
    };
    use gedepth_core::slope::SlopeSign;
    use gedepth_core::table::write_depth;

    use super::*;

    const WORDS: usize = 1 << 16;
    const PAINT: u64 = 0x5ca1_ab1e_0ddb_a115;

    extern "C" fn call(job: *mut libc::c_void) -> *mut libc::c_void {
        // SAFETY: `bytes_used` passes a pointer to a `fn()` that outlives the thread.
        let job = unsafe { *job.cast::<fn()>() };
        job();
        std::ptr::null_mut()
    }

    fn bytes_used(mut job: fn()) -> usize {
        #[repr(align(4096))]
        struct Page([u64; WORDS]);
        let mut stack = vec![Page([PAINT; WORDS])];
        let base = stack.as_mut_ptr().cast::<libc::c_void>();
        // SAFETY: the memory is ours, aligned to pages, larger than the least stack, and outlives the thread, which is
        // joined before it is looked at; `attributes` is initialized before it is used.
        unsafe {
            let mut attributes = std::mem::zeroed::<libc::pthread_attr_t>();
            let mut thread = std::mem::zeroed::<libc::pthread_t>();
            assert_eq!(libc::pthread_attr_init(&raw mut attributes), 0);
            assert_eq!(
                libc::pthread_attr_setstack(&raw mut attributes, base, size_of::<Page>()),
                0
            );
            let job = (&raw mut job).cast::<libc::c_void>();
            assert_eq!(
                libc::pthread_create(&raw mut thread, &raw const attributes, call, job),
                0
            );
            assert_eq!(libc::pthread_join(thread, std::ptr::null_mut()), 0);
            libc::pthread_attr_destroy(&raw mut attributes);
        }
        let untouched = black_box(&stack)[0]
            .0
            .iter()
            .take_while(|word| **word == PAINT)
            .count();
        (WORDS - untouched) * size_of::<u64>()
    }

    fn scene() -> (ImageSize, Intrinsics, Ground) {
        let size = ImageSize::new(64, 32).unwrap();
        let ground = Ground::from_mounting(1.5, Angle::from_degrees(2.0), Angle::ZERO).unwrap();
        (
            size,
            black_box(Intrinsics::centred(size, 60.0).unwrap()),
            ground,
        )
    }

    fn poses() {
        let (_, intrinsics, ground) = scene();
        let camera = BrownConrady::new(intrinsics, [-0.1, 0.0, 0.0, 0.0, 0.0]).unwrap();
        black_box(ground.vanishing_line(&camera));
    }

    fn cameras() {
        let (_, intrinsics, _) = scene();
        let camera = KannalaBrandt::new(intrinsics, [0.02, 0.0, 0.0, 0.0]).unwrap();
        black_box(camera.unproject(Pixel::new(3.0, 4.0)));
        black_box(camera.project(Point::new(1.0, 2.0, 3.0)));
    }

    // Memory that callers keep in statics, here on the heap.
    fn tables() {
        let (size, intrinsics, ground) = scene();
        let mut memory = vec![0.0; size.pixels()];
        let camera = BrownConrady::new(intrinsics, [-0.1, 0.0, 0.0, 0.0, 0.0]).unwrap();
        let table = GroundView::build(&mut memory, &camera, &ground).unwrap();
        black_box(Coverage::of(&table, &mut [0.0; 64]).unwrap());
        write_depth(&table, 80.0, &mut vec![0.0; size.pixels()]).unwrap();
        let mut rays = vec![0.0; RayView::len(size)];
        let rays = RayView::build(&mut rays, &camera).unwrap();
        GroundView::rebuild(&mut memory, &rays, &ground).unwrap();
    }

    fn head(values: &[f32], channels: usize) -> HeadMap<'_> {
        HeadMap::new(
            Samples::F32(values),
            channels,
            ImageSize::new(16, 8).unwrap(),
        )
        .unwrap()
    }

    fn fuse(at: DecodeAt) {
        let (size, _, _) = scene();
        let inverse = vec![0.1; size.pixels()];
        let ground = GroundView::from_values(&inverse, size, 1.5).unwrap();
        let range = DepthRange::new(1.0, 80.0).unwrap();
        let classes: SlopeClasses = SlopeClasses::uniform(
            Angle::from_degrees(-5.0),
            Angle::from_degrees(5.0),
            11,
            SlopeSign::DownhillPositive,
        )
        .unwrap();
        let values = vec![0.5; 11 * 128];
        let mut scratch = vec![0.0; scratch_len(size, 16, 11)];
        Fusion::new(Upsampling::HalfPixel, range, 200.0)
            .unwrap()
            .adaptive(
                &ground,
                &ResidualHead {
                    map: head(&values[..128], 1),
                    unit: ResidualUnit::LogMetres,
                    decode_at: at,
                },
                &AttentionHead {
                    map: head(&values[..128], 1),
                    unit: AttentionUnit::Logit,
                    decode_at: at,
                },
                &SlopeHead {
                    map: head(&values, 11),
                    classes: &classes,
                    decode_at: at,
                },
                &mut scratch,
                FusedMaps {
                    depth: &mut vec![0.0; size.pixels()],
                    attention: None,
                    ground: None,
                },
            )
            .unwrap();
    }

    fn fusion() {
        fuse(DecodeAt::HeadSize);
        fuse(DecodeAt::OutputSize);
    }

    fn reference() {
        let (size, _, _) = scene();
        let inverse = vec![0.1; size.pixels()];
        let ground = GroundView::from_values(&inverse, size, 1.5).unwrap();
        let classes: SlopeClasses = SlopeClasses::uniform(
            Angle::from_degrees(-5.0),
            Angle::from_degrees(5.0),
            11,
            SlopeSign::UphillPositive,
        )
        .unwrap();
        let values = vec![0.5; size.pixels()];
        let attention = HeadMap::new(Samples::F32(&values), 1, size).unwrap();
        let slope = SlopeHead {
            map: head(&values[..11 * 128], 11),
            classes: &classes,
            decode_at: DecodeAt::OutputSize,
        };
        let mut scratch = vec![0.0; reference_scratch_len(size, 16, 16, 11)];
        ReferenceFusion::new(1.65, 200.0, DepthRange::new(1.0, 80.0).unwrap())
            .unwrap()
            .adaptive(
                &ground,
                &head(&values[..128], 1),
                &attention,
                &slope,
                &mut scratch,
                &mut vec![0.0; size.pixels()],
            )
            .unwrap();
    }

    fn metrics() {
        let cloud = vec![Point::<CameraFrame>::new(1.0, 2.0, 3.0); 40];
        let mut matches = CloudMatches::new();
        matches.add(&cloud, &cloud, 0.1, &mut [0; 81]).unwrap();
        let mut errors = DepthErrors::new();
        errors.add(1.0, 2.0);
        black_box((matches.metrics(), errors.metrics()));
    }

    #[test]
    fn use_of_every_entry() {
        let idle = bytes_used(|| ());
        for (name, job, limit) in [
            ("cameras", cameras as fn(), 4 * 1024),
            ("vanishing line", poses, 4 * 1024),
            ("tables", tables, 4 * 1024),
            ("fusion", fusion, 6 * 1024),
            ("reference fusion", reference, 6 * 1024),
            ("metrics", metrics, 4 * 1024),
        ] {
            let used = bytes_used(job).saturating_sub(idle);
            println!("{name}: {used} bytes of stack");
            assert!(
                used > 0 && used <= limit,
                "{name}: {used} bytes, limit {limit}"
            );
        }
    }
}
