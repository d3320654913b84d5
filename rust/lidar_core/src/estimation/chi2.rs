//! Chi-square distribution: gates and consistency bounds.

use crate::Error;
use crate::error::require;

/// A series ends when its last term is smaller than this, relative to the sum.
const TERM: f64 = 1e-17;
/// Limit of the number of terms; no argument below 1e12 needs as many.
const MAX_TERMS: usize = 20_000_000;

/// Number of terms after which the continued fraction also ends at a factor that is the float next
/// to 1.
const SETTLED: usize = 10_000;

/// Probability that a chi-square variable of `degrees` degrees of freedom is at most `x`; NaN for
/// NaN.
#[must_use]
pub fn cdf(x: f64, degrees: u32) -> f64 {
    if x.is_nan() {
        return x;
    }
    if x <= 0.0 || degrees == 0 {
        return if x >= 0.0 && degrees == 0 { 1.0 } else { 0.0 };
    }
    let (shape, x) = (f64::from(degrees) / 2.0, x / 2.0);
    if x.is_infinite() {
        return 1.0;
    }
    // The three factors x^shape, exp(-x) and 1 / gamma(shape) overflow or vanish one by one at
    // large degrees; the sum of their logarithms does not.
    let front = libm::exp(shape * libm::log(x) - x - libm::lgamma(shape));
    // Each expansion converges fast only on its own side of the mean of the distribution.
    if x < shape + 1.0 {
        (front * lower_series(shape, x)).min(1.0)
    } else {
        (1.0 - front * upper_fraction(shape, x)).max(0.0)
    }
}

/// Inverse of [`cdf`]: the value below which a chi-square variable of `degrees` degrees of freedom
/// lies with this probability.
///
/// # Errors
/// [`Error::Parameter`] unless 0 < `probability` < 1 and `degrees` >= 1.
pub fn quantile(probability: f64, degrees: u32) -> Result<f64, Error> {
    require(
        probability > 0.0 && probability < 1.0,
        "probability",
        "more than 0 and less than 1",
        probability,
    )?;
    require(degrees >= 1, "degrees", ">= 1", degrees)?;
    let (mut low, mut high) = (0.0, f64::from(degrees));
    while cdf(high, degrees) < probability {
        (low, high) = (high, 2.0 * high);
    }
    // Bisection down to neighbouring floats: the distribution is monotone, no start value is
    // needed, and the result does not depend on a tolerance.
    loop {
        let middle = low + (high - low) / 2.0;
        if middle <= low || middle >= high {
            return Ok(high);
        }
        if cdf(middle, degrees) < probability {
            low = middle;
        } else {
            high = middle;
        }
    }
}

/// Series of the lower incomplete gamma function: sum of x^k / (shape .. (shape + k)), k from 0.
fn lower_series(shape: f64, x: f64) -> f64 {
    let mut term = 1.0 / shape;
    let mut sum = term;
    let mut divisor = shape;
    for _ in 0..MAX_TERMS {
        divisor += 1.0;
        term *= x / divisor;
        sum += term;
        if term < TERM * sum {
            break;
        }
    }
    sum
}

/// Continued fraction of the upper tail, evaluated by the method of Lentz.
fn upper_fraction(shape: f64, x: f64) -> f64 {
    const TINY: f64 = 1e-300;
    let mut b = x + 1.0 - shape;
    let mut c = 1.0 / TINY;
    // The method divides by c and d. A zero there is replaced by a number that the next term
    // cancels.
    let mut d = 1.0 / if b.abs() < TINY { TINY } else { b };
    let mut value = d;
    for index in 1..MAX_TERMS {
        let k = index as f64;
        let a = k * (shape - k);
        b += 2.0;
        let denominator = a * d + b;
        d = 1.0 / if denominator.abs() < TINY { TINY } else { denominator };
        c = b + a / c;
        if c.abs() < TINY {
            c = TINY;
        }
        value *= c * d;
        let off = (c * d - 1.0).abs();
        // Some factors never come nearer to 1 than the next float, which long fractions show.
        if off < 1e-16 || (index > SETTLED && off <= f64::EPSILON) {
            break;
        }
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_degrees_have_a_closed_form() -> Result<(), Error> {
        for probability in [1e-9, 0.05, 0.5, 0.95, 0.997] {
            let expected = -2.0 * libm::log1p(-probability);
            assert!((quantile(probability, 2)? / expected - 1.0).abs() < 1e-12);
        }
        assert!((cdf(3.0, 2) - (1.0 - libm::exp(-1.5))).abs() < 1e-15);
        Ok(())
    }

    /// Values of scipy 1.17.1, `scipy.stats.chi2.ppf`.
    #[test]
    fn quantiles_agree_with_scipy() -> Result<(), Error> {
        for (probability, degrees, expected) in SCIPY {
            let got = quantile(probability, degrees)?;
            assert!((got / expected - 1.0).abs() < 1e-9, "{probability} {degrees}: {got}");
        }
        Ok(())
    }

    const SCIPY: [(f64, u32, f64); 8] = [
        (0.95, 1, 3.841458820694124),
        (0.997, 3, 13.931422665512084),
        (0.99, 6, 16.811893829770927),
        (5e-07, 1_500, 1247.185077175545),
        (0.9999995, 1_500, 1783.3734517377773),
        (1e-12, 3, 2.417987942718036e-08),
        (0.5, 100, 99.33412923598846),
        (0.975, 108_000, 108912.80176790648),
    ];

    /// Found by `make fuzz`: fractions that come no nearer to 1 than the next float went on for
    /// 20 million terms, as those of NaN did.
    #[test]
    fn every_argument_ends_soon() -> Result<(), Error> {
        let start = std::time::Instant::now();
        assert!(cdf(f64::NAN, 3).is_nan());
        for step in 0..400 {
            let probability = (f64::from(step) + 0.5) / 400.0;
            for degrees in [1, 2, 153, 255, 100_000] {
                let x = quantile(probability, degrees)?;
                assert!((cdf(x, degrees) - probability).abs() < 1e-8, "{probability} {degrees}");
                assert!(cdf(1e300 * x, degrees) >= 1.0 - 1e-12);
            }
        }
        assert!(start.elapsed().as_secs() < 60, "{:?}", start.elapsed());
        Ok(())
    }

    #[test]
    fn probabilities_outside_their_range_are_refused() {
        for probability in [0.0, 1.0, -0.1, f64::NAN] {
            assert!(quantile(probability, 3).is_err());
        }
        assert!(quantile(0.5, 0).is_err());
    }
}
