//! Accumulator: marks of one scan, with points or ray length for every voxel.

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

/// Entry of a block without a slot, in the table of slots.
const EMPTY: u32 = u32::MAX;
/// Number of points that are marked together.
const POINTS_AT_A_TIME: usize = 64;

/// Number of steps of a ray that are added together.
pub(in crate::flying::integrate) const STEPS: usize = 8;
/// One number for each of `N` rays side by side, for each of several steps.
pub(crate) type Steps<const N: usize> = [[u32; N]; STEPS];

/// Marks of one scan, block by block. It is empty between scans and keeps its memory.
///
/// If the whole window is in memory, the slot of a block is its index in the window.
#[derive(Default)]
pub(crate) struct Accumulator {
    window: Option<Window>,
    /// Marks inside the window.
    dense: DenseBlocks,
    /// For a window that is not in memory as a whole: slot of every block, by its index in the
    /// window.
    table: Vec<u32>,
    /// Index and slot of every block in `table` that has a slot.
    opened: Vec<(u32, u32)>,
    /// Marks of points outside the window.
    sparse: SparseBlocks,
    /// Memory for [`Accumulator::absorb`]: slots of the other accumulator, by own slot.
    sources: Vec<u32>,
    visits: u64,
    /// Number of voxels to which walked rays added length. A voxel counts once for every ray.
    walked: u64,
    /// Largest number of blocks that one scan may touch.
    most: usize,
    /// True if there was no memory for a block.
    is_starved: bool,
}

/// Position of a block or a mark: inside the window, or among the blocks outside it.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Slot {
    Within(usize),
    Beyond(usize),
}

impl Accumulator {
    /// Memory that [`Accumulator::aim`] would take [bytes].
    pub(in crate::flying::integrate) fn room(&self, window: &Window) -> usize {
        if window.is_whole() {
            let of_block = size_of::<[Mark; VOLUME]>() + size_of::<u64>();
            window.len().saturating_sub(self.dense.len()) * of_block
        } else {
            window.len().saturating_sub(self.table.len()) * size_of::<u32>()
        }
    }

    /// Prepare the empty accumulator for `window`. The scan will touch at most `most` blocks.
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

    /// Remove all marks, for the next scan.
    pub(crate) fn clear(&mut self, pool: Option<&ThreadPool>) {
        (self.visits, self.walked, self.is_starved) = (0, 0, false);
        self.dense.clear(pool);
        for (index, _) in self.opened.drain(..) {
            self.table[index as usize] = EMPTY;
        }
        self.sparse.clear();
    }

    /// Slot of the block at `index` of the window. It is opened if needed.
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

    /// Add the lengths of several steps of `N` rays to the voxels at `places` of the window. Until
    /// `settle`, sums may exceed the largest count of a mark.
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

    /// Add to the number of voxels that rays cross.
    pub(in crate::flying::integrate) fn count(&mut self, visits: u64) {
        self.visits += visits;
    }

    /// Add to the number of voxels to which walked rays added length.
    pub(in crate::flying::integrate) fn count_walked(&mut self, visits: u64) {
        self.walked += visits;
    }

    /// Limit the sums of rays to the largest count, and note the rows with marks. `meets`: whether
    /// rays may have met the block at an index of the window.
    pub(in crate::flying::integrate) fn settle(&mut self, meets: impl Fn(usize) -> bool) {
        match self.window {
            Some(window) if window.is_whole() => {
                self.dense.settle(window.indices().filter(|index| meets(*index)));
            }
            _ => self.dense.settle(0..self.opened.len()),
        }
    }

    /// Mark points, each given by its voxel and content.
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

    /// Mark points of class `content` in `voxel`: `units` points, or units of weight.
    pub(crate) fn mark_points(&mut self, voxel: Voxel, content: Content, units: u32) {
        if let Some(mark) = self.mark(voxel) {
            *mark = with_points(*mark, content, units);
        }
    }

    /// Mark that background points may be in `voxel`, by `units` of weight, unless it holds other
    /// points.
    pub(crate) fn mark_beside(&mut self, voxel: Voxel, units: u32) {
        let others = [Content::Unknown as u32, Content::Flying as u32];
        if self.mark(voxel).is_some_and(|mark| !others.contains(&tag_and_count(*mark).0)) {
            self.mark_points(voxel, Content::Background, units);
        }
    }

    /// Mark of a voxel, to be changed. None if too many blocks would be open.
    #[inline]
    pub(crate) fn mark(&mut self, voxel: Voxel) -> Option<&mut Mark> {
        self.spot(voxel).map(|spot| self.at(spot))
    }

    /// Mark at a place of the window, to be changed.
    #[inline(always)]
    pub(in crate::flying::integrate) fn mark_within(
        &mut self,
        window: &Window,
        place: usize,
    ) -> &mut Mark {
        let spot = self.spot_within(window, place);
        &mut self.dense.marks_mut()[spot]
    }

    /// Position of the mark of a voxel, to be changed. None if too many blocks would be open.
    #[inline(always)]
    fn spot(&mut self, voxel: Voxel) -> Option<Slot> {
        let window = self.window?;
        if let Some(place) = window.place_of(voxel) {
            return Some(Slot::Within(self.spot_within(&window, place)));
        }
        let slot = self.sparse.slot(Place::of(voxel), self.most)?;
        Some(Slot::Beyond(self.sparse.spot(slot, offset_of(voxel))))
    }

    /// Index of the mark at a place of the window, to be changed.
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

    /// Add the ray lengths that `other` summed up in the same window, and empty `other`. Both must
    /// be settled. Runs on the threads of the pool that it is called in.
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

    /// Check that there was room for all blocks of the scan. On an error its marks must not be
    /// used.
    ///
    /// # Errors
    /// [`Error::Limit`] if the scan touches too many blocks, [`Error::Memory`] if there is no
    /// memory for them.
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

    /// Number of voxels that rays cross. A voxel counts once for every crossing.
    pub(crate) fn visits(&self) -> u64 {
        self.visits
    }

    /// Number of voxels to which walked rays added length. A voxel counts once for every ray.
    pub(crate) fn walked(&self) -> u64 {
        self.walked
    }

    /// Index and slot of every block of the window with marks.
    fn slots(&self) -> impl Iterator<Item = (u32, u32)> {
        let opened = self.opened.iter().copied();
        let all = if self.opened.is_empty() { self.dense.len() as u32 } else { 0 };
        let met = self.dense.met();
        (0..all)
            .map(|index| (index, index))
            .chain(opened)
            .filter(|&(_, slot)| met[slot as usize] != 0)
    }

    /// Blocks with marks: first those of the window, in its order, then the others in ascending
    /// order of place.
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

    /// Marks of a block, and a bit for every row with marks. Rows without this bit must not be
    /// read. `spare`: memory for blocks outside the window.
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

/// Call `add` for every step, ray by ray: additions to the same voxel directly after one another
/// would wait for each other.
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
