//! Cubic lattice: point <-> voxel index.

use crate::Error;
use crate::error::{require, require_positive};

/// Index of a voxel along x, y, z.
pub type Voxel = [i32; 3];

/// Largest |index|: room for any search around a voxel, so that no neighbour's index overflows.
const MAX_INDEX: f64 = (i32::MAX - 4096) as f64;

/// A quotient this close to a whole number, relatively, may have been rounded across it.
const DOUBT: f64 = 4.0 * f64::EPSILON;

/// Cubes of edge `voxel_size` [m]; the corner of voxel (0, 0, 0) lies at `origin` [m].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    voxel_size: f64,
    origin: [f64; 3],
}

impl Lattice {
    /// # Errors
    /// [`Error::Parameter`] unless `voxel_size` is finite and > 0 and `origin` is finite.
    pub fn new(voxel_size: f64, origin: [f64; 3]) -> Result<Self, Error> {
        require_positive("voxel_size", voxel_size)?;
        require(
            origin.iter().all(|at| at.is_finite()),
            "origin",
            "finite",
            format_args!("{origin:?}"),
        )?;
        Ok(Self { voxel_size, origin })
    }

    /// Edge of a voxel [m].
    #[must_use]
    pub fn voxel_size(&self) -> f64 {
        self.voxel_size
    }

    /// Corner of voxel (0, 0, 0) [m].
    #[must_use]
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// `point` in units of voxels; voxel (i, j, k) spans i..i+1 and so on.
    #[must_use]
    #[inline(always)]
    pub fn scaled(&self, point: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| (point[axis] - self.origin[axis]) / self.voxel_size)
    }

    /// The voxel that holds `point`; a point on a face belongs to the voxel above it. Exact: the
    /// rounding of the division does not move a point across a face.
    ///
    /// # Errors
    /// [`Error::PointOutOfRange`] if a coordinate is not finite or beyond 2^31 voxels.
    #[inline(always)]
    pub fn voxel_at(&self, point: [f64; 3]) -> Result<Voxel, Error> {
        let scaled = self.scaled(point);
        let mut voxel = floor(scaled).ok_or(Error::PointOutOfRange { point })?;
        for axis in 0..3 {
            let face = scaled[axis].round();
            if (scaled[axis] - face).abs() <= DOUBT * face.abs() {
                let beyond = libm::fma(-face, self.voxel_size, point[axis] - self.origin[axis]);
                voxel[axis] = face as i32 - i32::from(beyond < 0.0); // in range, as its floor is
            }
        }
        Ok(voxel)
    }

    /// Centre of `voxel` [m].
    #[must_use]
    pub fn center(&self, voxel: Voxel) -> [f64; 3] {
        std::array::from_fn(|axis| {
            (f64::from(voxel[axis]) + 0.5) * self.voxel_size + self.origin[axis]
        })
    }
}

/// The voxel of a point given in units of voxels; None if it cannot be indexed.
#[must_use]
#[inline(always)]
pub fn floor(scaled: [f64; 3]) -> Option<Voxel> {
    let mut voxel = [0; 3];
    for axis in 0..3 {
        if !is_index(scaled[axis]) {
            return None;
        }
        voxel[axis] = scaled[axis].floor() as i32; // in range: checked above
    }
    Some(voxel)
}

/// Whether a coordinate in units of voxels can be indexed.
#[inline(always)]
fn is_index(scaled: f64) -> bool {
    scaled.floor().abs() < MAX_INDEX
}

/// Points of `f32` as `f64`.
#[must_use]
#[inline(always)]
pub fn wide([x, y, z]: [f32; 3]) -> [f64; 3] {
    [f64::from(x), f64::from(y), f64::from(z)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_on_a_face_belongs_to_the_voxel_above() -> Result<(), Error> {
        let lattice = Lattice::new(0.25, [0.0; 3])?;
        assert_eq!(lattice.voxel_at([0.25, -0.25, 0.0])?, [1, -1, 0]);
        assert_eq!(lattice.voxel_at([-1e-9, 0.24, 0.5])?, [-1, 0, 2]);
        assert_eq!(lattice.center([1, -1, 0]), [0.375, -0.125, 0.125]);
        Ok(())
    }

    #[test]
    fn what_cannot_be_indexed_is_refused() -> Result<(), Error> {
        for size in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-310] {
            assert!(Lattice::new(size, [0.0; 3]).is_err());
        }
        let lattice = Lattice::new(1e-9, [0.0; 3])?;
        for x in [f64::NAN, f64::INFINITY, 100.0, -100.0] {
            assert!(matches!(lattice.voxel_at([x, 0.0, 0.0]), Err(Error::PointOutOfRange { .. })));
        }
        Ok(())
    }
}
