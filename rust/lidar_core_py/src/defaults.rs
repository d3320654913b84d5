//! Parameters of the core made from a configuration, and its defaults, as text: a test compares
//! them.

use crate::circles::config::FitConfig;
use crate::circles::map::CircleMapConfig;
use crate::circles::pipeline::CirclesConfig;
use crate::errors::BorderError;
use crate::flying::config::{ClassifyConfig, FlyingConfig, MapConfig};
use crate::flying::tracker::TrackerConfig;
use crate::fusion::config::FusionConfig;
use crate::fusion::many::MultiTargetConfig;
use lidar_core::Error;
use lidar_core::circles::map::CircleMapParameters;
use lidar_core::circles::parameters::PipelineParameters;
use lidar_core::flying::classify::parameters::ClassifyParameters;
use lidar_core::flying::map::parameters::MapParameters;
use lidar_core::flying::parameters::FlyingParameters;
use lidar_core::flying::track::TrackerParameters;
use lidar_core::fusion::{FusionParameters, ManyParameters, TargetAssociation};
use pyo3::prelude::*;
use std::fmt::Debug;

/// Parameters of the core made from a configuration model, one line per value.
#[pyfunction]
pub(crate) fn parameters_of(model: &str, config: &Bound<'_, PyAny>) -> Result<String, BorderError> {
    Ok(match model {
        "flying" => {
            let mut parameters = config.extract::<FlyingConfig>()?.parameters()?;
            // The rays of sensors that are sold are data of the Python package.
            parameters.default_sensor.known_sensors.clear();
            text(&parameters)
        }
        "voxel_map" => text(&config.extract::<MapConfig>()?.parameters([0.0; 3])?),
        "classify" => text(&config.extract::<ClassifyConfig>()?.parameters()),
        "tracker" => text(&config.extract::<TrackerConfig>()?.parameters()?),
        "circles" => {
            let fit: FitConfig = config.getattr("fit")?.extract()?;
            text(&config.extract::<CirclesConfig>()?.parameters(&fit)?)
        }
        "circle_map" => text(&config.extract::<CircleMapConfig>()?.parameters()?),
        "fusion" => text(&config.extract::<FusionConfig>()?.parameters()?),
        "many" => text(&config.extract::<MultiTargetConfig>()?.parameters()?),
        _ => return Err(unknown("model", model)),
    })
}

/// The parameters of the core, as `parameters_of` prints them: "default", "paper", "nearest" or
/// "joint".
#[pyfunction]
pub(crate) fn default_parameters(model: &str, mode: &str) -> Result<String, BorderError> {
    Ok(match (model, mode) {
        ("flying", "default") => text(&FlyingParameters::default()),
        ("flying", "paper") => text(&FlyingParameters::paper()),
        ("voxel_map", "default") => text(&MapParameters::default()),
        ("voxel_map", "paper") => text(&MapParameters::paper()),
        ("classify", "default") => text(&ClassifyParameters::default()),
        ("classify", "paper") => text(&ClassifyParameters::paper()),
        ("tracker", "default") => text(&TrackerParameters::default()),
        ("tracker", "paper") => text(&TrackerParameters::paper()),
        ("circles", "default") => text(&PipelineParameters::default()),
        ("circles", "paper") => text(&PipelineParameters::paper()),
        ("circle_map", "default") => text(&CircleMapParameters::default()),
        ("circle_map", "paper") => text(&CircleMapParameters::paper()),
        ("fusion", "default") => text(&FusionParameters::default()),
        ("fusion", "paper") => text(&FusionParameters::paper()),
        ("many", "default") => text(&ManyParameters::default()),
        ("many", "nearest") => {
            let association = TargetAssociation::Nearest;
            text(&ManyParameters { association, ..ManyParameters::default() })
        }
        ("many", "joint") => {
            let association = TargetAssociation::joint();
            text(&ManyParameters { association, ..ManyParameters::default() })
        }
        _ => return Err(unknown("mode", mode)),
    })
}

fn text(parameters: &impl Debug) -> String {
    format!("{parameters:#?}")
}

fn unknown(name: &'static str, got: &str) -> BorderError {
    Error::Parameter { name, expected: "a known one", got: got.to_owned() }.into()
}
