//! Any model and method behind one type, and runs over whole recordings.

use super::cartesian::{ConstantAcceleration, ConstantVelocity, CoordinatedTurn};
use super::drone::{CtrvDrone, CtrvDroneRate};
use super::engine::{Output, Single};
use super::heading::{Ctra, Ctrv};
use super::measurement::Measurement;
use super::motion::{Motion, NoiseForm, Prior, ProcessNoise};
use super::platform::Platform;
use super::sensors::Sensing;
use super::target::{GyroUse, Life, Step, Target};
use crate::Error;

/// How targets move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// [x, y, vx, vy].
    ConstantVelocity,
    /// [x, y, vx, vy, ax, ay].
    ConstantAcceleration,
    /// [x, y, vx, vy, w].
    CoordinatedTurn,
    /// [x, y, v, theta, w].
    Ctrv,
    /// [x, y, v, theta, w, a].
    Ctra,
    /// [x, y, v, theta, w] in the frame of a sensor that moves; with w_d unless a gyro is an input.
    CtrvDrone,
}

/// How the state is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Linear: radar as a position, without its range rate. Models with a velocity vector only.
    Linear,
    /// Linearised at the mean.
    Extended,
}

/// Strengths of process noise, in the units that `form` asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strengths {
    /// How the noise acts.
    pub form: NoiseForm,
    /// Of the acceleration.
    pub acceleration: f64,
    /// Of the jerk, where acceleration is a state.
    pub jerk: f64,
    /// Of the angular acceleration.
    pub turn: f64,
    /// Of the angular acceleration of the platform.
    pub platform: f64,
    /// Of the acceleration while a target starts, constant over a step [m/s^2].
    pub start: f64,
}

/// Everything a filter can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionParameters {
    /// How targets move.
    pub model: Model,
    /// How the state is estimated.
    pub method: Method,
    /// What disturbs the motion.
    pub strengths: Strengths,
    /// What is known before.
    pub prior: Prior,
    /// Sensor models.
    pub sensing: Sensing,
    /// Rules over a target's life.
    pub life: Life,
    /// From the platform's origin to the sensor, axes of the platform [m].
    pub lever: [f64; 2],
}

/// A filter of one target.
#[derive(Clone, Debug)]
pub struct Filter(Kind);

#[derive(Clone, Debug)]
enum Kind {
    ConstantVelocity(Target<Single<4, ConstantVelocity>>),
    ConstantAcceleration(Target<Single<6, ConstantAcceleration>>),
    CoordinatedTurn(Target<Single<5, CoordinatedTurn>>),
    Ctrv(Target<Single<5, Ctrv>>),
    Ctra(Target<Single<6, Ctra>>),
    CtrvDrone(Target<Single<5, CtrvDrone>>),
    CtrvDroneRate(Target<Single<6, CtrvDroneRate>>),
}

/// The same call on whatever target there is.
macro_rules! on_target {
    ($filter:expr, $target:ident => $call:expr) => {
        match $filter {
            Kind::ConstantVelocity($target) => $call,
            Kind::ConstantAcceleration($target) => $call,
            Kind::CoordinatedTurn($target) => $call,
            Kind::Ctrv($target) => $call,
            Kind::Ctra($target) => $call,
            Kind::CtrvDrone($target) => $call,
            Kind::CtrvDroneRate($target) => $call,
        }
    };
}

impl Filter {
    /// A filter that has seen nothing.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a method that does not fit the model.
    pub fn new(parameters: &FusionParameters) -> Result<Self, Error> {
        let p = parameters;
        let linear = matches!(p.model, Model::ConstantVelocity | Model::ConstantAcceleration);
        if p.method == Method::Linear && !linear {
            let expected = "\"cv\" or \"ca\" with method \"kf\"";
            return Err(Error::Parameter {
                name: "model",
                expected,
                got: format!("{:?}", p.model),
            });
        }
        let Strengths { acceleration, jerk, turn, platform, .. } = p.strengths;
        Ok(Self(match p.model {
            Model::ConstantVelocity => Kind::ConstantVelocity(
                p.target(ConstantVelocity, [acceleration, acceleration, 0.0]),
            ),
            Model::ConstantAcceleration => {
                Kind::ConstantAcceleration(p.target(ConstantAcceleration, [jerk, jerk, 0.0]))
            }
            Model::CoordinatedTurn => {
                Kind::CoordinatedTurn(p.target(CoordinatedTurn, [acceleration, acceleration, turn]))
            }
            Model::Ctrv => Kind::Ctrv(p.target(Ctrv, [acceleration, turn, 0.0])),
            Model::Ctra => Kind::Ctra(p.target(Ctra, [jerk, turn, 0.0])),
            Model::CtrvDrone if p.life.gyro == GyroUse::Input => {
                Kind::CtrvDrone(p.target(CtrvDrone, [acceleration, turn, 0.0]))
            }
            Model::CtrvDrone => {
                Kind::CtrvDroneRate(p.target(CtrvDroneRate, [acceleration, turn, platform]))
            }
        }))
    }

    /// Take in a measurement.
    pub fn step(&mut self, m: &Measurement) -> Step {
        on_target!(&mut self.0, target => target.step(m))
    }

    /// State at the time of the last measurement.
    #[must_use]
    pub fn output(&self) -> Option<Output> {
        on_target!(&self.0, target => target.output())
    }

    /// State carried on to `stamp_ns`; nothing changes.
    #[must_use]
    pub fn output_at(&self, stamp_ns: i64) -> Option<Output> {
        on_target!(&self.0, target => target.output_at(stamp_ns))
    }
}

/// Filter measurements in the order of their stamps; those of one stamp keep their order.
///
/// # Errors
/// As [`Filter::new`].
pub fn run(
    parameters: &FusionParameters,
    measurements: &[Measurement],
) -> Result<Vec<Step>, Error> {
    let mut filter = Filter::new(parameters)?;
    let mut sorted = measurements.to_vec();
    sorted.sort_by_key(Measurement::stamp_ns);
    Ok(sorted.iter().map(|m| filter.step(m)).collect())
}

impl FusionParameters {
    fn target<const N: usize, M: Motion<N>>(
        &self,
        motion: M,
        strength: [f64; 3],
    ) -> Target<Single<N, M>> {
        let noise = ProcessNoise { form: self.strengths.form, strength };
        let (prior, sensing) = (self.prior, self.sensing);
        let start = self.strengths.start;
        let starter = Single {
            motion: ConstantVelocity,
            noise: ProcessNoise { form: NoiseForm::Discrete, strength: [start, start, 0.0] },
            prior,
            sensing,
        };
        let platform = Platform { lever: self.lever, ..Platform::still() };
        Target::new(Single { motion, noise, prior, sensing }, starter, self.life, platform)
    }
}
