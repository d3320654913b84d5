//! Groups of clusters: fragments of one larger thing, judged by their common extent.
//!
//! Crowns of trees and rows of a distant pole fall apart into clusters of a target's size. What
//! lies close together and is not known background is taken as one thing.

use super::classify::Cluster;
use crate::Error;
use crate::geometry::cluster::{Clustering, label};
use crate::geometry::transform::{minus, norm};

/// Extent (diagonal of the box, [m]) of the group of every cluster that is not background.
pub(crate) fn extents(
    points: &[[f32; 3]],
    clusters: &[Cluster],
    background: &[bool],
    distance: Option<f64>,
) -> Result<Vec<f64>, Error> {
    let mut extents: Vec<f64> = clusters.iter().map(Cluster::diagonal).collect();
    let Some(max_distance) = distance else { return Ok(extents) };
    let mut cloud = Vec::new();
    let mut owner = Vec::new();
    for (index, cluster) in clusters.iter().enumerate().filter(|&(index, _)| !background[index]) {
        for &row in &cluster.members {
            cloud.push(points[row as usize]);
            owner.push(index);
        }
    }
    let groups = label(&cloud, &Clustering { max_distance, min_points: 1, max_points: None })?;
    let count = groups.iter().max().map_or(0, |&last| last as usize + 1);
    let mut boxes = vec![([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]); count];
    for (&group, &index) in groups.iter().zip(&owner) {
        let (low, high) = &mut boxes[group as usize];
        for axis in 0..3 {
            low[axis] = low[axis].min(clusters[index].low[axis]);
            high[axis] = high[axis].max(clusters[index].high[axis]);
        }
    }
    for (&group, &index) in groups.iter().zip(&owner) {
        let (low, high) = boxes[group as usize];
        extents[index] = norm(minus(high, low));
    }
    Ok(extents)
}
