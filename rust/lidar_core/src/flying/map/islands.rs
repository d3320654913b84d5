//! Search for groups of occupied voxels with too few confidently occupied ones.
//!
//! Each step handles the voxels of one layer of a block, as the bits of a word.

use super::block_shape::{Bits, has};
use super::blocks::{Block, Blocks, Place};
use super::layers::{Layer, Neighbours};
use crate::geometry::lattice::Voxel;
use crate::util::key_hasher::KeyHasher;
use std::collections::HashSet;
use std::hash::BuildHasherDefault;

/// Results of the searches for the voxels of one block.
#[derive(Clone, Copy, Default)]
struct SearchResults {
    /// Voxels that a search of this removal has met.
    met: Bits,
    /// Voxels whose group has enough confident voxels, or had them at the last removal
    /// ("anchored").
    anchored: Bits,
}

/// Results of the searches by slot of the block, and working memory. Between removals, no voxel
/// counts as met.
#[derive(Clone, Default)]
pub(crate) struct SearchMemory {
    results: Vec<SearchResults>,
    /// Slots of the blocks that contain met voxels.
    touched: Vec<u32>,
    /// Voxels of the group that is being searched.
    members: Vec<Layer>,
    /// Voxels of the separate groups that were found.
    pub(crate) separate: Vec<Layer>,
}

impl SearchMemory {
    /// For each slot, the voxels whose group had enough confident ones at the last removal.
    pub(super) fn anchored(&self) -> Vec<Bits> {
        self.results.iter().map(|one| one.anchored).collect()
    }

    /// Search memory as after a removal with these anchored voxels.
    pub(super) fn restored(anchored: Vec<Bits>) -> Self {
        let with_anchors = |anchored| SearchResults { anchored, ..SearchResults::default() };
        Self { results: anchored.into_iter().map(with_anchors).collect(), ..Self::default() }
    }

    fn at(&mut self, slot: u32) -> &mut SearchResults {
        let results = &mut self.results[slot as usize];
        if results.met.iter().all(|&bits| bits == 0) {
            // No bit is set yet, so the slot is not listed: each is listed once.
            self.touched.push(slot);
        }
        results
    }
}

/// Number of blocks in the cache: 16 x 16 x 8.
const CACHED_BLOCKS: usize = 1 << 11;

/// Slot of a block in the map's pool, and the block.
type BlockInSlot<'a> = (u32, &'a Block);

/// Cache of blocks with occupied voxels. It saves time because a search goes from neighbour to
/// neighbour.
struct BlockCache<'a> {
    blocks: &'a Blocks,
    known: [(Place, Option<BlockInSlot<'a>>); CACHED_BLOCKS],
}

impl<'a> BlockCache<'a> {
    fn new(blocks: &'a Blocks) -> Self {
        Self { blocks, known: [(Place([i32::MAX; 3]), None); CACHED_BLOCKS] } // no voxel lies there
    }

    #[inline]
    fn find(&mut self, place: Place) -> Option<BlockInSlot<'a>> {
        let [x, y, z] = place.0.map(|index| index as usize);
        // Indexed by the low bits of the place: blocks near each other never displace one another.
        let known = &mut self.known[(z & 7) << 8 | (y & 15) << 4 | x & 15];
        if known.0 != place {
            let found = self.blocks.find(place);
            *known =
                (place, found.filter(|(_, block)| block.tentative.iter().any(|&bits| bits != 0)));
        }
        known.1
    }
}

/// Breadth-first searches of one removal. Each search uses the results of the earlier ones.
pub(crate) struct Search<'a> {
    blocks: BlockCache<'a>,
    neighbours: &'a Neighbours,
    kept: &'a HashSet<Place, BuildHasherDefault<KeyHasher>>,
    min_confident: usize,
    memory: SearchMemory,
    /// True if anchored voxels of the last removal count as anchored.
    trusts_last: bool,
    anchor: Option<Voxel>,
}

impl<'a> Search<'a> {
    pub(crate) fn new(
        blocks: &'a Blocks,
        neighbours: &'a Neighbours,
        kept: &'a HashSet<Place, BuildHasherDefault<KeyHasher>>,
        min_confident: usize,
        mut memory: SearchMemory,
    ) -> Self {
        memory.results.resize(blocks.len(), SearchResults::default());
        memory.separate.clear();
        Self {
            blocks: BlockCache::new(blocks),
            neighbours,
            kept,
            min_confident,
            memory,
            trusts_last: false,
            anchor: None,
        }
    }

    /// From now on, count the anchored voxels of the last removal. All groups that have lost voxels
    /// since then must have been searched before.
    pub(super) fn trust_last(&mut self) {
        self.trusts_last = true;
    }

    /// A voxel of some group with enough confident ones. None if no search has found one.
    pub(crate) fn anchor(&self) -> Option<Voxel> {
        self.anchor
    }

    /// Finish the removal. Returns the memory for the next one, which contains the voxels of
    /// separate groups.
    pub(crate) fn finish(mut self) -> SearchMemory {
        let SearchMemory { results, touched, .. } = &mut self.memory;
        for slot in touched.drain(..) {
            // `anchored` stays, for the next removal to rely on.
            results[slot as usize].met = Bits::default();
        }
        self.memory
    }

    /// Search the groups of voxels that have changed. For a voxel that is no longer occupied,
    /// search the groups around it, which it may have connected.
    pub(super) fn look_around(&mut self, changed: &[Layer]) {
        for &layer in changed {
            let found = self.blocks.find(layer.place);
            let occupied = found.map_or(0, |(_, block)| block.tentative[layer.z as usize]);
            if let Some(found) = found {
                self.each_unmet(found, Layer { bits: layer.bits & occupied, ..layer });
            }
            let gone = Layer { bits: layer.bits & !occupied, ..layer };
            if gone.bits != 0 {
                if let Some(slot) = self.blocks.blocks.slot(gone.place) {
                    self.memory.results[slot as usize].anchored[gone.z as usize] &= !gone.bits;
                }
                self.each_around(&gone, |search, found, beside| {
                    search.each_unmet(found, beside);
                    false
                });
            }
        }
    }

    /// Search the groups of those voxels of an occupied layer that no search has met yet.
    fn each_unmet(&mut self, found: BlockInSlot<'a>, layer: Layer) {
        for offset in layer.offsets() {
            if !has(&self.memory.results[found.0 as usize].met, offset) {
                self.component(found, layer.place.voxel(offset));
            }
        }
    }

    /// Call `visit` for the layers with [`open`](Self::open) voxels in the neighbourhood of a
    /// layer, until one call returns true. Returns whether a call returned true.
    #[inline]
    fn each_around(
        &mut self,
        layer: &Layer,
        mut visit: impl FnMut(&mut Self, BlockInSlot<'a>, Layer) -> bool,
    ) -> bool {
        let neighbours = self.neighbours;
        let [x, y, z] = layer.place.0;
        neighbours.any_block(layer, |step| {
            let place = Place([x + step[0], y + step[1], z + step[2]]);
            let Some(found) = self.blocks.find(place) else { return false };
            neighbours.layers(layer, step[2]).any(|z| {
                let open = self.open(found, z as usize);
                let bits = if open == 0 { 0 } else { open & neighbours.of(layer, step, z) };
                bits != 0 && visit(self, found, Layer { place, z, bits })
            })
        })
    }

    /// Search the group of `start` until it is anchored (has enough confident voxels), or is
    /// completely known and separate.
    fn component(&mut self, found: BlockInSlot<'a>, start: Voxel) {
        let mut members = std::mem::take(&mut self.memory.members);
        members.clear();
        let mut confident = 0;
        let mut anchored = self.meet(found, Layer::of(start), &mut members, &mut confident)
            || confident >= self.min_confident;
        let mut next = 0;
        while let Some(&layer) = members.get(next).filter(|_| !anchored) {
            next += 1;
            anchored = self.each_around(&layer, |search, found, beside| {
                search.meet(found, beside, &mut members, &mut confident)
                    || confident >= search.min_confident
            });
        }
        if anchored {
            self.anchor = self.anchor.or(Some(start));
            for layer in &members {
                if let Some((slot, _)) = self.blocks.find(layer.place) {
                    self.memory.at(slot).anchored[layer.z as usize] |= layer.bits;
                }
            }
        } else if !members.iter().any(|layer| self.is_kept(layer)) {
            self.memory.separate.extend(&members);
        }
        self.memory.members = members;
    }

    fn is_kept(&self, layer: &Layer) -> bool {
        let kept = |offset| self.kept.contains(&Place(layer.place.voxel(offset)));
        !self.kept.is_empty() && layer.offsets().any(kept)
    }

    /// Bits of the occupied voxels of a layer that no search has met, or whose group is known to be
    /// anchored.
    #[inline]
    fn open(&self, (slot, block): BlockInSlot<'_>, z: usize) -> u64 {
        // Anchored voxels are open although they were met: to reach one ends a search.
        block.tentative[z] & (!self.memory.results[slot as usize].met[z] | self.anchored(slot, z))
    }

    /// Bits of the voxels of a layer whose group is known to be anchored.
    #[inline]
    fn anchored(&self, slot: u32, z: usize) -> u64 {
        let SearchResults { met, anchored } = &self.memory.results[slot as usize];
        // Before that only what this removal has met: a group that lost voxels may have come apart.
        if self.trusts_last { anchored[z] } else { anchored[z] & met[z] }
    }

    /// Add open voxels to the group if no search has met them, and the voxels connected with them
    /// in their layer. Returns true if one of the open voxels is anchored.
    #[inline]
    fn meet(
        &mut self,
        (slot, block): BlockInSlot<'_>,
        layer: Layer,
        members: &mut Vec<Layer>,
        confident: &mut usize,
    ) -> bool {
        let z = layer.z as usize;
        let anchored = layer.bits & self.anchored(slot, z) != 0;
        let unmet = block.tentative[z] & !self.memory.results[slot as usize].met[z];
        let (mut bits, mut more) = (0, layer.bits & unmet);
        while more != 0 {
            bits |= more;
            let beside = self.neighbours.of(&Layer { bits: more, ..layer }, [0; 3], layer.z);
            more = beside & unmet & !bits;
        }
        if bits != 0 {
            let trusts_last = self.trusts_last;
            let results = self.memory.at(slot);
            results.met[z] |= bits;
            // An older anchor is void until this search has found the group anchored again.
            results.anchored[z] &= if trusts_last { u64::MAX } else { !bits };
            *confident += (bits & block.confident[z]).count_ones() as usize;
            members.push(Layer { bits, ..layer });
        }
        anchored
    }
}
