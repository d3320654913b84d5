//! How much later than others the measurements of a scanner are, by what they say of moving targets.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Most values of a measurement.
pub const VALUES: usize = 4;
/// Information about a delay before any measurement [1/s^2]: one of a second would be no surprise.
const PRIOR: f64 = 1.0;
/// Number of scans after which one counts 1/e.
const MEMORY: f64 = 300.0;
/// Share of a look's information that counts: errors of a long target hang together over some scans,
/// since the same parts of it return.
const SHARE: f64 = 0.2;
/// Longest delay [s].
const LONGEST: f64 = 5.0;

/// What a measurement of a moving target says about its delay; the entries of values that were not
/// measured are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Look {
    /// Measured minus expected, the delay that is known taken into account.
    pub values: [f64; VALUES],
    /// Their variances.
    pub variances: [f64; VALUES],
    /// How fast each expected value changes [1/s].
    pub rates: [f64; VALUES],
}

/// Delay of a scanner, with a normal distribution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Delay {
    seconds: f64,
    information: f64,
}

impl Default for Delay {
    fn default() -> Self {
        Self { seconds: 0.0, information: PRIOR }
    }
}

/// Delays of scanners. Only differences show: the scanner that is the first to know has none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Delays {
    of: BTreeMap<u8, Delay>,
}

impl Delays {
    /// Take in that a scanner is used; returns its delay [s].
    pub fn of(&mut self, source: u8) -> f64 {
        self.of.entry(source).or_default().seconds
    }

    /// All delays, by scanner [s].
    pub fn all(&self) -> impl Iterator<Item = (u8, f64)> + '_ {
        self.of.iter().map(|(source, delay)| (*source, delay.seconds))
    }

    /// Least delay of the scanners in a set of bits [s].
    #[must_use]
    pub fn least(&self, sources: u64) -> f64 {
        let own = self.of.iter().filter(|(source, _)| sources & 1 << **source != 0);
        let least = own.map(|(_, delay)| delay.seconds).fold(f64::INFINITY, f64::min);
        if least.is_finite() { least } else { 0.0 }
    }

    /// True if scanners can be compared.
    #[must_use]
    pub fn are_comparable(&self) -> bool {
        self.of.len() > 1
    }

    /// Take in what a scan of a scanner says: the weighted mean of a prior and of the looks, whose
    /// innovations are -(delay - known delay) x rates.
    pub fn learn(&mut self, source: u8, looks: impl Iterator<Item = Look>) {
        let (mut slope, mut gained) = (0.0, 0.0);
        for Look { values, variances, rates } in looks {
            for ((value, variance), rate) in values.iter().zip(variances).zip(rates) {
                if variance > 0.0 {
                    slope -= value * rate / variance;
                    gained += rate * rate / variance;
                }
            }
        }
        let (slope, gained) = (SHARE * slope, SHARE * gained);
        if !(slope.is_finite() && gained.is_finite() && gained > 0.0) {
            return;
        }
        let delay = self.of.entry(source).or_default();
        let kept = 1.0 - 1.0 / MEMORY;
        let before = kept * delay.information + (1.0 - kept) * PRIOR;
        let faded = kept * delay.information * delay.seconds / before;
        let information = before + gained;
        // The slope was taken at the delay that is known.
        let mean = (before * faded + gained * delay.seconds + slope) / information;
        *delay = Delay { seconds: mean.clamp(-LONGEST, LONGEST), information };
        let least = self.of.values().map(|delay| delay.seconds).fold(f64::INFINITY, f64::min);
        for delay in self.of.values_mut() {
            delay.seconds = (delay.seconds - least).min(LONGEST);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks at a target of 3 m/s along x, `late` seconds after the known delay, with errors of a
    /// sequence of low discrepancy.
    fn look(k: u32, late: f64) -> Look {
        let error = 4.0 * ((0.618_034 * f64::from(k)) % 1.0 - 0.5);
        Look {
            values: [error - 3.0 * late, -error, 0.0, 0.0],
            variances: [2.0, 2.0, 0.0, 0.0],
            rates: [3.0, 0.0, 0.0, 0.0],
        }
    }

    #[test]
    fn the_late_one_of_two_is_found() {
        for late in [1, 0] {
            let mut delays = Delays::default();
            assert_eq!([delays.of(0), delays.of(1)], [0.0, 0.0]);
            for k in 0..2_000 {
                let source = (k % 2) as u8;
                let truth = if source == late { 1.5 } else { 0.0 };
                let known = delays.of(source);
                delays.learn(source, std::iter::once(look(k, truth - known)));
            }
            let found = [delays.of(late), delays.of(1 - late)];
            assert!((found[0] - 1.5).abs() < 0.05 && found[1] == 0.0, "{found:?}");
        }
    }

    #[test]
    fn what_stands_or_is_alone_has_no_delay() {
        let mut delays = Delays::default();
        let standing = Look { rates: [0.0; VALUES], ..look(1, 1.0) };
        delays.of(1);
        delays.learn(0, std::iter::once(standing));
        assert_eq!(delays.of(0), 0.0);
        let mut alone = Delays::default();
        (0..50).for_each(|k| alone.learn(3, std::iter::once(look(k, 2.0))));
        assert_eq!(alone.of(3), 0.0);
        assert!(!alone.are_comparable());
    }
}
