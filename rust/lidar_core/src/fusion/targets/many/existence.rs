//! Tracks with probabilities of existence: merging, reporting and ending.

use super::integrated::{CERTAIN, DELETED, DIVIDED, determinant, prior_of};
use super::parameters::MAX_TARGETS;
use super::track::{Belief, IntegratedScan, Sighting, TargetTrack};
use super::tracks::Tracks;
use crate::fusion::sensors::measurement::Sensor;
use crate::tracking::surroundings::Surroundings;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Probability of existence below which a track that was certain counts as ended.
const DOUBTFUL: f64 = 0.5;
/// Expected number of false measurements in the region where a target may be, from which on its
/// track ends: it would follow false measurements.
const LOST: f64 = 2.0;
/// A reported track is no longer reported below this share of `report`.
const KEPT: f64 = 0.5;

impl Tracks {
    /// Merge tracks with the same last two measurements, unless both are certain: they are two
    /// hypotheses about one target. These exclude each other, so their probabilities add up.
    pub(super) fn unite(&mut self) {
        let mut first: BTreeMap<[Option<Sighting>; 2], usize> = BTreeMap::new();
        let mut is_gone = vec![false; self.all.len()];
        for row in 0..self.all.len() {
            let belief = self.all[row].belief;
            if belief.last[1].is_none() {
                continue;
            }
            let Some(other) = first.get(&belief.last).copied() else {
                first.insert(belief.last, row);
                continue;
            };
            let [a, b] = [other, row].map(|row| self.all[row].existence());
            if a.min(b) > 0.5 {
                continue;
            }
            let (kept, gone) = if b > a { (row, other) } else { (other, row) };
            let [one, two] = [kept, gone].map(|row| self.all[row].belief.presence);
            self.all[kept].belief.presence = one.united(&two);
            is_gone[gone] = true;
            first.insert(belief.last, kept);
        }
        let mut rows = is_gone.into_iter();
        self.all.retain(|_| !rows.next().unwrap_or(false));
    }

    /// End and report tracks by their probabilities.
    pub(super) fn judge_existence(&mut self, space: &IntegratedScan<'_>, lidar: &Surroundings) {
        self.end_improbable(space, lidar);
        if self.all.len() > MAX_TARGETS {
            self.keep_most_probable();
        }
        self.report_probable(space);
    }

    /// End tracks with a very low probability of existence, and tracks with a too uncertain
    /// position.
    fn end_improbable(&mut self, space: &IntegratedScan<'_>, lidar: &Surroundings) {
        let widest = space.parameters.max_position_std * space.parameters.max_position_std;
        let stamp_ns = space.scan.stamp_ns;
        let largest = largest_place(space, lidar);
        self.all.retain(|track| {
            let is_lost = || {
                let output = track.filter.output_at(stamp_ns);
                output.is_some_and(|output| TAU * libm::sqrt(determinant(&output)) > largest)
            };
            if track.hits > DIVIDED && is_lost() {
                return false;
            }
            let is_placed = || {
                let output = track.filter.output_at(stamp_ns);
                output.is_some_and(|o| o.covariance[0][0].max(o.covariance[1][1]) <= widest)
            };
            // Before a track is certain, its probability alone ends it: a slow scanner leaves the
            // speed open, and its next measurement shares the track with the case of a miss.
            track.existence() >= DELETED && (!track.belief.was_certain || is_placed())
        });
    }

    /// Keep the [`MAX_TARGETS`] tracks of the highest probability; of equal ones the oldest.
    fn keep_most_probable(&mut self) {
        let mut sorted: Vec<f64> = self.all.iter().map(TargetTrack::existence).collect();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let least = sorted[MAX_TARGETS - 1];
        let mut left = MAX_TARGETS;
        self.all.retain(|track| {
            let stays = track.existence() >= least && left > 0;
            left -= usize::from(stays);
            stays
        });
    }

    /// Report tracks by their probability. Learn the statistics of targets and scanner from certain
    /// tracks.
    fn report_probable(&mut self, space: &IntegratedScan<'_>) {
        let (existence, stamp_ns) = (space.existence, space.scan.stamp_ns);
        let mut arrived = 0;
        for track in &mut self.all {
            let probability = track.existence();
            if probability > CERTAIN
                && !track.belief.was_certain
                && let Some(velocity) = track.mean_velocity(stamp_ns)
            {
                self.population.count_speed(velocity);
            }
            let is_kept = track.confirmed && probability >= KEPT * existence.report;
            track.confirmed = is_kept || probability >= existence.report;
            let Belief { was_certain, is_doubtful, .. } = &mut track.belief;
            *was_certain |= probability > CERTAIN;
            let doubts = if *is_doubtful { probability < CERTAIN } else { probability < DOUBTFUL };
            if *was_certain && doubts != *is_doubtful {
                self.population.count_end(doubts);
                *is_doubtful = doubts;
            }
            if probability > CERTAIN && std::mem::take(&mut track.belief.will_arrive) {
                arrived += 1;
            }
        }
        if let Some(scanner) = self.scanners.get_mut(&space.scan.source) {
            for of in scanner.iter_mut().filter(|of| **of != Surroundings::default()) {
                (0..arrived).for_each(|_| of.count_arrival());
            }
        }
    }
}

/// Area in which [`LOST`] false measurements of the LiDAR are expected [m^2]; infinite for a
/// scanner without LiDAR.
fn largest_place(space: &IntegratedScan<'_>, lidar: &Surroundings) -> f64 {
    let prior = prior_of(space.existence, Sensor::Lidar);
    let is_used = *lidar != Surroundings::default();
    if is_used { LOST / lidar.clutter(&prior, 2) } else { f64::INFINITY }
}
