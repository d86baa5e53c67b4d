//! A small picture with everything that fusion takes, to be spoiled field by field.
#![allow(dead_code, unreachable_pub, clippy::unwrap_used)]

use gedepth_core_ffi::camera::*;
use gedepth_core_ffi::fusion::*;
use gedepth_core_ffi::result::GEDEPTH_CORE_OK;
use gedepth_core_ffi::slope::*;
use gedepth_core_ffi::table::*;

pub const W: u32 = 24;
pub const H: u32 = 10;
pub const PIXELS: usize = (W * H) as usize;
pub const HEAD_W: u32 = 7;
pub const HEAD_H: u32 = 3;
const HEAD: usize = (HEAD_W * HEAD_H) as usize;
const CLASSES: usize = 3;

pub const LINE: gedepth_core_line = gedepth_core_line {
    u0: -1.0,
    v0: -1.0,
    u1: -1.0,
    v1: -1.0,
};

/// Values lie behind boxes and vectors, so that pointers to them stay right as the scene is moved, and a sanitizer sees
/// what is read beyond them.
pub struct Scene {
    pub lens: gedepth_core_lens,
    pub mounting: gedepth_core_mounting,
    pub extrinsics: gedepth_core_extrinsics,
    pub camera: gedepth_core_camera,
    pub table: Vec<f32>,
    pub ground: gedepth_core_ground,
    pub residual_values: Vec<f32>,
    pub attention_values: Vec<f32>,
    pub logits: Vec<f32>,
    pub residual: gedepth_core_head,
    pub attention: gedepth_core_head,
    pub slope: gedepth_core_head,
    pub angles: Vec<f64>,
    pub classes: gedepth_core_slope_classes,
    pub settings: gedepth_core_fusion,
    pub scratch: Vec<f32>,
    pub scratch_len: usize,
    outputs: Vec<Vec<f32>>,
    pub maps: gedepth_core_maps,
}

impl Scene {
    pub fn new() -> Self {
        let lens = gedepth_core_lens {
            width: W,
            height: H,
            distortion: GEDEPTH_CORE_KANNALA_BRANDT,
            reserved: 0,
            fx: 20.0,
            fy: 20.0,
            cx: 11.5,
            cy: 3.0,
            skew: 0.1,
            coefficients: [-0.1, 0.02, 1e-3, -1e-3, 0.0, 0.0, 0.0, 0.0],
        };
        let mounting = gedepth_core_mounting {
            height: 1.5,
            pitch: 0.02,
            roll: 0.01,
            yaw: 0.3,
        };
        let extrinsics = gedepth_core_extrinsics {
            r: [0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0],
            t: [0.1, -0.1, 0.2],
            plane_up: [0.0, 0.0, 2.0],
            plane_offset: -1.6,
        };
        let mut camera = gedepth_core_camera { opaque: [0; 64] };
        let mut table = vec![0.0; PIXELS];
        let mut ground = gedepth_core_ground {
            form: 0,
            width: 0,
            height: 0,
            camera_height: 0.0,
            values: std::ptr::null(),
            values_len: 0,
            coefficients: [0.0; 3],
        };
        // SAFETY: pointers lead to as many values as said.
        unsafe {
            assert_eq!(
                gedepth_core_camera_set_lens(&mut camera, &lens),
                GEDEPTH_CORE_OK
            );
            assert_eq!(
                gedepth_core_camera_set_mounting(&mut camera, &mounting),
                GEDEPTH_CORE_OK
            );
            let result = gedepth_core_table_build(&camera, table.as_mut_ptr(), PIXELS, &mut ground);
            assert_eq!(result, GEDEPTH_CORE_OK);
        }
        let wave = |count: usize, scale: f32| -> Vec<f32> {
            (0..count)
                .map(|i| (i * 7 % 13) as f32 / 13.0 * scale - 1.0)
                .collect()
        };
        let residual_values = wave(HEAD, 5.0);
        let attention_values = wave(HEAD, 2.0);
        let logits = wave(CLASSES * HEAD, 3.0);
        let head = |values: &[f32], channels: u32, unit: u32| gedepth_core_head {
            values: values.as_ptr().cast(),
            values_len: values.len(),
            format: GEDEPTH_CORE_F32,
            channels,
            width: HEAD_W,
            height: HEAD_H,
            unit,
            decode_at: GEDEPTH_CORE_DECODE_AT_HEAD,
            scale: 0.1,
            zero_point: 3,
            focal_length: f32::NAN,
        };
        let angles = vec![-0.05, 0.0, 0.05];
        let scratch = vec![0.0; gedepth_core_scratch_len(W, H, HEAD_W, CLASSES)];
        let mut outputs = vec![vec![0.0; PIXELS]; 3];
        let [depth, attention, ground_map] = &mut outputs[..] else {
            unreachable!()
        };
        Self {
            residual: head(&residual_values, 1, GEDEPTH_CORE_LOG_METRES),
            attention: head(&attention_values, 1, GEDEPTH_CORE_LOGIT),
            slope: head(&logits, CLASSES as u32, GEDEPTH_CORE_LOGIT),
            classes: gedepth_core_slope_classes {
                radians: angles.as_ptr(),
                radians_len: CLASSES,
                sign: GEDEPTH_CORE_UPHILL_POSITIVE,
                reserved: 0,
            },
            settings: gedepth_core_fusion {
                upsampling: GEDEPTH_CORE_HALF_PIXEL,
                depth_min: 0.1,
                depth_max: 80.0,
                ground_limit: 150.0,
            },
            maps: gedepth_core_maps {
                depth: depth.as_mut_ptr(),
                depth_len: PIXELS,
                attention: attention.as_mut_ptr(),
                attention_len: PIXELS,
                ground: ground_map.as_mut_ptr(),
                ground_len: PIXELS,
            },
            scratch_len: scratch.len(),
            lens,
            mounting,
            extrinsics,
            camera,
            table,
            ground,
            residual_values,
            attention_values,
            logits,
            angles,
            scratch,
            outputs,
        }
    }

    pub fn adaptive(&mut self) -> i32 {
        // SAFETY: pointers lead to as many values as said, or are refused before they are followed.
        unsafe {
            gedepth_core_fuse_adaptive(
                &self.settings,
                &self.ground,
                &self.residual,
                &self.attention,
                &self.slope,
                &self.classes,
                self.scratch.as_mut_ptr(),
                self.scratch_len,
                &self.maps,
            )
        }
    }

    pub fn fill_outputs(&mut self, value: f32) {
        self.outputs.iter_mut().for_each(|map| map.fill(value));
    }

    pub fn outputs_are(&self, value: f32) -> bool {
        self.outputs.iter().flatten().all(|output| *output == value)
    }

    pub fn outputs(&self) -> &[Vec<f32>] {
        &self.outputs
    }
}
