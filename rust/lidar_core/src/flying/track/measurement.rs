//! Inputs of a track: a scan, its measurements, and the region of a track's search.

#![allow(non_snake_case)] // textbook letters

use super::belief::kinds::TargetShape;
use super::motion::{self, position_matrix};
use super::parameters::Hiding;
use super::visibility::occupancy::{Occupancy, Visibility};
use crate::estimation::kalman::{Gaussian, symmetrised};
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

/// Search region of a track.
pub(super) struct SearchRegion {
    /// State of the track at the stamp of the scan.
    pub(super) estimate: Gaussian<9>,
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
        let H = position_matrix(delay);
        let Gaussian { mean, covariance } = &self.estimate;
        (H * mean, symmetrised(H * covariance * H.transpose()))
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
