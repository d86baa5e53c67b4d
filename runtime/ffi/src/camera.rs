//! Cameras: a model bound to a calibration, which takes pictures and writes depth.

use std::iter;
use std::ptr;
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::time::Instant;

use gedepth::gedepth_core::Ground;
use gedepth::{Error, Estimate, Estimator, OutputSize, Picture, PixelFormat, Plane, Yuv};

use crate::calibration::gedepth_calibration;
use crate::memory::{Array, check_disjoint, close, look, open, read};
use crate::model::gedepth_model;
use crate::result::{
    Failure, GEDEPTH_BUSY, GEDEPTH_DEADLINE, GEDEPTH_NO_ATTENTION, GEDEPTH_OUTPUT_LENGTH,
    GEDEPTH_PANICKED, GEDEPTH_PICTURE_LENGTH, GEDEPTH_STATISTICS_LENGTH, GEDEPTH_UNKNOWN_CHOICE,
    GEDEPTH_UNUSED_NOT_ZERO, Result, guarded,
};
use crate::statistics::{Statistics, gedepth_statistics};

/// Maps have the picture's size (the region's, where the model crops): the ground is exact in every pixel.
pub const GEDEPTH_OUTPUT_PICTURE: u32 = 0;
/// Maps have the network's size: fewer pixels, faster.
pub const GEDEPTH_OUTPUT_NETWORK: u32 = 1;

/// Runs that statistics keep by default.
const DEFAULT_RUNS: u32 = 1000;
/// And at most.
const MAX_RUNS: u32 = 1_000_000;

/// How a camera is opened; all zeros is the usual.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct gedepth_options {
    /// Columns of the network's input; with network_height 0, the usual of the model and the picture's proportions. Both are
    /// multiples of what the model asks for (32 of the shipped ones), at most 16384, and 2^24 pixels; or what the file is fixed to.
    pub network_width: u32,
    /// Rows of the network's input.
    pub network_height: u32,
    /// GEDEPTH_OUTPUT_PICTURE or GEDEPTH_OUTPUT_NETWORK.
    pub output: u32,
    /// Runs that the statistics are of, the last ones: 1 to 1000000; 0 is 1000. 48 bytes each.
    pub statistics_runs: u32,
    /// 0.
    pub reserved: [u32; 4],
}

/// Sizes of an opened camera, in pixels, and what it gives.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct gedepth_shape {
    /// Columns of the pictures.
    pub picture_width: u32,
    /// Rows of the pictures.
    pub picture_height: u32,
    /// First column of the region of the picture that the maps cover.
    pub region_left: u32,
    /// First row of the region.
    pub region_top: u32,
    /// Columns of the region.
    pub region_width: u32,
    /// Rows of the region.
    pub region_height: u32,
    /// Columns of the network's input.
    pub network_width: u32,
    /// Rows of the network's input.
    pub network_height: u32,
    /// Columns of the maps.
    pub map_width: u32,
    /// Rows of the maps.
    pub map_height: u32,
    /// 1 if there is an attention, 0 if not.
    pub has_attention: u32,
    /// 0.
    pub reserved: u32,
}

/// Red, green, blue.
pub const GEDEPTH_FORMAT_RGB: u32 = 0;
/// Blue, green, red.
pub const GEDEPTH_FORMAT_BGR: u32 = 1;
/// Red, green, blue, and a byte that is not read.
pub const GEDEPTH_FORMAT_RGBX: u32 = 2;
/// Blue, green, red, and a byte that is not read.
pub const GEDEPTH_FORMAT_BGRX: u32 = 3;
/// One grey value.
pub const GEDEPTH_FORMAT_GREY: u32 = 4;
/// Two pixels in four bytes: luma, Cb, luma, Cr.
pub const GEDEPTH_FORMAT_YUYV: u32 = 5;
/// Two pixels in four bytes: Cb, luma, Cr, luma.
pub const GEDEPTH_FORMAT_UYVY: u32 = 6;
/// A plane of luma, then one of Cb, Cr with a pair for every two by two pixels.
pub const GEDEPTH_FORMAT_NV12: u32 = 7;

/// ITU-R BT.601, luma 16 to 235, chroma 16 to 240.
pub const GEDEPTH_YUV_BT601_LIMITED: u32 = 0;
/// ITU-R BT.601, 0 to 255 (JFIF).
pub const GEDEPTH_YUV_BT601_FULL: u32 = 1;
/// ITU-R BT.709, luma 16 to 235, chroma 16 to 240.
pub const GEDEPTH_YUV_BT709_LIMITED: u32 = 2;
/// ITU-R BT.709, 0 to 255.
pub const GEDEPTH_YUV_BT709_FULL: u32 = 3;

/// A picture, 8 bits a value, row by row from the top left; read where it is, without a copy. What is not used is 0: of a picture
/// of red, green, blue, all from `format` on.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct gedepth_picture {
    /// The bytes; of GEDEPTH_FORMAT_NV12 the luma.
    pub bytes: *const u8,
    /// Their number, at least (height - 1) * stride + a row's.
    pub bytes_len: usize,
    /// Bytes from the start of a row to the start of the next, at least a row's; 0 is a row's: width times 3, 4 (RGBX, BGRX), 1
    /// (GREY, NV12), or 2 (YUYV, UYVY; of the next even width).
    pub stride: usize,
    /// Columns: the camera's.
    pub width: u32,
    /// Rows: the camera's.
    pub height: u32,
    /// GEDEPTH_FORMAT_*.
    pub format: u32,
    /// What luma and chroma are, where the format has them: GEDEPTH_YUV_*.
    pub yuv: u32,
    /// Chroma of GEDEPTH_FORMAT_NV12: half as many rows, rounded up.
    pub chroma: *const u8,
    /// Number of its bytes, at least (rows - 1) * chroma_stride + a row's.
    pub chroma_len: usize,
    /// As stride; a row has as many bytes as the next even width.
    pub chroma_stride: usize,
}

/// A map to be written, row by row from the top left; with values null and values_len 0, none.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct gedepth_map {
    /// The values.
    pub values: *mut f32,
    /// Their number, at least (map_height - 1) * stride + map_width.
    pub values_len: usize,
    /// Values from the start of a row to the start of the next, at least map_width; 0 is map_width. What lies between rows is
    /// left as it is.
    pub stride: usize,
}

/// What a run is to write. Every map may be null. Ground or attention take a second fusion, in the time for copying.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct gedepth_maps {
    /// Planar depth, metres: z in the camera's frame. Within the model's range, never 0: its end for sky and what is farther.
    pub depth: gedepth_map,
    /// Ground depth as the model sees it, metres; 0 where there is none within the model's range.
    pub ground: gedepth_map,
    /// Ground attention, 0 to 1: how much of the depth is the ground's.
    pub attention: gedepth_map,
}

/// How long a run took, nanoseconds.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct gedepth_times {
    /// Resampling of the picture.
    pub preprocess_ns: u64,
    /// The network.
    pub network_ns: u64,
    /// From the network's outputs to depth.
    pub fusion_ns: u64,
    /// Copies into the caller's maps.
    pub copy_ns: u64,
    /// The call, from its start to when its maps were written.
    pub total_ns: u64,
}

/// Signs that a calibration and what a picture shows do not belong together, for a monitor to watch over many pictures.
/// An input to a safety argument, not one: each can be right by chance, and none sees every fault. -1 where there is no
/// such pixel, or no attention.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct gedepth_plausibility {
    /// Share of the maps' pixels where the calibration has ground within the model's range. The same for every picture until
    /// gedepth_camera_set_ground.
    pub ground_share: f32,
    /// Share of those where the ground is trusted: the attention is at least 1/2. It falls when the ground is hidden or wet,
    /// the lens is dirty, or the calibration is of another camera.
    pub trusted_share: f32,
    /// Mean attention about the vanishing line, where the ground is farther than the model's range, above the line as
    /// below. There is no ground to trust there: it rises when the camera's pitch is not the calibration's.
    pub attention_at_line: f32,
    /// Mean of |z - z_table| / z_table where the ground is trusted, z the depth, z_table the flat ground's: slope of the road,
    /// or a wrong pitch or height.
    pub ground_residual: f32,
}

/// A model bound to a calibrated camera. One thread at a time: a call during another of the same camera gives GEDEPTH_BUSY.
/// Different cameras may run at the same time on different threads, and a camera need not stay with one thread.
pub struct gedepth_camera {
    shape: gedepth_shape,
    state: Mutex<State>,
}

struct State {
    estimator: Estimator,
    statistics: Statistics,
}

/// A picture's bytes, not yet read, nor known to be enough.
struct Planes {
    format: PixelFormat,
    bytes: Array<u8>,
    chroma: Option<Array<u8>>,
}

impl Planes {
    /// The picture, whose description `of` is.
    ///
    /// # Safety
    /// [The crate's contract](crate#safety), while the picture is used.
    unsafe fn picture<'a>(&self, of: &gedepth_picture) -> Result<Picture<'a>> {
        let size = (of.width, of.height);
        let [(row, _), (chroma_row, _)] = self.format.planes(size);
        let plane = |array: &Array<u8>, stride, row: u64| Plane {
            // SAFETY: the caller's promise.
            bytes: unsafe { array.slice() },
            stride: match stride {
                0 => row as usize,
                stride => stride,
            },
        };
        let first = plane(&self.bytes, of.stride, row);
        let made = match &self.chroma {
            None => Picture::with_format(size, self.format, &[first]),
            Some(chroma) => {
                let second = plane(chroma, of.chroma_stride, chroma_row);
                Picture::with_format(size, self.format, &[first, second])
            }
        };
        made.map_err(|e| Failure::new(GEDEPTH_PICTURE_LENGTH, format_args!("{e}")))
    }
}

const _: fn() = || {
    fn any_thread<T: Send + Sync>() {}
    any_thread::<gedepth_camera>();
    any_thread::<gedepth_model>();
};

impl gedepth_camera {
    fn new(
        model: &gedepth_model,
        calibration: &gedepth_calibration,
        options: &gedepth_options,
    ) -> Result<Self> {
        if options.reserved != [0; 4] {
            return Err(Failure::new(
                GEDEPTH_UNUSED_NOT_ZERO,
                format_args!("options: reserved must be 0"),
            ));
        }
        let output = match options.output {
            GEDEPTH_OUTPUT_PICTURE => OutputSize::Picture,
            GEDEPTH_OUTPUT_NETWORK => OutputSize::Network,
            unknown => {
                return Err(Failure::new(
                    GEDEPTH_UNKNOWN_CHOICE,
                    format_args!("options: output {unknown} is none of GEDEPTH_OUTPUT_*"),
                ));
            }
        };
        let runs = match options.statistics_runs {
            0 => DEFAULT_RUNS,
            runs if runs > MAX_RUNS => {
                return Err(Failure::new(
                    GEDEPTH_STATISTICS_LENGTH,
                    format_args!("options: statistics_runs is {runs}, must be at most {MAX_RUNS}"),
                ));
            }
            runs => runs,
        };
        let network = match (options.network_width, options.network_height) {
            (0, 0) => None,
            size => Some(size),
        };
        let picture = (calibration.width, calibration.height);
        let calibration = calibration.checked()?;
        let estimator = Estimator::new(&model.model, &calibration, picture, network, output)?;
        let (placement, map) = (estimator.placement(), estimator.map_size());
        let shape = gedepth_shape {
            picture_width: picture.0,
            picture_height: picture.1,
            region_left: placement.left,
            region_top: placement.top,
            region_width: placement.region.0,
            region_height: placement.region.1,
            network_width: placement.network.0,
            network_height: placement.network.1,
            map_width: map.0,
            map_height: map.1,
            has_attention: model.model.contract().attention.is_some().into(),
            reserved: 0,
        };
        Ok(Self {
            shape,
            state: Mutex::new(State {
                estimator,
                statistics: Statistics::new(runs as usize),
            }),
        })
    }

    /// This thread's, until the guard is dropped.
    fn state(&self) -> Result<MutexGuard<'_, State>> {
        self.state.try_lock().map_err(|e| match e {
            TryLockError::WouldBlock => Failure::plain(GEDEPTH_BUSY),
            TryLockError::Poisoned(_) => Failure::plain(GEDEPTH_PANICKED),
        })
    }

    /// What the next picture is fused with.
    pub(crate) fn ground(&self) -> Result<Ground> {
        Ok(*self.state()?.estimator.ground())
    }

    /// From the next picture on.
    pub(crate) fn set_ground(&self, ground: &Ground) -> Result<()> {
        Ok(self.state()?.estimator.set_ground(ground)?)
    }

    /// Runs a picture and writes its maps; its times, and whether that was late.
    ///
    /// # Safety
    /// [The crate's contract](crate#safety).
    unsafe fn run(
        &self,
        start: Instant,
        picture: *const gedepth_picture,
        maps: *const gedepth_maps,
        times: *mut gedepth_times,
        deadline_ns: u64,
    ) -> Result<()> {
        let (picture_span, maps_span) = (Array::one(picture)?.span(), Array::one(maps)?.span());
        // SAFETY: passed on.
        let (picture, maps) = unsafe { (read(picture)?, read(maps)?) };
        let times = match times.is_null() {
            true => None,
            false => Some(Array::one(times)?),
        };
        let planes = self.planes(&picture)?;
        let outputs = [
            self.output(&maps.depth, "depth")?,
            self.output(&maps.ground, "ground")?,
            self.output(&maps.attention, "attention")?,
        ];
        if outputs[2].is_some() && self.shape.has_attention == 0 {
            return Err(Failure::plain(GEDEPTH_NO_ATTENTION));
        }
        let mut written = [None; 4];
        for (span, output) in written.iter_mut().zip(&outputs) {
            *span = output.as_ref().map(|(array, _)| array.span());
        }
        written[3] = times.as_ref().map(Array::span);
        let [bytes, chroma] = [
            &planes.bytes,
            planes.chroma.as_ref().unwrap_or(&planes.bytes),
        ];
        check_disjoint(
            written.iter().flatten(),
            &[bytes.span(), chroma.span(), picture_span, maps_span],
        )?;

        let mut state = self.state()?;
        let State {
            estimator,
            statistics,
        } = &mut *state;
        // SAFETY: passed on.
        let picture = unsafe { planes.picture(&picture)? };
        let Estimate {
            depth,
            times: stages,
            ..
        } = estimator.run(picture)?;
        let sources = match outputs[1..].iter().any(Option::is_some) {
            true => {
                let maps = estimator.maps()?;
                [Some(maps.depth), Some(maps.ground), maps.attention]
            }
            false => [Some(depth), None, None],
        };
        for (output, source) in outputs.iter().zip(sources) {
            let (Some((array, stride)), Some(source)) = (output, source) else {
                continue;
            };
            let width = self.shape.map_width as usize;
            for (row, values) in source.chunks_exact(width).enumerate() {
                // SAFETY: passed on.
                unsafe { array.write(row * stride, values) };
            }
        }
        let nanoseconds =
            |time: std::time::Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let total_ns = nanoseconds(start.elapsed());
        let [preprocess_ns, network_ns, fusion_ns] =
            [stages.preprocess, stages.network, stages.fusion].map(nanoseconds);
        let copy_ns = total_ns.saturating_sub(preprocess_ns + network_ns + fusion_ns);
        if let Some(times) = times {
            let of_run = gedepth_times {
                preprocess_ns,
                network_ns,
                fusion_ns,
                copy_ns,
                total_ns,
            };
            // SAFETY: passed on.
            unsafe { times.write(0, &[of_run]) };
        }
        let late = deadline_ns > 0 && total_ns > deadline_ns;
        statistics.add(
            [preprocess_ns, network_ns, fusion_ns, copy_ns, total_ns],
            late,
        );
        match late {
            true => Err(Failure::new(
                GEDEPTH_DEADLINE,
                format_args!(
                    "the run took {total_ns} ns, its deadline was {deadline_ns} ns; its maps are complete"
                ),
            )),
            false => Ok(()),
        }
    }

    /// Where the bytes of a picture of the right size are.
    fn planes(&self, picture: &gedepth_picture) -> Result<Planes> {
        let actual = (picture.width, picture.height);
        let expected = (self.shape.picture_width, self.shape.picture_height);
        if actual != expected {
            return Err(Error::PictureSize { actual, expected }.into());
        }
        let yuv = match picture.yuv {
            GEDEPTH_YUV_BT601_LIMITED => Yuv::Bt601Limited,
            GEDEPTH_YUV_BT601_FULL => Yuv::Bt601Full,
            GEDEPTH_YUV_BT709_LIMITED => Yuv::Bt709Limited,
            GEDEPTH_YUV_BT709_FULL => Yuv::Bt709Full,
            unknown => {
                return Err(Failure::new(
                    GEDEPTH_UNKNOWN_CHOICE,
                    format_args!("the picture's yuv {unknown} is none of GEDEPTH_YUV_*"),
                ));
            }
        };
        let format = match picture.format {
            GEDEPTH_FORMAT_RGB => PixelFormat::Rgb,
            GEDEPTH_FORMAT_BGR => PixelFormat::Bgr,
            GEDEPTH_FORMAT_RGBX => PixelFormat::Rgbx,
            GEDEPTH_FORMAT_BGRX => PixelFormat::Bgrx,
            GEDEPTH_FORMAT_GREY => PixelFormat::Grey,
            GEDEPTH_FORMAT_YUYV => PixelFormat::Yuyv(yuv),
            GEDEPTH_FORMAT_UYVY => PixelFormat::Uyvy(yuv),
            GEDEPTH_FORMAT_NV12 => PixelFormat::Nv12(yuv),
            unknown => {
                return Err(Failure::new(
                    GEDEPTH_UNKNOWN_CHOICE,
                    format_args!("the picture's format {unknown} is none of GEDEPTH_FORMAT_*"),
                ));
            }
        };
        let has_yuv = picture.format >= GEDEPTH_FORMAT_YUYV;
        let has_chroma = picture.format == GEDEPTH_FORMAT_NV12;
        let chroma = (picture.chroma, picture.chroma_len, picture.chroma_stride);
        if !has_yuv && picture.yuv != 0 || !has_chroma && chroma != (ptr::null(), 0, 0) {
            return Err(Failure::new(
                GEDEPTH_UNUSED_NOT_ZERO,
                format_args!(
                    "the picture's format {} has no use for its yuv or its chroma: they must be 0",
                    picture.format
                ),
            ));
        }
        Ok(Planes {
            format,
            bytes: Array::new(picture.bytes, picture.bytes_len)?,
            chroma: match has_chroma {
                true => Some(Array::new(picture.chroma, picture.chroma_len)?),
                false => None,
            },
        })
    }

    /// Where a map goes and its stride; `None` if it is not asked for.
    fn output(&self, map: &gedepth_map, name: &str) -> Result<Option<(Array<f32>, usize)>> {
        // A length without values is memory that could not be had.
        if map.values.is_null() && map.values_len == 0 {
            return Ok(None);
        }
        let values = Array::new(map.values, map.values_len)?;
        let (width, height) = (self.shape.map_width as usize, self.shape.map_height);
        let stride = match map.stride {
            0 => width,
            stride => stride,
        };
        let needed = needed(height, stride, width);
        if stride < width || needed.is_none_or(|needed| map.values_len < needed) {
            return Err(Failure::new(
                GEDEPTH_OUTPUT_LENGTH,
                format_args!(
                    "{name} of {width} x {height} with a stride of {stride} has {} values; (height - 1) * stride + {width} are needed, and the stride must be at least {width}",
                    map.values_len
                ),
            ));
        }
        Ok(Some((values, stride)))
    }
}

/// Elements of `rows` rows (at least one) `stride` apart, the last of them `row` long.
fn needed(rows: u32, stride: usize, row: usize) -> Option<usize> {
    (rows as usize - 1).checked_mul(stride)?.checked_add(row)
}

/// Binds a model to a calibrated camera: plans the network, builds the ground table and runs a made-up picture, so that all
/// memory of later runs is there. Takes some 50 ms with the shipped models, up to 1 s where tract runs the model. `options`
/// may be null: the usual. `*camera` is written on success only. For another lens or place open another camera, then close
/// this one; another ground under it is gedepth_camera_set_ground's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_camera_open(
    model: *const gedepth_model,
    calibration: *const gedepth_calibration,
    options: *const gedepth_options,
    camera: *mut *mut gedepth_camera,
) -> i32 {
    guarded(|| {
        // SAFETY: the crate's contract.
        let (model, numbers) = unsafe { (look(model)?, read(calibration)?) };
        let place = Array::one(camera)?.span();
        check_disjoint(iter::once(&place), &[Array::one(calibration)?.span()])?;
        let options = match options.is_null() {
            true => gedepth_options::default(),
            false => {
                check_disjoint(iter::once(&place), &[Array::one(options)?.span()])?;
                // SAFETY: as above.
                unsafe { read(options) }?
            }
        };
        // SAFETY: as above.
        unsafe { open(camera, || gedepth_camera::new(model, &numbers, &options)) }
    })
}

/// The camera's sizes, for the caller to make its maps.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_camera_shape(
    camera: *const gedepth_camera,
    shape: *mut gedepth_shape,
) -> i32 {
    guarded(|| {
        // SAFETY: the crate's contract.
        let camera = unsafe { look(camera) }?;
        let shape = Array::one(shape)?;
        // SAFETY: as above.
        unsafe { shape.write(0, &[camera.shape]) };
        Ok(())
    })
}

/// Estimates the depth of a picture and writes the maps that are not null. `times` may be null. Where the run takes longer
/// than `deadline_ns` (0 is none) the result is GEDEPTH_DEADLINE, with everything written; a run is never cut short. After
/// any other result but GEDEPTH_OK nothing was written. Allocates nothing where the quantized engine runs the whole network.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_camera_run(
    camera: *mut gedepth_camera,
    picture: *const gedepth_picture,
    maps: *const gedepth_maps,
    deadline_ns: u64,
    times: *mut gedepth_times,
) -> i32 {
    let start = Instant::now();
    guarded(|| {
        // SAFETY: the crate's contract.
        unsafe { look(camera.cast_const())?.run(start, picture, maps, times, deadline_ns) }
    })
}

/// Percentiles of the camera's last runs. Allocates nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_camera_statistics(
    camera: *const gedepth_camera,
    statistics: *mut gedepth_statistics,
) -> i32 {
    guarded(|| {
        // SAFETY: the crate's contract.
        let camera = unsafe { look(camera) }?;
        let statistics = Array::one(statistics)?;
        let summary = camera.state()?.statistics.summary();
        // SAFETY: as above.
        unsafe { statistics.write(0, &[summary]) };
        Ok(())
    })
}

/// What the camera's last picture says about its calibration (before the first, of a made-up one). Allocates nothing; takes
/// less than 1 ms for a megapixel of maps, and a fusion where the picture's maps were not asked for.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_camera_plausibility(
    camera: *const gedepth_camera,
    plausibility: *mut gedepth_plausibility,
) -> i32 {
    guarded(|| {
        // SAFETY: the crate's contract.
        let camera = unsafe { look(camera) }?;
        let plausibility = Array::one(plausibility)?;
        let of_last = camera.state()?.estimator.plausibility()?;
        let none = -1.0;
        let of_last = gedepth_plausibility {
            ground_share: of_last.ground_share,
            trusted_share: of_last.trusted_share.unwrap_or(none),
            attention_at_line: of_last.attention_at_line.unwrap_or(none),
            ground_residual: of_last.ground_residual.unwrap_or(none),
        };
        // SAFETY: as above.
        unsafe { plausibility.write(0, &[of_last]) };
        Ok(())
    })
}

/// Keeps each of a camera's threads on one of these cores (numbers as Linux has them), in order, from the first again if there are
/// more threads. The calling thread is the first of them: call this on the one that runs the camera's pictures. GEDEPTH_CORES where
/// tract runs a part of the network, there are no cores, or the system refuses one; threads may then be on others of these cores.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_camera_pin(
    camera: *mut gedepth_camera,
    cores: *const u32,
    cores_len: usize,
) -> i32 {
    guarded(|| {
        // SAFETY: the crate's contract.
        let camera = unsafe { look(camera.cast_const()) }?;
        let cores = Array::new(cores, cores_len)?;
        // SAFETY: as above.
        let cores: Vec<usize> = unsafe { cores.slice() }
            .iter()
            .map(|&core| core as usize)
            .collect();
        Ok(camera.state()?.estimator.pin_threads(&cores)?)
    })
}

/// Closes a camera and ends its threads; null is none. No other call may be using it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_camera_close(camera: *mut gedepth_camera) {
    guarded(|| {
        // SAFETY: the crate's contract.
        unsafe { close(camera) };
        Ok(())
    });
}

#[cfg(test)]
#[allow(clippy::panic)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::ptr::{null, null_mut};

    use super::*;
    use crate::calibration::GEDEPTH_PINHOLE;
    use crate::ground::{gedepth_camera_ground, gedepth_camera_set_ground, gedepth_ground};
    use crate::model::{gedepth_model_close, gedepth_model_open_embedded};
    use crate::result::GEDEPTH_OK;

    #[test]
    fn a_camera_in_use_is_busy_and_one_that_panicked_is_refused() {
        let calibration = gedepth_calibration {
            width: 32,
            height: 32,
            distortion: GEDEPTH_PINHOLE,
            reserved: 0,
            fx: 30.0,
            fy: 30.0,
            cx: 15.5,
            cy: 15.5,
            skew: 0.0,
            coefficients: [0.0; 8],
            r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            t: [0.0; 3],
            plane_up: [0.0, -1.0, 0.0],
            plane_offset: -1.5,
        };
        let options = gedepth_options {
            network_width: 32,
            network_height: 32,
            ..Default::default()
        };
        let (mut model, mut camera) = (null_mut(), null_mut());
        let rgb = [9; 3 * 32 * 32];
        let picture = gedepth_picture {
            bytes: rgb.as_ptr(),
            bytes_len: rgb.len(),
            stride: 0,
            width: 32,
            height: 32,
            format: GEDEPTH_FORMAT_RGB,
            yuv: 0,
            chroma: ptr::null(),
            chroma_len: 0,
            chroma_stride: 0,
        };
        let none = gedepth_map {
            values: null_mut(),
            values_len: 0,
            stride: 0,
        };
        let mut depth = [-1.0; 32 * 32];
        let maps = gedepth_maps {
            depth: gedepth_map {
                values: depth.as_mut_ptr(),
                values_len: depth.len(),
                stride: 0,
            },
            ground: none,
            attention: none,
        };
        // SAFETY: all of this function's; closed at its end.
        unsafe {
            assert_eq!(gedepth_model_open_embedded(0, 1, &mut model), GEDEPTH_OK);
            let opened = gedepth_camera_open(model, &calibration, &options, &mut camera);
            assert_eq!(opened, GEDEPTH_OK);
            let mut under = gedepth_ground::default();
            assert_eq!(gedepth_camera_ground(camera, &mut under), GEDEPTH_OK);
            let run = || gedepth_camera_run(camera, &picture, &maps, 0, null_mut());
            let mut statistics = gedepth_statistics::default();

            let in_use = look(camera.cast_const()).map(gedepth_camera::state);
            assert_eq!(run(), GEDEPTH_BUSY);
            assert_eq!(
                gedepth_camera_statistics(camera, &mut statistics),
                GEDEPTH_BUSY
            );
            let mut ground = gedepth_ground::default();
            assert_eq!(gedepth_camera_ground(camera, &mut ground), GEDEPTH_BUSY);
            assert_eq!(gedepth_camera_set_ground(camera, &under), GEDEPTH_BUSY);
            drop(in_use);
            assert!(depth.iter().all(|&z| z == -1.0));
            assert_eq!(run(), GEDEPTH_OK);
            assert!(depth.iter().all(|&z| z > 0.0));

            let panicked = catch_unwind(AssertUnwindSafe(|| {
                let _in_use = look(camera.cast_const()).map(gedepth_camera::state);
                panic!("as a fault of the library would");
            }));
            assert!(panicked.is_err());
            assert_eq!(run(), GEDEPTH_PANICKED);
            assert_eq!(
                gedepth_camera_open(model, null(), &options, &mut camera),
                crate::result::GEDEPTH_NULL_POINTER
            );
            gedepth_camera_close(camera);
            gedepth_model_close(model);
        }
    }
}
