//! Update of a track with a probability of existence by the measurements in its gate.

use super::track::{Births, Candidates, IntegratedScan, Scan, TargetTrack};
use crate::fusion::filter::engine::Innovation;
use crate::fusion::sensors::measurement::Measurement;
use crate::tracking::existence::Presence;
use std::f64::consts::TAU;

/// Largest number of pairs of a track and a measurement that are evaluated per scan. With more
/// pairs, each track keeps only its most likely pairs.
const MOST_PAIRS: usize = 20_000;
/// Least number of its most likely pairs that each track keeps.
const LEAST_PAIRS: usize = 8;
/// Share of the measurements of targets visible again after they were hidden that are not used:
/// those furthest from the predicted position.
const FOREIGN: f64 = 0.02;
/// Share of measurements that are not used, below which this test is left out: for targets that
/// were probably not hidden.
const CERTAINLY_OWN: f64 = 1e-3;

/// A measurement in the gate of a track: its index in the scan, the probability that it comes from
/// the target, and its innovation.
#[derive(Clone, Copy)]
pub(super) struct OwnPair {
    pub(super) column: usize,
    pub(super) probability: f64,
    pub(super) innovation: Innovation,
    /// True if this pair alone is more likely than a missed detection.
    pub(super) is_likely: bool,
}

impl Candidates {
    /// The most likely pairs of each of `tracks` tracks, in the same order; None if there are at
    /// most [`MOST_PAIRS`] pairs, which are then all used.
    pub(super) fn limited(&self, tracks: usize) -> Option<Self> {
        if self.pairs.len() <= MOST_PAIRS {
            return None;
        }
        let mut of_track = vec![Vec::new(); tracks];
        for (index, pair) in self.pairs.iter().enumerate() {
            of_track[pair.row].push(index);
        }
        let spread = |index: usize| self.innovations[index].nis + spread(&self.innovations[index]);
        let cost: Vec<f64> = (0..self.pairs.len()).map(spread).collect();
        for own in &mut of_track {
            own.sort_by(|a, b| cost[*a].total_cmp(&cost[*b]).then(a.cmp(b)));
        }
        // As many for each track as fit; tracks with few leave room for the others.
        let kept = |most: usize| of_track.iter().map(|own| own.len().min(most)).sum::<usize>();
        let most = (LEAST_PAIRS..).take_while(|most| kept(*most) <= MOST_PAIRS).last();
        let most = most.unwrap_or(LEAST_PAIRS);
        let mut left: Vec<usize> =
            of_track.iter().flat_map(|own| own.iter().take(most)).copied().collect();
        left.sort_unstable();
        let pairs = left.iter().map(|index| self.pairs[*index]).collect();
        Some(Self {
            pairs,
            innovations: left.iter().map(|index| self.innovations[*index]).collect(),
        })
    }
}

impl TargetTrack {
    /// Probability that the target of the track exists.
    pub(super) fn existence(&self) -> f64 {
        self.belief.presence.existence
    }

    /// Mean velocity [vx, vy] from the first measurement to `stamp_ns` [m/s]; None if `stamp_ns` is
    /// not later than the first measurement.
    pub(super) fn mean_velocity(&self, stamp_ns: i64) -> Option<[f64; 2]> {
        let dt = stamp_ns.saturating_sub(self.born_ns) as f64 * 1e-9;
        let now = self.filter.output_at(stamp_ns)?.mean;
        let start = self.belief.start;
        (dt > 0.0).then(|| [0, 1].map(|axis| (now[axis] - start[axis]) / dt))
    }

    /// Correct the track by measurements, weighted with their probabilities given that the target
    /// exists.
    pub(super) fn corrected(&mut self, scan: &Scan, own: &[OwnPair], presence: Presence) {
        let existence = presence.existence;
        self.belief.presence = presence;
        if own.is_empty() || existence <= 0.0 {
            return;
        }
        let given = |pair: &OwnPair| (pair.probability / existence, scan.measurements[pair.column]);
        let weighted: Vec<(f64, Measurement)> = own.iter().map(given).collect();
        self.filter.absorb(scan.stamp_ns, &weighted);
        if weighted.iter().map(|(weight, _)| weight).sum::<f64>() > 0.5 {
            self.see(scan);
        }
        // The wide gate of a hidden target holds measurements of others: they are no evidence that
        // both tracks are of one target.
        if presence.hidden_share() < 0.5 {
            self.remember(scan, own);
        }
    }

    /// Store the measurement that most likely comes from the target of the track. Unlikely
    /// measurements are left out: the wide gate of a hidden track contains measurements of other
    /// targets.
    pub(super) fn remember(&mut self, scan: &Scan, own: &[OwnPair]) {
        let likelier = |a: &&OwnPair, b: &&OwnPair| {
            let cost = |pair: &OwnPair| pair.innovation.nis + pair.innovation.log_determinant;
            cost(b).total_cmp(&cost(a)).then(b.column.cmp(&a.column))
        };
        if let Some(pair) = own.iter().filter(|pair| pair.is_likely).max_by(likelier) {
            let [last, _] = self.belief.last;
            self.belief.last = [Some((scan.stamp_ns, scan.source, pair.column)), last];
        }
    }

    /// Split the track: one track for each measurement; `self` stands for the hypothesis that no
    /// measurement comes from its target. The most likely track keeps the ID.
    pub(super) fn divided(
        &mut self,
        space: &IntegratedScan<'_>,
        own: &[OwnPair],
        presence: Presence,
        births: &mut Births,
    ) -> Vec<Self> {
        let scan = space.scan;
        let seen: f64 = own.iter().map(|pair| pair.probability).sum();
        let part = |pair: &OwnPair| {
            let mut part = self.clone();
            part.filter.take(&scan.measurements[pair.column]);
            part.id = births.of_pair(self.id, pair.column);
            part.belief.presence = Presence::measured(pair.probability);
            part.see(scan);
            part.remember(scan, &[OwnPair { is_likely: true, ..*pair }]);
            part
        };
        let mut parts: Vec<Self> = own.iter().map(part).collect();
        let left = (presence.existence - seen).max(presence.hidden);
        self.belief.presence = Presence { existence: left, ..presence };
        let likelier = |a: &&mut Self, b: &&mut Self| {
            a.existence().total_cmp(&b.existence()).then(b.id.cmp(&a.id))
        };
        if let Some(best) = parts.iter_mut().max_by(likelier)
            && best.existence() > left
        {
            std::mem::swap(&mut best.id, &mut self.id);
        }
        parts
    }
}

/// Logarithm of det(2 pi S), where S is the covariance of the innovation.
pub(super) fn spread(innovation: &Innovation) -> f64 {
    innovation.log_determinant + innovation.count as f64 * libm::log(TAU)
}

/// True for a measurement that is too far from the predicted position for a target that was hidden
/// and is visible again.
///
/// It does not matter here how rarely other targets appear: an ID that changes to another target is
/// worse than a new ID.
pub(super) fn is_another_target(track: &mut TargetTrack, m: &Measurement) -> bool {
    let least = FOREIGN * track.belief.presence.hidden_share();
    least > CERTAINLY_OWN && track.filter.tail(m) < least
}
