//! Bundles of rays that are walked side by side: walls, lengths and places of the rays.
//!
//! Every ray is mirrored so that it runs upwards along all axes.

use super::accumulate::mark::UNITS_PER_EDGE;
use super::accumulate::window::Window;
use super::ray_segments::{LANES, Lanes, Numbers, Ray, RaySegments, places};
use crate::geometry::lattice::{least, whole};

/// Largest length of a ray, in sub-units.
const FURTHEST: f64 = (i32::MAX - 1) as f64;
/// Position of the next wall on an axis along which the ray crosses none: behind every end.
const NEVER: u32 = i32::MAX.cast_unsigned();

/// Rays, or stretches of rays, that are walked together. Positions along a ray are whole numbers of
/// sub-units. A unit (1/16384 of a voxel edge) has 2^`shift` sub-units.
pub(super) struct Bundle {
    /// Position of the next wall along every axis.
    pub(super) wall: [Lanes; 3],
    /// Distance from one wall to the next along every axis.
    pub(super) pace: [Lanes; 3],
    /// Number of walls that the whole ray crosses along every axis.
    pub(super) walls: [Lanes; 3],
    /// Position of the end along the ray.
    pub(super) end: Lanes,
    pub(super) shift: Lanes,
    /// Position along the ray at which it entered its voxel, in units.
    pub(super) entered: Lanes,
    /// Place of the present voxel in the window, mirrored.
    pub(super) place: Lanes,
    /// Bits of the place that are mirrored, so that the ray goes up along all axes.
    pub(super) mirror: Lanes,
    /// Number of voxels that every ray visits. 0 for lanes that only fill the bundle.
    pub(super) visits: Lanes,
    /// Number of rays that every ray stands for.
    pub(super) count: Lanes,
}

impl Bundle {
    /// A bundle of rays without length, in which no lane visits a voxel.
    pub(super) const NONE: Self = Self {
        wall: [[NEVER; LANES]; 3],
        pace: [[0; LANES]; 3],
        walls: [[0; LANES]; 3],
        end: [0; LANES],
        shift: [0; LANES],
        entered: [0; LANES],
        place: [0; LANES],
        mirror: [0; LANES],
        visits: [0; LANES],
        count: [0; LANES],
    };

    #[inline(always)]
    pub(super) fn of(window: &Window, segments: &RaySegments, rays: &[Ray]) -> Self {
        let RaySegments { start, end } = segments;
        let mut bundle = Self { place: places(start, window), ..Self::NONE };
        for (count, ray) in bundle.count.iter_mut().zip(rays) {
            *count = ray.count;
        }
        let length = bundle.measure(start, end);
        for axis in 0..3 {
            bundle.set_walls(axis, &length, &start[axis], &end[axis], window.bits_along(axis));
        }
        for lane in 0..LANES {
            bundle.place[lane] ^= bundle.mirror[lane];
            bundle.visits[lane] =
                if bundle.count[lane] == 0 { 0 } else { bundle.visits[lane].wrapping_add(1) };
        }
        bundle
    }

    /// Sum of the voxels that the rays visit.
    #[inline(always)]
    pub(super) fn all_visits(&self) -> u64 {
        self.visits.iter().map(|&visits| u64::from(visits)).sum()
    }

    /// True if a ray stands for other rays too.
    #[inline(always)]
    pub(super) fn stands_for_others(&self) -> bool {
        self.count.iter().fold(false, |any, &count| any | (count > 1))
    }

    /// Multiply lengths by the number of rays that each ray stands for.
    #[inline(always)]
    pub(super) fn multiply(&self, lengths: &mut [Lanes]) {
        for lengths in lengths {
            for (length, count) in lengths.iter_mut().zip(self.count) {
                *length = length.wrapping_mul(count);
            }
        }
    }

    /// Set shift and end of every ray. Returns the lengths in sub-units.
    #[inline(always)]
    fn measure(&mut self, start: &[Numbers; 3], end: &[Numbers; 3]) -> Numbers {
        let mut length = [0.0; LANES];
        for lane in 0..LANES {
            let (x, y) = (end[0][lane] - start[0][lane], end[1][lane] - start[1][lane]);
            let z = end[2][lane] - start[2][lane];
            let units = (x * x + y * y + z * z).sqrt() * UNITS_PER_EDGE;
            // The bits of the exponent are the largest power of two that keeps the length below 2^31 - 1.
            // Windows keep rays below 2^29 units, so it is not negative; `least` bounds it for length 0.
            let shift = least(FURTHEST / units, f64::from(1u32 << 31)).to_bits() >> 52;
            length[lane] = units * f64::from_bits(shift << 52); // a power of two: exact
            self.shift[lane] = (shift as u32).wrapping_sub(1023);
            self.end[lane] = whole(length[lane].ceil());
        }
        length
    }

    /// Set the walls along an axis. `bits`: the bits of a place that belong to the axis.
    #[inline(always)]
    fn set_walls(
        &mut self,
        axis: usize,
        length: &Numbers,
        start: &Numbers,
        end: &Numbers,
        bits: u32,
    ) {
        for lane in 0..LANES {
            let (first, last) = (start[lane].floor(), end[lane].floor());
            let upwards = last > first;
            let gap = ((if upwards { first + 1.0 } else { first }) - start[lane]).abs();
            // Finite also for an axis along which the ray does not move: 0 times infinity would be NaN.
            let rate = least(length[lane] / (end[lane] - start[lane]).abs(), f64::MAX);
            let (walls, ahead) = ((last - first).abs(), f64::from(self.end[lane]));
            let pace = least(rate.round_ties_even(), ahead + 1.0);
            // Rounding may put the last wall one unit behind the end. The shorter pace puts it at the end or
            // before, and the next wall behind: the ray crosses exactly `walls` walls.
            let pace = if (walls - 1.0) * pace > ahead { pace - 1.0 } else { pace };
            let wall = least((gap * rate).round_ties_even(), ahead - (walls - 1.0) * pace);
            let wall = -least(-wall, -(ahead + 1.0 - walls * pace));
            let is_met = walls > 0.0;
            self.wall[axis][lane] = if is_met { whole(wall) } else { NEVER };
            self.pace[axis][lane] = if is_met { whole(pace) } else { 0 };
            // Turning the bits over makes a step down a step up: one addition serves both directions.
            self.mirror[lane] |= if upwards | !is_met { 0 } else { bits };
            self.walls[axis][lane] = whole(walls);
            self.visits[lane] = self.visits[lane].wrapping_add(self.walls[axis][lane]);
        }
    }
}
