//! The motion models that a filter may use: the only list of their names and states.
//!
//! A new model needs a file in `models/`, and here its variant, its entry and its motion.

use super::filter::paper::Paper;
use super::models::cartesian::{ConstantAcceleration, ConstantVelocity, CoordinatedTurn};
use super::models::drone::{CtrvDrone, CtrvDroneRate};
use super::models::heading::{Ctra, Ctrv};
use super::models::motion::{Motion, Noise};
use super::models::standing::StandingTarget;
use super::models::state_conversion::StateConversion;

/// Motion model of the targets.
#[derive(Clone, Copy, Debug, PartialEq)]
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
    /// [x, y, vx, vy], of which the velocity is zero.
    Standing,
    /// [x, y, v, theta, w] in the frame of a sensor that moves; with w_d unless a gyro is an input.
    CtrvDrone,
    /// [x, y, v, theta, w, w_d] as published; method, prior and deviations come from elsewhere.
    Paper(Paper),
}

/// Description of a model for configurations and tables of results.
#[derive(Clone, Copy, Debug)]
pub struct ModelEntry {
    /// Name in configurations.
    pub name: &'static str,
    /// The model; of the published one, as printed.
    pub model: Model,
    /// Names of the states; that of the platform's rate is left out if a gyro is an input.
    pub states: &'static [&'static str],
    /// Meaning, for help texts.
    pub title: &'static str,
}

/// Every model.
#[must_use]
pub fn models() -> [ModelEntry; 8] {
    [
        ModelEntry {
            name: "cv",
            model: Model::ConstantVelocity,
            states: &["x", "y", "vx", "vy"],
            title: "constant velocity",
        },
        ModelEntry {
            name: "ca",
            model: Model::ConstantAcceleration,
            states: &["x", "y", "vx", "vy", "ax", "ay"],
            title: "constant acceleration",
        },
        ModelEntry {
            name: "ct",
            model: Model::CoordinatedTurn,
            states: &["x", "y", "vx", "vy", "w"],
            title: "coordinated turn",
        },
        ModelEntry {
            name: "ctrv",
            model: Model::Ctrv,
            states: &["x", "y", "v", "theta", "w"],
            title: "constant turn rate and velocity",
        },
        ModelEntry {
            name: "ctra",
            model: Model::Ctra,
            states: &["x", "y", "v", "theta", "w", "a"],
            title: "the same with acceleration",
        },
        ModelEntry {
            name: "standing",
            model: Model::Standing,
            states: &["x", "y", "vx", "vy"],
            title: "a place that hardly moves; with imm for targets that stop",
        },
        ModelEntry {
            name: "ctrv-drone",
            model: Model::CtrvDrone,
            states: &["x", "y", "v", "theta", "w", PLATFORM_RATE],
            title: "CTRV in the frame of a sensor that moves",
        },
        ModelEntry {
            name: "paper",
            model: Model::Paper(Paper::default()),
            states: &["x", "y", "v", "theta", "w", PLATFORM_RATE],
            title: "the model as published, errors included, whose method is its own",
        },
    ]
}

/// Name of the state that is the turn rate of the platform.
pub const PLATFORM_RATE: &str = "w_d";

/// Models that [`super::Method::Interacting`] can mix, in the order of its switches.
pub const MIXABLE: [Model; 6] = [
    Model::ConstantVelocity,
    Model::ConstantAcceleration,
    Model::CoordinatedTurn,
    Model::Ctrv,
    Model::Ctra,
    Model::Standing,
];

/// Computation that needs the motion of a model, whatever its number of states.
pub(crate) trait ForMotion {
    type Output;
    fn run<const N: usize, M: Motion<N>>(self, motion: M) -> Self::Output;
    /// The published model is a filter of its own.
    fn published(self, paper: Paper) -> Self::Output;
}

/// Computation that needs a motion whose states can be converted to those of other models.
pub(crate) trait ForMixable {
    type Output;
    fn run<const N: usize, M: StateConversion<N>>(self, motion: M) -> Self::Output;
}

struct NoisesOf;

impl ForMotion for NoisesOf {
    type Output = Vec<Noise>;

    fn run<const N: usize, M: Motion<N>>(self, _: M) -> Self::Output {
        M::NOISES.to_vec()
    }

    fn published(self, _: Paper) -> Self::Output {
        vec![Noise::Acceleration, Noise::Turn, Noise::Platform]
    }
}

impl Model {
    /// `task` with the motion of this model.
    pub(crate) fn with_motion<T: ForMotion>(self, has_gyro: bool, task: T) -> T::Output {
        match self {
            Self::ConstantVelocity => task.run(ConstantVelocity),
            Self::ConstantAcceleration => task.run(ConstantAcceleration),
            Self::CoordinatedTurn => task.run(CoordinatedTurn),
            Self::Ctrv => task.run(Ctrv),
            Self::Ctra => task.run(Ctra),
            Self::Standing => task.run(StandingTarget),
            Self::CtrvDrone if has_gyro => task.run(CtrvDrone),
            Self::CtrvDrone => task.run(CtrvDroneRate),
            Self::Paper(paper) => task.published(paper),
        }
    }

    /// Noises that drive this model.
    #[must_use]
    pub fn noises(self) -> Vec<Noise> {
        self.with_motion(false, NoisesOf)
    }

    /// `task` with the motion of this model; none for one that is not in [`MIXABLE`].
    pub(crate) fn with_mixable<T: ForMixable>(self, task: T) -> Option<T::Output> {
        Some(match self {
            Self::ConstantVelocity => task.run(ConstantVelocity),
            Self::ConstantAcceleration => task.run(ConstantAcceleration),
            Self::CoordinatedTurn => task.run(CoordinatedTurn),
            Self::Ctrv => task.run(Ctrv),
            Self::Ctra => task.run(Ctra),
            Self::Standing => task.run(StandingTarget),
            Self::CtrvDrone | Self::Paper(_) => return None,
        })
    }
}
