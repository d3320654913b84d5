//! What one scan could see, for the tracker: is a target in the field of view and not hidden?

use super::analysis::PoseSpread;
use super::center::{Around, Center, Hit, Ray, Region, SightSource};
use super::scan::Prepared;
use super::track::Visibility;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{dot, minus, norm};
use nalgebra::{Matrix3, Vector3};

/// Rays that must pass, so that a target in the ball should have given returns.
const ENOUGH: usize = 3;

/// The rays of one scan.
pub(crate) struct ScanView<'a> {
    scan: &'a Prepared,
    /// Radius of the smallest target that must be seen [m].
    target_radius: f64,
    /// Noise of ranges [m].
    range_std: f64,
    /// Noise of the pose, if it is known.
    spread: Option<PoseSpread>,
}

impl<'a> ScanView<'a> {
    pub(crate) fn new(
        scan: &'a Prepared,
        target_radius: f64,
        range_std: f64,
        spread: Option<PoseSpread>,
    ) -> Self {
        Self { scan, target_radius, range_std, spread }
    }

    /// Centres of targets, given the rows of their points, none of them empty; the pose counts as
    /// exact.
    pub(crate) fn centers_of(&self, targets: &[&[u32]]) -> Vec<Center> {
        self.sights(targets).iter().map(|sight| Center::of(sight, self.range_std)).collect()
    }

    /// Noise of the pose, if it is known.
    pub(crate) fn spread(&self) -> Option<&PoseSpread> {
        self.spread.as_ref()
    }

    /// Way and length of the ray `row`, not normalised; None where it tells nothing.
    fn way(&self, row: usize) -> Option<([f64; 3], f64)> {
        if self.scan.no_return[row] {
            return Some((wide(self.scan.directions.as_ref()?[row]), f64::INFINITY));
        }
        let way = minus(wide(self.scan.points[row]), self.scan.origins[row]);
        let squared = dot(way, way);
        (squared > 0.0).then_some((way, squared))
    }

    /// Unit direction and length of the ray `row`; None where it tells nothing.
    fn ray(&self, row: usize) -> Option<([f64; 3], f64)> {
        if self.scan.no_return[row] {
            let direction = self.scan.directions.as_ref()?[row];
            return Some((wide(direction), f64::INFINITY));
        }
        let span = minus(wide(self.scan.points[row]), self.scan.origins[row]);
        let length = norm(span);
        (length > 0.0).then(|| (span.map(|value| value / length), length))
    }
}

impl Visibility for ScanView<'_> {
    fn expected(&self, position: [f64; 3], radius: f64) -> bool {
        let radius = radius.min(self.target_radius);
        let passes = |row: usize| {
            let Some((direction, length)) = self.ray(row) else { return false };
            let span = minus(position, self.scan.origins[row]);
            let along = dot(span, direction);
            along > 0.0
                && dot(span, span) - along * along <= radius * radius
                && length >= along - radius
        };
        (0..self.scan.points.len()).filter(|&row| passes(row)).take(ENOUGH).count() == ENOUGH
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

impl SightSource for ScanView<'_> {
    fn hit(&self, row: usize) -> Hit {
        Hit::new(self.scan.origins[row], wide(self.scan.points[row]))
    }

    fn around(&self, regions: &[Region]) -> Vec<Around> {
        let mut around = vec![Around::default(); regions.len()];
        if regions.is_empty() {
            return around;
        }
        let casts = |row: usize| !self.scan.no_ray.as_ref().is_some_and(|no_ray| no_ray[row]);
        for row in 0..self.scan.points.len() {
            let Some((way, squared)) = self.way(row) else { continue };
            for (region, rays) in regions.iter().zip(&mut around) {
                match End::of(region, self.scan.origins[row], way, squared) {
                    Some(End::Behind) if casts(row) => {
                        let origin = Vector3::from(self.scan.origins[row]);
                        rays.passing
                            .push(Ray { origin, direction: Vector3::from(way).normalize() });
                    }
                    Some(End::InFront) => rays.n_blocked += 1,
                    _ => {}
                }
            }
        }
        around
    }
}

/// Where a ray ends that comes near a region.
enum End {
    InFront,
    Behind,
}

impl End {
    /// `squared` is the length of `way` squared, infinite if the ray met nothing; None for rays
    /// that stay away from the region or end in it.
    fn of(region: &Region, origin: [f64; 3], way: [f64; 3], squared: f64) -> Option<Self> {
        let span = minus(region.middle.into(), origin);
        let along = dot(span, way);
        let (reach, unit) = (region.reach(), dot(way, way));
        if along <= 0.0 || (dot(span, span) - reach * reach) * unit > along * along {
            return None;
        }
        if squared.is_infinite() {
            return Some(Self::Behind);
        }
        let margin = squared.sqrt() * reach;
        match squared {
            _ if squared > along + margin => Some(Self::Behind),
            _ if squared < along - margin => Some(Self::InFront),
            _ => None,
        }
    }
}
