//! Input of the update of a map by one scan, and the counts that the update returns.

use super::accumulate::mark::Content;
use super::pose_weights::{PoseError, PoseNoise};
use crate::Error;
use crate::flying::point_class::PointClass;
use crate::flying::scan::prepared::Prepared;
use crate::util::budget::check_points;

/// Start points of the rays of a scan [m], in the frame of the map.
#[derive(Clone, Copy, Debug)]
pub enum Origins<'a> {
    /// One start point for all rays.
    One([f64; 3]),
    /// One start point per ray.
    Each(&'a [[f64; 3]]),
}

impl Origins<'_> {
    /// Start point of the ray `index` [m], in the frame of the map.
    #[must_use]
    #[inline]
    pub fn at(&self, index: usize) -> [f64; 3] {
        match self {
            Self::One(origin) => *origin,
            Self::Each(origins) => origins[index],
        }
    }
}

/// One classified scan in the frame of the map, as input of [`super::integrator::Integrator`].
#[derive(Clone, Copy, Debug)]
pub struct ClassifiedScan<'a> {
    /// End of every ray, frame of the map [m].
    pub points: &'a [[f32; 3]],
    /// Class of every point. Invalid entries cast no ray.
    pub class: &'a [PointClass],
    /// Start points of the rays.
    pub origins: Origins<'a>,
    /// Direction of every ray. Needed for the rays that `no_return` marks.
    pub directions: Option<&'a [[f32; 3]]>,
    /// True for rays without a return. They clear the voxels up to `reach`. None: all rays have a
    /// return.
    pub no_return: Option<&'a [bool]>,
    /// True for points whose ray is not cast, such as the nearer of two returns. None: all rays are
    /// cast.
    pub no_ray: Option<&'a [bool]>,
    /// Length along their direction up to which rays of `no_return` clear voxels [m]. None: up to
    /// `max_range`. Entries of other rays are ignored.
    pub reach: Option<&'a [f32]>,
    /// Uncertainty of the points. None: the update ignores it.
    pub pose_error: Option<&'a PoseError>,
}

impl<'a> ClassifiedScan<'a> {
    /// The rays of a scan whose points are not classified yet.
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
    /// Number of points that were used, by class: background, flying, unknown. Moving points count
    /// as unknown.
    pub points: [usize; 3],
    /// Number of entries without information: class invalid, not finite, or without a direction.
    pub skipped: usize,
    /// Number of rays, with and without return. A cast ray that represents several rays counts for
    /// all of them.
    pub rays: usize,
    /// Number of rays without return among `rays`.
    pub no_return_rays: usize,
    /// Number of voxels that rays crossed. A voxel counts once for every crossing.
    pub visits: u64,
    /// Number of these crossings that rays skipped
    /// ([`Skip`](crate::flying::map::parameters::Skip)).
    pub visits_skipped: u64,
    /// Number of voxels that contain points or that rays visited. Skipped voxels do not count.
    pub voxels: usize,
    /// Number of voxels whose value has changed. It does not depend on whether rays skip voxels.
    pub voxels_changed: usize,
    /// Number of observed voxels that the map forgot, farthest from the scan first, to stay within
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
