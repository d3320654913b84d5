//! Centre of a target, of which a scan shows only the near side.
//!
//! The centroid of its points (eq. 19) lies nearer to the sensor by up to the target's radius, as
//! the paper says itself (sec. V-A). Here two models of the target are held against the points
//! and against the rays that passed beside them, and weighed by how well they agree: a solid ball,
//! whose centre and radius the points and the passing rays determine, and an open frame as of a
//! multicopter, whose centre lies behind the centroid by a share of its width.

mod filled;
mod frame;
mod sphere;
mod target_observation;

#[cfg(test)]
mod tests;

pub(in crate::flying::detect) use filled::of_expected;
pub(crate) use target_observation::{
    PassingRays, RaySource, TargetHit, TargetObservation, TargetRay, TargetRegion,
};

use crate::Error;
use crate::error::require;
use crate::estimation::kalman::symmetrised;
use crate::geometry::transform::norm;
use crate::util::budget::check_points;
use frame::OpenFrame;
use nalgebra::{Matrix3, Vector3};
use sphere::Sphere;

/// Centre of a target's circumscribed sphere, estimated from one scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Center {
    /// Position [m].
    pub position: Vector3<f64>,
    /// Covariance of the centre [m^2].
    pub covariance: Matrix3<f64>,
    /// Radius of the sphere [m].
    pub radius: f64,
    /// Radius under the assumption that rays pass as near to each other as its points are [m]: at
    /// most `radius`, and less if the rays that passed are unknown.
    pub least_radius: f64,
    /// Share of the rays inside the ellipse of its points that hit, 0 to 1: small for loose objects
    /// such as leaves.
    pub filled_share: f64,
    /// True if rays pass below it; None if unknown.
    pub is_free_below: Option<bool>,
    /// Whether something nearer may hide a part of the target.
    pub is_cut: bool,
    /// Whether it ends at the edge of something nearer, to a side or above.
    pub is_at_edge: bool,
}

/// Squared residuals per degree of freedom at which ball and frame are equally likely.
const EVEN_RATIO: f64 = 2.0;
/// How fast the ball loses beyond it.
const RATIO_STEEPNESS: f64 = 3.0;
/// A few points fit any ball: so many imagined degrees of freedom, at the even ratio.
const IMAGINED_FREEDOM: f64 = 2.0;
/// A ball is at most so many times as large as the outline that its points and the gaps between rays leave.
/// Beyond that its weight falls with this power of the ratio: more rays would have met it. Where it is not
/// known which rays passed, a row of points fits large balls above it and below it as well as a small one.
const LARGEST_BALL: f64 = 1.5;
const SIZE_POWER: i32 = 8;
/// Solid share from which on a target may be a ball, and from which on its rays do not speak
/// against it.
const BALL_SHARE: [f64; 2] = [0.4, 0.55];

/// The centre of a target, from its points [m], where they were seen from, and the directions of
/// rays that passed beside it, in a frame whose z axis points up. Directions need not have unit
/// length; rays more than 0.4 m beside the points do not count.
///
/// # Errors
/// [`Error::Value`] for the first entry that is not finite, or a direction without length;
/// [`Error::Length`] without points; [`Error::Limit`] for too many.
pub fn target_center(
    points: &[[f64; 3]],
    origin: [f64; 3],
    passing: &[[f64; 3]],
    range_std: f64,
) -> Result<Center, Error> {
    check_points(points.len().max(passing.len()))?;
    if points.is_empty() {
        return Err(Error::Length { name: "points_world", expected: 1, got: 0 });
    }
    let is_std = range_std.is_finite() && range_std >= 0.0;
    require(is_std, "range_std", "finite and >= 0", range_std)?;
    check_finite("sensor_origin", &[origin], |_| true)?;
    check_finite("points_world", points, |_| true)?;
    check_finite("passing_directions", passing, |way| norm(way) > 0.0)?;
    let hits: Vec<TargetHit> = points.iter().map(|&point| TargetHit::new(origin, point)).collect();
    let region = TargetRegion::of(&hits);
    let ray = |&way: &[f64; 3]| TargetRay {
        origin: origin.into(),
        direction: Vector3::from(way).normalize(),
    };
    let near = |ray: &TargetRay| ray.aside(&region.middle).norm() <= region.reach();
    let passing = passing.iter().map(ray).filter(near).collect();
    let around = PassingRays { passing, ..PassingRays::default() };
    Ok(Center::of(&TargetObservation::new(hits, around), range_std))
}

fn check_finite(
    name: &'static str,
    rows: &[[f64; 3]],
    is_usable: impl Fn([f64; 3]) -> bool,
) -> Result<(), Error> {
    let is_bad = |row: &[f64; 3]| !row.iter().all(|value| value.is_finite()) || !is_usable(*row);
    match rows.iter().position(is_bad) {
        Some(index) => {
            let got = format!("{:?}", rows[index]);
            Err(Error::Value {
                name,
                expected: "finite coordinates, directions not zero",
                index,
                got,
            })
        }
        None => Ok(()),
    }
}

impl Center {
    /// Estimate the centre of what was hit; `range_std` is the noise of ranges [m].
    ///
    /// The order of hits and of passing rays does not matter.
    pub(crate) fn of(observation: &TargetObservation, range_std: f64) -> Self {
        let frame = OpenFrame::of(observation, range_std);
        let fitted = Sphere::fit(observation, &frame.start(), range_std);
        let Some(ball) = fitted else { return frame.into_center(observation) };
        let weight = ball_weight(&ball, &frame, observation.hits.len());
        let offset = ball.center - frame.position;
        Self {
            position: frame.position + weight * offset,
            covariance: symmetrised(
                weight * ball.covariance
                    + (1.0 - weight) * frame.covariance
                    + weight * (1.0 - weight) * offset * offset.transpose(),
            ),
            radius: weight * ball.radius + (1.0 - weight) * frame.radius,
            least_radius: weight * ball.radius.min(LARGEST_BALL * frame.least_radius)
                + (1.0 - weight) * frame.least_radius,
            filled_share: frame.filled_share,
            is_free_below: frame.is_free_below,
            is_cut: observation.is_cut,
            is_at_edge: observation.is_at_edge,
        }
    }
}

/// Probability of the ball against the frame, 0 to 1.
fn ball_weight(ball: &Sphere, frame: &OpenFrame, n_hits: usize) -> f64 {
    let freedom = n_hits.saturating_sub(sphere::PARAMETERS) as f64;
    let imagined = EVEN_RATIO * IMAGINED_FREEDOM;
    let ratio = (ball.squared_residuals + imagined) / (freedom + IMAGINED_FREEDOM);
    let agrees = 1.0 / (1.0 + libm::exp(RATIO_STEEPNESS * (ratio - EVEN_RATIO)));
    let fits = (LARGEST_BALL * frame.radius / ball.radius).min(1.0).powi(SIZE_POWER);
    let [from, full] = BALL_SHARE;
    agrees * fits * ((frame.solid_share - from) / (full - from)).clamp(0.0, 1.0)
}
