//! The fields of `FusionConfig` as parameters of the core.

use crate::arrays::choice;
use lidar_core::Error;
use lidar_core::fusion::motion::{NoiseForm, Prior};
use lidar_core::fusion::sensors::Sensing;
use lidar_core::fusion::target::{GyroUse, Life, Loss};
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
    start_noise: f64,
    lidar_std: [f64; 2],
    radar_std: [f64; 3],
    gyro_std: f64,
    range_min: f64,
    gyro: String,
    lever_arm: [f64; 2],
    start_rows: u32,
    start_speed: String,
    initial_position: f64,
    initial_speed: f64,
    initial_heading: f64,
    initial_turn_rate: f64,
    initial_acceleration: f64,
    initial_platform_rate: f64,
    gate_probability: Option<f64>,
    loss_ratio: Option<f64>,
    loss_window: f64,
}

const MODELS: [(&str, Model); 6] = [
    ("cv", Model::ConstantVelocity),
    ("ca", Model::ConstantAcceleration),
    ("ct", Model::CoordinatedTurn),
    ("ctrv", Model::Ctrv),
    ("ctra", Model::Ctra),
    ("ctrv-drone", Model::CtrvDrone),
];
const METHODS: [(&str, Method); 2] = [("kf", Method::Linear), ("ekf", Method::Extended)];
const FORMS: [(&str, NoiseForm); 2] =
    [("continuous", NoiseForm::Continuous), ("discrete", NoiseForm::Discrete)];
const GYROS: [(&str, GyroUse); 3] =
    [("input", GyroUse::Input), ("measurement", GyroUse::Measurement), ("none", GyroUse::Ignored)];
const STARTS: [(&str, bool); 2] = [("range-rate", true), ("zero", false)];

impl FusionConfig {
    pub(crate) fn parameters(&self) -> Result<FusionParameters, Error> {
        let method = choice("method", &self.method, &METHODS)?;
        Ok(FusionParameters {
            model: choice("model", &self.model, &MODELS)?,
            method,
            strengths: Strengths {
                form: choice("process", &self.process, &FORMS)?,
                acceleration: self.acceleration_noise,
                jerk: self.jerk_noise,
                turn: self.turn_noise,
                platform: self.platform_noise,
                start: self.start_noise,
            },
            prior: self.prior(),
            sensing: Sensing {
                lidar: self.lidar_std.map(squared),
                radar: self.radar_std.map(squared),
                gyro: squared(self.gyro_std),
                range_min: self.range_min,
                convert_radar: method == Method::Linear,
            },
            life: self.life()?,
            lever: self.lever_arm,
        })
    }

    fn prior(&self) -> Prior {
        Prior {
            position: squared(self.initial_position),
            speed: squared(self.initial_speed),
            heading: squared(self.initial_heading),
            turn_rate: squared(self.initial_turn_rate),
            acceleration: squared(self.initial_acceleration),
            platform_rate: squared(self.initial_platform_rate),
        }
    }

    fn life(&self) -> Result<Life, Error> {
        Ok(Life {
            start_rows: self.start_rows,
            gate: Life::gates(self.gate_probability)?,
            loss: self.loss_ratio.map(|ratio| Loss { ratio, window: self.loss_window }),
            radar_starts_speed: choice("start_speed", &self.start_speed, &STARTS)?,
            gyro: choice("gyro", &self.gyro, &GYROS)?,
        })
    }
}

fn squared(value: f64) -> f64 {
    value * value
}
