//! Rays of one scan -> summed length per voxel. Source: Vrba et al., eqs 21-22.
//!
//! Lengths are summed as integers in a sparse window of blocks around the rays, so the result
//! depends neither on the order of the rays nor on the number of threads.

use super::blocks::{EDGE, EDGE_BITS, Place, VOLUME, offset_of};
use super::lanes::cast;
use crate::Error;
use crate::geometry::lattice::Voxel;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A segment in units of voxels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub(crate) start: [f64; 3],
    pub(crate) end: [f64; 3],
}

/// What one scan did to one voxel, in 32 bits: the class of the points inside in the highest
/// two, below them their number, or without points the length of rays in 1/16384 edges.
pub(crate) type Mark = u32;
/// Of points, their number, or in a weighted scan their weight in units of 1 / `POINT_UNITS`.
const COUNT_BITS: u32 = 30;
pub(crate) const MAX_COUNT: u32 = (1 << COUNT_BITS) - 1;
/// Weight units per point, in scans whose points have weights.
pub(crate) const POINT_UNITS: u32 = 1024;
/// Length units per voxel edge.
pub(crate) const UNITS_PER_EDGE: f64 = 16_384.0;

/// Classes that a voxel's points can have, weakest first: of several the strongest counts
/// (first matching case of eq. 9: background, then flying or unknown, then rays).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    Rays,
    Unknown,
    Flying,
    Background,
}

/// Content and number (points, or length units) of a mark.
pub(crate) fn content(mark: Mark) -> (Content, u32) {
    let content = match mark >> COUNT_BITS {
        0 => Content::Rays,
        1 => Content::Unknown,
        2 => Content::Flying,
        _ => Content::Background,
    };
    (content, mark & MAX_COUNT)
}

/// Rays handed to a thread at a time.
const RAYS_PER_CHUNK: usize = 1024;
/// So many rays cannot make a full mark overflow, with a diagonal each.
const RAYS_UNTIL_FULL: usize = ((u32::MAX - MAX_COUNT) / (1.75 * UNITS_PER_EDGE) as u32) as usize;
/// Most blocks in the window of one scan.
const MAX_WINDOW: u64 = 1 << 24;
const EMPTY: u32 = u32::MAX;

/// Blocks that bound the rays of one scan.
///
/// A voxel's place in the window is a row of bits: its place in the block, then that of the block,
/// each along x, y and z, so that a step along an axis is one addition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Window {
    low: [i32; 3],
    size: [usize; 3],
    /// Bits that the index of a block takes along x, y, z.
    bits: [u32; 3],
}

impl Window {
    /// The window that spans both voxels.
    ///
    /// # Errors
    /// [`Error::Limit`] if it holds too many blocks.
    pub(crate) fn spanning(low: Voxel, high: Voxel) -> Result<Self, Error> {
        let (low, high) = (Place::of(low).0, Place::of(high).0);
        let size: [u64; 3] =
            std::array::from_fn(|axis| u64::from(high[axis].abs_diff(low[axis])) + 1);
        let blocks = size.iter().try_fold(1u64, |product, &edge| product.checked_mul(edge));
        match blocks {
            Some(blocks) if blocks <= MAX_WINDOW => {
                let bits = size.map(|edge| edge.next_power_of_two().trailing_zeros());
                Ok(Self { low, size: size.map(|edge| edge as usize), bits })
            }
            _ => Err(Error::Limit {
                what: format!("a scan that spans {size:?} blocks of 8 voxels"),
                limit: MAX_WINDOW,
                key: "raise `voxel_size` or lower `max_range`",
            }),
        }
    }

    /// Entries of a table of the window.
    fn len(&self) -> usize {
        self.size[2] << (self.bits[0] + self.bits[1])
    }

    fn index(&self, place: Place) -> usize {
        let [x, y, z]: [usize; 3] =
            std::array::from_fn(|axis| place.0[axis].wrapping_sub(self.low[axis]) as usize);
        (z << self.bits[1] | y) << self.bits[0] | x
    }

    /// Bits of a voxel.
    #[inline(always)]
    pub(super) fn bits_of(&self, voxel: Voxel) -> u64 {
        (self.index(Place::of(voxel)) * VOLUME + offset_of(voxel)) as u64
    }

    /// Those of them that belong to an axis.
    #[inline(always)]
    pub(super) fn bits_along(&self, axis: usize) -> u64 {
        let below: u32 = self.bits[..axis].iter().sum();
        let (inside, block) = ((EDGE as u64) - 1, (1 << self.bits[axis]) - 1);
        inside << (EDGE_BITS as usize * axis) | (block * VOLUME as u64) << below
    }

    fn holds(&self, place: Place) -> bool {
        (0..3).all(|axis| (place.0[axis].wrapping_sub(self.low[axis]) as usize) < self.size[axis])
    }

    fn place(&self, index: usize) -> Place {
        let [x, y, _] = self.bits;
        let inside = [index & ((1 << x) - 1), index >> x & ((1 << y) - 1), index >> (x + y)];
        Place(std::array::from_fn(|axis| self.low[axis] + inside[axis] as i32))
    }
}

/// Marks of one scan, block by block. Reused from scan to scan.
#[derive(Default)]
pub(crate) struct Accumulator {
    window: Option<Window>,
    table: Vec<u32>,
    touched: Vec<u32>,
    blocks: Vec<[Mark; VOLUME]>,
    /// Blocks with points beyond the window: a stray return must not widen it.
    far: BTreeMap<Place, Box<[Mark; VOLUME]>>,
    visits: u64,
    /// Most blocks that one scan may touch.
    most: usize,
}

impl Accumulator {
    /// Empty the accumulator and aim it at `window`; it will touch at most `most` blocks.
    fn aim(&mut self, window: Window, most: usize) {
        for &index in &self.touched {
            self.table[index as usize] = EMPTY;
        }
        self.touched.clear();
        self.far.clear();
        self.visits = 0;
        self.most = most;
        self.table.resize(window.len(), EMPTY);
        self.window = Some(window);
    }

    /// Slot of a block, made when first met.
    #[inline]
    fn slot(&mut self, window: &Window, place: Place) -> usize {
        let index = window.index(place);
        let slot = self.table[index];
        if slot == EMPTY { self.open(index) } else { slot as usize }
    }

    #[cold]
    fn open(&mut self, index: usize) -> usize {
        let slot = self.touched.len();
        if slot > self.most {
            return slot - 1; // too many: `check` will say so, and nothing of this scan is used
        }
        self.table[index] = slot as u32;
        self.touched.push(index as u32);
        if slot == self.blocks.len() {
            self.blocks.push([0; VOLUME]);
        } else {
            self.blocks[slot] = [0; VOLUME];
        }
        slot
    }

    /// Add a length to the voxel whose bits in the window are `place`. Sums may pass the largest
    /// mark until `settle`.
    #[inline(always)]
    pub(super) fn add(&mut self, place: u64, units: u32) {
        let index = (place / VOLUME as u64) as usize;
        let Some(&known) = self.table.get(index) else { return };
        let mut slot = known as usize;
        if known == EMPTY {
            if units == 0 {
                return; // of a ray that has arrived
            }
            slot = self.open(index);
        }
        let mark = &mut self.blocks[slot][place as usize % VOLUME];
        *mark = mark.wrapping_add(units);
    }

    /// Note that rays were cast which visit so many voxels.
    pub(super) fn count(&mut self, visits: u64) {
        self.visits += visits;
    }

    /// Full marks stay full.
    fn settle(&mut self) {
        for block in &mut self.blocks[..self.touched.len()] {
            block.iter_mut().for_each(|mark| *mark = (*mark).min(MAX_COUNT));
        }
    }

    /// Note a point, or as many units, of class `content` in `voxel`.
    pub(crate) fn mark_points(&mut self, voxel: Voxel, content: Content, units: u32) {
        let tag = content as u32;
        let Some(mark) = self.mark(voxel) else { return };
        if *mark >> COUNT_BITS < tag {
            *mark = tag << COUNT_BITS | units.min(MAX_COUNT);
        } else if *mark >> COUNT_BITS == tag {
            *mark = tag << COUNT_BITS | (*mark & MAX_COUNT).saturating_add(units).min(MAX_COUNT);
        }
    }

    /// Note that points of the background may lie in `voxel`, unless it holds others.
    pub(crate) fn mark_beside(&mut self, voxel: Voxel, units: u32) {
        let others = [Content::Unknown, Content::Flying];
        if self.mark(voxel).is_some_and(|mark| !others.contains(&content(*mark).0)) {
            self.mark_points(voxel, Content::Background, units);
        }
    }

    /// Mark of a voxel.
    fn mark(&mut self, voxel: Voxel) -> Option<&mut Mark> {
        let window = self.window?;
        let place = Place::of(voxel);
        let block = if window.holds(place) {
            let slot = self.slot(&window, place);
            &mut self.blocks[slot]
        } else if self.far.len() > self.most {
            return None; // as in `open`
        } else {
            self.far.entry(place).or_insert_with(|| Box::new([0; VOLUME])).as_mut()
        };
        Some(&mut block[offset_of(voxel)])
    }

    /// Add the lengths that `other` summed up in the same window.
    fn absorb(&mut self, other: &Self, window: &Window) {
        self.visits += other.visits;
        for &index in &other.touched {
            self.slot(window, window.place(index as usize));
        }
        let mut sources = vec![None; self.touched.len()];
        for (&index, marks) in other.touched.iter().zip(&other.blocks) {
            if let Some(source) = sources.get_mut(self.table[index as usize] as usize) {
                *source = Some(marks);
            }
        }
        let add = |(marks, source): (&mut [Mark; VOLUME], &Option<&[Mark; VOLUME]>)| {
            let Some(source) = source else { return };
            for (mark, more) in marks.iter_mut().zip(source.iter()) {
                *mark = (*mark + more).min(MAX_COUNT); // both are settled
            }
        };
        self.blocks.par_iter_mut().zip(&sources).for_each(add);
    }

    /// # Errors
    /// [`Error::Limit`] if the scan touches too many blocks; its marks are of no use then.
    pub(crate) fn check(&self) -> Result<(), Error> {
        if self.touched.len() > self.most || self.far.len() > self.most {
            return Err(Error::Limit {
                what: format!("a scan that touches more than {} voxels", self.most * VOLUME),
                limit: (self.most * VOLUME) as u64,
                key: "voxel_map.max_voxels",
            });
        }
        Ok(())
    }

    /// Voxels visited by rays, each visit counted.
    pub(crate) fn visits(&self) -> u64 {
        self.visits
    }

    /// Marked blocks in ascending order of place.
    pub(crate) fn marked(&self) -> Vec<(Place, &[Mark; VOLUME])> {
        let Some(window) = self.window else { return Vec::new() };
        let mut marked: Vec<_> = self
            .touched
            .iter()
            .zip(&self.blocks)
            .map(|(&index, marks)| (window.place(index as usize), marks))
            .chain(self.far.iter().map(|(&place, marks)| (place, &**marks)))
            .collect();
        marked.sort_unstable_by_key(|&(place, _)| place);
        marked
    }
}

/// Sum the lengths of `rays` into the first accumulator; one accumulator per thread. Its `check`
/// says whether they fit into `most` blocks.
pub(crate) fn cast_all(
    pool: Option<&ThreadPool>,
    accumulators: &mut [Accumulator],
    window: Window,
    rays: &[Ray],
    most: usize,
) {
    for accumulator in accumulators.iter_mut() {
        accumulator.aim(window, most);
    }
    let next = AtomicUsize::new(0);
    let work = |accumulator: &mut Accumulator| {
        let chunk = || next.fetch_add(RAYS_PER_CHUNK, Ordering::Relaxed);
        let mut unsettled = 0;
        for start in std::iter::repeat_with(chunk).take_while(|&start| start < rays.len()) {
            if unsettled + RAYS_PER_CHUNK > RAYS_UNTIL_FULL {
                accumulator.settle();
                unsettled = 0;
            }
            unsettled += RAYS_PER_CHUNK;
            cast(accumulator, &window, &rays[start..rays.len().min(start + RAYS_PER_CHUNK)]);
            if accumulator.check().is_err() {
                break;
            }
        }
        accumulator.settle();
    };
    match pool {
        Some(pool) => pool.install(|| {
            accumulators.par_iter_mut().for_each(work);
            if let Some((sum, others)) = accumulators.split_first_mut() {
                // Integer sums: their order cannot matter.
                others.iter().for_each(|other| sum.absorb(other, &window));
            }
        }),
        None => accumulators.iter_mut().take(1).for_each(work),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sum(rays: &[Ray], threads: usize) -> Result<Vec<(Place, Vec<Mark>)>, Error> {
        let pool = crate::threads::pool(threads)?;
        let mut accumulators: Vec<_> = (0..threads).map(|_| Accumulator::default()).collect();
        let window = Window::spanning([-40; 3], [40; 3])?;
        cast_all(Some(&pool), &mut accumulators, window, rays, 1 << 20);
        Ok(accumulators[0]
            .marked()
            .into_iter()
            .map(|(place, marks)| (place, marks.to_vec()))
            .collect())
    }

    #[test]
    fn any_number_of_threads_and_any_order_give_the_same_bits() -> Result<(), Error> {
        let mut rays: Vec<Ray> = (0..5000)
            .map(|index| {
                let angle = f64::from(index) * 0.37;
                let end = [
                    30.0 * libm::cos(angle),
                    30.0 * libm::sin(angle),
                    f64::from(index % 60) - 30.0,
                ];
                Ray { start: [0.3, -0.2, 0.1], end }
            })
            .collect();
        let one = sum(&rays, 1)?;
        assert!(one.len() > 100);
        for threads in [2, 4, 7] {
            assert_eq!(sum(&rays, threads)?, one);
        }
        rays.reverse();
        assert_eq!(sum(&rays, 2)?, one);
        Ok(())
    }

    #[test]
    fn points_beat_rays_and_background_beats_all() -> Result<(), Error> {
        let mut accumulators = [Accumulator::default()];
        let window = Window::spanning([0; 3], [15; 3])?;
        let ray = Ray { start: [0.5; 3], end: [3.5, 0.5, 0.5] };
        cast_all(None, &mut accumulators, window, &[ray], 1 << 20);
        let sum = &mut accumulators[0];
        for (x, class) in [
            (1, Content::Unknown),
            (1, Content::Background),
            (1, Content::Unknown),
            (2, Content::Flying),
        ] {
            sum.mark_points([x, 0, 0], class, 1);
        }
        let marks = sum.marked()[0].1;
        assert_eq!(content(marks[0]), (Content::Rays, 8192));
        assert_eq!(content(marks[1]), (Content::Background, 1));
        assert_eq!(content(marks[2]), (Content::Flying, 1));
        assert_eq!(content(marks[3]), (Content::Rays, 8192));
        assert_eq!(sum.visits(), 4);
        Ok(())
    }
}
