//! Observation of a target by one scan: the rays that hit it, and those that passed beside it.

use super::Vector3;
use std::cmp::Ordering;
use std::f64::consts::TAU;

/// Rays are looked at as far beside the points as this [m].
pub(crate) const MARGIN: f64 = 0.4;
/// Rays at most this far beside the points are compared with a ball [m].
const NEAR: f64 = 0.15;
/// So many rays that end in front may hide a part of the target: one alone is a speck of dust.
const ENOUGH_BLOCKED: usize = 2;
/// Sectors around a target in which the nearest ray beside it is looked for.
const SECTORS: usize = 8;

/// A ray from a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TargetRay {
    pub(crate) origin: Vector3<f64>,
    /// Unit vector.
    pub(crate) direction: Vector3<f64>,
}

/// A ray that hit the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TargetHit {
    pub(crate) ray: TargetRay,
    pub(crate) point: Vector3<f64>,
}

/// Observation of one target in one scan.
#[derive(Clone, Debug)]
pub(crate) struct TargetObservation {
    /// At least one.
    pub(crate) hits: Vec<TargetHit>,
    /// Rays that went past the target, on either side and through its gaps.
    pub(crate) passing: Vec<TargetRay>,
    /// True if rays beside the points ended nearer, so that a part of the target may be hidden.
    pub(crate) is_cut: bool,
    /// True if the nearest ray beside it, to a side or above, ends in front of it: it ends at the edge of that.
    pub(crate) is_at_edge: bool,
    /// Number of `passing` rays, the first ones, that are near the points.
    n_near: usize,
}

/// Search region for rays that pass a target.
#[derive(Clone, Debug)]
pub(crate) struct TargetRegion {
    /// Middle of the box around its points [m].
    pub(crate) middle: Vector3<f64>,
    /// Radius of a ball around the points [m].
    pub(crate) radius: f64,
}

/// Rays that pass near a region, and those that end before it.
#[derive(Clone, Debug, Default)]
pub(crate) struct PassingRays {
    /// Rays that passed the target and went on behind it.
    pub(crate) passing: Vec<TargetRay>,
    /// Number of rays that ended in front of the target.
    pub(crate) n_blocked: usize,
    /// Rays that end in front of the region and surely not on the robot itself.
    pub(crate) hiding: Vec<TargetRay>,
}

/// Rays of a scan, by target and by region.
pub(crate) trait RaySource {
    /// The hit of a row that has a point.
    fn hit(&self, row: usize) -> TargetHit;
    /// For every region, the rays that come within [`MARGIN`] of it.
    fn around(&self, regions: &[TargetRegion]) -> Vec<PassingRays>;

    /// Observations of targets, given the rows of their points, none of them empty.
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
    /// Offset of `point` from the nearest place on the line of the ray.
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

    /// Largest distance from the middle at which a ray is looked at [m].
    pub(crate) fn reach(&self) -> f64 {
        self.radius + MARGIN
    }

    /// Sectors around the middle, with how far the points reach in each.
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

/// Sectors around a place, across the line of sight.
struct Sectors<'a> {
    middle: &'a Vector3<f64>,
    /// Unit vectors across the line of sight: to the left, and upwards.
    axes: [Vector3<f64>; 2],
    /// Distance of the outermost point of the target in each sector [m].
    reach: [f64; SECTORS],
    /// Height of its lowest point above the middle [m].
    lowest: f64,
}

impl Sectors<'_> {
    /// Sector in which a ray passes the middle, its distance from it, and its height above it [m].
    fn of(&self, ray: &TargetRay) -> (usize, f64, f64) {
        let place = -ray.aside(self.middle);
        let [left, up] = self.axes.map(|axis| axis.dot(&place));
        let turn = libm::atan2(up, left) / TAU + 0.5; // from the right, by way of below
        (((turn * SECTORS as f64) as usize).min(SECTORS - 1), libm::hypot(left, up), up)
    }

    /// Rays beyond the points in each sector: the distance of the nearest [m], and their number. Rays below the lowest
    /// point do not count: the ground in front of a low target, or a wall below it, hides nothing of it.
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

    /// True if in a sector the nearest ray ends in front, and not only that one.
    fn is_any_hidden(&self, passing: &[TargetRay], hiding: &[TargetRay]) -> bool {
        let (passing, hiding) = (self.beyond(passing), self.beyond(hiding));
        hiding
            .iter()
            .zip(passing)
            .any(|(hiding, passing)| hiding.1 >= ENOUGH_BLOCKED && hiding.0 < passing.0)
    }
}

impl TargetObservation {
    /// An observation whose hits and rays are sorted: results do not depend on their order.
    pub(crate) fn new(mut hits: Vec<TargetHit>, around: PassingRays) -> Self {
        let PassingRays { mut passing, n_blocked, hiding } = around;
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
        Self { hits, passing: sorted, is_cut: n_blocked >= ENOUGH_BLOCKED, is_at_edge, n_near }
    }

    pub(super) fn near_passing(&self) -> &[TargetRay] {
        &self.passing[..self.n_near]
    }

    /// Mean of where its rays start [m].
    pub(crate) fn origin(&self) -> Vector3<f64> {
        self.hits.iter().map(|hit| hit.ray.origin).sum::<Vector3<f64>>() / self.hits.len() as f64
    }
}

fn order(one: &Vector3<f64>, other: &Vector3<f64>) -> Ordering {
    let by = |axis: usize| one[axis].total_cmp(&other[axis]);
    by(0).then_with(|| by(1)).then_with(|| by(2))
}
