//! Tracks with probabilities of existence: update by a scan, and start with one and with two
//! measurements.

use super::hypotheses::{OwnPair, spread};
use super::parameters::{ExistenceParameters, SHARE};
use super::track::{Assigned, Belief, Births, Candidates, IntegratedScan, Scan, TargetTrack, kind};
use super::tracks::Tracks;
use crate::fusion::filter::engine::Output;
use crate::fusion::sensors::measurement::{Measurement, Sensor};
use crate::fusion::targets::lifecycle::Outcome;
use crate::tracking::existence::{
    GatedPair, JointEvidence, PredictedTrack, Presence, Sojourn, associate,
};
use crate::tracking::extent::AXES;
use crate::tracking::near::NearIndex;
use crate::tracking::surroundings::{ScannerPrior, Surroundings};
use std::f64::consts::PI;

/// A track with fewer measurements than this is split: each measurement in its gate gives a track
/// of its own. Its velocity then comes from two measured positions, not from a mean over several
/// measurements.
pub(super) const DIVIDED: u32 = 2;
/// Initial value of the mean time for which a target exists [s]; later learnt from tracks.
const LIFETIME: f64 = 30.0;
/// Initial value of the mean time until something hides a target [s]; later learnt from tracks.
const VISIBLE: f64 = 100.0;
/// Mean time for which a target is hidden [s].
const HIDDEN: f64 = 1.5;
/// Volume of the unit ball in 1 to 4 dimensions.
const BALLS: [f64; AXES] = [2.0, PI, 4.0 / 3.0 * PI, 0.5 * PI * PI];
/// Probability of existence below which a track ends.
pub(super) const DELETED: f64 = 1e-3;
/// Probability of existence from which on a track is used to learn the properties of its scanner.
pub(super) const CERTAIN: f64 = 0.9;

impl Tracks {
    /// Process the measurements of a scan. The pairs of tracks and near measurements are given.
    pub(super) fn integrate(
        &mut self,
        space: &IntegratedScan<'_>,
        candidates: &Candidates,
        births: &mut Births,
        assigned: &mut [Assigned],
    ) {
        let scan = space.scan;
        let targets = || scan.measurements.iter().filter(|m| !m.is_of_platform() && m.is_usable());
        let scanner = self.scanners.entry(scan.source).or_default();
        for (k, of) in scanner.iter_mut().enumerate() {
            of.see(targets().filter(|m| kind(m) == k).map(Measurement::values));
        }
        let scanner = scanner.clone();
        let fewer = candidates.limited(self.all.len());
        let candidates = fewer.as_ref().unwrap_or(candidates);
        let found = self.associated(space, candidates, &scanner);
        self.learn(space, candidates, &found);
        let measured = self.updated(space, candidates, &found, births, assigned);
        self.start_tracks(space, &scanner, &found, &measured, births, assigned);
        self.unite();
        self.judge_existence(space, &scanner[0]);
    }

    /// Probabilities of existence and association.
    fn associated(
        &mut self,
        space: &IntegratedScan<'_>,
        candidates: &Candidates,
        scanner: &[Surroundings; 2],
    ) -> JointEvidence {
        let (scan, existence) = (space.scan, space.existence);
        let sensor =
            scan.measurements.iter().find(|m| !m.is_of_platform()).map(Measurement::sensor);
        // An empty scan: of what its scanner has measured before.
        let sensor = sensor.unwrap_or(if scanner[0] == Surroundings::default() {
            Sensor::Radar
        } else {
            Sensor::Lidar
        });
        let prior = prior_of(existence, sensor);
        let detection = scanner[usize::from(sensor == Sensor::Radar)].detection(&prior);
        let predicted = self.predict_presence(scan, detection);
        let told = self.largest_clutter(space, candidates, scanner);
        let pairs = candidates.pairs.iter().zip(&candidates.innovations);
        let pairs = pairs.map(|(pair, innovation)| {
            let m = &scan.measurements[pair.column];
            let axes = innovation.count;
            let prior = prior_of(existence, m.sensor());
            let clutter = prior.clutter.min(told[kind(m)][axes - 1]);
            let prior = ScannerPrior { clutter, ..prior };
            let density = scanner[kind(m)].clutter(&prior, axes);
            let density = density.max(space.standing[pair.column]);
            let log_ratio = -0.5 * (innovation.nis + spread(innovation)) - libm::log(density);
            GatedPair { track: pair.row, measurement: pair.column, log_ratio }
        });
        associate(&predicted, scan.measurements.len(), &pairs.collect::<Vec<_>>())
    }

    /// Predict the probabilities of existence of every track to the time of the scan. The time for
    /// which certain targets exist is counted.
    fn predict_presence(&mut self, scan: &Scan, detection: f64) -> Vec<PredictedTrack> {
        let mean = Sojourn {
            lifetime: self.population.lifetime(LIFETIME),
            visible: self.population.visible(VISIBLE),
            hidden: HIDDEN,
        };
        let population = &mut self.population;
        let predicted = self.all.iter_mut().map(|track| {
            let belief = &mut track.belief;
            let dt = scan.stamp_ns.saturating_sub(belief.stamp_ns) as f64 * 1e-9;
            if belief.was_certain {
                population.count_stay(&belief.presence, dt);
            }
            belief.presence = belief.presence.predicted(dt, &mean);
            belief.stamp_ns = scan.stamp_ns;
            let is_in_view = track.sources & (1 << scan.source) != 0;
            PredictedTrack { presence: belief.presence, detection, is_in_view }
        });
        predicted.collect()
    }

    /// Largest density of clutter before scans show more, by sensor and number of axes: all
    /// measurements of this scan in the smallest gate of a young track.
    ///
    /// After a long time between scans this gate is large. With too large a density of clutter,
    /// more false measurements would be expected in it than the scan has, and no measurement would
    /// be accepted as the second one of the target.
    fn largest_clutter(
        &self,
        space: &IntegratedScan<'_>,
        candidates: &Candidates,
        scanner: &[Surroundings; 2],
    ) -> [[f64; AXES]; 2] {
        let scan = &space.scan.measurements;
        let mut told = [[f64::INFINITY; AXES]; 2];
        let mut smallest = [[f64::INFINITY; AXES]; 2];
        for (pair, innovation) in candidates.pairs.iter().zip(&candidates.innovations) {
            let track = &self.all[pair.row];
            if track.hits < DIVIDED {
                // Of models together: the innovation is that of the likeliest alone.
                let output = track.filter.output_at(space.scan.stamp_ns);
                let place = output.filter(|_| innovation.count == 2);
                let all = place.map_or(f64::NEG_INFINITY, |o| libm::log(determinant(&o)));
                let own = &mut smallest[kind(&scan[pair.column])][innovation.count - 1];
                *own = own.min(innovation.log_determinant.max(all));
            }
        }
        for (sensor, smallest) in smallest.iter().enumerate() {
            let own = scan.iter().filter(|m| !m.is_of_platform() && kind(m) == sensor);
            let count = own.filter(|m| m.is_usable()).count() as f64;
            for (k, log_determinant) in smallest.iter().enumerate() {
                let axes = (k + 1) as f64;
                let log_ball = libm::log(BALLS[k])
                    + 0.5 * axes * libm::log(space.parameters.filter.life.gate[k]);
                let log_volume = log_ball + 0.5 * log_determinant;
                let seen = scanner[sensor].volume(k + 1);
                if log_volume.is_finite() {
                    // The others of this scan say more, where they lie in less than the gate.
                    let others = if seen > 0.0 { (count - 1.0).max(0.0) / seen } else { 0.0 };
                    told[sensor][k] = (count * libm::exp(-log_volume)).max(others);
                }
            }
        }
        told
    }

    /// Learn the properties of the scanner and of the targets from the probabilities of a scan.
    fn learn(
        &mut self,
        space: &IntegratedScan<'_>,
        candidates: &Candidates,
        found: &JointEvidence,
    ) {
        let scan = space.scan;
        let mut seen = vec![0.0; self.all.len()];
        for (pair, probability) in candidates.pairs.iter().zip(&found.pair) {
            seen[pair.row] += probability;
        }
        for (track, returned) in self.all.iter().zip(&found.returns) {
            if track.belief.was_certain {
                self.population.count_return(*returned);
            }
        }
        let Some(scanner) = self.scanners.get_mut(&scan.source) else { return };
        let mut unexplained = [Vec::new(), Vec::new()];
        for (m, left) in scan.measurements.iter().zip(&found.unexplained) {
            if !m.is_of_platform() && m.is_usable() {
                unexplained[kind(m)].push((m.values(), *left));
            }
        }
        let used: [bool; 2] = std::array::from_fn(|k| scanner[k] != Surroundings::default());
        for (k, of) in scanner.iter_mut().enumerate().filter(|(k, _)| used[*k]) {
            of.count_scan(&unexplained[k]);
            let own = self.all.iter().zip(&found.presence);
            let own = own.filter(|(track, _)| track.belief.origin == (scan.source, k));
            of.count_first(own.map(|(_, presence)| presence.existence).sum());
            for ((track, presence), hit) in self.all.iter().zip(&found.presence).zip(&seen) {
                let is_seen = track.sources & (1 << scan.source) != 0;
                if is_seen && track.belief.presence.existence > CERTAIN {
                    of.count_look(presence.observable(), *hit);
                }
            }
        }
    }

    /// Correct every track by its measurements, and split new tracks. Returns the positions of the
    /// measured tracks [m].
    fn updated(
        &mut self,
        space: &IntegratedScan<'_>,
        candidates: &Candidates,
        found: &JointEvidence,
        births: &mut Births,
        assigned: &mut [Assigned],
    ) -> NearIndex {
        // Longer than other functions: one pass over the tracks, which shares out measurements and
        // divides the young.
        let scan = space.scan;
        let of_track = pairs_of_tracks(self.all.len(), candidates, found);
        let mut best = vec![0.0; assigned.len()];
        let (mut divided, mut measured) = (Vec::new(), Vec::new());
        for ((track, own), presence) in self.all.iter_mut().zip(of_track).zip(&found.presence) {
            let parts = if track.hits < DIVIDED {
                track.divided(space, &own, *presence, births)
            } else {
                track.corrected(scan, &own, *presence);
                Vec::new()
            };
            for (option, OwnPair { column, probability, innovation, .. }) in own.iter().enumerate()
            {
                if found.unexplained[*column] < 0.5 && *probability > best[*column] {
                    best[*column] = *probability;
                    let id = parts.get(option).map_or(track.id, |part| part.id);
                    assigned[*column] = Assigned { id: Some(id), innovation: Some(*innovation) };
                }
            }
            let seen: f64 = own.iter().map(|pair| pair.probability).sum();
            if space.parameters.birth_distance > 0.0 && seen > 0.5 {
                let likelier =
                    |a: &&TargetTrack, b: &&TargetTrack| a.existence().total_cmp(&b.existence());
                let seen_so = parts.iter().max_by(likelier).unwrap_or(track);
                let output = seen_so.filter.output_at(scan.stamp_ns);
                let place = output.map(|output| [output.mean[0], output.mean[1]]);
                measured.extend(place.filter(|at| at.iter().all(|value| value.is_finite())));
            }
            divided.extend(parts);
        }
        self.all.extend(divided);
        NearIndex::new(measured.into_iter().zip(0..).collect())
    }

    /// Start a track for every measurement that may come from a new target.
    fn start_tracks(
        &mut self,
        space: &IntegratedScan<'_>,
        scanner: &[Surroundings; 2],
        found: &JointEvidence,
        measured: &NearIndex,
        births: &mut Births,
        assigned: &mut [Assigned],
    ) {
        // Longer than other functions: the conditions for a new track in the order of their cost,
        // then all its fields.
        let (scan, existence) = (space.scan, space.existence);
        let mut unseen = self.unseen.clone();
        unseen.expect_speed(self.population.speed(space.parameters.filter.prior.speed));
        for (column, m) in scan.measurements.iter().enumerate() {
            if m.is_of_platform() {
                continue;
            }
            let share = scanner[kind(m)].share(&prior_of(existence, m.sensor()));
            let probability = found.unexplained[column] * share;
            if probability < DELETED {
                continue;
            }
            let mut filter = unseen.clone();
            let step = filter.step(m);
            let output = step.output.filter(|_| step.outcome == Outcome::Started);
            let Some(start) = output.map(|output| [output.mean[0], output.mean[1]]) else {
                continue;
            };
            if measured.is_near(start, space.parameters.birth_distance) {
                continue;
            }
            let mut track = TargetTrack::new(births.of(column), filter, scan);
            track.belief = Belief {
                presence: Presence::measured(probability),
                stamp_ns: scan.stamp_ns,
                last: [Some((scan.stamp_ns, scan.source, column)), None],
                start,
                origin: (scan.source, kind(m)),
                was_certain: false,
                is_doubtful: false,
                will_arrive: scanner[kind(m)].is_settled(),
            };
            assigned[column].id = assigned[column].id.or(Some(track.id));
            self.all.push(track);
        }
    }
}

/// The pairs of every track, with their probabilities.
fn pairs_of_tracks(
    tracks: usize,
    candidates: &Candidates,
    found: &JointEvidence,
) -> Vec<Vec<OwnPair>> {
    let mut of_track: Vec<Vec<OwnPair>> = vec![Vec::new(); tracks];
    let pairs = candidates.pairs.iter().zip(&candidates.innovations);
    for (index, (pair, innovation)) in pairs.enumerate() {
        of_track[pair.row].push(OwnPair {
            column: pair.column,
            probability: found.pair[index],
            innovation: *innovation,
            is_likely: found.is_likely[index],
        });
    }
    of_track
}

/// Assumed properties of a scanner, until they are learnt from its scans.
pub(super) fn prior_of(existence: &ExistenceParameters, sensor: Sensor) -> ScannerPrior {
    let clutter = existence.clutter[usize::from(sensor == Sensor::Radar)];
    ScannerPrior { detection: existence.detection, clutter, share: SHARE }
}

/// Determinant of the covariance of the position of a state [m^4].
pub(super) fn determinant(output: &Output) -> f64 {
    let [first, second, ..] = output.covariance;
    (first[0] * second[1] - first[1] * second[0]).max(0.0)
}
