//! Inputs for the update of a track: the scan, its measurements, and the search region.

#![allow(non_snake_case)] // textbook letters

use super::belief::kinds::TargetShape;
use super::motion::{self, position_matrix};
use super::parameters::Hiding;
use super::visibility::occupancy::{Occupancy, Visibility};
use crate::estimation::kalman::{self, Gaussian, symmetrised};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// A scan, as input of an update.
#[derive(Clone, Copy)]
pub(super) struct CloudScan<'a> {
    pub(super) points: &'a [[f32; 3]],
    /// Time of every point after the stamp [s]. None: all points are of the stamp.
    pub(super) delays: Option<&'a [f32]>,
    pub(super) stamp_ns: i64,
    pub(super) occupied: &'a dyn Occupancy,
    pub(super) visibility: Option<&'a dyn Visibility>,
}

impl CloudScan<'_> {
    /// Time of the point with the index `row` after the stamp [s].
    pub(super) fn delay(&self, row: u32) -> f32 {
        self.delays.map_or(0.0, |delays| delays[row as usize])
    }

    /// Points of the cloud with these indices [m].
    pub(super) fn points_of(&self, rows: &[u32]) -> Vec<[f32; 3]> {
        rows.iter().map(|&row| self.points[row as usize]).collect()
    }
}

/// A measured position, its covariance, and the size of the measured object.
#[derive(Clone, Debug)]
pub(super) struct Measurement {
    pub(super) position: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
    /// Time of the measurement after the time of the track's state [s]. It differs from zero
    /// because a scan takes time.
    pub(super) delay: f64,
    pub(super) extent: [f64; 3],
    /// Number of points; 0 for a detection.
    pub(super) n_points: usize,
    /// Whether a part of the target may be hidden.
    pub(super) is_cut: bool,
    /// Index in the cloud of one of its points; None for a detection.
    pub(super) row: Option<u32>,
}

/// Evidence of a detection about the existence of its track's target.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Evidence {
    /// Whether the detection is certain.
    pub(super) is_sure: bool,
    /// Whether it counts as flying only because of its track.
    pub(super) is_led: bool,
    /// Whether surfaces around it give more returns than it has itself.
    pub(super) is_among_surfaces: bool,
    /// Whether it may be a part of the surface beside it.
    pub(super) is_joined: bool,
    pub(super) shape: Option<TargetShape>,
}

/// Position of a state `delay` seconds after its time [m], and the covariance [m^2].
fn place_of(state: &Gaussian<9>, delay: f64) -> (Vector3<f64>, Matrix3<f64>) {
    let H = position_matrix(delay);
    (H * state.mean, symmetrised(H * state.covariance * H.transpose()))
}

/// A measurement beside the place where a track expects it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Offset {
    /// Difference to the expected place [m].
    pub(super) y: Vector3<f64>,
    /// Covariance of the difference [m^2].
    pub(super) covariance: Matrix3<f64>,
    /// Least cost of the pair, -2 ln of its likelihood up to a constant.
    pub(super) least_cost: f64,
}

impl Offset {
    /// A difference [m] and its covariance [m^2], whose cost follows from these alone.
    pub(super) fn new(y: Vector3<f64>, covariance: Matrix3<f64>) -> Self {
        Self { y, covariance, least_cost: f64::NEG_INFINITY }
    }
}

/// Region in which a track searches for its target in a scan.
pub(super) struct SearchRegion {
    /// State of the track at the stamp of the scan.
    pub(super) estimate: Gaussian<9>,
    /// State at the stamp if the target has turned hard since the last scan. None if this track
    /// cannot turn hard: see [`super::state::PointTrack::turned_at`].
    pub(super) turned: Option<Gaussian<9>>,
    /// Radius of the region [m].
    pub(super) radius: f64,
    pub(super) size: [f64; 3],
    pub(super) confirmed: bool,
}

impl SearchRegion {
    pub(super) fn position(&self) -> Vector3<f64> {
        motion::position(&self.estimate)
    }

    pub(super) fn velocity(&self) -> Vector3<f64> {
        self.estimate.mean.fixed_rows::<3>(3).into_owned()
    }

    pub(super) fn acceleration(&self) -> Vector3<f64> {
        self.estimate.mean.fixed_rows::<3>(6).into_owned()
    }

    /// Predicted position `delay` seconds after the stamp [m], and its covariance [m^2]. A new
    /// track knows the position of its target but hardly the velocity: 0.1 s later, its position is
    /// uncertain by 0.4 m.
    pub(super) fn place_at(&self, delay: f64) -> (Vector3<f64>, Matrix3<f64>) {
        place_of(&self.estimate, delay)
    }

    /// Difference of a cluster to its expected place and the covariance of that. None if the cluster is
    /// further away than the radius of the region, or beyond `gate` though the target may have turned hard.
    pub(super) fn offset(
        &self,
        cluster: &Measurement,
        hiding: Option<Hiding>,
        gate: f64,
    ) -> Option<Offset> {
        let noise = self.covariance_of(cluster, hiding);
        let ahead = self.difference(&self.estimate, cluster, &noise);
        if ahead.y.norm() > self.radius {
            return None;
        }
        let Some((turned, cost)) = self.turned_from(&ahead, cluster, hiding, gate) else {
            return Some(ahead);
        };
        let offset = self.difference(turned, cluster, &noise);
        // A cluster that needs a turn is never more probable than one on the edge of the gate, which needs none.
        (offset.y.norm() <= self.radius).then_some(Offset { least_cost: cost, ..offset })
    }

    /// The state after a hard turn, if the state without a turn cannot explain the measurement of this track: its
    /// squared Mahalanobis distance is beyond `gate`. Otherwise None.
    pub(super) fn turned_by(
        &self,
        found: &Measurement,
        hiding: Option<Hiding>,
        gate: f64,
    ) -> Option<&Gaussian<9>> {
        let ahead = self.difference(&self.estimate, found, &found.covariance);
        self.turned_from(&ahead, found, hiding, gate).map(|(turned, _)| turned)
    }

    /// As [`Self::turned_by`], given the difference without a turn; and the cost of a pair on the edge of the gate.
    fn turned_from(
        &self,
        ahead: &Offset,
        cluster: &Measurement,
        hiding: Option<Hiding>,
        gate: f64,
    ) -> Option<(&Gaussian<9>, f64)> {
        // That it is a part explains a smaller cluster aside; a turn would excuse it a second time.
        let is_part = (0..3).any(|axis| self.hidden_length(cluster, hiding, axis) > 0.0);
        let turned = self.turned.as_ref().filter(|_| !is_part)?;
        let distance = kalman::mahalanobis(&ahead.y, &ahead.covariance).ok()?;
        (distance.squared > gate).then_some((turned, gate + distance.log_determinant))
    }

    /// Difference of a cluster with this covariance [m^2] to the place of a state at its time.
    fn difference(
        &self,
        state: &Gaussian<9>,
        cluster: &Measurement,
        noise: &Matrix3<f64>,
    ) -> Offset {
        let (place, covariance) = place_of(state, cluster.delay);
        Offset::new(cluster.position - place, covariance + noise)
    }

    /// Covariance of a cluster as a measurement of this track [m^2]. Where a side is partly hidden,
    /// the missing part may be at one end, which makes the position along this side less certain.
    pub(super) fn covariance_of(
        &self,
        cluster: &Measurement,
        hiding: Option<Hiding>,
    ) -> Matrix3<f64> {
        let mut covariance = cluster.covariance;
        for axis in 0..3 {
            covariance[(axis, axis)] += self.hidden_length(cluster, hiding, axis).powi(2);
        }
        covariance
    }

    /// Hidden length of a cluster along an axis [m]; zero if the whole side is visible.
    fn hidden_length(&self, cluster: &Measurement, hiding: Option<Hiding>, axis: usize) -> f64 {
        let (size, extent) = (self.size[axis], cluster.extent[axis]);
        let is_short = hiding.is_some_and(|hiding| extent < hiding.share * size);
        if cluster.is_cut && is_short { size - extent } else { 0.0 }
    }
}
