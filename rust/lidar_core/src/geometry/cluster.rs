//! Euclidean clustering: points linked by steps of at most a given distance.

use super::lattice::wide;
use crate::Error;
use crate::budget::check_points;
use crate::error::{require, require_positive};

/// Label of points that belong to no cluster.
pub const NOISE: i32 = -1;

/// Group of points that are not finite.
pub(super) const NO_GROUP: u32 = u32::MAX;

/// Room for rounding: two points at exactly `max_distance` never lie more than one cell apart.
const CELL_MARGIN: f64 = 1.0 + 1e-6;
/// Most cells along one axis.
const MAX_CELLS: f64 = (1u64 << 31) as f64;
const RADIX_BITS: u32 = 11;

/// What makes a cluster.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clustering {
    /// Largest gap inside a cluster [m], finite and > 0. Exactly this distance still links.
    pub max_distance: f64,
    /// Smaller clusters are noise, >= 1.
    pub min_points: usize,
    /// Larger clusters are noise.
    pub max_points: Option<usize>,
}

/// Group `points` [m] that are linked by steps of at most `max_distance`.
///
/// Clusters are numbered by first appearance; [`NOISE`] marks points in clusters of unwanted
/// size and points that are not finite. Distances are compared as squares in `f64`.
///
/// # Errors
/// [`Error::Parameter`], [`Error::Limit`] for too many points, [`Error::PointOutOfRange`] if the
/// cloud is more than 2^31 cells wide.
///
/// # Source
/// Vrba et al., eqs 13-15.
pub fn label(points: &[[f32; 3]], clustering: &Clustering) -> Result<Vec<i32>, Error> {
    check(clustering)?;
    check_points(points.len())?;
    let group_of = linked(points, clustering.max_distance, &Fixed::new(clustering.max_distance))?;
    Ok(numbered(&group_of, clustering))
}

/// How far apart two points may be that are linked.
pub(super) trait Reach {
    /// Square of the largest distance [m^2].
    fn most(&self) -> f64;
    /// Square of the distance for these two points [m^2].
    fn of(&self, one: [f64; 3], other: [f64; 3]) -> f64;
}

/// The same distance everywhere.
pub(super) struct Fixed(f64);

impl Fixed {
    pub(super) const fn new(distance: f64) -> Self {
        Self(distance * distance)
    }
}

impl Reach for Fixed {
    fn most(&self) -> f64 {
        self.0
    }

    fn of(&self, _: [f64; 3], _: [f64; 3]) -> f64 {
        self.0
    }
}

/// For every point the root of its group; [`NO_GROUP`] where it is not finite. No reach is larger
/// than `largest` [m], and none smaller than 0.8661 of it.
pub(super) fn linked(
    points: &[[f32; 3]],
    largest: f64,
    reach: &impl Reach,
) -> Result<Vec<u32>, Error> {
    let Some(grid) = Grid::of(points, largest)? else { return Ok(vec![NO_GROUP; points.len()]) };
    Ok(match grid.key_bits() {
        ..=64 => groups_linked::<u64>(points, &grid, reach),
        _ => groups_linked::<u128>(points, &grid, reach),
    })
}

pub(super) fn check(clustering: &Clustering) -> Result<(), Error> {
    require_positive("max_distance", clustering.max_distance)?;
    require(clustering.min_points >= 1, "min_points", ">= 1", clustering.min_points)
}

/// Cells of edge `max_distance`, each split into eight octants. Two points of one octant are
/// always linked (its diagonal is 0.866 of the distance), so octants are what is joined.
struct Grid {
    low: [f64; 3],
    octant_size: f64,
    bits: [u32; 3],
}

impl Grid {
    /// None if no point is finite.
    fn of(points: &[[f32; 3]], max_distance: f64) -> Result<Option<Self>, Error> {
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        for &point in points {
            if is_finite(point) {
                let point = wide(point);
                for axis in 0..3 {
                    low[axis] = low[axis].min(point[axis]);
                    high[axis] = high[axis].max(point[axis]);
                }
            }
        }
        if low[0] > high[0] {
            return Ok(None);
        }
        let octant_size = 0.5 * max_distance * CELL_MARGIN;
        let mut bits = [0; 3];
        for axis in 0..3 {
            let cells = (high[axis] - low[axis]) / (2.0 * octant_size);
            if cells >= MAX_CELLS {
                return Err(Error::PointOutOfRange { point: high });
            }
            bits[axis] = (cells as u64 + 3).ilog2() + 1; // one cell of room on either side
        }
        Ok(Some(Self { low, octant_size, bits }))
    }

    fn key_bits(&self) -> u32 {
        self.bits.iter().sum::<u32>() + 3
    }

    /// Cell along z, y, x, then the octant in the lowest three bits.
    fn key(&self, point: [f32; 3]) -> u128 {
        let point = wide(point);
        let (mut cells, mut octant) = (0, 0);
        for axis in [2, 1, 0] {
            let index = ((point[axis] - self.low[axis]) / self.octant_size) as u64;
            cells = cells << self.bits[axis] | u128::from((index >> 1) + 1);
            octant = octant << 1 | u128::from(index & 1);
        }
        cells << 3 | octant
    }
}

/// A sort key: 64 bits where the cloud's extent allows, 128 where it does not.
trait Key: Copy + Ord {
    fn narrow(key: u128) -> Self;
    fn digit(self, shift: u32) -> usize;
    fn cell(self) -> Self;
    fn offset(self, by: i128) -> Self;
}

macro_rules! key {
    ($type:ty) => {
        impl Key for $type {
            fn narrow(key: u128) -> Self {
                key as Self
            }
            fn digit(self, shift: u32) -> usize {
                (self >> shift) as usize & ((1 << RADIX_BITS) - 1)
            }
            fn cell(self) -> Self {
                self >> 3
            }
            fn offset(self, by: i128) -> Self {
                self.wrapping_add(by as Self)
            }
        }
    };
}
key!(u64);
key!(u128);

fn groups_linked<K: Key>(points: &[[f32; 3]], grid: &Grid, reach: &impl Reach) -> Vec<u32> {
    let mut order: Vec<(K, u32)> = Vec::with_capacity(points.len());
    for (index, &point) in points.iter().enumerate() {
        if is_finite(point) {
            order.push((K::narrow(grid.key(point)), index as u32)); // at most MAX_POINTS
        }
    }
    sort(&mut order, grid.key_bits());
    let groups = Groups::of(points, &order);
    let mut sets = Sets::new(groups.len());
    link_cells(&groups, &row_offsets(grid), reach, &mut sets);
    let mut group_of = vec![NO_GROUP; points.len()];
    for group in 0..groups.len() {
        let root = sets.root(group as u32);
        for &(_, index) in &order[groups.range(group)] {
            group_of[index as usize] = root;
        }
    }
    group_of
}

/// Stable radix sort by key, lowest digit first.
fn sort<K: Key>(order: &mut Vec<(K, u32)>, bits: u32) {
    let mut sorted = order.clone();
    for shift in (0..bits).step_by(RADIX_BITS as usize) {
        let mut starts = vec![0u32; 1 << RADIX_BITS];
        for (key, _) in order.iter() {
            starts[key.digit(shift)] += 1;
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        for &entry in order.iter() {
            let place = &mut starts[entry.0.digit(shift)];
            sorted[*place as usize] = entry;
            *place += 1;
        }
        std::mem::swap(order, &mut sorted);
    }
}

/// Runs of one octant ("groups") and of one cell in the sorted points.
struct Groups<K> {
    points: Vec<[f32; 3]>,
    starts: Vec<u32>,
    cells: Vec<(K, u32)>,
}

impl<K: Key> Groups<K> {
    fn of(points: &[[f32; 3]], order: &[(K, u32)]) -> Self {
        let sorted = order.iter().map(|&(_, index)| points[index as usize]).collect();
        let mut starts = Vec::new();
        let mut cells: Vec<(K, u32)> = Vec::new();
        let mut previous = None;
        for (place, &(key, _)) in order.iter().enumerate() {
            if previous != Some(key) {
                if cells.last().is_none_or(|&(cell, _)| cell != key.cell()) {
                    cells.push((key.cell(), starts.len() as u32));
                }
                starts.push(place as u32);
                previous = Some(key);
            }
        }
        starts.push(order.len() as u32);
        Self { points: sorted, starts, cells }
    }

    fn len(&self) -> usize {
        self.starts.len() - 1
    }

    fn range(&self, group: usize) -> std::ops::Range<usize> {
        self.starts[group] as usize..self.starts[group + 1] as usize
    }

    fn in_cell(&self, cell: usize) -> std::ops::Range<u32> {
        let end = self.cells.get(cell + 1).map_or(self.len() as u32, |&(_, start)| start);
        self.cells[cell].1..end
    }
}

/// Keys from a cell to the four rows of neighbours that follow it in the order of the keys.
fn row_offsets(grid: &Grid) -> [i128; 4] {
    let (row, plane) = (1i128 << grid.bits[0], 1i128 << (grid.bits[0] + grid.bits[1]));
    [row, plane - row, plane, plane + row]
}

/// Join the groups of every cell with each other and with those of the 13 neighbours behind it.
fn link_cells<K: Key>(groups: &Groups<K>, rows: &[i128; 4], reach: &impl Reach, sets: &mut Sets) {
    let cells = &groups.cells;
    let mut heads = [0; 4];
    for (cell, &(key, _)) in cells.iter().enumerate() {
        let own = groups.in_cell(cell);
        for group in own.clone() {
            link_groups(groups, group..group + 1, group + 1..own.end, reach, sets);
        }
        if cells.get(cell + 1).is_some_and(|&(next, _)| next == key.offset(1)) {
            link_groups(groups, own.clone(), groups.in_cell(cell + 1), reach, sets);
        }
        for (head, row) in heads.iter_mut().zip(rows) {
            let (first, last) = (key.offset(row - 1), key.offset(row + 1));
            while cells.get(*head).is_some_and(|&(other, _)| other < first) {
                *head += 1;
            }
            let mut other = *head;
            while cells.get(other).is_some_and(|&(key, _)| key <= last) {
                link_groups(groups, own.clone(), groups.in_cell(other), reach, sets);
                other += 1;
            }
        }
    }
}

fn link_groups<K: Key>(
    groups: &Groups<K>,
    ours: std::ops::Range<u32>,
    theirs: std::ops::Range<u32>,
    reach: &impl Reach,
    sets: &mut Sets,
) {
    for a in ours {
        for b in theirs.clone() {
            let (root_a, root_b) = (sets.root(a), sets.root(b));
            if root_a != root_b && touch(groups, a as usize, b as usize, reach) {
                sets.join(root_a, root_b);
            }
        }
    }
}

/// Pairs above which the box of a group is worth its making.
const MANY_PAIRS: usize = 1024;

/// Whether two groups hold a pair of points within reach.
fn touch<K: Key>(groups: &Groups<K>, a: usize, b: usize, reach: &impl Reach) -> bool {
    let (ours, theirs) = (&groups.points[groups.range(a)], &groups.points[groups.range(b)]);
    let near = |p: [f64; 3]| {
        theirs.iter().any(|&q| {
            let q = wide(q);
            let (dx, dy, dz) = (p[0] - q[0], p[1] - q[1], p[2] - q[2]);
            dx * dx + dy * dy + dz * dz <= reach.of(p, q)
        })
    };
    if ours.len() * theirs.len() < MANY_PAIRS {
        return ours.iter().any(|&p| near(wide(p)));
    }
    let [low, high] = bounds(theirs);
    ours.iter().map(|&p| wide(p)).any(|p| {
        let [x, y, z] =
            std::array::from_fn(|axis| (low[axis] - p[axis]).max(p[axis] - high[axis]).max(0.0));
        x * x + y * y + z * z <= reach.most() && near(p)
    })
}

/// Lower and upper corner of the box around `points`.
fn bounds(points: &[[f32; 3]]) -> [[f64; 3]; 2] {
    let mut corners = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for &point in points {
        let point = wide(point);
        for axis in 0..3 {
            corners[0][axis] = corners[0][axis].min(point[axis]);
            corners[1][axis] = corners[1][axis].max(point[axis]);
        }
    }
    corners
}

/// Union-find whose root is the smallest member.
pub(super) struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    pub(super) fn new(len: usize) -> Self {
        Self { parent: (0..len as u32).collect() }
    }

    pub(super) fn root(&mut self, mut member: u32) -> u32 {
        while self.parent[member as usize] != member {
            let up = self.parent[self.parent[member as usize] as usize];
            self.parent[member as usize] = up; // path halving
            member = up;
        }
        member
    }

    pub(super) fn join(&mut self, a: u32, b: u32) {
        self.parent[a.max(b) as usize] = a.min(b);
    }
}

/// Labels by first appearance; groups of unwanted size are noise.
pub(super) fn numbered(group_of: &[u32], clustering: &Clustering) -> Vec<i32> {
    let mut labels = vec![NOISE; group_of.len()];
    let groups =
        group_of.iter().filter(|&&group| group != NO_GROUP).max().map_or(0, |&g| g as usize + 1);
    let mut sizes = vec![0usize; groups];
    for &group in group_of.iter().filter(|&&group| group != NO_GROUP) {
        sizes[group as usize] += 1;
    }
    let largest = clustering.max_points.unwrap_or(usize::MAX);
    let mut numbers = vec![NOISE; groups];
    let mut next = 0;
    for (label, &group) in labels.iter_mut().zip(group_of) {
        if group == NO_GROUP || !(clustering.min_points..=largest).contains(&sizes[group as usize])
        {
            continue;
        }
        let number = &mut numbers[group as usize];
        if *number == NOISE {
            *number = next;
            next += 1;
        }
        *label = *number;
    }
    labels
}

fn is_finite(point: [f32; 3]) -> bool {
    point.iter().all(|value| value.is_finite())
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
