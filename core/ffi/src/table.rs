//! Ground tables in the caller's memory, and what describes them.

use gedepth_core::Error;
use gedepth_core::camera::ImageSize;
use gedepth_core::table::{
    Coverage, FixedView, GroundCoefficients, GroundRows, GroundView, RayView, RowTolerance,
    RowView, write_depth,
};

use crate::camera::{Camera, check_finite, gedepth_core_camera};
use crate::memory::{Array, Span, check_disjoint, read};
use crate::result::{
    Failure, GEDEPTH_CORE_NOT_FINITE, GEDEPTH_CORE_UNKNOWN_CHOICE, Result, number,
};

/// float, inverse depth in 1/m with its sign, one a pixel.
pub const GEDEPTH_CORE_INVERSE_DEPTH: u32 = 1;
/// uint16_t, depth in 1/256 m up to 255 m, 0 for none, one a pixel.
pub const GEDEPTH_CORE_METRES_256: u32 = 2;
/// float, inverse depth in 1/m with its sign, one a row.
pub const GEDEPTH_CORE_ROWS: u32 = 3;
/// No table: three coefficients of a camera without distortion.
pub const GEDEPTH_CORE_COEFFICIENTS: u32 = 4;

/// A ground table: what the functions that make one fill in, and what fusion reads. Plain data; may be filled in by hand
/// for a table kept in flash. Row-major, index = v * width + u.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct gedepth_core_ground {
    /// GEDEPTH_CORE_INVERSE_DEPTH, GEDEPTH_CORE_METRES_256, GEDEPTH_CORE_ROWS or GEDEPTH_CORE_COEFFICIENTS.
    pub form: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Of the camera over the ground, metres.
    pub camera_height: f32,
    /// The table, of the form's type; not read for GEDEPTH_CORE_COEFFICIENTS.
    pub values: *const core::ffi::c_void,
    /// Its elements, exactly what the form takes.
    pub values_len: usize,
    /// a, b, c of 1/z = a + b u + c v in 1/m; read for GEDEPTH_CORE_COEFFICIENTS only.
    pub coefficients: [f64; 3],
}

type MetresView<'a> = FixedView<'a, 256, 255>;

/// A table of any form.
pub(crate) enum Table<'a> {
    InverseDepth(GroundView<'a>),
    Metres(MetresView<'a>),
    Rows(RowView<'a>),
    Coefficients(GroundCoefficients),
}

impl Table<'_> {
    /// The table, and where its descriptor and its values lie.
    ///
    /// # Safety
    /// The crate's.
    pub(crate) unsafe fn new(ground: *const gedepth_core_ground) -> Result<(Self, [Span; 2])> {
        // SAFETY: the crate's.
        unsafe {
            let descriptor = Array::one(ground)?.span();
            let ground = read(ground)?;
            let size = ImageSize::new(ground.width, ground.height)?;
            let (height, len) = (ground.camera_height, ground.values_len);
            let (table, values) = match ground.form {
                GEDEPTH_CORE_INVERSE_DEPTH => {
                    let values = Array::<f32>::new(ground.values.cast(), len)?;
                    let table = GroundView::from_values(values.slice(), size, height)?;
                    (Self::InverseDepth(table), values.span())
                }
                GEDEPTH_CORE_METRES_256 => {
                    let values = Array::<u16>::new(ground.values.cast(), len)?;
                    let table = FixedView::from_values(values.slice(), size, height)?;
                    (Self::Metres(table), values.span())
                }
                GEDEPTH_CORE_ROWS => {
                    let values = Array::<f32>::new(ground.values.cast(), len)?;
                    let table = RowView::from_values(values.slice(), size, height)?;
                    (Self::Rows(table), values.span())
                }
                GEDEPTH_CORE_COEFFICIENTS => {
                    check_finite(&ground.coefficients)?;
                    let table = GroundCoefficients::from_values(ground.coefficients, size, height)?;
                    (Self::Coefficients(table), Span::NONE)
                }
                _ => return Err(Failure(GEDEPTH_CORE_UNKNOWN_CHOICE)),
            };
            Ok((table, [descriptor, values]))
        }
    }
}

// Not four copies of fusion, one for each form: a branch a row costs nothing.
impl GroundRows for Table<'_> {
    fn size(&self) -> ImageSize {
        match self {
            Self::InverseDepth(table) => table.size(),
            Self::Metres(table) => table.size(),
            Self::Rows(table) => table.size(),
            Self::Coefficients(table) => table.size(),
        }
    }

    fn camera_height(&self) -> f32 {
        match self {
            Self::InverseDepth(table) => table.camera_height(),
            Self::Metres(table) => table.camera_height(),
            Self::Rows(table) => table.camera_height(),
            Self::Coefficients(table) => table.camera_height(),
        }
    }

    fn write_row(&self, v: u32, row: &mut [f32]) -> core::result::Result<(), Error> {
        match self {
            Self::InverseDepth(table) => table.write_row(v, row),
            Self::Metres(table) => table.write_row(v, row),
            Self::Rows(table) => table.write_row(v, row),
            Self::Coefficients(table) => table.write_row(v, row),
        }
    }
}

fn described(
    form: u32,
    table: &dyn GroundRows,
    values: *const core::ffi::c_void,
    values_len: usize,
    coefficients: [f64; 3],
) -> gedepth_core_ground {
    gedepth_core_ground {
        form,
        width: table.size().width(),
        height: table.size().height(),
        camera_height: table.camera_height(),
        values,
        values_len,
        coefficients,
    }
}

/// What the functions that fill a table have in common: checks, the table by `build`, its description.
///
/// # Safety
/// The crate's.
unsafe fn fill<T>(
    camera: *const gedepth_core_camera,
    values: *mut T,
    values_len: usize,
    ground: *mut gedepth_core_ground,
    read: Span,
    build: impl FnOnce(&Camera<'_>, &mut [T]) -> Result<gedepth_core_ground>,
) -> Result<()> {
    // SAFETY: the crate's; the memory that is written overlaps nothing.
    unsafe {
        let camera = Camera::new(camera)?;
        let values = Array::new(values, values_len)?;
        let ground = Array::one(ground)?;
        check_disjoint(&[values.span(), ground.span()], &[camera.span, read])?;
        ground.write(build(&camera, values.slice_mut())?);
        Ok(())
    }
}

/// Makes the table of inverse depths: values_len floats, at least gedepth_core_table_len.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_table_build(
    camera: *const gedepth_core_camera,
    values: *mut f32,
    values_len: usize,
    ground: *mut gedepth_core_ground,
) -> i32 {
    // SAFETY: the crate's.
    number(unsafe {
        fill(
            camera,
            values,
            values_len,
            ground,
            Span::NONE,
            |camera, memory| {
                let table = GroundView::build(memory, camera.lens().model(), camera.ground()?)?;
                let len = table.values().len();
                Ok(described(
                    GEDEPTH_CORE_INVERSE_DEPTH,
                    &table,
                    values.cast(),
                    len,
                    [0.0; 3],
                ))
            },
        )
    })
}

/// Makes the table of depths in 1/256 m: values_len uint16_t, at least gedepth_core_table_len. Keeps nothing above the
/// vanishing line: not for the adaptive mode where roads rise.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_table_build_metres(
    camera: *const gedepth_core_camera,
    values: *mut u16,
    values_len: usize,
    ground: *mut gedepth_core_ground,
) -> i32 {
    // SAFETY: the crate's.
    number(unsafe {
        fill(
            camera,
            values,
            values_len,
            ground,
            Span::NONE,
            |camera, memory| {
                let table = MetresView::build(memory, camera.lens().model(), camera.ground()?)?;
                let len = table.values().len();
                Ok(described(
                    GEDEPTH_CORE_METRES_256,
                    &table,
                    values.cast(),
                    len,
                    [0.0; 3],
                ))
            },
        )
    })
}

/// Makes the table of one inverse depth a row: values_len floats, at least gedepth_core_rows_len. For cameras without
/// distortion that hardly roll: GEDEPTH_CORE_ROLL_TOO_LARGE if a depth of up_to metres would be wrong by more than the share
/// relative_error, GEDEPTH_CORE_NOT_FINITE if either is NaN.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_table_build_rows(
    camera: *const gedepth_core_camera,
    relative_error: f64,
    up_to: f64,
    values: *mut f32,
    values_len: usize,
    ground: *mut gedepth_core_ground,
) -> i32 {
    // SAFETY: the crate's.
    number(unsafe {
        fill(
            camera,
            values,
            values_len,
            ground,
            Span::NONE,
            |camera, memory| {
                if relative_error.is_nan() || up_to.is_nan() {
                    return Err(Failure(GEDEPTH_CORE_NOT_FINITE));
                }
                let coefficients =
                    GroundCoefficients::new(camera.lens().as_pinhole()?, camera.ground()?);
                let tolerance = RowTolerance {
                    relative_error,
                    up_to,
                };
                let table = RowView::build(memory, &coefficients, tolerance)?;
                let len = table.values().len();
                Ok(described(
                    GEDEPTH_CORE_ROWS,
                    &table,
                    values.cast(),
                    len,
                    [0.0; 3],
                ))
            },
        )
    })
}

/// Makes the three coefficients of a camera without distortion, which need no memory.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_table_coefficients(
    camera: *const gedepth_core_camera,
    ground: *mut gedepth_core_ground,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let camera = Camera::new(camera)?;
        let ground = Array::one(ground)?;
        check_disjoint(&[ground.span()], &[camera.span])?;
        let table = GroundCoefficients::new(camera.lens().as_pinhole()?, camera.ground()?);
        let coefficients = table.coefficients();
        ground.write(described(
            GEDEPTH_CORE_COEFFICIENTS,
            &table,
            core::ptr::null(),
            0,
            coefficients,
        ));
        Ok(())
    })())
}

/// Keeps the ray of every pixel: rays_len floats, at least gedepth_core_rays_len. Needs the lens only. For
/// gedepth_core_table_rebuild.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_rays_build(
    camera: *const gedepth_core_camera,
    rays: *mut f32,
    rays_len: usize,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let camera = Camera::new(camera)?;
        let rays = Array::new(rays, rays_len)?;
        check_disjoint(&[rays.span()], &[camera.span])?;
        RayView::build(rays.slice_mut(), camera.lens().model())?;
        Ok(())
    })())
}

/// Makes the table of inverse depths for a camera whose pitch, roll or height is new (gedepth_core_camera_set_mounting)
/// and whose rays were kept, without unprojecting: rays_len exactly gedepth_core_rays_len, values_len at least
/// gedepth_core_table_len. About 1e-6 of the depth less exact than gedepth_core_table_build.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_table_rebuild(
    camera: *const gedepth_core_camera,
    rays: *const f32,
    rays_len: usize,
    values: *mut f32,
    values_len: usize,
    ground: *mut gedepth_core_ground,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let rays = Array::new(rays, rays_len)?;
        fill(
            camera,
            values,
            values_len,
            ground,
            rays.span(),
            |camera, memory| {
                let rays = RayView::from_values(rays.slice(), camera.lens().model().size())?;
                let table = GroundView::rebuild(memory, &rays, camera.ground()?)?;
                let len = table.values().len();
                Ok(described(
                    GEDEPTH_CORE_INVERSE_DEPTH,
                    &table,
                    values.cast(),
                    len,
                    [0.0; 3],
                ))
            },
        )
    })())
}

/// Writes the ground's depth in metres, 0 where there is none or where it is beyond max_depth, which is finite: metres_len floats, exactly
/// width * height.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_ground_depth(
    ground: *const gedepth_core_ground,
    max_depth: f32,
    metres: *mut f32,
    metres_len: usize,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let (table, spans) = Table::new(ground)?;
        let metres = Array::new(metres, metres_len)?;
        check_disjoint(&[metres.span()], &spans)?;
        check_finite(&[max_depth.into()])?;
        Ok(write_depth(&table, max_depth, metres.slice_mut())?)
    })())
}

/// How much of the picture shows ground: its share of the pixels, 0 to 1, and the nearest ground in metres, 0 if there is
/// none. scratch_len floats, at least the width.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_ground_coverage(
    ground: *const gedepth_core_ground,
    scratch: *mut f32,
    scratch_len: usize,
    share: *mut f64,
    nearest: *mut f32,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let (table, spans) = Table::new(ground)?;
        let scratch = Array::new(scratch, scratch_len)?;
        let (share, nearest) = (Array::one(share)?, Array::one(nearest)?);
        check_disjoint(&[scratch.span(), share.span(), nearest.span()], &spans)?;
        let coverage = Coverage::of(&table, scratch.slice_mut())?;
        share.write(coverage.share);
        nearest.write(coverage.nearest.unwrap_or(0.0));
        Ok(())
    })())
}

fn len(width: u32, height: u32, len: impl FnOnce(ImageSize) -> usize) -> usize {
    ImageSize::new(width, height).map_or(0, len)
}

/// Elements of a table with a value a pixel; 0 for a picture size that is refused. Also GEDEPTH_CORE_TABLE_LEN.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_core_table_len(width: u32, height: u32) -> usize {
    len(width, height, GroundView::len)
}

/// Elements of a table with a value a row; 0 for a picture size that is refused. Also GEDEPTH_CORE_ROWS_LEN.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_core_rows_len(width: u32, height: u32) -> usize {
    len(width, height, RowView::len)
}

/// Elements of kept rays; 0 for a picture size that is refused. Also GEDEPTH_CORE_RAYS_LEN.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_core_rays_len(width: u32, height: u32) -> usize {
    len(width, height, RayView::len)
}
