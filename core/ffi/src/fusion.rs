//! Fusion of the ground with a network's heads.

use core::ffi::c_void;

use gedepth_core::Error;
use gedepth_core::camera::ImageSize;
use gedepth_core::fusion::{
    AttentionHead, AttentionUnit, DecodeAt, DepthRange, FusedMaps, Fusion, HEAD_VALUE_MAX, Head,
    HeadMap, ResidualHead, ResidualUnit, Samples, SlopeHead, Upsampling, scratch_len,
};
use gedepth_core::table::GroundRows;

use crate::memory::{Array, Span, check_disjoint, read};
use crate::result::{
    Failure, GEDEPTH_CORE_UNKNOWN_CHOICE, GEDEPTH_CORE_UNUSED_NOT_ZERO, GEDEPTH_CORE_ZERO_POINT,
    Result, number,
};
use crate::slope::{classes, gedepth_core_slope_classes};
use crate::table::{Table, gedepth_core_ground};

/// Heads are upsampled with half-pixel centres: PyTorch's and ONNX's align_corners off.
pub const GEDEPTH_CORE_HALF_PIXEL: u32 = 1;
/// Heads are upsampled from corner centre to corner centre: align_corners on.
pub const GEDEPTH_CORE_ALIGN_CORNERS: u32 = 2;

/// float.
pub const GEDEPTH_CORE_F32: u32 = 1;
/// uint8_t, (value - zero_point) * scale.
pub const GEDEPTH_CORE_U8: u32 = 2;
/// int8_t, (value - zero_point) * scale.
pub const GEDEPTH_CORE_I8: u32 = 3;

/// Residual depth in metres.
pub const GEDEPTH_CORE_METRES: u32 = 1;
/// Residual depth as natural logarithm of metres.
pub const GEDEPTH_CORE_LOG_METRES: u32 = 2;
/// Attention or slope as logits.
pub const GEDEPTH_CORE_LOGIT: u32 = 3;
/// Attention as M itself, 0 to 1.
pub const GEDEPTH_CORE_PROBABILITY: u32 = 4;
/// Residual depth as natural logarithm of depth over focal length, the metres that a pixel of the network's input spans there.
pub const GEDEPTH_CORE_LOG_METRES_PER_PIXEL: u32 = 5;

/// Exponentials and softmax before upsampling: 4 to 16 times cheaper.
pub const GEDEPTH_CORE_DECODE_AT_HEAD: u32 = 1;
/// Exponentials and softmax after upsampling.
pub const GEDEPTH_CORE_DECODE_AT_OUTPUT: u32 = 2;

/// One output of a network: planes of width x height, row-major, one after the other (NCHW with N = 1).
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct gedepth_core_head {
    /// The values, of the format's type; f32 ones within +-1e37.
    pub values: *const c_void,
    /// Their number, exactly channels * width * height.
    pub values_len: usize,
    /// GEDEPTH_CORE_F32, GEDEPTH_CORE_U8 or GEDEPTH_CORE_I8.
    pub format: u32,
    /// 1 for the residual and the attention, the number of classes for the slope.
    pub channels: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Residual: GEDEPTH_CORE_METRES, GEDEPTH_CORE_LOG_METRES or GEDEPTH_CORE_LOG_METRES_PER_PIXEL; attention:
    /// GEDEPTH_CORE_LOGIT or GEDEPTH_CORE_PROBABILITY; slope: GEDEPTH_CORE_LOGIT.
    pub unit: u32,
    /// GEDEPTH_CORE_DECODE_AT_HEAD or GEDEPTH_CORE_DECODE_AT_OUTPUT.
    pub decode_at: u32,
    /// Of 8-bit formats, positive, 255 times it at most 1e37; not read for GEDEPTH_CORE_F32.
    pub scale: f32,
    /// Of 8-bit formats; not read for GEDEPTH_CORE_F32.
    pub zero_point: i32,
    /// Of GEDEPTH_CORE_LOG_METRES_PER_PIXEL, sqrt(fx fy) of the network's input, pixels, 0.01 to 1e7; not read for others.
    pub focal_length: f32,
}

/// What all modes have in common.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct gedepth_core_fusion {
    /// GEDEPTH_CORE_HALF_PIXEL or GEDEPTH_CORE_ALIGN_CORNERS.
    pub upsampling: u32,
    /// Depth is clamped to at least this, metres, above 0.
    pub depth_min: f32,
    /// Depth is clamped to at most this, metres, finite and above depth_min.
    pub depth_max: f32,
    /// Ground farther than this counts as none, metres, positive and finite; not read by the baseline.
    pub ground_limit: f32,
}

/// Where results go. Each length is exactly the picture's pixels, or 0 with a null pointer where a map is not wanted.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct gedepth_core_maps {
    /// Depth, metres; wanted always.
    pub depth: *mut f32,
    /// Elements of depth.
    pub depth_len: usize,
    /// M, the attention at the picture's size, 0 to 1, or null.
    pub attention: *mut f32,
    /// Elements of attention.
    pub attention_len: usize,
    /// The ground depth that went into the fusion, metres, 0 for none, or null.
    pub ground: *mut f32,
    /// Elements of ground.
    pub ground_len: usize,
}

const UNKNOWN_CHOICE: Failure = Failure(GEDEPTH_CORE_UNKNOWN_CHOICE);

/// A head, what its values mean, and where its descriptor and its values lie.
struct HeadInput<'a> {
    map: HeadMap<'a>,
    unit: u32,
    focal_length: f32,
    decode_at: DecodeAt,
    spans: [Span; 2],
}

impl HeadInput<'_> {
    /// # Safety
    /// The crate's.
    unsafe fn new(head: *const gedepth_core_head, kind: Head) -> Result<Self> {
        // SAFETY: the crate's.
        unsafe {
            let descriptor = Array::one(head)?.span();
            let head = read(head)?;
            let size = ImageSize::new(head.width, head.height)?;
            let decode_at = match head.decode_at {
                GEDEPTH_CORE_DECODE_AT_HEAD => DecodeAt::HeadSize,
                GEDEPTH_CORE_DECODE_AT_OUTPUT => DecodeAt::OutputSize,
                _ => return Err(UNKNOWN_CHOICE),
            };
            let (values, len, scale) = (head.values, head.values_len, head.scale);
            let zero_point_error = Failure(GEDEPTH_CORE_ZERO_POINT);
            let (samples, span) = match head.format {
                GEDEPTH_CORE_F32 => {
                    let values = Array::<f32>::new(values.cast(), len)?;
                    (Samples::F32(values.slice()), values.span())
                }
                GEDEPTH_CORE_U8 => {
                    let array = Array::<u8>::new(values.cast(), len)?;
                    let zero_point = head.zero_point.try_into().map_err(|_| zero_point_error)?;
                    let values = array.slice();
                    let samples = Samples::U8 {
                        values,
                        scale,
                        zero_point,
                    };
                    (samples, array.span())
                }
                GEDEPTH_CORE_I8 => {
                    let array = Array::<i8>::new(values.cast(), len)?;
                    let zero_point = head.zero_point.try_into().map_err(|_| zero_point_error)?;
                    let values = array.slice();
                    let samples = Samples::I8 {
                        values,
                        scale,
                        zero_point,
                    };
                    (samples, array.span())
                }
                _ => return Err(UNKNOWN_CHOICE),
            };
            let map = HeadMap::new(samples, head.channels as usize, size)?;
            check_values(samples, kind)?;
            Ok(Self {
                map,
                unit: head.unit,
                focal_length: head.focal_length,
                decode_at,
                spans: [descriptor, span],
            })
        }
    }
}

/// Fusion finds values that it does not take when it comes to their row; here nothing may have been written by then. Bytes are
/// always within.
fn check_values(samples: Samples<'_>, kind: Head) -> Result<()> {
    match samples {
        Samples::F32(values) if !values.iter().all(|value| value.abs() <= HEAD_VALUE_MAX) => {
            Err(Error::HeadNotFinite(kind).into())
        }
        _ => Ok(()),
    }
}

fn residual<'a>(head: &HeadInput<'a>) -> Result<ResidualHead<'a>> {
    Ok(ResidualHead {
        map: head.map,
        unit: match head.unit {
            GEDEPTH_CORE_METRES => ResidualUnit::Metres,
            GEDEPTH_CORE_LOG_METRES => ResidualUnit::LogMetres,
            GEDEPTH_CORE_LOG_METRES_PER_PIXEL => ResidualUnit::LogMetresPerPixel {
                focal_length: head.focal_length,
            },
            _ => return Err(UNKNOWN_CHOICE),
        },
        decode_at: head.decode_at,
    })
}

fn attention<'a>(head: &HeadInput<'a>) -> Result<AttentionHead<'a>> {
    Ok(AttentionHead {
        map: head.map,
        unit: match head.unit {
            GEDEPTH_CORE_LOGIT => AttentionUnit::Logit,
            GEDEPTH_CORE_PROBABILITY => AttentionUnit::Probability,
            _ => return Err(UNKNOWN_CHOICE),
        },
        decode_at: head.decode_at,
    })
}

fn fusion(fusion: &gedepth_core_fusion, ground_limit: f32) -> Result<Fusion> {
    let upsampling = match fusion.upsampling {
        GEDEPTH_CORE_HALF_PIXEL => Upsampling::HalfPixel,
        GEDEPTH_CORE_ALIGN_CORNERS => Upsampling::AlignCorners,
        _ => return Err(UNKNOWN_CHOICE),
    };
    let range = DepthRange::new(fusion.depth_min, fusion.depth_max)?;
    Ok(Fusion::new(upsampling, range, ground_limit)?)
}

/// A map that C may not want.
fn optional(map: *mut f32, len: usize) -> Result<Option<Array<f32>>> {
    if !map.is_null() {
        return Array::new(map, len).map(Some);
    }
    if len == 0 {
        Ok(None)
    } else {
        Err(Failure(GEDEPTH_CORE_UNUSED_NOT_ZERO))
    }
}

/// Baseline: the residual is the depth. scratch_len at least gedepth_core_scratch_len(width, height, head width, 0),
/// depth_len exactly width * height.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_fuse_baseline(
    settings: *const gedepth_core_fusion,
    width: u32,
    height: u32,
    residual_head: *const gedepth_core_head,
    scratch: *mut f32,
    scratch_len: usize,
    depth: *mut f32,
    depth_len: usize,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let settings_span = Array::one(settings)?.span();
        // The ground's limit is not used.
        let fusion = fusion(&read(settings)?, 1.0)?;
        let size = ImageSize::new(width, height)?;
        let input = HeadInput::new(residual_head, Head::Residual)?;
        let (scratch, depth) = (
            Array::new(scratch, scratch_len)?,
            Array::new(depth, depth_len)?,
        );
        let [head, values] = input.spans;
        check_disjoint(
            &[scratch.span(), depth.span()],
            &[settings_span, head, values],
        )?;
        let residual = residual(&input)?;
        Ok(fusion.baseline(size, &residual, scratch.slice_mut(), depth.slice_mut())?)
    })())
}

/// Vanilla: ground depth from the plane. scratch_len at least gedepth_core_scratch_len(width, height, widest head, 0).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_fuse_vanilla(
    settings: *const gedepth_core_fusion,
    ground: *const gedepth_core_ground,
    residual_head: *const gedepth_core_head,
    attention_head: *const gedepth_core_head,
    scratch: *mut f32,
    scratch_len: usize,
    maps: *const gedepth_core_maps,
) -> i32 {
    // SAFETY: the crate's.
    number(unsafe {
        fuse(
            settings,
            ground,
            residual_head,
            attention_head,
            None,
            (scratch, scratch_len),
            maps,
        )
    })
}

/// Adaptive: ground depth from the plane and the expected slope (Eq. 7 and 8). scratch_len at least
/// gedepth_core_scratch_len(width, height, widest head, classes).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_fuse_adaptive(
    settings: *const gedepth_core_fusion,
    ground: *const gedepth_core_ground,
    residual_head: *const gedepth_core_head,
    attention_head: *const gedepth_core_head,
    slope_head: *const gedepth_core_head,
    slope_classes: *const gedepth_core_slope_classes,
    scratch: *mut f32,
    scratch_len: usize,
    maps: *const gedepth_core_maps,
) -> i32 {
    // SAFETY: the crate's.
    number(unsafe {
        fuse(
            settings,
            ground,
            residual_head,
            attention_head,
            Some((slope_head, slope_classes)),
            (scratch, scratch_len),
            maps,
        )
    })
}

type SlopeArguments = (*const gedepth_core_head, *const gedepth_core_slope_classes);

/// # Safety
/// The crate's.
unsafe fn fuse(
    settings: *const gedepth_core_fusion,
    ground: *const gedepth_core_ground,
    residual_head: *const gedepth_core_head,
    attention_head: *const gedepth_core_head,
    slope: Option<SlopeArguments>,
    (scratch, scratch_len): (*mut f32, usize),
    maps: *const gedepth_core_maps,
) -> Result<()> {
    // SAFETY: the crate's; the memory that is written overlaps nothing.
    unsafe {
        let settings_span = Array::one(settings)?.span();
        let settings = read(settings)?;
        let fusion = fusion(&settings, settings.ground_limit)?;
        let (table, [ground, ground_values]) = Table::new(ground)?;
        let residual_input = HeadInput::new(residual_head, Head::Residual)?;
        let attention_input = HeadInput::new(attention_head, Head::Attention)?;
        let slope = match slope {
            Some((head, slope_classes)) => {
                let input = HeadInput::new(head, Head::Slope)?;
                if input.unit != GEDEPTH_CORE_LOGIT {
                    return Err(UNKNOWN_CHOICE);
                }
                Some((input, classes(slope_classes)?))
            }
            None => None,
        };
        let maps_span = Array::one(maps)?.span();
        let maps = read(maps)?;
        let depth = Array::new(maps.depth, maps.depth_len)?;
        let attention_map = optional(maps.attention, maps.attention_len)?;
        let ground_map = optional(maps.ground, maps.ground_len)?;
        let scratch = Array::new(scratch, scratch_len)?;
        let span = |map: &Option<Array<f32>>| map.as_ref().map_or(Span::NONE, Array::span);
        let written = [
            depth.span(),
            span(&attention_map),
            span(&ground_map),
            scratch.span(),
        ];
        let [residual_span, residual_values] = residual_input.spans;
        let [attention_span, attention_values] = attention_input.spans;
        check_disjoint(
            &written,
            &[
                settings_span,
                ground,
                ground_values,
                residual_span,
                residual_values,
                attention_span,
                attention_values,
                maps_span,
            ],
        )?;
        if let Some((input, (_, spans))) = &slope {
            check_disjoint(&written, &input.spans)?;
            check_disjoint(&written, spans)?;
        }
        let residual = residual(&residual_input)?;
        let attention = attention(&attention_input)?;
        let maps = FusedMaps {
            depth: depth.slice_mut(),
            attention: attention_map.map(|map| map.slice_mut()),
            ground: ground_map.map(|map| map.slice_mut()),
        };
        let scratch = scratch.slice_mut();
        // Not one copy of fusion for each form of table.
        let ground: &dyn GroundRows = &table;
        match &slope {
            None => fusion.vanilla(ground, &residual, &attention, scratch, maps)?,
            Some((input, (classes, _))) => {
                let slope = SlopeHead {
                    map: input.map,
                    classes,
                    decode_at: input.decode_at,
                };
                fusion.adaptive(ground, &residual, &attention, &slope, scratch, maps)?;
            }
        }
        Ok(())
    }
}

/// Elements of scratch memory that fusion takes at most, for a picture of this size, heads of at most head_width columns and
/// this many slope classes (0 for the baseline and vanilla; 1 is enough for any number decoded at the head's size); 0 for a
/// picture size that is refused. Also GEDEPTH_CORE_SCRATCH_LEN.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_core_scratch_len(
    width: u32,
    height: u32,
    head_width: u32,
    slope_classes: usize,
) -> usize {
    ImageSize::new(width, height).map_or(0, |size| scratch_len(size, head_width, slope_classes))
}
