//! Stretches of rays through layers with live cells (cells that hold a voxel which rays may
//! change).
//!
//! A layer is between two walls across the axis along which the ray goes furthest, so a stretch
//! begins and ends with the crossing of a wall. One exact division per axis counts the walls before
//! it. So a stretch visits the same voxels there as the whole ray, with the same lengths.

use super::accumulate::window::Window;
use super::bundle::Bundle;
use super::cube_map::CubeMap;
use super::eye_view::{LAST, direction, grid_at};
use super::ray_segments::{LANES, Lanes, RaySegments};
use crate::flying::map::block_shape::EDGE_BITS;
use crate::geometry::lattice::whole;

/// Crossing of a wall: its position along the ray, and the number of axes, from the lowest on,
/// whose walls at this position have been crossed. Before all walls: 0, 0.
#[derive(Clone, Copy)]
struct Crossing {
    at: u32,
    axes: u32,
}

/// Part of a ray, from one crossing to another.
#[derive(Clone, Copy)]
struct Stretch {
    /// Index of its ray, counted over all bundles.
    ray: u32,
    from: Crossing,
    /// Crossing into the first voxel behind the stretch. None: it goes on to the end of the ray.
    to: Option<Crossing>,
}

/// Bundles of rays, and the stretches of these rays.
#[derive(Default)]
pub(crate) struct Stretches {
    rays: Vec<Bundle>,
    stretches: Vec<Stretch>,
}

impl Stretches {
    /// Remove all rays and stretches.
    pub(super) fn clear(&mut self) {
        self.rays.clear();
        self.stretches.clear();
    }

    /// Number of stretches.
    pub(super) fn len(&self) -> usize {
        self.stretches.len()
    }

    /// Add the stretches of `rays` through the layers of `live`. `segments`: starts and ends of the
    /// rays.
    #[inline(always)]
    pub(super) fn find(
        &mut self,
        window: &Window,
        live: &CubeMap,
        segments: &RaySegments,
        rays: Bundle,
    ) {
        let layered = Layered::of(window, live, segments, &rays);
        let before = self.stretches.len();
        for lane in 0..LANES {
            if rays.visits[lane] > 0 {
                self.cut(live, &layered, lane);
            }
        }
        if self.stretches.len() > before {
            self.rays.push(rays);
        }
    }

    /// Add the stretches of the ray `lane` through live layers.
    #[inline(always)]
    fn cut(&mut self, live: &CubeMap, layered: &Layered, lane: usize) {
        let from = layered.from[lane].min(LAST);
        let last = layered.walls[lane].min(LAST - from);
        let layers = live.layers(layered.direction[lane]) >> from;
        let mut layers = layers & u64::MAX >> (LAST - last);
        let ray = (self.rays.len() * LANES + lane) as u32;
        let crossing = |layer: u32| Crossing {
            at: layered.wall[lane].wrapping_add((layer - 1).wrapping_mul(layered.pace[lane])),
            axes: layered.axis[lane] + 1,
        };
        while layers != 0 {
            let first = layers.trailing_zeros();
            let behind = first + (layers >> first).trailing_ones();
            let from = if first == 0 { Crossing { at: 0, axes: 0 } } else { crossing(first) };
            let to = (behind <= last).then(|| crossing(behind));
            self.stretches.push(Stretch { ray, from, to });
            layers &= u64::MAX.checked_shl(behind).unwrap_or(0);
        }
    }

    /// Bundle of the stretches from index `first` on.
    #[inline(always)]
    pub(super) fn bundle(&self, window: &Window, first: usize) -> Bundle {
        let mut bundle = Bundle::NONE;
        let (mut from, mut to) =
            ([Crossing { at: 0, axes: 0 }; LANES], [Crossing { at: 0, axes: 0 }; LANES]);
        for (lane, stretch) in self.stretches[first..].iter().take(LANES).enumerate() {
            let (rays, ray) =
                (&self.rays[stretch.ray as usize / LANES], stretch.ray as usize % LANES);
            for axis in 0..3 {
                bundle.wall[axis][lane] = rays.wall[axis][ray];
                bundle.pace[axis][lane] = rays.pace[axis][ray];
            }
            bundle.end[lane] = rays.end[ray];
            bundle.shift[lane] = rays.shift[ray];
            bundle.place[lane] = rays.place[ray];
            bundle.mirror[lane] = rays.mirror[ray];
            bundle.count[lane] = rays.count[ray];
            bundle.visits[lane] = u32::from(stretch.to.is_none());
            from[lane] = stretch.from;
            to[lane] = stretch.to.unwrap_or(Crossing { at: rays.end[ray], axes: 3 });
        }
        for axis in 0..3 {
            start_at(&mut bundle, window, axis, &from, &to);
        }
        for (entered, (from, shift)) in bundle.entered.iter_mut().zip(from.iter().zip(bundle.shift))
        {
            *entered = from.at.wrapping_shr(shift);
        }
        bundle
    }
}

/// Move the rays of a bundle along an axis to the crossing where their stretches begin, and add the
/// walls that the stretches cross along it to the visits.
#[inline(always)]
fn start_at(
    bundle: &mut Bundle,
    window: &Window,
    axis: usize,
    from: &[Crossing; LANES],
    to: &[Crossing; LANES],
) {
    let bits = window.bits_along(axis);
    for lane in 0..LANES {
        let (wall, pace) = (bundle.wall[axis][lane], bundle.pace[axis][lane]);
        let (first, each) = (f64::from(wall.cast_signed()), f64::from(pace.max(1).cast_signed()));
        // Walls before a position, or at it, if this axis counts there: 1 + floor((last - first) / pace), in
        // whole numbers below 2^31. The half keeps the quotient of 53 bits clear of whole numbers, so the
        // floor is exact.
        let crossed = |crossing: Crossing| {
            let behind = crossing.at.wrapping_add(u32::from((axis as u32) < crossing.axes));
            let count = ((f64::from(behind.cast_signed()) - first - 0.5) / each).floor() + 1.0;
            whole(if count > 0.0 { count } else { 0.0 })
        };
        let (before, after) = (crossed(from[lane]), crossed(to[lane]));
        bundle.visits[lane] = bundle.visits[lane].wrapping_add(after).wrapping_sub(before);
        bundle.wall[axis][lane] = wall.wrapping_add(before.wrapping_mul(pace));
        let place = bundle.place[lane];
        // The carry runs through the bits of the other axes.
        let moved = (place | !bits).wrapping_add(window.bits_at(axis, before));
        bundle.place[lane] = moved & bits | place & !bits;
    }
}

/// Rays of a bundle, as crossings of the layers across the axis along which each goes furthest.
struct Layered {
    axis: Lanes,
    /// Layer in which the ray starts, counted from the eye.
    from: Lanes,
    /// Position along the ray of the first wall between layers, if the ray crosses one.
    wall: Lanes,
    /// Distance along the ray from one wall between layers to the next.
    pace: Lanes,
    /// Number of walls between layers that the ray crosses.
    walls: Lanes,
    /// Index of the ray's direction in the map of directions.
    direction: Lanes,
}

impl Layered {
    #[inline(always)]
    fn of(window: &Window, live: &CubeMap, segments: &RaySegments, rays: &Bundle) -> Self {
        // Longer than other functions: one loop over the lanes, so that the compiler makes vector code
        // of all of it.
        let none = [0; LANES];
        let mut layered =
            Self { axis: none, from: none, wall: none, pace: none, walls: none, direction: none };
        let sight = live.sight();
        let inner = (1 << sight.layer_bits) - 1;
        let first = [0, 1, 2].map(|axis| f64::from(window.first(axis)));
        let RaySegments { start, end } = segments;
        for lane in 0..LANES {
            let [x, y, z]: [f64; 3] =
                std::array::from_fn(|axis| end[axis][lane] - start[axis][lane]);
            let is_x = (x.abs() >= y.abs()) & (x.abs() >= z.abs());
            let is_y = !is_x & (y.abs() >= z.abs());
            let (along, beside) = if is_x {
                (x, [y, z])
            } else if is_y {
                (y, [z, x])
            } else {
                (z, [x, y])
            };
            let axis = if is_x {
                0
            } else if is_y {
                1
            } else {
                2
            };
            let of_axis = |of: [u32; 3]| {
                if is_x {
                    of[0]
                } else if is_y {
                    of[1]
                } else {
                    of[2]
                }
            };
            let is_down = along < 0.0;
            // A ray of length 0 is NaN here: it meets only cells around the eye, which all directions hold.
            let places = beside.map(|beside| grid_at(beside / along.abs()));
            layered.direction[lane] = direction(2 * axis + u32::from(is_down), places);
            layered.axis[lane] = axis;

            let [up, down] =
                [0, 1].map(|way| of_axis([0, 1, 2].map(|axis: usize| sight.first[axis][way])));
            let layer = of_axis([0, 1, 2].map(|axis: usize| {
                whole(start[axis][lane].floor() - first[axis]) >> sight.layer_bits
            }));
            layered.from[lane] =
                if is_down { down.wrapping_sub(layer) } else { layer.wrapping_sub(up) };

            let inside = rays.place[lane] >> (EDGE_BITS as u32 * axis) & inner;
            let wall = of_axis([0, 1, 2].map(|axis: usize| rays.wall[axis][lane]));
            let pace = of_axis([0, 1, 2].map(|axis: usize| rays.pace[axis][lane]));
            let walls = of_axis([0, 1, 2].map(|axis: usize| rays.walls[axis][lane]));
            // Of a wall that is crossed the position lies at the end or before: nothing wraps.
            layered.wall[lane] = wall.wrapping_add((inner - inside).wrapping_mul(pace));
            layered.pace[lane] = pace.wrapping_shl(sight.layer_bits);
            layered.walls[lane] = (inside + walls) >> sight.layer_bits;
        }
        layered
    }
}
