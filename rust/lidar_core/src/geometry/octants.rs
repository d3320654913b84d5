//! Points within reach of each other, joined cell by cell.

use super::cluster::{NO_GROUP, Sets};
use super::lattice::wide;
use crate::Error;
use std::ops::{Add, BitAnd, BitOr, Range, Shl, Shr, Sub};

/// Room for rounding: two points at exactly the largest reach never lie more than one cell apart.
const CELL_MARGIN: f64 = 1.0 + 1e-6;
/// Most cells along one axis.
const MAX_CELLS: f64 = (1u64 << 31) as f64;
const RADIX_BITS: u32 = 11;

/// How far apart two points may be that are linked.
pub(super) trait Reach {
    /// Square of the largest distance [m^2].
    fn most(&self) -> f64;
    /// Whether two points are linked whose distance has this square [m^2].
    fn links(&self, square: f64, one: [f64; 3], other: [f64; 3]) -> bool;
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

    #[inline]
    fn links(&self, square: f64, _: [f64; 3], _: [f64; 3]) -> bool {
        square <= self.0
    }
}

/// For every point one of its group, the same for all of them; [`NO_GROUP`] where it is not
/// finite. No reach is larger than `largest` [m], and none smaller than 0.8661 of it.
///
/// # Errors
/// [`Error::PointOutOfRange`] if the cloud is too many cells wide.
pub(super) fn linked(
    points: &[[f32; 3]],
    largest: f64,
    reach: &impl Reach,
) -> Result<Vec<u32>, Error> {
    let Some(grid) = Grid::of(points, largest)? else { return Ok(vec![NO_GROUP; points.len()]) };
    Ok(match grid.key_bits() + grid.index_bits {
        ..=64 => groups_linked::<u64>(points, &grid, reach),
        _ => groups_linked::<u128>(points, &grid, reach),
    })
}

/// # Errors
/// Those of [`linked`].
pub(super) fn check_extent(points: &[[f32; 3]], largest: f64) -> Result<(), Error> {
    Grid::of(points, largest).map(drop)
}

/// Cells as large as the reach, each split into eight octants. Two points of one octant are
/// always linked (its diagonal is 0.866 of the reach), so octants are what is joined.
struct Grid {
    low: [f64; 3],
    octant_size: f64,
    bits: [u32; 3],
    /// Bits of the number of a point.
    index_bits: u32,
}

impl Grid {
    /// None if no point is finite.
    fn of(points: &[[f32; 3]], largest: f64) -> Result<Option<Self>, Error> {
        let finite = points.iter().filter(|point| is_finite(**point));
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for point in finite {
            for axis in 0..3 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        if low[0] > high[0] {
            return Ok(None);
        }
        let (low, high) = (wide(low), wide(high));
        let octant_size = 0.5 * largest * CELL_MARGIN;
        let mut bits = [0; 3];
        for axis in 0..3 {
            let cells = (high[axis] - low[axis]) / (2.0 * octant_size);
            if cells >= MAX_CELLS {
                return Err(Error::PointOutOfRange { point: high });
            }
            bits[axis] = (cells as u64 + 3).ilog2() + 1; // one cell of room on either side
        }
        let index_bits = usize::BITS - points.len().leading_zeros();
        Ok(Some(Self { low, octant_size, bits, index_bits }))
    }

    fn key_bits(&self) -> u32 {
        self.bits.iter().sum::<u32>() + 3
    }

    /// Cell along z, y, x, then the octant in the lowest three bits.
    #[inline]
    fn key<K: Key>(&self, point: [f32; 3]) -> K {
        let point = wide(point);
        let (mut cells, mut octant) = (K::from(0), 0);
        for axis in [2, 1, 0] {
            let index = ((point[axis] - self.low[axis]) / self.octant_size) as i64 as u64;
            cells = cells << self.bits[axis] | K::from((index >> 1) + 1);
            octant = octant << 1 | (index & 1);
        }
        cells << 3 | K::from(octant)
    }
}

/// A sort key, with the number of its point below it: 64 bits where the extent of the cloud allows,
/// 128 where it does not.
trait Key:
    Copy
    + Ord
    + From<u64>
    + Shl<u32, Output = Self>
    + Shr<u32, Output = Self>
    + BitOr<Output = Self>
    + BitAnd<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
{
    /// The lowest bits.
    fn low(self) -> u64;
}

impl Key for u64 {
    fn low(self) -> u64 {
        self
    }
}

impl Key for u128 {
    fn low(self) -> u64 {
        self as u64
    }
}

fn groups_linked<K: Key>(points: &[[f32; 3]], grid: &Grid, reach: &impl Reach) -> Vec<u32> {
    let order = sorted::<K>(points, grid);
    let row = |entry: K| (entry.low() & ((1 << grid.index_bits) - 1)) as usize;
    let groups = Groups::of(points, &order, grid, row);
    let mut sets = Sets::new(groups.len());
    link_cells(&groups, grid, reach, &mut sets);
    let mut group_of = vec![NO_GROUP; points.len()];
    for group in 0..groups.len() {
        let root = sets.root(group as u32) as usize;
        let stands_for = row(order[groups.starts[root] as usize]) as u32;
        for &entry in &order[groups.range(group)] {
            group_of[row(entry)] = stands_for;
        }
    }
    group_of
}

/// Finite points by key: radix sort, lowest digit first.
fn sorted<K: Key>(points: &[[f32; 3]], grid: &Grid) -> Vec<K> {
    let entries = points.iter().zip(0..).filter(|(point, _)| is_finite(**point));
    let entry = |(&point, index)| grid.key::<K>(point) << grid.index_bits | K::from(index);
    let mut order: Vec<K> = Vec::with_capacity(points.len());
    order.extend(entries.map(entry));
    let mut sorted = order.clone();
    for shift in (0..grid.key_bits()).step_by(RADIX_BITS as usize) {
        let digit = |entry: K| {
            (entry >> (grid.index_bits + shift)).low() as usize & ((1 << RADIX_BITS) - 1)
        };
        let mut starts = [0u32; 1 << RADIX_BITS];
        for &entry in &order {
            starts[digit(entry)] += 1;
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        for &entry in &order {
            let place = &mut starts[digit(entry)];
            sorted[*place as usize] = entry;
            *place += 1;
        }
        std::mem::swap(&mut order, &mut sorted);
    }
    order
}

/// Runs of one octant ("groups") and of one cell in the sorted points.
struct Groups<K> {
    points: Vec<[f32; 3]>,
    starts: Vec<u32>,
    octants: Vec<u8>,
    cells: Vec<(K, u32)>,
}

impl<K: Key> Groups<K> {
    fn of(points: &[[f32; 3]], order: &[K], grid: &Grid, row: impl Fn(K) -> usize) -> Self {
        let mut groups = Self {
            points: order.iter().map(|&entry| points[row(entry)]).collect(),
            starts: Vec::with_capacity(order.len() + 1),
            octants: Vec::with_capacity(order.len()),
            cells: Vec::with_capacity(order.len() + 1),
        };
        let (mut last_key, mut last_cell) = (None, None);
        for (place, &entry) in order.iter().enumerate() {
            let key = entry >> grid.index_bits;
            if last_key == Some(key) {
                continue;
            }
            last_key = Some(key);
            let cell = key >> 3;
            if last_cell != Some(cell) {
                last_cell = Some(cell);
                groups.cells.push((cell, groups.starts.len() as u32));
            }
            groups.starts.push(place as u32);
            groups.octants.push((key.low() & 7) as u8);
        }
        groups.starts.push(order.len() as u32);
        groups
    }

    fn len(&self) -> usize {
        self.octants.len()
    }

    #[inline]
    fn range(&self, group: usize) -> Range<usize> {
        self.starts[group] as usize..self.starts[group + 1] as usize
    }

    #[inline]
    fn in_cell(&self, cell: usize) -> Range<usize> {
        let end = self.cells.get(cell + 1).map_or(self.len(), |&(_, start)| start as usize);
        self.cells[cell].1 as usize..end
    }
}

/// For every octant of a cell, the octants of the cell `step` away that lie no further than two
/// octants away along every axis: others are out of reach.
const fn octants_in_reach(step: [i32; 3]) -> [u8; 8] {
    let mut masks = [0; 8];
    let mut pair = 0;
    while pair < 64 {
        let (one, other) = (pair / 8, pair % 8);
        let (mut axis, mut reached) = (0, true);
        while axis < 3 {
            let away = 2 * step[axis] + (other >> axis & 1) - (one >> axis & 1);
            reached &= -2 <= away && away <= 2;
            axis += 1;
        }
        masks[one as usize] |= (reached as u8) << other;
        pair += 1;
    }
    masks
}

/// The same for steps of -1, 0 and 1 along x to the four rows of cells that follow a cell in the order
/// of the keys: the next one, then those of the next plane.
const ROWS: [[[u8; 8]; 3]; 4] = {
    let mut rows = [[[0; 8]; 3]; 4];
    let steps = [[1, 0], [-1, 1], [0, 1], [1, 1]];
    let mut at = 0;
    while at < 12 {
        let [y, z] = steps[at / 3];
        rows[at / 3][at % 3] = octants_in_reach([at as i32 % 3 - 1, y, z]);
        at += 1;
    }
    rows
};
const OWN: [u8; 8] = octants_in_reach([0; 3]);
const NEXT: [u8; 8] = octants_in_reach([1, 0, 0]);

/// Join the groups of every cell with each other and with those of the 13 neighbours behind it.
fn link_cells<K: Key>(groups: &Groups<K>, grid: &Grid, reach: &impl Reach, sets: &mut Sets) {
    let cells = &groups.cells;
    let (one, row) = (K::from(1), K::from(1) << grid.bits[0]);
    let plane = row << grid.bits[1];
    let offsets = [row, plane - row, plane, plane + row];
    let mut heads = [0; 4];
    for (cell, &(key, _)) in cells.iter().enumerate() {
        let own = groups.in_cell(cell);
        for group in own.clone() {
            link(groups, group..group + 1, group + 1..own.end, &OWN, reach, sets);
        }
        if cells.get(cell + 1).is_some_and(|&(next, _)| next == key + one) {
            link(groups, own.clone(), groups.in_cell(cell + 1), &NEXT, reach, sets);
        }
        for ((head, &offset), masks) in heads.iter_mut().zip(&offsets).zip(&ROWS) {
            let first = key + offset - one; // one cell of room: never below the row
            while cells.get(*head).is_some_and(|&(other, _)| other < first) {
                *head += 1;
            }
            let beside = cells.iter().enumerate().skip(*head);
            for (other, &(found, _)) in beside.take_while(|(_, (key, _))| *key <= first + one + one)
            {
                let masks = &masks[(found - first).low() as usize];
                link(groups, own.clone(), groups.in_cell(other), masks, reach, sets);
            }
        }
    }
}

#[inline]
fn link<K: Key>(
    groups: &Groups<K>,
    ours: Range<usize>,
    theirs: Range<usize>,
    masks: &[u8; 8],
    reach: &impl Reach,
    sets: &mut Sets,
) {
    for a in ours {
        let mask = masks[groups.octants[a] as usize & 7];
        let mut root_a = sets.root(a as u32);
        for b in theirs.clone().filter(|&b| mask >> groups.octants[b] & 1 == 1) {
            let root_b = sets.root(b as u32);
            if root_a != root_b && touch(groups, a, b, reach) {
                sets.join(root_a, root_b);
                root_a = root_a.min(root_b);
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
            reach.links(dx * dx + dy * dy + dz * dz, p, q)
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

pub(super) fn is_finite(point: [f32; 3]) -> bool {
    point.iter().all(|value| value.is_finite())
}
