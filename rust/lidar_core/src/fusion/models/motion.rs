//! Interface of motion models, and the process noise that drives them.

#![allow(non_snake_case)] // textbook letters

use super::platform::Platform;
use super::world::{Plane, Space, World};
use crate::estimation::kalman::{Gaussian, add_scaled};
use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

/// Largest number of independent noises that drive a model.
pub const INPUTS: usize = 3;

/// A noise that drives a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Noise {
    /// Acceleration of the target.
    Acceleration,
    /// Jerk of the target.
    Jerk,
    /// Angular acceleration of the target.
    Turn,
    /// Angular acceleration of the platform.
    Platform,
    /// Change of the bias of a gyro.
    Gyro,
    /// No noise: the model has fewer than three.
    Absent,
}

/// Variances of the states before the second measurement of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Variance of the position, per axis [m^2].
    pub position: f64,
    /// Variance of the speed, or of the velocity per axis [m^2/s^2].
    pub speed: f64,
    /// Variance of the heading [rad^2].
    pub heading: f64,
    /// Variance of the turn rate [rad^2/s^2].
    pub turn_rate: f64,
    /// Variance of the acceleration, per axis [m^2/s^4].
    pub acceleration: f64,
    /// Variance of the turn rate of the platform, where it is estimated [rad^2/s^2].
    pub platform_rate: f64,
}

impl Default for Prior {
    #[allow(clippy::approx_constant)] // 0.7071 m is what ships, not the root of 1/2
    fn default() -> Self {
        let [position, speed, heading, turn_rate, acceleration, platform_rate] =
            [0.7071, 5.0, 1.732, 1.0, 3.0, 1.0].map(|std: f64| std * std);
        Self { position, speed, heading, turn_rate, acceleration, platform_rate }
    }
}

/// First sight of a target: its position, and its velocity along the line of sight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct First {
    /// Position in the frame of the state [m]; z is zero in the plane.
    pub position: [f64; 3],
    /// Speed away from the sensor [m/s]; zero where it is not measured.
    pub speed: f64,
    /// Direction of the speed, counter-clockwise from x [rad].
    pub heading: f64,
    /// Elevation of the direction above the plane of x and y [rad].
    pub elevation: f64,
    /// Covariance of the position [m^2]; None for the variances of the prior.
    pub noise: Option<Matrix3<f64>>,
    /// Variance of the speed [m^2/s^2]; None for that of the prior.
    pub speed_variance: Option<f64>,
}

impl First {
    /// Variance of a speed that is not measured [m^2/s^2].
    #[must_use]
    pub fn spread(&self, prior: &Prior) -> f64 {
        self.speed_variance.unwrap_or(prior.speed)
    }

    /// Covariance of the first state: position block (D x D), then the given variances on the
    /// diagonal.
    #[must_use]
    pub fn covariance<const N: usize, const D: usize>(
        &self,
        prior: &Prior,
        variances: &[f64],
    ) -> SMatrix<f64, N, N> {
        let mut covariance = SMatrix::zeros();
        for (index, variance) in variances.iter().enumerate() {
            covariance[(D + index, D + index)] = *variance;
        }
        for (row, column) in (0..D).flat_map(|row| (0..D).map(move |column| (row, column))) {
            let told = if row == column { prior.position } else { 0.0 };
            covariance[(row, column)] = self.noise.map_or(told, |noise| noise[(row, column)]);
        }
        covariance
    }
}

/// A motion model with N states; the first ones are the position.
///
/// The state is in the frame of the sensor if the sensor stands still or the model moves it, else
/// in the world.
pub trait Motion<const N: usize>: Clone + Send + Sync + 'static {
    /// World of the model: plane or space.
    type World: World;
    /// Noises that drive the model, in the order of the columns of [`Self::impulses`].
    const NOISES: [Noise; INPUTS];
    /// Index of the state that is a heading: it is kept unwrapped and wrapped on output. None for a
    /// model without heading.
    const HEADING: Option<usize>;
    /// Index of the state that is the turn rate of the platform; None for a model without this
    /// state.
    const PLATFORM_RATE: Option<usize> = None;

    /// State after `dt` [s].
    fn propagate(&self, s: &SVector<f64, N>, dt: f64, platform: &Platform) -> SVector<f64, N>;

    /// State after `dt` [s], with its Jacobian.
    fn transition(
        &self,
        s: &SVector<f64, N>,
        dt: f64,
        platform: &Platform,
    ) -> (SVector<f64, N>, SMatrix<f64, N, N>);

    /// Response of the state, `dt` after it was `s`, to a unit impulse of each noise at `s`.
    fn impulses(
        &self,
        s: &SVector<f64, N>,
        dt: f64,
        platform: &Platform,
    ) -> SMatrix<f64, N, INPUTS>;

    /// Visit the responses of the state `end` to unit impulses that came `rests` [s] before it.
    fn responses(
        &self,
        end: &SVector<f64, N>,
        rests: [f64; 3],
        platform: &Platform,
        mut visit: impl FnMut(&SMatrix<f64, N, INPUTS>),
    ) {
        for rest in rests {
            // Only the end of the step is known: moved backwards it gives the state at the impulse.
            visit(&self.impulses(&self.propagate(end, -rest, platform), rest, platform));
        }
    }

    /// Response to each noise when it is constantly 1 for `dt` [s], on a straight line.
    fn step_response(&self, s: &SVector<f64, N>, dt: f64) -> SMatrix<f64, N, INPUTS>;

    /// Response to the error of a given input, times its standard deviation; None for a model
    /// without such an input.
    fn input_response(
        &self,
        _s: &SVector<f64, N>,
        _dt: f64,
        _platform: &Platform,
    ) -> Option<SVector<f64, N>> {
        None
    }

    /// State of a target that has been seen once.
    fn first(&self, first: &First, prior: &Prior) -> Gaussian<N>;

    /// State of a target with known position and velocity; None for models that start by
    /// themselves.
    fn after_velocity(
        &self,
        _cv: &<Self::World as World>::Cv,
        _prior: &Prior,
    ) -> Option<Gaussian<N>> {
        None
    }
}

/// A motion in the plane; the first two states are the position.
pub trait PlaneMotion<const N: usize>: Motion<N, World = Plane> {
    /// Velocity relative to the origin of the state's frame, and its Jacobian.
    fn velocity(
        &self,
        s: &SVector<f64, N>,
        platform: &Platform,
    ) -> (Vector2<f64>, SMatrix<f64, 2, N>);
}

/// A motion in space; the first three states are the position.
pub trait SpaceMotion<const N: usize>: Motion<N, World = Space> {
    /// Velocity in the frame of the state, and its Jacobian.
    fn velocity(&self, s: &SVector<f64, N>) -> (Vector3<f64>, SMatrix<f64, 3, N>);
}

/// Time behaviour of the process noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoiseForm {
    /// White in continuous time: strengths are roots of spectral densities. Two half steps give the
    /// same noise as one whole step.
    Continuous,
    /// Constant over a step: strengths are standard deviations, and the noise per second depends
    /// on the rate of the measurements.
    Discrete,
}

/// Process noise of a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcessNoise {
    /// Time behaviour of the noise.
    pub form: NoiseForm,
    /// Strength of each noise, in the units that `form` asks for.
    pub strength: [f64; INPUTS],
}

/// Nodes and weights of the Gauss-Legendre rule with three points over 0 to 1.
const NODES: [(f64, f64); 3] = [
    (0.112_701_665_379_258_31, 5.0 / 18.0),
    (0.5, 8.0 / 18.0),
    (0.887_298_334_620_741_7, 5.0 / 18.0),
];

impl ProcessNoise {
    /// Visit columns c whose outer products sum to the covariance Q of the noise of a step from `s`
    /// to `end`: Q is positive semidefinite by construction.
    pub fn columns<const N: usize, M: Motion<N>>(
        &self,
        motion: &M,
        [s, end]: [&SVector<f64, N>; 2],
        dt: f64,
        platform: &Platform,
        mut visit: impl FnMut(&SVector<f64, N>),
    ) {
        let mut visit_scaled = |columns: &SMatrix<f64, N, INPUTS>, scale: f64| {
            for (column, strength) in columns.data.0.iter().zip(self.strength) {
                if strength != 0.0 {
                    // A zero column changes nothing, but costs the square-root filters a rotation
                    // each.
                    visit(&(SVector::from(*column) * (strength * scale)));
                }
            }
        };
        match self.form {
            NoiseForm::Discrete => visit_scaled(&motion.step_response(s, dt), 1.0),
            NoiseForm::Continuous => {
                // The three-point rule is exact up to degree five. Q of constant acceleration has
                // degree four, so the linear models get their exact covariance.
                let rests = NODES.map(|(node, _)| (1.0 - node) * dt);
                // The weight belongs to the product of a column with itself: the column takes its
                // root.
                let mut weights = NODES.iter().map(|(_, weight)| libm::sqrt(weight * dt));
                motion.responses(end, rests, platform, |columns| {
                    weights.next().into_iter().for_each(|weight| visit_scaled(columns, weight));
                });
            }
        }
        if let Some(column) = motion.input_response(s, dt, platform) {
            visit(&column);
        }
    }

    /// Add the covariance of the noise of a step from `ends[0]` to `ends[1]`.
    pub fn add<const N: usize, M: Motion<N>>(
        &self,
        motion: &M,
        ends: [&SVector<f64, N>; 2],
        dt: f64,
        platform: &Platform,
        sum: &mut SMatrix<f64, N, N>,
    ) {
        self.columns(motion, ends, dt, platform, |column| {
            let [entries] = &column.data.0;
            // Adding outer products of columns keeps the sum symmetric bit for bit.
            for row in 0..N {
                add_scaled(&mut sum.data.0[row], entries[row], entries);
            }
        });
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Central difference of a function of the state, column by column.
    pub(crate) fn difference<const N: usize, const M: usize>(
        s: &SVector<f64, N>,
        f: impl Fn(&SVector<f64, N>) -> SVector<f64, M>,
    ) -> SMatrix<f64, M, N> {
        let mut J = SMatrix::<f64, M, N>::zeros();
        for column in 0..N {
            let step = 1e-5 * s[column].abs().max(1.0);
            let mut ends = [*s, *s];
            ends[0][column] += step;
            ends[1][column] -= step;
            J.set_column(column, &((f(&ends[0]) - f(&ends[1])) / (2.0 * step)));
        }
        J
    }

    /// Check everything that models have to fulfil, at one state.
    pub(crate) fn check<const N: usize, M: Motion<N>>(
        motion: &M,
        s: &SVector<f64, N>,
        dt: f64,
        platform: &Platform,
    ) {
        let (after, F) = motion.transition(s, dt, platform);
        assert!((after - motion.propagate(s, dt, platform)).abs().max() < 1e-12);
        let expected = difference(s, |s| motion.propagate(s, dt, platform));
        assert!((F - expected).abs().max() < 1e-8, "F: {F} expected {expected}");
        let half = motion.propagate(s, 0.5 * dt, platform);
        let again = motion.propagate(&half, 0.5 * dt, platform);
        assert!((again - after).abs().max() < 1e-12, "two half steps: {again} {after}");
        let rests = [0.0, 0.3 * dt, dt];
        let mut left = rests.iter();
        motion.responses(&after, rests, platform, |got| {
            let rest = left.next().copied().unwrap_or(f64::NAN);
            let at = motion.propagate(s, dt - rest, platform);
            let expected = motion.impulses(&at, rest, platform);
            assert!((got - expected).abs().max() < 1e-12, "{got} {expected}");
        });
        assert_eq!(left.next(), None);
        check_noise(motion, s, dt, platform);
    }

    /// The same, and the velocity of a motion in the plane.
    pub(crate) fn check_in_plane<const N: usize, M: PlaneMotion<N>>(
        motion: &M,
        s: &SVector<f64, N>,
        dt: f64,
        platform: &Platform,
    ) {
        check(motion, s, dt, platform);
        let (_, J) = motion.velocity(s, platform);
        let expected = difference(s, |s| motion.velocity(s, platform).0);
        assert!((J - expected).abs().max() < 1e-8, "velocity: {J} {expected}");
    }

    fn check_noise<const N: usize, M: Motion<N>>(
        motion: &M,
        s: &SVector<f64, N>,
        dt: f64,
        platform: &Platform,
    ) {
        let noise = ProcessNoise { form: NoiseForm::Continuous, strength: [0.7, 0.4, 0.2] };
        let mut Q = SMatrix::<f64, N, N>::zeros();
        noise.add(motion, [s, &motion.propagate(s, dt, platform)], dt, platform, &mut Q);
        let mut expected = SMatrix::<f64, N, N>::zeros();
        let steps = 400;
        let h = dt / f64::from(steps);
        for step in 0..steps {
            let t = (f64::from(step) + 0.5) * h;
            let at = motion.propagate(s, t, platform);
            let columns = motion.impulses(&at, dt - t, platform);
            for (index, q) in noise.strength.iter().enumerate() {
                let column = columns.column(index);
                expected += column * column.transpose() * (q * q * h);
            }
        }
        if let Some(column) = motion.input_response(s, dt, platform) {
            expected += column * column.transpose();
        }
        let scale = expected.abs().max();
        assert!((Q - expected).abs().max() < 2e-4 * scale, "Q {Q} expected {expected}");
        assert!((Q + SMatrix::<f64, N, N>::identity() * (1e-13 * scale)).cholesky().is_some());
    }
}
