//! Cameras: a lens, and where it is over which ground.

use core::mem::{align_of, size_of};

use gedepth_core::camera::{
    BrownConrady, CameraModel, ImageSize, Intrinsics, KannalaBrandt, Pinhole, Pixel,
};
use gedepth_core::{Angle, Direction, Error, Extrinsics, Ground, GroundPlane};

use crate::memory::{Array, Span, check_disjoint, read};
use crate::result::{
    Failure, GEDEPTH_CORE_CAMERA_NOT_SET, GEDEPTH_CORE_NO_RAY, GEDEPTH_CORE_NO_VANISHING_LINE,
    GEDEPTH_CORE_NOT_A_PINHOLE, GEDEPTH_CORE_NOT_FINITE, GEDEPTH_CORE_POSE_NOT_SET,
    GEDEPTH_CORE_UNKNOWN_CHOICE, GEDEPTH_CORE_UNUSED_NOT_ZERO, Result, number,
};

/// No distortion.
pub const GEDEPTH_CORE_PINHOLE: u32 = 1;
/// Brown-Conrady: k1, k2, p1, p2, k3, and k4, k5, k6 of the rational form or 0; OpenCV's order, ROS `plumb_bob` and
/// `rational_polynomial`.
pub const GEDEPTH_CORE_BROWN_CONRADY: u32 = 2;
/// Kannala-Brandt fisheye: k1, k2, k3, k4; OpenCV `fisheye`, ROS `equidistant`.
pub const GEDEPTH_CORE_KANNALA_BRANDT: u32 = 3;

/// A camera, in memory that the caller owns: 512 bytes, aligned as uint64_t, the same for every version with this
/// GEDEPTH_CORE_ABI_VERSION. Zero it before the first use. What is inside belongs to the library, holds no pointer and may
/// be copied, but only between programs with the very same library.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct gedepth_core_camera {
    /// The library's.
    pub opaque: [u64; 64],
}

/// Picture size, K and distortion. Pixels have integer coordinates at their centres; u to the right, v down:
/// u = fx x + skew y + cx, v = fy y + cy.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct gedepth_core_lens {
    /// Columns, 1 to 65535.
    pub width: u32,
    /// Rows, 1 to 65535.
    pub height: u32,
    /// GEDEPTH_CORE_PINHOLE, GEDEPTH_CORE_BROWN_CONRADY or GEDEPTH_CORE_KANNALA_BRANDT.
    pub distortion: u32,
    /// 0.
    pub reserved: u32,
    /// Focal length in columns, 0.01 to 1e7.
    pub fx: f64,
    /// Focal length in rows, 0.01 to 1e7.
    pub fy: f64,
    /// Principal point, column, within +-1e6.
    pub cx: f64,
    /// Principal point, row, within +-1e6.
    pub cy: f64,
    /// Skew, pixels, within +-1e6.
    pub skew: f64,
    /// Of the distortion, each within +-1e6; those that it has not are 0.
    pub coefficients: [f64; 8],
}

/// World to camera, p_camera = R p_world + T, and the ground plane up . p_world = offset. Metres. The camera's frame is
/// x right, y down, z forward; the world's is any.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct gedepth_core_extrinsics {
    /// R, rows; orthonormal to 1e-3.
    pub r: [f64; 9],
    /// T, metres, each within +-1e9.
    pub t: [f64; 3],
    /// A normal of the plane, pointing out of the ground; its length does not matter.
    pub plane_up: [f64; 3],
    /// Where the plane lies along the normal of length 1, metres, within +-1e9.
    pub plane_offset: f64,
}

/// The short way, without a calibration file: how the camera is mounted over the road.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct gedepth_core_mounting {
    /// Of the centre of projection over the ground, metres, 0.001 to 1e5.
    pub height: f64,
    /// Radians, positive looks down.
    pub pitch: f64,
    /// Radians, positive lowers the right side.
    pub roll: f64,
    /// Radians; does not change what is seen of a plane, but must be finite.
    pub yaw: f64,
}

/// The two ends of the vanishing line in the picture, left one first, pixels.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct gedepth_core_line {
    /// Left end, column.
    pub u0: f64,
    /// Left end, row.
    pub v0: f64,
    /// Right end, column.
    pub u1: f64,
    /// Right end, row.
    pub v1: f64,
}

/// What is in a [`gedepth_core_camera`].
#[repr(C)]
#[derive(Clone, Copy)]
struct State {
    /// [`MARK`] where there is a lens.
    mark: u64,
    lens: Lens,
    ground: Option<Ground>,
}

/// "gedepth" and a number for this very layout: changed with it.
const MARK: u64 = 0x6765_6465_7074_6801;

const _: () = assert!(
    size_of::<State>() <= size_of::<gedepth_core_camera>()
        && align_of::<State>() <= align_of::<gedepth_core_camera>()
);

/// A lens of any kind.
#[derive(Clone, Copy)]
pub(crate) enum Lens {
    Pinhole(Pinhole),
    BrownConrady(BrownConrady),
    KannalaBrandt(KannalaBrandt),
}

impl Lens {
    fn new(lens: &gedepth_core_lens) -> Result<Self> {
        let [k1, k2, k3, k4, rest @ ..] = lens.coefficients;
        let unused: &[f64] = match lens.distortion {
            GEDEPTH_CORE_PINHOLE => &lens.coefficients,
            GEDEPTH_CORE_BROWN_CONRADY => &[],
            GEDEPTH_CORE_KANNALA_BRANDT => &rest,
            _ => return Err(Failure(GEDEPTH_CORE_UNKNOWN_CHOICE)),
        };
        if lens.reserved != 0 || unused.iter().any(|coefficient| *coefficient != 0.0) {
            return Err(Failure(GEDEPTH_CORE_UNUSED_NOT_ZERO));
        }
        let size = ImageSize::new(lens.width, lens.height)?;
        let intrinsics =
            Intrinsics::new(size, lens.fx, lens.fy, lens.cx, lens.cy)?.with_skew(lens.skew)?;
        Ok(match lens.distortion {
            GEDEPTH_CORE_PINHOLE => Self::Pinhole(Pinhole::new(intrinsics)),
            GEDEPTH_CORE_BROWN_CONRADY => {
                Self::BrownConrady(BrownConrady::rational(intrinsics, lens.coefficients)?)
            }
            _ => Self::KannalaBrandt(KannalaBrandt::new(intrinsics, [k1, k2, k3, k4])?),
        })
    }

    // Behind a pointer: tables are made by one loop for all lenses, which keeps the library small.
    pub(crate) fn model(&self) -> &dyn CameraModel {
        match self {
            Self::Pinhole(camera) => camera,
            Self::BrownConrady(camera) => camera,
            Self::KannalaBrandt(camera) => camera,
        }
    }

    pub(crate) fn as_pinhole(&self) -> Result<&Intrinsics> {
        self.model()
            .as_pinhole()
            .ok_or(Failure(GEDEPTH_CORE_NOT_A_PINHOLE))
    }
}

/// A camera whose lens is set, and the memory that it lies in.
pub(crate) struct Camera<'a> {
    state: &'a State,
    pub(crate) span: Span,
}

impl Camera<'_> {
    /// # Safety
    /// The crate's.
    pub(crate) unsafe fn new(camera: *const gedepth_core_camera) -> Result<Self> {
        let span = Array::one(camera)?.span();
        // SAFETY: not null and aligned: `Array`; the first word of a camera is always there.
        if unsafe { camera.cast::<u64>().read() } != MARK {
            return Err(Failure(GEDEPTH_CORE_CAMERA_NOT_SET));
        }
        // SAFETY: it is no smaller and no less aligned than a `State` (asserted above), and the mark says that
        // `set_lens` wrote one.
        let state = unsafe { &*camera.cast::<State>() };
        Ok(Self { state, span })
    }

    pub(crate) fn lens(&self) -> &Lens {
        &self.state.lens
    }

    pub(crate) fn ground(&self) -> Result<&Ground> {
        let missing = Failure(GEDEPTH_CORE_POSE_NOT_SET);
        self.state.ground.as_ref().ok_or(missing)
    }
}

/// Keeps the lens and replaces the ground by what `ground` makes of `source`.
///
/// # Safety
/// The crate's.
unsafe fn set_ground<T: Copy>(
    camera: *mut gedepth_core_camera,
    source: *const T,
    ground: impl FnOnce(T) -> Result<Ground>,
) -> Result<()> {
    // SAFETY: as said there.
    let source = unsafe {
        let memory = Array::one(camera.cast_const())?;
        check_disjoint(&[memory.span()], &[Array::one(source)?.span()])?;
        read(source)?
    };
    // SAFETY: as said there.
    let state = unsafe { Camera::new(camera) }?.state;
    let state = State {
        ground: Some(ground(source)?),
        ..*state
    };
    // SAFETY: `Camera::new` checked it.
    unsafe { camera.cast::<State>().write(state) };
    Ok(())
}

/// Sets the lens and forgets the ground. Costly for distortions (they are checked for folds): once per calibration.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_camera_set_lens(
    camera: *mut gedepth_core_camera,
    lens: *const gedepth_core_lens,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let memory = Array::one(camera.cast_const())?;
        check_disjoint(&[memory.span()], &[Array::one(lens)?.span()])?;
        let state = State {
            mark: MARK,
            lens: Lens::new(&read(lens)?)?,
            ground: None,
        };
        camera.cast::<State>().write(state);
        Ok(())
    })())
}

/// Sets the ground from extrinsics and a plane. The lens must have been set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_camera_set_extrinsics(
    camera: *mut gedepth_core_camera,
    extrinsics: *const gedepth_core_extrinsics,
) -> i32 {
    // SAFETY: the crate's.
    number(unsafe {
        set_ground(camera, extrinsics, |extrinsics| {
            let [r0, r1, r2, r3, r4, r5, r6, r7, r8] = extrinsics.r;
            let [x, y, z] = extrinsics.plane_up;
            let rows = [[r0, r1, r2], [r3, r4, r5], [r6, r7, r8]];
            let pose = Extrinsics::world_to_camera(rows, extrinsics.t)?;
            let plane = GroundPlane::new(Direction::new(x, y, z)?, extrinsics.plane_offset)?;
            Ok(Ground::seen_by(&pose, &plane)?)
        })
    })
}

/// Sets the ground from how the camera is mounted. The lens must have been set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_camera_set_mounting(
    camera: *mut gedepth_core_camera,
    mounting: *const gedepth_core_mounting,
) -> i32 {
    // SAFETY: the crate's.
    number(unsafe {
        set_ground(camera, mounting, |mounting| {
            if !mounting.yaw.is_finite() {
                return Err(Error::AngleNotFinite(mounting.yaw).into());
            }
            Ok(Ground::from_mounting(
                mounting.height,
                Angle::from_radians(mounting.pitch),
                Angle::from_radians(mounting.roll),
            )?)
        })
    })
}

/// The ground as the camera sees it: the direction straight down (x, y, z in the camera's frame, unit length; may be
/// null) and the camera's height over the ground in metres (may be null).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_camera_ground(
    camera: *const gedepth_core_camera,
    down: *mut [f64; 3],
    height: *mut f64,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let camera = Camera::new(camera)?;
        let ground = camera.ground()?;
        let down = optional(down)?;
        let height = optional(height)?;
        let spans = [
            down.as_ref().map_or(Span::NONE, Array::span),
            height.as_ref().map_or(Span::NONE, Array::span),
        ];
        check_disjoint(&spans, &[camera.span])?;
        if let Some(down) = down {
            down.write(ground.down().vector().to_array());
        }
        if let Some(height) = height {
            height.write(ground.height());
        }
        Ok(())
    })())
}

fn optional<T>(value: *mut T) -> Result<Option<Array<T>>> {
    if value.is_null() {
        return Ok(None);
    }
    Array::one(value).map(Some)
}

/// The vanishing line's ends. GEDEPTH_CORE_NO_VANISHING_LINE if the picture does not show it, which is no fault. Costs one
/// unprojection for every pixel of the picture's frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_vanishing_line(
    camera: *const gedepth_core_camera,
    line: *mut gedepth_core_line,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let camera = Camera::new(camera)?;
        let line = Array::one(line)?;
        check_disjoint(&[line.span()], &[camera.span])?;
        let [left, right] = camera
            .ground()?
            .vanishing_line(camera.lens().model())
            .ok_or(Failure(GEDEPTH_CORE_NO_VANISHING_LINE))?;
        line.write(gedepth_core_line {
            u0: left.u,
            v0: left.v,
            u1: right.u,
            v1: right.v,
        });
        Ok(())
    })())
}

/// The inverse ground depth 1/z at pixel (u, v), anywhere, 1/m: positive below the vanishing line, negative above.
/// GEDEPTH_CORE_NO_RAY where the camera sees nothing that has a depth.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_inverse_depth_at(
    camera: *const gedepth_core_camera,
    u: f64,
    v: f64,
    inverse_depth: *mut f64,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let camera = Camera::new(camera)?;
        let inverse_depth = Array::one(inverse_depth)?;
        check_disjoint(&[inverse_depth.span()], &[camera.span])?;
        check_finite(&[u, v])?;
        let ray = camera.lens().model().forward_ray(Pixel::new(u, v));
        let ray = ray.ok_or(Failure(GEDEPTH_CORE_NO_RAY))?;
        inverse_depth.write(camera.ground()?.inverse_depth(ray));
        Ok(())
    })())
}

pub(crate) fn check_finite(values: &[f64]) -> Result<()> {
    if values.iter().all(|value| value.is_finite()) {
        Ok(())
    } else {
        Err(Failure(GEDEPTH_CORE_NOT_FINITE))
    }
}
