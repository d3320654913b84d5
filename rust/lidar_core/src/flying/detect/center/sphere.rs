//! Fit of a ball: points are on its surface, and passing rays miss it.

use super::target_observation::{TargetHit, TargetObservation, TargetRay};
use super::{Matrix3, Vector3};
use nalgebra::{SMatrix, SVector};

/// Number of parameters of the fit: centre and radius.
pub(crate) const PARAMETERS: usize = 4;
const MAX_STEPS: usize = 20;
/// Smallest gain of a step, as a share of the cost. A smaller one ends the fit.
const LEAST_GAIN: f64 = 1e-9;
/// Prior of the radius [m]: mean, standard deviation and limits, in this and the next constants.
const RADIUS_MEAN: f64 = 0.3;
/// Standard deviation of the prior of the radius [m].
const RADIUS_STD: f64 = 0.25;
/// Smallest and largest radius [m].
const RADIUS_RANGE: [f64; 2] = [0.02, 2.0];
/// Standard deviation of the centre around the start of the fit [m]. A few points do not determine
/// the centre in all directions.
const PLACE_STD: f64 = 0.5;
/// Standard deviation of the depth at which a passing ray may enter the ball [m].
const PASSING_STD: f64 = 0.01;
/// Smallest cosine of the angle of incidence that is used. At grazing incidence, a range gives no
/// further information about the surface.
const LEAST_COSINE: f64 = 0.3;
/// Standard deviation of the centre as a share of the radius, since no target is a perfect ball.
const SHAPE_STD: f64 = 0.01;
/// Error of the centre along the line of sight that noise leaves, as a share of the standard
/// deviation of a range.
const NOISE_BIAS: f64 = 0.3;

type Vector4 = SVector<f64, PARAMETERS>;
type Matrix4 = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Start values of a fit: centre and radius [m].
pub(crate) struct Start {
    pub(crate) center: Vector3<f64>,
    pub(crate) radius: f64,
}

/// A fitted ball.
pub(super) struct Sphere {
    pub(crate) center: Vector3<f64>,
    pub(crate) radius: f64,
    pub(crate) covariance: Matrix3<f64>,
    /// Sum of the squared residuals of the points, in units of their noise.
    pub(super) squared_residuals: f64,
}

/// Normal equations of the linearised least-squares problem, and its cost.
#[derive(Clone, Copy)]
struct Normal {
    matrix: Matrix4,
    vector: Vector4,
    cost: f64,
    /// The part of the cost that comes from the points.
    points: f64,
}

impl Sphere {
    /// Fit by Levenberg-Marquardt: distances of points from the surface, depths of passing rays
    /// inside the ball, and the prior of the radius. None if the equations cannot be solved.
    pub(crate) fn fit(
        observation: &TargetObservation,
        start: &Start,
        range_std: f64,
    ) -> Option<Self> {
        let mut at = start.center.push(start.radius);
        let mut sums = Normal::at(observation, &at, start, range_std);
        let mut damping = 1e-3;
        for _ in 0..MAX_STEPS {
            let damped = sums.matrix + Matrix4::from_diagonal(&(damping * sums.matrix.diagonal()));
            let mut next = at - damped.cholesky()?.solve(&sums.vector);
            next[3] = next[3].clamp(RADIUS_RANGE[0], RADIUS_RANGE[1]);
            let there = Normal::at(observation, &next, start, range_std);
            if there.cost < sums.cost {
                let is_last = sums.cost - there.cost < LEAST_GAIN * sums.cost;
                (at, sums) = (next, there);
                damping /= 10.0;
                if is_last {
                    break;
                }
            } else {
                damping *= 10.0;
            }
        }
        let spread = sums.matrix.cholesky()?.inverse();
        let (center, radius) = (at.fixed_rows::<3>(0).into_owned(), at[3]);
        let forward = (center - observation.origin()).try_normalize(f64::MIN_POSITIVE)?;
        let (shape, bias) = (SHAPE_STD * radius, NOISE_BIAS * range_std);
        Some(Self {
            center,
            radius,
            covariance: spread.fixed_view::<3, 3>(0, 0)
                + Matrix3::identity() * (shape * shape)
                + forward * forward.transpose() * (bias * bias),
            squared_residuals: sums.points,
        })
    }
}

impl Normal {
    fn at(observation: &TargetObservation, at: &Vector4, start: &Start, range_std: f64) -> Self {
        let (center, radius) = (at.fixed_rows::<3>(0).into_owned(), at[3]);
        let mut sums = Self::of_what_is_known(&(center - start.center), radius);
        let before = sums.cost;
        for hit in &observation.hits {
            sums.add_hit(hit, &center, radius, range_std);
        }
        sums.points = sums.cost - before;
        for ray in observation.near_passing() {
            sums.add_passing(ray, &center, radius);
        }
        sums
    }

    fn of_what_is_known(offset: &Vector3<f64>, radius: f64) -> Self {
        let mut sums =
            Self { matrix: Matrix4::zeros(), vector: Vector4::zeros(), cost: 0.0, points: 0.0 };
        for axis in 0..3 {
            let mut slope = Vector4::zeros();
            slope[axis] = 1.0 / PLACE_STD;
            sums.add(offset[axis] / PLACE_STD, &slope);
        }
        let slope = Vector4::new(0.0, 0.0, 0.0, 1.0 / RADIUS_STD);
        sums.add((radius - RADIUS_MEAN) / RADIUS_STD, &slope);
        sums
    }

    /// Add a point to the equations. Its range noise counts towards the surface by the cosine of
    /// the angle of incidence.
    fn add_hit(&mut self, hit: &TargetHit, center: &Vector3<f64>, radius: f64, range_std: f64) {
        let offset = hit.point - center;
        let distance = offset.norm().max(1e-9);
        let aside = hit.ray.aside(center).norm();
        let cosine = (1.0 - (aside / radius).powi(2)).max(LEAST_COSINE * LEAST_COSINE).sqrt();
        let scale = 1.0 / (range_std.max(1e-3) * cosine);
        let slope = (-offset / distance).push(-1.0) * scale;
        self.add((distance - radius) * scale, &slope);
    }

    fn add_passing(&mut self, ray: &TargetRay, center: &Vector3<f64>, radius: f64) {
        let aside = ray.aside(center);
        let distance = aside.norm().max(1e-9);
        if distance < radius && (center - ray.origin).dot(&ray.direction) > 0.0 {
            let slope = (-aside / distance).push(1.0) / PASSING_STD;
            self.add((radius - distance) / PASSING_STD, &slope);
        }
    }

    fn add(&mut self, residual: f64, slope: &Vector4) {
        self.matrix += slope * slope.transpose();
        self.vector += slope * residual;
        self.cost += residual * residual;
    }
}
