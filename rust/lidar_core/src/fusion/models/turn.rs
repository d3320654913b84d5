//! Motion along an arc: exact integrals over a step, without cancellation at small turn rates.

/// Turn angle up to which the series are used [rad].
const SERIES_UP_TO: f64 = 0.5;
/// Terms of the series: the first omitted term is below 1e-17 at `SERIES_UP_TO`.
const TERMS: usize = 7;
/// Terms of the series for turn angles below `SHORT_UP_TO`, with the same error.
const SHORT: usize = 4;
/// Turn angle up to which the shorter series is used [rad].
const SHORT_UP_TO: f64 = 0.03;

/// Integrals of t^k cos(w t) and t^k sin(w t) over a step, for k = 0 to K - 1, K at most 3.
///
/// The displacement (A, B) of the models is moment 0 turned by the heading. Its derivatives by the
/// turn rate are moments 1 and 2, each turned by a further quarter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn<const K: usize> {
    /// Displacement along the heading at the start [s^(k + 1)].
    pub along: [f64; K],
    /// Displacement to the left of that heading [s^(k + 1)].
    pub aside: [f64; K],
}

impl<const K: usize> Turn<K> {
    /// A step of `dt` [s] at the turn rate `rate` [rad/s].
    #[must_use]
    pub fn new(rate: f64, dt: f64) -> Self {
        let angle = rate * dt;
        // The closed forms divide by the angle once per moment: near zero all their digits would
        // cancel, and straight flight is the common case.
        let (along, aside) = if angle.abs() < SHORT_UP_TO {
            by_series::<K, SHORT>(angle)
        } else if angle.abs() < SERIES_UP_TO {
            by_series::<K, TERMS>(angle)
        } else {
            let (along, aside) = closed(angle);
            (std::array::from_fn(|k| along[k]), std::array::from_fn(|k| aside[k]))
        };
        let scale = [dt, dt * dt, dt * dt * dt];
        let scaled = |unit: [f64; K]| std::array::from_fn(|k| unit[k] * scale[k]);
        Self { along: scaled(along), aside: scaled(aside) }
    }

    /// Moment `k` for a start with the heading whose cosine and sine are `heading`.
    #[inline]
    #[must_use]
    pub fn turned(&self, k: usize, heading: [f64; 2]) -> [f64; 2] {
        rotated(heading, [self.along[k], self.aside[k]])
    }
}

/// `vector` turned by the angle whose cosine and sine are `heading`.
#[inline]
#[must_use]
pub fn rotated([cosine, sine]: [f64; 2], [x, y]: [f64; 2]) -> [f64; 2] {
    [x * cosine - y * sine, x * sine + y * cosine]
}

/// Cosine and sine of an angle, to 2e-16.
#[inline]
#[must_use]
pub fn direction(angle: f64) -> [f64; 2] {
    if angle.abs() < PARTS_UP_TO {
        return direction_by_parts(angle);
    }
    let (sine, cosine) = libm::sincos(angle);
    [cosine, sine]
}

/// Angles up to which the number of quarter turns times each part is exact [rad].
const PARTS_UP_TO: f64 = 1e6;
/// Quarter turn as a sum: its first 28 bits, the remaining bits of a double, and the rest.
const QUARTER: [f64; 3] = {
    let whole = std::f64::consts::FRAC_PI_2;
    let first = f64::from_bits(whole.to_bits() & !0x1ff_ffff);
    [first, whole - first, 6.123_233_995_736_766e-17]
};
/// Added to a number, this makes the last bit worth one: the number is rounded.
const ROUNDS: f64 = 6_755_399_441_055_744.0;

/// Cosine and sine by reduction to the nearest quarter turn and a series for the remainder.
#[inline]
fn direction_by_parts(angle: f64) -> [f64; 2] {
    let rounded = angle * std::f64::consts::FRAC_2_PI + ROUNDS;
    let quarters = rounded - ROUNDS;
    // In three parts, the first of which is exact times the number of quarters: the remainder keeps
    // full precision although most of the angle cancels.
    let rest = QUARTER.iter().fold(angle, |rest, part| rest - quarters * part);
    let square = rest * rest;
    let sum = |values: &[f64; 8]| values.iter().rev().fold(0.0, |sum, value| sum * square + value);
    let [even, odd] = &POWERS;
    let (cosine, sine) = (1.0 + square * sum(even), rest + rest * square * sum(odd));
    // The constant added for rounding leaves the number of quarters in the last bits, also of
    // negative angles.
    match rounded.to_bits() & 3 {
        0 => [cosine, sine],
        1 => [-sine, cosine],
        2 => [-cosine, -sine],
        _ => [sine, -cosine],
    }
}

/// Coefficients of cosine and sine after the first: (-1)^k / (2k)! and (-1)^k / (2k + 1)!.
const POWERS: [[f64; 8]; 2] = [powers(0), powers(1)];

const fn powers(odd: usize) -> [f64; 8] {
    let (mut values, mut value, mut k) = ([0.0; 8], 1.0, 0);
    while k < 8 {
        value /= -(((2 * k + odd + 1) * (2 * k + odd + 2)) as f64);
        values[k] = value;
        k += 1;
    }
    values
}

/// `angle` shifted by whole turns into -pi to pi [rad].
#[inline]
#[must_use]
pub fn wrapped(angle: f64) -> f64 {
    const TURN: f64 = std::f64::consts::TAU;
    // An angle that is within the range already keeps its bits.
    if angle.abs() <= std::f64::consts::PI { angle } else { angle - TURN * (angle / TURN).round() }
}

/// Coefficients of (-angle^2)^j in the unit integrals: 1 / ((2j)! (2j + k + 1)) for the cosine,
/// 1 / ((2j + 1)! (2j + k + 2)) for the sine.
const COEFFICIENTS: [[[f64; TERMS]; 3]; 2] = [
    [coefficients(0, 1), coefficients(0, 2), coefficients(0, 3)],
    [coefficients(1, 2), coefficients(1, 3), coefficients(1, 4)],
];

const fn coefficients(odd: usize, first: usize) -> [f64; TERMS] {
    let mut values = [0.0; TERMS];
    let (mut factorial, mut j) = (1.0, 0);
    while j < TERMS {
        values[j] = 1.0 / (factorial * (2 * j + first) as f64);
        factorial *= ((2 * j + odd + 1) * (2 * j + odd + 2)) as f64;
        j += 1;
    }
    values
}

fn by_series<const K: usize, const COUNT: usize>(angle: f64) -> ([f64; K], [f64; K]) {
    let x = -angle * angle;
    let sum = |values: &[f64; TERMS]| {
        values[..COUNT].iter().rev().fold(0.0, |sum, value| sum * x + value)
    };
    let [cosine, sine] = &COEFFICIENTS;
    (std::array::from_fn(|k| sum(&cosine[k])), std::array::from_fn(|k| angle * sum(&sine[k])))
}

/// Unit integrals in closed form, each by integration by parts from the moment before.
fn closed(angle: f64) -> ([f64; 3], [f64; 3]) {
    let (sine, cosine) = libm::sincos(angle);
    // 1 - cos(angle) as a square of the half angle: the difference would cancel at small angles.
    let half = libm::sin(0.5 * angle);
    let (c0, s0) = (sine / angle, 2.0 * half * half / angle);
    let (c1, s1) = ((sine - s0) / angle, (c0 - cosine) / angle);
    ([c0, c1, (sine - 2.0 * s1) / angle], [s0, s1, (2.0 * c1 - cosine) / angle])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Simpson's rule with many intervals.
    fn integrated(rate: f64, dt: f64, k: i32) -> [f64; 2] {
        let steps = 2000;
        let mut sums = [0.0; 2];
        for index in 0..=steps {
            let t = dt * f64::from(index) / f64::from(steps);
            let weight = match index {
                0 => 1.0,
                index if index == steps => 1.0,
                index if index % 2 == 1 => 4.0,
                _ => 2.0,
            };
            sums[0] += weight * t.powi(k) * (rate * t).cos();
            sums[1] += weight * t.powi(k) * (rate * t).sin();
        }
        sums.map(|sum| sum * dt / f64::from(steps) / 3.0)
    }

    #[test]
    fn moments_are_the_integrals() {
        for rate in [0.0, 1e-9, -0.01, 0.3, 0.999, -1.001, 2.5, -8.0] {
            for dt in [0.05, 0.5, 1.0] {
                let turn = Turn::<3>::new(rate, dt);
                for k in 0..3 {
                    let [cosine, sine] = integrated(rate, dt, k as i32);
                    assert!((turn.along[k] - cosine).abs() < 1e-12, "{rate} {dt} {k}");
                    assert!((turn.aside[k] - sine).abs() < 1e-12, "{rate} {dt} {k}");
                }
            }
        }
    }

    #[test]
    fn series_and_closed_form_meet() {
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 4e-15);
        for angle in [SERIES_UP_TO, -SERIES_UP_TO] {
            let ((c, s), (c2, s2)) = (by_series::<3, TERMS>(angle), closed(angle));
            assert!(near(c, c2) && near(s, s2));
        }
        let (short, long) = (by_series::<3, SHORT>(0.03), by_series::<3, TERMS>(0.03));
        assert!(near(short.0, long.0) && near(short.1, long.1));
    }

    #[test]
    fn directions_are_cosines_and_sines() {
        for step in -40_000..40_000 {
            let turned = f64::from(step) * 0.001_7;
            for angle in [turned, 1e4 * turned, 1e9 * turned] {
                let ([cosine, sine], (sin, cos)) = (direction(angle), libm::sincos(angle));
                assert!((cosine - cos).abs() < 2.3e-16 && (sine - sin).abs() < 2.3e-16, "{angle}");
            }
        }
        assert!(direction(f64::NAN).iter().chain(&direction(f64::INFINITY)).all(|v| v.is_nan()));
    }

    #[test]
    fn angles_are_wrapped_into_half_a_turn() {
        for (angle, expected) in [(0.5, 0.5), (4.0, 4.0 - std::f64::consts::TAU), (-7.0, -0.7168)] {
            assert!((wrapped(angle) - expected).abs() < 1e-4);
        }
    }
}
