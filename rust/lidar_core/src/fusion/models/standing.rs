//! Targets at rest.

use super::cartesian::ConstantVelocity;
use super::motion::{First, INPUTS, Motion, Noise, PlaneMotion, Prior};
use super::platform::Platform;
use super::state_conversion::StateConversion;
use super::world::Plane;
use crate::estimation::kalman::Gaussian;
use nalgebra::{SMatrix, SVector, Vector2, Vector4};

/// Duration of an acceleration, after which the target is at rest again [s]: the acceleration
/// changes the position and leaves no velocity.
const REST: f64 = 0.02;

/// Share of stops among changes of motion, relative to changes to another model.
const STOPS: f64 = 0.1;

/// A target at rest whose position hardly changes: [x, y, vx, vy] with vx = vy = 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StandingTarget;

/// Columns that respond by `shift` in x and y.
fn shifts(shift: f64) -> SMatrix<f64, 4, INPUTS> {
    let mut columns = SMatrix::<f64, 4, INPUTS>::zeros();
    (columns[(0, 0)], columns[(1, 1)]) = (shift, shift);
    columns
}

/// A place with its covariance, at rest.
fn at_rest(place: [f64; 2], covariance: [[f64; 2]; 2]) -> Gaussian<4> {
    let mut wide = SMatrix::<f64, 4, 4>::zeros();
    for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        wide[(row, column)] = covariance[row][column];
    }
    Gaussian { mean: Vector4::new(place[0], place[1], 0.0, 0.0), covariance: wide }
}

impl Motion<4> for StandingTarget {
    type World = Plane;
    const NOISES: [Noise; INPUTS] = [Noise::Acceleration, Noise::Acceleration, Noise::Absent];
    const HEADING: Option<usize> = None;

    fn propagate(&self, s: &Vector4<f64>, _: f64, _: &Platform) -> Vector4<f64> {
        Vector4::new(s[0], s[1], 0.0, 0.0)
    }

    fn transition(
        &self,
        s: &Vector4<f64>,
        dt: f64,
        platform: &Platform,
    ) -> (Vector4<f64>, SMatrix<f64, 4, 4>) {
        let mut stays = SMatrix::<f64, 4, 4>::zeros();
        (stays[(0, 0)], stays[(1, 1)]) = (1.0, 1.0);
        (self.propagate(s, dt, platform), stays)
    }

    fn impulses(&self, _: &Vector4<f64>, _: f64, _: &Platform) -> SMatrix<f64, 4, INPUTS> {
        shifts(REST)
    }

    fn step_response(&self, _: &Vector4<f64>, dt: f64) -> SMatrix<f64, 4, INPUTS> {
        shifts(REST * dt)
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<4> {
        let known = first.covariance::<4, 2>(prior, &[0.0; 2]);
        let [x, y, _] = first.position;
        at_rest([x, y], [0, 1].map(|row| [0, 1].map(|column| known[(row, column)])))
    }
}

impl PlaneMotion<4> for StandingTarget {
    fn velocity(&self, s: &Vector4<f64>, _: &Platform) -> (Vector2<f64>, SMatrix<f64, 2, 4>) {
        let mut jacobian = SMatrix::<f64, 2, 4>::zeros();
        (jacobian[(0, 2)], jacobian[(1, 3)]) = (1.0, 1.0);
        (Vector2::new(s[2], s[3]), jacobian)
    }
}

impl StateConversion<4> for StandingTarget {
    /// Mean time for which a target at rest stays there [s]: minutes.
    const SOJOURN: Option<f64> = Some(300.0);
    /// How often a new target stands, relative to other models: in a crowd, at first only targets
    /// at rest are measured again at the same place.
    const OF_NEW: f64 = 0.3;

    fn cartesian(&self, state: &Gaussian<4>, other: Option<&Gaussian<6>>) -> Gaussian<6> {
        ConstantVelocity.cartesian(state, other)
    }

    /// The tendency is smaller for an uncertain position: a large covariance that does not grow
    /// would fit measurements of different objects.
    fn tendency(&self, at: &Gaussian<6>, prior: &Prior) -> f64 {
        let widest = at.covariance[(0, 0)].max(at.covariance[(1, 1)]);
        STOPS * (prior.position / widest).min(1.0)
    }

    /// The velocity of a target that has stopped is lost.
    fn adopted(&self, cartesian: &Gaussian<6>) -> Gaussian<4> {
        let place: SVector<f64, 2> = cartesian.mean.fixed_rows::<2>(0).into();
        let known = &cartesian.covariance;
        at_rest(place.data.0[0], [0, 1].map(|row| [0, 1].map(|column| known[(row, column)])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::models::motion::tests::check_in_plane as check;
    use nalgebra::{Matrix6, Vector6};

    #[test]
    fn the_model_agrees_with_differences() {
        for dt in [0.02, 0.3] {
            check(&StandingTarget, &Vector4::new(1.0, 2.0, 0.0, 0.0), dt, &Platform::still());
        }
    }

    #[test]
    fn what_has_stopped_keeps_its_place_only() {
        let mean = Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0);
        let covariance = Matrix6::from_fn(|r, c| if r == c { 2.0 } else { 0.1 });
        let state = StandingTarget.adopted(&Gaussian { mean, covariance });
        assert_eq!(state.mean, Vector4::new(1.0, 2.0, 0.0, 0.0));
        assert_eq!(state.covariance[(0, 1)], 0.1);
        assert_eq!(state.covariance.fixed_view::<2, 2>(2, 2).abs().max(), 0.0);
        let known = Gaussian { mean: 9.0 * mean, covariance: 9.0 * covariance };
        let back = StandingTarget.cartesian(&state, Some(&known));
        assert_eq!(back.mean, Vector6::new(1.0, 2.0, 0.0, 0.0, 45.0, 54.0));
        assert_eq!(back.covariance[(5, 5)], 18.0);
    }
}
