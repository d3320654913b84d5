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
    /// Time of the point `row` after the stamp [s].
    pub(super) fn delay(&self, row: u32) -> f32 {
        self.delays.map_or(0.0, |delays| delays[row as usize])
    }

    /// Points in these rows of the cloud [m].
    pub(super) fn points_of(&self, rows: &[u32]) -> Vec<[f32; 3]> {
        rows.iter().map(|&row| self.points[row as usize]).collect()
    }
}

/// A measured position, its covariance, and the size of what was measured.
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
    /// Row in the cloud of one of its points; None for a detection.
    pub(super) row: Option<u32>,
}

/// What a detection says about the existence of its track's target.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Evidence {
    /// Whether the detection is certain.
    pub(super) is_sure: bool,
    /// Whether only its track tells that it flies.
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

/// Difference of a cluster to the position that a state predicts at the time of the cluster [m],
/// and its covariance [m^2].
fn difference(state: &Gaussian<9>, cluster: &Measurement) -> (Vector3<f64>, Matrix3<f64>) {
    let (place, covariance) = place_of(state, cluster.delay);
    (cluster.position - place, covariance + cluster.covariance)
}

/// Region in which a track looks for its target in a scan.
pub(super) struct SearchRegion {
    /// State of the track at the stamp of the scan.
    pub(super) estimate: Gaussian<9>,
    /// State at the stamp if the target has turned hard since it was last seen. None if this track
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

    /// Difference of a cluster to its predicted position [m] and the covariance of this difference
    /// [m^2]. None if the cluster is out of reach.
    pub(super) fn offset(
        &self,
        cluster: &Measurement,
        hiding: Option<Hiding>,
        gate: f64,
    ) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let covariance = self.covariance_of(cluster, hiding);
        let cluster = Measurement { covariance, ..cluster.clone() };
        let estimate = self.turned_to(&cluster, gate).unwrap_or(&self.estimate);
        let (y, covariance) = difference(estimate, &cluster);
        (y.norm() <= self.radius).then_some((y, covariance))
    }

    /// The state after a hard turn, if the state without a turn cannot explain the cluster: the
    /// squared Mahalanobis distance, with the cluster's covariance for this track, is beyond
    /// `gate`. Otherwise None.
    pub(super) fn turned_to(&self, cluster: &Measurement, gate: f64) -> Option<&Gaussian<9>> {
        let turned = self.turned.as_ref()?;
        let (y, covariance) = difference(&self.estimate, cluster);
        let is_ahead = kalman::mahalanobis(&y, &covariance).is_ok_and(|one| one.squared <= gate);
        (!is_ahead).then_some(turned)
    }

    /// Covariance of a cluster as a measurement of this track [m^2]. Where a side is partly hidden,
    /// the missing part may be at one end, which makes the position along this side less certain.
    pub(super) fn covariance_of(
        &self,
        cluster: &Measurement,
        hiding: Option<Hiding>,
    ) -> Matrix3<f64> {
        let mut covariance = cluster.covariance;
        for (axis, (size, extent)) in self.size.into_iter().zip(cluster.extent).enumerate() {
            if cluster.is_cut && hiding.is_some_and(|hiding| extent < hiding.share * size) {
                covariance[(axis, axis)] += (size - extent) * (size - extent);
            }
        }
        covariance
    }
}
