//! Coherence of a target: whether rays next to a hit are hits more often than by chance.
//!
//! A body or a frame is met by neighbouring rays, at least along one direction: a thin wing along the wing. Dust, smoke
//! and rain are met at random, also where they are as dense as a frame.

use crate::flying::detect::center::Coherence;

/// Share of the evidence that is kept when that of another detection is added: the last 20 count.
const KEPT: f64 = 0.95;
/// Least number of `possible` hits in a direction that are evidence.
const FEWEST: f64 = 4.0;
/// Mean and standard deviation of the coherence of bodies: simulated quadcopters, aircraft and octocopters have 0.5 to
/// 0.9 (OS1-128, 10 and more returns).
const OF_BODY: [f64; 2] = [0.6, 0.2];
/// Share of the bodies whose coherence may be anything: many rays into dark ones are lost at random.
const ANY: f64 = 0.05;
/// Standard deviation of the coherence of dust, whose density varies: simulated puffs have 0 to 0.04.
const LOOSE_STD: f64 = 0.05;

impl Coherence {
    /// Add the evidence of another detection of the target.
    pub(super) fn add(&mut self, other: &Self) {
        for (sum, value) in self.excess.iter_mut().zip(other.excess) {
            *sum = KEPT * *sum + value;
        }
        for (sum, value) in self.possible.iter_mut().zip(other.possible) {
            *sum = KEPT * *sum + value;
        }
    }

    /// Probability densities of the evidence if the target is a body, and if it is loose as dust. The direction with
    /// the largest coherence counts. 1 and 1 if there is too little evidence.
    pub(super) fn densities(&self) -> [f64; 2] {
        let of_direction = |(&excess, &possible): (&f64, &f64)| (excess / possible, possible);
        let largest = self
            .excess
            .iter()
            .zip(&self.possible)
            .filter(|&(_, &possible)| possible >= FEWEST)
            .map(of_direction)
            .max_by(|one, other| one.0.total_cmp(&other.0));
        let Some((coherence, possible)) = largest else { return [1.0, 1.0] };
        let chance = 2.0 / possible; // a pair of hits counts from both sides
        let normal = |mean: f64, std: f64| {
            let variance = std * std + chance;
            let off = coherence - mean;
            libm::exp(-0.5 * off * off / variance) / (std::f64::consts::TAU * variance).sqrt()
        };
        let [mean, std] = OF_BODY;
        [(1.0 - ANY) * normal(mean, std) + ANY, normal(0.0, LOOSE_STD)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::detect::center::DIRECTIONS;

    fn of(coherence: [f64; DIRECTIONS], possible: f64) -> Coherence {
        Coherence { excess: coherence.map(|one| one * possible), possible: [possible; DIRECTIONS] }
    }

    #[test]
    fn one_coherent_direction_shows_a_body_and_none_shows_dust() {
        let ratio = |evidence: Coherence| {
            let [body, loose] = evidence.densities();
            body / loose
        };
        assert!(ratio(of([0.7, -0.1, 0.0, -0.1], 100.0)) > 100.0);
        assert!(ratio(of([0.0, 0.02, 0.01, 0.0], 100.0)) < 0.1);
        // A few rays show little, fewer nothing.
        let few = ratio(of([0.0, 0.1, 0.0, 0.0], 6.0));
        assert!(few > 0.3 && few < 1.0, "{few}");
        assert_eq!(of([0.0; 4], 2.0).densities(), [1.0, 1.0]);
        assert_eq!(Coherence::default().densities(), [1.0, 1.0]);
    }

    #[test]
    fn the_last_detections_count() {
        let mut sum = Coherence::default();
        (0..200).for_each(|_| sum.add(&of([0.0; 4], 10.0)));
        assert!((sum.possible[0] - 200.0).abs() < 1.0);
        (0..60).for_each(|_| sum.add(&of([0.7; 4], 10.0)));
        assert!(sum.excess[0] / sum.possible[0] > 0.6);
    }
}
