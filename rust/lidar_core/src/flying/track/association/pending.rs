//! Predicted place of a track's target at a set of detections, and fit of each detection.

use super::super::motion::{position, position_block, position_matrix};
use super::super::parameters::Motion;
use super::super::state::PointTrack;
use crate::estimation::kalman::{self, Gaussian, symmetrised};
use nalgebra::{Matrix3, Vector3};

/// A track to which detections can be assigned.
pub(super) struct PendingTrack {
    pub(super) track: PointTrack,
    /// Detections further away are not its own [m].
    pub(super) reach: f64,
    /// A target that is lost may have gone on as predicted, or it may have turned: then it is this
    /// far from where it was seen, as a standard deviation [m].
    pub(super) strayed: Option<f64>,
}

impl PendingTrack {
    /// Largest distance of its detections from where it is predicted [m].
    pub(super) fn furthest(&self) -> f64 {
        let turned =
            self.strayed.map_or(0.0, |_| (self.track.position() - self.track.seen_at).norm());
        self.reach + turned
    }

    /// Difference to a detection and its covariance, of the more probable of the places where the
    /// target may be; None if the detection is out of reach.
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

    /// The offset as if the target had turned since it was seen.
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
        (y.norm() <= self.reach).then_some((y, detection.covariance + covariance))
    }

    /// The track after a turn that led to a detection: its motion is not known any more. None if the
    /// target went on as predicted.
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

/// Where a hypothesis is at a time after its stamp.
pub(super) struct MeasuredPlace {
    pub(super) position: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
    /// Time after the stamp [s].
    pub(super) delay: f64,
}

impl MeasuredPlace {
    pub(super) fn at_stamp(estimate: &Gaussian<9>) -> Self {
        let covariance = position_block(&estimate.covariance);
        Self { position: position(estimate), covariance, delay: 0.0 }
    }

    /// Of a fresh detection at the time when it was measured: where it was at the stamp of its scan,
    /// before that, nobody knows without its velocity. A target of 30 m/s moves by metres meanwhile.
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

/// A difference and its covariance.
pub(super) type Offset = (Vector3<f64>, Matrix3<f64>);

/// -2 ln of the likelihood of a difference, without what all share.
fn cost((y, covariance): &Offset) -> f64 {
    kalman::mahalanobis(y, covariance)
        .map_or(f64::INFINITY, |distance| distance.squared + distance.log_determinant)
}
