//! What every function checks before it writes: pointers, lengths, overlap, choices.
#![allow(clippy::unwrap_used)]

use std::ptr::{null, null_mut};

use gedepth_core_ffi::camera::*;
use gedepth_core_ffi::fusion::*;
use gedepth_core_ffi::result::*;
use gedepth_core_ffi::slope::*;
use gedepth_core_ffi::table::*;

mod scene;

use scene::{H, HEAD_H, HEAD_W, PIXELS, Scene, W};

const SENTINEL: f32 = -12345.0;

/// A pointer that no `f32` may have.
fn misaligned<T>(values: *const T) -> *mut T {
    values.cast::<u8>().wrapping_add(1).cast::<T>().cast_mut()
}

#[test]
fn cameras_are_set_in_order() {
    let scene = Scene::new();
    let mut camera = gedepth_core_camera { opaque: [0; 64] };
    let (mut line, mut inverse) = (scene::LINE, 0.0);
    // SAFETY: all pointers lead to one value of their type, or are null.
    unsafe {
        let c = &raw mut camera;
        for (result, expected) in [
            (
                gedepth_core_camera_set_mounting(c, &scene.mounting),
                GEDEPTH_CORE_CAMERA_NOT_SET,
            ),
            (
                gedepth_core_vanishing_line(c, &mut line),
                GEDEPTH_CORE_CAMERA_NOT_SET,
            ),
            (
                gedepth_core_camera_set_lens(c, &scene.lens),
                GEDEPTH_CORE_OK,
            ),
            (
                gedepth_core_vanishing_line(c, &mut line),
                GEDEPTH_CORE_POSE_NOT_SET,
            ),
            (
                gedepth_core_inverse_depth_at(c, 1.0, 1.0, &mut inverse),
                GEDEPTH_CORE_POSE_NOT_SET,
            ),
            (
                gedepth_core_camera_set_mounting(c, &scene.mounting),
                GEDEPTH_CORE_OK,
            ),
            (gedepth_core_vanishing_line(c, &mut line), GEDEPTH_CORE_OK),
            (
                gedepth_core_inverse_depth_at(c, 1.0, 1.0, &mut inverse),
                GEDEPTH_CORE_OK,
            ),
            // The lens again: its ground is forgotten.
            (
                gedepth_core_camera_set_lens(c, &scene.lens),
                GEDEPTH_CORE_OK,
            ),
            (
                gedepth_core_vanishing_line(c, &mut line),
                GEDEPTH_CORE_POSE_NOT_SET,
            ),
        ] {
            assert_eq!(result, expected);
        }
    }
}

#[test]
fn cameras_refuse_bad_pointers() {
    let scene = Scene::new();
    let mut camera = scene.camera;
    let before = camera;
    let c = &raw mut camera;
    let off = misaligned(c);
    let mut line = scene::LINE;
    let (mut down, mut height) = ([0.0; 3], 0.0);
    // SAFETY: pointers that are not null and aligned lead to values of their type; others are not followed.
    unsafe {
        for (result, expected) in [
            (
                gedepth_core_camera_set_lens(null_mut(), &scene.lens),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_camera_set_lens(c, null()),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_camera_set_lens(off, &scene.lens),
                GEDEPTH_CORE_MISALIGNED,
            ),
            (
                gedepth_core_camera_set_lens(c, misaligned(&scene.lens)),
                GEDEPTH_CORE_MISALIGNED,
            ),
            (
                gedepth_core_camera_set_lens(c, c.cast()),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_camera_set_mounting(null_mut(), &scene.mounting),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_camera_set_mounting(c, null()),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_camera_set_mounting(c, c.cast()),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_camera_set_extrinsics(c, c.cast()),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_camera_set_extrinsics(c, null()),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_camera_set_extrinsics(off, &scene.extrinsics),
                GEDEPTH_CORE_MISALIGNED,
            ),
            (
                gedepth_core_camera_ground(null(), &mut down, &mut height),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_camera_ground(c, c.cast(), &mut height),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_camera_ground(c, &mut down, down.as_mut_ptr()),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_camera_ground(c, null_mut(), null_mut()),
                GEDEPTH_CORE_OK,
            ),
            (
                gedepth_core_vanishing_line(c, null_mut()),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_vanishing_line(c, misaligned(&line)),
                GEDEPTH_CORE_MISALIGNED,
            ),
            (
                gedepth_core_vanishing_line(c, c.cast()),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_vanishing_line(null(), &mut line),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_inverse_depth_at(c, 0.0, 0.0, null_mut()),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_inverse_depth_at(c, f64::NAN, 0.0, &mut height),
                GEDEPTH_CORE_NOT_FINITE,
            ),
            (
                gedepth_core_inverse_depth_at(c, 0.0, 1e300, &mut height),
                GEDEPTH_CORE_NO_RAY,
            ),
        ] {
            assert_eq!(result, expected);
        }
    }
    assert!(camera == before);
    assert_eq!((down, height, line), ([0.0; 3], 0.0, scene::LINE));
}

#[test]
fn tables_refuse_bad_memory() {
    let scene = Scene::new();
    let camera = &raw const scene.camera;
    let mut values = vec![SENTINEL; PIXELS];
    let mut steps = vec![7_u16; PIXELS];
    let mut rays = vec![SENTINEL; 2 * PIXELS];
    let mut ground = scene.ground;
    let before = ground;
    let (v, g) = (values.as_mut_ptr(), &raw mut ground);
    let mut share = -1.0;
    // SAFETY: pointers that are not null and aligned lead to values of their type; others are not followed.
    unsafe {
        for (number, (result, expected)) in [
            (
                gedepth_core_table_build(null(), v, PIXELS, g),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_table_build(camera, null_mut(), PIXELS, g),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_table_build(camera, v, PIXELS, null_mut()),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_table_build(camera, misaligned(v), PIXELS - 1, g),
                GEDEPTH_CORE_MISALIGNED,
            ),
            (
                gedepth_core_table_build(camera, v, PIXELS - 1, g),
                GEDEPTH_CORE_TABLE_LENGTH,
            ),
            (
                gedepth_core_table_build(camera, v, 0, g),
                GEDEPTH_CORE_TABLE_LENGTH,
            ),
            (
                gedepth_core_table_build(camera, v, usize::MAX, g),
                GEDEPTH_CORE_TOO_LONG,
            ),
            (
                gedepth_core_table_build(camera, v, usize::MAX / 4 + 2, g),
                GEDEPTH_CORE_TOO_LONG,
            ),
            (
                gedepth_core_table_build(camera, g.cast(), PIXELS, g),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_table_build(camera, camera.cast_mut().cast(), PIXELS, g),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_table_build_metres(camera, steps.as_mut_ptr(), PIXELS - 1, g),
                GEDEPTH_CORE_TABLE_LENGTH,
            ),
            (
                gedepth_core_table_build_rows(camera, 1e-3, 80.0, v, H as usize, g),
                GEDEPTH_CORE_NOT_A_PINHOLE,
            ),
            (
                gedepth_core_table_build_rows(camera, f64::NAN, 80.0, v, H as usize, g),
                GEDEPTH_CORE_NOT_FINITE,
            ),
            (
                gedepth_core_table_build_rows(camera, 1e-3, f64::NAN, v, H as usize, g),
                GEDEPTH_CORE_NOT_FINITE,
            ),
            (
                gedepth_core_table_coefficients(camera, g),
                GEDEPTH_CORE_NOT_A_PINHOLE,
            ),
            (
                gedepth_core_rays_build(camera, rays.as_mut_ptr(), 2 * PIXELS - 1),
                GEDEPTH_CORE_TABLE_LENGTH,
            ),
            (
                gedepth_core_table_rebuild(camera, null(), 2 * PIXELS, v, PIXELS, g),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_table_rebuild(camera, rays.as_ptr(), 2 * PIXELS - 1, v, PIXELS, g),
                GEDEPTH_CORE_TABLE_LENGTH,
            ),
            (
                gedepth_core_table_rebuild(camera, rays.as_ptr(), 2 * PIXELS, v, PIXELS - 1, g),
                GEDEPTH_CORE_TABLE_LENGTH,
            ),
            (
                gedepth_core_table_rebuild(
                    camera,
                    rays.as_ptr(),
                    2 * PIXELS,
                    rays.as_mut_ptr(),
                    PIXELS,
                    g,
                ),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_ground_depth(&scene.ground, 80.0, v, PIXELS - 1),
                GEDEPTH_CORE_OUTPUT_LENGTH,
            ),
            (
                gedepth_core_ground_depth(&scene.ground, f32::NAN, v, PIXELS),
                GEDEPTH_CORE_NOT_FINITE,
            ),
            (
                gedepth_core_ground_depth(
                    &scene.ground,
                    80.0,
                    scene.ground.values.cast_mut().cast(),
                    PIXELS,
                ),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_ground_coverage(
                    &scene.ground,
                    v,
                    W as usize - 1,
                    &mut share,
                    rays.as_mut_ptr(),
                ),
                GEDEPTH_CORE_SCRATCH_LENGTH,
            ),
        ]
        .into_iter()
        .enumerate()
        {
            assert_eq!(result, expected, "call {number}");
        }
    }
    assert!(values.iter().chain(&rays).all(|value| *value == SENTINEL));
    assert!(steps.iter().all(|value| *value == 7) && share == -1.0);
    assert_eq!((ground.form, ground.values), (before.form, before.values));
}

/// Memory beyond a table is left alone, and tables are described as they are.
#[test]
fn tables_write_what_they_say() {
    let scene = Scene::new();
    let mut values = vec![SENTINEL; PIXELS + 3];
    let mut ground = scene.ground;
    // SAFETY: pointers lead to as many values as said.
    let result = unsafe {
        gedepth_core_table_build(
            &scene.camera,
            values.as_mut_ptr(),
            values.len(),
            &mut ground,
        )
    };
    assert_eq!(result, GEDEPTH_CORE_OK);
    assert!(values[..PIXELS].iter().all(|value| *value != SENTINEL));
    assert_eq!(values[PIXELS..], [SENTINEL; 3]);
    assert_eq!(
        (ground.form, ground.width, ground.height),
        (GEDEPTH_CORE_INVERSE_DEPTH, W, H)
    );
    assert_eq!(
        (ground.values, ground.values_len),
        (values.as_ptr().cast(), PIXELS)
    );
    assert_eq!(ground.camera_height, 1.5);
}

type Change = fn(&mut Scene);

/// Everything that fusion refuses, each by its own number, and without touching an output.
#[test]
fn fusion_refuses() {
    let changes: &[(i32, Change)] = &[
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| s.settings.upsampling = 0),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| s.settings.upsampling = 3),
        (GEDEPTH_CORE_DEPTH_RANGE, |s| s.settings.depth_min = 0.0),
        (GEDEPTH_CORE_DEPTH_RANGE, |s| {
            s.settings.depth_max = f32::INFINITY
        }),
        (GEDEPTH_CORE_GROUND_LIMIT, |s| s.settings.ground_limit = 0.0),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| s.ground.form = 0),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| s.ground.form = 5),
        (GEDEPTH_CORE_IMAGE_SIZE, |s| s.ground.width = 0),
        (GEDEPTH_CORE_IMAGE_SIZE, |s| s.ground.height = 65_536),
        (GEDEPTH_CORE_TABLE_LENGTH, |s| s.ground.width -= 1),
        (GEDEPTH_CORE_TABLE_LENGTH, |s| s.ground.values_len -= 1),
        (GEDEPTH_CORE_TABLE_LENGTH, |s| {
            s.ground.form = GEDEPTH_CORE_ROWS
        }),
        (GEDEPTH_CORE_CAMERA_NOT_ABOVE_GROUND, |s| {
            s.ground.camera_height = 0.0
        }),
        (GEDEPTH_CORE_NULL_POINTER, |s| s.ground.values = null()),
        (GEDEPTH_CORE_MISALIGNED, |s| {
            s.ground.values = misaligned(s.ground.values.cast::<f32>()).cast()
        }),
        (GEDEPTH_CORE_NOT_FINITE, |s| {
            s.ground.form = GEDEPTH_CORE_COEFFICIENTS;
            s.ground.coefficients[1] = f64::NAN;
        }),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| s.residual.format = 4),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| {
            s.residual.unit = GEDEPTH_CORE_LOGIT
        }),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| {
            s.attention.unit = GEDEPTH_CORE_METRES
        }),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| {
            s.slope.unit = GEDEPTH_CORE_PROBABILITY
        }),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| s.attention.decode_at = 0),
        (GEDEPTH_CORE_HEAD_LENGTH, |s| s.residual.values_len -= 1),
        (GEDEPTH_CORE_HEAD_LENGTH, |s| s.attention.channels = 2),
        (GEDEPTH_CORE_HEAD_LENGTH, |s| {
            s.attention.channels = u32::MAX
        }),
        (GEDEPTH_CORE_HEAD_CHANNELS, |s| {
            s.attention.channels = 3;
            s.attention.values = s.slope.values;
            s.attention.values_len = s.slope.values_len;
        }),
        (GEDEPTH_CORE_SLOPE_LOGIT_COUNT, |s| {
            s.classes.radians_len = 2
        }),
        (GEDEPTH_CORE_SLOPE_CLASS_COUNT, |s| {
            s.classes.radians_len = 0
        }),
        (GEDEPTH_CORE_SLOPE_ANGLE, |s| s.angles[1] = s.angles[0]),
        (GEDEPTH_CORE_SLOPE_ANGLE, |s| s.angles[2] = f64::NAN),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| s.classes.sign = 0),
        (GEDEPTH_CORE_UNUSED_NOT_ZERO, |s| s.classes.reserved = 1),
        (GEDEPTH_CORE_HEAD_NOT_FINITE, |s| {
            *s.residual_values.last_mut().unwrap() = f32::NAN
        }),
        (GEDEPTH_CORE_HEAD_NOT_FINITE, |s| {
            *s.attention_values.last_mut().unwrap() = f32::INFINITY
        }),
        (GEDEPTH_CORE_HEAD_NOT_FINITE, |s| {
            *s.logits.last_mut().unwrap() = f32::NEG_INFINITY
        }),
        (GEDEPTH_CORE_HEAD_NOT_FINITE, |s| {
            *s.attention_values.last_mut().unwrap() = f32::MAX;
        }),
        (GEDEPTH_CORE_HEAD_NOT_FINITE, |s| {
            *s.residual_values.last_mut().unwrap() = -1.1e37;
        }),
        (GEDEPTH_CORE_QUANTIZATION_SCALE, |s| {
            s.slope.format = GEDEPTH_CORE_I8;
            s.slope.scale = 0.0;
        }),
        (GEDEPTH_CORE_QUANTIZATION_SCALE, |s| {
            s.slope.format = GEDEPTH_CORE_U8;
            s.slope.scale = 4e34;
        }),
        (GEDEPTH_CORE_ZERO_POINT, |s| {
            s.slope.format = GEDEPTH_CORE_I8;
            s.slope.zero_point = 128;
        }),
        (GEDEPTH_CORE_FOCAL_LENGTH, |s| {
            s.residual.unit = GEDEPTH_CORE_LOG_METRES_PER_PIXEL;
            s.residual.focal_length = 0.0;
        }),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, |s| {
            s.attention.unit = GEDEPTH_CORE_LOG_METRES_PER_PIXEL
        }),
        (GEDEPTH_CORE_ZERO_POINT, |s| {
            s.slope.format = GEDEPTH_CORE_U8;
            s.slope.zero_point = -1;
        }),
        (GEDEPTH_CORE_SCRATCH_LENGTH, |s| s.scratch_len = 100),
        (GEDEPTH_CORE_OUTPUT_LENGTH, |s| s.maps.depth_len -= 1),
        (GEDEPTH_CORE_OUTPUT_LENGTH, |s| s.maps.attention_len -= 1),
        (GEDEPTH_CORE_OUTPUT_LENGTH, |s| s.maps.ground_len -= 1),
        (GEDEPTH_CORE_NULL_POINTER, |s| s.maps.depth = null_mut()),
        (GEDEPTH_CORE_UNUSED_NOT_ZERO, |s| {
            s.maps.attention = null_mut()
        }),
        (GEDEPTH_CORE_OVERLAP, |s| s.maps.attention = s.maps.depth),
        (GEDEPTH_CORE_OVERLAP, |s| {
            s.maps.ground = s.maps.depth.wrapping_add(PIXELS - 1)
        }),
        (GEDEPTH_CORE_OVERLAP, |s| {
            s.maps.depth = s.scratch.as_mut_ptr()
        }),
        (GEDEPTH_CORE_OVERLAP, |s| {
            s.maps.depth = s.ground.values.cast_mut().cast()
        }),
        (GEDEPTH_CORE_OVERLAP, |s| {
            s.residual.values = s.maps.depth.cast_const().cast()
        }),
        (GEDEPTH_CORE_OVERLAP, |s| {
            s.slope.values = s.scratch.as_ptr().cast()
        }),
        (GEDEPTH_CORE_OVERLAP, |s| {
            s.maps.depth = s.angles.as_mut_ptr().cast()
        }),
    ];
    for (number, (expected, change)) in changes.iter().enumerate() {
        let mut scene = Scene::new();
        change(&mut scene);
        scene.fill_outputs(SENTINEL);
        assert_eq!(scene.adaptive(), *expected, "change {number}");
        assert!(scene.outputs_are(SENTINEL), "change {number} wrote");
    }
    let mut scene = Scene::new();
    scene.fill_outputs(SENTINEL);
    assert_eq!(scene.adaptive(), GEDEPTH_CORE_OK);
    assert!(!scene.outputs_are(SENTINEL));
    assert_eq!(
        (scene.residual.width, scene.residual.height),
        (HEAD_W, HEAD_H)
    );
}

/// Scratch of exactly the length that is asked for is enough, in both places of decoding.
#[test]
fn scratch_of_the_length_asked_for_is_enough() {
    for at in [GEDEPTH_CORE_DECODE_AT_HEAD, GEDEPTH_CORE_DECODE_AT_OUTPUT] {
        let mut scene = Scene::new();
        for head in [&mut scene.residual, &mut scene.attention, &mut scene.slope] {
            head.decode_at = at;
        }
        scene.scratch_len = gedepth_core_scratch_len(W, H, HEAD_W, 3);
        assert_eq!(scene.adaptive(), GEDEPTH_CORE_OK);
    }
    assert_eq!(gedepth_core_scratch_len(0, H, HEAD_W, 3), 0);
    assert_eq!(gedepth_core_table_len(65_536, 1), 0);
    assert_eq!(gedepth_core_rows_len(65_535, 9), 9);
    assert_eq!(gedepth_core_rays_len(3, 4), 24);
}

#[test]
fn slope() {
    let mut scene = Scene::new();
    let pixel: [f32; 3] = [-1.0, 0.5, 2.0];
    let (mut expected, mut class, mut radians, mut inverse) = (SENTINEL, 99, -9.0, -9.0);
    // SAFETY: pointers that are not null and aligned lead to as many values as said; others are not followed.
    unsafe {
        let (c, camera) = (&raw const scene.classes, &raw const scene.camera);
        for (result, wanted) in [
            (
                gedepth_core_expected_slope(c, pixel.as_ptr(), 2, &mut expected),
                GEDEPTH_CORE_SLOPE_LOGIT_COUNT,
            ),
            (
                gedepth_core_expected_slope(c, null(), 3, &mut expected),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_expected_slope(null(), pixel.as_ptr(), 3, &mut expected),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_expected_slope(c, [f32::NAN; 3].as_ptr(), 3, &mut expected),
                GEDEPTH_CORE_SLOPE_LOGIT_NOT_FINITE,
            ),
            (
                gedepth_core_expected_slope(c, pixel.as_ptr(), 3, pixel.as_ptr().cast_mut()),
                GEDEPTH_CORE_OVERLAP,
            ),
            (
                gedepth_core_nearest_slope_class(c, f32::NAN, &mut class),
                GEDEPTH_CORE_NOT_FINITE,
            ),
            (
                gedepth_core_nearest_slope_class(c, 0.0, null_mut()),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_slope_from_depth(camera, 0.1, 0.0, &mut radians),
                GEDEPTH_CORE_NOT_FINITE,
            ),
            (
                gedepth_core_slope_from_depth(camera, f64::INFINITY, 9.0, &mut radians),
                GEDEPTH_CORE_NOT_FINITE,
            ),
            (
                gedepth_core_slope_from_depth(null(), 0.1, 9.0, &mut radians),
                GEDEPTH_CORE_NULL_POINTER,
            ),
            (
                gedepth_core_sloped_inverse_depth(camera, 0.1, f64::NAN, &mut inverse),
                GEDEPTH_CORE_NOT_FINITE,
            ),
        ] {
            assert_eq!(result, wanted);
        }
        assert_eq!(
            (expected, class, radians, inverse),
            (SENTINEL, 99, -9.0, -9.0)
        );
        // More classes than there may be are refused, not cut off.
        scene.angles = (0..65).map(|i| f64::from(i) * 1e-3).collect();
        scene.classes.radians = scene.angles.as_ptr();
        for (count, wanted) in [(64, GEDEPTH_CORE_OK), (65, GEDEPTH_CORE_SLOPE_CLASS_COUNT)] {
            scene.classes.radians_len = count;
            let result = gedepth_core_nearest_slope_class(&scene.classes, -0.0302, &mut class);
            assert_eq!((result, class), (wanted, 30));
        }
        // Eq. 7 undoes Eq. 9.
        let camera = &raw const scene.camera;
        assert_eq!(
            gedepth_core_slope_from_depth(camera, 0.05, 22.0, &mut radians),
            GEDEPTH_CORE_OK
        );
        assert_eq!(
            gedepth_core_sloped_inverse_depth(camera, 0.05, radians, &mut inverse),
            GEDEPTH_CORE_OK
        );
        assert!(radians > 0.0 && (inverse - 1.0 / 22.0).abs() < 1e-12);
    }
}
