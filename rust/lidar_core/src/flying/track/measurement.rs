//! Inputs of a track: a scan, its measurements, and the region of a track's search.

#![allow(non_snake_case)] // textbook letters

use super::belief::kinds::TargetShape;
use super::motion::{self, position_matrix};
use super::parameters::Hiding;
use super::visibility::occupancy::{Occupancy, Visibility};
use crate::estimation::kalman::{self, Gaussian, symmetrised};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Input of an update from one scan.
#[derive(Clone, Copy)]
pub(super) struct CloudScan<'a> {
    pub(super) points: &'a [[f32; 3]],
    /// Time of every point after the stamp [s].
    pub(super) delays: Option<&'a [f32]>,
    pub(super) stamp_ns: i64,
    pub(super) occupied: &'a dyn Occupancy,
    pub(super) visibility: Option<&'a dyn Visibility>,
}

impl CloudScan<'_> {
    /// Time of a point after the stamp [s].
    pub(super) fn delay(&self, row: u32) -> f32 {
        self.delays.map_or(0.0, |delays| delays[row as usize])
    }

    /// Points of these rows.
    pub(super) fn points_of(&self, rows: &[u32]) -> Vec<[f32; 3]> {
        rows.iter().map(|&row| self.points[row as usize]).collect()
    }
}

/// Something measured: where, how well, and how large.
#[derive(Clone, Debug)]
pub(super) struct Measurement {
    pub(super) position: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
    /// Time of the measurement after the state's [s]: a scan takes a while.
    pub(super) delay: f64,
    pub(super) extent: [f64; 3],
    /// Number of points; 0 for a detection.
    pub(super) n_points: usize,
    /// True if a part of the target may be hidden.
    pub(super) is_cut: bool,
    /// Row of one of its points in the cloud.
    pub(super) row: Option<u32>,
}

/// Evidence of a detection for the existence of its track.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Evidence {
    pub(super) is_sure: bool,
    /// Only its track tells that it flies.
    pub(super) is_led: bool,
    /// Surfaces around it give more returns than it does.
    pub(super) is_among_surfaces: bool,
    /// It may be a part of the surface beside it.
    pub(super) is_joined: bool,
    pub(super) shape: Option<TargetShape>,
}

/// Place of a state `delay` seconds after its time, and its covariance.
fn place_of(state: &Gaussian<9>, delay: f64) -> (Vector3<f64>, Matrix3<f64>) {
    let H = position_matrix(delay);
    (H * state.mean, symmetrised(H * state.covariance * H.transpose()))
}

/// Difference of a cluster to the place of a state at its time, and its covariance.
fn difference(state: &Gaussian<9>, cluster: &Measurement) -> (Vector3<f64>, Matrix3<f64>) {
    let (place, covariance) = place_of(state, cluster.delay);
    (cluster.position - place, covariance + cluster.covariance)
}

/// Search region of a track.
pub(super) struct SearchRegion {
    /// State of the track at the stamp of the scan.
    pub(super) estimate: Gaussian<9>,
    /// The same if its target has turned hard since it was seen; None if it is none that does.
    pub(super) turned: Option<Gaussian<9>>,
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

    /// Expected place `delay` seconds after the stamp, and its covariance. A track that has just begun knows where
    /// its target was, but hardly how fast it is: 0.1 s after that, its place is uncertain by 0.4 m.
    pub(super) fn place_at(&self, delay: f64) -> (Vector3<f64>, Matrix3<f64>) {
        place_of(&self.estimate, delay)
    }

    /// Difference of a cluster to the place where it is expected, and the covariance of that; None if it is out of reach.
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

    /// The state of a target that has turned hard, where that of one which has not cannot explain a cluster with its
    /// covariance for this track: its squared Mahalanobis distance is beyond `gate`.
    pub(super) fn turned_to(&self, cluster: &Measurement, gate: f64) -> Option<&Gaussian<9>> {
        let turned = self.turned.as_ref()?;
        let (y, covariance) = difference(&self.estimate, cluster);
        let is_ahead = kalman::mahalanobis(&y, &covariance).is_ok_and(|one| one.squared <= gate);
        (!is_ahead).then_some(turned)
    }

    /// Covariance of a cluster as a measurement of this track: what is missing of a hidden side
    /// may be missing on one end.
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
