//! Noise of LiDAR and radar as the measurements of a target show it.

use crate::fusion::filter::engine::Innovation;
use crate::fusion::sensors::measurement::{Measurement, Sensor};
use crate::fusion::sensors::observation::Sensing;
use crate::tracking::sensor_noise::{InnovationStatistics, NoiseFactor};
use serde::{Deserialize, Serialize};

/// Largest factor on the variances of a measurement that may be an outlier.
const OUTLIER: f64 = 100.0;

/// Estimated variances as factors on the configured ones. Measurements with a covariance of their
/// own are believed as they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorErrors {
    /// Of x and y.
    lidar: [NoiseFactor; 2],
    /// Of range, bearing and range rate.
    radar: [NoiseFactor; 3],
}

impl SensorErrors {
    /// The measurement with the covariance that its sensor has by these estimates.
    pub fn seen_by(&self, m: &Measurement, sensing: &Sensing) -> Measurement {
        let scaled = |factor: &NoiseFactor, variance: f64| factor.factor() * variance;
        if m.covariance().is_some() {
            return *m;
        }
        match m.sensor() {
            Sensor::Lidar => {
                m.with_variances(&[0, 1].map(|k| scaled(&self.lidar[k], sensing.lidar[k])))
            }
            Sensor::Radar => {
                m.with_variances(&[0, 1, 2].map(|k| scaled(&self.radar[k], sensing.radar[k])))
            }
            Sensor::Gyro | Sensor::Pose => *m,
        }
    }

    /// Take in the innovation that a measurement, as [`Self::seen_by`] gives it, has.
    pub fn learn(
        &mut self,
        m: &Measurement,
        sensing: &Sensing,
        innovation: &Innovation,
        memory: f64,
    ) {
        if m.covariance().is_some() {
            return;
        }
        let Innovation { values, variances, .. } = innovation;
        match (m.sensor(), innovation.count) {
            (Sensor::Lidar, 2) => each(&mut self.lidar, &sensing.lidar, values, variances, memory),
            (Sensor::Radar, 3) => each(&mut self.radar, &sensing.radar, values, variances, memory),
            _ => {}
        }
    }

    /// True if enough measurements of a sensor have been seen to know its noise.
    pub fn is_known(&self, sensor: Sensor) -> bool {
        match sensor {
            Sensor::Lidar => self.lidar.iter().all(NoiseFactor::is_known),
            Sensor::Radar => self.radar.iter().all(NoiseFactor::is_known),
            Sensor::Gyro | Sensor::Pose => true,
        }
    }

    /// Estimated variances of LiDAR and radar.
    pub fn variances(&self, sensing: &Sensing) -> ([f64; 2], [f64; 3]) {
        let lidar = std::array::from_fn(|k| self.lidar[k].factor() * sensing.lidar[k]);
        (lidar, std::array::from_fn(|k| self.radar[k].factor() * sensing.radar[k]))
    }
}

/// Let every value of a sensor learn from its innovation.
fn each(
    factors: &mut [NoiseFactor],
    configured: &[f64],
    values: &[f64],
    variances: &[f64],
    memory: f64,
) {
    for (k, factor) in factors.iter_mut().enumerate() {
        let predicted = variances[k] - factor.factor() * configured[k];
        let squared = values[k] * values[k];
        factor
            .learn(&InnovationStatistics { squared, predicted, configured: configured[k] }, memory);
    }
}

/// The measurement as it would be if it were an outlier; None if it has no covariance.
pub fn as_outlier(m: &Measurement) -> Option<Measurement> {
    let rows = m.covariance()?;
    let variances = [0, 1, 2].map(|k| OUTLIER * rows[k][k]);
    Some(m.with_variances(&variances[..m.noisy()]))
}
