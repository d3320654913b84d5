//! Search for points that are in reach of each other, octant by octant.

use super::cube_reach::{InReach, NEXT, OWN, ROWS};
use super::keys::{Key, OCTANT_BITS, OctantGrid, is_finite};
use super::{NO_GROUP, Sets};
use crate::Error;
use crate::geometry::lattice::wide;
use crate::util::cancel::{self, Watch};
use crate::util::vector_unit::dispatch;
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// Number of bits of a digit of the radix sort.
const RADIX_BITS: u32 = 11;
/// Number of cubes, or of points of a crowded octant, between two checks whether the call was asked
/// to stop.
const STEPS_PER_LOOK: usize = 64;

/// Rule that decides up to which distance two points are linked.
pub(super) trait Reach {
    /// Square of the largest distance of linked points [m^2].
    fn most(&self) -> f64;
    /// True if two points `one` and `other` [m] are linked. `square`: their squared distance [m^2].
    fn links(&self, square: f64, one: [f64; 3], other: [f64; 3]) -> bool;
}

/// One largest distance for all points. Holds its square [m^2].
pub(crate) struct Fixed(f64);

impl Fixed {
    pub(crate) const fn new(distance: f64) -> Self {
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

/// Links the points of clouds, one after another. It keeps its memory.
#[derive(Default)]
pub(super) struct Linker {
    short: Groups<u64>,
    long: Groups<u128>,
    group_of: Vec<u32>,
}

impl Linker {
    /// For every point, the index of one point of its group, the same for the whole group.
    /// [`NO_GROUP`] if the point is not finite. The distances of `reach` must be between 0.8661
    /// times `largest` [m] and `largest`.
    ///
    /// # Errors
    /// [`Error::PointOutOfRange`] if the cloud is too wide for the cells, [`Error::Interrupted`].
    pub(crate) fn linked(
        &mut self,
        points: &[[f32; 3]],
        largest: f64,
        reach: &impl Reach,
    ) -> Result<&[u32], Error> {
        let Self { short, long, group_of } = self;
        let watch = cancel::watch();
        group_of.clear();
        group_of.resize(points.len(), NO_GROUP);
        match OctantGrid::of(points, largest)? {
            None => {}
            // Half the memory to sort; only far outliers need longer keys.
            Some(grid) if grid.key_bits() + grid.index_bits <= u64::BITS => {
                short.link(points, &grid, reach, group_of, &watch)?;
            }
            Some(grid) => long.link(points, &grid, reach, group_of, &watch)?,
        }
        Ok(group_of)
    }
}

/// Check that the points have cells for this largest link distance [m].
///
/// # Errors
/// Those of [`Linker::linked`].
pub(super) fn check_extent(points: &[[f32; 3]], largest: f64) -> Result<(), Error> {
    OctantGrid::of(points, largest).map(drop)
}

/// A cube, with its octants that contain points.
struct Cube<K> {
    key: K,
    /// Octants that contain points, as bits.
    octants: u64,
    /// Index of the first of these octants, among all occupied octants.
    first: u32,
}

impl<K> Cube<K> {
    /// Index of the octant with place `octant` in the cube, among all occupied octants.
    #[inline(always)]
    fn number(&self, octant: u32) -> u32 {
        self.first + (self.octants & ((1 << octant) - 1)).count_ones()
    }
}

/// Sorted points, with the runs of each octant ("groups") and of each cube.
#[derive(Default)]
struct Groups<K> {
    /// Keys and indices of the finite points, sorted by key; `spare`: memory for sorting.
    order: Vec<K>,
    spare: Vec<K>,
    /// The finite points [m], sorted by key.
    points: Vec<[f32; 3]>,
    starts: Vec<u32>,
    cubes: Vec<Cube<K>>,
    sets: Sets,
}

impl<K: Key> Groups<K> {
    /// Link the points. Writes to `group_of`, for each point, the index of one point of its group.
    fn link(
        &mut self,
        points: &[[f32; 3]],
        grid: &OctantGrid,
        reach: &impl Reach,
        group_of: &mut [u32],
        watch: &Watch,
    ) -> Result<(), Error> {
        self.sort(points, grid, watch)?;
        watch.check()?;
        self.divide(points, grid);
        watch.check()?;
        let mut sets = std::mem::take(&mut self.sets);
        sets.restart(self.len());
        let is_done = dispatch(CubeLinker { groups: self, grid, reach, sets: &mut sets, watch });
        for (group, &root) in sets.roots().iter().enumerate() {
            let stands_for = grid.row(self.order[self.starts[root as usize] as usize]) as u32;
            for &entry in &self.order[self.range(group)] {
                group_of[grid.row(entry)] = stands_for;
            }
        }
        self.sets = sets; // its memory is used again
        is_done
    }

    /// Sort the finite points by key: radix sort, lowest digit first.
    fn sort(&mut self, points: &[[f32; 3]], grid: &OctantGrid, watch: &Watch) -> Result<(), Error> {
        let Self { order, spare, .. } = self;
        let entries = points.iter().zip(0..).filter(|(point, _)| is_finite(**point));
        order.clear();
        order.extend(
            entries.map(|(&point, index)| grid.key::<K>(point) << grid.index_bits | K::from(index)),
        );
        spare.clone_from(order);
        watch.check()?;
        let passes = grid.key_bits().div_ceil(RADIX_BITS);
        // Digits of equal width, since a shorter one saves counters and no pass.
        let digit_bits = grid.key_bits().div_ceil(passes);
        for shift in (0..passes).map(|pass| pass * digit_bits) {
            watch.check()?;
            let digit = |entry: K| {
                (entry >> (grid.index_bits + shift)).low() as usize & ((1 << digit_bits) - 1)
            };
            let mut starts = [0u32; 1 << RADIX_BITS];
            for &entry in &*order {
                starts[digit(entry)] += 1;
            }
            let mut sum = 0;
            for start in &mut starts[..1 << digit_bits] {
                sum += std::mem::replace(start, sum);
            }
            for &entry in &*order {
                let place = &mut starts[digit(entry)];
                spare[*place as usize] = entry;
                *place += 1;
            }
            std::mem::swap(order, spare);
        }
        Ok(())
    }

    /// Find the runs of octants and cubes among the sorted points.
    fn divide(&mut self, points: &[[f32; 3]], grid: &OctantGrid) {
        let Self { order, points: sorted, starts, cubes, .. } = self;
        sorted.clear();
        // Copied in the order of the keys: points of an octant lie side by side.
        sorted.extend(order.iter().map(|&entry| points[grid.row(entry)]));
        starts.clear();
        cubes.clear();
        let mut last = None;
        for (place, &entry) in order.iter().enumerate() {
            let key = entry >> grid.index_bits;
            if last == Some(key) {
                continue;
            }
            last = Some(key);
            let octant = 1 << (key.low() & ((1 << OCTANT_BITS) - 1));
            let (key, first) = (key >> OCTANT_BITS, starts.len() as u32);
            match cubes.last_mut() {
                Some(cube) if cube.key == key => cube.octants |= octant,
                _ => cubes.push(Cube { key, octants: octant, first }),
            }
            starts.push(place as u32);
        }
        starts.push(order.len() as u32);
    }

    fn len(&self) -> usize {
        self.starts.len() - 1
    }

    #[inline]
    fn range(&self, group: usize) -> Range<usize> {
        self.starts[group] as usize..self.starts[group + 1] as usize
    }
}

/// Links the groups of every cube with each other and with those of the 13 neighbouring cubes
/// behind it. It runs on the vector unit of the machine for its bit instructions.
struct CubeLinker<'a, K, R> {
    groups: &'a Groups<K>,
    grid: &'a OctantGrid,
    reach: &'a R,
    sets: &'a mut Sets,
    watch: &'a Watch,
}

impl<K: Key, R: Reach> WithSimd for CubeLinker<'_, K, R> {
    type Output = Result<(), Error>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Result<(), Error> {
        let Self { groups, grid, reach, sets, watch } = self;
        let cubes = &groups.cubes;
        let (one, row) = (K::from(1), K::from(1) << grid.bits[0]);
        let plane = row << grid.bits[1];
        // From one cube of room below every row: its first neighbour.
        let offsets = [row - one, plane - row - one, plane - one, plane + row - one];
        let mut heads = [0; 4];
        for (at, cube) in cubes.iter().enumerate() {
            if at % STEPS_PER_LOOK == 0 {
                watch.check()?;
            }
            let next = cubes.get(at + 1).filter(|next| next.key == cube.key + one);
            let mut near = [(cube, &OWN); 14];
            let mut count = 1;
            if let Some(next) = next {
                near[count] = (next, &NEXT);
                count += 1;
            }
            for ((head, &offset), row) in heads.iter_mut().zip(&offsets).zip(&ROWS) {
                let first = cube.key + offset;
                // Keys ascend, so every head only moves forward: no search for neighbours.
                while cubes.get(*head).is_some_and(|other| other.key < first) {
                    *head += 1;
                }
                let beside = cubes.iter().skip(*head);
                for other in beside.take_while(|other| other.key <= first + one + one) {
                    near[count] = (other, &row[(other.key - first).low() as usize]);
                    count += 1;
                }
            }
            for (other, in_reach) in &near[..count] {
                link(groups, cube, other, in_reach, (reach, watch), sets);
            }
        }
        watch.check()
    }
}

/// Link the octants of two cubes that have points in reach of each other.
#[inline(always)]
fn link<K: Key>(
    groups: &Groups<K>,
    ours: &Cube<K>,
    theirs: &Cube<K>,
    in_reach: &InReach,
    (reach, watch): (&impl Reach, &Watch),
    sets: &mut Sets,
) {
    let reached = theirs.octants & in_reach.theirs;
    if reached == 0 {
        return;
    }
    let mut octants = ours.octants & in_reach.ours;
    while octants != 0 {
        let octant = octants.trailing_zeros();
        octants &= octants - 1;
        let mut near = in_reach.of[octant as usize] & reached;
        if near == 0 {
            continue;
        }
        let a = ours.number(octant);
        let mut root_a = sets.root(a);
        while near != 0 {
            let b = theirs.number(near.trailing_zeros());
            near &= near - 1;
            let root_b = sets.root(b);
            // Octants that are joined already need no distances: that spares most pairs.
            if root_a != root_b && touch(groups, a as usize, b as usize, (reach, watch)) {
                sets.join(root_a, root_b);
                root_a = root_a.min(root_b);
            }
        }
    }
}

/// Number of point pairs of two groups above which the box of a group is computed before the
/// search.
const MANY_PAIRS: usize = 1024;

/// True if any two points of the two groups are in reach of each other.
#[inline(always)]
fn touch<K: Key>(
    groups: &Groups<K>,
    a: usize,
    b: usize,
    (reach, watch): (&impl Reach, &Watch),
) -> bool {
    let (ours, theirs) = (&groups.points[groups.range(a)], &groups.points[groups.range(b)]);
    let (Some(&p), Some(&q)) = (ours.first(), theirs.first()) else { return false };
    // One pair often suffices, without the bounds that the whole search needs.
    near(p, q, reach) || (ours.len() * theirs.len() > 1 && any_near(ours, theirs, reach, watch))
}

#[inline(always)]
fn near(p: [f32; 3], q: [f32; 3], reach: &impl Reach) -> bool {
    let (p, q) = (wide(p), wide(q));
    let (dx, dy, dz) = (p[0] - q[0], p[1] - q[1], p[2] - q[2]);
    reach.links(dx * dx + dy * dy + dz * dz, p, q)
}

fn any_near(ours: &[[f32; 3]], theirs: &[[f32; 3]], reach: &impl Reach, watch: &Watch) -> bool {
    let near = |p: [f32; 3]| theirs.iter().any(|&q| near(p, q, reach));
    if ours.len() * theirs.len() < MANY_PAIRS {
        return ours.iter().any(|&p| near(p));
    }
    let [low, high] = bounds(theirs);
    ours.iter().enumerate().any(|(number, &p)| {
        if number % STEPS_PER_LOOK == 0 && watch.is_asked() {
            return true; // cancelled: no label of this cloud is used, so any answer ends the search
        }
        let at = wide(p);
        let [x, y, z] =
            std::array::from_fn(|axis| (low[axis] - at[axis]).max(at[axis] - high[axis]).max(0.0));
        x * x + y * y + z * z <= reach.most() && near(p)
    })
}

/// Lowest and highest corner of the box around `points` [m].
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
