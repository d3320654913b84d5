//! Stretches of rays through bricks that hold a voxel which rays may change.
//!
//! Walls of bricks are every fourth wall of the voxels, at the same positions, and are crossed in the
//! same order. So a bundle walks from brick to brick as it walks from voxel to voxel, and its way
//! through live bricks is cut out. Such a stretch begins and ends with the crossing of a wall. The walls
//! that lie before it along every axis are counted by one division, exactly: a stretch visits the
//! voxels that the whole ray visits there, with the same lengths.

use super::accumulate::live_bricks::{INSIDE, LiveBricks};
use super::accumulate::window::Window;
use super::ray_lanes::{Bundle, BundleWay, NEVER, vectors};
use super::ray_segments::{LANES, Lanes};
use crate::flying::map::blocks::{EDGE_BITS, VOLUME};
use crate::flying::map::inert::BRICK_BITS;
use crate::geometry::lattice::whole;
use pulp::Simd;

/// Bricks of a ray that are looked at together: a bit each.
const BRICKS: usize = 64;
/// Lowest bit of the axes in what is noted of a brick; its place lies below.
const AXES: u32 = 30;
/// Distance of walls that lie as far apart as a ray is long.
const FAR: u32 = 1 << 31;

/// Crossing of a wall: its position along the ray, and the number of axes whose walls at this position
/// have been crossed, the lowest axes first. Before all walls: 0, 0.
#[derive(Clone, Copy)]
struct Crossing {
    at: u32,
    axes: u32,
}

/// Part of a ray.
#[derive(Clone, Copy)]
struct Stretch {
    /// Number of the ray.
    ray: u32,
    from: Crossing,
    /// Crossing into the first voxel behind it; None: it goes on to the end of the ray.
    to: Option<Crossing>,
}

/// Rays side by side, and their stretches.
#[derive(Default)]
pub(crate) struct Stretches {
    rays: Vec<Bundle>,
    stretches: Vec<Stretch>,
    noted: Noted,
}

/// What is noted of bricks along the rays, step by step; the last one has only been entered.
struct Noted {
    /// Position at which the ray entered the brick.
    entered: [Lanes; BRICKS + 1],
    /// Place of the brick, and axes of the crossing.
    place: [Lanes; BRICKS + 1],
}

impl Default for Noted {
    fn default() -> Self {
        Self { entered: [[0; LANES]; BRICKS + 1], place: [[0; LANES]; BRICKS + 1] }
    }
}

impl Stretches {
    /// Forget all rays.
    pub(super) fn clear(&mut self) {
        self.rays.clear();
        self.stretches.clear();
    }

    /// Number of stretches.
    pub(super) fn len(&self) -> usize {
        self.stretches.len()
    }

    /// Find the stretches of `rays` through `live` bricks.
    #[inline(always)]
    pub(super) fn find<S: Simd, const K: usize>(
        &mut self,
        simd: S,
        window: &Window,
        live: &LiveBricks,
        rays: Bundle,
    ) {
        let coarse = Coarse::of(&rays);
        let mut search = BrickSearch::<S, K>::new(simd, window, &coarse);
        let most = coarse.bricks.into_iter().max().unwrap_or(0) as usize;
        for first in (0..most).step_by(BRICKS) {
            let steps = BRICKS.min(most - first);
            for step in 0..steps {
                search.note(simd, &mut self.noted, step);
                search.go_on(simd);
            }
            search.note(simd, &mut self.noted, steps);
            for (lane, &bricks) in coarse.bricks.iter().enumerate() {
                let left = (bricks as usize).saturating_sub(first).min(steps);
                self.cut(live, lane, left, bricks as usize <= first + steps);
            }
        }
        self.rays.push(rays);
    }

    /// Cut out what lies in live bricks, of the `len` bricks of a ray that were noted. `is_last`: the ray
    /// ends in the last of them.
    #[inline(always)]
    fn cut(&mut self, live: &LiveBricks, lane: usize, len: usize, is_last: bool) {
        let Noted { entered, place } = &self.noted;
        let mut bits = (0..len).fold(0, |bits, step| {
            let brick = place[step][lane] & ((1 << AXES) - 1);
            bits | live.is_live(brick) << step
        });
        let ray = (self.rays.len() * LANES + lane) as u32;
        let crossing =
            |step: usize| Crossing { at: entered[step][lane], axes: place[step][lane] >> AXES };
        while bits != 0 {
            let first = bits.trailing_zeros() as usize;
            let behind = first + (!(bits >> first)).trailing_zeros() as usize;
            let to = (behind < len || !is_last).then(|| crossing(behind));
            self.stretches.push(Stretch { ray, from: crossing(first), to });
            bits &= u64::MAX.checked_shl(behind as u32).unwrap_or(0);
        }
    }

    /// Stretches from `first` on as a bundle.
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

/// Move the rays of a bundle along an axis to the crossing where their stretches begin, and count the
/// walls that these cross.
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

/// Rays between the walls of bricks.
struct Coarse {
    wall: [Lanes; 3],
    pace: [Lanes; 3],
    place: Lanes,
    mirror: Lanes,
    /// Bricks that every ray meets.
    bricks: Lanes,
}

impl Coarse {
    #[inline(always)]
    fn of(rays: &Bundle) -> Self {
        const INNER: u32 = (1 << BRICK_BITS) - 1;
        let mut coarse = Self {
            wall: [[NEVER; LANES]; 3],
            pace: [[0; LANES]; 3],
            place: rays.place.map(brick_place),
            mirror: rays.mirror.map(brick_place),
            bricks: [0; LANES],
        };
        for axis in 0..3 {
            for lane in 0..LANES {
                let (wall, pace) = (rays.wall[axis][lane], rays.pace[axis][lane]);
                let inside = rays.place[lane] >> (EDGE_BITS as usize * axis) & INNER;
                let walls = rays.walls[axis][lane];
                let bricks = (inside + walls) >> BRICK_BITS;
                // Of a wall that is crossed the position lies at the end or before: nothing wraps.
                let first = wall.wrapping_add((INNER - inside).wrapping_mul(pace));
                coarse.wall[axis][lane] = if bricks > 0 { first } else { NEVER };
                // Walls further apart than a ray is long must not wrap to a position on it.
                let wide = pace.wrapping_shl(BRICK_BITS);
                coarse.pace[axis][lane] = if pace < FAR >> BRICK_BITS { wide } else { FAR };
                coarse.bricks[lane] = coarse.bricks[lane].wrapping_add(bricks);
            }
        }
        for lane in 0..LANES {
            // None of rays that only fill the bundle.
            let bricks = coarse.bricks[lane].wrapping_add(1);
            coarse.bricks[lane] = if rays.visits[lane] > 0 { bricks } else { 0 };
        }
        coarse
    }
}

/// Place of the brick that holds a voxel, both in the window: that of its block, and three bits.
#[inline(always)]
fn brick_place(voxel: u32) -> u32 {
    let half = |axis: u32| voxel >> (EDGE_BITS as u32 * axis + BRICK_BITS) & 1;
    (voxel / VOLUME as u32) << INSIDE | half(2) << 2 | half(1) << 1 | half(0)
}

/// State of a bundle that walks from brick to brick.
struct BrickSearch<S: Simd, const K: usize> {
    way: BundleWay<S, K>,
    mirror: [S::u32s; K],
    bricks: [S::u32s; K],
    step: S::u32s,
    /// Position at which the ray entered its brick.
    entered: [S::u32s; K],
    /// Axes of that crossing, at their place in what is noted.
    axes: [S::u32s; K],
}

impl<S: Simd, const K: usize> BrickSearch<S, K> {
    #[inline(always)]
    fn new(simd: S, window: &Window, coarse: &Coarse) -> Self {
        let bits = |axis: usize| simd.splat_u32s(brick_place(window.bits_along(axis)));
        let none = simd.splat_u32s(0);
        Self {
            way: BundleWay {
                wall: std::array::from_fn(|axis| vectors::<S, K>(&coarse.wall[axis])),
                pace: std::array::from_fn(|axis| vectors::<S, K>(&coarse.pace[axis])),
                place: vectors::<S, K>(&coarse.place),
                bits: std::array::from_fn(bits),
            },
            mirror: vectors::<S, K>(&coarse.mirror),
            bricks: vectors::<S, K>(&coarse.bricks),
            step: none,
            entered: [none; K],
            axes: [none; K],
        }
    }

    /// Write down the bricks that the rays are in. Rays that have arrived are in the first one.
    #[inline(always)]
    fn note(&self, simd: S, noted: &mut Noted, step: usize) {
        let none = simd.splat_u32s(0);
        let places = S::as_mut_simd_u32s(&mut noted.place[step]).0;
        let entered = S::as_mut_simd_u32s(&mut noted.entered[step]).0;
        for k in 0..K {
            let going = simd.greater_than_u32s(self.bricks[k], self.step);
            let here = simd.xor_u32s(self.way.place[k], self.mirror[k]);
            let here = simd.select_u32s(going, here, none);
            places[k] = simd.or_u32s(here, self.axes[k]);
            entered[k] = self.entered[k];
        }
    }

    /// Go on to the next bricks.
    #[inline(always)]
    fn go_on(&mut self, simd: S) {
        let axes = [1, 2, 3].map(|axes| simd.splat_u32s(axes << AXES));
        for k in 0..K {
            let first = self.way.first_wall(simd, k);
            let [along_x, along_y] = self.way.cross(simd, k, first);
            let other = simd.select_u32s(along_y, axes[1], axes[2]);
            self.axes[k] = simd.select_u32s(along_x, axes[0], other);
            self.entered[k] = first;
        }
        self.step = simd.add_u32s(self.step, simd.splat_u32s(1));
    }
}
