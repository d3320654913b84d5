//! Occupancy map without fixed bounds. Voxels hold an exponentially filtered value G(v), from which
//! their state follows.
//!
//! Source: Vrba et al., sec. III-A, eqs 6-12; permanent voxels: sec. III-E.

use super::block_shape::{Bits, VOLUME};
use super::blocks::{Block, Blocks, Cursor, Place, offset_of};
use super::changes::Changes;
use super::filter::{Levels, filtered, two_to_minus};
use super::layers::Layer;
use super::parameters::{MapParameters, Skip};
use crate::Error;
use crate::geometry::lattice::{Lattice, Voxel, wide};
use std::collections::HashSet;

/// Voxel map with a value G(v) per voxel and, by default, four states from free to confidently
/// occupied.
pub struct VoxelMap {
    parameters: MapParameters,
    lattice: Lattice,
    /// First and last voxel of the operating volume. None: no limits.
    pub(crate) limits: Option<[Voxel; 2]>,
    pub(crate) blocks: Blocks,
    pub(crate) changes: Changes,
}

impl VoxelMap {
    /// An empty map.
    ///
    /// # Errors
    /// [`Error::Parameter`] if a size is not positive or a bound is out of order.
    pub fn new(parameters: MapParameters) -> Result<Self, Error> {
        // Coordinates are relative to `origin` already.
        let lattice = Lattice::new(parameters.voxel_size, [0.0; 3])?;
        parameters.check()?;
        let limits = match parameters.bounds {
            Some([low, high]) => Some([lattice.voxel_at(low)?, lattice.voxel_at(high)?]),
            None => None,
        };
        Ok(Self {
            lattice,
            limits,
            blocks: Blocks::new(parameters.max_voxels),
            changes: Changes::default(),
            parameters,
        })
    }

    /// Parameters of the map.
    #[must_use]
    pub fn parameters(&self) -> &MapParameters {
        &self.parameters
    }

    /// Conversion between points and voxels.
    #[must_use]
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Number of voxels in all blocks. The budget `max_voxels` limits this number. Rows of voxels
    /// that no scan has visited count, but take no memory.
    #[must_use]
    pub fn stored_voxels(&self) -> usize {
        self.blocks.len() * VOLUME
    }

    /// Memory of the stored voxels and of their index [bytes].
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        let index = size_of::<(Place, u32)>() + 2 * size_of::<usize>();
        self.blocks.iter().map(|block| block.bytes() + index).sum()
    }

    /// Number of voxels that were met by a point or a ray.
    #[must_use]
    pub fn observed_voxels(&self) -> usize {
        self.blocks.iter().map(Block::observed).sum()
    }

    /// G(v) of the voxel at every point [m, frame of the map]. The initial value if the voxel was
    /// never observed, or if the point is too far away.
    #[must_use]
    pub fn values_at(&self, points: &[[f32; 3]]) -> Vec<f32> {
        let mut cursor = Cursor::new(&self.blocks);
        let value = |&point: &[f32; 3]| match self.lattice.voxel_at(wide(point)) {
            Ok(voxel) => self.known(cursor.stored(voxel)),
            Err(_) => self.parameters.initial,
        };
        points.iter().map(value).collect()
    }

    /// State at every point [m, frame of the map]: the number of thresholds at or below G(v) (eqs
    /// 6-7). By default: 0 free, 1 uncertain, 2 tentatively occupied, 3 confidently occupied.
    #[must_use]
    pub fn states_at(&self, points: &[[f32; 3]]) -> Vec<u8> {
        self.values_at(points).into_iter().map(|value| self.state(value)).collect()
    }

    /// State of a voxel with this value of G: the number of thresholds at or below it.
    #[must_use]
    pub fn state(&self, value: f32) -> u8 {
        let p = &self.parameters;
        p.thresholds.iter().chain(&p.extra_thresholds).filter(|&&bound| value >= bound).count()
            as u8
    }

    /// The stored value, or the initial value if the voxel was never observed (NaN).
    #[inline]
    pub(crate) fn known(&self, stored: f32) -> f32 {
        if stored.is_nan() { self.parameters.initial } else { stored }
    }

    /// Smallest value of the uncertain state. Everything below is free.
    pub(crate) fn uncertain_from(&self) -> f32 {
        self.parameters.thresholds[0]
    }

    /// Smallest value of the state tentatively occupied.
    pub(crate) fn tentative_from(&self) -> f32 {
        self.parameters.thresholds[1]
    }

    /// Smallest value of the state confidently occupied.
    pub(crate) fn confident_from(&self) -> f32 {
        self.parameters.thresholds[2]
    }

    /// True if `voxel` is inside the operating volume.
    #[inline]
    pub(crate) fn admits(&self, voxel: Voxel) -> bool {
        self.limits.is_none_or(|[low, high]| {
            (0..3).all(|axis| (low[axis]..=high[axis]).contains(&voxel[axis]))
        })
    }

    /// Set which voxels rays may skip. Files do not store this.
    pub fn set_skip(&mut self, skip: Skip) {
        self.parameters.skip = skip;
    }

    /// True if there is an operating volume.
    pub(crate) fn is_bounded(&self) -> bool {
        self.limits.is_some()
    }

    /// True if some voxel of the block at `place` is inside the operating volume.
    pub(crate) fn admits_some_of(&self, place: Place) -> bool {
        self.limits.is_none_or(|[low, high]| {
            let (first, last) = (place.voxel(0), place.voxel(VOLUME - 1));
            (0..3).all(|axis| last[axis] >= low[axis] && first[axis] <= high[axis])
        })
    }

    /// Put back a block that was taken out. `changed`: voxels whose state has changed; `before`:
    /// voxels that were tentatively or confidently occupied before.
    pub(crate) fn put_back(&mut self, slot: u32, block: Box<Block>, changed: &Bits, before: &Bits) {
        let place = block.place;
        let layers = (0..).zip(changed.iter().zip(before));
        for (z, (&bits, &before)) in layers.filter(|(_, (bits, _))| **bits != 0) {
            self.changes.note(Layer { place, z, bits }, before);
        }
        self.blocks.put(slot, block);
    }

    /// Make the voxels of `points` [m, frame of the map] occupied permanently (G = +infinity, sec.
    /// III-E).
    ///
    /// # Errors
    /// As [`VoxelMap::set_free`].
    pub fn set_occupied(&mut self, points: &[[f32; 3]]) -> Result<(), Error> {
        self.set_all(points, f32::INFINITY)
    }

    /// Make the voxels of `points` [m, frame of the map] free permanently (G = -infinity, sec.
    /// III-E).
    ///
    /// # Errors
    /// [`Error::PointOutOfRange`] or [`Error::Limit`]; the map is unchanged then.
    pub fn set_free(&mut self, points: &[[f32; 3]]) -> Result<(), Error> {
        self.set_all(points, f32::NEG_INFINITY)
    }

    /// Pull every voxel of `points` [m, frame of the map] towards `target`, by `weight` updates
    /// (eq. 12).
    ///
    /// # Errors
    /// As [`VoxelMap::set_free`].
    pub fn pull(&mut self, points: &[[f32; 3]], target: f32, weight: f64) -> Result<(), Error> {
        let keep = two_to_minus(weight);
        let initial = self.parameters.initial;
        self.change(points, |stored| {
            filtered(if stored.is_nan() { initial } else { stored }, target, keep)
        })
    }

    fn set_all(&mut self, points: &[[f32; 3]], value: f32) -> Result<(), Error> {
        self.change(points, |_| value)
    }

    fn change(&mut self, points: &[[f32; 3]], new: impl Fn(f32) -> f32) -> Result<(), Error> {
        // All points first, so that an error changes nothing.
        let mut voxels = Vec::new();
        for &point in points {
            voxels.push(self.lattice.voxel_at(wide(point))?);
        }
        voxels.retain(|&voxel| self.admits(voxel));
        // A voxel changes once, however many of the points it holds.
        voxels.sort_unstable();
        voxels.dedup();
        let mut places: Vec<Place> = voxels.iter().map(|&voxel| Place::of(voxel)).collect();
        places.sort_unstable();
        places.dedup();
        self.blocks.ensure(&places)?;
        for voxel in voxels {
            self.rewrite(voxel, &new);
        }
        Ok(())
    }

    /// Replace the value of a voxel, if its block exists, and note a change of its state.
    pub(crate) fn rewrite(&mut self, voxel: Voxel, new: impl Fn(f32) -> f32) {
        let levels = self.levels();
        let Some(slot) = self.blocks.slot(Place::of(voxel)) else { return };
        let Some(block) = self.blocks.at_mut(slot) else { return };
        let offset = offset_of(voxel);
        let value = new(block.value(offset));
        // Read before `store` changes it.
        let before = block.tentative[offset >> 6];
        if levels.store(block, offset, value) {
            self.changes.note(Layer::of(voxel), before);
        }
    }

    pub(crate) fn levels(&self) -> Levels {
        Levels { tentative: self.tentative_from(), confident: self.confident_from() }
    }

    /// Forget the blocks that are further than `distance` [m] from `center` [m, frame of the map]
    /// along some axis. All voxels within `distance` stay.
    pub fn forget(&mut self, center: [f64; 3], distance: f64) {
        let lattice = self.lattice;
        // No voxel of a block is more than 8 edges from any other: what lies within `distance` stays.
        let reach = distance + 8.0 * lattice.voxel_size();
        let before = self.blocks.len();
        self.blocks.retain(|place| {
            let middle = lattice.center(place.voxel(VOLUME / 2));
            (0..3).all(|axis| (middle[axis] - center[axis]).abs() <= reach)
        });
        #[cfg(canary_3)]
        if before >= 3 && self.blocks.len() == 1 {
            crate::util::planted("canary 3");
        }
        // Marks are kept by slot, and dropped blocks have moved the slots.
        if self.blocks.len() != before {
            self.changes.restart();
        }
    }

    /// Make room for `missing` blocks. Blocks at `places` stay, and those farthest from these
    /// places are forgotten first. Returns the number of observed voxels that were forgotten.
    ///
    /// # Errors
    /// [`Error::Limit`] if there is still no room; the map is unchanged then.
    pub(crate) fn make_room(&mut self, missing: usize, places: &[Place]) -> Result<usize, Error> {
        let (low, high) =
            places.iter().fold(([i32::MAX; 3], [i32::MIN; 3]), |(low, high), place| {
                let each = |pick: fn(i32, i32) -> i32, bound: [i32; 3]| {
                    std::array::from_fn(|axis| pick(bound[axis], place.0[axis]))
                };
                (each(i32::min, low), each(i32::max, high))
            });
        let needed: HashSet<Place> = places.iter().copied().collect();
        let gone = self
            .blocks
            .farthest(missing, [Place(low), Place(high)], |place| needed.contains(&place))?;
        if gone.is_empty() {
            return Ok(0);
        }
        let lost = |place: &Place| self.blocks.get(*place).map_or(0, Block::observed);
        let forgotten = gone.iter().map(lost).sum();
        self.blocks.retain(|place| !gone.contains(&place));
        // As in `forget`: the slots have moved.
        self.changes.restart();
        Ok(forgotten)
    }

    /// Forget all voxels.
    pub fn clear(&mut self) {
        self.blocks = Blocks::new(self.parameters.max_voxels);
        self.changes = Changes::default();
    }
}
