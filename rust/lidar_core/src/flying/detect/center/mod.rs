//! Estimation of the centre of a target, of which a scan shows only the near side.
//!
//! The centroid of the points (eq. 19) is nearer to the sensor than the centre, by up to the
//! target's radius, as the paper itself says (sec. V-A). Here two models of the target are compared
//! with the points and the passing rays, and weighed by how well they agree: a solid ball, whose
//! centre and radius follow from both, and an open frame like that of a multicopter, whose centre
//! is behind the centroid by a share of its width.

mod coherence;
mod filled;
mod frame;
mod sphere;
mod target_observation;

#[cfg(test)]
mod tests;

pub use coherence::Coherence;
#[cfg(test)]
pub(crate) use coherence::DIRECTIONS;
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

/// Centre of the sphere around a target, estimated from one scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Center {
    /// Position of the centre [m], in the frame of the points.
    pub position: Vector3<f64>,
    /// Covariance of the position [m^2].
    pub covariance: Matrix3<f64>,
    /// Radius of the sphere [m].
    pub radius: f64,
    /// Radius if the rays beside the target were as close to each other as its points [m]. It is at
    /// most `radius`, and smaller if it is not known which rays passed.
    pub least_radius: f64,
    /// Fill: share of the rays inside the ellipse around the points that hit, 0 to 1. It is small
    /// for loose objects such as leaves.
    pub filled_share: f64,
    /// Hits next to hits beyond chance: many on a body, none in dust.
    pub coherence: Coherence,
    /// Whether rays pass below the target. None if unknown.
    pub is_free_below: Option<bool>,
    /// Whether a nearer object may hide a part of the target.
    pub is_cut: bool,
    /// Whether the target ends at the edge of a nearer object, to a side or above.
    pub is_at_edge: bool,
}

/// Squared residuals per degree of freedom at which the ball and the frame are equally probable.
const EVEN_RATIO: f64 = 2.0;
/// Steepness with which the probability of the ball falls beyond [`EVEN_RATIO`].
const RATIO_STEEPNESS: f64 = 3.0;
/// Number of imagined degrees of freedom with residuals at the even ratio. Without them, a few
/// points would fit any ball.
const IMAGINED_FREEDOM: f64 = 2.0;
/// Largest ratio of the ball's radius to that of the outline, from its points and the gaps between
/// rays. Beyond it the weight of the ball falls with a power of the ratio, since more rays would
/// have met a larger ball. If it is not known which rays passed, a row of points fits large balls
/// above and below it as well as a small one.
const LARGEST_BALL: f64 = 1.5;
const SIZE_POWER: i32 = 8;
/// Solid share from which on a target may be a ball, and from which on its rays do not contradict a
/// ball at all.
const BALL_SHARE: [f64; 2] = [0.4, 0.55];

/// Estimate the centre of a target from its points [m], the place from which they were seen, and
/// the directions of rays that passed beside it, in a frame whose z axis points up. Directions need
/// not have unit length. Rays more than 0.4 m beside the points are ignored. `range_std`: standard
/// deviation of ranges [m].
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
    let passing: Vec<TargetRay> = passing.iter().map(ray).filter(near).collect();
    let around = PassingRays { missed: passing.clone(), passing, ..PassingRays::default() };
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
    /// Estimate the centre of the target. `range_std`: standard deviation of ranges [m].
    ///
    /// The result does not depend on the order of hits and passing rays.
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
            coherence: frame.coherence,
            is_free_below: frame.is_free_below,
            is_cut: observation.is_cut,
            is_at_edge: observation.is_at_edge,
        }
    }
}

/// Probability that the target is a ball and not an open frame, 0 to 1.
fn ball_weight(ball: &Sphere, frame: &OpenFrame, n_hits: usize) -> f64 {
    let freedom = n_hits.saturating_sub(sphere::PARAMETERS) as f64;
    let imagined = EVEN_RATIO * IMAGINED_FREEDOM;
    let ratio = (ball.squared_residuals + imagined) / (freedom + IMAGINED_FREEDOM);
    let agrees = 1.0 / (1.0 + libm::exp(RATIO_STEEPNESS * (ratio - EVEN_RATIO)));
    let fits = (LARGEST_BALL * frame.radius / ball.radius).min(1.0).powi(SIZE_POWER);
    let [from, full] = BALL_SHARE;
    agrees * fits * ((frame.solid_share - from) / (full - from)).clamp(0.0, 1.0)
}
