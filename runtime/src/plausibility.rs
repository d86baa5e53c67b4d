//! Signs that a calibration and what a picture shows do not belong together: numbers for a monitor to watch over many
//! pictures. An input to a safety argument, not one: each can be right by chance, and none sees every fault.

use gedepth_core::Error;
use gedepth_core::table::GroundRows;

/// Attention from which on a pixel's depth is the ground's rather than the residual's.
const TRUSTED: f32 = 0.5;

/// What one picture says about its calibration, at the output's pixels. `None`: there is no such pixel, or no attention.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plausibility {
    /// Share of the pixels where the calibration has ground within the model's range; 0 to 1. The same for every picture until
    /// [`set_ground`](crate::Estimator::set_ground).
    pub ground_share: f32,
    /// Share of those where the ground is trusted: the attention is at least 1/2. It falls when the ground is hidden or wet,
    /// the lens is dirty, or the calibration is of another camera.
    pub trusted_share: Option<f32>,
    /// Mean attention about the vanishing line, where the ground is farther than the model's range, above the line as
    /// below. There is no ground to trust there: it rises when the camera's pitch is not the calibration's.
    pub attention_at_line: Option<f32>,
    /// Mean of `|z - z_table| / z_table` where the ground is trusted, `z` the depth, `z_table` the flat ground's: slope of
    /// the road, or a wrong pitch or height.
    pub ground_residual: Option<f32>,
}

impl Plausibility {
    /// `ground` is the flat ground's inverse depth, 1/m, negative above the vanishing line; `scratch` has room for a row of
    /// it; `farthest` is the model's range, metres; maps have the ground's size. Allocates nothing.
    pub(crate) fn of<G: GroundRows>(
        ground: &G,
        scratch: &mut [f32],
        farthest: f32,
        depth: &[f32],
        attention: Option<&[f32]>,
    ) -> Result<Self, Error> {
        let width = ground.size().width() as usize;
        let scratch = scratch.get_mut(..width).unwrap_or_default();
        let mut in_range = 0_u32;
        let (mut trusted, mut residuals) = (0_u32, 0.0_f64);
        let (mut at_line, mut attentions) = (0_u32, 0.0_f64);
        let mut attention_rows = attention.map(|map| map.chunks_exact(width));
        for (v, depth) in (0..).zip(depth.chunks_exact(width)) {
            ground.write_row(v, scratch)?;
            let attention = attention_rows.as_mut().and_then(Iterator::next);
            for (u, (&inverse, &z)) in scratch.iter().zip(depth).enumerate() {
                let attention = attention.and_then(|attention| attention.get(u).copied());
                if inverse * farthest >= 1.0 {
                    in_range += 1;
                    if attention.is_some_and(|m| m >= TRUSTED) {
                        trusted += 1;
                        residuals += f64::from((z * inverse - 1.0).abs());
                    }
                } else if inverse * farthest > -1.0 {
                    at_line += 1;
                    attentions += f64::from(attention.unwrap_or(0.0));
                }
            }
        }
        let mean = |sum: f64, count: u32| (count > 0).then(|| (sum / f64::from(count)) as f32);
        Ok(Self {
            ground_share: mean(f64::from(in_range), depth.len() as u32).unwrap_or(0.0),
            trusted_share: attention.and(mean(f64::from(trusted), in_range)),
            attention_at_line: attention.and(mean(attentions, at_line)),
            ground_residual: mean(residuals, trusted),
        })
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use gedepth_core::camera::ImageSize;
    use gedepth_core::table::GroundView;

    use super::*;

    // 1/m, to be read with a range of 80 m: sky, line, line, ground at 50, 20, 10 and 5 m, and sky.
    const TABLE: [f32; 8] = [-0.2, -0.01, 0.01, 0.02, 0.05, 0.1, 0.2, -1.0];
    const DEPTH: [f32; 8] = [70.0, 60.0, 60.0, 40.0, 22.0, 10.0, 7.0, 3.0];
    const ATTENTION: [f32; 8] = [1.0, 0.25, 0.75, 0.5, 0.9, 1.0, 0.4, 1.0];

    fn of(table: &[f32; 8], attention: Option<&[f32]>) -> Plausibility {
        let size = ImageSize::new(4, 2).expect("a size");
        let view = GroundView::from_values(table, size, 1.5).expect("a table");
        Plausibility::of(&view, &mut [0.0; 5], 80.0, &DEPTH, attention).expect("numbers")
    }

    #[test]
    fn each_number_is_of_its_pixels() {
        let seen = of(&TABLE, Some(&ATTENTION));
        assert_eq!(seen.ground_share, 0.5);
        assert_eq!(seen.trusted_share, Some(0.75));
        assert_eq!(seen.attention_at_line, Some(0.5));
        // 10 of 50 m, 2 of 20 m, 0 of 10 m; that at 5 m is not trusted.
        let residual = seen.ground_residual.unwrap_or(f32::NAN);
        assert!((residual - 0.1).abs() < 1e-6, "{residual}");
    }

    #[test]
    fn nothing_is_said_about_what_is_not_there() {
        let baseline = of(&TABLE, None);
        let nothing = (None, None, None);
        let said = |p: Plausibility| (p.trusted_share, p.attention_at_line, p.ground_residual);
        assert_eq!((baseline.ground_share, said(baseline)), (0.5, nothing));
        let sky = of(&[-1.0; 8], Some(&ATTENTION));
        assert_eq!((sky.ground_share, said(sky)), (0.0, nothing));
    }
}
