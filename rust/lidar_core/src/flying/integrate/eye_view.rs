//! View of cubes of voxels from the eye: the small box in which the rays of a scan start.
//!
//! Around the eye are the six faces of a cube, each with a grid of directions.

use super::accumulate::window::Window;
use super::classified_scan::Origins;
use super::ray_segments::{Ray, Source};
use crate::flying::map::block_shape::{EDGE, EDGE_BITS};
use crate::flying::map::inert::CELL_BITS;
use crate::geometry::lattice::{least, whole};
use std::ops::Range;

/// Number of directions along the edge of a face.
pub(super) const GRID: usize = 64;
/// Bit of the last layer. It also stands for all layers behind it.
pub(super) const LAST: u32 = u64::BITS - 1;
/// Largest edge of the eye [voxels]. Seen from a larger eye, too many cells overlap.
const LARGEST_EYE: f64 = 16.0;
/// Margin of cells on all sides [voxels], in addition to the margin for rounding errors.
const LEAST_MARGIN: f64 = 1.0 / 256.0;

/// Box in which all rays start: its lowest and highest corner [voxels].
type Eye = [[f64; 3]; 2];

/// View from the eye: position of the eye, and layers of voxels around it.
#[derive(Clone, Copy, Default)]
pub(super) struct EyeView {
    /// The eye, enlarged by the margin of cells, relative to the first voxel of the window
    /// [voxels].
    eye: Eye,
    /// Length of the longest ray, enlarged by a margin [voxels].
    reach: f64,
    /// Base-2 logarithm of the thickness of a layer in voxels.
    pub(super) layer_bits: u32,
    /// Layer of the eye along every axis: for rays that go up the axis, and for rays that go down.
    pub(super) first: [[u32; 2]; 3],
}

impl EyeView {
    /// View of the rays of a scan. None if their start points are too far apart.
    pub(super) fn of(window: &Window, source: &Source<'_>, rays: &[Ray]) -> Option<Self> {
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

    /// Smallest and largest distance along every axis at which rays may meet a cube of voxels.
    #[inline(always)]
    fn away(&self, low: [u32; 3], edge: u32) -> [[f64; 3]; 2] {
        let near = std::array::from_fn(|axis| f64::from(low[axis]) - self.eye[1][axis]);
        let far = std::array::from_fn(|axis| f64::from(low[axis] + edge) - self.eye[0][axis]);
        [near, far]
    }

    /// True if a ray may be long enough to reach a block. `corner`: its first voxel in the window.
    pub(super) fn reaches(&self, corner: [u32; 3]) -> bool {
        let [near, far] = self.away(corner, EDGE as u32);
        let gap = |axis: usize| near[axis].max(-far[axis]).max(0.0);
        (0..3).map(|axis| gap(axis) * gap(axis)).sum::<f64>() <= self.reach * self.reach
    }

    /// Call `visit` for the directions of rays that may meet a cube of voxels, row by row, with the
    /// bits of the cube's layers.
    #[inline(always)]
    pub(super) fn look_at(
        &self,
        low: [u32; 3],
        edge: u32,
        mut visit: impl FnMut(Range<usize>, u64),
    ) {
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
                [low, high].map(|slope| on_grid(slope) as usize)
            };
            let ([first_u, last_u], [first_v, last_v]) = (span(u), span(v));
            for v in first_v..=last_v {
                let row = (face * GRID + v) * GRID;
                visit(row + first_u..row + last_u + 1, layers);
            }
        }
    }

    /// Bits of the layers of a cube along `axis`. None if the cube is behind the eye.
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

/// Index of a direction. `face`: twice the index of the axis along which the ray goes furthest,
/// plus 1 if the ray goes down this axis. `u`, `v`: cell on the grid of the face, along the next
/// two axes.
#[inline(always)]
pub(super) fn direction(face: u32, [u, v]: [u32; 2]) -> u32 {
    const EDGE: u32 = GRID as u32;
    (face * EDGE + v) * EDGE + u
}

/// Cell of a slope on an edge of the grid. A slope is the distance along another axis per distance
/// along the ray's axis, -1 to 1.
#[inline(always)]
pub(super) fn grid_at(slope: f64) -> u32 {
    whole(on_grid(slope).floor())
}

/// Like [`grid_at`], with the fraction: from 0 to the last cell.
#[inline(always)]
fn on_grid(slope: f64) -> f64 {
    const HALF: f64 = GRID as f64 / 2.0;
    let slope = -least(-least(slope, 1.0), 1.0);
    least((slope + 1.0) * HALF, GRID as f64 - 1.0)
}

/// The box in which the rays start [voxels].
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
