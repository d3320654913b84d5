//! Occupancy map without fixed bounds: exponential filter G(v) with several states.
//!
//! Source: Vrba et al., sec. III-A, eqs 6-12; permanent voxels: sec. III-E.

use super::blocks::{Block, Blocks, Cursor, Place, offset_of};
use super::filter::{Levels, filtered, two_to_minus};
use super::layers::Layer;
use super::separate::Changes;
use crate::Error;
use crate::error::{require, require_positive};
use crate::flying::integrate::block_update::Task;
use crate::flying::integrate::casting::Casting;
use crate::geometry::lattice::{Lattice, Voxel, wide};
use crate::geometry::transform::minus;
use crate::util::threads;
use rayon::ThreadPool;

/// Length unit of the ray weight n_int (eq. 22), whose unit the paper does not state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RayUnit {
    /// Sum of lengths over the voxel edge.
    Edges,
    /// Sum of lengths in metres: the paper's text, literally.
    Metres,
    /// Sum of lengths over the voxel diagonal.
    Diagonals,
}

/// Rays of a scan that are cast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rays {
    /// All of them: exact.
    All,
    /// The first of those that end in the same voxel, with their number as its weight.
    OnePerEnd,
}

/// Parameters of [`VoxelMap`]; values of G have no unit.
#[derive(Clone, Debug, PartialEq)]
pub struct MapParameters {
    /// Edge of a voxel [m].
    pub voxel_size: f64,
    /// World coordinates of the point that all coordinates given to the map are relative to [m]:
    /// kept and saved for the caller, so that `f32` suffices far from the world's origin.
    pub origin: [f64; 3],
    /// G that background points pull a voxel to.
    pub g_occ: f32,
    /// G that unknown and flying points pull a voxel to.
    pub g_unk: f32,
    /// G that rays pull a voxel to.
    pub g_free: f32,
    /// G of a voxel that has never been observed.
    pub initial: f32,
    /// Lower bounds of the states uncertain, tentative and confidently occupied (eq. 7).
    pub thresholds: [f32; 3],
    /// Further bounds that `state` counts (eq. 6).
    pub extra_thresholds: Vec<f32>,
    /// Rays clear no further than this, d_max of eq. 20 [m].
    pub max_range: f64,
    /// Rays that hit something end this much earlier [m].
    pub end_margin: f64,
    /// Rays that are cast.
    pub rays: Rays,
    /// Unit of the ray weight.
    pub ray_unit: RayUnit,
    /// Factor on the ray weight.
    pub ray_gain: f64,
    /// Corners of a fixed operating volume [m]; nothing outside is mapped.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// Budget of stored voxels.
    pub max_voxels: u64,
}

impl MapParameters {
    /// Parameters for coordinates relative to `origin` [m, world].
    #[must_use]
    pub fn relative_to(&self, origin: [f64; 3]) -> Self {
        let bounds = self.bounds.map(|corners| corners.map(|corner| minus(corner, origin)));
        Self { origin, bounds, ..self.clone() }
    }
}

/// The map: values of G(v), four states by default.
pub struct VoxelMap {
    parameters: MapParameters,
    lattice: Lattice,
    pub(crate) limits: Option<[Voxel; 2]>,
    pub(crate) blocks: Blocks,
    pub(crate) changes: Changes,
    pub(crate) casting: Casting,
    pub(crate) tasks: Vec<Task>,
    pub(crate) pool: Option<ThreadPool>,
}

impl VoxelMap {
    /// An empty map that works with `threads` threads.
    ///
    /// # Errors
    /// [`Error::Parameter`] if a size is not positive or a bound is out of order.
    pub fn new(parameters: MapParameters, threads: usize) -> Result<Self, Error> {
        // Coordinates are relative to `origin` already.
        let lattice = Lattice::new(parameters.voxel_size, [0.0; 3])?;
        check(&parameters)?;
        let limits = match parameters.bounds {
            Some([low, high]) => Some([lattice.voxel_at(low)?, lattice.voxel_at(high)?]),
            None => None,
        };
        let pool = threads::pool(threads)?;
        Ok(Self {
            lattice,
            limits,
            blocks: Blocks::new(parameters.max_voxels),
            changes: Changes::default(),
            casting: Casting::new(threads),
            tasks: Vec::new(),
            pool: (threads > 1).then_some(pool),
            parameters,
        })
    }

    /// The parameters it was made with.
    #[must_use]
    pub fn parameters(&self) -> &MapParameters {
        &self.parameters
    }

    /// Point <-> voxel.
    #[must_use]
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Threads it works with.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.pool.as_ref().map_or(1, ThreadPool::current_num_threads)
    }

    /// Voxels of all blocks, which the budget counts; rows of them that nothing has met take no
    /// memory.
    #[must_use]
    pub fn stored_voxels(&self) -> usize {
        self.blocks.len() * super::blocks::VOLUME
    }

    /// Bytes held by the stored voxels and their index.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        let index = size_of::<(Place, u32)>() + 2 * size_of::<usize>();
        self.blocks.iter().map(|block| block.bytes() + index).sum()
    }

    /// Number of voxels that a point or a ray has met.
    #[must_use]
    pub fn observed_voxels(&self) -> usize {
        let observed = |block: &Block| block.values().filter(|value| !value.is_nan()).count();
        self.blocks.iter().map(observed).sum()
    }

    /// G(v) at every point; the initial value where nothing has been observed or can be.
    #[must_use]
    pub fn values_at(&self, points: &[[f32; 3]]) -> Vec<f32> {
        let mut cursor = Cursor::new(&self.blocks);
        let value = |&point: &[f32; 3]| match self.lattice.voxel_at(wide(point)) {
            Ok(voxel) => self.known(cursor.stored(voxel)),
            Err(_) => self.parameters.initial,
        };
        points.iter().map(value).collect()
    }

    /// State at every point: the number of thresholds at or below G(v) (eqs 6-7), so by default
    /// 0 free, 1 uncertain, 2 tentatively occupied, 3 confidently occupied.
    #[must_use]
    pub fn states_at(&self, points: &[[f32; 3]]) -> Vec<u8> {
        self.values_at(points).into_iter().map(|value| self.state(value)).collect()
    }

    /// State of a value.
    #[must_use]
    pub fn state(&self, value: f32) -> u8 {
        let p = &self.parameters;
        p.thresholds.iter().chain(&p.extra_thresholds).filter(|&&bound| value >= bound).count()
            as u8
    }

    /// A stored value, or the initial one where nothing has been observed.
    #[inline]
    pub(crate) fn known(&self, stored: f32) -> f32 {
        if stored.is_nan() { self.parameters.initial } else { stored }
    }

    /// Lower bound of the uncertain state: everything below is free.
    pub(crate) fn uncertain_from(&self) -> f32 {
        self.parameters.thresholds[0]
    }

    /// Lower bound of the tentative state.
    pub(crate) fn tentative_from(&self) -> f32 {
        self.parameters.thresholds[1]
    }

    /// Lower bound of the confident state.
    pub(crate) fn confident_from(&self) -> f32 {
        self.parameters.thresholds[2]
    }

    /// True if the operating volume holds `voxel`.
    #[inline]
    pub(crate) fn admits(&self, voxel: Voxel) -> bool {
        self.limits.is_none_or(|[low, high]| {
            (0..3).all(|axis| (low[axis]..=high[axis]).contains(&voxel[axis]))
        })
    }

    /// Make the voxels of `points` occupied for good (G = +infinity, sec. III-E).
    ///
    /// # Errors
    /// As [`VoxelMap::set_free`].
    pub fn set_occupied(&mut self, points: &[[f32; 3]]) -> Result<(), Error> {
        self.set_all(points, f32::INFINITY)
    }

    /// Make the voxels of `points` free for good (G = -infinity, sec. III-E).
    ///
    /// # Errors
    /// [`Error::PointOutOfRange`] or [`Error::Limit`]; the map is unchanged then.
    pub fn set_free(&mut self, points: &[[f32; 3]]) -> Result<(), Error> {
        self.set_all(points, f32::NEG_INFINITY)
    }

    /// Move every voxel of `points` by `weight` updates towards `target` (eq. 12).
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

    /// Replace the value of a voxel whose block exists, and note a change of its state.
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

    /// Forget what lies further than `distance` [m] from `center` (per axis, whole blocks).
    pub fn forget(&mut self, center: [f64; 3], distance: f64) {
        let lattice = self.lattice;
        // No voxel of a block is more than 8 edges from any other: what lies within `distance` stays.
        let reach = distance + 8.0 * lattice.voxel_size();
        let before = self.blocks.len();
        self.blocks.retain(|place| {
            let middle = lattice.center(place.voxel(super::blocks::VOLUME / 2));
            (0..3).all(|axis| (middle[axis] - center[axis]).abs() <= reach)
        });
        // Marks are kept by slot, and dropped blocks have moved the slots.
        if self.blocks.len() != before {
            self.changes.restart();
        }
    }

    /// Forget everything.
    pub fn clear(&mut self) {
        self.blocks = Blocks::new(self.parameters.max_voxels);
        self.changes = Changes::default();
    }
}

fn check(p: &MapParameters) -> Result<(), Error> {
    require_positive("max_range", p.max_range)?;
    require_positive("ray_gain", p.ray_gain)?;
    let margin = p.end_margin;
    require(margin.is_finite() && margin >= 0.0, "end_margin", "finite and >= 0", margin)?;
    require(
        // False if one is NaN.
        p.thresholds.is_sorted(),
        "thresholds",
        "uncertain <= tentative <= confident",
        format!("{:?}", p.thresholds),
    )?;
    let levels = [p.g_occ, p.g_unk, p.g_free, p.initial];
    require(
        levels.iter().all(|g| g.is_finite()),
        "g_occ, g_unk, g_free, initial",
        "finite",
        format!("{levels:?}"),
    )?;
    require(
        p.bounds.is_none_or(|[low, high]| (0..3).all(|axis| low[axis] < high[axis])),
        "bounds",
        "a lower corner, then an upper corner",
        format!("{:?}", p.bounds),
    )
}
