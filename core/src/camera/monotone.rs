//! Inverting an increasing function of one variable: how radial distortions are undone.

/// Where an increasing `f` on `[0, end]` takes the value `target`, which must lie between `f(0) = 0` and `f(end)`;
/// `f` gives value and slope, `start` is a first guess. To 1e-9 of `end`, or of 1 where that is less, and mostly far better.
#[inline]
pub(super) fn invert(f: impl Fn(f64) -> [f64; 2], target: f64, start: f64, end: f64) -> f64 {
    // Newton's steps, and halving where one would leave the bracket.
    let (mut low, mut high) = (0.0, end);
    // In this order NaN becomes 0.
    let mut x = start.max(low).min(high);
    let enough = 1e-5 * end.min(1.0);
    for _ in 0..60 {
        let [value, slope] = f(x);
        let miss = target - value;
        if miss < 0.0 {
            high = x;
        } else {
            low = x;
        }
        let next = x + miss / slope;
        if !(low..=high).contains(&next) {
            x = 0.5 * (low + high);
            continue;
        }
        let step = next - x;
        x = next;
        // What is left is of the order of the square of the step, and more where the function is flat.
        if step.abs() <= enough * slope.min(1.0) {
            break;
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use core::cell::Cell;

    use super::invert;

    /// A good start is all that is needed: Newton's first step is tried, found small, and kept.
    #[test]
    fn good_starts_end_at_once() {
        for (start, most) in [(0.7 + 1e-6, 1), (0.7 - 1e-3, 2), (0.9, 4)] {
            let calls = Cell::new(0);
            let f = |x: f64| {
                calls.set(calls.get() + 1);
                [x + 0.2 * x * x, 1.0 + 0.4 * x]
            };
            let x = invert(f, 0.7 + 0.2 * 0.49, start, 2.0);
            assert!((x - 0.7).abs() < 1e-9);
            assert!(calls.get() <= most, "from {start}: {} steps", calls.get());
        }
    }

    /// Newton alone would leave the bracket from these starts, or never settle.
    #[test]
    fn steep_flat_and_badly_started() {
        let cubic = |x: f64| [x * x * x, 3.0 * x * x];
        // Steps around the flat middle at 0.5.
        let saddle = |x: f64| {
            let d = x - 0.5;
            [d * d * d + 1e-3 * d + 0.1255, 3.0 * d * d + 1e-3]
        };
        for start in [0.0, 1e-9, 0.5, 1.0, -3.0, 7.0, f64::NAN] {
            for target in [1e-6, 0.1255, 0.3, 1.0] {
                let x = invert(cubic, target, start, 1.0);
                assert!((x * x * x - target).abs() < 1e-9, "from {start}: {x}");
            }
            for target in [0.01, 0.1255, 0.2] {
                let x = invert(saddle, target, start, 1.0);
                assert!((saddle(x)[0] - target).abs() < 1e-9, "from {start}: {x}");
            }
        }
    }
}
