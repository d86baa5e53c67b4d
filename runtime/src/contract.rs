//! The model contract: what a network says about itself in its own ONNX metadata (`metadata_props`), so that
//! the file alone is enough to run it.
//!
//! Every entry's key starts with `gedepth.`; [`Contract::from_metadata`] reads them and names the entry that is
//! missing, malformed or contradictory.
//!
//! | entry | values | needed by |
//! |---|---|---|
//! | `contract` | `1` | all |
//! | `mode` | `baseline`, `vanilla`, `adaptive` | all |
//! | `fusion` | `runtime` (the outputs are heads), `graph` (the output is the depth, metres) | all |
//! | `input` | name of the input, f32 `[1, channels, height, width]` | all |
//! | `channels` | list of `red`, `green`, `blue`, once each, and `inverse_ground_depth`, `ground_depth` or `ground_depth_unfiltered`, which a baseline has not | all |
//! | `mean`, `std` | three numbers each, of red, green and blue in 0 to 255, whatever the order of the channels; `std` at least 1 | all |
//! | `size_multiple` | height and width are multiples of this, 1 to 1024 | all |
//! | `nominal_size` | `WIDTHxHEIGHT` the network was made for: such multiples, at most 16384 a side and 2^24 pixels | all |
//! | `fit` | `resize` (default), `crop`: bottom-centre crop, no resampling | optional |
//! | `ground_scale_m` | metres, positive; see [`GroundChannel`] | a ground channel |
//! | `ground_limit` | bound of the scaled channel, positive; see [`GroundChannel`] | a scaled ground channel |
//! | `residual` | name of the output `[1, 1, h, w]`; with `fusion` = `graph`, of the depth | all |
//! | `residual_form` | `depth` (metres), `log_depth` (its natural logarithm), `log_metres_per_pixel` (that of `z / f`) | fusion in the runtime |
//! | `attention`, `attention_form` | name of the output; `logit`, `probability` | vanilla, adaptive in the runtime |
//! | `slope` | name of the output `[1, classes, h, w]`, logits | adaptive in the runtime |
//! | `slope_angles_deg` | one angle per class, degrees, ascending: 1 to 64, within 30 either way | as above |
//! | `slope_sign` | `downhill_positive` (paper, Eq. 6), `uphill_positive` | as above |
//! | `slope_order` | `softmax_then_upsample`, `upsample_then_softmax` | as above |
//! | `upsampling` | `half_pixel`, `align_corners` | fusion in the runtime |
//! | `depth_range_m` | `MIN,MAX` of the depth, metres, `0 < MIN < MAX`; ground beyond `MAX` counts as none | all |
//! | `stride` | input pixels per pixel of the heads; for people, the outputs tell | optional |
//! | `network`, `training` | one line of text each | optional |
//!
//! Entries of a head that the mode does not have are refused.
//!
//! `f` is the focal length `sqrt(fx fy)` in pixels of the network's input: `z / f` is what a pixel spans there, and what a thing of known
//! size tells, whatever the lens.
//!
//! Heads are decoded where their samples are and upsampled then: residuals to metres, attention to 0 to 1. So train them; only of slopes `slope_order` may
//! say otherwise.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use gedepth_core::Angle;
use gedepth_core::fusion::{AttentionUnit, DecodeAt, DepthRange, Upsampling};
use gedepth_core::slope::{SlopeClasses, SlopeSign};

/// Longest side that a network is run at, pixels.
pub(crate) const MAX_SIDE: u32 = 16384;

const PREFIX: &str = "gedepth.";
/// The one version of the contract that this crate reads.
const VERSION: &str = "1";
const SLOPE_ANGLES: &str = "1 to 64 ascending angles within -30 to 30 degrees";
const DEPTH_RANGE: &str = "MIN,MAX in metres with 0 < MIN < MAX";

/// How the network uses the ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// No ground embedding: depth is the residual.
    Baseline,
    /// Ground plane: `depth = M z_plane + (1 - M) z_residual`.
    Vanilla,
    /// Undulating ground: as vanilla, with `z_slope` of Eq. 7 from the network's slope classes.
    Adaptive,
}

/// What one input channel holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Red, normalised with mean and standard deviation.
    Red,
    /// Green, likewise.
    Green,
    /// Blue, likewise.
    Blue,
    /// The ground as the camera sees it.
    Ground(GroundChannel),
}

/// The forms in which a network sees the ground; `z` is the planar ground depth in metres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GroundChannel {
    /// `clamp(ground_scale_m / z, -ground_limit, ground_limit)`, with its sign above the vanishing line.
    InverseDepth,
    /// `z / ground_scale_m`, 0 where there is no ground or `z > ground_limit` metres (the reference: both 200).
    Depth,
    /// `z` in metres, unfiltered and signed (the reference's fifth channel, read by its slope formula only).
    DepthUnfiltered,
}

/// How a picture is brought to the network's size.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fit {
    /// The bottom-centre part of the picture with the network's proportions, resampled to its size.
    #[default]
    Resize,
    /// The bottom-centre part of the picture of exactly the network's size (KITTI's "KB crop").
    Crop,
}

/// What the residual head's numbers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResidualForm {
    /// Depth, metres.
    Depth,
    /// Natural logarithm of the depth in metres.
    LogDepth,
    /// Natural logarithm of `z / f`, metres per pixel of the network's input.
    LogMetresPerPixel,
}

/// Where residual, attention and slope become depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FusionPlace {
    /// The network's outputs are heads; core's fusion makes the depth.
    Runtime,
    /// The network's output is the depth.
    Graph,
}

/// The attention head.
#[derive(Clone, Debug, PartialEq)]
pub struct Attention {
    /// Name of the output, `[1, 1, h, w]`.
    pub output: String,
    /// What its numbers are.
    pub unit: AttentionUnit,
}

/// The slope head.
#[derive(Clone, Debug, PartialEq)]
pub struct Slope {
    /// Name of the output, `[1, classes, h, w]`, logits.
    pub output: String,
    /// The angles of its classes.
    pub classes: SlopeClasses,
    /// Where softmax, expectation and tangent are taken.
    pub decode_at: DecodeAt,
}

/// What a network says about itself. See the module for the entries.
#[derive(Clone, Debug, PartialEq)]
pub struct Contract {
    /// How it uses the ground.
    pub mode: Mode,
    /// Where the fusion happens.
    pub fusion: FusionPlace,
    /// Name of the input.
    pub input: String,
    /// Its channels, in order.
    pub channels: Vec<Channel>,
    /// Mean of red, green, blue, in 0 to 255.
    pub mean: [f32; 3],
    /// Standard deviation of red, green, blue, in 0 to 255; at least 1.
    pub std: [f32; 3],
    /// Height and width are multiples of this.
    pub size_multiple: u32,
    /// Width and height that the network was made for.
    pub nominal_size: (u32, u32),
    /// How a picture is brought to the network's size.
    pub fit: Fit,
    /// Scale of the ground channels, metres; 1 where there is none.
    pub ground_scale_m: f32,
    /// Bound of the ground channels; see [`GroundChannel`].
    pub ground_limit: f32,
    /// Name of the residual output, or of the depth output where the graph fuses.
    pub residual: String,
    /// What its numbers are.
    pub residual_form: ResidualForm,
    /// The attention head; `None` in baselines and where the graph fuses.
    pub attention: Option<Attention>,
    /// The slope head; `None` unless adaptive and fused in the runtime.
    pub slope: Option<Slope>,
    /// Where the heads' samples lie.
    pub upsampling: Upsampling,
    /// Least and greatest depth; ground beyond the greatest counts as none.
    pub depth_range: DepthRange,
    /// What the network is, in one line, or empty.
    pub network: String,
    /// How it was trained, in one line, or empty.
    pub training: String,
}

/// What is wrong with a contract, and in which entry.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ContractError {
    /// There is no contract at all: an ONNX file of another kind.
    #[error(
        "the model has no gedepth contract: its ONNX metadata has no entry `gedepth.contract`; export it with the contract's entries"
    )]
    Absent,
    /// An entry that the mode needs is not there.
    #[error("the model's contract lacks the entry `gedepth.{0}`")]
    Missing(&'static str),
    /// An entry cannot be read.
    #[error("the model's contract has `gedepth.{entry}` = `{value}`; expected {expected}")]
    Malformed {
        /// Key without its prefix.
        entry: &'static str,
        /// What the file says.
        value: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// Two entries exclude each other.
    #[error("the model's contract contradicts itself: `gedepth.{entry}` {reason}")]
    Contradictory {
        /// Key without its prefix.
        entry: String,
        /// What about it.
        reason: &'static str,
    },
    /// An entry stands there more than once.
    #[error("the model's contract has the entry `gedepth.{0}` more than once; leave one")]
    Repeated(String),
    /// An entry that this version does not know: it may change the meaning of others.
    #[error(
        "the model's contract has the unknown entry `gedepth.{0}`: misspelt, or made for a newer gedepth"
    )]
    Unknown(String),
}

/// The entries of the metadata, taken out one by one so that what remains is unknown.
struct Entries(BTreeMap<String, String>);

impl Entries {
    fn optional(&mut self, entry: &'static str) -> Option<String> {
        self.0.remove(entry)
    }

    fn text(&mut self, entry: &'static str) -> Result<String, ContractError> {
        match self.optional(entry) {
            Some(value) if value.is_empty() => Err(ContractError::Malformed {
                entry,
                value,
                expected: "a name",
            }),
            Some(value) => Ok(value),
            None => Err(ContractError::Missing(entry)),
        }
    }

    fn choice<T: Copy>(
        &mut self,
        entry: &'static str,
        choices: &[(&str, T)],
        expected: &'static str,
    ) -> Result<T, ContractError> {
        let value = self.text(entry)?;
        match choices.iter().find(|(name, _)| *name == value) {
            Some((_, choice)) => Ok(*choice),
            None => Err(ContractError::Malformed {
                entry,
                value,
                expected,
            }),
        }
    }

    /// A list of numbers, separated by `separator`, that passes `valid`.
    fn numbers<T: FromStr>(
        &mut self,
        entry: &'static str,
        separator: char,
        expected: &'static str,
        valid: impl Fn(&[T]) -> bool,
    ) -> Result<Vec<T>, ContractError> {
        let value = self.text(entry)?;
        match value
            .split(separator)
            .map(|n| n.trim().parse())
            .collect::<Result<Vec<T>, _>>()
        {
            Ok(numbers) if valid(&numbers) => Ok(numbers),
            _ => Err(ContractError::Malformed {
                entry,
                value,
                expected,
            }),
        }
    }
}

impl Contract {
    /// Reads the contract from the model's metadata (keys with their prefix; foreign keys are ignored).
    pub fn from_metadata<'a>(
        metadata: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, ContractError> {
        let mut entries = Entries(BTreeMap::new());
        for (key, value) in metadata {
            let Some(key) = key.strip_prefix(PREFIX) else {
                continue;
            };
            if entries.0.insert(key.to_owned(), value.to_owned()).is_some() {
                return Err(ContractError::Repeated(key.to_owned()));
            }
        }
        match entries.optional("contract") {
            None => return Err(ContractError::Absent),
            Some(version) if version == VERSION => {}
            Some(value) => {
                return Err(ContractError::Malformed {
                    entry: "contract",
                    value,
                    expected: "version 1",
                });
            }
        }
        let mode = entries.choice(
            "mode",
            &[
                ("baseline", Mode::Baseline),
                ("vanilla", Mode::Vanilla),
                ("adaptive", Mode::Adaptive),
            ],
            "baseline, vanilla or adaptive",
        )?;
        let fusion = entries.choice(
            "fusion",
            &[
                ("runtime", FusionPlace::Runtime),
                ("graph", FusionPlace::Graph),
            ],
            "runtime or graph",
        )?;
        let heads = fusion == FusionPlace::Runtime;
        let input = entries.text("input")?;
        let channels = channels(entries.text("channels")?)?;
        let has_ground = channels.iter().any(|c| matches!(c, Channel::Ground(_)));
        if has_ground && mode == Mode::Baseline {
            return Err(ContractError::Contradictory {
                entry: "channels".to_owned(),
                reason: "show the ground, but the mode is baseline",
            });
        }
        let scaled = channels.iter().any(|c| {
            matches!(
                c,
                Channel::Ground(GroundChannel::Depth | GroundChannel::InverseDepth)
            )
        });
        let rgb = |n: &[f32]| n.len() == 3 && n.iter().all(|x| x.is_finite());
        let mean = entries.numbers("mean", ',', "three numbers", rgb)?;
        let expected = "three numbers of at least 1, in steps of 0 to 255 as pictures have (0.229 of 0 to 1 is 58.395)";
        let std = entries.numbers("std", ',', expected, |n: &[f32]| {
            rgb(n) && n.iter().all(|&x| x >= 1.0)
        })?;
        let size_multiple = entries.numbers(
            "size_multiple",
            ',',
            "a number from 1 to 1024",
            |n: &[u32]| matches!(n, [1..=1024]),
        )?[0];
        let nominal_size = entries.numbers(
            "nominal_size",
            'x',
            "WIDTHxHEIGHT, multiples of size_multiple",
            |n| {
                n.len() == 2
                    && n.iter()
                        .all(|&s| (1..=MAX_SIDE).contains(&s) && s % size_multiple == 0)
            },
        )?;
        let fit = match entries.0.contains_key("fit") {
            false => Fit::default(),
            true => entries.choice(
                "fit",
                &[("resize", Fit::Resize), ("crop", Fit::Crop)],
                "resize or crop",
            )?,
        };
        let positive = |n: &[f32]| matches!(n, [x] if x.is_finite() && *x > 0.0);
        let (mut ground_scale_m, mut ground_limit) = (1.0, f32::MAX);
        if scaled {
            ground_scale_m = entries.numbers(
                "ground_scale_m",
                ',',
                "a positive number of metres",
                positive,
            )?[0];
            ground_limit = entries.numbers("ground_limit", ',', "a positive number", positive)?[0];
        }
        let residual = entries.text("residual")?;
        let residual_form = match heads {
            false => ResidualForm::Depth,
            true => entries.choice(
                "residual_form",
                &[
                    ("depth", ResidualForm::Depth),
                    ("log_depth", ResidualForm::LogDepth),
                    ("log_metres_per_pixel", ResidualForm::LogMetresPerPixel),
                ],
                "depth, log_depth or log_metres_per_pixel",
            )?,
        };
        let attention = match mode != Mode::Baseline && heads {
            false => None,
            true => Some(Attention {
                output: entries.text("attention")?,
                unit: entries.choice(
                    "attention_form",
                    &[
                        ("logit", AttentionUnit::Logit),
                        ("probability", AttentionUnit::Probability),
                    ],
                    "logit or probability",
                )?,
            }),
        };
        let slope = match mode == Mode::Adaptive && heads {
            false => None,
            true => Some(slope(&mut entries)?),
        };
        let upsampling = match heads {
            false => Upsampling::HalfPixel,
            true => entries.choice(
                "upsampling",
                &[
                    ("half_pixel", Upsampling::HalfPixel),
                    ("align_corners", Upsampling::AlignCorners),
                ],
                "half_pixel or align_corners",
            )?,
        };
        let range = entries.numbers("depth_range_m", ',', DEPTH_RANGE, |n: &[f32]| n.len() == 2)?;
        let depth_range =
            DepthRange::new(range[0], range[1]).map_err(|_| ContractError::Malformed {
                entry: "depth_range_m",
                value: format!("{},{}", range[0], range[1]),
                expected: DEPTH_RANGE,
            })?;
        let network = entries.optional("network").unwrap_or_default();
        let training = entries.optional("training").unwrap_or_default();
        // The strides are read from the outputs themselves; the entry is for people.
        entries.optional("stride");
        if let Some(unknown) = entries.0.into_keys().next() {
            let reason = match unknown.as_str() {
                "residual_form" | "upsampling" | "attention" | "attention_form" | "slope"
                | "slope_angles_deg" | "slope_sign" | "slope_order" => {
                    "describes a head that its mode and place of fusion exclude"
                }
                "ground_scale_m" | "ground_limit" => {
                    "is of a scaled ground channel, which is not among its channels"
                }
                _ => return Err(ContractError::Unknown(unknown)),
            };
            return Err(ContractError::Contradictory {
                entry: unknown,
                reason,
            });
        }
        Ok(Self {
            mode,
            fusion,
            input,
            channels,
            mean: [mean[0], mean[1], mean[2]],
            std: [std[0], std[1], std[2]],
            size_multiple,
            nominal_size: (nominal_size[0], nominal_size[1]),
            fit,
            ground_scale_m,
            ground_limit,
            residual,
            residual_form,
            attention,
            slope,
            upsampling,
            depth_range,
            network,
            training,
        })
    }
}

fn channels(list: String) -> Result<Vec<Channel>, ContractError> {
    let channels = list.split(',').map(|name| {
        Some(match name.trim() {
            "red" => Channel::Red,
            "green" => Channel::Green,
            "blue" => Channel::Blue,
            "inverse_ground_depth" => Channel::Ground(GroundChannel::InverseDepth),
            "ground_depth" => Channel::Ground(GroundChannel::Depth),
            "ground_depth_unfiltered" => Channel::Ground(GroundChannel::DepthUnfiltered),
            _ => return None,
        })
    });
    match channels.collect::<Option<Vec<_>>>() {
        Some(channels)
            if [Channel::Red, Channel::Green, Channel::Blue]
                .iter()
                .all(|colour| channels.iter().filter(|c| *c == colour).count() == 1) =>
        {
            Ok(channels)
        }
        _ => Err(ContractError::Malformed {
            entry: "channels",
            value: list,
            expected: "red, green and blue once each, and any of inverse_ground_depth, ground_depth, ground_depth_unfiltered",
        }),
    }
}

fn slope(entries: &mut Entries) -> Result<Slope, ContractError> {
    let output = entries.text("slope")?;
    let degrees: Vec<f64> = entries.numbers("slope_angles_deg", ',', SLOPE_ANGLES, |_| true)?;
    let sign = entries.choice(
        "slope_sign",
        &[
            ("downhill_positive", SlopeSign::DownhillPositive),
            ("uphill_positive", SlopeSign::UphillPositive),
        ],
        "downhill_positive or uphill_positive",
    )?;
    let angles: Vec<Angle> = degrees.iter().copied().map(Angle::from_degrees).collect();
    let classes = SlopeClasses::new(&angles, sign).map_err(|_| ContractError::Malformed {
        entry: "slope_angles_deg",
        value: degrees
            .iter()
            .map(f64::to_string)
            .collect::<Vec<_>>()
            .join(","),
        expected: SLOPE_ANGLES,
    })?;
    Ok(Slope {
        output,
        classes,
        decode_at: entries.choice(
            "slope_order",
            &[
                ("softmax_then_upsample", DecodeAt::HeadSize),
                ("upsample_then_softmax", DecodeAt::OutputSize),
            ],
            "softmax_then_upsample or upsample_then_softmax",
        )?,
    })
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Mode::Baseline => "baseline",
            Mode::Vanilla => "vanilla",
            Mode::Adaptive => "adaptive",
        })
    }
}
