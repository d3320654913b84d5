//! Parameters of the filters that ship, and those of the paper.
//!
//! These are the only literals of a configuration in Rust. A test holds them against the models of
//! the Python package, which document each value.

use super::filter::paper::{Paper, Reading};
use super::model::{Model, switches};
use super::models::motion::{NoiseForm, Prior};
use super::models::platform::GyroUse;
use super::parameters::{FusionParameters, Method, Strengths};
use super::sensors::sensing::Sensing;
use super::targets::lifecycle::LifecycleRules;
use super::targets::many::{ExistenceParameters, ManyParameters, TargetAssociation};

/// Probability of the gate for a true measurement.
const GATE_PROBABILITY: f64 = 0.9999;

/// The standard deviations as variances.
fn squared<const N: usize>(std: [f64; N]) -> [f64; N] {
    std.map(|value| value * value)
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

impl Default for Prior {
    #[allow(clippy::approx_constant)] // 0.7071 m is what ships, not the root of 1/2
    fn default() -> Self {
        let [position, speed, heading, turn_rate, acceleration, platform_rate] =
            squared([0.7071, 5.0, 1.732, 1.0, 3.0, 1.0]);
        Self { position, speed, heading, turn_rate, acceleration, platform_rate }
    }
}

/// Sensors of 0.15 m (LiDAR), 0.3 m, 0.03 rad and 0.3 m/s (radar) on a platform of exact poses.
impl Default for Sensing {
    fn default() -> Self {
        let [gyro] = squared([0.01]);
        Self {
            lidar: squared([0.15; 3]),
            radar: squared([0.3, 0.03, 0.03, 0.3]),
            gyro,
            pose: [0.0; 6],
            range_min: 0.1,
            convert_radar: false,
        }
    }
}

impl Default for LifecycleRules {
    fn default() -> Self {
        Self {
            start_rows: 6,
            gate: Self::gates(Some(GATE_PROBABILITY)).unwrap_or([f64::INFINITY; 5]),
            memory: Some(200.0),
            loss_ratio: Some(4.0),
            radar_starts_speed: true,
            starts_as_measured: false,
            gyro: GyroUse::Input,
            buffer_ns: 500_000_000,
        }
    }
}

/// First reading of what the paper leaves open, with the deviations and prior of the filter.
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

/// Probabilities of existence, of targets that stand, move evenly, or change their velocity.
impl Default for ManyParameters {
    fn default() -> Self {
        Self {
            filter: FusionParameters {
                method: Method::Interacting {
                    models: switches(&[Model::ConstantVelocity, Model::Standing]),
                    sojourn: 2.0,
                    quiet: Some(0.1),
                },
                strengths: Strengths { acceleration: 1.0, ..Strengths::default() },
                prior: Prior { speed: 225.0, ..Prior::default() },
                life: LifecycleRules { start_rows: 1, ..LifecycleRules::default() },
                ..FusionParameters::default()
            },
            confirm_hits: 3,
            confirm_window: 5,
            max_coast: 2.0,
            max_position_std: 5.0,
            birth_distance: 0.0,
            report_speed: 0.0,
            association: TargetAssociation::Integrated(ExistenceParameters::default()),
        }
    }
}

/// Targets that stay for half a minute, in clutter that is learnt.
impl Default for ExistenceParameters {
    fn default() -> Self {
        Self { detection: 0.9, clutter: [1e-3, 1e-3], report: 0.95 }
    }
}

/// Clutter of 1 in 1000 m^2 (LiDAR) and of 1e-3 / (m rad m/s) (radar), shared out by probabilities.
impl TargetAssociation {
    /// Joint probabilistic data association with the defaults of the Python package.
    #[must_use]
    pub fn joint() -> Self {
        Self::Joint { detection: 0.9, clutter: [1e-3, 1e-3] }
    }
}
