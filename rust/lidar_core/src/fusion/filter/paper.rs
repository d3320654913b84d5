//! The filter of the paper as printed: equations 7-9 and 11-28, including their errors.
//!
//! The matrices contradict the equations of motion, the noise is neither symmetric nor positive,
//! and the radar is read as if it measured the state. This filter serves only for comparison.
//! Choices that the text leaves open are options.

#![allow(non_snake_case)] // textbook letters

use super::engine::{AcceptInnovation, Engine, Innovation, Output, mixed, output};
use crate::Error;
use crate::estimation::kalman::{Gaussian, Mahalanobis};
use crate::fusion::models::motion::{First, Prior};
use crate::fusion::models::platform::Platform;
use crate::fusion::models::turn::wrapped;
use crate::fusion::models::world::Plane;
use crate::fusion::sensors::measurement::{Measurement, PolarValues, Sensor};
use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

/// Turn rates below this [rad/s] use eqs 9 and 19; the paper switches at exactly 0.
const STRAIGHT: f64 = 1e-4;
/// Variance of the LiDAR, eq. 27.
const LIDAR: f64 = 0.0222;
/// Variances of the radar, eq. 28.
const RADAR: [f64; 5] = [0.088, 0.00088, 0.088, 0.0088, 0.08];

/// Interpretation of the radar measurement, eq. 26. Its x and y are always computed from range and
/// bearing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// v is the range rate, theta the bearing, w zero.
    A,
    /// Like A, but w is the range rate.
    B,
    /// v and theta are the true values, which the measurement has to contain; w is zero.
    C,
    /// Only x and y are measured.
    D,
}

/// The model of the paper: [x, y, v, theta, w, w_d].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paper {
    /// Interpretation of the radar measurement.
    pub reading: Reading,
    /// Use alpha = theta + w dt of eq. 8 in eq. 18, instead of the printed theta + dt.
    pub fixed_alpha: bool,
    /// Predict states by Phi of eq. 15, instead of eqs 8 and 9.
    pub by_matrix: bool,
    /// Subtract v_dy from y in eq. 9, as in eq. 8, instead of the printed v_dx.
    pub fixed_straight_y: bool,
    /// Set the column of w_d in eqs 18 and 19 to zero, instead of the printed values. By eq. 16 it
    /// is zero, since w_d does not occur in eqs 8 and 9.
    pub zero_platform_column: bool,
    /// Speed of the platform, V0 of eq. 7 [m/s].
    pub speed: f64,
    /// Elevation phi of the platform over the target [rad].
    pub elevation: f64,
    /// Standard deviations of the noises of eq. 23: on the acceleration, the turn rate, and the
    /// turn rate of the platform.
    pub std: [f64; 3],
    /// Variances before the second measurement.
    pub prior: Prior,
}

/// First interpretation of the choices that the paper leaves open, with the deviations and prior of
/// the filter.
impl Default for Paper {
    fn default() -> Self {
        Self {
            reading: Reading::A,
            fixed_alpha: false,
            by_matrix: false,
            fixed_straight_y: false,
            zero_platform_column: false,
            speed: 0.0,
            elevation: 0.0,
            std: [0.0; 3],
            prior: Prior::default(),
        }
    }
}

impl Paper {
    /// State after `dt` [s] by eqs 8 and 9, with the previous position added and the platform's
    /// term multiplied by the step.
    fn propagate(&self, s: &Vector6<f64>, dt: f64) -> Vector6<f64> {
        let [x, y, v, theta, w, w_d] = s.data.0[0];
        let (sine, cosine) = libm::sincos(theta);
        let (sin_phi, cos_phi) = libm::sincos(self.elevation);
        let v_dx = self.speed * cos_phi * cosine; // eq. 7
        let v_dy = self.speed * cos_phi * sine;
        let own = [v_dx * cosine * cos_phi * dt, v_dy * cosine * sin_phi * dt];
        if w.abs() < STRAIGHT {
            let v_d = if self.fixed_straight_y { v_dy } else { v_dx }; // eq. 9
            let own_y = v_d * cosine * sin_phi * dt;
            return Vector6::new(
                x + v * cosine * dt - own[0],
                y + v * sine * dt - own_y,
                v,
                theta,
                w,
                w_d,
            );
        }
        let alpha = w * dt + theta;
        let dx = v / w * (libm::sin(alpha) - sine);
        let dy = v / w * (cosine - libm::cos(alpha));
        Vector6::new(x + dx - own[0], y + dy - own[1], v, alpha, w, w_d)
    }

    /// Transition matrix Phi of eqs 18 and 19.
    fn matrix(&self, s: &Vector6<f64>, dt: f64) -> Matrix6<f64> {
        let [_, _, v, theta, w, _] = s.data.0[0];
        let (sine, cosine) = libm::sincos(theta);
        let (sin_phi, cos_phi) = libm::sincos(self.elevation);
        let own = [-self.speed * sine * cos_phi, self.speed * cosine * sin_phi];
        let mut Phi = Matrix6::identity();
        if !self.zero_platform_column {
            (Phi[(0, 5)], Phi[(1, 5)]) = (own[0], own[1]);
        }
        if w.abs() < STRAIGHT {
            (Phi[(0, 2)], Phi[(1, 2)]) = (cosine * dt, sine * dt);
            (Phi[(0, 3)], Phi[(1, 3)]) = (-v * sine * dt, v * cosine * dt);
            return Phi;
        }
        let alpha = theta + if self.fixed_alpha { w * dt } else { dt };
        let (sin_alpha, cos_alpha) = libm::sincos(alpha);
        let (beta, chi) = (sin_alpha - sine, cos_alpha - cosine);
        (Phi[(0, 2)], Phi[(1, 2)]) = (beta / w, -chi / w);
        (Phi[(0, 3)], Phi[(1, 3)]) = (v / w * chi, v / w * beta);
        Phi[(0, 4)] = dt * v / w * (cos_alpha - v / (w * w) * beta);
        Phi[(1, 4)] = dt * v / w * (sin_alpha + v / (w * w) * chi);
        Phi[(2, 3)] = dt;
        Phi
    }

    /// Process noise Q of eq. 24.
    fn noise(&self, theta: f64, dt: f64) -> Matrix6<f64> {
        let (sine, cosine) = libm::sincos(theta);
        let (sin_phi, cos_phi) = libm::sincos(self.elevation);
        let [a, w, d] = self.std;
        let (aa, dd, dt2, dt3) = (a * a, dt * dt * d * d, dt * dt, dt * dt * dt);
        let (gamma, nu, eta) = (cosine * cos_phi, cos_phi * sin_phi, sine * sin_phi);
        let (kappa, sigma, lambda) = (sine * cosine, cosine * sin_phi, cos_phi * sin_phi);
        let mut Q = Matrix6::zeros();
        Q[(0, 0)] = dt2 * dt2 / 4.0 * aa * cosine * cosine + dd * gamma * gamma;
        Q[(0, 1)] = dt2 * dt2 / 4.0 * aa * kappa + dd * cosine * cosine * lambda;
        Q[(0, 2)] = dt3 / 4.0 * aa * kappa;
        Q[(0, 5)] = -dd * gamma;
        Q[(1, 0)] = dt2 * dt2 / 4.0 * aa * sine * sine + dd * cosine * cosine * nu;
        Q[(1, 1)] = dt2 * dt2 / 4.0 * aa * kappa + dd * sigma * sigma;
        Q[(1, 2)] = dt3 / 2.0 * aa * sine;
        Q[(1, 5)] = -dd * eta;
        (Q[(2, 0)], Q[(2, 1)], Q[(2, 2)]) =
            (dt3 / 2.0 * aa * cosine, dt3 / 2.0 * aa * sine, dt2 * aa);
        Q[(4, 4)] = dt2 / 2.0 * w;
        (Q[(5, 0)], Q[(5, 1)], Q[(5, 5)]) = (-dd * gamma, -dd * sigma, -dd);
        Q
    }

    /// Correct the state by eqs 12, 13 and 15; the first K states are measured.
    fn corrected<const K: usize>(
        state: &mut Gaussian<6>,
        z: &SVector<f64, K>,
        variances: &[f64],
        believe: AcceptInnovation<'_>,
    ) -> Result<Option<Innovation>, Error> {
        // Longer than other functions: three equations of the paper on the same matrices.
        let singular = || Error::NotPositiveDefinite { matrix: "S" };
        let M = &state.covariance;
        let mut y = z - state.mean.fixed_rows::<K>(0);
        // The fourth state is the heading: a difference of angles is wrapped.
        if K > 3 {
            y[3] = wrapped(y[3]);
        }
        let mut S: SMatrix<f64, K, K> = M.fixed_view::<K, K>(0, 0).into_owned();
        for (index, variance) in variances.iter().take(K).enumerate() {
            S[(index, index)] += variance;
        }
        let (inverse, determinant) = inverted(&S).ok_or_else(singular)?;
        let K_gain = M.fixed_columns::<K>(0) * inverse;
        // As printed: no Joseph form and no symmetric part, since P is not symmetric here anyway
        // and the comparison is with these equations.
        let posterior = Gaussian {
            mean: state.mean + K_gain * y,
            covariance: M - K_gain * M.fixed_rows::<K>(0),
        };
        // The printed noise can make the covariance grow without limit: an error, not a state of
        // NaN.
        if !posterior.mean.iter().chain(&posterior.covariance).all(|value| value.is_finite()) {
            return Err(singular());
        }
        // S need not be positive, so its determinant may be negative.
        let log_determinant = libm::log(determinant.abs());
        let variances = std::array::from_fn(|index| S[(index, index)]);
        let squared = y.dot(&(inverse * y));
        let far = Mahalanobis::<K> { squared, log_determinant, variances };
        let innovation = Innovation::new(y.as_slice(), &far);
        if believe(&innovation) {
            *state = posterior;
        }
        Ok(Some(innovation))
    }
}

/// Inverse and determinant by elimination with pivoting; the matrix need not be a covariance.
fn inverted<const K: usize>(S: &SMatrix<f64, K, K>) -> Option<(SMatrix<f64, K, K>, f64)> {
    let (mut left, mut right) = (*S, SMatrix::<f64, K, K>::identity());
    let mut determinant = 1.0;
    for column in 0..K {
        let pivot = (column..K)
            .max_by(|&a, &b| left[(a, column)].abs().total_cmp(&left[(b, column)].abs()))?;
        left.swap_rows(column, pivot);
        right.swap_rows(column, pivot);
        let value = left[(column, column)];
        determinant *= if pivot == column { value } else { -value };
        if value == 0.0 || !value.is_finite() {
            return None;
        }
        for row in (0..K).filter(|&row| row != column) {
            let factor = left[(row, column)] / value;
            for k in 0..K {
                left[(row, k)] -= factor * left[(column, k)];
                right[(row, k)] -= factor * right[(column, k)];
            }
        }
        left.row_mut(column).unscale_mut(value);
        right.row_mut(column).unscale_mut(value);
    }
    Some((right, determinant))
}

impl Engine for Paper {
    type State = Gaussian<6>;
    type World = Plane;

    fn first(&self, first: &First) -> Gaussian<6> {
        let ([x, y, _], p) = (first.position, &self.prior);
        let variances =
            Vector6::new(p.position, p.position, p.speed, p.heading, p.turn_rate, p.platform_rate);
        Gaussian {
            mean: Vector6::new(x, y, first.speed, first.heading, 0.0, 0.0),
            covariance: Matrix6::from_diagonal(&variances),
        }
    }

    fn after_velocity(&self, _: &Gaussian<4>) -> Option<Gaussian<6>> {
        None
    }

    fn predict(&self, state: &mut Gaussian<6>, dt: f64, _: &Platform) {
        let Phi = self.matrix(&state.mean, dt);
        let mean = if self.by_matrix { Phi * state.mean } else { self.propagate(&state.mean, dt) };
        let Q = self.noise(state.mean[3], dt);
        let covariance = Phi * state.covariance * Phi.transpose() + Q; // eq. 11
        *state = Gaussian { mean, covariance };
    }

    fn update(
        &self,
        state: &mut Gaussian<6>,
        m: &Measurement,
        _: &Platform,
        believe: AcceptInnovation<'_>,
    ) -> Result<Option<Innovation>, Error> {
        let v = m.values();
        match m.sensor() {
            Sensor::Lidar => {
                Self::corrected::<2>(state, &SVector::from([v[0], v[1]]), &[LIDAR; 2], believe)
            }
            Sensor::Radar if m.measures() == PolarValues::FLAT => {
                let (sine, cosine) = libm::sincos(v[1]);
                let [x, y, rate] = [v[0] * cosine, v[0] * sine, v[2]];
                let truth = v.get(3..5).map_or([rate, v[1]], |both| [both[0], both[1]]);
                let z = match self.reading {
                    Reading::A => [x, y, rate, v[1], 0.0],
                    Reading::B => [x, y, rate, v[1], rate],
                    Reading::C => [x, y, truth[0], truth[1], 0.0],
                    Reading::D => {
                        return Self::corrected::<2>(state, &[x, y].into(), &RADAR, believe);
                    }
                };
                Self::corrected::<5>(state, &SVector::from(z), &RADAR, believe)
            }
            Sensor::Radar | Sensor::Gyro | Sensor::Pose | Sensor::SpacePose => Ok(None),
        }
    }

    fn blended(&self, parts: &[(f64, &Gaussian<6>)]) -> Gaussian<6> {
        mixed(parts)
    }

    fn loosen(&self, state: &mut Gaussian<6>, factor: f64) {
        state.covariance *= factor;
    }

    fn output(&self, state: &Gaussian<6>) -> Output {
        output(state, Some(3))
    }

    fn numbers(&self, state: &Gaussian<6>) -> Vec<f64> {
        state.numbers()
    }

    fn state_of_numbers(&self, numbers: &[f64]) -> Option<Gaussian<6>> {
        Gaussian::from_numbers(numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRIOR: Prior = Prior {
        position: 0.5,
        speed: 25.0,
        heading: 3.0,
        turn_rate: 1.0,
        acceleration: 1.0,
        platform_rate: 1.0,
    };

    fn paper(fixed_alpha: bool) -> Paper {
        Paper {
            reading: Reading::A,
            fixed_alpha,
            by_matrix: false,
            fixed_straight_y: false,
            zero_platform_column: false,
            speed: 0.0,
            elevation: 0.0,
            std: [3.0, 2.0, 0.5],
            prior: PRIOR,
        }
    }

    /// Values of the audit: what eq. 18 says and what is true.
    #[test]
    fn the_printed_matrix_is_as_wrong_as_the_audit_says() {
        let s = Vector6::new(0.0, 0.0, 1.4, 0.7, 0.01, 0.0);
        let Phi = paper(false).matrix(&s, 0.05);
        assert!((Phi[(0, 2)] - 3.74).abs() < 5e-3);
        assert!((Phi[(0, 4)] + 3660.0).abs() < 5.0);
        let Phi = paper(true).matrix(&s, 0.05);
        assert!((Phi[(0, 2)] - 0.0382).abs() < 5e-5);
    }

    /// V0 = 2 m/s, theta = 0.7, phi = 0.3: v_dx and v_dy by eq. 7, and what eq. 9 makes of them.
    #[test]
    fn equation_9_takes_v_dx_from_y_as_printed_and_v_dy_as_an_option() {
        let s = Vector6::new(1.0, 2.0, 0.0, 0.7, 0.0, 0.0);
        let moving = Paper { speed: 2.0, elevation: 0.3, ..paper(false) };
        let (v_dx, v_dy) = (1.461363, 1.230889);
        let way = 0.764842 * 0.295520 * 0.05; // cos(theta) sin(phi) dt
        assert!((moving.propagate(&s, 0.05)[1] - (2.0 - v_dx * way)).abs() < 1e-6);
        let meant = Paper { fixed_straight_y: true, ..moving };
        assert!((meant.propagate(&s, 0.05)[1] - (2.0 - v_dy * way)).abs() < 1e-6);
    }

    #[test]
    fn the_column_of_the_platform_is_what_is_printed_or_zero() {
        let s = Vector6::new(1.0, 2.0, 1.4, 0.7, 0.1, 0.2);
        let moving = Paper { speed: 2.0, elevation: 0.3, ..paper(false) };
        let Phi = moving.matrix(&s, 0.05);
        assert!((Phi[(0, 5)] + 1.230889).abs() < 1e-6); // -V0 sin(theta) cos(phi)
        assert!((Phi[(1, 5)] - 0.452052).abs() < 1e-6); // V0 cos(theta) sin(phi)
        let zero = Paper { zero_platform_column: true, ..moving }.matrix(&s, 0.05);
        assert_eq!((zero[(0, 5)], zero[(1, 5)], zero[(5, 5)]), (0.0, 0.0, 1.0));
        assert_eq!(zero.fixed_columns::<5>(0), Phi.fixed_columns::<5>(0));
        let rest = paper(false).matrix(&s, 0.05);
        assert_eq!(rest[(0, 5)].abs() + rest[(1, 5)].abs(), 0.0);
    }

    #[test]
    fn the_printed_noise_is_neither_symmetric_nor_positive() {
        let Q = paper(false).noise(0.7, 0.05);
        let difference = (Q - Q.transpose()).abs().max();
        assert!((difference - 2.9e-4).abs() < 1e-5, "{difference}");
        let least = ((Q + Q.transpose()) * 0.5).symmetric_eigenvalues().min();
        assert!((least + 8e-4).abs() < 1e-4, "{least}");
    }

    #[test]
    fn inverses_are_inverses() {
        let S = SMatrix::<f64, 3, 3>::new(0.0, 2.0, 1.0, 1.0, 0.0, 3.0, 4.0, 1.0, -2.0);
        let Some((inverse, determinant)) = inverted(&S) else { return assert_eq!(S.sum(), 0.0) };
        assert!((S * inverse - SMatrix::identity()).abs().max() < 1e-14);
        assert!((determinant - S.determinant()).abs() < 1e-12);
        assert!(inverted(&SMatrix::<f64, 3, 3>::zeros()).is_none());
    }
}
