//! Map of directions: where the rays of a scan may reach live cells (cells with voxels that rays
//! may change), and at which distances.
//!
//! All rays start in a small box, the eye. Around it are the six faces of a cube, each with a grid
//! of directions. A ray belongs to the face of the axis along which it goes furthest. Every
//! direction has a bit for each layer of voxels across this axis, counted from the eye. The bit is
//! set if the layer has a live cell in this direction. Cells are enlarged by the eye and by more
//! than the rounding of the walk of a ray: a superfluous bit only costs time, and no bit is
//! missing.

use super::accumulate::live_cells::{LiveCells, cubes};
use super::accumulate::window::Window;
use super::eye_view::{EyeView, GRID};
use super::ray_segments::{Ray, Source};
use crate::flying::map::block_shape::EDGE;
use crate::flying::map::inert::{CELL_BITS, CellBits};
use rayon::ThreadPool;
use rayon::prelude::*;

/// Number of blocks of the window per ray above which the map of directions costs more than it
/// saves.
const BLOCKS_PER_RAY: usize = 4;
/// Number of blocks that a thread takes at a time.
const BLOCKS_AT_A_TIME: usize = 256;

/// Layers with live cells, for every direction of rays.
#[derive(Default)]
pub(crate) struct CubeMap {
    sight: EyeView,
    layers: Layers,
    /// Layers that the other threads fill in.
    others: Vec<Layers>,
    /// Indices of the blocks with live cells that rays may reach.
    near: Vec<u32>,
    /// For each block of the window, whether rays may visit it.
    is_met: Vec<bool>,
}

impl CubeMap {
    /// Fill the map with the `live` cells of a window, as `rays` may reach them. Returns false if
    /// the map would cost more time than it saves. It must not be used then.
    pub(super) fn fill(
        &mut self,
        pool: Option<&ThreadPool>,
        window: &Window,
        live: &LiveCells,
        source: &Source<'_>,
        rays: &[Ray],
    ) -> bool {
        // Longer than other functions: the same closures serve one thread and several.
        if window.len() > BLOCKS_PER_RAY * rays.len() {
            return false;
        }
        let Some(sight) = EyeView::of(window, source, rays) else { return false };
        self.sight = sight;
        let Self { layers, others, near, is_met, .. } = self;
        let is_near = |index: &u32| {
            let index = *index as usize;
            live.at(index) != 0 && sight.reaches(window.corner(index))
        };
        near.clear();
        near.extend(window.indices().map(|index| index as u32).filter(is_near)); // fits 32 bits
        is_met.clear();
        is_met.resize(window.len(), false);
        // Rays visit other cells, too: those of the same layers, and those beside.
        let meets = |layers: &Layers, index: usize| {
            let corner = window.corner(index);
            sight.reaches(corner) && (live.at(index) != 0 || layers.hold_some_of(&sight, corner))
        };
        let draw = |part: &[u32], layers: &mut Layers| {
            layers.clear();
            for &index in part {
                let index = index as usize;
                layers.add_block(&sight, window.corner(index), live.at(index));
            }
        };
        let Some(pool) = pool else {
            draw(near, layers);
            window.indices().for_each(|index| is_met[index] = meets(layers, index));
            return true;
        };
        let n_threads = pool.current_num_threads();
        let share = near.len().div_ceil(n_threads).max(1);
        let parts = || near.chunks(share).chain(std::iter::repeat(&[][..]));
        others.resize_with(n_threads - 1, Layers::default);
        pool.install(|| {
            let all: Vec<_> =
                [&mut *layers].into_iter().chain(others.iter_mut()).zip(parts()).collect();
            all.into_par_iter().for_each(|(layers, part)| draw(part, layers));
            others.iter().for_each(|other| layers.join(other));
            is_met.par_chunks_mut(BLOCKS_AT_A_TIME).enumerate().for_each(|(chunk, is_met)| {
                for (at, is_met) in is_met.iter_mut().enumerate() {
                    // Also numbers that belong to no block of the window: nobody reads theirs, and a
                    // condition would cost more than it saves.
                    *is_met = meets(layers, chunk * BLOCKS_AT_A_TIME + at);
                }
            });
        });
        true
    }

    /// The view from the start of the rays.
    pub(super) fn sight(&self) -> &EyeView {
        &self.sight
    }

    /// Bits of the layers that hold live cells in a direction.
    #[inline(always)]
    pub(super) fn layers(&self, direction: u32) -> u64 {
        self.layers.0[direction as usize]
    }

    /// True if rays may visit the block at `index` of the window.
    pub(crate) fn meets(&self, index: usize) -> bool {
        self.is_met[index]
    }
}

/// One word for every direction, with one bit for every layer.
#[derive(Default)]
struct Layers(Vec<u64>);

impl Layers {
    fn clear(&mut self) {
        self.0.clear();
        self.0.resize(6 * GRID * GRID, 0);
    }

    /// Add the layers of `other`.
    fn join(&mut self, other: &Self) {
        self.0.iter_mut().zip(&other.0).for_each(|(layers, other)| *layers |= other);
    }

    /// Add the live cells of a block. `corner`: first voxel of the block in the window.
    fn add_block(&mut self, sight: &EyeView, corner: [u32; 3], live: CellBits) {
        cubes(live, |at, edge| {
            let low = std::array::from_fn(|axis| corner[axis] + (at[axis] << CELL_BITS));
            self.add(sight, low, edge << CELL_BITS);
        });
    }

    /// Add a cube of voxels. `low`: its first voxel in the window; `edge` [voxels].
    fn add(&mut self, sight: &EyeView, low: [u32; 3], edge: u32) {
        sight.look_at(low, edge, |directions, seen| {
            self.0[directions].iter_mut().for_each(|layers| *layers |= seen);
        });
    }

    /// True if a ray through live layers may visit the block at `corner`.
    fn hold_some_of(&self, sight: &EyeView, corner: [u32; 3]) -> bool {
        let mut met = 0;
        sight.look_at(corner, EDGE as u32, |directions, seen| {
            met |= self.0[directions].iter().fold(0, |all, layers| all | layers & seen);
        });
        met != 0
    }
}

#[cfg(test)]
mod tests {
    use crate::Error;
    use crate::flying::integrate::accumulate::accumulator::{Accumulator, Slot};
    use crate::flying::integrate::accumulate::live_cells::LiveCells;
    use crate::flying::integrate::accumulate::window::Window;
    use crate::flying::integrate::cube_map::CubeMap;
    use crate::flying::integrate::ray_lanes::CastTask;
    use crate::flying::integrate::ray_segments::tests::with_rays;
    use crate::flying::integrate::walk::cast_all;
    use crate::flying::map::block_shape::VOLUME;

    type Segment = ([f64; 3], [f32; 3]);

    /// A pseudo-random number from 0 to 1 for each `index`.
    fn share(index: u32) -> f64 {
        f64::from(index.wrapping_mul(2_654_435_769).rotate_left(9).wrapping_mul(2_246_822_519))
            / 4_294_967_296.0
    }

    /// Ray lengths in all voxels of a window, of whole rays or of their stretches through `live`
    /// cells, and the number of visits that were walked.
    fn lengths(
        window: Window,
        segments: &[Segment],
        live: Option<&CubeMap>,
    ) -> Result<(Vec<u32>, u64), Error> {
        let mut sums = [Accumulator::default()];
        with_rays(segments, |source, rays| {
            cast_all(None, &mut sums, &CastTask { window: &window, source, live }, &rays, 1 << 20);
            Ok(())
        })?;
        let all = window
            .indices()
            .flat_map(|index| *sums[0].block(Slot::Within(index), &mut [0; VOLUME]).0);
        Ok((all.collect(), sums[0].walked()))
    }

    /// Check that the lengths in live cells equal those of whole rays. Returns the share of the
    /// visits that were walked.
    fn compare(
        high: [i32; 3],
        segments: &[Segment],
        cells: &LiveCells,
        layer_bits: u32,
    ) -> Result<f64, Error> {
        let window = Window::spanning([0; 3], high)?;
        let mut map = CubeMap::default();
        let worth =
            with_rays(segments, |source, rays| Ok(map.fill(None, &window, cells, source, &rays)))?;
        assert!(worth);
        assert_eq!(map.sight().layer_bits, layer_bits);
        let (whole, all) = lengths(window, segments, None)?;
        let (some, walked) = lengths(window, segments, Some(&map))?;
        let (mut met, mut left) = (0, 0);
        for (at, (&whole, &some)) in whole.iter().zip(&some).enumerate() {
            let index = window.indices().nth(at / VOLUME).unwrap_or(0);
            let cell = [at, at >> 3, at >> 6].map(|at| at >> 1 & 3);
            if cells.at(index) >> (cell[0] + 4 * cell[1] + 16 * cell[2]) & 1 == 1 {
                assert_eq!(some, whole, "voxel {at}");
                met += u32::from(whole > 0);
            } else {
                assert!(some <= whole);
                left += u32::from(some < whole);
            }
        }
        assert!(met > 20 && left > 20, "{met} live voxels met, others passed by {left} times");
        Ok(walked as f64 / all as f64)
    }

    /// Segments of `number` rays from a box of edge `spread` in the middle of the window to all its
    /// sides.
    fn rays(high: [i32; 3], spread: f64, number: u32) -> Vec<Segment> {
        let at = |seed: u32, axis: u32| share(seed * 8 + axis);
        (0..number)
            .map(|ray| {
                let size = |axis: u32| f64::from(high[axis as usize]);
                let start = [0, 1, 2].map(|axis| 0.4 * size(axis) + spread * at(ray, axis));
                let end = [0, 1, 2].map(|axis| {
                    // Some along the axes, and through edges and corners.
                    let end = size(axis) * at(ray, 3 + axis);
                    let end = if ray % 3 == 0 { end.round() } else { end };
                    if ray % 7 == axis { start[axis as usize] as f32 } else { end as f32 }
                });
                (start, end)
            })
            .collect()
    }

    #[test]
    fn rays_miss_no_live_cell() -> Result<(), Error> {
        let cases = [
            ([79, 70, 63], 0.0, 1, 0.5),
            ([79, 70, 63], 3.7, 1, 0.7),
            ([63, 79, 70], 12.0, 1, 1.0),
            ([230, 63, 31], 0.5, 2, 0.6),
            ([31, 63, 790], 0.0, 3, 0.6),
            ([31, 2990, 15], 0.5, 3, 0.9), // layers behind the last bit
        ];
        for (seed, (high, spread, layer_bits, most)) in (1..).zip(cases) {
            let window = Window::spanning([0; 3], high)?;
            let random = |index: usize| share(7919 * seed + index as u32);
            let blocks = (0..window.len()).map(|index| match (random(index) * 40.0) as u32 {
                0 => u64::MAX,                                  // the whole block
                1 => 0x0033_0033 << (10 * (index % 2)),         // a brick
                2 => 1 << (index * 7 % 64) | 1 << (index % 64), // two cells
                _ => 0,
            });
            let cells = LiveCells::of(blocks.collect());
            let share = compare(high, &rays(high, spread, 2000), &cells, layer_bits)?;
            assert!(share < most, "{share} of all visits in {high:?}");
        }
        Ok(())
    }

    #[test]
    fn a_map_of_directions_is_made_where_it_pays() -> Result<(), Error> {
        let high = [79, 70, 63];
        let window = Window::spanning([0; 3], high)?;
        let cells = LiveCells::of(vec![1; window.len()]);
        for (spread, number, pays) in [(0.0, 2000, true), (40.0, 2000, false), (0.0, 100, false)] {
            let is_made = with_rays(&rays(high, spread, number), |source, rays| {
                Ok(CubeMap::default().fill(None, &window, &cells, source, &rays))
            })?;
            assert_eq!(is_made, pays);
        }
        Ok(())
    }
}
