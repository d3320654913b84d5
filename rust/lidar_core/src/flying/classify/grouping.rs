//! Groups of clusters: fragments of one larger object are classified together.
//!
//! Crowns of trees, rows of a distant pole, and walls seen at a grazing angle fall into clusters of
//! a target's size. Clusters close to each other count as one object. A cluster close to background
//! of the same scan is background too, before the map contains it.

use super::clusters::{Cluster, Clusters};
use crate::Error;
use crate::geometry::cluster::{Clustering, Labeller};
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};
use crate::geometry::transform::{minus, norm};

/// The group of a cluster.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Group {
    /// Diagonal of the box around all its clusters that are not background [m].
    pub(crate) extent: f64,
    /// True if the group contains background.
    pub(crate) with_background: bool,
}

/// Groups the clusters of one scan after another, and keeps its memory.
#[derive(Default)]
pub(crate) struct Grouper {
    groups: Vec<Group>,
    nearby: Nearby,
    labeller: Labeller,
    parts: Vec<Part>,
}

/// Lowest and highest corner of the box around a group [m], and whether it contains background.
type Part = ([f64; 3], [f64; 3], bool);

impl Grouper {
    /// Diagonal of the group of cluster `index` in the last call [m].
    pub(crate) fn extent(&self, index: usize) -> f64 {
        self.groups[index].extent
    }

    /// Group of every cluster. Clusters are linked by gaps of at most `distance` [m]. Without a
    /// distance, every cluster is its own group.
    pub(crate) fn groups(
        &mut self,
        points: &[[f32; 3]],
        clusters: &Clusters,
        background: &[bool],
        distance: Option<f64>,
    ) -> Result<&[Group], Error> {
        let alone =
            |cluster: Cluster<'_>| Group { extent: cluster.diagonal(), with_background: false };
        let Self { groups, nearby, labeller, parts } = self;
        groups.clear();
        groups.extend(clusters.iter().map(alone));
        let Some(max_distance) = distance else { return Ok(groups) };
        nearby.take(points, clusters, background, max_distance)?;
        let clustering = Clustering { max_distance, min_points: 1, max_points: None };
        let labels = labeller.label(&nearby.points, &clustering)?;
        let owners = nearby.owners.iter().map(|&owner| owner as usize);
        let count = labels.iter().max().map_or(0, |&last| (last + 1).max(0) as usize);
        parts.clear();
        parts.resize(count, ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3], false));
        for (&group, owner) in labels.iter().zip(owners.clone()) {
            let (low, high, with_background) = &mut parts[group as usize];
            *with_background |= background[owner];
            let cluster = clusters.get(owner);
            for axis in (0..3).filter(|_| !background[owner]) {
                low[axis] = low[axis].min(cluster.low[axis]);
                high[axis] = high[axis].max(cluster.high[axis]);
            }
        }
        for (&group, owner) in labels.iter().zip(owners).filter(|&(_, owner)| !background[owner]) {
            let (low, high, with_background) = parts[group as usize];
            groups[owner] = Group { extent: norm(minus(high, low)), with_background };
        }
        Ok(groups)
    }
}

/// Points of all clusters that are not background, and background points near them.
#[derive(Default)]
struct Nearby {
    points: Vec<[f32; 3]>,
    /// Index of the cluster of every point.
    owners: Vec<u32>,
    cells: Vec<Voxel>,
    around: Dilated,
}

impl Nearby {
    fn take(
        &mut self,
        points: &[[f32; 3]],
        clusters: &Clusters,
        background: &[bool],
        distance: f64,
    ) -> Result<(), Error> {
        let lattice = Lattice::new(distance, [0.0; 3])?;
        let Self { points: taken, owners, cells, around } = self;
        let cell = |row: u32| floor(lattice.scaled(wide(points[row as usize])));
        let owned = |wanted: bool| {
            (0..clusters.len()).filter(move |&owner| background[owner] == wanted).flat_map(
                |owner| clusters.get(owner).members.iter().map(move |&row| (owner as u32, row)),
            )
        };
        taken.clear();
        owners.clear();
        cells.clear();
        for (owner, row) in owned(false) {
            cells.extend(cell(row));
            taken.push(points[row as usize]);
            owners.push(owner);
        }
        around.restart(cells);
        let is_near = |&(_, row): &(u32, u32)| cell(row).is_some_and(|cell| around.holds(cell));
        for (owner, row) in owned(true).filter(is_near) {
            taken.push(points[row as usize]);
            owners.push(owner);
        }
        Ok(())
    }
}

/// Cells with their 26 neighbours, as a bitmap of hashes. It may contain other cells too, but none
/// of these cells is missing.
#[derive(Default)]
struct Dilated {
    bits: Vec<u64>,
}

impl Dilated {
    const SIZE_BITS: u32 = 18;

    /// Replace the content by these cells and their neighbours. Sorts `cells`.
    fn restart(&mut self, cells: &mut Vec<Voxel>) {
        cells.sort_unstable();
        cells.dedup();
        self.bits.clear();
        self.bits.resize(1 << (Self::SIZE_BITS - 6), 0);
        for &[x, y, z] in &*cells {
            for place in 0..27 {
                let beside = [x + place % 3 - 1, y + place / 3 % 3 - 1, z + place / 9 - 1];
                let bit = Self::bit(beside);
                self.bits[bit >> 6] |= 1 << (bit & 63);
            }
        }
    }

    fn holds(&self, cell: Voxel) -> bool {
        let bit = Self::bit(cell);
        self.bits[bit >> 6] >> (bit & 63) & 1 == 1
    }

    fn bit([x, y, z]: Voxel) -> usize {
        let [x, y, z] = [x, y, z].map(|index| u64::from(index.cast_unsigned()));
        let key = x ^ y.rotate_left(21) ^ z.rotate_left(42);
        (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> (64 - Self::SIZE_BITS)) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_of_fragments_reaches_the_background() -> Result<(), Error> {
        let points = [[0.0f32, 0.0, 0.0], [0.6, 0.0, 0.0], [1.2, 0.0, 0.0], [9.0, 0.0, 0.0]];
        let (mut clusters, mut grouper) = (Clusters::default(), Grouper::default());
        clusters.fill(&points, &[0, 1, 2, 3]);
        let background = [true, false, false, false];
        let groups = grouper.groups(&points, &clusters, &background, Some(0.7))?;
        assert!(
            groups[1].with_background && groups[2].with_background && !groups[3].with_background
        );
        assert!((groups[2].extent - 0.6).abs() < 1e-6 && groups[3].extent == 0.0);
        Ok(())
    }
}
