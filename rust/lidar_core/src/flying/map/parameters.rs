//! Parameters of the voxel map.

use super::block_shape::VOLUME;
use super::layers::Neighbours;
use crate::Error;
use crate::error::{require, require_positive};
use crate::geometry::transform::minus;
use serde::{Deserialize, Serialize};

/// Length unit of the ray weight n_int (eq. 22), whose unit the paper does not state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RayUnit {
    /// Sum of lengths over the voxel edge.
    Edges,
    /// Sum of lengths in metres: the paper's text, literally.
    Metres,
    /// Sum of lengths over the voxel diagonal.
    Diagonals,
}

/// Rays of a scan that are cast.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Rays {
    /// All of them: exact.
    All,
    /// The first of those that end in the same voxel, with their number as its weight.
    OnePerEnd,
}

/// Voxels that rays pass without a look at them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Skip {
    /// None: every ray visits every voxel that it crosses.
    Nothing,
    /// Rays pass directions and distances in which all voxels hold `g_free` to the bit, or are
    /// permanent: no ray changes them. Values, states and files equal those of [`Skip::Nothing`] to
    /// the bit. Only a scan that [`Skip::Nothing`] rejects, because it touches too many voxels, may
    /// be accepted.
    Saturated,
}

/// Parameters of a voxel map; values of G have no unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    /// Voxels that rays pass. They affect only the time, so files do not store this.
    pub skip: Skip,
    /// A value that rays have pulled to within 64 steps of `f32` from `g_free` becomes `g_free`. Otherwise
    /// rounding holds it there for ever, a step short or, where few rays pass, dozens.
    pub settles: bool,
    /// Unit of the ray weight.
    pub ray_unit: RayUnit,
    /// Factor on the ray weight.
    pub ray_gain: f64,
    /// Corners of a fixed operating volume [m]; nothing outside is mapped.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// Budget of stored voxels.
    pub max_voxels: u64,
}

/// Table II; the unit of the ray weight is the voxel's edge.
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
    /// Table II; the unit of the ray weight is the metre, as in the paper's text.
    #[must_use]
    pub fn paper() -> Self {
        Self { ray_unit: RayUnit::Metres, settles: false, ..Self::default() }
    }
}

impl MapParameters {
    /// Parameters for coordinates relative to `origin` [m, world].
    #[must_use]
    pub fn relative_to(&self, origin: [f64; 3]) -> Self {
        let bounds = self.bounds.map(|corners| corners.map(|corner| minus(corner, origin)));
        Self { origin, bounds, ..self.clone() }
    }

    /// True if the operating volume holds a point of the map's frame.
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

/// When a group of occupied voxels is separate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Separation {
    /// Largest distance between the centres of neighbours in a group, d_sep [m].
    pub max_gap: f64,
    /// A group with fewer confidently occupied voxels is removed, n_conf,min.
    pub min_confident: usize,
    /// Observed voxels within `max_gap` of a removed one are pulled towards free too; those of a
    /// permanent one when its group has changed, not by every removal.
    pub dilate: bool,
}

/// Table II; d_sep is not in it and comes from the authors' code.
impl Default for Separation {
    fn default() -> Self {
        Self { max_gap: 0.8, min_confident: 24, dilate: false }
    }
}

impl Separation {
    /// Neighbours of a voxel in a group.
    pub(super) fn neighbours(&self, voxel_size: f64) -> Result<Neighbours, Error> {
        Neighbours::within(self.max_gap / voxel_size)
    }

    /// Check the gap for voxels of this size [m].
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
