//! Output of the tracker: its tracks at one time, the changes by a call, and predicted positions of
//! targets.

use crate::estimation::kalman::{Gaussian, mahalanobis, symmetrised};
use crate::geometry::transform::Transform;
use crate::tracking::kind::{KINDS, TrackKind};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// A track, predicted to one time. Positions are in the frame of the tracker; in results of the
/// detector, they are in the world frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// ID of the track. It is never given to another track.
    pub id: i64,
    /// Time of the state [ns].
    pub stamp_ns: i64,
    /// Position [m], velocity [m/s], acceleration [m/s^2], and their covariance.
    pub state: Gaussian<9>,
    /// Sides of the bounding box of the last cluster or detection [m].
    pub extent: [f64; 3],
    /// Number of detections that updated it.
    pub n_detections: u32,
    /// Time from its first detection to `stamp_ns` [s].
    pub age: f64,
    /// Time of the last measurement [ns].
    pub seen_ns: i64,
    /// Whether the track is confirmed: see [`super::parameters::Confirmation`].
    pub confirmed: bool,
    /// Whether to report the track: it is confirmed, and was measured recently enough.
    pub reported: bool,
    /// Probability that its target exists. NaN if tracks are confirmed by counts.
    pub existence: f64,
    /// Kind of the target. `Flying` if tracks are confirmed by counts.
    pub kind: TrackKind,
    /// Probability of every kind, given that the target exists, in the order of [`TrackKind::ALL`].
    /// NaN if tracks are confirmed by counts.
    pub kind_probability: [f64; KINDS],
}

impl Track {
    fn place(&self) -> Vector3<f64> {
        self.state.mean.fixed_rows::<3>(0).into_owned()
    }

    /// The track in another frame: `target_from_source` is the pose of its present frame in that
    /// one.
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

/// Largest squared Mahalanobis distance at which two tracks may have the same target: 95 % quantile
/// of chi-squared with 3 degrees of freedom.
const MAYBE: f64 = 7.81;

/// Do not report a flying track if another track near it was measured more recently. The rows of a
/// sparse sensor can make two detections of one target, and only one of the two tracks goes on.
pub(super) fn leave_out_doubles(tracks: &mut [Track]) {
    let flies = |track: &Track| track.reported && track.kind == TrackKind::Flying;
    let seen: Vec<(i64, Vector3<f64>)> = tracks
        .iter()
        .filter(|track| flies(track))
        .map(|track| (track.seen_ns, track.place()))
        .collect();
    let newest = seen.iter().map(|(seen_ns, _)| *seen_ns).max();
    for track in tracks.iter_mut().filter(|track| flies(track) && Some(track.seen_ns) < newest) {
        let covariance = track.state.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let is_near = |place: &Vector3<f64>| {
            mahalanobis(&(place - track.place()), &covariance)
                .is_ok_and(|distance| distance.squared <= MAYBE)
        };
        let is_double =
            seen.iter().any(|(seen_ns, place)| *seen_ns > track.seen_ns && is_near(place));
        track.reported = !is_double;
    }
}

/// Where a track predicts its target at the stamp of a scan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ExpectedTarget {
    /// Position of the target [m].
    pub(crate) position: [f64; 3],
    /// Velocity of the target [m/s].
    pub(crate) velocity: [f64; 3],
    /// Half of the sides of the box that contains every place where a part of the target may be
    /// [m].
    pub(crate) half: [f64; 3],
    /// Usual sides of the bounding box of the target [m].
    pub(crate) size: [f64; 3],
    /// Whether the target has stood at `position` since the burn-in. The occupied voxels there are
    /// then its own points.
    pub(crate) has_stood: bool,
}

/// A target that was found in several scans together (track-before-detect), at the stamp of the
/// newest of these scans.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FoundTarget {
    /// Position of the target [m].
    pub(crate) position: [f64; 3],
    /// Velocity of the target [m/s].
    pub(crate) velocity: [f64; 3],
    /// The same three values for every axis: variance of the position [m^2], covariance of position
    /// and velocity [m^2/s], variance of the velocity [m^2/s^2].
    pub(crate) covariance: [f64; 3],
    /// Position of its first return [m].
    pub(crate) first: [f64; 3],
    /// Time of its first return [ns].
    pub(crate) first_ns: i64,
    /// Number of scans with returns of the target.
    pub(crate) n_returns: u32,
}

/// Changes of the tracks by one call, as IDs of tracks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// Whether the cloud was older than the newest one. Such a cloud is kept for late detections
    /// and changes no track.
    pub late: bool,
    /// Tracks that were corrected by a cluster.
    pub corrected: Vec<i64>,
    /// Index in the cloud of one point of the cluster of each corrected track.
    pub rows: Vec<u32>,
    /// New tracks.
    pub born: Vec<i64>,
    /// Tracks that this call has confirmed.
    pub confirmed: Vec<i64>,
    /// Removed tracks.
    pub removed: Vec<i64>,
    /// Merged tracks: pairs of the ID that stays and the ID that ends.
    pub merged: Vec<[i64; 2]>,
    /// Number of measurements that were not used because a covariance was not positive definite.
    pub rejected: usize,
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::SVector;

    /// A track at `x`, known to `std` [m], that was measured at `seen_ns`.
    fn track(x: f64, std: f64, seen_ns: i64) -> Track {
        let mut mean = SVector::<f64, 9>::zeros();
        mean[0] = x;
        Track {
            id: 0,
            stamp_ns: 100,
            state: Gaussian { mean, covariance: SMatrix::identity() * (std * std) },
            extent: [0.3; 3],
            n_detections: 5,
            age: 1.0,
            seen_ns,
            confirmed: true,
            reported: true,
            existence: 0.99,
            kind: TrackKind::Flying,
            kind_probability: [0.0, 1.0, 0.0, 0.0, 0.0],
        }
    }

    fn reported<const N: usize>(mut tracks: [Track; N]) -> [bool; N] {
        leave_out_doubles(&mut tracks);
        tracks.map(|track| track.reported)
    }

    #[test]
    fn of_two_tracks_at_one_place_the_measured_one_is_reported() {
        assert_eq!(reported([track(0.0, 0.05, 100), track(0.5, 0.3, 50)]), [true, false]);
        assert_eq!(reported([track(0.5, 0.3, 50), track(0.0, 0.05, 100)]), [false, true]);
    }

    /// Both tracks are reported if they are certainly apart, or if both were measured at the same
    /// time.
    #[test]
    fn two_targets_are_reported() {
        assert_eq!(reported([track(0.0, 0.05, 100), track(0.5, 0.1, 50)]), [true; 2]);
        assert_eq!(reported([track(0.0, 0.3, 100), track(0.1, 0.3, 100)]), [true; 2]);
        assert_eq!(reported([track(0.0, 0.3, 50), track(0.1, 0.3, 50)]), [true; 2]);
    }

    #[test]
    fn only_flying_targets_that_are_reported_hide_others() {
        let still = Track { kind: TrackKind::Static, ..track(0.0, 0.05, 100) };
        assert_eq!(reported([still, track(0.1, 0.3, 50)]), [true; 2]);
        let hidden = Track { reported: false, ..track(0.0, 0.05, 100) };
        assert_eq!(reported([hidden, track(0.1, 0.3, 50)]), [false, true]);
    }
}
