//! Through the C interface a picture costs no allocation, and 10,000 of them no memory.

use std::alloc::{GlobalAlloc, Layout, System};
use std::ptr::{null, null_mut};
use std::sync::atomic::{AtomicUsize, Ordering::SeqCst};

use gedepth_ffi::calibration::*;
use gedepth_ffi::camera::*;
use gedepth_ffi::ground::*;
use gedepth_ffi::model::*;
use gedepth_ffi::result::*;
use gedepth_ffi::statistics::gedepth_statistics;

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

/// Resident memory of this process, bytes; 0 where the system does not say.
fn resident() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kibibytes = line.and_then(|line| line.split_whitespace().next()?.parse::<usize>().ok());
    kibibytes.unwrap_or(0) * 1024
}

// No harness: other tests would allocate meanwhile, and so does the harness when it tells that a test takes a minute.
fn main() {
    const W: u32 = 96;
    const H: u32 = 64;
    let calibration = gedepth_calibration {
        width: W,
        height: H,
        distortion: GEDEPTH_PINHOLE,
        reserved: 0,
        fx: 60.0,
        fy: 60.0,
        cx: 47.5,
        cy: 20.0,
        skew: 0.0,
        coefficients: [0.0; 8],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        t: [0.0; 3],
        plane_up: [0.0, -1.0, 0.0],
        plane_offset: -1.5,
    };
    let options = gedepth_options {
        network_width: 64,
        network_height: 32,
        ..Default::default()
    };
    let pixels = (W * H) as usize;
    let (mut model, mut camera) = (null_mut(), null_mut());
    let mut rgb = vec![0_u8; 4 * pixels];
    let [mut depth, mut ground, mut attention] = [(); 3].map(|()| vec![0.0_f32; pixels]);
    let map = |values: &mut Vec<f32>| gedepth_map {
        values: values.as_mut_ptr(),
        values_len: values.len(),
        stride: 0,
    };
    let maps = gedepth_maps {
        depth: map(&mut depth),
        ground: map(&mut ground),
        attention: map(&mut attention),
    };
    let mut times = gedepth_times::default();
    let mut statistics = gedepth_statistics::default();
    // SAFETY: all of it is this function's.
    unsafe {
        assert_eq!(gedepth_model_open_embedded(0, 2, &mut model), GEDEPTH_OK);
        let opened = gedepth_camera_open(model, &calibration, &options, &mut camera);
        assert_eq!(opened, GEDEPTH_OK);
        let (mut resident_before, mut allocations_before) = (0, ALLOCATIONS.load(SeqCst));
        for run in 0..10_000_usize {
            if run == 100 {
                // Reading it allocates.
                let before = ALLOCATIONS.load(SeqCst);
                assert_eq!(before, allocations_before, "in the first 100 pictures");
                resident_before = resident();
                allocations_before = ALLOCATIONS.load(SeqCst);
            }
            rgb[run % (3 * pixels)] = run as u8;
            let has_chroma = run % 3 == 0;
            let picture = gedepth_picture {
                bytes: rgb.as_ptr(),
                bytes_len: rgb.len(),
                // Padded or not, of two planes or one.
                stride: (run % 2) * 4 * W as usize,
                width: W - u32::from(run % 10 == 9),
                height: H,
                format: match has_chroma {
                    true => GEDEPTH_FORMAT_NV12,
                    false => GEDEPTH_FORMAT_RGB,
                },
                yuv: 0,
                chroma: if has_chroma { rgb.as_ptr() } else { null() },
                chroma_len: if has_chroma { rgb.len() } else { 0 },
                chroma_stride: 0,
            };
            // In time, late, and of the wrong size.
            let deadline_ns = u64::from(run % 10 == 8);
            let result = gedepth_camera_run(camera, &picture, &maps, deadline_ns, &mut times);
            let expected = match run % 10 {
                8 => GEDEPTH_DEADLINE,
                9 => GEDEPTH_PICTURE_SIZE,
                _ => GEDEPTH_OK,
            };
            assert_eq!(result, expected);
            // Another ground for half of the pictures: a vehicle pitches.
            let ground = gedepth_ground {
                down: [0.0, 1.0, f64::from(run as u32 / 2 % 2) / 50.0],
                height: 1.5,
            };
            assert_eq!(gedepth_camera_set_ground(camera, &ground), GEDEPTH_OK);
            if run % 100 == 0 {
                let read = gedepth_camera_statistics(camera, &mut statistics);
                assert_eq!(read, GEDEPTH_OK);
            }
        }
        assert_eq!(ALLOCATIONS.load(SeqCst) - allocations_before, 0);
        let grown = resident().saturating_sub(resident_before);
        assert!(grown <= 256 * 1024, "{grown} bytes");
        assert_eq!((statistics.runs, statistics.window), (8911, 1000));
        gedepth_camera_close(camera);
        gedepth_model_close(model);
    }
}
