//! Probability that a trivariate normal variable lies in a box with edges along the axes.
//!
//! With the covariance factorised as `L L'`, the variable is `L z` with independent standard normal `z`, and the box
//! bounds one entry of `z` after the other: nested one-dimensional integrals, the innermost in closed form. Where the
//! variance left to an axis is small, the integrand rises or falls steeply at a known place: the integrals are split
//! there, so that they stay accurate up to singular covariances, whose further axes only narrow the innermost
//! interval. Where it is not small, the inner two integrals become one integral over the correlation, which is faster.

use super::quadrature::{KRONROD, NODES, integrate};
use crate::Error;
use crate::error::require;

/// Range of integration in standard deviations: 3e-10 of the probability lies outside.
const REACH: f64 = 6.3;
/// Conditional variance of an axis, relative to its own, below which the axis counts as determined.
const LEAST_SHARE: f64 = 1e-15;
/// Relative rounding error of a covariance that is accepted, although it makes it indefinite.
const ROUNDING: f64 = 1e-9;
/// Largest accepted difference of the two quadrature rules on a panel, outer and inner integral.
const TOLERANCE: [f64; 2] = [1e-8, 1e-9];
/// Longest first panel, in standard deviations.
const PANEL: f64 = 3.0;
/// Largest correlation for which the inner two integrals are computed as one.
const LARGEST_CORRELATION: f64 = 0.9;
/// Width of a step of the integrand below which the integral is split around it, in standard deviations.
const STEEP: f64 = 0.5;
/// Distance from a step at which the integral is split, in widths of the step.
const STEP_REACH: f64 = 7.0;

/// Probability that a normal variable with mean 0 and this covariance lies between `low` and
/// `high` on every axis; absolute error below 1e-8.
///
/// An axis without variance lies in the box, outside, or on its face, which counts half: the limit
/// of vanishing variance.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] if the covariance is not finite, not symmetric or has a negative
/// eigenvalue; [`Error::Parameter`] if a bound is NaN.
///
/// # Source
/// The integral of Vrba et al., eq. 46. Nested as in Genz, "Numerical computation of rectangular
/// bivariate and trivariate normal and t probabilities", Statistics and Computing 14, 2004.
pub fn box_probability(
    covariance: &[[f64; 3]; 3],
    low: [f64; 3],
    high: [f64; 3],
) -> Result<f64, Error> {
    check(covariance)?;
    let is_box = !low.iter().chain(&high).any(|bound| bound.is_nan());
    require(is_box, "low, high", "bounds of a box", format_args!("{low:?}, {high:?}"))?;
    let mut share = 1.0;
    let (mut axes, mut count) = ([0; 3], 0);
    for axis in 0..3 {
        let reach = REACH * covariance[axis][axis].sqrt();
        if low[axis] >= high[axis] || low[axis] > reach || high[axis] < -reach {
            return Ok(0.0);
        }
        // An axis that reaches beyond the box on neither side does not change the probability;
        // without it the integral has one dimension less.
        if reach == 0.0 {
            share *= if low[axis] == 0.0 || high[axis] == 0.0 { 0.5 } else { 1.0 };
        } else if low[axis] > -reach || high[axis] < reach {
            axes[count] = axis;
            count += 1;
        }
    }
    if count == 0 {
        return Ok(share);
    }
    let problem = Nested::new(covariance, &axes[..count], low, high);
    Ok((share * problem.inside(0, [0.0; 3])).clamp(0.0, 1.0))
}

/// Check that a matrix is a covariance.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] unless the matrix is a covariance, up to rounding.
fn check(covariance: &[[f64; 3]; 3]) -> Result<(), Error> {
    let refused = Err(Error::NotPositiveDefinite { matrix: "covariance" });
    let variance: [f64; 3] = std::array::from_fn(|axis| covariance[axis][axis]);
    if !covariance.iter().flatten().all(|value| value.is_finite())
        || variance.iter().any(|&value| value < 0.0)
    {
        return refused;
    }
    let rounding = ROUNDING * variance.into_iter().fold(0.0, f64::max);
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        let (entry, scale) = (covariance[a][b], variance[a].sqrt() * variance[b].sqrt());
        if (entry - covariance[b][a]).abs() > rounding || entry.abs() > scale + rounding {
            return refused;
        }
    }
    let [xy, xz, yz] = [(0, 1), (0, 2), (1, 2)].map(|(a, b)| correlation(covariance, a, b));
    let determinant = 1.0 + 2.0 * xy * xz * yz - xy * xy - xz * xz - yz * yz;
    if determinant < -ROUNDING { refused } else { Ok(()) }
}

/// Correlation of two axes, -1 to 1; 0 if the covariance is only a rounding error.
fn correlation(covariance: &[[f64; 3]; 3], a: usize, b: usize) -> f64 {
    let largest = (0..3).map(|axis| covariance[axis][axis]).fold(0.0, f64::max);
    let scale = covariance[a][a].sqrt() * covariance[b][b].sqrt();
    if scale <= ROUNDING * largest { 0.0 } else { (covariance[a][b] / scale).clamp(-1.0, 1.0) }
}

/// The box in standard deviations: bounds of `factor * z` with independent standard normal `z`.
struct Nested {
    /// Number of rows with a bound, 1 to 3.
    rows: usize,
    /// Number of columns of `factor` that are not zero.
    rank: usize,
    factor: [[f64; 3]; 3],
    low: [f64; 3],
    high: [f64; 3],
    /// The last two rows, conditional on the rows before; None if they are integrated one by one.
    pair: Option<CorrelatedPair>,
}

impl Nested {
    /// Cholesky factor of the correlations of `axes`, pivoted: the axis with the largest
    /// conditional variance comes next.
    fn new(covariance: &[[f64; 3]; 3], axes: &[usize], low: [f64; 3], high: [f64; 3]) -> Self {
        let rows = axes.len();
        let mut order: [usize; 3] = std::array::from_fn(|row| axes[row.min(rows - 1)]);
        let mut factor = [[0.0; 3]; 3];
        let mut left = [1.0f64; 3];
        let mut rank = rows;
        for k in 0..rows {
            let mut pivot = k;
            // With the largest remaining variance first, all pivots after a zero are zero too:
            // these rows are determined by the rows before, and nothing is divided by rounding
            // errors.
            for row in k + 1..rows {
                if left[row] > left[pivot] {
                    pivot = row;
                }
            }
            order.swap(k, pivot);
            factor.swap(k, pivot);
            left.swap(k, pivot);
            if left[k] < LEAST_SHARE {
                rank = k;
                break;
            }
            factor[k][k] = left[k].sqrt();
            for row in k + 1..rows {
                let known: f64 = (0..k).map(|m| factor[row][m] * factor[k][m]).sum();
                let both = correlation(covariance, order[row], order[k]);
                factor[row][k] = (both - known) / factor[k][k];
                left[row] -= factor[row][k] * factor[row][k];
            }
        }
        let std = |axis: usize| covariance[axis][axis].sqrt();
        let scaled =
            |bound: [f64; 3]| std::array::from_fn(|row| bound[order[row]] / std(order[row]));
        let pair =
            if rows >= 2 && rank == rows { CorrelatedPair::new(&factor, rows - 2) } else { None };
        Self { rows, rank, factor, low: scaled(low), high: scaled(high), pair }
    }

    /// Bounds of a row minus the contribution of the entries of `z` before `level`.
    fn bounds(&self, row: usize, level: usize, z: &[f64; 3]) -> [f64; 2] {
        let known: f64 = (0..level).map(|k| self.factor[row][k] * z[k]).sum();
        [self.low[row] - known, self.high[row] - known]
    }

    /// Probability of the box given the entries of `z` before `level`.
    fn inside(&self, level: usize, z: [f64; 3]) -> f64 {
        if level + 1 == self.rank {
            return self.innermost(level, &z);
        }
        if let Some(pair) = self.pair.as_ref().filter(|_| level + 2 == self.rows) {
            return pair.inside([level, level + 1].map(|row| self.bounds(row, level, &z)));
        }
        let [start, end] =
            self.bounds(level, level, &z).map(|bound| bound / self.factor[level][level]);
        let (start, end) = (start.max(-REACH), end.min(REACH));
        if start >= end {
            return 0.0;
        }
        let integrand = |value: f64| {
            let mut z = z;
            z[level] = value;
            density(value) * self.inside(level + 1, z)
        };
        let cuts = self.cuts(level, &z, [start, end]);
        let tolerance = TOLERANCE[level.min(1)];
        cuts.windows(2).map(|cut| integrate(&integrand, cut[0], cut[1], tolerance)).sum()
    }

    /// Probability of the last entry of `z`, bounded by its own row and by all rows that it
    /// determines.
    fn innermost(&self, level: usize, z: &[f64; 3]) -> f64 {
        let (mut start, mut end) = (f64::NEG_INFINITY, f64::INFINITY);
        for row in level..self.rows {
            let slope = self.factor[row][level];
            let [low, high] = self.bounds(row, level, z);
            // The row does not depend on the last entry: it holds for all values or for none.
            if slope.abs() < LEAST_SHARE {
                if low > 0.0 || high < 0.0 {
                    return 0.0;
                }
                continue;
            }
            // A negative slope exchanges the bounds.
            let (a, b) = (low / slope, high / slope);
            start = start.max(a.min(b));
            end = end.min(a.max(b));
        }
        interval(start, end)
    }

    /// Ascending places at which the integral over entry `level` of `z` is split, ends included.
    fn cuts(&self, level: usize, z: &[f64; 3], [start, end]: [f64; 2]) -> Vec<f64> {
        let panels = ((end - start) / PANEL).ceil().max(1.0);
        let step = (end - start) / panels;
        let mut cuts: Vec<f64> = (0..panels as u32).map(|k| start + f64::from(k) * step).collect();
        let mut add = |place: f64, width: f64| {
            // A slope of zero makes the place infinite or NaN and the width infinite: nothing is
            // added.
            if width < STEEP {
                let reach = STEP_REACH * width;
                let places = [place - reach, place, place + reach];
                cuts.extend(places.into_iter().filter(|&cut| start < cut && cut < end));
            }
        };
        for row in level + 1..self.rows {
            let slope = self.factor[row][level];
            let rest: f64 = self.factor[row][level + 1..].iter().map(|entry| entry * entry).sum();
            for bound in self.bounds(row, level, z) {
                add(bound / slope, rest.sqrt() / slope.abs());
            }
        }
        if level == 0 && self.rows == 3 {
            // The integrand bends where two bounds of the next entry change places, which the last entry blurs:
            // the steps have to be fine there.
            let [_, [a0, a1, _], [b0, b1, b2]] = self.factor;
            let slope = b0 * a1 - a0 * b1;
            for a in [self.low[1], self.high[1]] {
                for b in [self.low[2], self.high[2]] {
                    add((b * a1 - a * b1) / slope, (b2 * a1 / slope).abs());
                }
            }
        }
        cuts.push(end);
        cuts.sort_unstable_by(f64::total_cmp);
        cuts
    }
}

/// Two normal variables with correlation.
struct CorrelatedPair {
    std: [f64; 2],
    /// Per node of the integral over the correlation r: weight, r, and 1 / 2 (1 - r^2).
    nodes: [[f64; 3]; 30],
}

impl CorrelatedPair {
    /// The rows `first` and the next of a factor, given the rows before; None if their correlation
    /// is too large.
    fn new(factor: &[[f64; 3]; 3], first: usize) -> Option<Self> {
        let [along, across] = [factor[first + 1][first], factor[first + 1][first + 1]];
        let std = libm::hypot(along, across);
        if along.abs() > LARGEST_CORRELATION * std {
            return None;
        }
        // Half of the interval of each of the two 15-point rules, in the angle asin(r): over the
        // angle the integrand has no singularity at r = 1.
        let half = 0.25 * libm::asin(along / std);
        let node = |index: usize| {
            let place = index % 15;
            let (offset, weight) = match place {
                7 => (0.0, KRONROD[7]),
                0..7 => (-NODES[place], KRONROD[place]),
                _ => (NODES[14 - place], KRONROD[14 - place]),
            };
            let middle = if index < 15 { half } else { 3.0 * half };
            let angle = middle + half * offset;
            let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
            [half * weight / (2.0 * std::f64::consts::PI), sine, 0.5 / (cosine * cosine)]
        };
        Some(Self { std: [factor[first][first], std], nodes: std::array::from_fn(node) })
    }

    /// Probability of the rectangle: without correlation, and the integral over the correlation of
    /// the density at its corners.
    ///
    /// # Source
    /// Drezner & Wesolowsky, "On the computation of the bivariate normal integral", 1990.
    fn inside(&self, bounds: [[f64; 2]; 2]) -> f64 {
        // Beyond twice the reach a corner's density counts as little as at infinity.
        let scaled =
            |k: usize| bounds[k].map(|b| (b / self.std[k]).clamp(-2.0 * REACH, 2.0 * REACH));
        let ([a, b], [c, d]) = (scaled(0), scaled(1));
        if a >= b || c >= d {
            return 0.0;
        }
        let more = |&[weight, r, scale]: &[f64; 3]| {
            let corner = |x: f64, y: f64| libm::exp(-scale * (x * x + y * y - 2.0 * r * x * y));
            weight * (corner(b, d) - corner(a, d) - corner(b, c) + corner(a, c))
        };
        interval(a, b) * interval(c, d) + self.nodes.iter().map(more).sum::<f64>()
    }
}

fn density(z: f64) -> f64 {
    const SCALE: f64 = 0.5 * std::f64::consts::FRAC_2_SQRT_PI * std::f64::consts::FRAC_1_SQRT_2;
    SCALE * libm::exp(-0.5 * z * z)
}

/// Probability that a standard normal variable lies between `start` and `end`.
fn interval(start: f64, end: f64) -> f64 {
    if start >= end {
        return 0.0;
    }
    let above = |z: f64| 0.5 * libm::erfc(z * std::f64::consts::FRAC_1_SQRT_2);
    // From the tail that is nearer, so that nothing is lost to cancellation.
    if start + end > 0.0 { above(start) - above(end) } else { above(-end) - above(-start) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn independent_axes_multiply() -> Result<(), Error> {
        let covariance = [[0.04, 0.0, 0.0], [0.0, 0.09, 0.0], [0.0, 0.0, 1.0]];
        let got = box_probability(&covariance, [-0.2, 0.0, -9.0], [0.2, 0.3, 1.0])?;
        let exact = 0.682_689_492_137_086 * 0.341_344_746_068_543 * 0.841_344_746_068_543;
        assert!((got - exact).abs() < 1e-9, "{got}");
        Ok(())
    }

    #[test]
    fn orthants_have_a_closed_form() -> Result<(), Error> {
        // P(all > 0) = 1/8 + (asin a + asin b + asin c) / 4 pi.
        for [xy, xz, yz] in [[0.5, 0.2, -0.3], [0.999_999, 0.4, 0.4], [-0.9, 0.9, -0.9]] {
            let covariance = [[1.0, xy, xz], [xy, 1.0, yz], [xz, yz, 1.0]];
            let got = box_probability(&covariance, [0.0; 3], [f64::INFINITY; 3])?;
            let angles = libm::asin(xy) + libm::asin(xz) + libm::asin(yz);
            let exact = 0.125 + angles / (4.0 * std::f64::consts::PI);
            assert!((got - exact).abs() < 1e-9, "{got} {exact}");
        }
        Ok(())
    }

    #[test]
    fn one_direction_without_the_others() -> Result<(), Error> {
        // x = z, y = -2 z, w = 0.5 z: the box is an interval of z.
        let u: [f64; 3] = [1.0, -2.0, 0.5];
        let covariance = u.map(|a| u.map(|b| a * b));
        let got = box_probability(&covariance, [-1.0, -1.0, -0.1], [1.0, 3.0, 1.0])?;
        assert!((got - interval(-0.2, 0.5)).abs() < 1e-9, "{got}");
        Ok(())
    }

    #[test]
    fn without_variance_a_point_is_in_or_out() -> Result<(), Error> {
        let none = [[0.0; 3]; 3];
        assert_eq!(box_probability(&none, [-1.0; 3], [1.0; 3])?, 1.0);
        assert_eq!(box_probability(&none, [0.5; 3], [1.0; 3])?, 0.0);
        assert_eq!(box_probability(&none, [0.0, -1.0, 0.0], [1.0; 3])?, 0.25);
        Ok(())
    }

    #[test]
    fn what_is_no_covariance_is_refused() {
        let asymmetric = [[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let indefinite = [[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]];
        let negative = [[-1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]];
        for matrix in [asymmetric, indefinite, negative, [[f64::NAN; 3]; 3]] {
            assert!(box_probability(&matrix, [-1.0; 3], [1.0; 3]).is_err());
        }
        assert!(box_probability(&[[0.0; 3]; 3], [f64::NAN; 3], [1.0; 3]).is_err());
    }

    #[test]
    fn parts_of_a_box_add_up() -> Result<(), Error> {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            2.0 * f64::from(state) / f64::from(u32::MAX) - 1.0
        };
        for case in 0..200 {
            let flat = [1.0f64, 0.1, 1e-3, 1e-6, 1e-9, 0.0][case % 6];
            let root: [[f64; 3]; 3] =
                std::array::from_fn(|_| [random(), random() * flat.sqrt(), random() * flat]);
            let covariance = root.map(|a| root.map(|b| a[0] * b[0] + a[1] * b[1] + a[2] * b[2]));
            let (low, high) = ([0.5 * random() - 1.0; 3], [0.5 * random() + 1.0; 3]);
            let cut = [0.3 * random(), 0.3 * random(), 0.3 * random()];
            let whole = box_probability(&covariance, low, high)?;
            let mut parts = 0.0;
            for part in 0..8 {
                let upper = |axis: usize| part >> axis & 1 == 1;
                parts += box_probability(
                    &covariance,
                    std::array::from_fn(|axis| if upper(axis) { cut[axis] } else { low[axis] }),
                    std::array::from_fn(|axis| if upper(axis) { high[axis] } else { cut[axis] }),
                )?;
            }
            assert!((parts - whole).abs() < 4e-8, "{case}: {parts} {whole}");
        }
        Ok(())
    }
}
