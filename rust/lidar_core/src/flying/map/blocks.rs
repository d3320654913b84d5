//! Storage of the voxel map: blocks of 8 x 8 x 8 voxels. The rows of 8 voxels are allocated at the first visit.

use super::block_shape::{Bits, EDGE, EDGE_BITS, Row, VOLUME, has};
use super::inert::Inert;
use crate::Error;
use crate::geometry::lattice::Voxel;
use crate::util::full_state::impossible;
use crate::util::key_hasher::KeyHasher;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasherDefault, Hash, Hasher};

/// If a scan finds no room, the map removes up to the budget divided by this number at once: the blocks farthest from
/// the scan.
const SPARE: usize = 8;

/// Value of a voxel that no point and no ray has met.
pub(crate) const NEVER: f32 = f32::NAN;

/// Values of the voxels of a block. Only the rows that points or rays have met are stored.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct Block {
    pub(crate) place: Place,
    /// Voxels that are tentatively or confidently occupied.
    pub(crate) tentative: Bits,
    /// Voxels that are confidently occupied.
    pub(crate) confident: Bits,
    /// Voxels that rays cannot change. They are not saved: the bytes of a file may be wrong, and a scan finds these
    /// voxels again.
    #[serde(skip)]
    pub(crate) inert: Inert,
    /// One bit for every row that is stored.
    held: u64,
    /// The stored rows, in the order of y, then z.
    rows: Vec<Row>,
}

impl Block {
    fn new(place: Place) -> Self {
        let (bits, inert) = ([0; 8], Inert::default());
        Self { place, tentative: bits, confident: bits, inert, held: 0, rows: Vec::new() }
    }

    /// True if the number of rows agrees with their bits. Checks a block from a saved state.
    fn is_whole(&self) -> bool {
        self.rows.len() == self.held.count_ones() as usize
    }

    /// True if one of its voxels is permanent: a user has set it, and no scan can restore it.
    fn is_permanent(&self) -> bool {
        self.rows.iter().flatten().any(|value| value.is_infinite())
    }

    /// True if one of its voxels is tentatively or confidently occupied.
    #[inline]
    pub(crate) fn has_tentative(&self) -> bool {
        self.tentative != Bits::default()
    }

    /// Number of voxels that were observed.
    pub(crate) fn observed(&self) -> usize {
        self.rows.iter().flatten().filter(|value| !value.is_nan()).count()
    }

    /// Memory of the block [bytes].
    pub(crate) fn bytes(&self) -> usize {
        size_of::<Self>() + self.rows.capacity() * size_of::<Row>()
    }

    /// The stored value of the voxel `offset`. NaN if it was never observed.
    #[inline]
    pub(crate) fn value(&self, offset: usize) -> f32 {
        let row = offset / EDGE as usize;
        if self.held >> row & 1 == 0 {
            return NEVER;
        }
        self.rows[self.before(row)][offset % EDGE as usize]
    }

    pub(crate) fn values(&self) -> impl Iterator<Item = f32> {
        (0..VOLUME).map(|offset| self.value(offset))
    }

    /// Store the value of the voxel `offset`.
    pub(crate) fn set(&mut self, offset: usize, value: f32) {
        let row = offset / EDGE as usize;
        self.hold(1 << row);
        self.inert.forget(offset);
        if let Some(values) = self.row_mut(row) {
            values[offset % EDGE as usize] = value;
        }
    }

    /// The values of a row, to be changed. None if the row is not stored.
    #[inline]
    fn row_mut(&mut self, row: usize) -> Option<&mut Row> {
        let at = self.before(row);
        self.rows.get_mut(at).filter(|_| self.held >> row & 1 == 1)
    }

    /// The values of a row. None if the row is not stored.
    #[inline]
    pub(crate) fn row(&self, row: usize) -> Option<&Row> {
        self.rows.get(self.before(row)).filter(|_| self.held >> row & 1 == 1)
    }

    /// Change the values of a stored row. None of them may cross a bound between occupied states.
    #[inline]
    pub(crate) fn set_row(&mut self, row: usize, values: &Row) {
        self.inert.forget_row(row);
        if let Some(stored) = self.row_mut(row) {
            *stored = *values;
        }
    }

    /// Store the rows whose bits are set, in addition to those that are already stored.
    pub(crate) fn hold(&mut self, rows: u64) {
        let (old, held) = (self.held, self.held | rows);
        if old == held {
            return;
        }
        // Exactly as many as needed: most blocks never hold all 64 rows.
        let mut all = Vec::with_capacity(held.count_ones() as usize);
        let mut known = self.rows.iter();
        for row in (0..64).filter(|row| held >> row & 1 == 1) {
            let before = if old >> row & 1 == 1 { known.next() } else { None };
            all.push(before.copied().unwrap_or([NEVER; EDGE as usize]));
        }
        (self.held, self.rows) = (held, all);
    }

    /// Number of stored rows before this one.
    #[inline]
    fn before(&self, row: usize) -> usize {
        // Rows lie packed in the order of their bits: the bits below count those before.
        (self.held & ((1 << row) - 1)).count_ones() as usize
    }
}

/// Index of a block along x, y, z, in the grid of blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(crate) struct Place(pub(crate) [i32; 3]);

impl Place {
    #[inline]
    pub(crate) fn of(voxel: Voxel) -> Self {
        // The arithmetic shift rounds down below 0 too, where a division would round up.
        Self(voxel.map(|index| index >> EDGE_BITS))
    }

    /// True if all neighbours of the block have indices. This holds around every voxel that contains a point.
    pub(crate) fn has_neighbours(self) -> bool {
        self.0.iter().all(|&index| i32::MIN < index && index < i32::MAX)
    }

    /// The voxel at `offset` inside this block.
    #[inline]
    pub(crate) fn voxel(self, offset: usize) -> Voxel {
        let offset = offset as i32;
        let inside = [offset & 7, offset >> EDGE_BITS & 7, offset >> (2 * EDGE_BITS)];
        std::array::from_fn(|axis| (self.0[axis] << EDGE_BITS) + inside[axis])
    }
}

/// Offset of a voxel in its block: x + 8 y + 64 z.
#[inline]
pub(crate) fn offset_of(voxel: Voxel) -> usize {
    // The lowest bits of two's complement are the place in the block for negative indices too.
    ((voxel[0] & 7) | (voxel[1] & 7) << EDGE_BITS | (voxel[2] & 7) << (2 * EDGE_BITS)) as usize
}

impl Hash for Place {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let [x, y, z] = self.0.map(|index| u64::from(index.cast_unsigned()));
        // The indices of near blocks differ in their low bits. Each axis has these bits in another third of the
        // word, so that near blocks get different keys.
        state.write_u64(x ^ y.rotate_left(21) ^ z.rotate_left(42));
    }
}

/// All blocks of a map, found by their place in constant time.
#[derive(Clone)]
pub(crate) struct Blocks {
    slots: HashMap<Place, u32, BuildHasherDefault<KeyHasher>>,
    /// The blocks by slot. None only while a block is being updated.
    pool: Vec<Option<Box<Block>>>,
    max_blocks: usize,
}

impl Blocks {
    pub(crate) fn new(max_voxels: u64) -> Self {
        let max_blocks = usize::try_from(max_voxels / VOLUME as u64).unwrap_or(usize::MAX);
        Self {
            slots: HashMap::default(),
            pool: Vec::new(),
            max_blocks: max_blocks.min(u32::MAX as usize),
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.pool.len()
    }

    /// Largest number of blocks: the budget of the map.
    pub(crate) fn max_blocks(&self) -> usize {
        self.max_blocks
    }

    pub(crate) fn slot(&self, place: Place) -> Option<u32> {
        self.slots.get(&place).copied()
    }

    #[inline]
    pub(crate) fn get(&self, place: Place) -> Option<&Block> {
        self.at(self.slot(place)?)
    }

    #[inline]
    pub(crate) fn find(&self, place: Place) -> Option<(u32, &Block)> {
        let slot = self.slot(place)?;
        Some((slot, self.at(slot)?))
    }

    /// The stored value of a voxel. NaN if it was never observed.
    pub(crate) fn stored(&self, voxel: Voxel) -> f32 {
        self.get(Place::of(voxel)).map_or(NEVER, |block| block.value(offset_of(voxel)))
    }

    #[inline]
    pub(crate) fn at(&self, slot: u32) -> Option<&Block> {
        self.pool.get(slot as usize)?.as_deref()
    }

    pub(crate) fn at_mut(&mut self, slot: u32) -> Option<&mut Block> {
        self.pool.get_mut(slot as usize)?.as_deref_mut()
    }

    /// All blocks, in the order in which they were made.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Block> {
        self.pool.iter().filter_map(Option::as_deref)
    }

    /// Slots of the blocks at `places`. Missing blocks are made; on an error, none is.
    ///
    /// # Errors
    /// [`Error::Limit`] if the map would exceed its budget, or if there is not enough memory.
    pub(crate) fn ensure(&mut self, places: &[Place]) -> Result<Vec<u32>, Error> {
        self.reserve(places.iter().filter(|&&place| self.slot(place).is_none()).count())?;
        Ok(places.iter().map(|&place| self.make(place)).collect())
    }

    /// Reserve memory for this number of additional blocks.
    ///
    /// # Errors
    /// As [`Blocks::ensure`].
    pub(crate) fn reserve(&mut self, missing: usize) -> Result<(), Error> {
        let wanted = self.pool.len() + missing;
        if wanted > self.max_blocks
            // A plain `push` would end the process if the memory cannot be had.
            || self.pool.try_reserve(missing).is_err()
            || self.slots.try_reserve(missing).is_err()
        {
            return Err(self.refusal(missing));
        }
        Ok(())
    }

    /// Slot of the block at `place`, which is made if it is missing.
    pub(crate) fn make(&mut self, place: Place) -> u32 {
        let next = self.pool.len() as u32; // at most u32::MAX blocks
        let slot = *self.slots.entry(place).or_insert(next);
        if slot == next {
            self.pool.push(Some(Box::new(Block::new(place))));
        }
        slot
    }

    /// Blocks to remove so that there is room for `missing` more. Empty if there is room already.
    ///
    /// Blocks farthest from the box between `low` and `high` come first. Blocks at the same distance are in the order
    /// of their places. Up to an eighth of the budget outside the box is removed at once, so that only few scans have
    /// to make room. Blocks with permanent voxels, and blocks for which `is_needed` is true, stay.
    ///
    /// # Errors
    /// [`Error::Limit`] if there are not enough blocks that may be removed.
    pub(crate) fn farthest(
        &self,
        missing: usize,
        [low, high]: [Place; 2],
        is_needed: impl Fn(Place) -> bool,
    ) -> Result<HashSet<Place>, Error> {
        let excess = (self.len() + missing).saturating_sub(self.max_blocks);
        if excess == 0 {
            return Ok(HashSet::new());
        }
        let away = |place: Place| {
            let axis = |axis: usize| {
                let [index, low, high] = [place, low, high].map(|place| i64::from(place.0[axis]));
                (low - index).max(index - high).max(0)
            };
            axis(0).max(axis(1)).max(axis(2))
        };
        let mut candidates: Vec<(Reverse<i64>, Place)> = (self.iter())
            .filter(|block| !is_needed(block.place) && !block.is_permanent())
            .map(|block| (Reverse(away(block.place)), block.place))
            .collect();
        if candidates.len() < excess {
            return Err(self.refusal(missing));
        }
        candidates.sort_unstable();
        let outside = candidates.partition_point(|&(Reverse(away), _)| away > 0);
        let count = excess.max(outside.min(self.max_blocks / SPARE));
        Ok(candidates.into_iter().take(count).map(|(_, place)| place).collect())
    }

    fn refusal(&self, missing: usize) -> Error {
        Error::Limit {
            what: format!("a voxel map of {} voxels", (self.len() + missing) * VOLUME),
            limit: (self.max_blocks * VOLUME) as u64,
            key: "voxel_map.max_voxels",
        }
    }

    /// Insert blocks of a saved state, in the order in which they were made.
    ///
    /// # Errors
    /// [`Error::Limit`] above the budget; [`Error::Format`] for blocks that no map has.
    pub(crate) fn restore(&mut self, blocks: Vec<Block>) -> Result<(), Error> {
        self.reserve(blocks.len())?;
        for (slot, block) in blocks.into_iter().enumerate() {
            let is_new = self.slots.insert(block.place, slot as u32).is_none();
            if !is_new || !block.is_whole() {
                return Err(impossible("a block twice, or with other rows than it holds"));
            }
            self.pool.push(Some(Box::new(block)));
        }
        Ok(())
    }

    /// Take a block out for an update. [`Blocks::put`] puts it back. None if there is no such block.
    pub(crate) fn take(&mut self, slot: u32) -> Option<Box<Block>> {
        self.pool.get_mut(slot as usize)?.take()
    }

    pub(crate) fn put(&mut self, slot: u32, block: Box<Block>) {
        self.pool[slot as usize] = Some(block);
    }

    /// Remove every block for which `keep` returns false. The slots of others change.
    pub(crate) fn retain(&mut self, mut keep: impl FnMut(Place) -> bool) {
        self.pool.retain(|block| block.as_ref().is_some_and(|block| keep(block.place)));
        // Slots are positions in the pool: all behind a dropped block have changed.
        self.slots.clear();
        for (slot, block) in self.pool.iter().enumerate() {
            if let Some(block) = block {
                self.slots.insert(block.place, slot as u32);
            }
        }
    }
}

/// Reads single voxels. It stores the last block, because neighbouring voxels share it.
pub(crate) struct Cursor<'a> {
    blocks: &'a Blocks,
    last: Option<(Place, Option<&'a Block>)>,
}

impl<'a> Cursor<'a> {
    pub(crate) fn new(blocks: &'a Blocks) -> Self {
        Self { blocks, last: None }
    }

    #[inline]
    pub(crate) fn block(&mut self, place: Place) -> Option<&'a Block> {
        match self.last {
            Some((known, block)) if known == place => block,
            _ => {
                // Missing blocks are remembered too: most of the air has none.
                let block = self.blocks.get(place);
                self.last = Some((place, block));
                block
            }
        }
    }

    /// The stored value of a voxel. NaN if it was never observed.
    #[inline]
    pub(crate) fn stored(&mut self, voxel: Voxel) -> f32 {
        self.block(Place::of(voxel)).map_or(NEVER, |block| block.value(offset_of(voxel)))
    }

    #[inline]
    pub(crate) fn is_tentative(&mut self, voxel: Voxel) -> bool {
        self.block(Place::of(voxel)).is_some_and(|block| has(&block.tentative, offset_of(voxel)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_voxel_is_found_in_its_block() {
        for voxel in [[0, 0, 0], [-1, 7, 8], [-9, 100, -64], [i32::MAX - 1, i32::MIN + 1, 3]] {
            assert_eq!(Place::of(voxel).voxel(offset_of(voxel)), voxel);
        }
    }

    #[test]
    fn rows_are_held_in_order_however_they_come() {
        let mut block = Block::new(Place([0; 3]));
        for (step, offset) in [300, 5, 511, 4, 64].into_iter().enumerate() {
            block.set(offset, step as f32);
        }
        block.hold(0b111);
        assert_eq!(
            [300, 5, 511, 4, 64].map(|offset| block.value(offset)),
            [0.0, 1.0, 2.0, 3.0, 4.0]
        );
        assert_eq!(block.values().filter(|value| !value.is_nan()).count(), 5);
        assert!(block.row_mut(1).is_some() && block.row_mut(9).is_none());
    }

    #[test]
    fn a_full_map_refuses_and_stays_as_it_was() -> Result<(), Error> {
        let mut blocks = Blocks::new(2 * VOLUME as u64);
        blocks.ensure(&[Place([0, 0, 0])])?;
        assert!(matches!(
            blocks.ensure(&[Place([1, 0, 0]), Place([2, 0, 0])]),
            Err(Error::Limit { .. })
        ));
        assert_eq!(blocks.len(), 1);
        assert_eq!(blocks.ensure(&[Place([5, 0, 0]), Place([0, 0, 0])])?, [1, 0]);
        blocks.retain(|place| place.0[0] == 5);
        assert_eq!((blocks.slot(Place([5, 0, 0])), blocks.slot(Place([0, 0, 0]))), (Some(0), None));
        Ok(())
    }
}
