//! Output of the tracker: tracks at a time, changes by a call, and places to look for targets.

use crate::estimation::kalman::{Gaussian, symmetrised};
use crate::geometry::transform::Transform;
use crate::tracking::kind::{KINDS, TrackKind};
use nalgebra::{Matrix3, SMatrix};

/// A track, predicted to one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Number, never reused.
    pub id: i64,
    /// Time of the state [ns].
    pub stamp_ns: i64,
    /// Position [m], velocity [m/s], acceleration [m/s^2], and their covariance.
    pub state: Gaussian<9>,
    /// Sides of the bounding box of the last cluster or detection [m].
    pub extent: [f64; 3],
    /// Number of detections that updated it.
    pub n_detections: u32,
    /// Time since its first detection [s].
    pub age: f64,
    /// Time of the last measurement [ns].
    pub seen_ns: i64,
    /// Whether it is to be reported.
    pub confirmed: bool,
    /// Confirmed, and not out of sight for too long.
    pub reported: bool,
    /// Probability that its target exists; not a number where tracks are confirmed by counts.
    pub existence: f64,
    /// Kind of the target; Flying if tracks are confirmed by counts.
    pub kind: TrackKind,
    /// Probability of every kind, in the order of [`TrackKind::ALL`], if the target exists; not
    /// numbers where tracks are confirmed by counts.
    pub kind_probability: [f64; KINDS],
}

impl Track {
    /// The track in another frame.
    #[must_use]
    pub fn moved(&self, target_from_source: &Transform) -> Self {
        let r = &target_from_source.rotation;
        let turn = Matrix3::from_fn(|row, column| r[row][column]);
        let mut turns = SMatrix::<f64, 9, 9>::zeros();
        for block in [0, 3, 6] {
            turns.fixed_view_mut::<3, 3>(block, block).copy_from(&turn);
        }
        let mut mean = turns * self.state.mean;
        for (axis, offset) in target_from_source.translation.iter().enumerate() {
            mean[axis] += offset;
        }
        let covariance = symmetrised(turns * self.state.covariance * turns.transpose());
        Self { state: Gaussian { mean, covariance }, ..self.clone() }
    }
}

/// A target that a track predicts, at the stamp of a scan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ExpectedTarget {
    /// Position of the target [m].
    pub(crate) position: [f64; 3],
    /// Velocity of the target [m/s].
    pub(crate) velocity: [f64; 3],
    /// Half of the sides of the box around all places where a part of it may be [m].
    pub(crate) half: [f64; 3],
    /// Usual sides of its own box [m].
    pub(crate) size: [f64; 3],
    /// It has stood at `position` since the burn-in, and its own points are what the map holds there.
    pub(crate) has_stood: bool,
}

/// A target that several scans together show, at the stamp of the newest one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FoundTarget {
    /// Position of the target [m].
    pub(crate) position: [f64; 3],
    /// Velocity of the target [m/s].
    pub(crate) velocity: [f64; 3],
    /// On every axis the variance of the position [m^2], the covariance of position and velocity [m^2/s], and the
    /// variance of the velocity [m^2/s^2].
    pub(crate) covariance: [f64; 3],
    /// Where and when it was seen first [m], [ns].
    pub(crate) first: [f64; 3],
    pub(crate) first_ns: i64,
    /// Scans that showed it.
    pub(crate) n_returns: u32,
}

/// Changes of the tracks by one call, by their numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// The cloud was older than the newest one: kept for late detections, tracks untouched.
    pub late: bool,
    /// Corrected by a cluster.
    pub corrected: Vec<i64>,
    /// For each of these the row of a point of its cluster.
    pub rows: Vec<u32>,
    /// New.
    pub born: Vec<i64>,
    /// Reported from now on.
    pub confirmed: Vec<i64>,
    /// Removed.
    pub removed: Vec<i64>,
    /// Pairs of the track that stays and the one that was merged into it.
    pub merged: Vec<[i64; 2]>,
    /// Measurements that could not be used because a covariance was not positive definite.
    pub rejected: usize,
}
