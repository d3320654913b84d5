//! Many rays at a time through the blocks of a window.
//!
//! The walk of Amanatides & Woo on the vector unit of the machine, chosen when the program runs.
//! Every ray is mirrored so that it runs upwards along all axes; rays that have arrived go on with
//! length 0. At an edge or corner the lowest axis goes first, as in `geometry::traverse`.

use super::marks::{Accumulator, UNITS_PER_EDGE};
use super::raycast::Ray;
use super::window::Window;
use crate::geometry::lattice::{Voxel, floor};
use crate::geometry::transform::{minus, norm};
use crate::geometry::traverse::voxel_count;
use pulp::{Arch, Simd, WithSimd};

/// Rays side by side: two vectors of the widest unit, so that one works while the other waits.
const LANES: usize = 16;
/// Visits of a ray that are written down before they are added to memory: those of a bundle stay in
/// the first cache.
const RUN: usize = 160;
/// A number below 2^32 added to this has its whole part, rounded, in the lowest bits.
const SHIFT: f64 = (1u64 << 52) as f64;

/// Rays that are walked together.
struct Bundle {
    /// From the start to the next wall along every axis, in voxels; infinite where none is crossed.
    gap: [[f64; LANES]; 3],
    /// Ray parameter (0 at the start, 1 at the end) per voxel along every axis.
    rate: [[f64; LANES]; 3],
    /// Lengths, in units.
    length: [f64; LANES],
    /// Place of the voxel in the window, mirrored, in the upper half.
    place: [u64; LANES],
    /// Bits of the place that are mirrored.
    mirror: [u64; LANES],
    /// Voxels that every ray visits.
    visits: [usize; LANES],
}

impl Bundle {
    #[inline(always)]
    fn of(window: &Window, rays: &[Ray]) -> Self {
        let mut bundle = Self {
            gap: [[f64::INFINITY; LANES]; 3],
            rate: [[1.0; LANES]; 3],
            length: [0.0; LANES],
            place: [0; LANES],
            mirror: [0; LANES],
            visits: [0; LANES],
        };
        for (lane, ray) in rays.iter().enumerate().take(LANES) {
            if let Some(first) = floor(ray.start) {
                bundle.put(window, lane, ray, first);
            }
        }
        bundle
    }

    #[inline(always)]
    fn put(&mut self, window: &Window, lane: usize, ray: &Ray, first: Voxel) {
        let last = ray.last;
        let span = minus(ray.end, ray.start);
        for axis in (0..3).filter(|&axis| first[axis] != last[axis]) {
            let upwards = last[axis] > first[axis];
            let wall = f64::from(first[axis] + i32::from(upwards));
            self.gap[axis][lane] = (wall - ray.start[axis]).abs();
            // Finite: of a span whose reciprocal overflows, 0 * inf would be NaN.
            self.rate[axis][lane] = (1.0 / span[axis]).abs().min(f64::MAX);
            if !upwards {
                self.mirror[lane] |= window.bits_along(axis) << 32;
            }
        }
        self.length[lane] = norm(span) * UNITS_PER_EDGE * f64::from(ray.count);
        self.place[lane] = window.bits_of(first) << 32 ^ self.mirror[lane];
        self.visits[lane] = voxel_count(first, last) as usize;
    }
}

/// Add the length of `rays` inside every voxel they cross.
pub(crate) fn cast(accumulator: &mut Accumulator, window: &Window, rays: &[Ray]) {
    Arch::new().dispatch(Cast { accumulator, window, rays });
}

struct Cast<'a> {
    accumulator: &'a mut Accumulator,
    window: &'a Window,
    rays: &'a [Ray],
}

impl WithSimd for Cast<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F64_LANES {
            8 => self.walk::<S, 2>(simd),
            4 => self.walk::<S, 4>(simd),
            2 => self.walk::<S, 8>(simd),
            _ => self.walk::<S, LANES>(simd),
        }
    }
}

impl Cast<'_> {
    /// With `K` vectors per bundle.
    #[inline(always)]
    fn walk<S: Simd, const K: usize>(mut self, simd: S) {
        let mut visits = [[0; LANES]; RUN];
        for rays in self.rays.chunks(LANES) {
            let bundle = Bundle::of(self.window, rays);
            let mut walk = Walk::<S, K>::new(simd, self.window, &bundle);
            let mut left = bundle.visits;
            while let Some(most) = left.into_iter().max().filter(|&most| most > 0) {
                visits.iter_mut().take(most).for_each(|visits| walk.step(simd, visits));
                self.add(&visits, &mut left);
            }
            self.accumulator.count(bundle.visits.iter().sum::<usize>() as u64);
        }
    }

    /// Ray by ray, since additions to one voxel right after another wait for each other.
    #[inline(always)]
    fn add(&mut self, visits: &[[u64; LANES]; RUN], left: &mut [usize; LANES]) {
        for (lane, left) in left.iter_mut().enumerate() {
            let own = visits.iter().take(*left).map(|visits| visits[lane]);
            self.accumulator.add(self.window, own);
            *left = left.saturating_sub(RUN);
        }
    }
}

/// State of a bundle on its way, in vectors. No closures on the way: they would not be inlined
/// everywhere, and compiled for another vector unit.
struct Walk<S: Simd, const K: usize> {
    gap: [[S::f64s; K]; 3],
    rate: [[S::f64s; K]; 3],
    length: [S::f64s; K],
    place: [S::u64s; K],
    mirror: [S::u64s; K],
    /// Ray parameter where the ray entered its voxel.
    entered: [S::f64s; K],
    /// Bits of a place that belong to an axis.
    bits: [S::u64s; 3],
}

impl<S: Simd, const K: usize> Walk<S, K> {
    #[inline(always)]
    fn new(simd: S, window: &Window, bundle: &Bundle) -> Self {
        let numbers = |lanes: &[f64; LANES]| std::array::from_fn(|k| S::as_simd_f64s(lanes).0[k]);
        let words = |lanes: &[u64; LANES]| std::array::from_fn(|k| S::as_simd_u64s(lanes).0[k]);
        Self {
            gap: std::array::from_fn(|axis| numbers(&bundle.gap[axis])),
            rate: std::array::from_fn(|axis| numbers(&bundle.rate[axis])),
            length: numbers(&bundle.length),
            place: words(&bundle.place),
            mirror: words(&bundle.mirror),
            entered: [simd.splat_f64s(0.0); K],
            bits: std::array::from_fn(|axis| simd.splat_u64s(window.bits_along(axis) << 32)),
        }
    }

    /// Write down the voxels that the rays are in (upper halves), and the lengths inside (lower
    /// halves); go on to the next ones.
    #[inline(always)]
    fn step(&mut self, simd: S, visits: &mut [u64; LANES]) {
        let (one, shift) = (simd.splat_f64s(1.0), simd.splat_f64s(SHIFT));
        let lower = simd.splat_u64s(u64::from(u32::MAX));
        for (k, visit) in S::as_mut_simd_u64s(visits).0.iter_mut().enumerate().take(K) {
            // Computed from the start, not summed up, so that the error does not grow.
            let x = simd.mul_f64s(self.gap[0][k], self.rate[0][k]);
            let y = simd.mul_f64s(self.gap[1][k], self.rate[1][k]);
            let z = simd.mul_f64s(self.gap[2][k], self.rate[2][k]);
            let first = simd.min_f64s(x, simd.min_f64s(y, z));
            let exit = simd.min_f64s(first, one);
            let length = simd.mul_f64s(simd.sub_f64s(exit, self.entered[k]), self.length[k]);
            let units = simd.transmute_u64s_f64s(simd.add_f64s(length, shift));
            let place = simd.xor_u64s(self.place[k], self.mirror[k]);
            *visit = simd.or_u64s(simd.and_u64s(units, lower), place);
            self.entered[k] = exit;
            let along_x = simd.less_than_or_equal_f64s(x, first);
            let along_y = simd.less_than_or_equal_f64s(y, first);
            self.cross(simd, k, along_x, along_y);
        }
    }

    /// Through a wall along x, or else along y, or else along z.
    #[inline(always)]
    fn cross(&mut self, simd: S, k: usize, along_x: S::m64s, along_y: S::m64s) {
        let one = simd.splat_f64s(1.0);
        let [x, y, z] = [self.gap[0][k], self.gap[1][k], self.gap[2][k]];
        let next_y = simd.select_f64s(along_y, simd.add_f64s(y, one), y);
        let next_z = simd.select_f64s(along_y, z, simd.add_f64s(z, one));
        self.gap[0][k] = simd.select_f64s(along_x, simd.add_f64s(x, one), x);
        self.gap[1][k] = simd.select_f64s(along_x, y, next_y);
        self.gap[2][k] = simd.select_f64s(along_x, z, next_z);

        let [x, y, z] = self.bits;
        let bits = simd.select_u64s(along_x, x, simd.select_u64s(along_y, y, z));
        let others = simd.not_u64s(bits);
        let place = self.place[k];
        // The carry runs through the bits of the other axes.
        let above = simd.add_u64s(simd.or_u64s(place, others), simd.splat_u64s(1 << 32));
        self.place[k] = simd.or_u64s(simd.and_u64s(above, bits), simd.and_u64s(place, others));
    }
}
