//! Noise of LiDAR and radar, estimated from the measurements of a target.

use crate::fusion::filter::engine::Innovation;
use crate::fusion::sensors::measurement::{Measurement, Sensor};
use crate::fusion::sensors::sensing::Sensing;
use crate::tracking::sensor_noise::{InnovationStatistics, NoiseFactor};
use serde::{Deserialize, Serialize};

/// Largest factor on the variances of a measurement that may be an outlier.
const OUTLIER: f64 = 100.0;
/// Indices of the values of a LiDAR.
const IN_ORDER: [usize; 4] = [0, 1, 2, 3];

/// Estimated variances as factors of the configured ones. Measurements with their own covariance
/// are used unchanged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorErrors {
    /// Factors on the noise of x, y and z.
    lidar: [NoiseFactor; 3],
    /// Factors on the noise of range, bearing, elevation and range rate.
    radar: [NoiseFactor; 4],
}

impl SensorErrors {
    /// The measurement with the estimated covariance of its sensor.
    pub fn seen_by(&self, m: &Measurement, sensing: &Sensing) -> Measurement {
        if m.has_covariance() || m.is_of_platform() {
            return *m;
        }
        let (factors, places) = self.of(m);
        let configured = sensing.variances(m);
        let mut variances = [0.0; 4];
        let own = variances.iter_mut().zip(places).zip(configured).take(m.noisy());
        own.for_each(|((own, place), told)| *own = factors[place].factor() * told);
        m.with_variances(&variances[..m.noisy()])
    }

    /// Estimates for the sensor of a measurement, and for each value the index of its estimate.
    fn of(&self, m: &Measurement) -> (&[NoiseFactor], [usize; 4]) {
        if m.sensor() == Sensor::Radar {
            return (&self.radar, m.measures().places());
        }
        (&self.lidar, IN_ORDER)
    }

    /// Update the estimates with the innovation of a measurement, as [`Self::seen_by`] returns it.
    pub fn learn(
        &mut self,
        m: &Measurement,
        sensing: &Sensing,
        innovation: &Innovation,
        memory: f64,
    ) {
        // A radar's place in Cartesian form, or one that was levelled, has other values than were
        // measured.
        let is_plain = innovation.count == m.noisy();
        if m.has_covariance() || m.is_of_platform() || !is_plain {
            return;
        }
        let (factors, places, configured): (&mut [NoiseFactor], _, &[f64]) =
            if m.sensor() == Sensor::Radar {
                (&mut self.radar, m.measures().places(), &sensing.radar)
            } else {
                (&mut self.lidar, IN_ORDER, &sensing.lidar)
            };
        let seen = innovation.values.iter().zip(innovation.variances);
        for ((value, variance), place) in seen.zip(places).take(m.noisy()) {
            let (factor, configured) = (&mut factors[place], configured[place]);
            let predicted = variance - factor.factor() * configured;
            let squared = value * value;
            factor.learn(&InnovationStatistics { squared, predicted, configured }, memory);
        }
    }

    /// True if enough measurements of a sensor have been seen to know its noise.
    pub fn is_known(&self, m: &Measurement) -> bool {
        let (factors, places) = self.of(m);
        m.is_of_platform() || places[..m.noisy()].iter().all(|place| factors[*place].is_known())
    }

    /// Estimated variances of LiDAR and radar.
    pub fn variances(&self, sensing: &Sensing) -> ([f64; 3], [f64; 4]) {
        let lidar = std::array::from_fn(|k| self.lidar[k].factor() * sensing.lidar[k]);
        (lidar, std::array::from_fn(|k| self.radar[k].factor() * sensing.radar[k]))
    }
}

/// The measurement as it would be if it were an outlier; None if it has no covariance.
pub fn as_outlier(m: &Measurement) -> Option<Measurement> {
    let mut variances = [0.0; 4];
    for (index, variance) in variances.iter_mut().enumerate().take(m.noisy()) {
        *variance = OUTLIER * m.variance(index)?;
    }
    Some(m.with_variances(&variances[..m.noisy()]))
}
