//! Assignment of the clusters of a scan to tracks, and count of the points around tracks.
//!
//! A flying target is alone. Rain, dust, leaves, and panes of glass that return a few rays now and
//! then give scattered points. A track that jumps among these has more points around it than in its
//! own clusters.

use super::measurement::{Measurement, SearchRegion};
use super::parameters::Hiding;
use super::state::{PointTrack, UNNUMBERED};
use nalgebra::Vector3;

/// Points within this distance of a track count as points around it [m].
const AROUND: f64 = 2.0;
/// Largest cluster whose points count as points around a track. A cluster of more points belongs to
/// something that is always there.
const MOST_POINTS: usize = 3;

/// Clusters of a scan, and which of them belongs to each track.
#[derive(Default)]
pub(super) struct ClusterAssignment {
    pub(super) clusters: Vec<Measurement>,
    pub(super) cluster_of: Vec<Option<usize>>,
}

impl ClusterAssignment {
    /// The measurement of every track, with the covariance that its cluster has for this track;
    /// None if it has no cluster.
    pub(super) fn measured(
        &self,
        regions: &[SearchRegion],
        hiding: Option<Hiding>,
    ) -> Vec<Option<Measurement>> {
        let measured = |(cluster, region): (&Option<usize>, &SearchRegion)| {
            let cluster = &self.clusters[(*cluster)?];
            let covariance = region.covariance_of(cluster, hiding);
            Some(Measurement { covariance, ..cluster.clone() })
        };
        self.cluster_of.iter().zip(regions).map(measured).collect()
    }

    /// For each unconfirmed track, count the points of its cluster and the points around it.
    pub(super) fn count<'a>(&self, tracks: impl Iterator<Item = &'a mut PointTrack>) {
        for (track, cluster) in tracks.zip(&self.cluster_of) {
            if track.confirmed || track.id == UNNUMBERED {
                continue;
            }
            let cluster = cluster.map(|index| &self.clusters[index]);
            let place = cluster.map_or(track.position(), |cluster| cluster.position);
            let own = cluster.map_or(0, |cluster| cluster.n_points);
            track.count_points(own, self.stray_points(place));
        }
    }

    /// Number of points around a place, in small clusters that belong to no track.
    fn stray_points(&self, place: Vector3<f64>) -> usize {
        let is_stray = |index: &usize| !self.cluster_of.contains(&Some(*index));
        let stray = (0..self.clusters.len()).filter(is_stray).map(|index| &self.clusters[index]);
        let is_near = |cluster: &&Measurement| {
            cluster.n_points <= MOST_POINTS && (cluster.position - place).norm() <= AROUND
        };
        stray.filter(is_near).map(|cluster| cluster.n_points).sum()
    }
}
