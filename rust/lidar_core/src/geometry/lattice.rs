//! Cubic lattice: conversion between points and voxel indices.

use crate::Error;
use crate::error::{require, require_positive};

/// Index of a voxel along x, y, z.
pub type Voxel = [i32; 3];

/// Largest absolute index. It leaves room for any search around a voxel, so that no neighbour's
/// index overflows.
const MAX_INDEX: f64 = (i32::MAX - 4096) as f64;

/// Largest edge of a voxel [m].
const LARGEST: f64 = 1e100;

/// Relative distance from a whole number within which rounding may have moved a quotient across the
/// number.
const DOUBT: f64 = 4.0 * f64::EPSILON;

/// A lattice of cubes with edge `voxel_size` [m]. The lowest corner of voxel (0, 0, 0) is at
/// `origin` [m].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    voxel_size: f64,
    origin: [f64; 3],
    /// 1 / `voxel_size` if multiplying by it gives exactly the result of the division: for powers
    /// of two. Otherwise None.
    exact_inverse: Option<f64>,
}

impl Lattice {
    /// Make a lattice of voxels with this edge [m]; `origin` [m] is the lowest corner of
    /// voxel (0, 0, 0).
    ///
    /// # Errors
    /// [`Error::Parameter`] unless `voxel_size` is > 0 and at most 1e100, so that distances stay
    /// finite, and `origin` is finite.
    pub fn new(voxel_size: f64, origin: [f64; 3]) -> Result<Self, Error> {
        require_positive("voxel_size", voxel_size)?;
        require(voxel_size <= LARGEST, "voxel_size", "at most 1e100 m", voxel_size)?;
        require(
            origin.iter().all(|at| at.is_finite()),
            "origin",
            "finite",
            format_args!("{origin:?}"),
        )?;
        let inverse = 1.0 / voxel_size;
        let is_exact = is_power_of_two(voxel_size) && is_power_of_two(inverse);
        Ok(Self { voxel_size, origin, exact_inverse: is_exact.then_some(inverse) })
    }

    /// Edge of a voxel [m].
    #[must_use]
    pub fn voxel_size(&self) -> f64 {
        self.voxel_size
    }

    /// Lowest corner of voxel (0, 0, 0) [m].
    #[must_use]
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// `point` [m] in units of voxels, relative to the origin. Voxel (i, j, k) extends from (i, j,
    /// k) to (i+1, j+1, k+1).
    #[must_use]
    #[inline(always)]
    pub fn scaled(&self, point: [f64; 3]) -> [f64; 3] {
        let from_origin = |axis: usize| point[axis] - self.origin[axis];
        // As in `scale`: the same bits with or without the inverse.
        match self.exact_inverse {
            Some(inverse) => std::array::from_fn(|axis| from_origin(axis) * inverse),
            None => std::array::from_fn(|axis| from_origin(axis) / self.voxel_size),
        }
    }

    /// Convert coordinates along `axis` [m] to units of voxels in place, like [`Self::scaled`].
    #[inline(always)]
    pub(crate) fn scale(&self, axis: usize, values: &mut [f64]) {
        let origin = self.origin[axis];
        if let Some(inverse) = self.exact_inverse {
            // The same bits as the division below, without its cost.
            values.iter_mut().for_each(|value| *value = (*value - origin) * inverse);
        } else {
            values.iter_mut().for_each(|value| *value = (*value - origin) / self.voxel_size);
        }
    }

    /// The voxel that contains `point` [m]. A point on a face belongs to the voxel above it. The
    /// result is exact: rounding in the division does not move a point across a face.
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
                // Rounded once, so the sign is that of the exact difference: on which side of the face it lies.
                let beyond = libm::fma(-face, self.voxel_size, point[axis] - self.origin[axis]);
                voxel[axis] = face as i32 - i32::from(beyond < 0.0); // in range, as its floor is
            }
        }
        Ok(voxel)
    }

    /// Voxels of many points, by axis, and a measure of certainty for each. If this is not
    /// positive, the voxel may be wrong, and [`Self::voxel_at`] must be called for the point.
    #[inline(always)]
    pub(crate) fn voxels_at<const N: usize>(
        &self,
        points: &[[f64; N]; 3],
    ) -> ([[i32; N]; 3], [f64; N]) {
        let (mut voxels, mut sure) = ([[0; N]; 3], [1.0; N]);
        for axis in 0..3 {
            let mut scaled = points[axis];
            self.scale(axis, &mut scaled);
            for lane in 0..N {
                let face = scaled[lane].round_ties_even();
                let away = (scaled[lane] - face).abs() - DOUBT * face.abs();
                let away = if is_index(scaled[lane]) { away } else { 0.0 };
                sure[lane] = if away < sure[lane] { away } else { sure[lane] };
                voxels[axis][lane] = whole(scaled[lane].floor()).cast_signed();
            }
        }
        (voxels, sure)
    }

    /// Centre of `voxel` [m].
    #[must_use]
    pub fn center(&self, voxel: Voxel) -> [f64; 3] {
        std::array::from_fn(|axis| {
            (f64::from(voxel[axis]) + 0.5) * self.voxel_size + self.origin[axis]
        })
    }
}

/// True for a normal floating-point number without fraction bits: plus or minus a power of two.
fn is_power_of_two(value: f64) -> bool {
    value.is_normal() && value.to_bits().trailing_zeros() >= f64::MANTISSA_DIGITS - 1
}

/// The voxel of a point that is given in units of voxels. None if the point is not finite or too
/// far away.
#[must_use]
#[inline(always)]
pub fn floor(scaled: [f64; 3]) -> Option<Voxel> {
    let mut voxel = [0; 3];
    for axis in 0..3 {
        if !is_index(scaled[axis]) {
            return None;
        }
        // `f64::floor` is a call where the CPU's basic instructions cannot round. The cast rounds towards zero.
        let whole = scaled[axis] as i32; // in range: checked above
        voxel[axis] = whole - i32::from(f64::from(whole) > scaled[axis]);
    }
    Some(voxel)
}

/// Low 32 bits of a whole number, with or without sign, converted as on the vector unit: an
/// addition moves them to the lowest bits.
#[inline(always)]
pub(crate) fn whole(value: f64) -> u32 {
    const TO_LOWEST_BITS: f64 = 1.5 * (1u64 << 52) as f64;
    // Between 2^52 and 2^53 the last bit of a number is worth 1. The half keeps sums with negative
    // numbers there, and their lowest bits are two's complement.
    (value + TO_LOWEST_BITS).to_bits() as u32
}

/// The smaller number. `b` if one is NaN, like the instruction of the vector unit.
#[inline(always)]
pub(crate) fn least(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// True if a coordinate in units of voxels has a valid voxel index.
#[inline(always)]
fn is_index(scaled: f64) -> bool {
    (1.0 - MAX_INDEX..MAX_INDEX).contains(&scaled)
}

/// A point with coordinates of `f32`, as `f64`.
#[must_use]
#[inline(always)]
pub fn wide([x, y, z]: [f32; 3]) -> [f64; 3] {
    [f64::from(x), f64::from(y), f64::from(z)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_points_have_the_voxels_that_they_have_alone() -> Result<(), Error> {
        const N: usize = 8;
        for voxel_size in [0.25, 2.0, 0.1, 0.3, 1.0 / 3.0, f64::MIN_POSITIVE] {
            let lattice = Lattice::new(voxel_size, [0.1, 0.0, -7.3])?;
            let mut n_sure = 0;
            for step in -2000..2000 {
                let at = |lane: usize| f64::from(step) * 0.05 + lane as f64 * 1e-17;
                let odd = if step % 500 == 0 { f64::NAN } else { f64::from(step) * 0.317 };
                let points = [std::array::from_fn(at), [0.7 * at(0); N], [odd; N]];
                let (voxels, sure) = lattice.voxels_at(&points);
                for lane in (0..N).filter(|&lane| sure[lane] > 0.0) {
                    let voxel = lattice.voxel_at(points.map(|axis| axis[lane]))?;
                    assert_eq!(voxels.map(|axis| axis[lane]), voxel);
                    n_sure += 1;
                }
            }
            assert!(voxel_size < 0.1 || n_sure > 10_000, "{voxel_size}: {n_sure}");
        }
        Ok(())
    }

    #[test]
    fn numbers_are_scaled_alike_one_by_one_and_together() -> Result<(), Error> {
        for voxel_size in [0.25, 0.1, 4.0, f64::MIN_POSITIVE, 1e100] {
            let lattice = Lattice::new(voxel_size, [0.3; 3])?;
            let points = [1.7, -2e9, 0.3, 5e-324, f64::MAX, f64::NEG_INFINITY];
            let mut together = points;
            lattice.scale(1, &mut together);
            assert_eq!(together, points.map(|value| lattice.scaled([value; 3])[1]), "{voxel_size}");
        }
        Ok(())
    }

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
        for size in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-310, 1e101] {
            assert!(Lattice::new(size, [0.0; 3]).is_err());
        }
        let lattice = Lattice::new(1e-9, [0.0; 3])?;
        for x in [f64::NAN, f64::INFINITY, 100.0, -100.0] {
            assert!(matches!(lattice.voxel_at([x, 0.0, 0.0]), Err(Error::PointOutOfRange { .. })));
        }
        Ok(())
    }
}
