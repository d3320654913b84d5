//! Groups of clusters: fragments of one larger thing are judged together.
//!
//! Crowns of trees, rows of a distant pole and walls seen at a grazing angle fall apart into
//! clusters of a target's size. What lies close together is taken as one thing, and what lies
//! close to background of the same scan is background too, before the map knows it.

use super::clusters::Cluster;
use crate::Error;
use crate::geometry::cluster::{Clustering, label};
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};
use crate::geometry::transform::{minus, norm};

/// What a cluster belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Group {
    /// Diagonal of the box around all its clusters that are not background [m].
    pub(crate) extent: f64,
    /// Whether background is part of it.
    pub(crate) with_background: bool,
}

/// Group of every cluster: clusters linked by gaps of at most `distance` [m]; without a distance
/// every cluster is its own group.
pub(crate) fn groups(
    points: &[[f32; 3]],
    clusters: &[Cluster<'_>],
    background: &[bool],
    distance: Option<f64>,
) -> Result<Vec<Group>, Error> {
    let alone =
        |cluster: &Cluster<'_>| Group { extent: cluster.diagonal(), with_background: false };
    let mut groups: Vec<Group> = clusters.iter().map(alone).collect();
    let Some(max_distance) = distance else { return Ok(groups) };
    let (cloud, owners) = neighbourhood(points, clusters, background, max_distance)?;
    let clustering = Clustering { max_distance, min_points: 1, max_points: None };
    let labels = label(&cloud, &clustering)?;
    let count = labels.iter().max().map_or(0, |&last| (last + 1).max(0) as usize);
    let mut boxes = vec![([f64::INFINITY; 3], [f64::NEG_INFINITY; 3], false); count];
    for (&group, &owner) in labels.iter().zip(&owners) {
        let (low, high, with_background) = &mut boxes[group as usize];
        *with_background |= background[owner];
        for axis in (0..3).filter(|_| !background[owner]) {
            low[axis] = low[axis].min(clusters[owner].low[axis]);
            high[axis] = high[axis].max(clusters[owner].high[axis]);
        }
    }
    for (&group, &owner) in labels.iter().zip(&owners).filter(|&(_, &owner)| !background[owner]) {
        let (low, high, with_background) = boxes[group as usize];
        groups[owner] = Group { extent: norm(minus(high, low)), with_background };
    }
    Ok(groups)
}

/// All points that are not background, and the background points near them, with the clusters
/// that own them.
fn neighbourhood(
    points: &[[f32; 3]],
    clusters: &[Cluster<'_>],
    background: &[bool],
    distance: f64,
) -> Result<(Vec<[f32; 3]>, Vec<usize>), Error> {
    let lattice = Lattice::new(distance, [0.0; 3])?;
    let cell = |row: u32| floor(lattice.scaled(wide(points[row as usize])));
    let (mut cloud, mut owners, mut cells) = (Vec::new(), Vec::new(), Vec::new());
    let owned = |wanted: bool| {
        clusters
            .iter()
            .enumerate()
            .filter(move |&(owner, _)| background[owner] == wanted)
            .flat_map(|(owner, cluster)| cluster.members.iter().map(move |&row| (owner, row)))
    };
    for (owner, row) in owned(false) {
        cells.extend(cell(row));
        cloud.push(points[row as usize]);
        owners.push(owner);
    }
    let near = Dilated::of(cells);
    for (owner, row) in
        owned(true).filter(|&(_, row)| cell(row).is_some_and(|cell| near.holds(cell)))
    {
        cloud.push(points[row as usize]);
        owners.push(owner);
    }
    Ok((cloud, owners))
}

/// Cells and their 26 neighbours, as a bitmap that may answer yes wrongly, never no.
struct Dilated {
    bits: Vec<u64>,
}

impl Dilated {
    const SIZE_BITS: u32 = 18;

    fn of(mut cells: Vec<Voxel>) -> Self {
        cells.sort_unstable();
        cells.dedup();
        let mut dilated = Self { bits: vec![0; 1 << (Self::SIZE_BITS - 6)] };
        for [x, y, z] in cells {
            for place in 0..27 {
                let beside = [x + place % 3 - 1, y + place / 3 % 3 - 1, z + place / 9 - 1];
                let bit = Self::bit(beside);
                dilated.bits[bit >> 6] |= 1 << (bit & 63);
            }
        }
        dilated
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
        let mut rows = Vec::new();
        let clusters = Cluster::all(&points, &[0, 1, 2, 3], &mut rows);
        let groups = groups(&points, &clusters, &[true, false, false, false], Some(0.7))?;
        assert!(
            groups[1].with_background && groups[2].with_background && !groups[3].with_background
        );
        assert!((groups[2].extent - 0.6).abs() < 1e-6 && groups[3].extent == 0.0);
        Ok(())
    }
}
