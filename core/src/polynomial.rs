//! Functions of `f32` for inner loops: without branches or tables, so that they vectorize, and with the same bits on every
//! processor.

/// `x` between `low` and `high`; NaN becomes `low`. One instruction each, where `f32::max` and `min` take three for NaN.
#[inline(always)]
pub(crate) fn clamp(x: f32, low: f32, high: f32) -> f32 {
    let x = if x > low { x } else { low };
    if x < high { x } else { high }
}

/// `e^x`, to 2e-7 relative from -87 to 88; beyond, its value at the nearer end. NaN counts as -87.
///
/// One polynomial, no branch, no table: it vectorizes, and gives the same bits on every processor.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    let x = clamp(x, -87.0, 88.0);
    // x = n ln 2 + r. Adding 1.5 * 2^23 rounds to the nearest integer and leaves n in the low bits.
    const ROUND: f32 = 12_582_912.0;
    let shifted = x * core::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    // ln 2 in two parts, the first short enough that its product with n is exact.
    let r = x - n * 0.693_359_4 + n * 2.121_944_4e-4;
    // 1 + r + r^2 q(r), q the cubic of least relative error for |r| <= 0.347: 1.1e-7. In pairs, which leaves half as many
    // steps that wait for one another.
    let s = r * r;
    let q = (0.499_992_3 + 0.166_671_16 * r) + s * (0.041_890_55 + 0.008_312_48 * r);
    let p = 1.0 + (r + s * q);
    let power = f32::from_bits((shifted.to_bits() << 23).wrapping_add(0x3f80_0000));
    p * power
}

/// `tan x` for |x| up to 0.53 (30.3 degrees), to 2e-7 relative: its series up to x^15.
#[inline(always)]
pub(crate) fn tan(x: f32) -> f32 {
    let s = x * x;
    let p = 929_569.0 / 638_512_875.0 * s + 21_844.0 / 6_081_075.0;
    let p = p * s + 1_382.0 / 155_925.0;
    let p = p * s + 62.0 / 2_835.0;
    let p = p * s + 17.0 / 315.0;
    let p = p * s + 2.0 / 15.0;
    let p = p * s + 1.0 / 3.0;
    x + x * (s * p)
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::{clamp, exp, tan};

    /// Every 97th float from -87 to 88 against f64.
    #[test]
    fn exp_is_within_2e_7() {
        let mut x = -87.0_f32;
        while x < 88.0 {
            let truth = f64::from(x).exp();
            let error = (f64::from(exp(x)) / truth - 1.0).abs();
            assert!(error < 2e-7, "exp({x}) is off by {error}");
            let step = if x < 0.0 {
                x.to_bits() - 97
            } else {
                x.to_bits() + 97
            };
            x = if x < 0.0 && x > -1e-30 {
                1e-30
            } else {
                f32::from_bits(step)
            };
        }
    }

    #[test]
    fn exp_at_its_ends() {
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(exp(-1e30), exp(-87.0));
        assert_eq!(exp(f32::NEG_INFINITY), exp(-87.0));
        assert_eq!(exp(f32::INFINITY), exp(88.0));
        assert_eq!(exp(f32::NAN), exp(-87.0));
        assert!(exp(88.0).is_finite() && exp(-87.0) > 0.0);
    }

    /// All angles that the mean of slope classes may have, and a little more.
    #[test]
    fn tan_is_within_2e_7() {
        for i in -53_000..=53_000 {
            let x = i as f32 * 1e-5;
            let truth = f64::from(x).tan();
            let error = (f64::from(tan(x)) - truth).abs();
            assert!(error <= 2e-7 * truth.abs(), "tan({x}) is off by {error}");
        }
    }

    #[test]
    fn clamp_catches_nan() {
        assert_eq!(clamp(f32::NAN, 1.0, 2.0), 1.0);
        assert_eq!(clamp(0.5, 1.0, 2.0), 1.0);
        assert_eq!(clamp(1.5, 1.0, 2.0), 1.5);
        assert_eq!(clamp(2.5, 1.0, 2.0), 2.0);
        assert!(clamp(-0.0, 0.0, 1.0).is_sign_positive());
    }
}
