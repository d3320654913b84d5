//! Range limitation and horizontal projection, secs. III-A and III-B.

use super::polar_scan::{PolarScan, turn};
use super::sweep_poses::SweepPoses;
use crate::Error;
use crate::geometry::transform::{Transform, dot};

/// Cosine of the largest tilt of a scan plane that can be projected to the ground: 88.9 degrees.
const STEEPEST: f64 = 0.02;

/// Projection of a tilted scan to the horizontal plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Projection {
    /// Every measured point, with range and bearing as seen from above.
    Exact,
    /// Ranges multiplied by cos(pitch) cos(roll), bearings unchanged: eq. 5 as published.
    Paper,
}

/// A scan in the level frame: origin at the scanner at the stamp, z up, yaw of the scanner kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LevelScan {
    /// Horizontal ranges and bearings; bearings are continuous, so they may exceed pi.
    pub scan: PolarScan,
    /// Height of every hit above the scanner at the stamp [m]; NaN elsewhere.
    pub heights: Vec<f64>,
}

/// Cosine and sine of every bearing.
#[must_use]
pub fn directions(bearings: &[f64]) -> Vec<[f64; 2]> {
    bearings.iter().map(|&bearing| [libm::cos(bearing), libm::sin(bearing)]).collect()
}

/// Limit the ranges to the operating volume a x + b y + c z <= d of all `planes` (world frame), eq.
/// 4.
///
/// A surface outside becomes a miss if the ray has passed the volume, or no information (NaN) if
/// the surface hides the volume.
///
/// # Errors
/// [`Error::Length`] if the arrays differ in length, [`Error::Value`] for an invalid plane.
pub fn limit_range(
    ranges: &[f64],
    directions: &[[f64; 2]],
    sweep: &SweepPoses,
    planes: &[[f64; 4]],
) -> Result<Vec<f64>, Error> {
    check(ranges, directions.len(), sweep)?;
    check_planes(planes)?;
    let limited = |(ray, (&range, &[cosine, sine])): (usize, (&f64, &[f64; 2]))| {
        if !range.is_finite() {
            return range;
        }
        let pose = sweep.at(ray);
        let [enter, leave] = inside(planes, pose.translation, pose.rotate([cosine, sine, 0.0]));
        if (enter..=leave).contains(&range) {
            range
        } else if range < enter && enter <= leave {
            f64::NAN
        } else {
            f64::INFINITY
        }
    };
    Ok(ranges.iter().zip(directions).enumerate().map(limited).collect())
}

/// Check that all planes are valid.
///
/// # Errors
/// [`Error::Value`] for values that are not finite, or a normal of length zero.
pub(crate) fn check_planes(planes: &[[f64; 4]]) -> Result<(), Error> {
    let is_plane = |plane: &[f64; 4]| {
        plane.iter().all(|value| value.is_finite()) && plane[..3].iter().any(|&value| value != 0.0)
    };
    let expected = "finite values, and (a, b, c) not all 0";
    match planes.iter().position(|plane| !is_plane(plane)) {
        Some(index) => {
            let got = format!("{:?}", planes[index]);
            Err(Error::Value { name: "planes", expected, index, got })
        }
        None => Ok(()),
    }
}

/// Smallest ratio of horizontal to full length over all rays.
///
/// # Errors
/// [`Error::Value`] for a scan plane that is nearly vertical.
pub(in crate::circles) fn upright(sweep: &SweepPoses) -> Result<f64, Error> {
    let cosine = sweep.at_stamp().rotation[2][2].abs();
    if cosine < STEEPEST {
        return Err(Error::Value {
            name: "world_from_lidar",
            expected: "a scan plane that is not nearly vertical",
            index: 0,
            got: format!("a tilt of {:.1} deg", libm::acos(cosine).to_degrees()),
        });
    }
    Ok(cosine)
}

/// Interval of a ray inside all planes [m]; the first value is larger if there is none.
fn inside(planes: &[[f64; 4]], origin: [f64; 3], direction: [f64; 3]) -> [f64; 2] {
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for &[a, b, c, d] in planes {
        let left = d - dot([a, b, c], origin);
        let speed = dot([a, b, c], direction);
        if speed > 0.0 {
            leave = leave.min(left / speed);
        } else if speed < 0.0 {
            enter = enter.max(left / speed);
        } else if left < 0.0 {
            return [f64::INFINITY, f64::NEG_INFINITY];
        }
    }
    [enter, leave]
}

/// Project a scan to the level frame of its stamp, that is the horizontal plane, and correct the
/// motion during the sweep.
///
/// A miss stays a miss. Its bearing is that of a point at the range of the nearest hit (counted in
/// rays), because a moving scanner sees near and far objects in different directions.
///
/// # Errors
/// [`Error::Length`] if the arrays differ in length.
pub fn project(
    raw: &PolarScan,
    directions: &[[f64; 2]],
    sweep: &SweepPoses,
    mode: Projection,
) -> Result<LevelScan, Error> {
    check(&raw.ranges, directions.len(), sweep)?;
    check(&raw.ranges, raw.bearings.len(), sweep)?;
    let level_from_world = sweep.world_from_level().inverse();
    let still = level_from_world.after(sweep.at_stamp());
    let mut level = match mode {
        Projection::Paper => shrunk(raw, &still),
        Projection::Exact => LevelScan::default(),
    };
    let substitutes = if sweep.is_moving() { nearest_hits(&raw.ranges) } else { Vec::new() };
    let exact = mode == Projection::Exact;
    let mut bearing = raw.bearings.first().copied().unwrap_or_default();
    for (ray, &[cosine, sine]) in directions.iter().enumerate() {
        let range = raw.ranges[ray];
        let reach =
            if range.is_finite() { range } else { substitutes.get(ray).copied().unwrap_or(1.0) };
        let moved = sweep.is_moving().then(|| level_from_world.after(sweep.at(ray)));
        let point = moved.as_ref().unwrap_or(&still).apply([reach * cosine, reach * sine, 0.0]);
        level.heights.push(if range.is_finite() { point[2] } else { f64::NAN });
        if exact {
            bearing += turn(libm::atan2(point[1], point[0]) - bearing);
            let horizontal = (point[0] * point[0] + point[1] * point[1]).sqrt();
            level.scan.ranges.push(if range.is_finite() { horizontal } else { range });
            level.scan.bearings.push(bearing);
        }
    }
    Ok(level)
}

/// Eq. 5: `raw` with ranges times cos(pitch) cos(roll), which is the cosine between both z axes.
fn shrunk(raw: &PolarScan, level_from_lidar: &Transform) -> LevelScan {
    let factor = level_from_lidar.rotation[2][2].abs(); // a range, upside down as well
    let scan = PolarScan {
        ranges: raw.ranges.iter().map(|range| range * factor).collect(),
        bearings: raw.bearings.clone(),
    };
    LevelScan { scan, heights: Vec::new() }
}

/// For every ray, the range of the nearest hit, counted in rays [m]; a very large range if there is
/// no hit.
fn nearest_hits(ranges: &[f64]) -> Vec<f64> {
    const NOTHING_HIT: f64 = 1e6; // [m]: the direction alone
    let mut nearest = vec![(usize::MAX, NOTHING_HIT); ranges.len()];
    let mut last: Option<(usize, f64)> = None;
    for (ray, &range) in ranges.iter().enumerate() {
        last = if range.is_finite() { Some((ray, range)) } else { last };
        if let Some((hit, reach)) = last {
            nearest[ray] = (ray - hit, reach);
        }
    }
    last = None;
    for (ray, &range) in ranges.iter().enumerate().rev() {
        last = if range.is_finite() { Some((ray, range)) } else { last };
        if let Some((hit, reach)) = last.filter(|&(hit, _)| hit - ray < nearest[ray].0) {
            nearest[ray] = (hit - ray, reach);
        }
    }
    nearest.into_iter().map(|(_, reach)| reach).collect()
}

fn check(ranges: &[f64], got: usize, sweep: &SweepPoses) -> Result<(), Error> {
    let expected = ranges.len();
    if got != expected {
        return Err(Error::Length { name: "bearings", expected, got });
    }
    match sweep.rays().filter(|&got| got != expected) {
        Some(got) => Err(Error::Length { name: "ray_time_ns", expected, got }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const LEVEL: Transform = Transform::IDENTITY;

    fn pitched(angle: f64) -> Transform {
        let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
        let rotation = [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]];
        Transform { rotation, translation: [0.0; 3] }
    }

    #[test]
    fn beyond_the_volume_is_a_miss_and_before_it_no_information() -> Result<(), Error> {
        let ahead = [[1.0, 0.0]; 5];
        let ranges = [3.0, 5.0, 1.0, f64::INFINITY, f64::NAN];
        let slab = [[1.0, 0.0, 0.0, 4.0], [-1.0, 0.0, 0.0, -2.0]]; // 2 <= x <= 4
        let limited = limit_range(&ranges, &ahead, &SweepPoses::still(LEVEL), &slab)?;
        assert_eq!(limited[..2], [3.0, f64::INFINITY]);
        assert!(limited[2].is_nan() && limited[3] == f64::INFINITY && limited[4].is_nan());
        let beside = [[0.0, 1.0, 0.0, -1.0]]; // y <= -1: never met
        let limited = limit_range(&ranges[..1], &ahead[..1], &SweepPoses::still(LEVEL), &beside)?;
        assert_eq!(limited, [f64::INFINITY]);
        Ok(())
    }

    #[test]
    fn a_ray_ahead_is_shortened_by_pitch_and_one_abeam_is_not() -> Result<(), Error> {
        let raw = PolarScan { ranges: vec![2.0, 2.0], bearings: vec![0.0, TAU / 4.0] };
        let sweep = SweepPoses::still(pitched(0.3));
        let rays = directions(&raw.bearings);
        let level = project(&raw, &rays, &sweep, Projection::Exact)?;
        let expected = [2.0 * libm::cos(0.3), 2.0];
        for (got, expected) in level.scan.ranges.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-12);
        }
        assert!((level.scan.bearings[1] - raw.bearings[1]).abs() < 1e-12);
        assert!((level.heights[0] + 2.0 * libm::sin(0.3)).abs() < 1e-12);
        let paper = project(&raw, &rays, &sweep, Projection::Paper)?;
        assert!((paper.scan.ranges[1] - expected[0]).abs() < 1e-12);
        Ok(())
    }

    #[test]
    fn misses_look_where_the_nearest_hit_is() {
        let inf = f64::INFINITY;
        assert_eq!(nearest_hits(&[inf, 2.0, inf, inf, 5.0]), [2.0, 2.0, 2.0, 5.0, 5.0]);
        assert_eq!(nearest_hits(&[inf]), [1e6]);
    }
}
