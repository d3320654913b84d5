//! One scan into the map: rays, points, then one exponential update per voxel.
//!
//! Source: Vrba et al., eqs 8-12 and 16-22.

use super::accumulator::Content;
use super::pose_weights::PoseError;
use crate::Error;
use crate::util::budget::check_points;

/// Class of a point that is ignored.
pub const INVALID: u8 = 0;
/// Class of a point on something that belongs to the environment.
pub const BACKGROUND: u8 = 1;
/// Class of a point on a flying object.
pub const FLYING: u8 = 2;
/// Class of a point that is neither background nor known to fly.
pub const UNKNOWN: u8 = 3;

/// Start points of rays [m].
#[derive(Clone, Copy, Debug)]
pub enum Origins<'a> {
    /// One start point for all rays.
    One([f64; 3]),
    /// One start point per ray.
    Each(&'a [[f64; 3]]),
}

impl Origins<'_> {
    /// Origin of the ray `index`.
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
    /// [`INVALID`], [`BACKGROUND`], [`FLYING`] or [`UNKNOWN`] per point. Invalid entries cast no ray.
    pub class: &'a [u8],
    /// Start points of the rays.
    pub origins: Origins<'a>,
    /// Direction of every ray; needed where `no_return` is set.
    pub directions: Option<&'a [[f32; 3]]>,
    /// Rays that met nothing: they clear up to `max_range`.
    pub no_return: Option<&'a [bool]>,
    /// Points whose ray is not cast, such as the nearer of two returns.
    pub no_ray: Option<&'a [bool]>,
    /// Length that the rays of `no_return` clear [m], beyond their directions; without it, up to
    /// `max_range`. Other entries are not looked at.
    pub reach: Option<&'a [f32]>,
    /// Uncertainty of the points, if the update uses it.
    pub pose_error: Option<&'a PoseError>,
}

/// Counts of one scan's update of the map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IntegrateStats {
    /// Points used, per class background, flying, unknown.
    pub points: [usize; 3],
    /// Entries without information: class invalid, not finite, or without a direction.
    pub skipped: usize,
    /// Rays cast, with and without return, or represented by one that is cast.
    pub rays: usize,
    /// Of these, rays without return.
    pub no_return_rays: usize,
    /// Voxels crossed by rays, each crossing counted.
    pub visits: u64,
    /// Voxels whose value was updated.
    pub voxels: usize,
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
pub(super) fn content_of(class: u8) -> Option<Content> {
    match class {
        BACKGROUND => Some(Content::Background),
        FLYING => Some(Content::Flying),
        UNKNOWN => Some(Content::Unknown),
        // `INVALID`: other numbers are refused by `check_classes` before.
        _ => None,
    }
}

pub(super) fn check_classes(class: &[u8], expected: usize) -> Result<(), Error> {
    if class.len() != expected {
        return Err(Error::Length { name: "point_class", expected, got: class.len() });
    }
    let Some(index) = class.iter().position(|&class| class > UNKNOWN) else { return Ok(()) };
    Err(Error::Value {
        name: "point_class",
        expected: "0 invalid, 1 background, 2 flying or 3 unknown",
        index,
        got: class[index].to_string(),
    })
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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::flying::map::voxel_map::{MapParameters, VoxelMap};

    pub(crate) fn parameters() -> MapParameters {
        MapParameters { max_voxels: 1 << 20, ..MapParameters::default() }
    }

    pub(crate) fn scan<'a>(points: &'a [[f32; 3]], class: &'a [u8]) -> ClassifiedScan<'a> {
        ClassifiedScan {
            points,
            class,
            origins: Origins::One([0.1; 3]),
            directions: None,
            no_return: None,
            no_ray: None,
            reach: None,
            pose_error: None,
        }
    }

    #[test]
    fn a_ray_clears_up_to_the_voxel_of_its_point() -> Result<(), Error> {
        let mut map = VoxelMap::new(parameters(), 1)?;
        let stats = map.integrate(&scan(&[[1.1, 0.1, 0.1]], &[BACKGROUND]))?;
        assert_eq!((stats.rays, stats.visits, stats.voxels), (1, 5, 5));
        let at = map.values_at(&[[0.3, 0.1, 0.1], [1.1, 0.1, 0.1], [1.3, 0.1, 0.1]]);
        assert_eq!(at, [-870.0, -370.0, -740.0]); // one edge, one point, nothing
        Ok(())
    }

    #[test]
    fn a_ray_without_return_needs_a_direction() -> Result<(), Error> {
        let mut map = VoxelMap::new(parameters(), 1)?;
        let points = [[f32::NAN; 3]];
        let empty = ClassifiedScan { no_return: Some(&[true]), ..scan(&points, &[INVALID]) };
        assert!(matches!(map.integrate(&empty), Err(Error::Value { name: "ray_directions", .. })));
        let directions = [[0.0, 0.0, 2.0]];
        let stats = map.integrate(&ClassifiedScan { directions: Some(&directions), ..empty })?;
        assert_eq!((stats.rays, stats.no_return_rays, stats.visits), (1, 1, 81));
        Ok(())
    }

    #[test]
    fn a_refused_scan_changes_nothing() -> Result<(), Error> {
        let mut map = VoxelMap::new(MapParameters { max_voxels: 1024, ..parameters() }, 2)?;
        assert!(matches!(
            map.integrate(&scan(&[[15.0, 9.0, 3.0]], &[UNKNOWN])),
            Err(Error::Limit { .. })
        ));
        assert!(matches!(
            map.integrate(&scan(&[[1e30, 0.0, 0.0]], &[1])),
            Err(Error::PointOutOfRange { .. })
        ));
        assert!(matches!(map.integrate(&scan(&[[1.0; 3]], &[4])), Err(Error::Value { .. })));
        assert!(matches!(map.integrate(&scan(&[[1.0; 3]], &[])), Err(Error::Length { .. })));
        assert_eq!(map.stored_voxels(), 0);
        Ok(())
    }

    #[test]
    fn nothing_is_left_of_a_scan_in_the_next_one() -> Result<(), Error> {
        let far = [[15.0, 9.0, 3.0], [-40.0, 60.0, 5.0]];
        let near = [[1.1, 0.1, 0.1], [60.0, -3.0, 1.0]];
        for (threads, max_voxels) in [(1, 3072), (2, 3072), (1, 1 << 20), (3, 1 << 20)] {
            let parameters = MapParameters { max_voxels, max_range: 5.0, ..parameters() };
            let mut map = VoxelMap::new(parameters.clone(), threads)?;
            let refused = map.integrate(&scan(&far, &[UNKNOWN, BACKGROUND])).is_err();
            assert_eq!(refused, max_voxels == 3072);
            map.clear();
            let mut other = VoxelMap::new(parameters, 1)?;
            map.integrate(&scan(&near, &[BACKGROUND, FLYING]))?;
            other.integrate(&scan(&near, &[BACKGROUND, FLYING]))?;
            assert_eq!(map.to_bytes(), other.to_bytes());
        }
        Ok(())
    }

    #[test]
    fn a_window_in_pieces_gives_what_a_whole_one_gives() -> Result<(), Error> {
        // The blocks that bound both rays are far too many to lie in memory as a whole.
        let ends = [[300.1, 0.2, 0.3], [0.1, 290.1, 250.3]];
        let class = [BACKGROUND; 2];
        let long = MapParameters { max_range: 400.0, ..parameters() };
        for threads in [1, 2] {
            let mut map = VoxelMap::new(long.clone(), threads)?;
            map.integrate(&scan(&ends, &class))?;
            for end in ends {
                let mut alone = VoxelMap::new(long.clone(), 1)?;
                alone.integrate(&scan(&[end], &class[..1]))?;
                let along: Vec<[f32; 3]> = (1_u8..=200)
                    .map(|step| end.map(|value| value * f32::from(step) / 200.0))
                    .collect();
                assert_eq!(map.values_at(&along[5..]), alone.values_at(&along[5..]));
            }
        }
        Ok(())
    }

    #[test]
    fn a_scan_without_anything_fits_any_lattice() -> Result<(), Error> {
        let mut map = VoxelMap::new(MapParameters { voxel_size: 1e300, ..parameters() }, 1)?;
        let stats = map.integrate(&scan(&[[f32::NAN; 3]; 3], &[BACKGROUND; 3]))?;
        assert_eq!((stats.skipped, stats.rays, stats.voxels), (3, 0, 0));
        Ok(())
    }

    #[test]
    fn of_several_errors_the_first_in_the_order_of_the_input_is_told() -> Result<(), Error> {
        let mut map = VoxelMap::new(parameters(), 1)?;
        let (far, wrong, near) = ([1e30, 0.0, 0.0], [0.0, 1e30, 0.0], [1.0; 3]);
        let points = [near, far, near].map(|point| point.map(|value| value as f32));
        let class = [BACKGROUND; 3];
        for (origins, first) in [([[0.0; 3], [0.0; 3], wrong], far), ([wrong, near, near], wrong)] {
            let scan = ClassifiedScan {
                points: &points,
                origins: Origins::Each(&origins),
                ..scan(&[], &class)
            };
            let error = map.integrate(&scan);
            let told =
                |point: [f64; 3]| (0..3).all(|axis| (point[axis] - first[axis]).abs() < 1e24);
            assert!(
                matches!(error, Err(Error::PointOutOfRange { point }) if told(point)),
                "{error:?}"
            );
        }
        Ok(())
    }

    #[test]
    fn nothing_outside_the_operating_volume_is_mapped() -> Result<(), Error> {
        let bounds = Some([[0.0; 3], [0.5, 1.0, 1.0]]);
        let mut map = VoxelMap::new(MapParameters { bounds, ..parameters() }, 1)?;
        map.integrate(&scan(&[[5.1, 0.1, 0.1]], &[BACKGROUND]))?;
        assert_eq!(
            map.values_at(&[[0.3, 0.1, 0.1], [1.3, 0.1, 0.1], [5.1, 0.1, 0.1]]),
            [-870.0, -740.0, -740.0]
        );
        Ok(())
    }
}
