//! Parts of large targets.
//!
//! Where rays graze a wing, their ends lie further apart than the gap inside a cluster, and the tips of the
//! wing are clusters of their own. One detection is of them all.

use crate::flying::classify::classifier::Classification;
use crate::flying::classify::clusters::{Cluster, Clusters};
use crate::flying::point_class::PointClass;
use crate::geometry::transform::norm;

/// A target with a longer side may fall into several clusters [m].
const LARGE: f64 = 0.75;
/// Parts of it are no further apart than this, from box to box [m].
const GAP: f64 = 0.5;

/// Clusters with their classes, those of one large target as one.
pub(crate) struct UnitedClusters<'c> {
    /// Made only where a large target has parts.
    united: Option<Clusters>,
    items: Vec<(usize, &'c Classification)>,
}

impl<'c> UnitedClusters<'c> {
    /// Of the clusters of `points` with these numbers; those of another kind than flying stay as they
    /// are. What is united has no longer diagonal than `longest` [m]; None unites nothing.
    pub(crate) fn of(
        points: &[[f32; 3]],
        clusters: &Clusters,
        classifications: impl Iterator<Item = (usize, &'c Classification)>,
        longest: Option<f64>,
    ) -> Self {
        let mut items: Vec<(usize, &Classification)> = classifications.collect();
        let flying: Vec<(usize, Cluster<'_>)> = items
            .iter()
            .filter(|(_, one)| one.class == PointClass::Flying)
            .map(|&(index, _)| (index, clusters.get(index)))
            .collect();
        let mut host: Vec<(usize, usize)> = Vec::new();
        for &(index, part) in &flying {
            let larger = |(other, whole): &&(usize, Cluster<'_>)| {
                *other != index
                    && side(whole) >= LARGE
                    && (side(whole), *other) > (side(&part), index)
                    && gap(whole, &part) <= GAP
                    && longest.is_some_and(|longest| across(whole, &part) <= longest)
            };
            let whole = flying
                .iter()
                .filter(larger)
                .max_by(|(_, one), (_, other)| side(one).total_cmp(&side(other)));
            host.extend(whole.map(|&(whole, _)| (index, whole)));
        }
        if host.is_empty() {
            return Self { united: None, items };
        }
        items.retain(|(index, _)| !host.iter().any(|(part, _)| part == index));
        // A part of a part belongs to the largest of them.
        let root = |mut index: usize| {
            while let Some(&(_, whole)) = host.iter().find(|(part, _)| *part == index) {
                index = whole;
            }
            index
        };
        let mut labels = vec![-1; points.len()];
        for (place, (index, _)) in items.iter().enumerate() {
            let parts = host.iter().map(|&(part, _)| part).filter(|&part| root(part) == *index);
            for row in parts.chain([*index]).flat_map(|own| clusters.get(own).members) {
                labels[*row as usize] = place as i32;
            }
        }
        let mut united = Clusters::default();
        united.fill(points, &labels);
        Self { united: Some(united), items }
    }

    /// Each with its class.
    pub(crate) fn iter<'a>(
        &'a self,
        clusters: &'a Clusters,
    ) -> impl Iterator<Item = (Cluster<'a>, &'a Classification)> {
        self.items.iter().enumerate().map(move |(place, &(index, classification))| {
            let cluster = match &self.united {
                Some(united) => united.get(place),
                None => clusters.get(index),
            };
            (cluster, classification)
        })
    }
}

fn side(cluster: &Cluster<'_>) -> f64 {
    cluster.extent().into_iter().fold(0.0, f64::max)
}

/// From box to box [m].
fn gap(one: &Cluster<'_>, other: &Cluster<'_>) -> f64 {
    let away = |axis: usize| {
        (one.low[axis] - other.high[axis]).max(other.low[axis] - one.high[axis]).max(0.0)
    };
    norm([0, 1, 2].map(away))
}

/// Diagonal of the box around both [m].
fn across(one: &Cluster<'_>, other: &Cluster<'_>) -> f64 {
    let sides =
        |axis: usize| one.high[axis].max(other.high[axis]) - one.low[axis].min(other.low[axis]);
    norm([0, 1, 2].map(sides))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of points of what is detected of a wing of `width` [m] and a tip `apart` [m] from it.
    fn detected(width: f32, apart: f32) -> Vec<usize> {
        let wing = (0..11).map(|step| [5.0, 0.1 * width * step as f32, 2.0]);
        let tip = (0..3).map(|step| [5.0, width + apart + 0.05 * step as f32, 2.0]);
        let points: Vec<[f32; 3]> = wing.chain(tip).collect();
        let labels: Vec<i32> = (0..14).map(|row| i32::from(row > 10)).collect();
        let mut clusters = Clusters::default();
        clusters.fill(&points, &labels);
        let flying = Classification { class: PointClass::Flying, ..Classification::default() };
        let all = [(0, &flying), (1, &flying)];
        let united = UnitedClusters::of(&points, &clusters, all.into_iter(), Some(3.5));
        united.iter(&clusters).map(|(cluster, _)| cluster.members.len()).collect()
    }

    #[test]
    fn tips_of_wings_are_parts_and_targets_beside_each_other_are_not() {
        assert_eq!(detected(1.5, 0.45), [14]);
        assert_eq!(detected(1.5, 0.6), [11, 3]);
        assert_eq!(detected(0.7, 0.45), [11, 3], "two small targets");
        assert_eq!(detected(3.3, 0.45), [11, 3], "too long for a target");
    }
}
