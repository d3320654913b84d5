//! Input and counts of the update of a map by one scan.

use super::accumulate::mark::Content;
use super::pose_weights::{PoseError, PoseNoise};
use crate::Error;
use crate::flying::point_class::PointClass;
use crate::flying::scan::prepared::Prepared;
use crate::util::budget::check_points;

/// Start points of rays [m].
#[derive(Clone, Copy, Debug)]
pub enum Origins<'a> {
    /// One start point for all rays.
    One([f64; 3]),
    /// One start point per ray.
    Each(&'a [[f64; 3]]),
}

impl Origins<'_> {
    /// Origin of the ray `index` [m], frame of the map.
    #[must_use]
    #[inline]
    pub fn at(&self, index: usize) -> [f64; 3] {
        match self {
            Self::One(origin) => *origin,
            Self::Each(origins) => origins[index],
        }
    }
}

/// One scan in the frame of the map.
#[derive(Clone, Copy, Debug)]
pub struct ClassifiedScan<'a> {
    /// End of every ray [m].
    pub points: &'a [[f32; 3]],
    /// Class of every point. Invalid entries cast no ray.
    pub class: &'a [PointClass],
    /// Start points of the rays.
    pub origins: Origins<'a>,
    /// Direction of every ray; needed where `no_return` is set.
    pub directions: Option<&'a [[f32; 3]]>,
    /// True for rays without return: they clear up to `max_range`.
    pub no_return: Option<&'a [bool]>,
    /// Points whose ray is not cast, such as the nearer of two returns.
    pub no_ray: Option<&'a [bool]>,
    /// Length that the rays of `no_return` clear [m], beyond their directions; without it, up to
    /// `max_range`. Other entries are not looked at.
    pub reach: Option<&'a [f32]>,
    /// Uncertainty of the points, if the update uses it.
    pub pose_error: Option<&'a PoseError>,
}

impl<'a> ClassifiedScan<'a> {
    /// The rays of a scan before its classes are known.
    pub(crate) fn before_classes(scan: &'a Prepared, noise: &'a PoseNoise) -> Self {
        let one = Origins::One(scan.pose.translation);
        Self {
            points: &scan.points,
            class: &scan.unknown,
            origins: scan.origins.as_deref().map_or(one, Origins::Each),
            directions: scan.directions.as_deref(),
            no_return: scan.directions.is_some().then_some(&scan.no_return),
            no_ray: scan.no_ray.as_deref(),
            reach: scan.reach.as_deref(),
            pose_error: noise.error.as_ref(),
        }
    }
}

/// Counts of one scan's update of the map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IntegrateStats {
    /// Points used, per class background, flying, unknown; moving ones count as unknown.
    pub points: [usize; 3],
    /// Entries without information: class invalid, not finite, or without a direction.
    pub skipped: usize,
    /// Number of rays that were cast, with and without return, or that a cast ray represents.
    pub rays: usize,
    /// Rays without return among the cast rays.
    pub no_return_rays: usize,
    /// Voxels crossed by rays, each crossing counted.
    pub visits: u64,
    /// Crossings among the visits that rays passed in one step
    /// ([`Skip`](crate::flying::map::parameters::Skip)).
    pub visits_skipped: u64,
    /// Voxels that points lie in or that rays visited, without those that they passed.
    pub voxels: usize,
    /// Voxels whose value is another one than before; the same number whatever is passed.
    pub voxels_changed: usize,
    /// Observed voxels that the map forgot, farthest from the scan first, to stay within
    /// [`MapParameters::max_voxels`](crate::flying::map::parameters::MapParameters::max_voxels).
    pub voxels_forgotten: usize,
}

impl IntegrateStats {
    pub(crate) fn count(&mut self, point: Content) {
        self.points[match point {
            Content::Background => 0,
            Content::Flying => 1,
            _ => 2,
        }] += 1;
    }
}

#[inline(always)]
pub(super) fn content_of(class: PointClass) -> Option<Content> {
    match class {
        PointClass::Background => Some(Content::Background),
        PointClass::Flying => Some(Content::Flying),
        PointClass::Unknown | PointClass::Moving => Some(Content::Unknown),
        PointClass::Invalid => None,
    }
}

pub(super) fn check_classes(class: &[PointClass], expected: usize) -> Result<(), Error> {
    let got = class.len();
    if got == expected { Ok(()) } else { Err(Error::Length { name: "point_class", expected, got }) }
}

pub(crate) fn check_lengths(scan: &ClassifiedScan<'_>) -> Result<(), Error> {
    let expected = scan.points.len();
    // First, since rows are counted in 32 bits from here on.
    check_points(expected)?;
    check_classes(scan.class, expected)?;
    let lengths = [
        ("ray_directions", scan.directions.map(<[_]>::len)),
        ("no_return", scan.no_return.map(<[_]>::len)),
        ("no_ray", scan.no_ray.map(<[_]>::len)),
        ("reach", scan.reach.map(<[_]>::len)),
        (
            "sensor_origin",
            if let Origins::Each(each) = scan.origins { Some(each.len()) } else { None },
        ),
    ];
    for (name, got) in lengths {
        if let Some(got) = got.filter(|&got| got != expected) {
            return Err(Error::Length { name, expected, got });
        }
    }
    // Only the presence is checked: single directions that are zero or not finite count as skipped.
    if scan.no_return.is_some_and(|flags| flags.contains(&true)) && scan.directions.is_none() {
        return Err(Error::Value {
            name: "ray_directions",
            expected: "the direction of every ray, since `no_return` is set",
            index: 0,
            got: "none".into(),
        });
    }
    Ok(())
}
