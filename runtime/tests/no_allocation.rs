//! A picture costs no heap allocation, from its bytes to its depth, on any of the engine's threads, and each kernel and
//! number of threads gives the same depth.
#![allow(clippy::expect_used)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering::SeqCst};

use gedepth::gedepth_core::Ground;
use gedepth::{
    Calibration, Distortion, Engine, Estimator, Kernel, Model, Numbers, OutputSize, Picture,
    PixelFormat, Plane, Yuv, picture,
};

/// The system's allocator, counting.
struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: all of it is the system's.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, SeqCst);
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, SeqCst);
        // SAFETY: as above.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// One test: others would allocate meanwhile.
#[test]
fn a_picture_costs_no_allocation() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/scenes/street");
    let image = picture::read(&scene.join("image.png")).expect("the shipped picture");
    let picture = Picture::from(&image);
    // Its bytes as another format's, whatever they then show.
    let (width, height) = image.dimensions();
    let (luma, chroma) = image.as_raw().split_at((width * height) as usize);
    let planes =
        [(luma, width), (chroma, width.next_multiple_of(2))].map(|(bytes, stride)| Plane {
            bytes,
            stride: stride as usize,
        });
    let nv12 = PixelFormat::Nv12(Yuv::Bt709Limited);
    let nv12 = Picture::with_format((width, height), nv12, &planes).expect("a picture");
    let calibration = Calibration::read(&scene.join("calibration.json")).expect("its calibration");
    let ground = calibration.ground();
    let lower = Ground::new(ground.down(), 0.9 * ground.height()).expect("a ground");
    let mut depths: [Option<Vec<f32>>; 2] = [None, None];
    for kernel in Kernel::ALL
        .into_iter()
        .filter(|kernel| kernel.is_supported())
    {
        for threads in [1, 3] {
            for (output, expected) in [OutputSize::Picture, OutputSize::Network]
                .into_iter()
                .zip(&mut depths)
            {
                let model = Model::embedded().expect("the embedded model");
                let model = model.with_engine(Engine::Quantized { kernel, threads });
                let size = Some((320, 96));
                let mut estimator =
                    Estimator::new(&model, &calibration, picture.size(), size, output)
                        .expect("an estimator");
                let before = ALLOCATIONS.load(SeqCst);
                // The first picture too.
                estimator.run(picture).expect("depth");
                let once = estimator.run(picture).expect("depth").depth[0];
                // Ground and attention, made when asked for, are made beside the same depth.
                let depth = estimator.maps().expect("maps").depth;
                assert_eq!(depth[0], once);
                estimator.run(nv12).expect("depth");
                // Another ground, and the first one again.
                for ground in [&lower, calibration.ground()] {
                    estimator.set_ground(ground).expect("a ground");
                    estimator.run(picture).expect("depth");
                }
                let allocations = ALLOCATIONS.load(SeqCst) - before;
                assert_eq!(allocations, 0, "{kernel:?}, {threads} threads, {output:?}");
                let depth = estimator.maps().expect("maps").depth;
                let expected = expected.get_or_insert_with(|| depth.to_vec());
                assert!(
                    expected == depth,
                    "{kernel:?}, {threads} threads, {output:?}"
                );
            }
        }
    }

    // Of a lens there are tables, which are made anew.
    let numbers = Numbers {
        distortion: Distortion::Equidistant([0.02, -0.003, 0.0, 0.0]),
        ..Numbers::read(&scene.join("calibration.json")).expect("its calibration")
    };
    let fisheye = Calibration::new(&scene, &numbers).expect("a camera");
    let model = Model::embedded().expect("the embedded model");
    let (size, output) = (Some((320, 96)), OutputSize::Picture);
    let mut estimator =
        Estimator::new(&model, &fisheye, picture.size(), size, output).expect("an estimator");
    let before = ALLOCATIONS.load(SeqCst);
    estimator.set_ground(&lower).expect("a ground");
    estimator.run(picture).expect("depth");
    assert_eq!(ALLOCATIONS.load(SeqCst) - before, 0, "of a lens");
}
