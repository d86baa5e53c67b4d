//! What the C interface promises, through its exports.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;
use std::ffi::{CStr, CString};
use std::path::{Path, PathBuf};
use std::ptr::{null, null_mut};

use gedepth::{
    Calibration, Distortion, Estimator, Model, Numbers, OutputSize, Picture, PixelFormat, Plane,
    Yuv,
};
use gedepth_ffi::calibration::*;
use gedepth_ffi::camera::*;
use gedepth_ffi::ground::*;
use gedepth_ffi::model::*;
use gedepth_ffi::result::*;
use gedepth_ffi::statistics::gedepth_statistics;

const SIZE: (u32, u32) = (150, 60);
const NETWORK: (u32, u32) = (64, 32);
const PIXELS: usize = 150 * 60;

/// A camera 1.65 m over the ground, looking 2 degrees down.
fn calibration() -> gedepth_calibration {
    let (sin, cos) = 2.0_f64.to_radians().sin_cos();
    gedepth_calibration {
        width: SIZE.0,
        height: SIZE.1,
        distortion: GEDEPTH_PINHOLE,
        reserved: 0,
        fx: 90.0,
        fy: 91.0,
        cx: 74.0,
        cy: 27.0,
        skew: 0.1,
        coefficients: [0.0; 8],
        r: [0.0, -1.0, 0.0, -sin, 0.0, -cos, cos, 0.0, -sin],
        t: [0.0; 3],
        plane_up: [0.0, 0.0, 2.0],
        // Metres, whatever the normal's length.
        plane_offset: -1.65,
    }
}

fn options(output: u32) -> gedepth_options {
    gedepth_options {
        network_width: NETWORK.0,
        network_height: NETWORK.1,
        output,
        ..Default::default()
    }
}

/// Bytes without pattern, but smooth enough for a network to see something.
fn noise(seed: u32) -> Vec<u8> {
    let mut state = seed;
    (0..3 * PIXELS)
        .map(|i| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((i / 450 * 3) as u8).wrapping_add((state >> 26) as u8)
        })
        .collect()
}

fn picture(rgb: &[u8]) -> gedepth_picture {
    gedepth_picture {
        bytes: rgb.as_ptr(),
        bytes_len: rgb.len(),
        stride: 0,
        width: SIZE.0,
        height: SIZE.1,
        format: GEDEPTH_FORMAT_RGB,
        yuv: 0,
        chroma: null(),
        chroma_len: 0,
        chroma_stride: 0,
    }
}

const NONE: gedepth_map = gedepth_map {
    values: null_mut(),
    values_len: 0,
    stride: 0,
};

fn map(values: &mut [f32], stride: usize) -> gedepth_map {
    gedepth_map {
        values: values.as_mut_ptr(),
        values_len: values.len(),
        stride,
    }
}

fn only_depth(depth: &mut [f32]) -> gedepth_maps {
    gedepth_maps {
        depth: map(depth, 0),
        ground: NONE,
        attention: NONE,
    }
}

fn last_error() -> String {
    // SAFETY: ends with a zero; copied before anything else fails.
    unsafe { CStr::from_ptr(gedepth_last_error()) }
        .to_str()
        .unwrap()
        .to_owned()
}

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures")
}

fn c_path(path: &Path) -> CString {
    CString::new(path.to_str().unwrap()).unwrap()
}

struct Handle(*mut gedepth_model);

impl Handle {
    fn embedded() -> Self {
        let mut model = null_mut();
        // SAFETY: `model` is this function's.
        let opened = unsafe { gedepth_model_open_embedded(GEDEPTH_KERNEL_BEST, 1, &mut model) };
        assert_eq!(opened, GEDEPTH_OK);
        Self(model)
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        // SAFETY: opened by the library, closed once.
        unsafe { gedepth_model_close(self.0) }
    }
}

struct Camera(*mut gedepth_camera);

// SAFETY: the library's promise, which these tests are of.
unsafe impl Send for Camera {}

impl Camera {
    fn open(
        model: &Handle,
        calibration: &gedepth_calibration,
        options: &gedepth_options,
    ) -> Result<Self, i32> {
        let mut camera = null_mut();
        // SAFETY: all of it is the caller's.
        match unsafe { gedepth_camera_open(model.0, calibration, options, &mut camera) } {
            GEDEPTH_OK => Ok(Self(camera)),
            result => {
                assert!(camera.is_null());
                Err(result)
            }
        }
    }

    fn usual() -> Self {
        Self::open(&Handle::embedded(), &calibration(), &options(0)).unwrap()
    }

    fn run(&self, picture: &gedepth_picture, maps: &gedepth_maps, deadline_ns: u64) -> i32 {
        // SAFETY: all of it is the caller's.
        unsafe { gedepth_camera_run(self.0, picture, maps, deadline_ns, null_mut()) }
    }

    fn depth(&self, rgb: &[u8]) -> Vec<f32> {
        let mut depth = vec![-1.0; PIXELS];
        let result = self.run(&picture(rgb), &only_depth(&mut depth), 0);
        assert_eq!(result, GEDEPTH_OK, "{}", last_error());
        depth
    }

    fn statistics(&self) -> gedepth_statistics {
        let mut statistics = gedepth_statistics::default();
        // SAFETY: `statistics` is this function's.
        let result = unsafe { gedepth_camera_statistics(self.0, &mut statistics) };
        assert_eq!(result, GEDEPTH_OK);
        statistics
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        // SAFETY: opened by the library, closed once.
        unsafe { gedepth_camera_close(self.0) }
    }
}

/// The Rust interface's, of the same camera.
fn estimator(model: &Model, output: OutputSize) -> Estimator {
    let c = calibration();
    let numbers = Numbers {
        size: Some(SIZE),
        k: [[c.fx, c.skew, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]],
        distortion: Distortion::None,
        r: [
            [c.r[0], c.r[1], c.r[2]],
            [c.r[3], c.r[4], c.r[5]],
            [c.r[6], c.r[7], c.r[8]],
        ],
        t: c.t,
        up: c.plane_up,
        offset: c.plane_offset,
    };
    let calibration = Calibration::new(Path::new("numbers"), &numbers).unwrap();
    Estimator::new(model, &calibration, SIZE, Some(NETWORK), output).unwrap()
}

/// Depth, ground and attention by way of the Rust interface.
fn expected(rgb: &[u8], output: OutputSize) -> [Vec<f32>; 3] {
    let mut estimator = estimator(&Model::embedded().unwrap(), output);
    estimator.run(Picture::new(SIZE, rgb).unwrap()).unwrap();
    let maps = estimator.maps().unwrap();
    [
        maps.depth.to_vec(),
        maps.ground.to_vec(),
        maps.attention.unwrap().to_vec(),
    ]
}

/// Held: never changed, never used again.
#[test]
fn numbers_of_the_interface() {
    let numbers = [
        (GEDEPTH_OK, 0),
        (GEDEPTH_NULL_POINTER, 1),
        (GEDEPTH_MISALIGNED, 2),
        (GEDEPTH_OVERLAP, 3),
        (GEDEPTH_TOO_LONG, 4),
        (GEDEPTH_UNKNOWN_CHOICE, 7),
        (GEDEPTH_UNUSED_NOT_ZERO, 8),
        (GEDEPTH_DEADLINE, 30),
        (GEDEPTH_KERNEL_NOT_SUPPORTED, 31),
        (GEDEPTH_THREADS, 32),
        (GEDEPTH_NO_ATTENTION, 33),
        (GEDEPTH_BUSY, 34),
        (GEDEPTH_PANICKED, 35),
        (GEDEPTH_PICTURE_LENGTH, 36),
        (GEDEPTH_PATH, 37),
        (GEDEPTH_STATISTICS_LENGTH, 38),
        (GEDEPTH_IMAGE_SIZE, 101),
        (GEDEPTH_FOCAL_LENGTH, 102),
        (GEDEPTH_PRINCIPAL_POINT, 103),
        (GEDEPTH_SKEW, 104),
        (GEDEPTH_INTRINSIC_MATRIX, 105),
        (GEDEPTH_DISTORTION_COEFFICIENT, 106),
        (GEDEPTH_DIRECTION_WITHOUT_LENGTH, 201),
        (GEDEPTH_NOT_A_ROTATION, 202),
        (GEDEPTH_REFLECTION, 203),
        (GEDEPTH_TRANSLATION, 204),
        (GEDEPTH_ANGLE_NOT_FINITE, 205),
        (GEDEPTH_PLANE_OFFSET, 301),
        (GEDEPTH_CAMERA_NOT_ABOVE_GROUND, 302),
        (GEDEPTH_OUTPUT_LENGTH, 607),
        (GEDEPTH_PICTURE_SIZE, 803),
        (GEDEPTH_PICTURE_UNFIT, 804),
        (GEDEPTH_NETWORK_SIZE, 805),
        (GEDEPTH_CORES, 806),
        (GEDEPTH_CALIBRATION_READ, 821),
        (GEDEPTH_CALIBRATION_FORMAT, 822),
        (GEDEPTH_MODEL_READ, 841),
        (GEDEPTH_CONTRACT, 842),
        (GEDEPTH_MODEL, 843),
    ];
    for (constant, number) in numbers {
        assert_eq!(constant, number);
    }
    assert_eq!(all().collect::<Vec<_>>(), numbers.map(|(_, number)| number));
    // SAFETY: texts are static and end with a zero.
    let text = |result| unsafe { CStr::from_ptr(gedepth_result_text(result)) };
    let texts: BTreeSet<_> = all().map(text).collect();
    assert_eq!(texts.len(), numbers.len());
    assert!(!texts.contains(c"unknown result"));
    assert_eq!(text(-1), c"unknown result");
}

/// The sizes that the header checks on the side of C.
#[test]
fn layouts_of_the_interface() {
    let pointers = size_of::<usize>();
    let sizes = [
        (size_of::<gedepth_calibration>(), 248),
        (size_of::<gedepth_ground>(), 32),
        (size_of::<gedepth_options>(), 32),
        (size_of::<gedepth_shape>(), 48),
        (size_of::<gedepth_picture>(), 6 * pointers + 16),
        (size_of::<gedepth_maps>(), 9 * pointers),
        (size_of::<gedepth_plausibility>(), 16),
        (size_of::<gedepth_times>(), 40),
        (size_of::<gedepth_statistics>(), 144),
    ];
    for (size, expected) in sizes {
        assert_eq!(size, expected);
    }
    assert_eq!(gedepth_ffi::gedepth_abi_version(), 1);
}

#[test]
fn maps_are_those_of_the_rust_interface_with_any_strides() {
    let rgb = noise(1);
    for (output, size) in [
        (GEDEPTH_OUTPUT_PICTURE, SIZE),
        (GEDEPTH_OUTPUT_NETWORK, NETWORK),
    ] {
        let camera = Camera::open(&Handle::embedded(), &calibration(), &options(output)).unwrap();
        let mut shape = gedepth_shape::default();
        // SAFETY: `shape` is this function's.
        let result = unsafe { gedepth_camera_shape(camera.0, &mut shape) };
        assert_eq!(result, GEDEPTH_OK);
        assert_eq!((shape.map_width, shape.map_height), size);
        assert_eq!((shape.picture_width, shape.picture_height), SIZE);
        assert_eq!((shape.network_width, shape.network_height), NETWORK);
        assert_eq!(shape.has_attention, 1);
        let expected = expected(
            &rgb,
            match output {
                GEDEPTH_OUTPUT_PICTURE => OutputSize::Picture,
                _ => OutputSize::Network,
            },
        );
        let (width, height) = (size.0 as usize, size.1 as usize);
        for padding in [0, 7] {
            // The last row ends with its last pixel, in the picture and in the maps.
            let row = 3 * SIZE.0 as usize;
            let padded: Vec<u8> = rgb
                .chunks(row)
                .flat_map(|row| row.iter().copied().chain(vec![77; padding]))
                .collect();
            let padded = &padded[..padded.len() - padding];
            let strided = gedepth_picture {
                stride: row + padding,
                ..picture(padded)
            };
            let stride = width + padding;
            let mut maps = [(); 3].map(|()| vec![-7.0_f32; stride * (height - 1) + width]);
            let [depth, ground, attention] = &mut maps;
            let into = gedepth_maps {
                depth: map(depth, stride),
                ground: map(ground, stride),
                attention: map(attention, stride),
            };
            assert_eq!(
                camera.run(&strided, &into, 0),
                GEDEPTH_OK,
                "{}",
                last_error()
            );
            for (map, expected) in maps.iter().zip(&expected) {
                for (row, expected) in map.chunks(stride).zip(expected.chunks(width)) {
                    assert_eq!(&row[..width], expected);
                    assert!(row[width..].iter().all(|&value| value == -7.0));
                }
            }
        }
    }
}

/// Every format and meaning of luma and chroma, padded, is what the Rust interface takes for it.
#[test]
fn pictures_of_every_format_are_those_of_the_rust_interface() {
    let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
    let bytes = [noise(11), noise(12)].concat();
    let stride = 4 * width + 3;
    let (first, second) = bytes.split_at(stride * height);
    let camera = Camera::usual();
    let model = Model::embedded().unwrap();
    let mut estimator = estimator(&model, OutputSize::Picture);
    let yuvs = [
        (GEDEPTH_YUV_BT601_LIMITED, Yuv::Bt601Limited),
        (GEDEPTH_YUV_BT601_FULL, Yuv::Bt601Full),
        (GEDEPTH_YUV_BT709_LIMITED, Yuv::Bt709Limited),
        (GEDEPTH_YUV_BT709_FULL, Yuv::Bt709Full),
    ];
    let mut formats = vec![
        (GEDEPTH_FORMAT_RGB, 0, PixelFormat::Rgb),
        (GEDEPTH_FORMAT_BGR, 0, PixelFormat::Bgr),
        (GEDEPTH_FORMAT_RGBX, 0, PixelFormat::Rgbx),
        (GEDEPTH_FORMAT_BGRX, 0, PixelFormat::Bgrx),
        (GEDEPTH_FORMAT_GREY, 0, PixelFormat::Grey),
    ];
    for (number, yuv) in yuvs {
        formats.extend([
            (GEDEPTH_FORMAT_YUYV, number, PixelFormat::Yuyv(yuv)),
            (GEDEPTH_FORMAT_UYVY, number, PixelFormat::Uyvy(yuv)),
            (GEDEPTH_FORMAT_NV12, number, PixelFormat::Nv12(yuv)),
        ]);
    }
    let mut depths: Vec<Vec<f32>> = Vec::new();
    for (number, yuv, format) in formats {
        let has_chroma = number == GEDEPTH_FORMAT_NV12;
        let mut planes = vec![Plane {
            bytes: first,
            stride,
        }];
        let mut picture = gedepth_picture {
            stride,
            format: number,
            yuv,
            ..picture(first)
        };
        if has_chroma {
            // Padded but for the first, where 0 says that it is not; the last row always ends with its last pair.
            let row = width.next_multiple_of(2);
            picture.chroma_stride = [0, row + 5][usize::from(yuv > 0)];
            let stride = row.max(picture.chroma_stride);
            planes.push(Plane {
                bytes: second,
                stride,
            });
            picture.chroma = second.as_ptr();
            picture.chroma_len = stride * (height.div_ceil(2) - 1) + row;
        }
        let own = Picture::with_format(SIZE, format, &planes).unwrap();
        let mut depth = vec![0.0; PIXELS];
        let result = camera.run(&picture, &only_depth(&mut depth), 0);
        assert_eq!(result, GEDEPTH_OK, "{format:?}: {}", last_error());
        assert!(depth == estimator.run(own).unwrap().depth, "{format:?}");
        assert!(!depths.contains(&depth), "{format:?} is as one before");
        depths.push(depth);
    }
}

#[test]
fn what_cannot_be_done_is_refused_by_number_and_nothing_is_written() {
    let camera = Camera::usual();
    let rgb = noise(2);
    let mut depth = vec![-1.0; PIXELS + 8];
    let mut ground = vec![-1.0; PIXELS];
    let good = picture(&rgb);
    let depth_map = map(&mut depth, 0);
    let ground_map = map(&mut ground, 0);
    let maps = |depth, ground| gedepth_maps {
        depth,
        ground,
        attention: NONE,
    };
    let row = 3 * SIZE.0 as usize;
    let nv12 = gedepth_picture {
        format: GEDEPTH_FORMAT_NV12,
        chroma: rgb[PIXELS..].as_ptr(),
        chroma_len: (SIZE.0.div_ceil(2) * 2 * SIZE.1.div_ceil(2)) as usize,
        ..good
    };
    let inside = |by: usize| gedepth_map {
        values: depth_map.values.wrapping_add(by),
        values_len: PIXELS,
        stride: 0,
    };
    let pictures = [
        (
            gedepth_picture {
                bytes: null(),
                ..good
            },
            GEDEPTH_NULL_POINTER,
        ),
        (
            gedepth_picture {
                bytes_len: usize::MAX,
                ..good
            },
            GEDEPTH_TOO_LONG,
        ),
        (
            gedepth_picture {
                bytes_len: rgb.len() - 1,
                ..good
            },
            GEDEPTH_PICTURE_LENGTH,
        ),
        (
            gedepth_picture {
                stride: row - 1,
                ..good
            },
            GEDEPTH_PICTURE_LENGTH,
        ),
        (
            gedepth_picture {
                stride: row + 1,
                ..good
            },
            GEDEPTH_PICTURE_LENGTH,
        ),
        (
            gedepth_picture {
                stride: usize::MAX,
                ..good
            },
            GEDEPTH_PICTURE_LENGTH,
        ),
        (gedepth_picture { width: 0, ..good }, GEDEPTH_PICTURE_SIZE),
        (
            gedepth_picture {
                width: SIZE.1,
                height: SIZE.0,
                ..good
            },
            GEDEPTH_PICTURE_SIZE,
        ),
        (
            gedepth_picture {
                bytes: depth_map.values.cast(),
                ..good
            },
            GEDEPTH_OVERLAP,
        ),
        (
            gedepth_picture { format: 8, ..good },
            GEDEPTH_UNKNOWN_CHOICE,
        ),
        (gedepth_picture { yuv: 4, ..nv12 }, GEDEPTH_UNKNOWN_CHOICE),
        (gedepth_picture { yuv: 1, ..good }, GEDEPTH_UNUSED_NOT_ZERO),
        (
            gedepth_picture {
                format: GEDEPTH_FORMAT_YUYV,
                ..nv12
            },
            GEDEPTH_UNUSED_NOT_ZERO,
        ),
        (
            gedepth_picture {
                chroma_stride: 1,
                ..good
            },
            GEDEPTH_UNUSED_NOT_ZERO,
        ),
        (
            gedepth_picture {
                chroma: null(),
                ..nv12
            },
            GEDEPTH_NULL_POINTER,
        ),
        (
            gedepth_picture {
                chroma_len: nv12.chroma_len - 1,
                ..nv12
            },
            GEDEPTH_PICTURE_LENGTH,
        ),
        (
            gedepth_picture {
                chroma_stride: SIZE.0 as usize - 1,
                ..nv12
            },
            GEDEPTH_PICTURE_LENGTH,
        ),
        (
            gedepth_picture {
                chroma: depth_map.values.cast(),
                ..nv12
            },
            GEDEPTH_OVERLAP,
        ),
    ];
    for (picture, result) in pictures {
        assert_eq!(
            camera.run(&picture, &maps(depth_map, ground_map), 0),
            result
        );
    }
    let outputs = [
        (
            maps(
                depth_map,
                gedepth_map {
                    values_len: PIXELS,
                    ..NONE
                },
            ),
            GEDEPTH_NULL_POINTER,
        ),
        (
            maps(
                gedepth_map {
                    values_len: PIXELS - 1,
                    ..depth_map
                },
                NONE,
            ),
            GEDEPTH_OUTPUT_LENGTH,
        ),
        (
            maps(
                gedepth_map {
                    stride: SIZE.0 as usize - 1,
                    ..depth_map
                },
                NONE,
            ),
            GEDEPTH_OUTPUT_LENGTH,
        ),
        (
            maps(
                gedepth_map {
                    stride: usize::MAX / 2,
                    ..depth_map
                },
                NONE,
            ),
            GEDEPTH_OUTPUT_LENGTH,
        ),
        (
            maps(
                gedepth_map {
                    values: depth_map.values.wrapping_byte_add(2),
                    ..depth_map
                },
                NONE,
            ),
            GEDEPTH_MISALIGNED,
        ),
        (
            maps(
                gedepth_map {
                    values_len: usize::MAX / 4,
                    ..depth_map
                },
                NONE,
            ),
            GEDEPTH_TOO_LONG,
        ),
        (maps(inside(0), inside(0)), GEDEPTH_OVERLAP),
        (maps(inside(8), inside(0)), GEDEPTH_OVERLAP),
    ];
    for (maps, result) in outputs {
        assert_eq!(camera.run(&good, &maps, 0), result);
    }
    // SAFETY: what is not null is this function's.
    unsafe {
        let good_maps = maps(depth_map, ground_map);
        let run = gedepth_camera_run;
        for result in [
            run(null_mut(), &good, &good_maps, 0, null_mut()),
            run(camera.0, null(), &good_maps, 0, null_mut()),
            run(camera.0, &good, null(), 0, null_mut()),
            gedepth_camera_shape(camera.0, null_mut()),
            gedepth_camera_shape(null(), null_mut()),
            gedepth_camera_statistics(camera.0, null_mut()),
            gedepth_camera_plausibility(camera.0, null_mut()),
            gedepth_camera_open(null(), &calibration(), null(), null_mut()),
            gedepth_calibration_read(null(), null_mut()),
            gedepth_model_open_embedded(0, 0, null_mut()),
            gedepth_model_open_file(null(), 0, 0, null_mut()),
            gedepth_model_open_memory(null(), 8, 0, 0, null_mut()),
        ] {
            assert_eq!(result, GEDEPTH_NULL_POINTER);
        }
        let in_depth = depth_map.values.cast::<gedepth_times>();
        assert_eq!(
            run(
                camera.0,
                &good,
                &good_maps,
                0,
                in_depth.wrapping_byte_add(4)
            ),
            GEDEPTH_MISALIGNED
        );
        // The call's own structs, as in a union.
        let mut maps_or_times = [good_maps; 2];
        let times = maps_or_times.as_mut_ptr();
        assert_eq!(
            run(camera.0, &good, times.cast_const(), 0, times.cast()),
            GEDEPTH_OVERLAP
        );
        let model = Handle::embedded();
        let mut numbers = [calibration(); 2];
        let place = numbers.as_mut_ptr();
        assert_eq!(
            gedepth_camera_open(model.0, place.cast_const(), null(), place.cast()),
            GEDEPTH_OVERLAP
        );
        assert_eq!(numbers[0].width, calibration().width);
        // No handle: nothing to close.
        gedepth_camera_close(null_mut());
        gedepth_model_close(null_mut());
    }
    assert!(depth.iter().chain(&ground).all(|&value| value == -1.0));
    assert_eq!(camera.statistics().runs, 0);
    // And the camera is as good as ever.
    assert_eq!(camera.depth(&rgb), expected(&rgb, OutputSize::Picture)[0]);
}

#[test]
fn a_late_run_says_so_gives_its_depth_and_leaves_the_next_sound() {
    let camera = Camera::usual();
    let [one, other] = [noise(3), noise(4)];
    let [first, second] = [&one, &other].map(|rgb| camera.depth(rgb));
    assert_ne!(first, second);
    let mut depth = vec![-1.0; PIXELS];
    let mut times = gedepth_times::default();
    // SAFETY: all of it is this function's.
    let late = unsafe {
        let maps = only_depth(&mut depth);
        gedepth_camera_run(camera.0, &picture(&one), &maps, 1, &mut times)
    };
    assert_eq!(late, GEDEPTH_DEADLINE);
    assert!(last_error().contains("its deadline was 1 ns"));
    assert_eq!(depth, first);
    let stages = times.preprocess_ns + times.network_ns + times.fusion_ns + times.copy_ns;
    assert_eq!(stages, times.total_ns);
    let in_time = camera.run(&picture(&other), &only_depth(&mut depth), u64::MAX);
    assert_eq!(in_time, GEDEPTH_OK);
    assert_eq!(depth, second);
    let statistics = camera.statistics();
    assert_eq!(
        (statistics.runs, statistics.late, statistics.window),
        (4, 1, 4)
    );
    assert!(statistics.total.max_ns >= times.total_ns);
    assert!(statistics.total.p50_ns <= statistics.total.p99_ns);
}

#[test]
fn plausibility_is_that_of_the_maps_against_the_flat_ground() {
    let camera = Camera::usual();
    let rgb = noise(10);
    let [mut depth, mut attention] = [(); 2].map(|()| vec![-1.0; PIXELS]);
    let maps = gedepth_maps {
        depth: map(&mut depth, 0),
        ground: NONE,
        attention: map(&mut attention, 0),
    };
    assert_eq!(camera.run(&picture(&rgb), &maps, 0), GEDEPTH_OK);
    let mut seen = gedepth_plausibility::default();
    // SAFETY: `seen` is this function's.
    let result = unsafe { gedepth_camera_plausibility(camera.0, &mut seen) };
    assert_eq!(result, GEDEPTH_OK);

    // 1 / z of the ground from the camera's numbers alone: 1.65 m high, 2 degrees down.
    let c = calibration();
    let (sin, cos) = 2.0_f64.to_radians().sin_cos();
    let inverse = |index: usize| {
        let v = (index / SIZE.0 as usize) as f64;
        ((v - c.cy) / c.fy * cos + sin) / 1.65
    };
    let of = |what: &dyn Fn(f64) -> bool| (0..PIXELS).filter(|&i| what(inverse(i))).collect();
    let ground: Vec<usize> = of(&|inverse| inverse >= 1.0 / 80.0);
    let line: Vec<usize> = of(&|inverse| inverse.abs() < 1.0 / 80.0);
    let trusted = || ground.iter().copied().filter(|&i| attention[i] >= 0.5);
    let close = |seen: f32, sum: f64, count: usize| {
        let expected = if count == 0 { -1.0 } else { sum / count as f64 };
        assert!(
            (f64::from(seen) - expected).abs() < 1e-4,
            "{seen} {expected}"
        );
    };
    assert!(!ground.is_empty() && !line.is_empty());
    close(seen.ground_share, ground.len() as f64, PIXELS);
    close(seen.trusted_share, trusted().count() as f64, ground.len());
    let attentions = line.iter().map(|&i| f64::from(attention[i])).sum();
    close(seen.attention_at_line, attentions, line.len());
    let residuals = trusted().map(|i| (f64::from(depth[i]) * inverse(i) - 1.0).abs());
    close(seen.ground_residual, residuals.sum(), trusted().count());
}

#[test]
fn cameras_on_two_threads_do_not_meet() {
    let rgb = [noise(5), noise(6)];
    let model = Handle::embedded();
    let cameras = [0, 1].map(|_| Camera::open(&model, &calibration(), &options(0)).unwrap());
    // Cameras need no model any more.
    drop(model);
    let alone = [0, 1].map(|i| cameras[i].depth(&rgb[i]));
    std::thread::scope(|scope| {
        for ((camera, rgb), alone) in cameras.into_iter().zip(&rgb).zip(&alone) {
            scope.spawn(move || {
                let camera = camera;
                for _ in 0..200 {
                    assert_eq!(&camera.depth(rgb), alone);
                }
            });
        }
    });
}

#[test]
fn models_come_from_files_and_memory_and_bad_ones_by_number() {
    let mut model = null_mut();
    let path = fixtures().join("models/baseline-int8.onnx");
    let bytes = std::fs::read(&path).unwrap();
    let rgb = noise(7);
    let mut depths = Vec::new();
    let (file, text, missing) = (
        c_path(&path),
        c_path(&fixtures().join("README.md")),
        c_path(&fixtures().join("no-such.onnx")),
    );
    // SAFETY: all of it is this function's.
    unsafe {
        for memory in [false, true] {
            let opened = match memory {
                false => gedepth_model_open_file(file.as_ptr(), 0, 1, &mut model),
                true => gedepth_model_open_memory(bytes.as_ptr(), bytes.len(), 0, 1, &mut model),
            };
            assert_eq!(opened, GEDEPTH_OK);
            let handle = Handle(model);
            let camera = Camera::open(&handle, &calibration(), &options(0)).unwrap();
            depths.push(camera.depth(&rgb));
            let mut attention = vec![0.0; PIXELS];
            let maps = gedepth_maps {
                depth: NONE,
                ground: NONE,
                attention: map(&mut attention, 0),
            };
            assert_eq!(camera.run(&picture(&rgb), &maps, 0), GEDEPTH_NO_ATTENTION);
        }
        assert_eq!(depths[0], depths[1]);

        model = null_mut();
        for (opened, result) in [
            (
                gedepth_model_open_file(text.as_ptr(), 0, 0, &mut model),
                GEDEPTH_MODEL,
            ),
            (
                gedepth_model_open_file(missing.as_ptr(), 0, 0, &mut model),
                GEDEPTH_MODEL_READ,
            ),
            (
                gedepth_model_open_memory(bytes.as_ptr(), bytes.len() / 2, 0, 0, &mut model),
                GEDEPTH_MODEL,
            ),
            (
                gedepth_model_open_embedded(99, 0, &mut model),
                GEDEPTH_UNKNOWN_CHOICE,
            ),
            (
                gedepth_model_open_embedded(0, 65, &mut model),
                GEDEPTH_THREADS,
            ),
        ] {
            assert_eq!(opened, result, "{}", last_error());
        }
        let other_processors = match cfg!(target_arch = "x86_64") {
            true => GEDEPTH_KERNEL_NEON,
            false => GEDEPTH_KERNEL_AVX2,
        };
        assert_eq!(
            gedepth_model_open_embedded(other_processors, 0, &mut model),
            GEDEPTH_KERNEL_NOT_SUPPORTED
        );
        assert!(model.is_null());
    }
}

#[test]
fn kernels_and_threads_do_not_change_the_depth() {
    let rgb = noise(8);
    let best = Camera::usual().depth(&rgb);
    let mut ran = 0;
    for kernel in GEDEPTH_KERNEL_PORTABLE..=GEDEPTH_KERNEL_NEON_I8MM {
        let mut model = null_mut();
        // SAFETY: `model` is this function's.
        match unsafe { gedepth_model_open_embedded(kernel, 3, &mut model) } {
            GEDEPTH_OK => {
                let model = Handle(model);
                let camera = Camera::open(&model, &calibration(), &options(0)).unwrap();
                assert_eq!(camera.depth(&rgb), best, "kernel {kernel}");
                ran += 1;
            }
            result => assert_eq!(result, GEDEPTH_KERNEL_NOT_SUPPORTED),
        }
    }
    assert!(ran >= 2);
}

#[test]
fn calibration_files_give_their_numbers() {
    let path = fixtures().join("scenes/street/calibration.json");
    let numbers = Numbers::read(&path).unwrap();
    let mut read = gedepth_calibration {
        reserved: 9,
        ..calibration()
    };
    // SAFETY: all of it is this function's.
    unsafe {
        let result = gedepth_calibration_read(c_path(&path).as_ptr(), &mut read);
        assert_eq!(result, GEDEPTH_OK);
        assert_eq!(Some((read.width, read.height)), numbers.size);
        assert_eq!((read.distortion, read.reserved), (GEDEPTH_PINHOLE, 0));
        let k = [
            [read.fx, read.skew, read.cx],
            [0.0, read.fy, read.cy],
            [0.0, 0.0, 1.0],
        ];
        assert_eq!(k, numbers.k);
        assert_eq!(read.r.as_slice(), numbers.r.as_flattened());
        assert_eq!((read.t, read.plane_up), (numbers.t, numbers.up));
        assert_eq!(read.plane_offset, numbers.offset);

        let before = read.fx;
        for (path, result) in [
            ("no-such.json", GEDEPTH_CALIBRATION_READ),
            ("README.md", GEDEPTH_CALIBRATION_FORMAT),
        ] {
            let path = c_path(&fixtures().join(path));
            assert_eq!(gedepth_calibration_read(path.as_ptr(), &mut read), result);
        }
        assert_eq!(read.fx, before);
    }
}

/// The numbers of a calibration, to be changed one by one.
fn number(calibration: &mut gedepth_calibration, index: usize) -> Option<&mut f64> {
    let c = calibration;
    [&mut c.fx, &mut c.fy, &mut c.cx, &mut c.cy, &mut c.skew]
        .into_iter()
        .chain(&mut c.coefficients)
        .chain(&mut c.r)
        .chain(&mut c.t)
        .chain(&mut c.plane_up)
        .chain([&mut c.plane_offset])
        .nth(index)
}

#[test]
fn every_poisoned_number_is_refused_by_a_known_result_or_gives_finite_depth() {
    let model = Handle::embedded();
    let tiny = gedepth_options {
        network_width: 32,
        network_height: 32,
        output: GEDEPTH_OUTPUT_NETWORK,
        ..Default::default()
    };
    let known: BTreeSet<i32> = all().collect();
    let rgb = noise(9);
    let try_it = |poisoned: &gedepth_calibration| match Camera::open(&model, poisoned, &tiny) {
        Err(result) => {
            assert!(known.contains(&result), "{result}: {poisoned:?}");
            assert!(!last_error().is_empty());
            false
        }
        Ok(camera) => {
            let mut depth = [-1.0; 32 * 32];
            let picture = gedepth_picture {
                width: poisoned.width,
                height: poisoned.height,
                ..picture(&rgb)
            };
            let result = camera.run(&picture, &only_depth(&mut depth), 0);
            if result != GEDEPTH_PICTURE_LENGTH {
                assert_eq!(result, GEDEPTH_OK, "{}", last_error());
                assert!(depth.iter().all(|z| z.is_finite() && *z > 0.0));
            }
            true
        }
    };
    let lenses = [
        (GEDEPTH_PINHOLE, [0.0; 8]),
        (
            GEDEPTH_BROWN_CONRADY,
            [-0.3, 0.1, 1e-3, -1e-3, -0.01, 0.01, 0.0, 0.0],
        ),
        (
            GEDEPTH_KANNALA_BRANDT,
            [-0.01, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        ),
    ];
    for (distortion, coefficients) in lenses {
        let good = gedepth_calibration {
            distortion,
            coefficients,
            ..calibration()
        };
        assert!(try_it(&good), "{}", last_error());
        let mut index = 0;
        while number(&mut good.clone(), index).is_some() {
            let poisons = [
                f64::NAN,
                f64::INFINITY,
                f64::NEG_INFINITY,
                0.0,
                -1.0,
                5e-324,
                1e300,
                -1e9,
            ];
            for poison in poisons {
                let mut poisoned = good;
                if let Some(number) = number(&mut poisoned, index) {
                    *number = poison;
                }
                let opened = try_it(&poisoned);
                assert!(!opened || poison.is_finite(), "{poisoned:?}");
            }
            index += 1;
        }
        assert_eq!(index, 29);
    }
    for word in [0, 1, 2, 4, 31, 32, 33, 16384, 16385, 65536, u32::MAX] {
        let good = calibration();
        // Wide and flat, so that the greatest of them fit in memory.
        for poisoned in [
            gedepth_calibration {
                width: word,
                height: 1,
                ..good
            },
            gedepth_calibration {
                width: 1,
                height: word,
                ..good
            },
            gedepth_calibration {
                distortion: word,
                ..good
            },
            gedepth_calibration {
                reserved: word,
                ..good
            },
        ] {
            try_it(&poisoned);
        }
    }
    let options = [
        (
            gedepth_options { output: 2, ..tiny },
            GEDEPTH_UNKNOWN_CHOICE,
        ),
        (
            gedepth_options {
                statistics_runs: u32::MAX,
                ..tiny
            },
            GEDEPTH_STATISTICS_LENGTH,
        ),
        (
            gedepth_options {
                reserved: [0, 0, 0, 1],
                ..tiny
            },
            GEDEPTH_UNUSED_NOT_ZERO,
        ),
        (
            gedepth_options {
                network_width: 33,
                ..tiny
            },
            GEDEPTH_NETWORK_SIZE,
        ),
        (
            gedepth_options {
                network_height: 0,
                ..tiny
            },
            GEDEPTH_NETWORK_SIZE,
        ),
    ];
    for (options, result) in options {
        let opened = Camera::open(&model, &calibration(), &options);
        assert_eq!(opened.err(), Some(result));
    }
}

/// In a thread of its own, which stays where it is put.
#[test]
fn threads_stay_on_cores_that_there_are() {
    let camera = Camera::usual();
    let rgb = noise(4);
    let before = camera.depth(&rgb);
    let pin = |cores: &[u32]| {
        // SAFETY: `cores` is the caller's.
        unsafe { gedepth_camera_pin(camera.0, cores.as_ptr(), cores.len()) }
    };
    assert_eq!(pin(&[0, 0]), GEDEPTH_OK, "{}", last_error());
    if let Ok(status) = std::fs::read_to_string("/proc/thread-self/status") {
        let allowed = status
            .lines()
            .find(|line| line.starts_with("Cpus_allowed_list"));
        assert!(
            allowed.is_none_or(|list| list.ends_with("\t0")),
            "{allowed:?}"
        );
    }
    assert!(camera.depth(&rgb) == before);
    for cores in [&[1023][..], &[u32::MAX], &[]] {
        assert_eq!(pin(cores), GEDEPTH_CORES, "{cores:?}");
        assert!(
            last_error().contains(&format!("{cores:?}")),
            "{}",
            last_error()
        );
    }
    // SAFETY: nulls are refused.
    unsafe {
        assert_eq!(
            gedepth_camera_pin(null_mut(), [0].as_ptr(), 1),
            GEDEPTH_NULL_POINTER
        );
        assert_eq!(
            gedepth_camera_pin(camera.0, null(), 1),
            GEDEPTH_NULL_POINTER
        );
    }
}

fn ground_of(calibration: &gedepth_calibration) -> gedepth_ground {
    let mut ground = gedepth_ground::default();
    // SAFETY: both are the caller's or this function's.
    let result = unsafe { gedepth_ground_of_calibration(calibration, &mut ground) };
    assert_eq!(result, GEDEPTH_OK, "{}", last_error());
    ground
}

impl Camera {
    fn ground(&self) -> gedepth_ground {
        let mut ground = gedepth_ground::default();
        // SAFETY: `ground` is this function's.
        let result = unsafe { gedepth_camera_ground(self.0, &mut ground) };
        assert_eq!(result, GEDEPTH_OK);
        ground
    }

    fn set_ground(&self, ground: &gedepth_ground) -> i32 {
        // SAFETY: `ground` is the caller's.
        unsafe { gedepth_camera_set_ground(self.0, ground) }
    }
}

/// The vehicle pitches: the open camera is then the one that would have been opened, and the first one again when it is back.
#[test]
fn a_camera_over_another_ground_is_one_opened_with_it() {
    let first = calibration();
    // The road falls away to the right and ahead, and the camera is 5 cm nearer to it.
    let then = gedepth_calibration {
        plane_up: [0.02, 0.01, 1.0],
        plane_offset: -1.6,
        ..first
    };
    let rgb = noise(4);
    let camera = Camera::open(&Handle::embedded(), &first, &options(0)).unwrap();
    let opened = Camera::open(&Handle::embedded(), &then, &options(0)).unwrap();
    let before = camera.depth(&rgb);
    assert_eq!(camera.ground(), ground_of(&first));
    assert_eq!(camera.set_ground(&ground_of(&then)), GEDEPTH_OK);
    let after = camera.depth(&rgb);
    assert!(after == opened.depth(&rgb));
    assert!(after != before);
    // A direction of any length.
    let mut ground = ground_of(&first);
    ground.down = ground.down.map(|x| 4.0 * x);
    assert_eq!(camera.set_ground(&ground), GEDEPTH_OK);
    assert!(camera.depth(&rgb) == before);
}

/// Against trigonometry: 1.65 m over the ground, looking 2 degrees down, the right side 3 degrees lower.
#[test]
fn a_mounting_is_the_ground_that_the_header_says() {
    let [pitch, roll] = [2.0_f64, 3.0].map(f64::to_radians);
    let mut ground = gedepth_ground::default();
    // SAFETY: `ground` is this function's.
    let mounted = |height, pitch, roll, ground: &mut gedepth_ground| unsafe {
        gedepth_ground_of_mounting(height, pitch, roll, ground)
    };
    assert_eq!(mounted(1.65, pitch, roll, &mut ground), GEDEPTH_OK);
    // Looking down, the ground comes towards the axis of view; with the right side low, it is to the right.
    let down = [
        pitch.cos() * roll.sin(),
        pitch.cos() * roll.cos(),
        pitch.sin(),
    ];
    for (is, expected) in ground.down.into_iter().zip(down) {
        assert!((is - expected).abs() < 1e-15, "{ground:?}, {down:?}");
    }
    assert_eq!(ground.height, 1.65);
    mounted(1.65, pitch, 0.0, &mut ground);
    let of_file = ground_of(&calibration());
    for (is, expected) in ground.down.into_iter().zip(of_file.down) {
        assert!((is - expected).abs() < 1e-15, "{ground:?}, {of_file:?}");
    }

    let before = ground;
    for (height, pitch, result) in [
        (0.0, 0.0, GEDEPTH_CAMERA_NOT_ABOVE_GROUND),
        (f64::NAN, 0.0, GEDEPTH_CAMERA_NOT_ABOVE_GROUND),
        (1.65, f64::INFINITY, GEDEPTH_ANGLE_NOT_FINITE),
    ] {
        assert_eq!(mounted(height, pitch, 0.0, &mut ground), result);
        assert_eq!(ground, before);
    }
}

#[test]
fn grounds_that_are_none_are_refused_and_change_nothing() {
    let camera = Camera::usual();
    let rgb = noise(5);
    let (before, good) = (camera.depth(&rgb), camera.ground());
    let [x, y, z] = good.down;
    for (down, height, result) in [
        ([0.0; 3], 1.5, GEDEPTH_DIRECTION_WITHOUT_LENGTH),
        ([x, f64::NAN, z], 1.5, GEDEPTH_DIRECTION_WITHOUT_LENGTH),
        ([x, y, z], -1.5, GEDEPTH_CAMERA_NOT_ABOVE_GROUND),
        ([x, y, z], 1e6, GEDEPTH_CAMERA_NOT_ABOVE_GROUND),
        ([x, y, z], f64::NAN, GEDEPTH_CAMERA_NOT_ABOVE_GROUND),
    ] {
        assert_eq!(camera.set_ground(&gedepth_ground { down, height }), result);
    }
    let mut calibration = calibration();
    calibration.r[0] = 2.0;
    let mut ground = good;
    let overlapping: *const gedepth_calibration = &calibration;
    // SAFETY: all of it is this function's; what overlaps is refused.
    unsafe {
        let refused = gedepth_ground_of_calibration(&calibration, &mut ground);
        assert_eq!(refused, GEDEPTH_NOT_A_ROTATION);
        let refused = gedepth_ground_of_calibration(overlapping, overlapping.cast_mut().cast());
        assert_eq!(refused, GEDEPTH_OVERLAP);
        for refused in [
            gedepth_ground_of_calibration(null(), &mut ground),
            gedepth_ground_of_calibration(&calibration, null_mut()),
            gedepth_ground_of_mounting(1.5, 0.0, 0.0, null_mut()),
            gedepth_camera_ground(null(), &mut ground),
            gedepth_camera_ground(camera.0, null_mut()),
            gedepth_camera_set_ground(null_mut(), &good),
            gedepth_camera_set_ground(camera.0, null()),
        ] {
            assert_eq!(refused, GEDEPTH_NULL_POINTER);
        }
    }
    assert_eq!((ground, camera.ground()), (good, good));
    assert!(camera.depth(&rgb) == before);
}
