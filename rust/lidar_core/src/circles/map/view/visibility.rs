//! Visibility of a place in a scan: seen through, occupied, or hidden.

use super::piece::SurfacePiece;
use crate::Error;
use crate::circles::fit::circle::Circle;
use crate::circles::preprocess::polar_scan::{PolarScan, turn};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::ops::Range;
use std::sync::OnceLock;

use crate::circles::map::parameters::VisibilityTest;

/// Cosine of the angle of incidence on a line below which a ray is not used.
const GRAZING: f64 = 0.2;

/// A scan in the level frame, with its range limits.
#[derive(Clone, Copy, Debug)]
pub struct ScanWithLimits<'a> {
    /// Scan after range limits and projection; a ray without return means free up to `range_max`.
    pub scan: &'a PolarScan,
    /// Smallest range that is measured [m].
    pub range_min: f64,
    /// Largest range that is measured [m].
    pub range_max: f64,
}

/// Visibility of a circle in a scan, ordered from the most to the least certain result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum CircleVisibility {
    /// Rays passed beyond its place: it is not there.
    SeenThrough,
    /// Rays ended at its place.
    Returns,
    /// Most of it is behind a nearer object.
    Occluded,
    /// Out of the field of view or the range, or too small for enough rays.
    OutOfView,
}

/// A scan with its rays by ascending bearing, ready for queries.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SortedView {
    bearings: Vec<f64>,
    ranges: Vec<f64>,
    range_min: f64,
    range_max: f64,
    /// Surfaces that the rays hit, computed at the first query.
    #[serde(skip)]
    pieces: OnceLock<Vec<Option<SurfacePiece>>>,
}

impl ScanWithLimits<'_> {
    /// Sort the rays for queries.
    ///
    /// # Errors
    /// [`Error::Length`] or [`Error::Value`] if a ray has no bearing, [`Error::Parameter`] for
    /// range limits that are not ascending.
    pub fn sorted(&self) -> Result<SortedView, Error> {
        let (ranges, bearings) = (&self.scan.ranges, &self.scan.bearings);
        if ranges.len() != bearings.len() {
            let (expected, got) = (ranges.len(), bearings.len());
            return Err(Error::Length { name: "bearings", expected, got });
        }
        if let Some(index) = bearings.iter().position(|bearing| !bearing.is_finite()) {
            let (expected, got) = ("finite angles", bearings[index].to_string());
            return Err(Error::Value { name: "bearings", expected, index, got });
        }
        if !(self.range_min >= 0.0 && self.range_min < self.range_max) {
            let got = format!("{} to {}", self.range_min, self.range_max);
            return Err(Error::Parameter { name: "range_max", expected: "> range_min >= 0", got });
        }
        let (bearings, ranges) = ascending(bearings, ranges);
        let [range_min, range_max] = [self.range_min, self.range_max];
        Ok(SortedView { bearings, ranges, range_min, range_max, pieces: OnceLock::new() })
    }
}

/// Rays by ascending bearing; most sweeps are in this order already.
fn ascending(bearings: &[f64], ranges: &[f64]) -> (Vec<f64>, Vec<f64>) {
    if bearings.is_sorted() {
        return (bearings.to_vec(), ranges.to_vec());
    }
    let mut order: Vec<usize> = (0..bearings.len()).collect();
    order.sort_by(|&one, &other| bearings[one].total_cmp(&bearings[other]));
    let of = |values: &[f64]| order.iter().map(|&ray| values[ray]).collect();
    (of(bearings), of(ranges))
}

/// Numbers of rays at a circle: rays that pass through, that end on it, and that end in front of
/// it.
#[derive(Clone, Copy, Debug, Default)]
struct Votes {
    through: usize,
    on: usize,
    before: usize,
}

impl SortedView {
    /// True if the parts of a restored state agree.
    pub(in crate::circles::map) fn is_sound(&self) -> bool {
        self.bearings.len() == self.ranges.len()
            && self.bearings.is_sorted()
            && self.bearings.iter().all(|bearing| bearing.is_finite())
            && self.range_min >= 0.0
            && self.range_min < self.range_max
    }

    /// Visibility of `circle`, in the frame of the scan.
    #[must_use]
    pub fn of(&self, circle: &Circle, test: &VisibilityTest) -> CircleVisibility {
        let Circle { center: [x, y], radius } = *circle;
        let distance = (x * x + y * y).sqrt();
        if distance <= radius || distance - radius < self.range_min {
            return CircleVisibility::OutOfView;
        }
        let bearing = libm::atan2(y, x);
        let half = libm::asin(radius / distance).min(FRAC_PI_2);
        let surface = |ray: f64| (surface_of(circle, ray - bearing), test.margin);
        self.votes([bearing - half, bearing + half], surface).visibility(test)
    }

    /// Centre of an object on which the rays at the place of `circle` end, in the frame of the scan
    /// [m]. Each of these rays is assumed to hit the middle of the object. None unless most rays
    /// there end on it.
    pub(in crate::circles::map) fn glimpse(
        &self,
        circle: &Circle,
        test: &VisibilityTest,
    ) -> Option<[f64; 2]> {
        let Circle { center: [x, y], radius } = *circle;
        let distance = libm::hypot(x, y);
        if distance <= radius || distance - radius < self.range_min {
            return None;
        }
        let (bearing, half) = (libm::atan2(y, x), libm::asin(radius / distance));
        let (mut sum, mut on, mut others) = ([0.0; 2], 0, 0);
        for ray in [-TAU, 0.0, TAU].into_iter().flat_map(|turn| self.around(bearing + turn, half)) {
            let (at, range) = self.ray(ray);
            if (range - surface_of(circle, at - bearing)).abs() <= test.margin {
                sum[0] += (range + radius) * libm::cos(at);
                sum[1] += (range + radius) * libm::sin(at);
                on += 1;
            } else if !range.is_nan() {
                others += 1;
            }
        }
        (on > others).then(|| sum.map(|value| value / f64::from(on)))
    }

    /// Mean angle from ray to ray [rad].
    pub(in crate::circles::map) fn step(&self) -> f64 {
        let (Some(first), Some(last)) = (self.bearings.first(), self.bearings.last()) else {
            return 0.0;
        };
        (last - first) / (self.bearings.len().max(2) - 1) as f64
    }

    /// Surfaces that the rays hit; None for rays without return.
    pub(super) fn pieces(&self) -> &[Option<SurfacePiece>] {
        self.pieces.get_or_init(|| SurfacePiece::all(&self.bearings, &self.ranges, self.step()))
    }

    /// Indices of the rays within the angle `half` of a bearing [rad].
    pub(super) fn around(&self, bearing: f64, half: f64) -> Range<usize> {
        let ends = self.bearings.first().zip(self.bearings.last());
        if ends.is_none_or(|(&first, &last)| bearing + half < first || bearing - half > last) {
            return 0..0; // the usual case: callers also try the bearing a turn before and after
        }
        let low = self.bearings.partition_point(|&ray| ray < bearing - half);
        low..self.bearings.partition_point(|&ray| ray <= bearing + half).max(low)
    }

    /// Index of the first ray from a bearing on; None unless a ray is within the angle `half` of it
    /// [rad].
    pub(super) fn first_from(&self, bearing: f64, half: f64) -> Option<usize> {
        let (&first, &last) = self.bearings.first().zip(self.bearings.last())?;
        if bearing + half < first || bearing - half > last {
            return None; // the usual case: callers also try the bearing a turn before and after
        }
        let is_from = |ray: usize| self.bearings.get(ray).is_none_or(|&ray| ray >= bearing);
        let is_first = |ray: &usize| is_from(*ray) && (*ray == 0 || !is_from(ray - 1));
        // Most scanners turn steadily: the place is known within a ray.
        let guess = ((bearing - first) / self.step()) as usize;
        let near = guess.min(self.len());
        let found = (near..near + 2).find(is_first);
        let found = found.unwrap_or_else(|| self.bearings.partition_point(|&ray| ray < bearing));
        let is_near = |ray: Option<&f64>| ray.is_some_and(|ray| (ray - bearing).abs() <= half);
        let before = found.checked_sub(1).and_then(|ray| self.bearings.get(ray));
        (is_near(self.bearings.get(found)) || is_near(before)).then_some(found)
    }

    /// Bearing [rad] and range [m] of a ray.
    pub(super) fn ray(&self, number: usize) -> (f64, f64) {
        (self.bearings[number], self.ranges[number])
    }

    /// Number of rays.
    pub(super) fn len(&self) -> usize {
        self.ranges.len()
    }

    /// Largest range that is measured [m].
    pub(super) fn range_max(&self) -> f64 {
        self.range_max
    }

    /// Area between the sensor and the ends of all rays [m^2].
    pub(in crate::circles::map) fn area(&self) -> f64 {
        let pairs = self.bearings.windows(2).zip(&self.ranges);
        let parts = pairs.filter(|(_, range)| !range.is_nan()).map(|(bearings, range)| {
            let reach = range.min(self.range_max);
            0.5 * reach * reach * (bearings[1] - bearings[0])
        });
        parts.sum()
    }

    /// Visibility of a line between two ends in the frame of the scan [m]. Its front is on the left of
    /// the direction from its first end to its second. It is out of view if the scanner is behind it,
    /// nearer to it than the smallest range, or too few rays show it.
    #[must_use]
    pub fn of_line(&self, ends: [[f64; 2]; 2], test: &VisibilityTest) -> CircleVisibility {
        let [[x, y], [to_x, to_y]] = ends;
        let length = libm::hypot(to_x - x, to_y - y);
        let distance = (x * to_y - y * to_x) / length; // from the sensor to the line
        if distance.is_nan() || distance <= self.range_min {
            return CircleVisibility::OutOfView;
        }
        let bearings = [libm::atan2(y, x), libm::atan2(to_y, to_x)];
        let last = bearings[0] + turn(bearings[1] - bearings[0]);
        let normal = libm::atan2(x - to_x, to_y - y);
        let votes = self.votes([bearings[0], last], |ray| {
            let cosine = libm::cos(ray - normal);
            if cosine < GRAZING {
                return (f64::INFINITY, 0.0); // too slanting to tell
            }
            (distance / cosine, test.margin / cosine)
        });
        votes.visibility(test)
    }

    /// Votes of the rays between two bearings about a surface; `surface` gives its range and margin
    /// for a bearing.
    fn votes(&self, [low, high]: [f64; 2], surface: impl Fn(f64) -> (f64, f64)) -> Votes {
        let mut votes = Votes::default();
        // Bearings of the scan may be counted from any turn: the interval is looked up in its
        // neighbours, too.
        for turn in [-TAU, 0.0, TAU] {
            let first = self.bearings.partition_point(|&ray| ray <= low + turn);
            let last = self.bearings.partition_point(|&ray| ray < high + turn);
            for ray in first..last.max(first) {
                let (surface, margin) = surface(self.bearings[ray]);
                let range = self.ranges[ray];
                if range.is_nan() || surface > self.range_max - margin {
                    continue; // no information, or beyond what the ray could have met
                }
                if range > surface + margin {
                    votes.through += 1;
                } else if range >= surface - margin {
                    votes.on += 1;
                } else {
                    votes.before += 1;
                }
            }
        }
        votes
    }
}

/// Range at which a ray hits a circle [m]; `angle`: angle between the ray and the centre [rad]. For
/// rays that pass the circle, the range of its side.
fn surface_of(&Circle { center: [x, y], radius }: &Circle, angle: f64) -> f64 {
    let distance = (x * x + y * y).sqrt();
    let aside = distance * libm::sin(angle);
    let depth = (radius * radius - aside * aside).max(0.0).sqrt();
    (distance * distance - aside * aside).max(0.0).sqrt() - depth
}

impl Votes {
    fn visibility(&self, test: &VisibilityTest) -> CircleVisibility {
        let Self { through, on, before } = *self;
        let (known, enough) = (through + on + before, test.min_rays.max(1));
        if known < enough {
            CircleVisibility::OutOfView
        // Half of the rays: a few past the rim of the object are no proof against it.
        } else if through >= enough && 2 * through >= known {
            CircleVisibility::SeenThrough
        } else if on >= enough && on >= before {
            CircleVisibility::Returns
        } else {
            CircleVisibility::Occluded
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    const TEST: VisibilityTest = VisibilityTest { margin: 0.1, min_rays: 3 };

    fn scan(range: impl Fn(f64) -> f64) -> PolarScan {
        let bearings: Vec<f64> = (-540..=540).map(|ray| f64::from(ray) * PI / 720.0).collect();
        PolarScan { ranges: bearings.iter().map(|&bearing| range(bearing)).collect(), bearings }
    }

    fn seen(scan: &PolarScan, x: f64, y: f64, radius: f64) -> Result<CircleVisibility, Error> {
        let view = ScanWithLimits { scan, range_min: 0.1, range_max: 10.0 }.sorted()?;
        Ok(view.of(&Circle { center: [x, y], radius }, &TEST))
    }

    #[test]
    fn a_wall_hides_what_is_behind_and_open_space_nothing() -> Result<(), Error> {
        let wall = scan(|bearing| if bearing.abs() < 0.5 { 5.0 } else { f64::INFINITY });
        assert_eq!(seen(&wall, 7.0, 0.0, 0.3)?, CircleVisibility::Occluded);
        assert_eq!(seen(&wall, 3.0, 0.0, 0.3)?, CircleVisibility::SeenThrough);
        assert_eq!(seen(&wall, 5.25, 0.0, 0.3)?, CircleVisibility::Returns);
        assert_eq!(seen(&wall, 0.0, 7.0, 0.3)?, CircleVisibility::SeenThrough);
        Ok(())
    }

    #[test]
    fn where_no_ray_goes_nothing_is_known() -> Result<(), Error> {
        let open = scan(|_| f64::INFINITY);
        assert_eq!(seen(&open, -5.0, 0.0, 0.3)?, CircleVisibility::OutOfView); // behind the sensor
        assert_eq!(seen(&open, 12.0, 0.0, 0.3)?, CircleVisibility::OutOfView); // too far
        assert_eq!(seen(&open, 0.05, 0.0, 0.3)?, CircleVisibility::OutOfView); // around the sensor
        assert_eq!(seen(&open, 9.0, 0.0, 0.01)?, CircleVisibility::OutOfView); // too small
        assert_eq!(seen(&scan(|_| f64::NAN), 5.0, 0.0, 0.3)?, CircleVisibility::OutOfView);
        Ok(())
    }

    #[test]
    fn a_ray_that_ends_on_a_thin_post_shows_it_and_rays_that_pass_show_nothing() -> Result<(), Error>
    {
        let post = Circle { center: [5.0, 0.0], radius: 0.02 };
        let glimpse = |range: f64| -> Result<Option<[f64; 2]>, Error> {
            let scan = scan(|_| range);
            let view = ScanWithLimits { scan: &scan, range_min: 0.1, range_max: 10.0 }.sorted()?;
            Ok(view.glimpse(&post, &TEST))
        };
        let center = glimpse(4.98)?.map_or(f64::NAN, |center| center[0]);
        assert!((center - 5.0).abs() < 1e-3, "{center}");
        for range in [f64::INFINITY, 6.0, 4.5, f64::NAN] {
            assert_eq!(glimpse(range)?, None, "{range}");
        }
        Ok(())
    }

    #[test]
    fn a_full_circle_has_no_seam() -> Result<(), Error> {
        let bearings: Vec<f64> = (0..720).map(|ray| f64::from(ray) * PI / 360.0).collect();
        let ranges = vec![f64::INFINITY; 720];
        let full = PolarScan { ranges, bearings };
        assert_eq!(seen(&full, 4.0, 0.0, 0.2)?, CircleVisibility::SeenThrough);
        let turned = PolarScan {
            bearings: full.bearings.iter().map(|bearing| libm::remainder(*bearing, TAU)).collect(),
            ..full.clone()
        };
        assert_eq!(seen(&turned, -4.0, 0.0, 0.2)?, CircleVisibility::SeenThrough);
        Ok(())
    }

    #[test]
    fn views_that_are_none_are_refused() {
        let scan = PolarScan { ranges: vec![1.0], bearings: vec![f64::NAN] };
        assert!(ScanWithLimits { scan: &scan, range_min: 0.1, range_max: 10.0 }.sorted().is_err());
        let scan = PolarScan { ranges: vec![1.0], bearings: vec![0.0] };
        assert!(ScanWithLimits { scan: &scan, range_min: 0.1, range_max: 0.1 }.sorted().is_err());
        let scan = PolarScan { ranges: vec![1.0], bearings: vec![] };
        assert!(ScanWithLimits { scan: &scan, range_min: 0.1, range_max: 1.0 }.sorted().is_err());
    }
}
