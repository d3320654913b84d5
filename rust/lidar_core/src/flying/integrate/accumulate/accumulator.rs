//! Marks of one scan: points or ray length per voxel.

use super::dense_blocks::DenseBlocks;
use super::mark::{Content, Mark, tag_and_count, with_points};
use super::sparse_blocks::SparseBlocks;
use super::window::Window;
use crate::Error;
use crate::flying::map::block_shape::VOLUME;
use crate::flying::map::blocks::{Place, offset_of};
use crate::geometry::lattice::Voxel;
use rayon::ThreadPool;
use std::hint::black_box;

const EMPTY: u32 = u32::MAX;
/// Points that are marked together.
const POINTS_AT_A_TIME: usize = 64;

/// Steps of a ray that are added in one go.
pub(in crate::flying::integrate) const STEPS: usize = 8;
/// Steps of `N` rays side by side.
pub(crate) type Steps<const N: usize> = [[u32; N]; STEPS];

/// Marks of one scan, block by block: empty between scans, its memory is used again.
///
/// If the whole window lies in memory, the slot of a block is its index.
#[derive(Default)]
pub(crate) struct Accumulator {
    window: Option<Window>,
    /// Marks in the window.
    dense: DenseBlocks,
    /// Slots of the blocks of a window that does not lie in memory as a whole, by their index.
    table: Vec<u32>,
    /// Indices of the blocks that have a slot there, with it.
    opened: Vec<(u32, u32)>,
    /// Marks of points beyond the window.
    sparse: SparseBlocks,
    /// Slots of the blocks that are added to those of this one.
    sources: Vec<u32>,
    visits: u64,
    /// Touched voxels in which a ray left its length.
    walked: u64,
    /// Largest number of blocks that one scan may touch.
    most: usize,
    /// True once a block found no memory.
    is_starved: bool,
}

/// Position of a block or a mark: in the window, or among the blocks beyond it.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Slot {
    Within(usize),
    Beyond(usize),
}

impl Accumulator {
    /// Memory that `aim` would take [bytes].
    pub(in crate::flying::integrate) fn room(&self, window: &Window) -> usize {
        if window.is_whole() {
            let of_block = size_of::<[Mark; VOLUME]>() + size_of::<u64>();
            window.len().saturating_sub(self.dense.len()) * of_block
        } else {
            window.len().saturating_sub(self.table.len()) * size_of::<u32>()
        }
    }

    /// Aim the empty accumulator at `window`; it will touch at most `most` blocks.
    pub(crate) fn aim(&mut self, window: Window, most: usize) {
        self.most = most;
        if window.is_whole() {
            self.dense.reserve(window.len());
        } else {
            self.table.resize(window.len(), EMPTY);
            self.is_starved |= !self.dense.grow(1); // the slot of marks that have no other
        }
        self.window = Some(window);
    }

    /// Empty it for the next scan.
    pub(crate) fn clear(&mut self, pool: Option<&ThreadPool>) {
        (self.visits, self.walked, self.is_starved) = (0, 0, false);
        self.dense.clear(pool);
        for (index, _) in self.opened.drain(..) {
            self.table[index as usize] = EMPTY;
        }
        self.sparse.clear();
    }

    /// Slot of the block at `index` of the window, made when first met.
    #[inline(always)]
    fn slot(&mut self, window: &Window, index: usize) -> usize {
        if window.is_whole() {
            return index;
        }
        match self.table.get(index) {
            Some(&slot) if slot != EMPTY => slot as usize,
            _ => self.open(index),
        }
    }

    #[cold]
    fn open(&mut self, index: usize) -> usize {
        let slot = self.opened.len();
        let is_too_many = slot > self.most;
        self.is_starved |= !is_too_many && !self.dense.grow(slot + 1);
        if is_too_many || self.is_starved {
            return slot.saturating_sub(1); // `check` says so, and no mark is used
        }
        self.table[index] = slot as u32;
        self.opened.push((index as u32, slot as u32));
        slot
    }

    /// Add the lengths of steps of `N` rays side by side to the voxels whose bits in the window are in
    /// `places`. Sums may pass the largest mark until `settle`.
    #[inline(never)] // it would have too few registers
    pub(crate) fn add<const N: usize>(
        &mut self,
        window: &Window,
        places: &[Steps<N>],
        lengths: &[Steps<N>],
    ) {
        if window.is_whole() {
            let marks = self.dense.marks_mut();
            each(places, lengths, |place, length| {
                // Cannot overflow: `cast_all` settles before so many rays are cast.
                marks[place] = marks[place].wrapping_add(length);
            });
        } else {
            each(places, lengths, |place, length| {
                // Rays that have arrived add 0 at places that mean nothing: these must open no block.
                if length != 0 {
                    let mark = self.slot(window, place / VOLUME) * VOLUME + place % VOLUME;
                    let mark = &mut self.dense.marks_mut()[mark];
                    *mark = mark.wrapping_add(length);
                }
            });
        }
    }

    /// Note that rays were cast which cross so many voxels.
    pub(in crate::flying::integrate) fn count(&mut self, visits: u64) {
        self.visits += visits;
    }

    /// Note that rays left their lengths in so many of the voxels.
    pub(in crate::flying::integrate) fn count_walked(&mut self, visits: u64) {
        self.walked += visits;
    }

    /// Full marks stay full; the rows that rays met are noted. `meets` knows the blocks that they met.
    pub(in crate::flying::integrate) fn settle(&mut self, meets: impl Fn(usize) -> bool) {
        match self.window {
            Some(window) if window.is_whole() => {
                self.dense.settle(window.indices().filter(|index| meets(*index)));
            }
            _ => self.dense.settle(0..self.opened.len()),
        }
    }

    /// Note points, each with its class.
    pub(in crate::flying::integrate) fn mark_all(
        &mut self,
        mut points: impl Iterator<Item = (Voxel, Content)>,
    ) {
        let Some(window) = self.window else { return };
        let mut spots = [(0, Content::Rays); POINTS_AT_A_TIME];
        loop {
            let (mut taken, mut within) = (0, 0);
            for (voxel, content) in points.by_ref().take(POINTS_AT_A_TIME) {
                taken += 1;
                if let Some(place) = window.place_of(voxel) {
                    spots[within] = (self.spot_within(&window, place), content);
                    within += 1;
                } else {
                    self.mark_points(voxel, content, 1);
                }
            }
            if taken == 0 {
                return;
            }
            let (marks, spots) = (self.dense.marks_mut(), &spots[..within]);
            // All are read before any is changed: their cache misses overlap instead of following one another.
            black_box(spots.iter().fold(0, |seen, &(spot, _)| seen | marks[spot]));
            for &(spot, content) in spots {
                marks[spot] = with_points(marks[spot], content, 1);
            }
        }
    }

    /// Note a point, or as many units, of class `content` in `voxel`.
    pub(crate) fn mark_points(&mut self, voxel: Voxel, content: Content, units: u32) {
        if let Some(mark) = self.mark(voxel) {
            *mark = with_points(*mark, content, units);
        }
    }

    /// Note that points of the background may lie in `voxel`, unless it holds others.
    pub(crate) fn mark_beside(&mut self, voxel: Voxel, units: u32) {
        let others = [Content::Unknown as u32, Content::Flying as u32];
        if self.mark(voxel).is_some_and(|mark| !others.contains(&tag_and_count(*mark).0)) {
            self.mark_points(voxel, Content::Background, units);
        }
    }

    /// Mark of a voxel that is about to be set.
    #[inline]
    pub(crate) fn mark(&mut self, voxel: Voxel) -> Option<&mut Mark> {
        self.spot(voxel).map(|spot| self.at(spot))
    }

    /// Mark at a place of the window that is about to be set.
    #[inline(always)]
    pub(in crate::flying::integrate) fn mark_within(
        &mut self,
        window: &Window,
        place: usize,
    ) -> &mut Mark {
        let spot = self.spot_within(window, place);
        &mut self.dense.marks_mut()[spot]
    }

    /// Position of the mark of a voxel that is about to be set.
    #[inline(always)]
    fn spot(&mut self, voxel: Voxel) -> Option<Slot> {
        let window = self.window?;
        if let Some(place) = window.place_of(voxel) {
            return Some(Slot::Within(self.spot_within(&window, place)));
        }
        let slot = self.sparse.slot(Place::of(voxel), self.most)?;
        Some(Slot::Beyond(self.sparse.spot(slot, offset_of(voxel))))
    }

    /// Position of the mark at a place of the window that is about to be set.
    #[inline(always)]
    fn spot_within(&mut self, window: &Window, place: usize) -> usize {
        let slot = self.slot(window, place / VOLUME);
        self.dense.spot(slot, place % VOLUME)
    }

    #[inline(always)]
    fn at(&mut self, spot: Slot) -> &mut Mark {
        match spot {
            Slot::Within(at) => &mut self.dense.marks_mut()[at],
            Slot::Beyond(at) => &mut self.sparse.marks_mut()[at],
        }
    }

    /// Take over the lengths that `other` summed up in the same window; both are settled. Runs on
    /// the threads of the pool that it is called in.
    pub(crate) fn absorb(&mut self, other: &mut Self, window: &Window, pool: &ThreadPool) {
        self.visits += other.visits;
        self.walked += other.walked;
        let mut sources = std::mem::take(&mut self.sources);
        // `EMPTY` is no slot of `other`: blocks that keep it are left as they are.
        sources.clear();
        sources.resize(self.dense.len(), EMPTY);
        self.is_starved |= other.is_starved;
        for (index, slot) in other.slots() {
            let own = self.slot(window, index as usize);
            sources.resize(sources.len().max(own + 1), EMPTY);
            sources[own] = slot;
        }
        self.dense.absorb(&other.dense, &sources);
        self.sources = sources;
        other.clear(Some(pool));
    }

    /// Check that there was room for all blocks of the scan.
    ///
    /// # Errors
    /// [`Error::Limit`] if the scan touches too many blocks, [`Error::Memory`] if there is none for
    /// them; its marks are of no use then.
    pub(crate) fn check(&self) -> Result<(), Error> {
        if self.is_starved {
            let blocks = self.opened.len();
            let what =
                format!("a scan that touches more than {blocks} blocks of 2 KiB needs memory");
            return Err(Error::Memory { what });
        }
        if self.opened.len() > self.most || self.sparse.opened.len() > self.most {
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

    /// Touched voxels in which a ray left its length.
    pub(crate) fn walked(&self) -> u64 {
        self.walked
    }

    /// Index and slot of every block in the window that holds marks.
    fn slots(&self) -> impl Iterator<Item = (u32, u32)> {
        let opened = self.opened.iter().copied();
        let all = if self.opened.is_empty() { self.dense.len() as u32 } else { 0 };
        let met = self.dense.met();
        (0..all)
            .map(|index| (index, index))
            .chain(opened)
            .filter(|&(_, slot)| met[slot as usize] != 0)
    }

    /// Blocks with marks: first those in the window, in its order, then others in ascending order
    /// of place.
    pub(crate) fn marked(&mut self) -> impl Iterator<Item = (Place, Slot)> {
        // Blocks are opened in an order that depends on the threads; the map must not.
        self.opened.sort_unstable();
        self.sparse.opened.sort_unstable();
        let place = |index| self.window.map(|window| window.place(index));
        let within = self.slots().filter_map(move |(index, slot)| {
            Some((place(index as usize)?, Slot::Within(slot as usize)))
        });
        within.chain(
            self.sparse.opened.iter().map(|&(place, slot)| (place, Slot::Beyond(slot as usize))),
        )
    }

    /// Marks of a block, and a bit for every row that holds any; others are of no use. They may have
    /// to be put into `spare`.
    pub(crate) fn block<'a>(
        &'a self,
        slot: Slot,
        spare: &'a mut [Mark; VOLUME],
    ) -> (&'a [Mark; VOLUME], u64) {
        match slot {
            Slot::Within(slot) => (&self.dense.blocks()[slot], self.dense.met()[slot]),
            Slot::Beyond(slot) => {
                let met = self.sparse.copy(slot, spare);
                (spare, met)
            }
        }
    }
}

/// Call `add` for every step, ray by ray, since additions to one voxel right after another wait for
/// each other.
#[inline(always)]
fn each<const N: usize>(
    places: &[Steps<N>],
    lengths: &[Steps<N>],
    mut add: impl FnMut(usize, u32),
) {
    for lane in 0..N {
        for (places, lengths) in places.iter().zip(lengths) {
            for (place, length) in places.iter().zip(lengths) {
                add(place[lane] as usize, length[lane]);
            }
        }
    }
}
