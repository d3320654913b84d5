//! One track, or one hypothesis that may become one. Longer than other files: it holds one type with all its methods.

use super::FoundTarget;
use super::belief::existence::{FalseBirths, Sight, TrackBelief};
use super::belief::stood::StoodPlaces;
use super::manoeuvre::Manoeuvre;
use super::measurement::{Evidence, Measurement};
use super::motion::{self, Matrix9, seconds};
use super::parameters::{Hiding, Motion, NoiseForm, Radius, TrackerParameters};
use super::visibility::occupancy::ENOUGH_RAYS;
use crate::Error;
use crate::estimation::kalman::{self, Gaussian, Linearised, update};
use crate::flying::large_targets::shape_weight;
use crate::tracking::kind::TrackKind;
use nalgebra::{Matrix3, SVector, Vector3};
use serde::{Deserialize, Serialize};

/// Weight that counts of points in a track's own clusters and around it keep from one scan to the next.
const AROUND_KEPT: f64 = 0.8;

/// Weight of the newest scan in the average number of points of a track's cluster.
const NEW_POINTS: f64 = 0.3;

/// Standard deviation of the centre of a large target, as a share of its longest side, that remains after any number
/// of scans: every scan shows the same parts of the target, so the error of the centre is the same in all.
const SHAPE_SHARE: f64 = 0.03;

/// Squared Mahalanobis distance of a velocity from zero (three degrees of freedom) above which the
/// track certainly has a speed: errors alone exceed it once in 10,000 times.
const HAS_SPEED: f64 = 21.1;

/// A track further than this from its first detection does not hang there [m].
const AWAY: f64 = 1.0;

/// Largest number that a saved state of a track may contain. Products of such numbers are finite.
const MOST_POSSIBLE: f64 = 1e100;

/// Standard deviation of the acceleration after a hard turn, along every axis [m/s^2]: multirotors reach one to two g.
/// With it, targets at 14 m/s^2 are followed at 5 scans per second. Other values were not tried.
const HARD_TURN: f64 = 9.8;

/// ID of every hypothesis. A hypothesis gets an ID of its own when it becomes a track.
pub(super) const UNNUMBERED: i64 = -1;

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct PointTrack {
    pub(super) id: i64,
    pub(super) estimate: Gaussian<9>,
    /// Covariance of the state if it grew only while the track should have been visible.
    pub(super) aged: Matrix9,
    pub(super) stamp_ns: i64,
    pub(super) born_ns: i64,
    /// Position of the first detection [m].
    pub(super) born_at: Vector3<f64>,
    /// Time at which the first detection was measured, after `born_ns` [s].
    pub(super) delay: f64,
    /// Time of the last measurement [ns]; `seen_at` is the position then [m].
    pub(super) seen_ns: i64,
    pub(super) seen_at: Vector3<f64>,
    /// Speed at the last measurement [m/s].
    pub(super) seen_speed: f64,
    pub(super) extent: [f64; 3],
    /// Usual sides of the target's bounding box [m]: an average over time.
    pub(super) size: [f64; 3],
    pub(super) n_detections: u32,
    /// Which of the last sets of detections contained the track: 1 if it did, newest set in the lowest bit.
    pub(super) history: u64,
    /// Evidence of the detection with which the track began (of the later one, if it began with two).
    pub(super) first: Evidence,
    /// Evidence of the earlier of the two detections with which the track began; None if it began with one.
    pub(super) before: Option<Evidence>,
    /// IDs of the tracks of the two single detections with which it started. Empty once it is
    /// confirmed.
    pub(super) made_of: Vec<i64>,
    /// Observation of the track in the newest scan.
    pub(super) sight: Sight,
    /// Squared Mahalanobis distance of its cluster in the newest scan; None if it has none.
    pub(super) nis: Option<f64>,
    /// Factor for the standard deviations of the process noise: it is larger than 1 for a target that manoeuvres more
    /// than the motion model expects.
    pub(super) manoeuvre: Manoeuvre,
    /// Belief about the target: whether it exists, and of which kind it is.
    pub(super) belief: TrackBelief,
    pub(super) confirmed: bool,
    /// Whether the track is or ever was confirmed.
    pub(super) was_confirmed: bool,
    /// Number of points in its own clusters, summed over scans with decreasing weight; `stray_points`: the same for
    /// points around it that belong to no track.
    pub(super) own_points: f64,
    pub(super) stray_points: f64,
    /// Average number of points of its cluster, over scans that showed it. Zero before the first.
    pub(super) usual_points: f64,
    /// Whether the newest cloud shows that nothing is left at the place where the track began.
    pub(super) left: bool,
    /// Places around the first detection that gave returns before the track began.
    pub(super) stood: StoodPlaces,
}

impl PointTrack {
    /// A track that starts at a detection. Source: Vrba et al., eqs 32-33.
    pub(super) fn new(
        detection: &Measurement,
        stamp_ns: i64,
        parameters: &TrackerParameters,
    ) -> Self {
        // Longer than other functions: the first values of all fields.
        let [_, velocity, acceleration] = parameters.initial_std;
        let delay = detection.delay;
        let mut mean = SVector::<f64, 9>::zeros();
        mean.fixed_rows_mut::<3>(0).copy_from(&detection.position);
        let mut covariance = Matrix9::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&detection.covariance);
        for axis in 0..3 {
            // r = z - v * delay with an unknown velocity
            covariance[(axis, axis)] += delay * delay * velocity * velocity;
            covariance[(axis, axis + 3)] = -delay * velocity * velocity;
            covariance[(axis + 3, axis)] = -delay * velocity * velocity;
            covariance[(axis + 3, axis + 3)] = velocity * velocity;
            covariance[(axis + 6, axis + 6)] = acceleration * acceleration;
        }
        Self {
            id: UNNUMBERED,
            estimate: Gaussian { mean, covariance },
            aged: covariance,
            stamp_ns,
            born_ns: stamp_ns,
            born_at: detection.position,
            delay,
            seen_ns: stamp_ns,
            seen_at: detection.position,
            seen_speed: 0.0,
            extent: detection.extent,
            size: detection.extent,
            n_detections: 1,
            history: 1,
            first: Evidence {
                is_sure: true,
                is_led: false,
                is_among_surfaces: false,
                is_joined: false,
                shape: None,
            },
            before: None,
            made_of: Vec::new(),
            sight: Sight::Unseen,
            nis: None,
            manoeuvre: Manoeuvre::CALM,
            belief: TrackBelief::unknown(stamp_ns),
            confirmed: false,
            was_confirmed: false,
            own_points: 0.0,
            stray_points: 0.0,
            usual_points: 0.0,
            left: false,
            stood: StoodPlaces::default(),
        }
    }

    /// A confirmed track of a target that was found in several scans together (track-before-detect).
    pub(super) fn of_found(
        target: &FoundTarget,
        stamp_ns: i64,
        parameters: &TrackerParameters,
    ) -> Self {
        let [position, both, velocity] = target.covariance;
        let measured = Measurement {
            position: target.position.into(),
            covariance: Matrix3::identity() * position,
            delay: 0.0,
            extent: [0.0; 3],
            n_points: 0,
            is_cut: false,
            row: None,
        };
        let mut track = Self::new(&measured, stamp_ns, parameters);
        for axis in 0..3 {
            track.estimate.mean[axis + 3] = target.velocity[axis];
            let covariance = &mut track.estimate.covariance;
            covariance[(axis, axis + 3)] = both;
            covariance[(axis + 3, axis)] = both;
            covariance[(axis + 3, axis + 3)] = velocity;
        }
        (track.aged, track.seen_speed) = (track.estimate.covariance, track.velocity().norm());
        (track.born_ns, track.born_at) = (target.first_ns, target.first.into());
        track.n_detections = target.n_returns;
        track.usual_points = 1.0;
        track.belief = TrackBelief::of_mover(stamp_ns);
        (track.confirmed, track.was_confirmed) = (true, true);
        track
    }

    /// Whether a saved state may contain these values: finite, and with possible covariances.
    pub(super) fn is_possible(&self) -> bool {
        let is_covariance = |matrix: &Matrix9| {
            let is_number = |&value: &f64| value.abs() <= MOST_POSSIBLE;
            matrix.iter().all(is_number) && matrix.diagonal().min() >= 0.0
        };
        let places = self.estimate.mean.iter().chain(&self.born_at).chain(&self.seen_at);
        let sides = self.extent.iter().chain(&self.size);
        let counts = [&self.own_points, &self.stray_points, &self.usual_points];
        self.manoeuvre.is_possible()
            && self.stood.is_possible()
            && places.chain([&self.delay]).all(|value| value.abs() <= MOST_POSSIBLE)
            && sides
                .chain([&self.seen_speed])
                .chain(counts)
                .all(|value| (0.0..=MOST_POSSIBLE).contains(value))
            && is_covariance(&self.estimate.covariance)
            && is_covariance(&self.aged)
    }

    pub(super) fn position(&self) -> Vector3<f64> {
        motion::position(&self.estimate)
    }

    pub(super) fn velocity(&self) -> Vector3<f64> {
        self.estimate.mean.fixed_rows::<3>(3).into_owned()
    }

    /// Whether the track is certainly away from its first detection, further than leaves sway in
    /// the wind.
    pub(super) fn is_away(&self) -> bool {
        let spread = motion::position_block(&self.estimate.covariance).trace() / 3.0;
        let reach = AWAY + 2.0 * spread.max(0.0).sqrt();
        (self.position() - self.born_at).norm() > reach
    }

    /// Whether the velocity differs from zero by more than the error of its estimate.
    pub(super) fn has_speed(&self) -> bool {
        let covariance = self.estimate.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        kalman::mahalanobis(&self.velocity(), &covariance)
            .is_ok_and(|distance| distance.squared >= HAS_SPEED)
    }

    /// Longest usual side of its box [m].
    pub(super) fn longest_side(&self) -> f64 {
        self.size.into_iter().fold(0.0, f64::max)
    }

    /// Probability that the target exists, at the time of the last set of detections.
    pub(super) fn existence(&self) -> f64 {
        self.belief.existence(self.is_among_strays())
    }

    /// Probability that the target exists, predicted to `stamp_ns` without new evidence.
    pub(super) fn existence_at(&self, stamp_ns: i64) -> f64 {
        self.belief.at(stamp_ns).existence(self.is_among_strays())
    }

    fn is_among_strays(&self) -> bool {
        self.stray_points > self.own_points
    }

    /// Enter the end of the track into the statistics of tracks without a target. A track that was ever confirmed
    /// does not count; others count with the probability that they had no target.
    pub(super) fn count_end(&self, births: &mut FalseBirths) {
        if !self.was_confirmed {
            births.count_end(self.existence());
        }
    }

    pub(super) fn radius(&self, parameters: &Radius) -> f64 {
        motion::radius(&self.estimate.covariance, parameters)
    }

    /// The state, predicted to `stamp_ns`. If the track is not currently seen, its acceleration fades with the time
    /// constant for unseen targets.
    pub(super) fn at(&self, stamp_ns: i64, model: &Motion) -> Gaussian<9> {
        self.predicted(&self.estimate, stamp_ns, model)
    }

    /// A state of this track at its own time, predicted to `stamp_ns`.
    fn predicted(&self, estimate: &Gaussian<9>, stamp_ns: i64, model: &Motion) -> Gaussian<9> {
        let acceleration_time = match model.unseen_time {
            Some(time) if self.seen_ns < self.stamp_ns => Some(time),
            _ => model.acceleration_time,
        };
        let factor = match model.form {
            NoiseForm::Adaptive => self.manoeuvre.factor(),
            NoiseForm::Paper | NoiseForm::Continuous => 1.0,
        };
        let std = model.std.map(|std| factor * std);
        let model = Motion { acceleration_time, std, ..*model };
        motion::predict(estimate, seconds(self.stamp_ns, stamp_ns), &model)
    }

    /// The state to report, predicted to `stamp_ns`: for a large target, the position has the added uncertainty of
    /// its shape.
    pub(super) fn told_at(&self, stamp_ns: i64, model: &Motion) -> Gaussian<9> {
        let mut state = self.at(stamp_ns, model);
        let side = self.longest_side();
        let variance = (shape_weight(side) * SHAPE_SHARE * side).powi(2);
        (0..3).for_each(|axis| state.covariance[(axis, axis)] += variance);
        state
    }

    /// Predict the state to `stamp_ns`.
    pub(super) fn predict(&mut self, stamp_ns: i64, model: &Motion) {
        self.estimate = self.at(stamp_ns, model);
        self.stamp_ns = stamp_ns;
    }

    /// The state at `stamp_ns` if the target has turned hard since the time of the state: its old acceleration is
    /// over. None if the motion model does not adapt, or if the track is not one of a target that flies and moves.
    pub(super) fn turned_at(&self, stamp_ns: i64, model: &Motion) -> Option<Gaussian<9>> {
        if model.form != NoiseForm::Adaptive || !self.may_turn_hard() {
            return None;
        }
        let mut turned = self.estimate.clone();
        let Gaussian { mean, covariance } = &mut turned;
        mean.fixed_rows_mut::<3>(6).fill(0.0);
        covariance.fixed_view_mut::<3, 9>(6, 0).fill(0.0);
        covariance.fixed_view_mut::<9, 3>(0, 6).fill(0.0);
        (6..9).for_each(|axis| covariance[(axis, axis)] = HARD_TURN * HARD_TURN);
        Some(self.predicted(&turned, stamp_ns, model))
    }

    /// Enlarge the covariance of a target that has been lost since `seen_ns`: since then it may have accelerated by
    /// `acceleration` [m/s^2], and its position is no better known than that of a new track, `position_std` [m].
    pub(super) fn widen(&mut self, acceleration: f64, position_std: f64) {
        let dt = seconds(self.seen_ns, self.stamp_ns);
        let strayed = [0.5 * dt * dt, dt, 1.0].map(|share| share * acceleration);
        for axis in 0..3 {
            for (row, one) in strayed.into_iter().enumerate() {
                for (column, other) in strayed.into_iter().enumerate() {
                    self.estimate.covariance[(axis + 3 * row, axis + 3 * column)] += one * other;
                }
            }
            self.estimate.covariance[(axis, axis)] += position_std * position_std;
        }
    }

    /// Distance flown since the last measurement, at the speed of that time [m].
    pub(super) fn distance_flown(&self) -> f64 {
        self.seen_speed * seconds(self.seen_ns, self.stamp_ns)
    }

    /// Increase the covariance `aged` for `dt` seconds without a measurement.
    pub(super) fn grow_old(&mut self, dt: f64, model: &Motion) {
        self.aged = motion::predict_covariance(&self.aged, dt, model);
    }

    /// Update the usual sides with those of the last cluster, which was seen for `dt` seconds.
    pub(super) fn remember_size(&mut self, dt: f64, hiding: &Hiding) {
        let weight = -libm::expm1(-dt / hiding.time);
        for (size, extent) in self.size.iter_mut().zip(self.extent) {
            *size += weight * (extent - *size);
        }
    }

    /// Enter one scan into the counts of points: in the track's cluster, and around it without a track.
    pub(super) fn count_points(&mut self, own: usize, stray: usize) {
        self.own_points = AROUND_KEPT * self.own_points + own as f64;
        self.stray_points = AROUND_KEPT * self.stray_points + stray as f64;
    }

    /// Whether the process noise may adapt: the target has moved and most probably flies. An object that sways or
    /// drifts in the wind also deviates from its prediction, but its track must not follow it more closely.
    fn may_manoeuvre(&self) -> bool {
        self.belief.has_moved() && self.belief.kinds().kind() == TrackKind::Flying
    }

    /// Whether a hard turn is possible: the target most probably flies, and has moved or certainly has a speed. A
    /// target on a small circle is never away from its first detection.
    fn may_turn_hard(&self) -> bool {
        self.may_manoeuvre() || self.has_speed() && self.belief.kinds().kind() == TrackKind::Flying
    }

    /// Enter the points of the cluster of a correction into the average number of points.
    fn remember_points(&mut self, n_points: usize) {
        let n_points = n_points as f64;
        if self.usual_points == 0.0 {
            self.usual_points = n_points;
        } else if n_points > 0.0 {
            self.usual_points += NEW_POINTS * (n_points - self.usual_points);
        }
    }

    /// Number of returns expected from `rays` through the track's position. For a track that was confirmed it is at
    /// most its usual number of returns: a flat target of few returns may lie between two rows of rays, so a scan
    /// without returns is weaker evidence than for a target of many returns.
    pub(super) fn expected_returns(&self, rays: usize) -> usize {
        if !self.was_confirmed || self.usual_points == 0.0 || rays < ENOUGH_RAYS {
            return rays;
        }
        rays.min(ENOUGH_RAYS.max(self.usual_points.round() as usize))
    }

    /// Position `delay` seconds after the state's time.
    pub(super) fn position_after(&self, delay: f64) -> Vector3<f64> {
        (motion::position_matrix(delay) * self.estimate.mean).into_owned()
    }

    /// Correct with a measurement taken `delay` seconds after the state's time.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]; the state is unchanged then.
    pub(super) fn correct(&mut self, measurement: &Measurement) -> Result<(), Error> {
        let nis = self.update_from(&self.estimate.clone(), measurement)?;
        if self.may_manoeuvre() {
            self.manoeuvre.feel(nis);
        }
        Ok(())
    }

    /// Correct the state after a hard turn, `turned`, with a measurement. The process noise grows.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]; the state is unchanged then.
    pub(super) fn correct_turned(
        &mut self,
        measurement: &Measurement,
        turned: &Gaussian<9>,
    ) -> Result<(), Error> {
        self.update_from(turned, measurement)?;
        if self.may_manoeuvre() {
            self.manoeuvre.feel(f64::INFINITY);
        }
        Ok(())
    }

    /// Set the state that follows from a prior and a measurement. Returns the squared Mahalanobis distance of the
    /// measurement.
    fn update_from(
        &mut self,
        prior: &Gaussian<9>,
        measurement: &Measurement,
    ) -> Result<f64, Error> {
        let matrix = motion::position_matrix(measurement.delay);
        let y = measurement.position - matrix * prior.mean;
        let model = Linearised { y, H: matrix, R: measurement.covariance };
        let updated = update(prior, &model)?;
        (self.estimate, self.nis) = (updated.posterior, Some(updated.nis));
        self.aged = self.estimate.covariance;
        self.extent = measurement.extent;
        self.remember_points(measurement.n_points);
        self.seen_ns = self.stamp_ns;
        (self.seen_at, self.seen_speed) = (self.position(), self.velocity().norm());
        Ok(updated.nis)
    }
}

/// Expected number of tracks without a target, among those that were never confirmed.
pub(super) fn without_target(tracks: &[PointTrack]) -> f64 {
    tracks.iter().filter(|track| !track.was_confirmed).map(|track| 1.0 - track.existence()).sum()
}
