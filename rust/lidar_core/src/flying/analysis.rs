//! Limits of a sensor: uncertainty of measured points, probability that the right voxel is updated,
//! and probability that a ray hits a target. Source: Vrba et al., sec. IV.

use crate::Error;
use crate::error::require;
use crate::estimation::probability::box_probability;
use crate::geometry::caps::{Cap, Directions};
use crate::geometry::lattice::{Lattice, wide};
use crate::geometry::transform::{Transform, cross, direction_of, minus, norm};
use crate::util::budget::{check_memory, check_points};
use crate::util::{cancel, threads};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

/// Number of points that are handed to a thread at a time.
const POINTS_PER_CHUNK: usize = 1024;
/// Smallest field of view, as a share of the sphere.
const LEAST_VIEW: f64 = 1e-6;
/// Largest standard deviation of a range that is accepted [m].
const LARGEST_RANGE_STD: f64 = 100.0;

/// Covariances of measured points in the world [m^2], from those of the pose and of the range.
///
/// `pose_covariance` is that of the translation [m] and of the angles alpha, beta, gamma [rad] of
/// `R = Rz(gamma) Ry(beta) Rx(alpha)`; `range_std` [m]. The covariance of a point that is not
/// finite is not finite either. A point in the sensor itself has no range error, because it has no
/// direction.
///
/// # Errors
/// [`Error::Limit`] for too many points, [`Error::Parameter`] for a `range_std` beyond 0 to 100 m.
///
/// # Source
/// Vrba et al., eqs 34-44.
pub fn point_covariance(
    points_lidar: &[[f32; 3]],
    world_from_lidar: &Transform,
    pose_covariance: &[[f64; 6]; 6],
    range_std: f64,
) -> Result<Vec<[[f64; 3]; 3]>, Error> {
    check_points(points_lidar.len())?;
    check_memory("covariances", points_lidar.len(), size_of::<[[f64; 3]; 3]>())?;
    let is_std = (0.0..=LARGEST_RANGE_STD).contains(&range_std);
    require(is_std, "range_std", "0 to 100 [m]", range_std)?;
    let of_point = |&point: &[f32; 3]| {
        let jacobian = point_jacobian(world_from_lidar, wide(point));
        let mut covariance = propagated(&jacobian, pose_covariance);
        for (a, line) in covariance.iter_mut().enumerate() {
            for (b, entry) in line.iter_mut().enumerate() {
                *entry += range_std * range_std * (jacobian[a][6] * jacobian[b][6]);
            }
        }
        covariance
    };
    Ok(points_lidar.iter().map(of_point).collect())
}

/// Derivative of a measured point by translation, angles and range (eq. 42). `pose`: of the sensor;
/// `point_lidar`: the point in the frame of the sensor [m].
pub(crate) fn point_jacobian(pose: &Transform, point_lidar: [f64; 3]) -> [[f64; 7]; 3] {
    let by_pose = pose_jacobian(pose, pose.apply(point_lidar));
    let range = norm(point_lidar);
    let along = pose.rotate(point_lidar);
    std::array::from_fn(|row| {
        std::array::from_fn(|column| match column {
            0..6 => by_pose[row][column],
            _ if range == 0.0 => 0.0,
            _ => along[row] / range,
        })
    })
}

/// Probability for each of `points` [m] that the measured surface is in the voxel of the measured
/// point.
///
/// `covariance` [m^2]: one for all points, or one per point. The result is NaN for points that are
/// not finite.
///
/// # Errors
/// [`Error::Length`], [`Error::Limit`], [`Error::PointOutOfRange`], [`Error::Parameter`] for an
/// invalid lattice or number of threads, [`Error::Value`] for the first finite point with an
/// invalid covariance.
///
/// # Source
/// Vrba et al., eqs 45-46.
pub fn hit_probability(
    points: &[[f64; 3]],
    covariance: &[[[f64; 3]; 3]],
    lattice: &Lattice,
    threads: usize,
) -> Result<Vec<f64>, Error> {
    check_points(points.len())?;
    check_memory("probabilities", points.len(), 2 * size_of::<Result<f64, Error>>())?;
    if covariance.len() != 1 && covariance.len() != points.len() {
        let (expected, got) = (points.len(), covariance.len());
        return Err(Error::Length { name: "covariance", expected, got });
    }
    let watch = cancel::watch();
    let of_point = |index: usize| {
        watch.check()?;
        let point = points[index];
        if !point.iter().all(|value| value.is_finite()) {
            return Ok(f64::NAN);
        }
        let center = lattice.center(lattice.voxel_at(point)?);
        let to_center = minus(center, point);
        let half = 0.5 * lattice.voxel_size();
        let row = if covariance.len() == 1 { 0 } else { index };
        let low = to_center.map(|value| value - half);
        let high = to_center.map(|value| value + half);
        box_probability(&covariance[row], low, high).map_err(|error| match error {
            Error::NotPositiveDefinite { .. } => no_covariance(row, &covariance[row]),
            other => other,
        })
    };
    let hits: Vec<Result<f64, Error>> = threads::pool(threads)?.install(|| {
        (0..points.len()).into_par_iter().with_min_len(POINTS_PER_CHUNK).map(of_point).collect()
    });
    hits.into_iter().collect() // the first error in the order of the points
}

fn no_covariance(index: usize, matrix: &[[f64; 3]; 3]) -> Error {
    let expected = "finite, symmetric, without negative eigenvalues";
    Error::Value { name: "covariance", expected, index, got: format!("{matrix:?}") }
}

/// Probability that at least one ray hits a ball. For each of `distances` [m], the centre of the
/// ball is at this distance in any direction with equal probability.
///
/// A ray hits a ball of `radius` [m] at a distance l if the angle between the ray and the direction
/// of the centre is at most asin(radius / l). These directions are caps around the rays, whose
/// union is measured exactly (to 1e-9). A sensor inside the ball always hits it. `view`: smallest
/// and largest elevation [rad] of the band of directions in which the centre is; (-pi/2, pi/2) is
/// the sphere of the paper.
///
/// # Errors
/// [`Error::Value`] for a direction without length or an invalid distance, [`Error::Parameter`] for
/// other values.
///
/// # Source
/// Vrba et al., eqs 47-49.
pub fn detection_probability(
    directions: &[[f64; 3]],
    radius: f64,
    distances: &[f64],
    view: [f64; 2],
    threads: usize,
) -> Result<Vec<f64>, Error> {
    check_points(directions.len())?;
    let share = check_view(view)?;
    require(radius.is_finite() && radius > 0.0, "radius", "finite and > 0 [m]", radius)?;
    if let Some(index) = distances.iter().position(|d| !(d.is_finite() && *d >= 0.0)) {
        let (expected, got) = ("finite and >= 0 [m]", distances[index].to_string());
        return Err(Error::Value { name: "distance", expected, index, got });
    }
    let units = units(directions)?;
    let pool = threads::pool(threads)?;
    let nearest = distances.iter().copied().filter(|&l| l > radius).fold(f64::INFINITY, f64::min);
    let directions = Directions::new(units, cap_radius(radius, nearest));
    let outside = outside(view);
    let hidden: f64 = outside.iter().map(Cap::area).sum();
    let met = |&distance: &f64| {
        if directions.is_empty() || distance <= radius {
            return if directions.is_empty() { 0.0 } else { 1.0 };
        }
        let covered = directions.covered(&pool, cap_radius(radius, distance), &outside);
        ((covered - hidden) / (4.0 * PI * share)).clamp(0.0, 1.0)
    };
    Ok(distances.iter().map(met).collect())
}

/// The directions as unit vectors.
///
/// # Errors
/// [`Error::Value`] for the first one that has no length or is not finite.
fn units(directions: &[[f64; 3]]) -> Result<Vec<[f64; 3]>, Error> {
    let of_row = |(index, direction): (usize, &[f64; 3])| {
        direction_of(*direction).ok_or_else(|| {
            let (expected, got) = ("a direction", format!("{direction:?}"));
            Error::Value { name: "directions", expected, index, got }
        })
    };
    directions.iter().enumerate().map(of_row).collect()
}

fn cap_radius(radius: f64, distance: f64) -> f64 {
    libm::asin((radius / distance).min(1.0))
}

/// Share of the sphere that is inside a band of elevations [rad].
///
/// # Errors
/// [`Error::Parameter`] if the elevations do not bound a band.
fn check_view([low, high]: [f64; 2]) -> Result<f64, Error> {
    let share = 0.5 * (libm::sin(high) - libm::sin(low));
    let inside = |angle: f64| (-FRAC_PI_2..=FRAC_PI_2).contains(&angle);
    require(
        inside(low) && inside(high) && share >= LEAST_VIEW,
        "field_of_view",
        "least and largest elevation, -pi/2 to pi/2 [rad]",
        format_args!("({low}, {high})"),
    )?;
    Ok(share)
}

/// The caps above and below a band of elevations [rad].
fn outside([low, high]: [f64; 2]) -> Vec<Cap> {
    let above = Cap { center: [0.0, 0.0, 1.0], radius: FRAC_PI_2 - high };
    let below = Cap { center: [0.0, 0.0, -1.0], radius: FRAC_PI_2 + low };
    [above, below].into_iter().filter(|cap| cap.radius > 0.0).collect()
}

/// An uncertain pose, from which the covariances of points in the frame of the map follow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PoseSpread {
    /// Pose of the sensor in the world.
    pub(crate) world_from_lidar: Transform,
    /// Transform from the world to the frame of the map.
    pub(crate) map_from_world: Transform,
    /// Covariance of the pose in the world: translation [m], then the angles of eq. 38 [rad].
    pub(crate) covariance: [[f64; 6]; 6],
}

impl PoseSpread {
    /// Covariance [m^2] of a point of the map's frame that was measured from this pose (eqs 41-42).
    pub(crate) fn at(&self, point: [f64; 3]) -> [[f64; 3]; 3] {
        let in_world = self.map_from_world.inverse().apply(point);
        let jacobian = pose_jacobian(&self.world_from_lidar, in_world);
        self.map_from_world.turn_covariance(&propagated(&jacobian, &self.covariance))
    }
}

/// Derivative of a measured point by the pose: by the translation, then by the angles alpha, beta,
/// gamma of `R = Rz(gamma) Ry(beta) Rx(alpha)` (the first five blocks of eq. 42). `point` is in the
/// target frame of `pose`.
pub(crate) fn pose_jacobian(pose: &Transform, point: [f64; 3]) -> [[f64; 6]; 3] {
    // Turning about an axis u of the rotated frame moves an arm r by u x r: Rx turns about the
    // body's x axis, Rz about the world's z axis, Ry about the y axis that Rz has turned.
    let arm = minus(point, pose.translation);
    let heading = libm::atan2(pose.rotation[1][0], pose.rotation[0][0]);
    let x_axis = std::array::from_fn(|row| pose.rotation[row][0]);
    let y_axis = [-libm::sin(heading), libm::cos(heading), 0.0];
    let turns = [cross(x_axis, arm), cross(y_axis, arm), cross([0.0, 0.0, 1.0], arm)];
    std::array::from_fn(|row| {
        std::array::from_fn(|column| match column {
            0..3 => f64::from(u8::from(row == column)),
            _ => turns[column - 3][row],
        })
    })
}

/// Covariance `J C J'` from a covariance `C` of the pose (eq. 41), exactly symmetric. Columns of
/// `J` beyond the six of the pose are ignored.
pub(crate) fn propagated<const N: usize>(
    jacobian: &[[f64; N]; 3],
    covariance: &[[f64; 6]; 6],
) -> [[f64; 3]; 3] {
    let entry = |a: usize, b: usize| -> f64 {
        (0..6)
            .flat_map(|i| (0..6).map(move |j| (i, j)))
            .map(|(i, j)| jacobian[a][i] * covariance[i][j] * jacobian[b][j])
            .sum()
    };
    std::array::from_fn(|a| std::array::from_fn(|b| 0.5 * (entry(a, b) + entry(b, a))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose([x, y, z, alpha, beta, gamma]: [f64; 6]) -> Transform {
        let (sa, ca) = (libm::sin(alpha), libm::cos(alpha));
        let (sb, cb) = (libm::sin(beta), libm::cos(beta));
        let (sc, cc) = (libm::sin(gamma), libm::cos(gamma));
        Transform {
            rotation: [
                [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
                [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
                [-sb, cb * sa, cb * ca],
            ],
            translation: [x, y, z],
        }
    }

    #[test]
    fn the_jacobian_is_that_of_finite_differences() {
        let at = [1.0, -2.0, 3.0, 0.4, -0.7, 2.1];
        let local = [5.0, 3.0, -1.0];
        let jacobian = point_jacobian(&pose(at), local);
        for column in 0..7 {
            let shifted = |by: f64| {
                if column == 6 {
                    return pose(at).apply(local.map(|value| value * (1.0 + by / norm(local))));
                }
                let mut moved = at;
                moved[column] += by;
                pose(moved).apply(local)
            };
            let difference = minus(shifted(1e-6), shifted(-1e-6));
            for row in 0..3 {
                assert!((difference[row] / 2e-6 - jacobian[row][column]).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn a_certain_pose_leaves_the_range_error_along_the_ray() -> Result<(), Error> {
        let none = [[0.0; 6]; 6];
        let covariance =
            point_covariance(&[[0.0, 5.0, 0.0], [0.0; 3]], &Transform::IDENTITY, &none, 0.1)?;
        assert!((covariance[0][1][1] - 0.01).abs() < 1e-15);
        assert_eq!(covariance[0][0], [0.0; 3]);
        assert_eq!(covariance[1], [[0.0; 3]; 3]);
        Ok(())
    }

    #[test]
    fn one_ray_covers_its_cap() -> Result<(), Error> {
        let whole = [-FRAC_PI_2, FRAC_PI_2];
        let met = detection_probability(&[[0.0, 3.0, 0.0]], 0.5, &[0.4, 5.0, 50.0], whole, 1)?;
        assert_eq!(met[0], 1.0);
        for (share, distance) in met[1..].iter().zip([5.0f64, 50.0]) {
            let exact = 0.5 * (1.0 - (1.0 - (0.5 / distance).powi(2)).sqrt());
            assert!((share / exact - 1.0).abs() < 1e-9, "{share} {exact}");
        }
        Ok(())
    }
}
