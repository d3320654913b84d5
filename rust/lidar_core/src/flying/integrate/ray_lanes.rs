//! Walk of many rays at a time through the blocks of a window.
//!
//! The algorithm is that of Amanatides & Woo, on the vector unit of the machine (chosen when the
//! program runs), in whole numbers (docs/adr/0002). At an edge or corner the lowest axis goes
//! first, as in `geometry::traverse`.

use super::accumulate::accumulator::{Accumulator, STEPS};
use super::accumulate::window::Window;
use super::bundle::Bundle;
use super::cube_map::CubeMap;
use super::ray_segments::{LANES, Lanes, Ray, Source};
use super::stretches::Stretches;
use crate::util::vector_unit::dispatch;
use pulp::{Simd, WithSimd};

/// Number of groups of `STEPS` steps that are buffered before their lengths are added to memory.
/// The buffers stay in the first cache.
const RUN: usize = 8;

/// Input of the casting of rays: window, rays of the scan, and live cells.
#[derive(Clone, Copy)]
pub(crate) struct CastTask<'a> {
    pub(crate) window: &'a Window,
    pub(crate) source: &'a Source<'a>,
    /// Cells that rays may change. Rays skip the others. None: rays visit every cell.
    pub(crate) live: Option<&'a CubeMap>,
}

/// Add the length of `rays` inside every voxel that they cross to the accumulator. `stretches` is
/// memory for the work.
pub(crate) fn cast(
    accumulator: &mut Accumulator,
    task: &CastTask<'_>,
    rays: &[Ray],
    stretches: &mut Stretches,
) {
    dispatch(Cast { accumulator, task, rays, stretches });
}

struct Cast<'a> {
    accumulator: &'a mut Accumulator,
    task: &'a CastTask<'a>,
    rays: &'a [Ray],
    stretches: &'a mut Stretches,
}

impl WithSimd for Cast<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::U32_LANES {
            // Vectors of any width make bundles of 32 lanes, so every unit does the same sums.
            16 => self.walk::<S, 2>(simd),
            8 => self.walk::<S, 4>(simd),
            4 => self.walk::<S, 8>(simd),
            _ => self.walk::<S, LANES>(simd),
        }
    }
}

impl Cast<'_> {
    /// Cast all rays, with `K` vectors per bundle.
    #[inline(always)]
    fn walk<S: Simd, const K: usize>(self, simd: S) {
        let Self { accumulator, task: &CastTask { window, source, live }, rays, stretches } = self;
        let mut steps =
            Buffers { places: [[[0; LANES]; STEPS]; RUN], lengths: [[[0; LANES]; STEPS]; RUN] };
        stretches.clear();
        for rays in rays.chunks(LANES) {
            let segments = source.segments(rays).scaled(source.lattice);
            let bundle = Bundle::of(window, &segments, rays);
            accumulator.count(bundle.all_visits());
            match live {
                Some(live) => stretches.find(window, live, &segments, bundle),
                None => walk_bundle::<S, K>(simd, accumulator, window, &bundle, &mut steps),
            }
        }
        for at in (0..stretches.len()).step_by(LANES) {
            let bundle = stretches.bundle(window, at);
            walk_bundle::<S, K>(simd, accumulator, window, &bundle, &mut steps);
        }
    }
}

/// Buffered steps of rays: 8 x 8 steps of 32 lanes, 8 KiB per buffer. Both buffers fit into the
/// first cache.
struct Buffers {
    places: [[Lanes; STEPS]; RUN],
    lengths: [[Lanes; STEPS]; RUN],
}

/// Walk the rays of a bundle and add their lengths to the accumulator.
#[inline(always)]
fn walk_bundle<S: Simd, const K: usize>(
    simd: S,
    accumulator: &mut Accumulator,
    window: &Window,
    bundle: &Bundle,
    steps: &mut Buffers,
) {
    let mut walk = Walk::<S, K>::new(simd, window, bundle);
    let most = bundle.visits.into_iter().max().unwrap_or(0) as usize;
    let mut left = most.div_ceil(STEPS);
    while left > 0 {
        let run = left.min(RUN);
        let (places, lengths) = (&mut steps.places[..run], &mut steps.lengths[..run]);
        for (places, lengths) in places.iter_mut().zip(lengths.iter_mut()) {
            for (places, lengths) in places.iter_mut().zip(lengths.iter_mut()) {
                walk.step(simd, places, lengths);
            }
        }
        if bundle.stands_for_others() {
            bundle.multiply(lengths.as_flattened_mut());
        }
        accumulator.add(window, places, lengths);
        left -= run;
    }
    accumulator.count_walked(bundle.all_visits());
}

/// Next walls and present voxels of the rays of a bundle, as vectors. Its methods use no closures:
/// these would not be inlined everywhere, and would be compiled for another vector unit.
pub(super) struct BundleWay<S: Simd, const K: usize> {
    /// Position along the ray of the next wall, for every axis.
    pub(super) wall: [[S::u32s; K]; 3],
    /// Distance along the ray from one wall to the next, for every axis.
    pub(super) pace: [[S::u32s; K]; 3],
    /// Place of the present voxel in the window, mirrored.
    pub(super) place: [S::u32s; K],
    /// Bits of a place that belong to each axis.
    pub(super) bits: [S::u32s; 3],
}

/// The numbers of all lanes as vectors.
#[inline(always)]
pub(super) fn vectors<S: Simd, const K: usize>(lanes: &Lanes) -> [S::u32s; K] {
    std::array::from_fn(|k| S::as_simd_u32s(lanes).0[k])
}

/// State of a bundle that walks from voxel to voxel.
struct Walk<S: Simd, const K: usize> {
    way: BundleWay<S, K>,
    end: [S::u32s; K],
    shift: [S::u32s; K],
    mirror: [S::u32s; K],
    visits: [S::u32s; K],
    step: S::u32s,
    /// Position along the ray at which it entered its voxel, in units.
    entered: [S::u32s; K],
}

impl<S: Simd, const K: usize> Walk<S, K> {
    #[inline(always)]
    fn new(simd: S, window: &Window, bundle: &Bundle) -> Self {
        Self {
            way: BundleWay {
                wall: std::array::from_fn(|axis| vectors::<S, K>(&bundle.wall[axis])),
                pace: std::array::from_fn(|axis| vectors::<S, K>(&bundle.pace[axis])),
                place: vectors::<S, K>(&bundle.place),
                bits: std::array::from_fn(|axis| simd.splat_u32s(window.bits_along(axis))),
            },
            end: vectors::<S, K>(&bundle.end),
            shift: vectors::<S, K>(&bundle.shift),
            mirror: vectors::<S, K>(&bundle.mirror),
            visits: vectors::<S, K>(&bundle.visits),
            step: simd.splat_u32s(0),
            entered: vectors::<S, K>(&bundle.entered),
        }
    }

    /// Write the present voxels of the rays and the lengths inside, and go to the next voxels. Rays
    /// that have arrived add length 0, at another voxel in every step, so that no addition waits
    /// for the last one. There are enough voxels for this: the number of steps follows the edges of
    /// the window, that of voxels its volume.
    #[inline(always)]
    fn step(&mut self, simd: S, places: &mut Lanes, lengths: &mut Lanes) {
        let (none, one) = (simd.splat_u32s(0), simd.splat_u32s(1));
        let (places, lengths) = (S::as_mut_simd_u32s(places).0, S::as_mut_simd_u32s(lengths).0);
        for (k, (place, length)) in places.iter_mut().zip(lengths).enumerate().take(K) {
            let going = simd.greater_than_u32s(self.visits[k], self.step);
            let here = simd.xor_u32s(self.way.place[k], self.mirror[k]);
            *place = simd.select_u32s(going, here, self.step);
            let first = self.way.first_wall(simd, k);
            let exit = simd.min_u32s(first, self.end[k]);
            // Positions are rounded to units, not lengths: the lengths add up to that of the ray.
            let exit = simd.wrapping_dyn_shr_u32s(exit, self.shift[k]);
            let inside = simd.sub_u32s(exit, self.entered[k]);
            *length = simd.select_u32s(going, inside, none);
            self.entered[k] = exit;
            self.way.cross(simd, k, first);
        }
        self.step = simd.add_u32s(self.step, one);
    }
}

impl<S: Simd, const K: usize> BundleWay<S, K> {
    /// Position along the ray of the nearest next wall.
    #[inline(always)]
    pub(super) fn first_wall(&self, simd: S, k: usize) -> S::u32s {
        simd.min_u32s(self.wall[0][k], simd.min_u32s(self.wall[1][k], self.wall[2][k]))
    }

    /// Go through the nearest wall: along x, or else along y, or else along z. Returns masks of the
    /// lanes that went along x and along y.
    #[inline(always)]
    pub(super) fn cross(&mut self, simd: S, k: usize, first: S::u32s) -> [S::m32s; 2] {
        let along_x = simd.equal_u32s(self.wall[0][k], first);
        let along_y = simd.equal_u32s(self.wall[1][k], first);
        self.move_on(simd, k, along_x, along_y);
        [along_x, along_y]
    }

    /// Go through a wall along x, or else along y, or else along z, by the given masks.
    #[inline(always)]
    fn move_on(&mut self, simd: S, k: usize, along_x: S::m32s, along_y: S::m32s) {
        let [x, y, z] = [self.wall[0][k], self.wall[1][k], self.wall[2][k]];
        let next_y = simd.select_u32s(along_y, simd.add_u32s(y, self.pace[1][k]), y);
        let next_z = simd.select_u32s(along_y, z, simd.add_u32s(z, self.pace[2][k]));
        // Positions stay below 2^32: a wall that is crossed lies at the end or before, and a pace is at
        // most the end + 1. Sums of rays that have arrived may wrap: their lengths are masked.
        self.wall[0][k] = simd.select_u32s(along_x, simd.add_u32s(x, self.pace[0][k]), x);
        self.wall[1][k] = simd.select_u32s(along_x, y, next_y);
        self.wall[2][k] = simd.select_u32s(along_x, z, next_z);

        let [x, y, z] = self.bits;
        let bits = simd.select_u32s(along_x, x, simd.select_u32s(along_y, y, z));
        let others = simd.not_u32s(bits);
        let place = self.place[k];
        // The carry runs through the bits of the other axes.
        let above = simd.add_u32s(simd.or_u32s(place, others), simd.splat_u32s(1));
        self.place[k] = simd.or_u32s(simd.and_u32s(above, bits), simd.and_u32s(place, others));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::flying::integrate::ray_segments::tests::with_rays;
    use crate::flying::map::block_shape::VOLUME;
    use pulp::{Arch, Scalar};

    /// Marks after rays in all directions were cast by `run`.
    fn marks(run: impl Fn(Cast<'_>)) -> Result<Vec<u32>, Error> {
        let segments: Vec<_> = (0..77u16)
            .map(|index| {
                let (sin, cos) = libm::sincosf(f32::from(index) * 0.37);
                ([0.3, -0.2, 0.1], [30.0 * cos, 30.0 * sin, f32::from(index % 20) - 10.0])
            })
            .collect();
        let window = Window::spanning([-40; 3], [40; 3])?;
        let mut sums = Accumulator::default();
        sums.aim(window, 1 << 20);
        with_rays(&segments, |source, rays| {
            let task = &CastTask { window: &window, source, live: None };
            let stretches = &mut Stretches::default();
            run(Cast { accumulator: &mut sums, task, rays: &rays, stretches });
            Ok(())
        })?;
        sums.settle(|_| true);
        let slots: Vec<_> = sums.marked().collect();
        Ok(slots.iter().flat_map(|&(_, slot)| *sums.block(slot, &mut [0; VOLUME]).0).collect())
    }

    #[test]
    fn every_vector_unit_gives_the_same_bits() -> Result<(), Error> {
        let best = marks(|cast| Arch::new().dispatch(cast))?;
        assert!(best.iter().filter(|&&mark| mark > 0).count() > 1000);
        assert_eq!(marks(|cast| cast.with_simd(Scalar::new()))?, best);
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = pulp::x86::V3::try_new() {
            assert_eq!(marks(|cast| Simd::vectorize(avx2, cast))?, best);
        }
        Ok(())
    }
}
