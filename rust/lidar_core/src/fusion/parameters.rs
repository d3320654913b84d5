//! Parameters of a filter: model, method, noise, sensors, rules.

use super::filter::paper::Paper;
use super::model_list::{MIXABLE, Model};
use super::models::motion::{Noise, NoiseForm, Prior};
use super::sensors::sensing::Sensing;
use super::targets::lifecycle::LifecycleRules;

/// Estimation method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Linear Kalman filter: radar as a position, without its range rate. Models with a velocity
    /// vector only.
    Linear,
    /// Extended Kalman filter: models are linearised at the mean.
    Extended,
    /// Unscented Kalman filter, in square-root form.
    Sigma {
        /// Square of the distance of the sigma points, in standard deviations; none: the number
        /// of states plus 2, which keeps all weights positive.
        spread: Option<f64>,
        /// Compare the predicted points with the measurement, instead of new ones.
        carries: bool,
    },
    /// Cubature Kalman filter: unscented without a central point.
    Cubature,
    /// Interacting multiple models, each an extended filter; the model of the parameters is
    /// ignored.
    Interacting {
        /// Models that take part, as indices into [`MIXABLE`].
        models: [bool; MIXABLE.len()],
        /// Mean time for which a target follows one model [s].
        sojourn: f64,
        /// Share of the process noise that a second copy of each model but that of standing targets
        /// has, for targets that move evenly; none: no such copies.
        quiet: Option<f64>,
    },
}

/// Strengths of process noise, in the units that `form` asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strengths {
    /// Time behaviour of the noise.
    pub form: NoiseForm,
    /// Strength of the acceleration.
    pub acceleration: f64,
    /// Strength of the jerk, for models with acceleration as a state.
    pub jerk: f64,
    /// Strength of the angular acceleration.
    pub turn: f64,
    /// Strength of the angular acceleration of the platform.
    pub platform: f64,
    /// Standard deviation of the acceleration while a target starts, constant over a step [m/s^2].
    pub start: f64,
}

/// White noise in continuous time.
impl Default for Strengths {
    fn default() -> Self {
        Self {
            form: NoiseForm::Continuous,
            acceleration: 0.7,
            jerk: 2.0,
            turn: 0.5,
            platform: 0.5,
            start: 4.0,
        }
    }
}

/// All parameters of a filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionParameters {
    /// Motion model.
    pub model: Model,
    /// Estimation method.
    pub method: Method,
    /// Process noise.
    pub strengths: Strengths,
    /// Variances before the second measurement.
    pub prior: Prior,
    /// Sensor models.
    pub sensing: Sensing,
    /// Rules for the life of a target.
    pub life: LifecycleRules,
    /// Offset of the sensor from the platform's origin, axes of the platform [m].
    pub lever: [f64; 3],
}

/// Coordinated turn, extended Kalman filter: a velocity in place of speed and heading means something
/// also at rest.
impl Default for FusionParameters {
    fn default() -> Self {
        Self {
            model: Model::CoordinatedTurn,
            method: Method::Extended,
            strengths: Strengths::default(),
            prior: Prior::default(),
            sensing: Sensing::default(),
            life: LifecycleRules::default(),
            lever: [0.0; 3],
        }
    }
}

impl FusionParameters {
    /// The filter as published, which does not give the deviations of eq. 23.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            model: Model::Paper(Paper::default()),
            strengths: Strengths {
                acceleration: 3.0,
                turn: 2.0,
                platform: 0.5,
                ..Strengths::default()
            },
            life: LifecycleRules {
                start_rows: 1,
                gate: [f64::INFINITY; 5],
                memory: None,
                loss_ratio: None,
                ..LifecycleRules::default()
            },
            ..Self::default()
        }
    }
}

impl FusionParameters {
    /// Filter without a buffer, for measurements that come in order.
    #[must_use]
    pub fn without_buffer(&self) -> Self {
        Self { life: LifecycleRules { buffer_ns: 0, ..self.life }, ..*self }
    }

    /// These parameters with process noise of `share` times the strength.
    pub(super) fn with_noise(&self, share: f64) -> Self {
        let Strengths { acceleration, jerk, turn, .. } = self.strengths;
        let [acceleration, jerk, turn] = [acceleration, jerk, turn].map(|noise| share * noise);
        Self { strengths: Strengths { acceleration, jerk, turn, ..self.strengths }, ..*self }
    }

    /// True if states are in the frame of a sensor that may move, and not in the world.
    #[must_use]
    pub fn is_seen_from_sensor(&self) -> bool {
        let is_mixed = matches!(self.method, Method::Interacting { .. });
        !is_mixed && matches!(self.model, Model::CtrvDrone | Model::Paper(_))
    }

    /// True if targets are tracked in space, false in the plane.
    #[must_use]
    pub fn is_in_space(&self) -> bool {
        match self.method {
            Method::Interacting { models, .. } => {
                let mut used = MIXABLE.iter().zip(models).filter(|(_, is_used)| *is_used);
                used.any(|(model, _)| model.is_in_space())
            }
            _ => self.model.is_in_space(),
        }
    }
}

/// Change of the bias of a gyro, in continuous time [rad/s^1.5]. Real ones change less; the rest lets
/// a filter leave a wrong bias that it took from the first turn of a target.
const GYRO_WALK: f64 = 0.008;

impl Strengths {
    /// Strength of a noise.
    pub(super) fn of(&self, noise: Noise) -> f64 {
        match noise {
            Noise::Acceleration => self.acceleration,
            Noise::Jerk => self.jerk,
            Noise::Turn => self.turn,
            Noise::Platform => self.platform,
            Noise::Gyro => GYRO_WALK,
            Noise::Absent => 0.0,
        }
    }
}
