//! Observation of a target by one scan: the rays that hit it, and those that passed beside it.

use super::Vector3;
use std::cmp::Ordering;
use std::f64::consts::TAU;

/// Distance beside the points up to which rays are looked at [m].
pub(crate) const MARGIN: f64 = 0.4;
/// Distance beside the points up to which rays are compared with a ball [m].
const NEAR: f64 = 0.15;
/// Number of rays ending in front of a target that show that a part of it may be hidden. A single
/// one may be a speck of dust.
const ENOUGH_BLOCKED: usize = 2;
/// Number of sectors around a target. The search finds the nearest ray beside the target in each
/// sector.
const SECTORS: usize = 8;

/// A ray of a sensor: start point [m] and direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TargetRay {
    pub(crate) origin: Vector3<f64>,
    /// Direction of the ray: unit vector.
    pub(crate) direction: Vector3<f64>,
}

/// A ray that hit the target, and its end point [m], in the frame of the ray's start point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TargetHit {
    pub(crate) ray: TargetRay,
    pub(crate) point: Vector3<f64>,
}

/// Observation of a target by one scan.
#[derive(Clone, Debug)]
pub(crate) struct TargetObservation {
    /// Rays that hit the target; at least one.
    pub(crate) hits: Vec<TargetHit>,
    /// Rays that passed the target, beside it or through its gaps.
    pub(crate) passing: Vec<TargetRay>,
    /// Those of the `passing` rays that were certainly cast. Where the sky is estimated by its density, these are the
    /// rays that returned from behind the target.
    pub(super) missed: Vec<TargetRay>,
    /// Rays near the target that end in front of it, and certainly not on the robot itself.
    pub(super) hiding: Vec<TargetRay>,
    /// Whether rays beside the points ended nearer to the sensor, so that a part of the target may
    /// be hidden.
    pub(crate) is_cut: bool,
    /// Whether the target ends at the edge of a nearer object: the nearest ray beside it, to a side
    /// or above, ends in front of it.
    pub(crate) is_at_edge: bool,
    /// Number of `passing` rays near the points. These are the first ones.
    n_near: usize,
}

/// Region around a target in which passing rays are searched for.
#[derive(Clone, Debug)]
pub(crate) struct TargetRegion {
    /// Middle of the box around its points [m].
    pub(crate) middle: Vector3<f64>,
    /// Radius of a ball around the middle that contains the points [m].
    pub(crate) radius: f64,
}

/// Rays that pass near a region, and rays that end before it.
#[derive(Clone, Debug, Default)]
pub(crate) struct PassingRays {
    /// Rays that passed the target and went on behind it.
    pub(crate) passing: Vec<TargetRay>,
    /// Those of the `passing` rays that were certainly cast. Where the sky is estimated by its density, these are the
    /// rays that returned from behind the target.
    pub(crate) missed: Vec<TargetRay>,
    /// Number of rays that ended in front of the target.
    pub(crate) n_blocked: usize,
    /// Rays that end in front of the region, and certainly not on the robot itself.
    pub(crate) hiding: Vec<TargetRay>,
}

/// Source of the rays of a scan: by the index of a point, and by region.
pub(crate) trait RaySource {
    /// The ray of the point with the index `row`.
    fn hit(&self, row: usize) -> TargetHit;
    /// For every region, the rays that come within [`MARGIN`] of it.
    fn around(&self, regions: &[TargetRegion]) -> Vec<PassingRays>;

    /// Observation of each target, given the indices of its points, of which there must be at least
    /// one.
    fn observations(&self, targets: &[&[u32]]) -> Vec<TargetObservation> {
        let hits: Vec<Vec<TargetHit>> = targets
            .iter()
            .map(|rows| rows.iter().map(|&row| self.hit(row as usize)).collect())
            .collect();
        let regions: Vec<TargetRegion> = hits.iter().map(|hits| TargetRegion::of(hits)).collect();
        let around = self.around(&regions);
        hits.into_iter()
            .zip(around)
            .map(|(hits, around)| TargetObservation::new(hits, around))
            .collect()
    }
}

impl TargetRay {
    /// Offset of `point` from the nearest point on the line of the ray [m].
    pub(crate) fn aside(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let span = point - self.origin;
        span - self.direction * span.dot(&self.direction)
    }
}

impl TargetHit {
    pub(crate) fn new(origin: [f64; 3], point: [f64; 3]) -> Self {
        let (origin, point) = (Vector3::from(origin), Vector3::from(point));
        let direction = (point - origin).try_normalize(f64::MIN_POSITIVE);
        Self { ray: TargetRay { origin, direction: direction.unwrap_or(Vector3::x()) }, point }
    }
}

impl TargetRegion {
    pub(crate) fn of(hits: &[TargetHit]) -> Self {
        let (mut low, mut high) = (Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN));
        for hit in hits {
            low = low.inf(&hit.point);
            high = high.sup(&hit.point);
        }
        Self { middle: 0.5 * (low + high), radius: 0.5 * (high - low).norm() }
    }

    /// Largest distance from the middle up to which rays are looked at [m].
    pub(crate) fn reach(&self) -> f64 {
        self.radius + MARGIN
    }

    /// Sectors around the middle, with the distance up to which points reach in each.
    fn sectors_of(&self, hits: &[TargetHit]) -> Sectors<'_> {
        let sight = (self.middle - hits[0].ray.origin).normalize();
        let across = Vector3::z().cross(&sight).try_normalize(1e-6).unwrap_or(Vector3::x());
        let axes = [across, sight.cross(&across)];
        let middle = &self.middle;
        let mut sectors = Sectors { middle, axes, reach: [0.0; SECTORS], lowest: f64::INFINITY };
        for hit in hits {
            let (sector, away, up) = sectors.of(&hit.ray);
            sectors.reach[sector] = sectors.reach[sector].max(away);
            sectors.lowest = sectors.lowest.min(up);
        }
        sectors
    }
}

/// Sectors around the middle of a target, in the plane across the line of sight.
struct Sectors<'a> {
    middle: &'a Vector3<f64>,
    /// Unit vectors across the line of sight: horizontal, and upwards.
    axes: [Vector3<f64>; 2],
    /// Distance of the outermost point of the target in each sector [m].
    reach: [f64; SECTORS],
    /// Height of the lowest point of the target above the middle [m].
    lowest: f64,
}

impl Sectors<'_> {
    /// Sector in which a ray passes the middle, distance from the middle, and height above it [m].
    fn of(&self, ray: &TargetRay) -> (usize, f64, f64) {
        let place = -ray.aside(self.middle);
        let [left, up] = self.axes.map(|axis| axis.dot(&place));
        let turn = libm::atan2(up, left) / TAU + 0.5; // from the right, by way of below
        (((turn * SECTORS as f64) as usize).min(SECTORS - 1), libm::hypot(left, up), up)
    }

    /// For each sector, the distance of the nearest ray beyond the points [m], and the number of
    /// such rays. Rays below the lowest point do not count: the ground in front of a low target, or
    /// a wall below it, hides nothing of it.
    fn beyond(&self, rays: &[TargetRay]) -> [(f64, usize); SECTORS] {
        let mut beyond = [(f64::INFINITY, 0); SECTORS];
        for (sector, away, up) in rays.iter().map(|ray| self.of(ray)) {
            if away > self.reach[sector] && up >= self.lowest {
                let (nearest, count) = &mut beyond[sector];
                (*nearest, *count) = (nearest.min(away), *count + 1);
            }
        }
        beyond
    }

    /// True if, in some sector, the ray nearest to the target ends in front of it, and at least one
    /// other does too.
    fn is_any_hidden(&self, passing: &[TargetRay], hiding: &[TargetRay]) -> bool {
        let (passing, hiding) = (self.beyond(passing), self.beyond(hiding));
        hiding
            .iter()
            .zip(passing)
            .any(|(hiding, passing)| hiding.1 >= ENOUGH_BLOCKED && hiding.0 < passing.0)
    }
}

impl TargetObservation {
    /// An observation with sorted hits and rays, so that results do not depend on their order.
    pub(crate) fn new(mut hits: Vec<TargetHit>, around: PassingRays) -> Self {
        let PassingRays { mut passing, missed, n_blocked, hiding } = around;
        let region = TargetRegion::of(&hits);
        hits.sort_by(|one, other| order(&one.point, &other.point));
        let is_at_edge = region.sectors_of(&hits).is_any_hidden(&passing, &hiding);
        passing.sort_unstable_by(|one, other| {
            let by_origin = || order(&one.origin, &other.origin);
            order(&one.direction, &other.direction).then_with(by_origin)
        });
        let is_near = |ray: &&TargetRay| ray.aside(&region.middle).norm() <= region.radius + NEAR;
        let mut sorted = Vec::with_capacity(passing.len());
        sorted.extend(passing.iter().filter(is_near));
        let n_near = sorted.len();
        sorted.extend(passing.iter().filter(|ray| !is_near(ray)));
        let is_cut = n_blocked >= ENOUGH_BLOCKED;
        Self { hits, passing: sorted, missed, hiding, is_cut, is_at_edge, n_near }
    }

    pub(super) fn near_passing(&self) -> &[TargetRay] {
        &self.passing[..self.n_near]
    }

    /// Mean of the start points of the rays that hit the target [m].
    pub(crate) fn origin(&self) -> Vector3<f64> {
        self.hits.iter().map(|hit| hit.ray.origin).sum::<Vector3<f64>>() / self.hits.len() as f64
    }
}

fn order(one: &Vector3<f64>, other: &Vector3<f64>) -> Ordering {
    let by = |axis: usize| one[axis].total_cmp(&other[axis]);
    by(0).then_with(|| by(1)).then_with(|| by(2))
}
