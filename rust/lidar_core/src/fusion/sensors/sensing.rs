//! Noise of the sensors, and limits of their models.

use super::measurement::Measurement;
use nalgebra::{Matrix3, Matrix6, Vector3};

/// Noise of measurements without a covariance, and limits of the models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensing {
    /// Variances of x, y and z of the LiDAR [m^2].
    pub lidar: [f64; 3],
    /// Variances of range [m^2], bearing and elevation [rad^2] and range rate [m^2/s^2] of the
    /// radar, in the order of [`PolarValues`].
    pub radar: [f64; 4],
    /// Variance of the gyro's turn rate [rad^2/s^2].
    pub gyro: f64,
    /// Variances of the platform's x, y, z [m^2], roll, pitch and yaw [rad^2]; zeros for exact
    /// poses.
    pub pose: [f64; 6],
    /// Range below which a radar's range and bearing are turned into a position [m].
    pub range_min: f64,
    /// Always convert radar measurements to positions and drop the range rate.
    pub convert_radar: bool,
}

/// Standard deviations of 0.15 m (LiDAR), of 0.3 m, 0.03 rad and 0.3 m/s (radar), and of 0.01 rad/s
/// (gyro), on a platform with exact poses.
impl Default for Sensing {
    fn default() -> Self {
        let variance = |std: f64| std * std;
        Self {
            lidar: [0.15; 3].map(variance),
            radar: [0.3, 0.03, 0.03, 0.3].map(variance),
            gyro: variance(0.01),
            pose: [0.0; 6],
            range_min: 0.1,
            convert_radar: false,
        }
    }
}

impl Sensing {
    /// Variance of a gyro's turn rate [rad^2/s^2].
    #[must_use]
    pub fn gyro_variance(&self, m: &Measurement) -> f64 {
        m.variance(0).unwrap_or(self.gyro)
    }

    /// Covariance of a pose's x, y and yaw; None for an exact pose.
    #[must_use]
    pub fn pose_noise(&self, m: &Measurement) -> Option<Matrix3<f64>> {
        let [x, y, _, _, _, yaw] = self.pose;
        let variances = Vector3::new(x, y, yaw);
        let known = variances.iter().any(|variance| *variance > 0.0);
        m.covariance().or_else(|| known.then(|| Matrix3::from_diagonal(&variances)))
    }

    /// Covariance of a pose's x, y, z, roll, pitch and yaw; None for an exact pose.
    #[must_use]
    pub fn space_pose_noise(&self, m: &Measurement) -> Option<Matrix6<f64>> {
        let known = self.pose.iter().any(|variance| *variance > 0.0);
        m.covariance().or_else(|| known.then(|| Matrix6::from_diagonal(&self.pose.into())))
    }
}
