//! Parameters of the voxel map, and of the removal of separate voxels.

use super::block_shape::VOLUME;
use super::layers::Neighbours;
use crate::Error;
use crate::error::{require, require_positive};
use crate::geometry::transform::minus;
use serde::{Deserialize, Serialize};

/// Unit of the ray length in the weight n_int (eq. 22). The paper does not state it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RayUnit {
    /// Voxel edges.
    Edges,
    /// Metres: the literal reading of the paper's text.
    Metres,
    /// Voxel diagonals.
    Diagonals,
}

/// Which rays of a scan are cast.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Rays {
    /// All rays (exact).
    All,
    /// Only the first of the rays that end in the same voxel, weighted with the number of these
    /// rays.
    OnePerEnd,
}

/// Which voxels rays skip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Skip {
    /// No voxels: every ray visits every voxel that it crosses.
    Nothing,
    /// Voxels in directions and at distances where all voxels are either exactly at `g_free` or
    /// permanent: no ray changes these. Values, states and files are equal to those of
    /// [`Skip::Nothing`], bit by bit. One exception: a scan that [`Skip::Nothing`] rejects, because
    /// it touches too many voxels, may be accepted.
    Saturated,
}

/// Parameters of a voxel map. Values of G have no unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapParameters {
    /// Edge of a voxel [m].
    pub voxel_size: f64,
    /// Origin of the map's frame in the world [m]. Coordinates given to the map are relative to it,
    /// so that `f32` suffices far from the world's origin. The map only stores it for the caller.
    pub origin: [f64; 3],
    /// Value of G towards which background points pull a voxel.
    pub g_occ: f32,
    /// Value of G towards which unknown points pull a voxel, and to which flying points set it.
    pub g_unk: f32,
    /// Value of G towards which rays pull a voxel.
    pub g_free: f32,
    /// Value of G of a voxel that was never observed.
    pub initial: f32,
    /// Smallest values of the states uncertain, tentatively occupied and confidently occupied (eq.
    /// 7).
    pub thresholds: [f32; 3],
    /// Additional thresholds that [`state`](super::voxel_map::VoxelMap::state) counts (eq. 6).
    pub extra_thresholds: Vec<f32>,
    /// Largest distance up to which rays clear voxels, d_max of eq. 20 [m].
    pub max_range: f64,
    /// Distance in front of its point at which a ray with a return ends [m].
    pub end_margin: f64,
    /// Which rays of a scan are cast.
    pub rays: Rays,
    /// Which voxels rays skip. This changes only the computing time, so files do not store it.
    pub skip: Skip,
    /// If true, a value that rays have pulled to within 64 steps of `f32` from `g_free` becomes
    /// `g_free`. Otherwise rounding would keep the value at one step from `g_free` for ever or,
    /// where few rays pass, at dozens of steps.
    pub settles: bool,
    /// Unit of the ray length in the ray weight.
    pub ray_unit: RayUnit,
    /// Factor of the ray weight.
    pub ray_gain: f64,
    /// Corners of the operating volume [m, frame of the map]. Nothing outside is mapped. None: no
    /// limits.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// Largest number of stored voxels.
    pub max_voxels: u64,
}

/// Values of Table II. The unit of the ray length is the voxel edge.
impl Default for MapParameters {
    fn default() -> Self {
        Self {
            voxel_size: 0.25,
            origin: [0.0; 3],
            g_occ: 0.0,
            g_unk: -740.0,
            g_free: -1000.0,
            initial: -740.0,
            thresholds: [-750.0, -300.0, -0.1],
            extra_thresholds: Vec::new(),
            max_range: 20.0,
            end_margin: 0.0,
            rays: Rays::All,
            skip: Skip::Saturated,
            settles: true,
            ray_unit: RayUnit::Edges,
            ray_gain: 1.0,
            bounds: None,
            max_voxels: 200_000_000,
        }
    }
}

impl MapParameters {
    /// Values of Table II. The unit of the ray length is the metre, as in the paper's text.
    #[must_use]
    pub fn paper() -> Self {
        Self { ray_unit: RayUnit::Metres, settles: false, ..Self::default() }
    }
}

impl MapParameters {
    /// The same parameters for a frame with its origin at `origin` [m, world].
    #[must_use]
    pub fn relative_to(&self, origin: [f64; 3]) -> Self {
        let bounds = self.bounds.map(|corners| corners.map(|corner| minus(corner, origin)));
        Self { origin, bounds, ..self.clone() }
    }

    /// True if a point [m, frame of the map] is inside the operating volume.
    pub(crate) fn holds(&self, point: [f64; 3]) -> bool {
        self.bounds.is_none_or(|[low, high]| {
            (0..3).all(|axis| (low[axis]..=high[axis]).contains(&point[axis]))
        })
    }

    /// Check the ranges of the parameters.
    ///
    /// # Errors
    /// [`Error::Parameter`] if a size is not positive or a bound is out of order.
    pub(super) fn check(&self) -> Result<(), Error> {
        let p = self;
        require_positive("max_range", p.max_range)?;
        require_positive("ray_gain", p.ray_gain)?;
        require(p.max_voxels >= VOLUME as u64, "max_voxels", ">= 512", p.max_voxels)?;
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
}

/// When a group of occupied voxels is separate, and what a removal does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Separation {
    /// Largest distance between the centres of neighbouring voxels in a group, d_sep [m].
    pub max_gap: f64,
    /// Number of confidently occupied voxels below which a group is removed, n_conf,min.
    pub min_confident: usize,
    /// If true, observed voxels within `max_gap` of a removed voxel are also pulled towards free.
    /// Around a permanent voxel this happens only after its group has changed, not at every
    /// removal.
    pub dilate: bool,
}

/// Values of Table II. d_sep is not in the table; it comes from the authors' code.
impl Default for Separation {
    fn default() -> Self {
        Self { max_gap: 0.8, min_confident: 24, dilate: false }
    }
}

impl Separation {
    /// Neighbourhood of a voxel in a group, for voxels of this size [m].
    pub(super) fn neighbours(&self, voxel_size: f64) -> Result<Neighbours, Error> {
        Neighbours::within(self.max_gap / voxel_size)
    }

    /// Check the parameters for voxels of this size [m].
    ///
    /// # Errors
    /// [`Error::Parameter`] if `max_gap` is not a distance of 0 to 64 voxels.
    pub(crate) fn check(&self, voxel_size: f64) -> Result<(), Error> {
        self.neighbours(voxel_size).map(drop)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::MapParameters;

    pub(crate) fn parameters() -> MapParameters {
        MapParameters { max_voxels: 1 << 20, ..MapParameters::default() }
    }
}
