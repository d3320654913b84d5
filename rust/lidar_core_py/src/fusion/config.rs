//! The fields of `FusionConfig` as parameters of the core.

use crate::arrays::choice;
use lidar_core::Error;
use lidar_core::fusion::filter::paper::{Paper, Reading};
use lidar_core::fusion::model_list::{self, MIXABLE};
use lidar_core::fusion::models::motion::{NoiseForm, Prior};
use lidar_core::fusion::models::platform::GyroUse;
use lidar_core::fusion::sensors::sensing::Sensing;
use lidar_core::fusion::targets::lifecycle::LifecycleRules;
use lidar_core::fusion::{FusionParameters, Method, Model, Strengths};
use pyo3::prelude::*;

/// The fields of `FusionConfig`.
#[derive(FromPyObject)]
pub(crate) struct FusionConfig {
    model: String,
    method: String,
    process: String,
    acceleration_noise: f64,
    jerk_noise: f64,
    turn_noise: f64,
    platform_noise: f64,
    lidar_std: Vec<f64>,
    radar_std: Vec<f64>,
    gyro_std: f64,
    pose_std: Vec<f64>,
    gyro: String,
    lever_arm: Vec<f64>,
    start_rows: u32,
    start_speed: String,
    initial_position: f64,
    initial_speed: f64,
    initial_heading: f64,
    initial_turn_rate: f64,
    initial_acceleration: f64,
    gate_probability: Option<f64>,
    loss_ratio: Option<f64>,
    sensor_noise: String,
    buffer_time: f64,
    sigma_spread: Option<f64>,
    sigma_points: String,
    imm_models: Vec<String>,
    imm_sojourn: f64,
    imm_quiet: Option<f64>,
    published: PublishedModel,
}

/// The fields of `PublishedModel`.
#[derive(FromPyObject)]
struct PublishedModel {
    reading: String,
    alpha: String,
    prediction: String,
    straight_y: String,
    platform_column: String,
    speed: f64,
    elevation: f64,
}

/// Names, in configurations, of the possible interpretations of the published radar measurement.
const READINGS: [(&str, Reading); 4] =
    [("a", Reading::A), ("b", Reading::B), ("c", Reading::C), ("d", Reading::D)];
/// Names, in configurations, of the use of sigma points: true if the predicted points are also used
/// for the update.
const POINTS: [(&str, bool); 2] = [("redrawn", false), ("carried", true)];
/// Choice between the printed form of an equation and the corrected one.
const FIXES: [(&str, bool); 2] = [("literal", false), ("fixed", true)];
/// Names, in configurations, of the forms of the platform's column of the Jacobian: true if it is
/// zero.
const COLUMNS: [(&str, bool); 2] = [("literal", false), ("zero", true)];
/// Names, in configurations, of the published predictions: true for the prediction with the matrix.
const PREDICTIONS: [(&str, bool); 2] = [("motion", false), ("matrix", true)];
/// Names of the time behaviours of process noise in configurations.
const FORMS: [(&str, NoiseForm); 2] =
    [("continuous", NoiseForm::Continuous), ("discrete", NoiseForm::Discrete)];
/// Names of the uses of a gyro in configurations.
const GYROS: [(&str, GyroUse); 4] = [
    ("input", GyroUse::Input),
    ("exact", GyroUse::Exact),
    ("measurement", GyroUse::Measurement),
    ("none", GyroUse::Ignored),
];
/// Names of the sources of sensor noise in configurations: true if it is estimated.
const NOISES: [(&str, bool); 2] = [("estimated", true), ("configured", false)];
/// Names, in configurations, of the source of the first speed of a target: true if it is the range
/// rate.
const STARTS: [(&str, bool); 2] = [("range-rate", true), ("zero", false)];

impl FusionConfig {
    pub(crate) fn parameters(&self) -> Result<FusionParameters, Error> {
        let method = self.method()?;
        Ok(FusionParameters {
            model: self.model()?,
            method,
            strengths: Strengths {
                form: choice("process", &self.process, &FORMS)?,
                acceleration: self.acceleration_noise,
                jerk: self.jerk_noise,
                turn: self.turn_noise,
                platform: self.platform_noise,
                ..Strengths::default()
            },
            prior: self.prior(),
            sensing: Sensing {
                lidar: self.lidar()?.map(squared),
                radar: self.radar()?.map(squared),
                gyro: squared(self.gyro_std),
                pose: self.pose()?.map(squared),
                convert_radar: method == Method::Linear,
                ..Sensing::default()
            },
            life: self.life()?,
            lever: self.lever()?,
        })
    }

    /// Standard deviations of x, y and z [m]; if z is missing, that of y is used.
    fn lidar(&self) -> Result<[f64; 3], Error> {
        match self.lidar_std[..] {
            [x, y] => Ok([x, y, y]),
            [x, y, z] => Ok([x, y, z]),
            _ => Err(length("lidar_std", 2, &self.lidar_std)),
        }
    }

    /// Standard deviations of range [m], bearing [rad], elevation [rad] and range rate [m/s]; if
    /// the elevation is missing, that of the bearing is used.
    fn radar(&self) -> Result<[f64; 4], Error> {
        match self.radar_std[..] {
            [range, bearing, rate] => Ok([range, bearing, bearing, rate]),
            [range, bearing, elevation, rate] => Ok([range, bearing, elevation, rate]),
            _ => Err(length("radar_std", 3, &self.radar_std)),
        }
    }

    /// Standard deviations of x, y, z [m], roll, pitch and yaw [rad]; zero for missing values.
    fn pose(&self) -> Result<[f64; 6], Error> {
        match self.pose_std[..] {
            [x, y, yaw] => Ok([x, y, 0.0, 0.0, 0.0, yaw]),
            [x, y, z, roll, pitch, yaw] => Ok([x, y, z, roll, pitch, yaw]),
            _ => Err(length("pose_std", 3, &self.pose_std)),
        }
    }

    fn lever(&self) -> Result<[f64; 3], Error> {
        match self.lever_arm[..] {
            [x, y] => Ok([x, y, 0.0]),
            [x, y, z] => Ok([x, y, z]),
            _ => Err(length("lever_arm", 2, &self.lever_arm)),
        }
    }

    fn model(&self) -> Result<Model, Error> {
        if self.model != "paper" {
            return model_named("model", &self.model);
        }
        Ok(Model::Paper(Paper {
            reading: choice("published.reading", &self.published.reading, &READINGS)?,
            fixed_alpha: choice("published.alpha", &self.published.alpha, &FIXES)?,
            by_matrix: choice("published.prediction", &self.published.prediction, &PREDICTIONS)?,
            fixed_straight_y: choice("published.straight_y", &self.published.straight_y, &FIXES)?,
            zero_platform_column: choice(
                "published.platform_column",
                &self.published.platform_column,
                &COLUMNS,
            )?,
            speed: self.published.speed,
            elevation: self.published.elevation,
            std: [0.0; 3], // those of the strengths
            prior: self.prior(),
        }))
    }

    fn method(&self) -> Result<Method, Error> {
        let carries = choice("sigma_points", &self.sigma_points, &POINTS)?;
        let mut models = MIXABLE.map(|_| false);
        for name in &self.imm_models {
            let model = model_named("imm_models", name)?;
            MIXABLE.iter().zip(&mut models).for_each(|(known, used)| *used |= *known == model);
        }
        let known = [
            ("kf", Method::Linear),
            ("ekf", Method::Extended),
            ("ukf", Method::Sigma { spread: self.sigma_spread, carries }),
            ("ckf", Method::Cubature),
            (
                "imm",
                Method::Interacting { models, sojourn: self.imm_sojourn, quiet: self.imm_quiet },
            ),
        ];
        choice("method", &self.method, &known)
    }

    fn prior(&self) -> Prior {
        Prior {
            position: squared(self.initial_position),
            speed: squared(self.initial_speed),
            heading: squared(self.initial_heading),
            turn_rate: squared(self.initial_turn_rate),
            acceleration: squared(self.initial_acceleration),
            ..Prior::default()
        }
    }

    fn life(&self) -> Result<LifecycleRules, Error> {
        let estimates = choice("sensor_noise", &self.sensor_noise, &NOISES)?;
        Ok(LifecycleRules {
            start_rows: self.start_rows,
            gate: LifecycleRules::gates(self.gate_probability)?,
            memory: LifecycleRules::default().memory.filter(|_| estimates),
            loss_ratio: self.loss_ratio,
            radar_starts_speed: choice("start_speed", &self.start_speed, &STARTS)?,
            starts_as_measured: false,
            gyro: choice("gyro", &self.gyro, &GYROS)?,
            buffer_ns: (self.buffer_time * 1e9).round() as i64,
        })
    }
}

fn model_named(key: &'static str, name: &str) -> Result<Model, Error> {
    choice(key, name, &model_list::models().map(|entry| (entry.name, entry.model)))
}

/// Name, names of the states, meaning, and whether `imm` can mix it, of every motion model.
#[pyfunction]
pub(crate) fn fusion_models() -> Vec<(&'static str, Vec<&'static str>, &'static str, bool)> {
    let of = |entry: model_list::ModelEntry| {
        let can_mix = MIXABLE.contains(&entry.model);
        (entry.name, entry.states.to_vec(), entry.title, can_mix)
    };
    model_list::models().map(of).to_vec()
}

fn length(name: &'static str, expected: usize, values: &[f64]) -> Error {
    Error::Length { name, expected, got: values.len() }
}

fn squared(value: f64) -> f64 {
    value * value
}
