//! Calibrations spoiled field by field: always a numbered result, outputs untouched unless it is 0, and no NaN ever.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;

use gedepth_core_ffi::camera::*;
use gedepth_core_ffi::result::*;
use gedepth_core_ffi::table::*;

mod scene;

use scene::{PIXELS, Scene};

const POISON: [f64; 18] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    0.0,
    -0.0,
    -1.0,
    -1e-3,
    5e-324,
    -1e-310,
    1e-30,
    1e-2,
    1.0,
    1e6,
    -1e6,
    1e7,
    1e9,
    1e300,
    -f64::MAX,
];
const WHOLE: [u32; 9] = [0, 1, 2, 3, 4, 65_535, 65_536, 0x8000_0000, u32::MAX];

/// What every field can be set to, all fields of one struct one after the other.
trait Fields: Copy {
    const FLOATS: usize;
    const WHOLES: usize;

    fn float(&mut self, field: usize) -> &mut f64;

    fn whole(&mut self, field: usize) -> &mut u32;

    /// The struct with this field spoiled; as many as there are.
    fn spoiled(&self) -> Vec<Self> {
        let mut all = Vec::new();
        for field in 0..Self::FLOATS {
            for value in POISON {
                let mut spoiled = *self;
                *spoiled.float(field) = value;
                all.push(spoiled);
            }
        }
        for field in 0..Self::WHOLES {
            for value in WHOLE {
                let mut spoiled = *self;
                *spoiled.whole(field) = value;
                all.push(spoiled);
            }
        }
        all
    }
}

impl Fields for gedepth_core_lens {
    const FLOATS: usize = 13;
    const WHOLES: usize = 4;

    fn float(&mut self, field: usize) -> &mut f64 {
        match field {
            0 => &mut self.fx,
            1 => &mut self.fy,
            2 => &mut self.cx,
            3 => &mut self.cy,
            4 => &mut self.skew,
            _ => &mut self.coefficients[field - 5],
        }
    }

    fn whole(&mut self, field: usize) -> &mut u32 {
        match field {
            0 => &mut self.width,
            1 => &mut self.height,
            2 => &mut self.distortion,
            _ => &mut self.reserved,
        }
    }
}

impl Fields for gedepth_core_mounting {
    const FLOATS: usize = 4;
    const WHOLES: usize = 0;

    fn float(&mut self, field: usize) -> &mut f64 {
        [
            &mut self.height,
            &mut self.pitch,
            &mut self.roll,
            &mut self.yaw,
        ]
        .into_iter()
        .nth(field)
        .unwrap()
    }

    fn whole(&mut self, _: usize) -> &mut u32 {
        unreachable!()
    }
}

impl Fields for gedepth_core_extrinsics {
    const FLOATS: usize = 16;
    const WHOLES: usize = 0;

    fn float(&mut self, field: usize) -> &mut f64 {
        match field {
            0..9 => &mut self.r[field],
            9..12 => &mut self.t[field - 9],
            12..15 => &mut self.plane_up[field - 12],
            _ => &mut self.plane_offset,
        }
    }

    fn whole(&mut self, _: usize) -> &mut u32 {
        unreachable!()
    }
}

const SENTINEL: f32 = -54321.0;

/// Results seen, and memory that calls write.
struct Probe {
    seen: BTreeSet<i32>,
    known: BTreeSet<i32>,
    table: Vec<f32>,
    metres: Vec<f32>,
    rays: Vec<f32>,
    steps: Vec<u16>,
}

impl Probe {
    fn new() -> Self {
        Self {
            seen: BTreeSet::new(),
            known: all().collect(),
            table: vec![0.0; PIXELS],
            metres: vec![0.0; PIXELS],
            rays: vec![0.0; 2 * PIXELS],
            steps: vec![0; PIXELS],
        }
    }

    /// Whether it is 0; any other result must be known.
    fn done(&mut self, result: i32) -> bool {
        assert!(self.known.contains(&result), "unknown result {result}");
        self.seen.insert(result);
        result == GEDEPTH_CORE_OK
    }

    /// Everything that can be asked of a camera, whatever calibration it has.
    fn ask(&mut self, camera: &gedepth_core_camera) {
        let scene = Scene::new();
        let mut line = scene::LINE;
        let (mut down, mut height) = ([9.0; 3], -9.0);
        let mut ground = scene.ground;
        self.table.fill(SENTINEL);
        self.metres.fill(SENTINEL);
        // SAFETY: pointers lead to as many values as said.
        unsafe {
            if self.done(gedepth_core_vanishing_line(camera, &mut line)) {
                assert!(
                    [line.u0, line.v0, line.u1, line.v1]
                        .iter()
                        .all(|x| x.is_finite())
                );
            } else {
                assert_eq!(line, scene::LINE);
            }
            if self.done(gedepth_core_camera_ground(camera, &mut down, &mut height)) {
                assert!(down.iter().all(|x| x.abs() <= 1.0) && height > 0.0);
            }
            for (u, v) in [(0.0, 0.0), (12.0, 9.0), (-1e9, 3.0), (1e-310, 1e308)] {
                let mut inverse = -9.0;
                if self.done(gedepth_core_inverse_depth_at(camera, u, v, &mut inverse)) {
                    assert!(inverse.is_finite());
                } else {
                    assert_eq!(inverse, -9.0);
                }
            }
            let table = self.table.as_mut_ptr();
            let result = gedepth_core_table_build(camera, table, PIXELS, &mut ground);
            if !self.done(result) {
                assert!(self.table.iter().all(|value| *value == SENTINEL));
                assert_eq!(ground.values, scene.ground.values);
                return;
            }
            assert!(self.table.iter().all(|value| value.is_finite()));
            let (pixels, metres) = (ground.values_len, self.metres.as_mut_ptr());
            assert!(self.done(gedepth_core_ground_depth(&ground, 80.0, metres, pixels)));
            assert!(
                self.metres[..pixels]
                    .iter()
                    .all(|depth| (0.0..=80.0).contains(depth))
            );
            let steps = self.steps.as_mut_ptr();
            let result = gedepth_core_table_build_metres(camera, steps, PIXELS, &mut ground);
            assert!(self.done(result));
            let result =
                gedepth_core_table_build_rows(camera, 1e-3, 80.0, metres, PIXELS, &mut ground);
            self.done(result);
            self.done(gedepth_core_table_coefficients(camera, &mut ground));
            let rays = self.rays.as_mut_ptr();
            assert!(self.done(gedepth_core_rays_build(camera, rays, 2 * PIXELS)));
            let result =
                gedepth_core_table_rebuild(camera, rays, 2 * pixels, table, PIXELS, &mut ground);
            assert!(self.done(result));
            assert!(self.table[..pixels].iter().all(|value| value.is_finite()));
        }
    }

    /// Sets one thing on a camera that has all: it changes only where the result is 0, and can be asked either way.
    fn set(&mut self, set: impl Fn(*mut gedepth_core_camera) -> i32) -> bool {
        let mut camera = Scene::new().camera;
        let before = camera;
        let done = self.done(set(&mut camera));
        if done {
            self.ask(&camera);
        } else {
            assert!(camera == before);
        }
        done
    }
}

/// Every field of every struct, every poison; and the results that must come up.
#[test]
fn every_field_of_a_calibration() {
    let mut probe = Probe::new();
    let scene = Scene::new();
    let lens = |lens: &gedepth_core_lens, camera| {
        // SAFETY: both lead to one value.
        let result = unsafe { gedepth_core_camera_set_lens(camera, lens) };
        if result == GEDEPTH_CORE_OK {
            // SAFETY: as above.
            let result = unsafe { gedepth_core_camera_set_mounting(camera, &scene.mounting) };
            assert_eq!(result, GEDEPTH_CORE_OK);
        }
        result
    };
    let mut count = 0;
    for distortion in [
        GEDEPTH_CORE_PINHOLE,
        GEDEPTH_CORE_BROWN_CONRADY,
        GEDEPTH_CORE_KANNALA_BRANDT,
    ] {
        let mut sound = scene.lens;
        sound.distortion = distortion;
        let kept = [0, 8, 4][distortion as usize - 1];
        sound.coefficients[kept..].fill(0.0);
        for spoiled in sound.spoiled() {
            count += 1;
            probe.set(|camera| lens(&spoiled, camera));
        }
    }
    for spoiled in scene.mounting.spoiled() {
        count += 1;
        // SAFETY: both lead to one value.
        probe.set(|camera| unsafe { gedepth_core_camera_set_mounting(camera, &spoiled) });
    }
    for spoiled in scene.extrinsics.spoiled() {
        count += 1;
        // SAFETY: both lead to one value.
        probe.set(|camera| unsafe { gedepth_core_camera_set_extrinsics(camera, &spoiled) });
    }
    assert_eq!(count, 3 * (13 * 18 + 4 * 9) + 20 * 18);
    let expected = [
        GEDEPTH_CORE_OK,
        GEDEPTH_CORE_UNKNOWN_CHOICE,
        GEDEPTH_CORE_UNUSED_NOT_ZERO,
        GEDEPTH_CORE_NOT_A_PINHOLE,
        GEDEPTH_CORE_NO_RAY,
        GEDEPTH_CORE_IMAGE_SIZE,
        GEDEPTH_CORE_FOCAL_LENGTH,
        GEDEPTH_CORE_PRINCIPAL_POINT,
        GEDEPTH_CORE_SKEW,
        GEDEPTH_CORE_DISTORTION_COEFFICIENT,
        GEDEPTH_CORE_NOT_A_ROTATION,
        GEDEPTH_CORE_TRANSLATION,
        GEDEPTH_CORE_ANGLE_NOT_FINITE,
        GEDEPTH_CORE_PLANE_OFFSET,
        GEDEPTH_CORE_CAMERA_NOT_ABOVE_GROUND,
        GEDEPTH_CORE_TABLE_LENGTH,
    ];
    for result in expected {
        assert!(probe.seen.contains(&result), "{result} never came up");
    }
}

/// Several fields at once.
#[test]
fn fields_together() {
    let mut probe = Probe::new();
    let scene = Scene::new();
    let mut state = 1_u32;
    let mut roll = |sides: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % sides
    };
    let mut done = 0;
    for _ in 0..if cfg!(miri) { 5 } else { 300 } {
        let mut lens = scene.lens;
        lens.distortion = 1 + roll(3) as u32;
        lens.coefficients[[0, 8, 4][lens.distortion as usize - 1]..].fill(0.0);
        let mut mounting = scene.mounting;
        for _ in 0..1 + roll(3) {
            *lens.float(roll(13)) = POISON[roll(18)];
            *mounting.float(roll(4)) = POISON[roll(18)];
        }
        // SAFETY: all lead to one value.
        done += usize::from(probe.set(|camera| unsafe {
            let result = gedepth_core_camera_set_lens(camera, &lens);
            if result == GEDEPTH_CORE_OK {
                gedepth_core_camera_set_mounting(camera, &mounting);
            }
            result
        }));
    }
    assert!(done > 0);
}

/// Any camera that was not set by the library, but for the mark itself, is refused.
#[test]
fn a_camera_of_any_other_bits() {
    let mut line = scene::LINE;
    for word in [0, 1, u64::MAX, 0x6765_6465_7074_6800, 0x7ff8_0000_0000_0000] {
        let mut camera = gedepth_core_camera { opaque: [word; 64] };
        let before = camera;
        let mounting = Scene::new().mounting;
        // SAFETY: all lead to one value.
        unsafe {
            let result = gedepth_core_vanishing_line(&camera, &mut line);
            assert_eq!(result, GEDEPTH_CORE_CAMERA_NOT_SET);
            let result = gedepth_core_camera_set_mounting(&mut camera, &mounting);
            assert_eq!(result, GEDEPTH_CORE_CAMERA_NOT_SET);
        }
        assert!(camera == before);
    }
}

/// Tables described by hand with poisoned numbers, and tables that hold any bits: no NaN comes out of fusion.
#[test]
fn tables_of_any_bits() {
    let values = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN,
        0.0,
        1e-40,
        1e-6,
    ];
    for value in values {
        let mut scene = Scene::new();
        scene
            .table
            .iter_mut()
            .step_by(3)
            .for_each(|entry| *entry = value);
        assert_eq!(scene.adaptive(), GEDEPTH_CORE_OK);
        let [depth, attention, ground] = scene.outputs() else {
            unreachable!()
        };
        assert!(depth.iter().all(|depth| (0.1..=80.0).contains(depth)));
        assert!(attention.iter().all(|m| (0.0..=1.0).contains(m)));
        assert!(ground.iter().all(|ground| (0.0..=150.1).contains(ground)));
    }
    for value in POISON {
        for coefficient in 0..3 {
            let mut scene = Scene::new();
            scene.ground.form = GEDEPTH_CORE_COEFFICIENTS;
            scene.ground.coefficients[coefficient] = value;
            let expected = if value.is_finite() {
                GEDEPTH_CORE_OK
            } else {
                GEDEPTH_CORE_NOT_FINITE
            };
            assert_eq!(scene.adaptive(), expected);
            if value.is_finite() {
                let depth = &scene.outputs()[0];
                assert!(depth.iter().all(|depth| (0.1..=80.0).contains(depth)));
            }
        }
    }
}

/// Heads of the most extreme values that are accepted: still no NaN.
#[test]
fn heads_of_extreme_values() {
    let values = [1e37, -1e37, 1e-45, -0.0, 88.8, -104.0];
    for unit in [1, 2] {
        for decode_at in [1, 2] {
            for value in values {
                let mut scene = Scene::new();
                for head in [&mut scene.residual, &mut scene.attention, &mut scene.slope] {
                    head.decode_at = decode_at;
                }
                scene.residual.unit = unit;
                for head in [
                    &mut scene.residual_values,
                    &mut scene.attention_values,
                    &mut scene.logits,
                ] {
                    head.iter_mut().step_by(2).for_each(|entry| *entry = value);
                }
                assert_eq!(scene.adaptive(), GEDEPTH_CORE_OK);
                let [depth, attention, ground] = scene.outputs() else {
                    unreachable!()
                };
                assert!(depth.iter().all(|depth| (0.1..=80.0).contains(depth)));
                assert!(attention.iter().all(|m| (0.0..=1.0).contains(m)));
                assert!(ground.iter().all(|ground| (0.0..=150.1).contains(ground)));
            }
        }
    }
}
