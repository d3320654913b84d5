//! What the marks of a scan do to the values of a block.
//!
//! Source: Vrba et al., eqs 9 and 12.

use super::blocks::{Bits, Block, EDGE, Place, VOLUME, assign};
use super::filter::{Levels, filtered, two_to_minus};
use super::marks::{Content, MAX_COUNT, Mark, POINT_UNITS, UNITS_PER_EDGE, tag_and_count};
use super::voxel_map::{RayUnit, VoxelMap};
use crate::geometry::lattice::Voxel;
use pulp::{Arch, Simd, WithSimd};

/// Voxels that are updated at a time: those of a row of x.
const ROW: usize = EDGE as usize;

/// What a mark does to a value.
pub(super) struct Rule {
    levels: Levels,
    initial: f32,
    g: [f32; 3],
    per_unit: f64,
    /// Weight of one of the units in which points are counted.
    per_point: f64,
    /// First and last voxel of the operating volume.
    limits: Option<[Voxel; 2]>,
}

/// What was done to a block.
pub(super) struct BlockUpdate {
    /// Number of voxels that were updated.
    pub(super) voxels: usize,
    /// Those whose groups have to be looked at.
    pub(super) changed: Bits,
}

impl Rule {
    pub(super) fn of(map: &VoxelMap, weighted: bool) -> Self {
        let p = map.parameters();
        let unit = match p.ray_unit {
            RayUnit::Edges => 1.0,
            RayUnit::Metres => p.voxel_size,
            RayUnit::Diagonals => 1.0 / 3f64.sqrt(),
        };
        Self {
            levels: map.levels(),
            initial: p.initial,
            g: [p.g_free, p.g_unk, p.g_occ],
            per_unit: p.ray_gain * unit / UNITS_PER_EDGE,
            per_point: if weighted { 1.0 / f64::from(POINT_UNITS) } else { 1.0 },
            limits: map.limits,
        }
    }

    /// Update a block, on the vector unit of the machine.
    pub(super) fn apply(&self, block: &mut Block, marks: &[Mark; VOLUME]) -> BlockUpdate {
        Arch::new().dispatch(Apply { rule: self, block, marks })
    }

    /// Marks of a row from the voxel `first` on, without those outside the operating volume.
    #[inline(always)]
    fn admitted(&self, place: Place, first: usize, marks: &[Mark; ROW]) -> [Mark; ROW] {
        let Some([low, high]) = self.limits else { return *marks };
        std::array::from_fn(|at| {
            let voxel = place.voxel(first + at);
            let inside = (0..3).all(|axis| (low[axis]..=high[axis]).contains(&voxel[axis]));
            if inside { marks[at] } else { 0 }
        })
    }

    /// Without branches, for many voxels at a time.
    #[inline(always)]
    fn updated(&self, stored: f32, mark: Mark) -> f32 {
        let (tag, count) = tag_and_count(mark);
        let of_rays = tag == Content::Rays as u32;
        let keep =
            two_to_minus(f64::from(count) * if of_rays { self.per_unit } else { self.per_point });
        let keep = if tag == Content::Flying as u32 { 0.0 } else { keep }; // n_det is infinite (eq. 17)
        let seen = if tag == Content::Background as u32 { self.g[2] } else { self.g[1] };
        let target = if of_rays { self.g[0] } else { seen };
        let value = filtered(if stored.is_nan() { self.initial } else { stored }, target, keep);
        if mark == 0 { stored } else { value }
    }
}

struct Apply<'a> {
    rule: &'a Rule,
    block: &'a mut Block,
    marks: &'a [Mark; VOLUME],
}

impl WithSimd for Apply<'_> {
    type Output = BlockUpdate;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> BlockUpdate {
        let Self { rule, block, marks } = self;
        let mut update = BlockUpdate { voxels: 0, changed: [0; 8] };
        let rows = marks.as_chunks::<ROW>().0;
        let is_met = |marks: &[Mark; ROW]| marks.iter().fold(0, |all, mark| all | mark) != 0;
        let met = rows.iter().rev().fold(0, |met, marks| met << 1 | u64::from(is_met(marks)));
        block.hold(met);
        for (row, marks) in rows.iter().enumerate().filter(|(row, _)| met >> row & 1 == 1) {
            let marks = rule.admitted(block.place, row * ROW, marks);
            update_row(rule, block, row, &marks, &mut update);
        }
        update
    }
}

#[inline(always)]
fn update_row(
    rule: &Rule,
    block: &mut Block,
    row: usize,
    marks: &[Mark; ROW],
    update: &mut BlockUpdate,
) {
    let Some(stored) = block.row_mut(row) else { return };
    update.voxels += marks.iter().filter(|&&mark| mark != 0).count();
    let holds_points = marks.iter().fold(0, |all, mark| all | mark) > MAX_COUNT;
    let is_free = stored.iter().fold(true, |all, &value| all & (value == rule.g[0]));
    if is_free && !holds_points {
        return; // pulled to where it is: most of the air, after a few scans
    }
    let mut values = [0.0; ROW];
    for (at, value) in values.iter_mut().enumerate() {
        *value = rule.updated(stored[at], marks[at]);
    }
    let crosses = |at: usize| rule.levels.crosses(stored[at], values[at]);
    if !(0..ROW).fold(false, |any, at| any | crosses(at)) {
        *stored = values;
        return;
    }
    for (at, &value) in values.iter().enumerate() {
        if rule.levels.store(block, row * ROW + at, value) {
            assign(&mut update.changed, row * ROW + at, true);
        }
    }
}
