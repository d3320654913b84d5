//! Noise of measured positions, from how they jitter from scan to scan.

use serde::{Deserialize, Serialize};

/// Longest time that three positions may span [s]: in a longer one an acceleration counts as noise.
const LONGEST: f64 = 0.5;
/// Largest stated variance of a position that is used to estimate additional noise [m^2].
const SHARP: f64 = 0.03 * 0.03;
/// Largest variance of one sample [m^2]: a change of the visible part is no noise.
const LARGEST: f64 = 0.08 * 0.08;
/// Number of samples that the mean remembers.
const MEMORY: f64 = 30.0;

/// A measured position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Sample {
    time_ns: i64,
    place: [f64; 2],
    /// Stated variance, mean of both axes [m^2].
    variance: f64,
}

/// Variance of positions beyond the one that they state, per axis.
///
/// Three positions of an object at constant velocity lie on a line at equal steps of time. What
/// departs from it is noise, or a change of the velocity. Noise departs to and fro: the position
/// that is too far ahead in one three is too far back in the next. So the product of two departures
/// in a row is negative for noise, and zero or positive for an object that turns, starts or bounces.
/// The estimate needs no model of motion and holds for standing and for moving objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Jitter {
    /// The last positions, the newest first.
    recent: [Option<Sample>; 3],
    /// Mean of all samples; negative if the stated variances are too large [m^2].
    excess: f64,
    weight: f64,
}

impl Jitter {
    /// Estimate that starts at a variance [m^2] with the weight of this many samples.
    #[must_use]
    pub fn new(variance: f64, weight: f64) -> Self {
        Self { recent: [None; 3], excess: variance, weight }
    }

    /// Variance to be added to the stated one [m^2], >= 0.
    #[must_use]
    pub fn variance(&self) -> f64 {
        self.excess.max(0.0)
    }

    /// Mean of all samples [m^2], and their number, in which the start counts with its weight.
    #[must_use]
    pub fn mean(&self) -> (f64, f64) {
        (self.excess, self.weight)
    }

    /// Add a position [m] at a time [ns] with the mean of its stated variances [m^2].
    pub fn add(&mut self, time_ns: i64, place: [f64; 2], variance: f64) {
        let now = Sample { time_ns, place, variance };
        let [newest, older, oldest] = self.recent;
        if let (Some(newest), Some(older), Some(oldest)) = (newest, older, oldest)
            && let Some(sample) = alternation([oldest, older, newest, now])
        {
            self.weight = (self.weight + 1.0).min(MEMORY);
            self.excess += (sample.clamp(-LARGEST, LARGEST) - self.excess) / self.weight;
        }
        self.recent = [Some(now), newest, older];
    }
}

/// Variance of one position beyond the stated ones, from four successive positions [m^2]; None if
/// they span too long a time or their stated variances are too large.
fn alternation(four: [Sample; 4]) -> Option<f64> {
    let [first, second, third, fourth] = four;
    let one = Departure::of([first, second, third])?;
    let two = Departure::of([second, third, fourth])?;
    let is_sharp = four.iter().all(|sample| sample.variance < SHARP);
    // The second and the third position are in both: their stated noise alone correlates the departures.
    let shared = [one.weights[1] * two.weights[0], one.weights[2] * two.weights[1]];
    let stated = shared[0] * second.variance + shared[1] * third.variance;
    let product = 0.5 * (one.off[0] * two.off[0] + one.off[1] * two.off[1]);
    is_sharp.then(|| (product - stated) / (shared[0] + shared[1]))
}

/// Departure of the third of three positions from a steady motion through the first two.
struct Departure {
    /// Weights of the three positions in the departure.
    weights: [f64; 3],
    off: [f64; 2],
}

impl Departure {
    fn of([first, second, third]: [Sample; 3]) -> Option<Self> {
        let seconds = |from: Sample, to: Sample| {
            (i128::from(to.time_ns) - i128::from(from.time_ns)) as f64 * 1e-9
        };
        let (before, after) = (seconds(first, second), seconds(second, third));
        let ahead = after / before;
        let off = [0, 1].map(|axis| {
            let [a, b, c] = [first, second, third].map(|one| one.place[axis]);
            c - b - (b - a) * ahead
        });
        (before > 0.0 && after > 0.0 && before + after < LONGEST)
            .then_some(Self { weights: [ahead, -(1.0 + ahead), 1.0], off })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_steadily_does_not_jitter() {
        let mut jitter = Jitter::new(0.0, 4.0);
        for step in 0..40 {
            let time = 0.08 * f64::from(step);
            jitter.add(i64::from(step) * 80_000_000, [1.5 * time, -0.7 * time], 0.0);
        }
        assert!(jitter.variance() < 1e-20);
    }

    #[test]
    fn alternating_positions_show_their_variance() {
        // +e, -e, +e: every second difference is 4 e, with the other sign than the last; its
        // products have weights -4.
        let (mut jitter, e) = (Jitter::new(0.0, 0.0), 0.02);
        for step in 0..60 {
            let sign = if step % 2 == 0 { 1.0 } else { -1.0 };
            jitter.add(step * 50_000_000, [sign * e; 2], 1e-5);
        }
        assert!((jitter.variance() - (4.0 * e * e - 1e-5)).abs() < 1e-12);
    }

    #[test]
    fn what_turns_round_does_not_jitter() {
        let (mut jitter, mut place) = (Jitter::new(0.0, 4.0), 0.0);
        for step in 0..60 {
            // Back and forth at 1.5 m/s, with a bounce every 0.5 s.
            place += if step / 10 % 2 == 0 { 0.075 } else { -0.075 };
            jitter.add(step * 50_000_000, [place, 0.0], 0.0);
        }
        assert!(jitter.variance() < 1e-20, "{}", jitter.variance());
    }

    #[test]
    fn vague_positions_and_long_gaps_tell_nothing() {
        let mut jitter = Jitter::new(1e-4, 4.0);
        for step in 0..20 {
            jitter.add(step * 50_000_000, [f64::from(step as u8 % 2), 0.0], 0.01);
            jitter.add(step * 3_000_000_000 + 1, [0.0, 1.0], 1e-6);
        }
        assert_eq!(jitter.mean(), (1e-4, 4.0));
    }
}
