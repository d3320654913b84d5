//! Update of the values of one block by the marks of a scan.
//!
//! Source: Vrba et al., eqs 9 and 12.

use super::accumulate::dense_blocks::{MarkRow, rows_of};
use super::accumulate::mark::{
    Content, MAX_COUNT, Mark, POINT_UNITS, UNITS_PER_EDGE, tag_and_count,
};
use crate::flying::map::block_shape::{Bits, EDGE, Row, VOLUME, assign};
use crate::flying::map::blocks::{Block, Place};
use crate::flying::map::filter::{Levels, filtered, two_to_minus};
use crate::flying::map::parameters::RayUnit;
use crate::flying::map::voxel_map::VoxelMap;
use crate::geometry::lattice::Voxel;
use crate::util::vector_unit::dispatch;
use pulp::{Simd, WithSimd};

/// Number of voxels that are updated at a time: one row along x.
const ROW: usize = EDGE as usize;

/// Update rule: new value of a voxel from its old value and its mark.
#[derive(Clone, Copy)]
pub(crate) struct Rule {
    levels: Levels,
    initial: f32,
    g: [f32; 3],
    /// Values within this distance of `g_free` become `g_free` when rays pull them. Below 0: never.
    settled: f32,
    per_unit: f64,
    /// Weight of one unit in which points are counted.
    per_point: f64,
    /// First and last voxel of the operating volume. None: it has no limits.
    limits: Option<[Voxel; 2]>,
}

impl Rule {
    pub(crate) fn of(map: &VoxelMap, weighted: bool) -> Self {
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
            settled: if p.settles { settled_within(p.g_free) } else { -1.0 },
            // One factor for gain, unit and fixed point: one multiplication per voxel.
            per_unit: p.ray_gain * unit / UNITS_PER_EDGE,
            per_point: if weighted { 1.0 / f64::from(POINT_UNITS) } else { 1.0 },
            limits: map.limits,
        }
    }

    /// Number of voxels of `block` with marks inside the operating volume. `met`: a bit for each
    /// row with marks.
    pub(crate) fn count(&self, block: &Block, marks: &[Mark; VOLUME], met: u64) -> usize {
        dispatch(Count { rule: self, place: block.place, marks, met })
    }

    /// Update the rows `met` of a block on the vector unit of the machine. Returns the voxels whose
    /// state has changed, so that their groups must be updated, and the number of voxels with a
    /// changed value.
    pub(crate) fn apply(&self, block: &mut Block, marks: &[Mark; VOLUME], met: u64) -> (Bits, u32) {
        dispatch(Apply { rule: self, block, marks, met })
    }

    /// Marks of a row whose first voxel is `first`, with those outside the operating volume set to
    /// 0.
    #[inline(always)]
    fn admitted(&self, place: Place, first: usize, marks: &[Mark; ROW]) -> [Mark; ROW] {
        let Some([low, high]) = self.limits else { return *marks };
        std::array::from_fn(|at| {
            let voxel = place.voxel(first + at);
            let inside = (0..3).all(|axis| (low[axis]..=high[axis]).contains(&voxel[axis]));
            if inside { marks[at] } else { 0 }
        })
    }

    /// New values of a row, computed for all its voxels at a time.
    #[inline(always)]
    fn updated(&self, stored: &Row, marks: &MarkRow) -> Row {
        // A class is a bit above `MAX_COUNT`: one OR finds any. Most rows hold rays only.
        let holds_points = marks.iter().fold(0, |all, mark| all | mark) > MAX_COUNT;
        let mut values = *stored;
        for (value, &mark) in values.iter_mut().zip(marks) {
            *value =
                if holds_points { self.marked(*value, mark) } else { self.cleared(*value, mark) };
        }
        values
    }

    /// New value of a voxel in a row without points: only rays can have changed it.
    #[inline(always)]
    fn cleared(&self, stored: f32, mark: Mark) -> f32 {
        // Computed for every voxel and selected at the end: a branch would split the vector loop.
        let keep = two_to_minus(f64::from(mark & MAX_COUNT) * self.per_unit);
        let value = self.settled(filtered(self.known(stored), self.g[0], keep));
        if mark == 0 { stored } else { value }
    }

    #[inline(always)]
    fn marked(&self, stored: f32, mark: Mark) -> f32 {
        let (tag, count) = tag_and_count(mark);
        let of_rays = tag == Content::Rays as u32;
        let [free, unknown, occupied] = self.g;
        let per_unit = if of_rays { self.per_unit } else { self.per_point };
        let keep = two_to_minus(f64::from(count) * per_unit);
        let keep = if tag == Content::Flying as u32 { 0.0 } else { keep }; // n_det is infinite (eq. 17)
        let seen = if tag == Content::Background as u32 { occupied } else { unknown };
        let value = filtered(self.known(stored), if of_rays { free } else { seen }, keep);
        let value = if of_rays { self.settled(value) } else { value };
        if mark == 0 { stored } else { value }
    }

    /// The value after a pull by rays: `g_free` if it is close enough.
    #[inline(always)]
    fn settled(&self, value: f32) -> f32 {
        if (value - self.g[0]).abs() <= self.settled { self.g[0] } else { value }
    }

    #[inline(always)]
    fn known(&self, stored: f32) -> f32 {
        if stored.is_nan() { self.initial } else { stored }
    }
}

/// Distance from `g_free` within which values become `g_free`: 64 steps of floating-point numbers
/// there.
fn settled_within(g_free: f32) -> f32 {
    const STEPS: f32 = 64.0;
    STEPS * (g_free.abs().next_up() - g_free.abs())
}

struct Count<'a> {
    rule: &'a Rule,
    place: Place,
    marks: &'a [Mark; VOLUME],
    met: u64,
}

impl WithSimd for Count<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        let rows = self.marks.as_chunks().0;
        // A counter per lane, so that no sum runs across lanes inside the loop; each counts 64 rows at most.
        let mut counts = [0u32; ROW];
        for row in rows_of(self.met) {
            let marks = self.rule.admitted(self.place, row * ROW, &rows[row]);
            for (count, mark) in counts.iter_mut().zip(marks) {
                *count = count.wrapping_add(u32::from(mark != 0));
            }
        }
        counts.into_iter().sum::<u32>() as usize
    }
}

struct Apply<'a> {
    rule: &'a Rule,
    block: &'a mut Block,
    marks: &'a [Mark; VOLUME],
    /// A bit for every row with marks.
    met: u64,
}

impl WithSimd for Apply<'_> {
    type Output = (Bits, u32);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> (Bits, u32) {
        let Self { rule, block, marks, met } = self;
        let rule = *rule; // a local copy stays in registers: no store of the loop can change it
        let (mut changed, mut n_changed) = ([0; EDGE as usize], 0);
        let rows = marks.as_chunks().0;
        for row in rows_of(met) {
            let marks = rule.admitted(block.place, row * ROW, &rows[row]);
            n_changed += update_row(&rule, block, row, &marks, &mut changed);
        }
        (changed, n_changed)
    }
}

/// Update a row. Returns the number of its voxels whose value has changed.
#[inline(always)]
fn update_row(
    rule: &Rule,
    block: &mut Block,
    row: usize,
    marks: &MarkRow,
    changed: &mut Bits,
) -> u32 {
    if block.inert.holds(row) && marks.iter().fold(0, |all, mark| all | mark) <= MAX_COUNT {
        return 0; // most of the air, after a few scans
    }
    let Some(&stored) = block.row(row) else { return 0 };
    let stays =
        |(&value, &mark): (&f32, &Mark)| (mark <= MAX_COUNT) & (value == rule.g[0]) | (mark == 0);
    if stored.iter().zip(marks).fold(true, |all, voxel| all & stays(voxel)) {
        block.inert.note(row, &stored, rule.g[0]);
        return 0; // pulled to where it is
    }
    let values = rule.updated(&stored, marks);
    let crosses = |at: usize| rule.levels.crosses(stored[at], values[at]);
    // No bound is crossed: the bits of the block stay, and the row is stored as a whole.
    if !(0..ROW).fold(false, |any, at| any | crosses(at)) {
        block.set_row(row, &values);
    } else {
        for (at, &value) in values.iter().enumerate() {
            if rule.levels.store(block, row * ROW + at, value) {
                assign(changed, row * ROW + at, true);
            }
        }
    }
    block.inert.note(row, &values, rule.g[0]);
    let differs = |at: usize| u32::from(stored[at].to_bits() != values[at].to_bits());
    (0..ROW).fold(0, |count, at| count + differs(at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::flying::integrate::integrator::Integrator;
    use crate::flying::integrate::integrator::tests::scan;
    use crate::flying::map::parameters::MapParameters;
    use crate::flying::map::parameters::tests::parameters;
    use crate::flying::point_class::PointClass;

    #[test]
    fn values_settle_within_64_steps_and_no_further_away() -> Result<(), Error> {
        for (settles, expected) in [(true, true), (false, false)] {
            let rule = Rule::of(&VoxelMap::new(MapParameters { settles, ..parameters() })?, false);
            let steps = |count: u32| f32::from_bits((-1000f32).to_bits() - count);
            assert_eq!(rule.settled(steps(64)) == -1000.0, expected);
            assert_eq!(rule.settled(steps(1)) == -1000.0, expected);
            assert_eq!(rule.settled(steps(65)).to_bits(), steps(65).to_bits());
            assert_eq!(rule.settled(-1000.0).to_bits(), (-1000f32).to_bits());
            assert!(rule.settled(f32::NAN).is_nan());
            assert_eq!(rule.settled(f32::INFINITY), f32::INFINITY);
        }
        Ok(())
    }

    #[test]
    fn weak_rays_saturate_only_where_values_settle() -> Result<(), Error> {
        for settles in [true, false] {
            let mut map = VoxelMap::new(MapParameters { settles, ray_gain: 0.1, ..parameters() })?;
            let mut integrator = Integrator::new(1)?;
            for _ in 0..400 {
                integrator
                    .integrate(&mut map, &scan(&[[1.1, 0.1, 0.1]], &[PointClass::Background]))?;
            }
            let value = map.values_at(&[[0.6, 0.1, 0.1]])[0];
            assert_eq!(value == -1000.0, settles, "{value}");
            assert!(value < -999.99);
            // A point is not drawn to `g_free`, however near its value is to it.
            assert!(map.values_at(&[[1.1, 0.1, 0.1]])[0] > -1e-3);
        }
        Ok(())
    }
}
