//! The motion models that a filter may use: the only list of their names and states.
//!
//! A new model needs a file in `models/`, and here its variant, its entry and its motion; in space
//! also [`Model::is_in_space`] and a name that ends in `-3d`; for mixtures also [`MIXABLE`], and
//! `with_mixable` or `with_mixable_in_space`.

use super::filter::paper::Paper;
use super::models::cartesian::{ConstantAcceleration, ConstantVelocity, CoordinatedTurn};
use super::models::drone::{CtrvDrone, CtrvDroneGyro, CtrvDroneRate};
use super::models::heading::{Ctra, Ctrv};
use super::models::motion::Noise;
use super::models::platform::GyroUse;
use super::models::space::{ClimbingCtrv, SpaceAcceleration, SpaceVelocity};
use super::models::standing::StandingTarget;
use super::models::state_conversion::StateConversion;
use super::models::world::{Plane, Space};
use super::sensors::sight::SeenMotion;

/// Motion model of the targets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Model {
    /// Constant velocity: [x, y, vx, vy].
    ConstantVelocity,
    /// Constant acceleration: [x, y, vx, vy, ax, ay].
    ConstantAcceleration,
    /// Coordinated turn: [x, y, vx, vy, w].
    CoordinatedTurn,
    /// Constant turn rate and velocity: [x, y, v, theta, w].
    Ctrv,
    /// Constant turn rate and acceleration: [x, y, v, theta, w, a].
    Ctra,
    /// States [x, y, vx, vy] with zero velocity.
    Standing,
    /// Constant velocity in space: [x, y, z, vx, vy, vz].
    SpaceVelocity,
    /// Constant acceleration in space: [x, y, z, vx, vy, vz, ax, ay, az].
    SpaceAcceleration,
    /// CTRV with a climb: [x, y, z, v, theta, w, vz].
    ClimbingCtrv,
    /// States [x, y, v, theta, w] in the frame of a moving sensor: also bias and delay of a gyro
    /// that is an input, or w_d without such a gyro.
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
    /// Names of the states; those of the platform differ if a gyro is an input.
    pub states: &'static [&'static str],
    /// Meaning, for help texts.
    pub title: &'static str,
}

/// Every model.
#[must_use]
pub fn models() -> [ModelEntry; 11] {
    // Longer than other functions: a table with an entry per model.
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
            name: "cv-3d",
            model: Model::SpaceVelocity,
            states: &["x", "y", "z", "vx", "vy", "vz"],
            title: "constant velocity in space",
        },
        ModelEntry {
            name: "ca-3d",
            model: Model::SpaceAcceleration,
            states: &["x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az"],
            title: "constant acceleration in space",
        },
        ModelEntry {
            name: "ctrv-3d",
            model: Model::ClimbingCtrv,
            states: &["x", "y", "z", "v", "theta", "w", "vz"],
            title: "constant turn rate, horizontal speed and climb",
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
pub const MIXABLE: [Model; 9] = [
    Model::ConstantVelocity,
    Model::ConstantAcceleration,
    Model::CoordinatedTurn,
    Model::Ctrv,
    Model::Ctra,
    Model::Standing,
    Model::SpaceVelocity,
    Model::SpaceAcceleration,
    Model::ClimbingCtrv,
];

/// Switches of [`super::Method::Interacting`] that mix these models of [`MIXABLE`].
pub(crate) fn switches(models: &[Model]) -> [bool; MIXABLE.len()] {
    MIXABLE.map(|model| models.contains(&model))
}

/// Computation that needs the motion of a model, whatever its number of states.
pub(crate) trait ForMotion {
    type Output;
    fn run<const N: usize, M: SeenMotion<N, World = Plane>>(self, motion: M) -> Self::Output;
    fn run_in_space<const N: usize, M: SeenMotion<N, World = Space>>(
        self,
        motion: M,
    ) -> Self::Output;
    /// The published model is a filter of its own.
    fn published(self, paper: Paper) -> Self::Output;
}

/// Computation that needs a motion whose states can be converted to those of other models of the
/// plane or space W.
pub(crate) trait ForMixable<W> {
    type Output;
    fn run<const N: usize, M: StateConversion<N, World = W> + SeenMotion<N>>(
        self,
        motion: M,
    ) -> Self::Output;
}

struct NoisesOf;

impl ForMotion for NoisesOf {
    type Output = Vec<Noise>;

    fn run<const N: usize, M: SeenMotion<N, World = Plane>>(self, _: M) -> Self::Output {
        M::NOISES.to_vec()
    }

    fn run_in_space<const N: usize, M: SeenMotion<N, World = Space>>(self, _: M) -> Self::Output {
        M::NOISES.to_vec()
    }

    fn published(self, _: Paper) -> Self::Output {
        vec![Noise::Acceleration, Noise::Turn, Noise::Platform]
    }
}

impl Model {
    /// `task` with the motion of this model.
    pub(crate) fn with_motion<T: ForMotion>(self, gyro: GyroUse, task: T) -> T::Output {
        match self {
            Self::ConstantVelocity => task.run(ConstantVelocity),
            Self::ConstantAcceleration => task.run(ConstantAcceleration),
            Self::CoordinatedTurn => task.run(CoordinatedTurn),
            Self::Ctrv => task.run(Ctrv),
            Self::Ctra => task.run(Ctra),
            Self::Standing => task.run(StandingTarget),
            Self::SpaceVelocity => task.run_in_space(SpaceVelocity),
            Self::SpaceAcceleration => task.run_in_space(SpaceAcceleration),
            Self::ClimbingCtrv => task.run_in_space(ClimbingCtrv),
            Self::CtrvDrone => match gyro {
                GyroUse::Input => task.run(CtrvDroneGyro),
                GyroUse::Exact => task.run(CtrvDrone),
                GyroUse::Measurement | GyroUse::Ignored => task.run(CtrvDroneRate),
            },
            Self::Paper(paper) => task.published(paper),
        }
    }

    /// Noises that drive this model.
    #[must_use]
    pub fn noises(self) -> Vec<Noise> {
        self.with_motion(GyroUse::Ignored, NoisesOf)
    }

    /// True for a model in space, false for one in the plane.
    #[must_use]
    pub fn is_in_space(self) -> bool {
        matches!(self, Self::SpaceVelocity | Self::SpaceAcceleration | Self::ClimbingCtrv)
    }

    /// `task` with the motion of this model; none for one that is not in [`MIXABLE`], or in space.
    pub(crate) fn with_mixable<T: ForMixable<Plane>>(self, task: T) -> Option<T::Output> {
        Some(match self {
            Self::ConstantVelocity => task.run(ConstantVelocity),
            Self::ConstantAcceleration => task.run(ConstantAcceleration),
            Self::CoordinatedTurn => task.run(CoordinatedTurn),
            Self::Ctrv => task.run(Ctrv),
            Self::Ctra => task.run(Ctra),
            Self::Standing => task.run(StandingTarget),
            _ => return None,
        })
    }

    /// `task` with the motion of this model; none for one that is not in [`MIXABLE`], or in the plane.
    pub(crate) fn with_mixable_in_space<T: ForMixable<Space>>(self, task: T) -> Option<T::Output> {
        Some(match self {
            Self::SpaceVelocity => task.run(SpaceVelocity),
            Self::SpaceAcceleration => task.run(SpaceAcceleration),
            Self::ClimbingCtrv => task.run(ClimbingCtrv),
            _ => return None,
        })
    }
}
