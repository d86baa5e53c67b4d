//! What `gedepth eval` says: tables in Markdown, and everything as JSON.
//!
//! ```json
//! {
//!   "schema": "gedepth-eval-1",
//!   "protocol": {
//!     "depth_range_m": [0.001, 80], "crop": "none" | "garg", "cloud_threshold_m": 0.1,
//!     "distance_limits_m": [10, 20, 30, 40, 50, 60, 70, 80]
//!   },
//!   "data_sets": [{ "name": "flat", "pictures": 100, "pictures_with_ground_mask": 100 }],
//!   "models": [{
//!     "name": "adaptive-int8", "mode": "baseline" | "vanilla" | "adaptive", "network": "...", "parameters": 1488269,
//!     "by_data_set": [SCORES, in the order of data_sets],
//!     "all": SCORES
//!   }]
//! }
//! ```
//!
//! SCORES has `whole`, `ground`, `not_ground` and `by_distance` (a list in the order of `distance_limits_m`: from the
//! limit before, or 0, up to but without this one), each
//! `{ "pictures", "pixels", "mean": METRICS | null, "pooled": METRICS | null }`;
//! `cloud`, `{ "pictures", "mean", "pooled" }` of `{ "precision", "recall", "f_score", "iou" }`; and `times_ms`:
//! `preprocess`, `network` and `fusion`, each `{ "least", "mean" }` over pictures, `null` without pictures.
//! METRICS are those of [`Metrics`], with its names. `mean` is the mean over pictures of each picture's metrics, `pooled`
//! over all pixels (points) together.

use std::fmt::Write;
use std::time::Duration;

use gedepth::evaluation::{
    CropRule, DISTANCE_LIMITS_M, ErrorScores, Metrics, Protocol, Scores, StageScores,
};
use gedepth_core::metrics::CloudMetrics;
use serde_json::{Value, json};

use super::{Candidate, Measured};

pub(super) struct Report<'a> {
    protocol: &'a Protocol,
    sets: &'a [Measured],
    candidates: &'a [Candidate],
}

/// A table's rows are data sets, each with every model; with more than one set, all together come last.
struct Row<'a> {
    set: &'a str,
    model: &'a str,
    scores: Scores,
}

impl<'a> Report<'a> {
    pub(super) fn new(
        protocol: &'a Protocol,
        sets: &'a [Measured],
        candidates: &'a [Candidate],
    ) -> Self {
        Self {
            protocol,
            sets,
            candidates,
        }
    }

    fn rows(&self) -> Vec<Row<'_>> {
        let mut rows = Vec::new();
        for (index, measured) in self.sets.iter().enumerate() {
            for candidate in self.candidates {
                rows.push(Row {
                    set: &measured.set.name,
                    model: &candidate.name,
                    scores: candidate.scores[index],
                });
            }
        }
        if self.sets.len() > 1 {
            for candidate in self.candidates {
                rows.push(Row {
                    set: "**all**",
                    model: &candidate.name,
                    scores: all(candidate),
                });
            }
        }
        rows
    }

    pub(super) fn markdown(&self) -> String {
        let rows = self.rows();
        let crop = match self.protocol.crop {
            CropRule::None => "in the whole picture",
            CropRule::Garg => "in Garg's crop",
        };
        let mut text = format!(
            "Pixels measured within {} m, {crop}; means over pictures of each picture's metric. Points of clouds match \
             within {} m.\n\n",
            self.protocol.range.max(),
            self.protocol.cloud_threshold_m,
        );
        table(
            &mut text,
            &[
                "data set",
                "model",
                "pictures",
                "Abs Rel",
                "Sq Rel, m",
                "RMSE, m",
                "RMSE log",
                "SILog",
                "delta < 1.25",
                "< 1.25^2",
                "< 1.25^3",
                "F-score",
                "IoU",
            ],
            rows.iter().map(|row| {
                let whole = row.scores.whole;
                let m = whole.mean();
                let c = row.scores.cloud.mean();
                let metric = |value: fn(Metrics) -> f64, digits| number(m.map(value), digits);
                let cloud = |value: fn(CloudMetrics) -> f64| number(c.map(value), 4);
                vec![
                    row.set.to_owned(),
                    row.model.to_owned(),
                    whole.pictures().to_string(),
                    metric(|m| m.abs_rel, 4),
                    metric(|m| m.sq_rel_m, 3),
                    metric(|m| m.rmse_m, 3),
                    metric(|m| m.rmse_log, 4),
                    metric(|m| m.silog, 2),
                    metric(|m| m.delta_1, 4),
                    metric(|m| m.delta_2, 4),
                    metric(|m| m.delta_3, 4),
                    cloud(|c| c.f_score),
                    cloud(|c| c.iou),
                ]
            }),
        );
        self.by_distance(&mut text, &rows, "Abs Rel", 4, |m| m.abs_rel);
        self.by_distance(&mut text, &rows, "RMSE, m,", 3, |m| m.rmse_m);
        self.by_region(&mut text, &rows);
        self.models(&mut text);
        text
    }

    fn by_distance(
        &self,
        text: &mut String,
        rows: &[Row<'_>],
        name: &str,
        digits: usize,
        value: fn(Metrics) -> f64,
    ) {
        let _ = write!(text, "\n{name} by true distance, metres:\n\n");
        let mut head = vec!["data set".to_owned(), "model".to_owned()];
        let mut from = 0.0;
        for to in DISTANCE_LIMITS_M {
            head.push(format!("{from} to {to}"));
            from = to;
        }
        let head: Vec<&str> = head.iter().map(String::as_str).collect();
        table(
            text,
            &head,
            rows.iter().map(|row| {
                let intervals = row.scores.by_distance.iter();
                let mut cells = vec![row.set.to_owned(), row.model.to_owned()];
                cells.extend(intervals.map(|i| number(i.mean().map(value), digits)));
                cells
            }),
        );
    }

    fn by_region(&self, text: &mut String, rows: &[Row<'_>]) {
        let pictures: u64 = self.sets.iter().map(|set| set.pictures).sum();
        let masks: u64 = self.sets.iter().map(|set| set.masks).sum();
        let _ = write!(
            text,
            "\nOn the ground and off it (ground by mask in {masks} pictures, by slope of the measured depth in {}):\n\n",
            pictures - masks
        );
        table(
            text,
            &[
                "data set",
                "model",
                "ground: share of pixels",
                "Abs Rel",
                "RMSE, m",
                "SILog",
                "not ground: Abs Rel",
                "RMSE, m",
                "SILog",
            ],
            rows.iter().map(|row| {
                let (ground, other) = (row.scores.ground, row.scores.not_ground);
                let share =
                    ground.pixels() as f64 / (ground.pixels() + other.pixels()).max(1) as f64;
                let mut cells = vec![
                    row.set.to_owned(),
                    row.model.to_owned(),
                    format!("{:.1} %", 100.0 * share),
                ];
                for region in [ground, other] {
                    let m = region.mean();
                    cells.push(number(m.map(|m| m.abs_rel), 4));
                    cells.push(number(m.map(|m| m.rmse_m), 3));
                    cells.push(number(m.map(|m| m.silog), 2));
                }
                cells
            }),
        );
    }

    fn models(&self, text: &mut String) {
        text.push_str("\nThe models; times in ms are those of the quickest picture / the mean over pictures:\n\n");
        table(
            text,
            &[
                "model",
                "mode",
                "parameters",
                "preprocess",
                "network",
                "fusion",
            ],
            self.candidates.iter().map(|candidate| {
                let times = all(candidate).times;
                let time = |stage: StageScores| match (stage.least(), stage.mean()) {
                    (Some(least), Some(mean)) => format!("{:.1} / {:.1}", ms(least), ms(mean)),
                    _ => "-".to_owned(),
                };
                vec![
                    candidate.name.clone(),
                    candidate.model.contract().mode.to_string(),
                    format!("{:.3} M", candidate.model.parameters() as f64 / 1e6),
                    time(times.preprocess),
                    time(times.network),
                    time(times.fusion),
                ]
            }),
        );
    }

    pub(super) fn json(&self) -> String {
        let range = self.protocol.range;
        let value = json!({
            "schema": "gedepth-eval-1",
            "protocol": {
                "depth_range_m": [range.min(), range.max()],
                "crop": match self.protocol.crop {
                    CropRule::None => "none",
                    CropRule::Garg => "garg",
                },
                "cloud_threshold_m": self.protocol.cloud_threshold_m,
                "distance_limits_m": DISTANCE_LIMITS_M,
            },
            "data_sets": self.sets.iter().map(|measured| json!({
                "name": measured.set.name,
                "pictures": measured.pictures,
                "pictures_with_ground_mask": measured.masks,
            })).collect::<Vec<_>>(),
            "models": self.candidates.iter().map(|candidate| {
                let contract = candidate.model.contract();
                json!({
                    "name": candidate.name,
                    "mode": contract.mode.to_string(),
                    "network": contract.network,
                    "parameters": candidate.model.parameters(),
                    "by_data_set": candidate.scores.iter().map(scores).collect::<Vec<_>>(),
                    "all": scores(&all(candidate)),
                })
            }).collect::<Vec<_>>(),
        });
        format!("{value:#}\n")
    }
}

/// A candidate's scores over all data sets.
fn all(candidate: &Candidate) -> Scores {
    let mut all = Scores::default();
    for scores in &candidate.scores {
        all.merge(scores);
    }
    all
}

fn scores(scores: &Scores) -> Value {
    let errors = |e: &ErrorScores| json!({ "pictures": e.pictures(), "pixels": e.pixels(), "mean": e.mean(), "pooled": e.pooled() });
    let cloud = |metrics: Option<CloudMetrics>| {
        metrics.map(|m| {
            json!({ "precision": m.precision, "recall": m.recall, "f_score": m.f_score, "iou": m.iou })
        })
    };
    let time = |stage: StageScores| json!({ "least": stage.least().map(ms), "mean": stage.mean().map(ms) });
    json!({
        "whole": errors(&scores.whole),
        "by_distance": scores.by_distance.iter().map(errors).collect::<Vec<_>>(),
        "ground": errors(&scores.ground),
        "not_ground": errors(&scores.not_ground),
        "cloud": {
            "pictures": scores.cloud.pictures(),
            "mean": cloud(scores.cloud.mean()),
            "pooled": cloud(scores.cloud.pooled()),
        },
        "times_ms": {
            "preprocess": time(scores.times.preprocess),
            "network": time(scores.times.network),
            "fusion": time(scores.times.fusion),
        },
    })
}

fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

fn table(text: &mut String, head: &[&str], rows: impl Iterator<Item = Vec<String>>) {
    let _ = writeln!(text, "| {} |", head.join(" | "));
    let _ = writeln!(text, "|{}", "---|".repeat(head.len()));
    for row in rows {
        // Names of files may hold what ends a cell or a row.
        let cells = row
            .iter()
            .map(|cell| cell.replace('|', "\\|").replace(['\n', '\r'], " "));
        let _ = writeln!(text, "| {} |", cells.collect::<Vec<_>>().join(" | "));
    }
}
