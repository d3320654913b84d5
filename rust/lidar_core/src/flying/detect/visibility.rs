//! Visibility of targets in one scan, for the tracker: whether a target is in the field of view and
//! not hidden.

use super::center::{Center, PassingRays, RaySource, TargetHit, TargetRay, TargetRegion};
use super::ray_groups::{GROUP, RayCone};
use crate::flying::analysis::PoseSpread;
use crate::flying::scan::prepared::Prepared;
use crate::flying::sky::source::SkySource;
use crate::flying::track::Visibility;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{dot, minus, norm};
use crate::util::vector_unit::dispatch;
use nalgebra::{Matrix3, Vector3};
use pulp::{Simd, WithSimd};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::OnceLock;

/// Relative margin for the early exclusion of rays: directions are unit vectors only up to
/// rounding.
const ROOM: f64 = 1e-6;
/// Number of rays that are tested side by side.
const LANES: usize = GROUP;
/// Number of rays that are tested before it is checked whether enough rays were found.
const ROWS_AT_A_TIME: usize = 4096;
const ROWS_PER_CHUNK: usize = 16_384; // fixed: chunk borders must not move with the thread count

/// The rays of one scan, as needed to decide whether targets were visible.
pub(crate) struct ScanView<'a> {
    scan: &'a Prepared,
    /// Radius of the smallest target that must be visible [m].
    target_radius: f64,
    /// Standard deviation of ranges [m].
    range_std: f64,
    /// Uncertainty of the pose. None if it is unknown.
    spread: Option<PoseSpread>,
    pool: Option<&'a ThreadPool>,
    /// Cones of the rays, each of [`GROUP`] rays that follow each other. Not computed for scans without targets.
    cones: OnceLock<Vec<RayCone>>,
}

impl<'a> ScanView<'a> {
    pub(crate) fn new(
        scan: &'a Prepared,
        target_radius: f64,
        range_std: f64,
        spread: Option<PoseSpread>,
        pool: Option<&'a ThreadPool>,
    ) -> Self {
        Self { scan, target_radius, range_std, spread, pool, cones: OnceLock::new() }
    }

    /// Centre of every target, given the indices of its points, of which there must be at least
    /// one. The pose counts as exact.
    pub(crate) fn centers_of(&self, targets: &[&[u32]]) -> Vec<Center> {
        self.observations(targets)
            .iter()
            .map(|observation| Center::of(observation, self.range_std))
            .collect()
    }

    /// Uncertainty of the pose. None if it is unknown.
    pub(crate) fn spread(&self) -> Option<&PoseSpread> {
        self.spread.as_ref()
    }

    /// True if the ray `row` ends in a ball or passes through it.
    fn passes(&self, row: usize, ball: &TestedBall) -> bool {
        let Some((direction, length)) = self.ray(row) else { return false };
        let (span, radius) = (minus(ball.middle, self.scan.origin(row)), ball.radius);
        let along = dot(span, direction);
        along > 0.0
            && dot(span, span) - along * along <= radius * radius
            && length >= along - radius
    }

    /// Vector along the ray `row` (not normalised), and its squared length up to the return or to
    /// the known free reach. None if there is no information about the ray.
    #[inline(always)]
    fn way(&self, row: usize) -> Option<([f64; 3], f64)> {
        if self.scan.no_return[row] {
            let way = wide(self.scan.directions.as_ref()?[row]);
            let reach = self.reach(row);
            let is_limited = reach.is_finite(); // its direction is a unit vector then
            let way = if is_limited { way.map(|part| reach * part) } else { way };
            return Some((way, reach * reach));
        }
        let way = minus(wide(self.scan.points[row]), self.scan.origin(row));
        let squared = dot(way, way);
        (squared > 0.0).then_some((way, squared))
    }

    /// Length up to which a ray without return is known to meet nothing [m].
    fn reach(&self, row: usize) -> f64 {
        self.scan.reach.as_ref().map_or(f64::INFINITY, |reach| f64::from(reach[row]))
    }

    /// Unit direction and length [m] of the ray `row`. None if there is no information about the
    /// ray.
    fn ray(&self, row: usize) -> Option<([f64; 3], f64)> {
        if self.scan.no_return[row] {
            let way = wide(self.scan.directions.as_ref()?[row]);
            let length = norm(way);
            return (length > 0.0).then(|| (way.map(|part| part / length), self.reach(row)));
        }
        let span = minus(wide(self.scan.points[row]), self.scan.origin(row));
        let length = norm(span);
        (length > 0.0).then(|| (span.map(|value| value / length), length))
    }
}

impl Visibility for ScanView<'_> {
    fn rays(&self, position: [f64; 3], radius: f64, most: usize) -> usize {
        let ball = TestedBall { middle: position, radius: radius.min(self.target_radius) };
        let (mut passing, rows) = (0, self.scan.points.len());
        for first in (0..rows).step_by(ROWS_AT_A_TIME) {
            let near = self.rows_near(first..rows.min(first + ROWS_AT_A_TIME), &[ball]);
            passing += near.filter(|&row| self.passes(row, &ball)).count();
            if passing >= most {
                return most;
            }
        }
        passing
    }

    fn centers(&self, targets: &[&[u32]]) -> Option<Vec<Center>> {
        let mut centers = self.centers_of(targets);
        if let Some(spread) = &self.spread {
            for center in &mut centers {
                center.covariance += Matrix3::from(spread.at(center.position.into())); // symmetric
            }
        }
        Some(centers)
    }
}

impl RaySource for ScanView<'_> {
    fn hit(&self, row: usize) -> TargetHit {
        TargetHit::new(self.scan.origin(row), wide(self.scan.points[row]))
    }

    fn around(&self, regions: &[TargetRegion]) -> Vec<PassingRays> {
        let rows = self.scan.points.len();
        let mut around = vec![PassingRays::default(); regions.len()];
        if regions.is_empty() {
            return around;
        }
        let chunk = |chunk: usize| {
            let first = chunk * ROWS_PER_CHUNK;
            self.around_in(first..rows.min(first + ROWS_PER_CHUNK), regions)
        };
        let chunks = 0..rows.div_ceil(ROWS_PER_CHUNK);
        let parts: Vec<Vec<PassingRays>> = match self.pool {
            Some(pool) => pool.install(|| chunks.into_par_iter().map(chunk).collect()),
            None => chunks.map(chunk).collect(),
        };
        for part in parts {
            for (all, mut more) in around.iter_mut().zip(part) {
                all.passing.append(&mut more.passing);
                all.missed.append(&mut more.missed);
                all.n_blocked += more.n_blocked;
                all.hiding.append(&mut more.hiding);
            }
        }
        around
    }
}

impl ScanView<'_> {
    /// For every region, the rays among `rows` that come near it.
    fn around_in(&self, rows: Range<usize>, regions: &[TargetRegion]) -> Vec<PassingRays> {
        let casts = |row: usize| !self.scan.no_ray.as_ref().is_some_and(|no_ray| no_ray[row]);
        let is_own = |row: usize| self.scan.maybe_own.get(row).copied().unwrap_or(false);
        let ball = |region: &TargetRegion| TestedBall {
            middle: region.middle.into(),
            radius: region.reach(),
        };
        let balls: Vec<TestedBall> = regions.iter().map(ball).collect();
        let mut around = vec![PassingRays::default(); regions.len()];
        for row in self.rows_near(rows, &balls) {
            let Some((way, squared)) = self.way(row) else { continue };
            let origin = self.scan.origin(row);
            let ray = || {
                let (origin, way) = (Vector3::from(origin), Vector3::from(way));
                TargetRay { origin, direction: way.normalize() }
            };
            for (ball, rays) in balls.iter().zip(&mut around) {
                match ball.end(origin, way, squared) {
                    Some(End::Behind) if casts(row) => {
                        rays.passing.push(ray());
                        if !self.scan.no_return[row] || self.scan.sky != SkySource::Density {
                            rays.missed.push(ray());
                        }
                    }
                    Some(End::InFront) if !self.scan.no_return[row] => {
                        rays.n_blocked += 1;
                        if casts(row) && !is_own(row) {
                            rays.hiding.push(ray());
                        }
                    }
                    _ => {}
                }
            }
        }
        around
    }

    /// Indices of rays among `rows` (at most one chunk) that come near one of the balls. A few
    /// other rays may be among them.
    fn rows_near(
        &self,
        rows: Range<usize>,
        balls: &[TestedBall],
    ) -> impl Iterator<Item = usize> + use<> {
        let (first, lanes) = (rows.start, 0..LANES);
        let cones = &self.cones()[first / GROUP..];
        let near = dispatch(FindNearRays { view: self, rows, balls, cones });
        let some = (first..).step_by(LANES).zip(near).filter(|(_, flags)| *flags != 0);
        some.flat_map(move |(first, flags)| {
            lanes.clone().filter(move |lane| flags >> lane & 1 == 1).map(move |lane| first + lane)
        })
    }

    /// Cones of all rays of the scan.
    fn cones(&self) -> &[RayCone] {
        self.cones.get_or_init(|| {
            let rows = self.scan.points.len();
            let mut rays = Vec::with_capacity(GROUP);
            let cone = |first: usize| {
                rays.clear();
                let known = (first..rows.min(first + GROUP))
                    .filter_map(|row| Some((self.scan.origin(row), self.way(row)?.0)));
                rays.extend(known);
                RayCone::of(&rays)
            };
            (0..rows).step_by(GROUP).map(cone).collect()
        })
    }

    #[inline(always)]
    fn lanes(&self, rows: Range<usize>) -> RayLanes {
        let mut lanes = RayLanes { origins: [[0.0; LANES]; 3], ways: [[f64::NAN; LANES]; 3] };
        for (lane, row) in rows.enumerate() {
            let Some((way, _)) = self.way(row) else { continue };
            let origin = self.scan.origin(row);
            for axis in 0..3 {
                lanes.origins[axis][lane] = origin[axis];
                lanes.ways[axis][lane] = way[axis];
            }
        }
        lanes
    }
}

/// Search for rays that come near one of some balls, on the vector unit of the machine.
struct FindNearRays<'a> {
    view: &'a ScanView<'a>,
    rows: Range<usize>,
    balls: &'a [TestedBall],
    /// Cones of `rows` and of the rays behind them.
    cones: &'a [RayCone],
}

/// One bit for every ray of a chunk.
type RowBits = [u32; ROWS_PER_CHUNK / LANES];

impl WithSimd for FindNearRays<'_> {
    type Output = RowBits;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> RowBits {
        let mut all = [0; ROWS_PER_CHUNK / LANES];
        let groups = self.rows.clone().step_by(LANES).zip(&mut all).zip(self.cones);
        for ((first, flags), cone) in groups {
            if !self.balls.iter().any(|ball| cone.may_meet(ball.middle, ball.radius)) {
                continue;
            }
            let lanes = self.view.lanes(first..self.rows.end.min(first + LANES));
            let near = lanes.near(self.balls);
            for (lane, near) in near.into_iter().enumerate() {
                *flags |= u32::from(near != 0) << lane;
            }
        }
        all
    }
}

/// Start points and directions of rays. The direction is NaN for rays without information.
struct RayLanes {
    origins: [[f64; LANES]; 3],
    ways: [[f64; LANES]; 3],
}

impl RayLanes {
    /// Not 0 for rays whose lines come near a ball in front of them, as in [`TestedBall::end`].
    #[inline(always)]
    fn near(&self, balls: &[TestedBall]) -> [u64; LANES] {
        let mut near = [0; LANES];
        for TestedBall { middle, radius } in balls {
            for (lane, near) in near.iter_mut().enumerate() {
                let span = std::array::from_fn(|axis| middle[axis] - self.origins[axis][lane]);
                let way = std::array::from_fn(|axis| self.ways[axis][lane]);
                let (along, apart) = (dot(span, way), dot(span, span) * (1.0 - ROOM));
                let is_near = (apart - radius * radius) * dot(way, way) <= along * along;
                *near |= u64::from((along > 0.0) & is_near);
            }
        }
        near
    }
}

/// A ball against which rays are tested.
#[derive(Clone, Copy)]
struct TestedBall {
    middle: [f64; 3],
    radius: f64,
}

impl TestedBall {
    /// Where a ray ends. `way`: vector along the ray; `squared`: the squared length of the ray,
    /// infinite if it met nothing. None for rays that do not meet the ball, or end in it.
    fn end(&self, origin: [f64; 3], way: [f64; 3], squared: f64) -> Option<End> {
        let span = minus(self.middle, origin);
        let (along, apart) = (dot(span, way), dot(span, span) - self.radius * self.radius);
        if along <= 0.0 || apart * dot(way, way) > along * along {
            return None;
        }
        if squared.is_infinite() {
            return Some(End::Behind);
        }
        let margin = squared.sqrt() * self.radius;
        match squared {
            _ if squared > along + margin => Some(End::Behind),
            _ if squared < along - margin => Some(End::InFront),
            _ => None,
        }
    }
}

/// Position of the end of a ray relative to a ball that its line meets.
enum End {
    InFront,
    Behind,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::track::ENOUGH_RAYS;
    use crate::geometry::transform::Transform;

    #[test]
    fn directions_of_rays_without_return_may_have_any_length() {
        for length in [0.25, 1.0, 2.0] {
            let mut scan = Prepared::default();
            scan.points = vec![[f32::NAN; 3]; ENOUGH_RAYS];
            scan.directions = Some(vec![[length, 0.0, 0.0]; ENOUGH_RAYS]);
            scan.no_return = vec![true; ENOUGH_RAYS];
            scan.pose = Transform::IDENTITY;
            let view = ScanView::new(&scan, 1.0, 0.01, None, None);
            assert!(view.expected([10.0, 0.5, 0.0], 1.0));
            assert!(!view.expected([10.0, 1.5, 0.0], 1.0));
            assert!(!view.expected([-10.0, 0.0, 0.0], 1.0));
        }
    }
}
