//! Assignment of the clusters of a scan to tracks, and the points around tracks that belong to none.
//!
//! A target in the air is alone. A pane of glass that returns a few rays now and then, rain, dust and
//! leaves give points all over: a track that leaps among them has more of them around it than in it.

use super::measurement::{Measurement, SearchRegion};
use super::parameters::Hiding;
use super::state::{PointTrack, UNNUMBERED};
use nalgebra::Vector3;

/// Points this near to a track are around it [m].
const AROUND: f64 = 2.0;
/// Clusters of more points are parts of something that is there all the time.
const MOST_POINTS: usize = 3;

/// Clusters of a scan, and which of them is assigned to every track.
#[derive(Default)]
pub(super) struct ClusterAssignment {
    pub(super) clusters: Vec<Measurement>,
    pub(super) cluster_of: Vec<Option<usize>>,
}

impl ClusterAssignment {
    /// The cluster of every track, with the covariance that it has for it.
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

    /// Count the points of tracks that are not confirmed, and those around them.
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

    /// Points around a place in small clusters that no track holds.
    fn stray_points(&self, place: Vector3<f64>) -> usize {
        let is_stray = |index: &usize| !self.cluster_of.contains(&Some(*index));
        let stray = (0..self.clusters.len()).filter(is_stray).map(|index| &self.clusters[index]);
        let is_near = |cluster: &&Measurement| {
            cluster.n_points <= MOST_POINTS && (cluster.position - place).norm() <= AROUND
        };
        stray.filter(is_near).map(|cluster| cluster.n_points).sum()
    }
}
