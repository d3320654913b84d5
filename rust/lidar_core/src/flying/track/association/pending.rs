//! Predicted positions of the targets of tracks at the time of a set of detections, and their
//! differences to the detections.

use super::super::measurement::Offset;
use super::super::motion::{position, position_block, position_matrix};
use super::super::parameters::Motion;
use super::super::state::PointTrack;
use crate::estimation::kalman::{self, Gaussian, symmetrised};
use nalgebra::{Matrix3, Vector3};

/// A track, predicted to the time of a set of detections that may be assigned to it.
pub(super) struct PendingTrack {
    pub(super) track: PointTrack,
    /// Largest distance of a detection of this track from its predicted position [m].
    pub(super) reach: f64,
    /// Standard deviation of the position of a lost target around the place where it was last seen
    /// [m]: it may have turned instead of going on as predicted. None: only the predicted position counts.
    pub(super) strayed: Option<f64>,
}

impl PendingTrack {
    /// Largest distance of a detection of this track from the predicted position, also if the
    /// target has turned [m].
    pub(super) fn furthest(&self) -> f64 {
        let turned =
            self.strayed.map_or(0.0, |_| (self.track.position() - self.track.seen_at).norm());
        self.reach + turned
    }

    /// Difference to a detection [m] and its covariance [m^2], from the more probable of two
    /// positions: as predicted, or after a turn. None if the detection is too far away from both.
    pub(super) fn offset(&self, detection: &MeasuredPlace) -> Option<Offset> {
        match (self.if_ahead(detection), self.if_turned(detection)) {
            (Some(one), Some(other)) if cost(&other) < cost(&one) => Some(other),
            (one, other) => one.or(other),
        }
    }

    #[allow(non_snake_case)] // textbook letters
    fn if_ahead(&self, detection: &MeasuredPlace) -> Option<Offset> {
        let H = position_matrix(detection.delay);
        let covariance = symmetrised(H * self.track.estimate.covariance * H.transpose());
        self.offset_to(self.track.position_after(detection.delay), covariance, detection)
    }

    /// Like [`PendingTrack::offset`], for a target that has turned since it was last seen. None
    /// also if `strayed` is None.
    fn if_turned(&self, detection: &MeasuredPlace) -> Option<Offset> {
        let std = self.strayed?;
        self.offset_to(self.track.seen_at, Matrix3::identity() * (std * std), detection)
    }

    fn offset_to(
        &self,
        place: Vector3<f64>,
        covariance: Matrix3<f64>,
        detection: &MeasuredPlace,
    ) -> Option<Offset> {
        let y = detection.position - place;
        (y.norm() <= self.reach).then(|| Offset::new(y, detection.covariance + covariance))
    }

    /// The track, with the state of the detection `found`, if a turn explains the detection better
    /// than the predicted motion: the old motion is then unknown. None if the target went on as
    /// predicted.
    pub(super) fn turned_to(&self, found: &PointTrack, model: &Motion) -> Option<PointTrack> {
        let mut found = found.clone();
        found.predict(found.stamp_ns.max(self.track.stamp_ns), model);
        let place = MeasuredPlace::at_stamp(&found.estimate);
        let turned = cost(&self.if_turned(&place)?);
        let is_turned = self.if_ahead(&place).is_none_or(|one| turned < cost(&one));
        let PointTrack { estimate, aged, stamp_ns, seen_ns, seen_at, extent, .. } = found;
        let known = self.track.clone();
        is_turned.then_some(PointTrack {
            estimate,
            aged,
            stamp_ns,
            seen_ns,
            seen_at,
            extent,
            ..known
        })
    }
}

/// Position of a detection, its covariance, and the time to which both belong.
pub(super) struct MeasuredPlace {
    pub(super) position: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
    /// Time of the position after the stamp of the detection [s].
    pub(super) delay: f64,
}

impl MeasuredPlace {
    pub(super) fn at_stamp(estimate: &Gaussian<9>) -> Self {
        let covariance = position_block(&estimate.covariance);
        Self { position: position(estimate), covariance, delay: 0.0 }
    }

    /// Position of a detection that no scan has updated yet, at the time when it was measured. Its
    /// position at the stamp is hardly known, because the velocity is not: a target of 30 m/s moves
    /// by metres in between. A hypothesis that a scan has updated gives its position at the stamp.
    pub(super) fn of(hypothesis: &PointTrack, velocity_std: f64) -> Self {
        let at_stamp = Self::at_stamp(&hypothesis.estimate);
        if hypothesis.stamp_ns != hypothesis.born_ns || hypothesis.delay == 0.0 {
            return at_stamp;
        }
        // What its unknown velocity adds to the place at the stamp is taken off.
        let unknown = (hypothesis.delay * velocity_std).powi(2);
        let covariance = at_stamp.covariance - Matrix3::identity() * unknown;
        Self { position: hypothesis.born_at, covariance, delay: hypothesis.delay }
    }
}

/// -2 ln of the likelihood of a difference, without the constant term. Infinite if the covariance
/// is not positive definite.
fn cost(Offset { y, covariance, .. }: &Offset) -> f64 {
    kalman::mahalanobis(y, covariance)
        .map_or(f64::INFINITY, |distance| distance.squared + distance.log_determinant)
}
