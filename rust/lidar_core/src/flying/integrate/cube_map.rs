//! Directions in which the rays of a scan meet cells that they may change, and how far away.
//!
//! All rays start in a small box, the eye. Around it lie the six faces of a cube, each with a grid of
//! directions. A ray belongs to the face of the axis along which it goes furthest. A direction holds a bit for every
//! layer of voxels across this axis, counted from the eye: set if a live cell lies there. Cells are enlarged
//! by the eye and by more than the walk of a ray is rounded: a bit too many costs time, and none is missing.

use super::accumulate::live_cells::{ALL, LiveCells};
use super::accumulate::window::Window;
use super::classified_scan::Origins;
use super::ray_segments::{Ray, Source};
use crate::flying::map::block_shape::{EDGE, EDGE_BITS};
use crate::flying::map::inert::{CELL_BITS, CELLS};
use crate::geometry::lattice::{least, whole};
use std::ops::Range;

/// Directions along the edge of a face.
const GRID: usize = 64;
/// Bit of the last layer, and of all behind it.
pub(super) const LAST: u32 = u64::BITS - 1;
/// Cells of the first brick of 2 x 2 x 2 cells in a block.
const BRICK: u64 = 0x0033_0033;
/// Largest eye [voxels]: seen from a larger one, too many cells overlap.
const LARGEST_EYE: f64 = 16.0;
/// Blocks of a window per ray above which the map costs more than it saves.
const BLOCKS_PER_RAY: usize = 4;
/// Distance that is added to cells on all sides [voxels], beside what rounding asks for.
const LEAST_MARGIN: f64 = 1.0 / 256.0;

/// Box in which all rays start: its lowest and highest corner [voxels].
type Eye = [[f64; 3]; 2];

/// How cells are seen.
#[derive(Clone, Copy, Default)]
pub(super) struct EyeView {
    /// The eye with the margin of cells, from the first voxel of the window.
    eye: Eye,
    /// Longest ray with the same margin [voxels].
    reach: f64,
    /// Voxels across a layer, as a power of two.
    pub(super) layer_bits: u32,
    /// Layer of the eye along every axis, for rays that go up, and for those that go down.
    pub(super) first: [[u32; 2]; 3],
}

/// Layers with live cells, by direction.
#[derive(Default)]
pub(crate) struct CubeMap {
    sight: EyeView,
    layers: Vec<u64>,
    /// Blocks of the window that rays may visit.
    is_met: Vec<bool>,
}

impl CubeMap {
    /// See the `live` cells of a window as `rays` do. False if that does not pay.
    pub(super) fn fill(
        &mut self,
        window: &Window,
        live: &LiveCells,
        source: &Source<'_>,
        rays: &[Ray],
    ) -> bool {
        if window.len() > BLOCKS_PER_RAY * rays.len() {
            return false;
        }
        let Some(sight) = EyeView::of(window, source, rays) else { return false };
        self.sight = sight;
        self.layers.clear();
        self.layers.resize(6 * GRID * GRID, 0);
        self.is_met.clear();
        self.is_met.resize(window.len(), false);
        for index in window.indices() {
            let corner = window.corner(index);
            if live.at(index) != 0 && sight.reaches(corner) {
                self.is_met[index] = true;
                self.add_block(corner, live.at(index));
            }
        }
        // Rays visit other cells, too: those of the same layers, and those beside.
        for index in window.indices().filter(|&index| live.at(index) == 0) {
            let corner = window.corner(index);
            self.is_met[index] = sight.reaches(corner) && self.holds_some_of(corner);
        }
        true
    }

    /// How cells are seen.
    pub(super) fn sight(&self) -> &EyeView {
        &self.sight
    }

    /// Layers that hold live cells in a direction.
    #[inline(always)]
    pub(super) fn layers(&self, direction: u32) -> u64 {
        self.layers[direction as usize]
    }

    /// True if rays may visit the block at `index` of the window.
    pub(crate) fn meets(&self, index: usize) -> bool {
        self.is_met[index]
    }

    /// Add the live cells of a block: together where that adds no others.
    fn add_block(&mut self, corner: [u32; 3], live: u64) {
        if live == ALL {
            return self.add(corner, EDGE as u32);
        }
        for brick in 0..8 {
            let at = [brick & 1, brick >> 1 & 1, brick >> 2].map(|at| at * CELLS / 2);
            let mut cells = live >> (at[0] + CELLS * (at[1] + CELLS * at[2])) & BRICK;
            let corner: [u32; 3] =
                std::array::from_fn(|axis| corner[axis] + (at[axis] << CELL_BITS));
            if cells == BRICK {
                self.add(corner, EDGE as u32 / 2);
                continue;
            }
            while cells != 0 {
                let cell = cells.trailing_zeros();
                let at = [cell % CELLS, cell / CELLS % CELLS, cell / (CELLS * CELLS)];
                self.add(
                    std::array::from_fn(|axis| corner[axis] + (at[axis] << CELL_BITS)),
                    1 << CELL_BITS,
                );
                cells &= cells - 1;
            }
        }
    }

    /// Add a cube of voxels.
    fn add(&mut self, low: [u32; 3], edge: u32) {
        let layers = &mut self.layers;
        self.sight.look_at(low, edge, |directions, seen| {
            layers[directions].iter_mut().for_each(|layers| *layers |= seen);
        });
    }

    /// True if a ray through live layers may visit a block.
    fn holds_some_of(&self, corner: [u32; 3]) -> bool {
        let mut met = 0;
        self.sight.look_at(corner, EDGE as u32, |directions, seen| {
            met |= self.layers[directions].iter().fold(0, |all, layers| all | layers & seen);
        });
        met != 0
    }
}

impl EyeView {
    /// None if the rays start too far apart.
    fn of(window: &Window, source: &Source<'_>, rays: &[Ray]) -> Option<Self> {
        let size: [u32; 3] = std::array::from_fn(|axis| window.extent(axis));
        // In sub-units of a ray, of which its length has 2^30 at least, a wall is rounded by at most three
        // for each wall before it.
        let walls = f64::from(size.iter().sum::<u32>());
        let margin = LEAST_MARGIN + 4.0 * walls * walls / f64::from(1u32 << 30);
        let [low, high] = eye(source, rays);
        // Floors as those of the rays themselves: a difference may be rounded to the next voxel.
        let layer = |at: f64, axis: usize| whole(at.floor() - f64::from(window.first(axis)));
        if (0..3).any(|axis| high[axis] - low[axis] + 2.0 * margin > LARGEST_EYE) {
            return None;
        }
        let first: [[u32; 2]; 3] =
            std::array::from_fn(|axis| [layer(low[axis], axis), layer(high[axis], axis)]);
        let reach = source.parameters.max_range / source.lattice.voxel_size() + 1.0;
        // Rays go from the eye to an end of the window at most.
        let furthest =
            (0..3).map(|axis| size[axis].saturating_sub(first[axis][0]).max(first[axis][1]));
        let furthest = furthest.max().unwrap_or(0);
        let layer_bits = (CELL_BITS..EDGE_BITS as u32)
            .find(|bits| furthest >> bits < LAST)
            .unwrap_or(EDGE_BITS as u32);
        let first = first.map(|ends| ends.map(|voxel| voxel >> layer_bits));
        let relative = |corner: [f64; 3], margin: f64| {
            std::array::from_fn(|axis| corner[axis] - f64::from(window.first(axis)) + margin)
        };
        let eye = [relative(low, -margin), relative(high, margin)];
        Some(Self { eye, reach, layer_bits, first })
    }

    /// Distances along every axis at which rays may meet a cube of voxels: the least and the greatest.
    #[inline(always)]
    fn away(&self, low: [u32; 3], edge: u32) -> [[f64; 3]; 2] {
        let near = std::array::from_fn(|axis| f64::from(low[axis]) - self.eye[1][axis]);
        let far = std::array::from_fn(|axis| f64::from(low[axis] + edge) - self.eye[0][axis]);
        [near, far]
    }

    /// True if a ray may be long enough for a block.
    fn reaches(&self, corner: [u32; 3]) -> bool {
        let [near, far] = self.away(corner, EDGE as u32);
        let gap = |axis: usize| near[axis].max(-far[axis]).max(0.0);
        (0..3).map(|axis| gap(axis) * gap(axis)).sum::<f64>() <= self.reach * self.reach
    }

    /// Visit the directions of the rays that may meet a cube of voxels, row by row, with its layers.
    #[inline(always)]
    fn look_at(&self, low: [u32; 3], edge: u32, mut visit: impl FnMut(Range<usize>, u64)) {
        let [near, far] = self.away(low, edge);
        for face in 0..6 {
            let (axis, is_down) = (face / 2, face % 2 == 1);
            let (from, to) =
                if is_down { (-far[axis], -near[axis]) } else { (near[axis], far[axis]) };
            let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
            // Rays of this face go no further along the other axes.
            let is_beside = |axis: usize| near[axis] > to || -far[axis] > to;
            if to <= 0.0 || is_beside(u) || is_beside(v) {
                continue;
            }
            let Some(layers) = self.layers(axis, is_down, low[axis], edge) else { continue };
            let (close, distant) = (1.0 / from.max(f64::MIN_POSITIVE), 1.0 / to);
            let span = |axis: usize| {
                let low = near[axis] * if near[axis] < 0.0 { close } else { distant };
                let high = far[axis] * if far[axis] > 0.0 { close } else { distant };
                [low, high].map(|slope| grid_at(slope) as usize)
            };
            let ([first_u, last_u], [first_v, last_v]) = (span(u), span(v));
            for v in first_v..=last_v {
                let row = (face * GRID + v) * GRID;
                visit(row + first_u..row + last_u + 1, layers);
            }
        }
    }

    /// Bits of the layers of a cube, None if it lies behind the eye.
    #[inline(always)]
    fn layers(&self, axis: usize, is_down: bool, low: u32, edge: u32) -> Option<u64> {
        let (low, high) = (low >> self.layer_bits, (low + edge - 1) >> self.layer_bits);
        let [up, down] = self.first[axis];
        let (from, to) = if is_down {
            (down.saturating_sub(high), down.checked_sub(low)?)
        } else {
            (low.saturating_sub(up), high.checked_sub(up)?)
        };
        Some(u64::MAX << from.min(LAST) & u64::MAX >> (LAST - to.min(LAST)))
    }
}

/// Number of the face of rays along `axis`, and the place of a direction there, given as distances
/// along the next two axes per distance along this one.
#[inline(always)]
pub(super) fn direction(face: u32, [u, v]: [u32; 2]) -> u32 {
    const EDGE: u32 = GRID as u32;
    (face * EDGE + v) * EDGE + u
}

/// Place of a slope along an edge of the grid.
#[inline(always)]
pub(super) fn grid_at(slope: f64) -> u32 {
    const HALF: f64 = GRID as f64 / 2.0;
    let slope = -least(-least(slope, 1.0), 1.0);
    whole(least((slope + 1.0) * HALF, GRID as f64 - 1.0).floor())
}

/// The box in which rays start.
fn eye(source: &Source<'_>, rays: &[Ray]) -> Eye {
    let [low, high] = match source.scan.origins {
        Origins::One(origin) => [origin; 2],
        Origins::Each(origins) => {
            let (mut low, mut high) = ([f64::MAX; 3], [f64::MIN; 3]);
            for ray in rays {
                let origin = origins[ray.index as usize];
                low = std::array::from_fn(|axis| low[axis].min(origin[axis]));
                high = std::array::from_fn(|axis| high[axis].max(origin[axis]));
            }
            [low, high]
        }
    };
    // Scaling keeps the order of numbers.
    [low, high].map(|corner| source.lattice.scaled(corner))
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

    /// A number from 0 to 1 for each `index`.
    fn share(index: u32) -> f64 {
        f64::from(index.wrapping_mul(2_654_435_769).rotate_left(9).wrapping_mul(2_246_822_519))
            / 4_294_967_296.0
    }

    /// Lengths in all voxels of a window, of all rays or of their stretches; and the visits walked.
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

    /// Compare the lengths in live cells, which are `number` in `of`, with those of whole rays. Returns
    /// the share of the visits that were walked.
    fn compare(
        high: [i32; 3],
        segments: &[Segment],
        cells: &LiveCells,
        layer_bits: u32,
    ) -> Result<f64, Error> {
        let window = Window::spanning([0; 3], high)?;
        let mut map = CubeMap::default();
        let worth =
            with_rays(segments, |source, rays| Ok(map.fill(&window, cells, source, &rays)))?;
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

    /// Rays from a box of edge `spread` in the middle of the window to all its ends.
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
                Ok(CubeMap::default().fill(&window, &cells, source, &rays))
            })?;
            assert_eq!(is_made, pays);
        }
        Ok(())
    }
}
