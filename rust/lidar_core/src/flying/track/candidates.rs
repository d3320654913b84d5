//! Clusters that may be a track's target.

use super::occupancy::Occupancy;
use super::parameters::{MeasurementForm, TrackerParameters};
use crate::Error;
use crate::geometry::cluster;
use nalgebra::{Matrix3, Vector3};

/// Something measured: where, how well, and how large.
#[derive(Clone, Debug)]
pub(super) struct Measurement {
    pub(super) position: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
    pub(super) extent: [f64; 3],
}

/// Clusters of `points` that are small enough and far enough from the background, by first
/// appearance. Source: Vrba et al., Algorithm 2, lines 37-39 and 43.
///
/// # Errors
/// Those of [`cluster::label`].
pub(super) fn candidates(
    points: &[[f32; 3]],
    occupied: &dyn Occupancy,
    parameters: &TrackerParameters,
) -> Result<Vec<Measurement>, Error> {
    let labels = cluster::label(points, &parameters.clustering)?;
    let count = labels.iter().map(|&label| (label + 1) as usize).max().unwrap_or(0);
    let mut clusters = vec![Cluster::EMPTY; count];
    for (point, &label) in points.iter().zip(&labels) {
        if label >= 0 {
            clusters[label as usize].add(point.map(f64::from));
        }
    }
    if parameters.measurement == MeasurementForm::Cluster {
        for (point, &label) in points.iter().zip(&labels) {
            if label >= 0 {
                clusters[label as usize].add_scatter(point.map(f64::from));
            }
        }
    }
    let is_target = |cluster: &Cluster| {
        let centroid = cluster.centroid();
        cluster.extent().iter().all(|&side| parameters.max_extent.is_none_or(|max| side <= max))
            && !occupied.any_within(centroid.into(), parameters.occupied_distance)
    };
    Ok(clusters
        .iter()
        .filter(|cluster| is_target(cluster))
        .map(|cluster| cluster.measurement(parameters.measurement_std))
        .collect())
}

#[derive(Clone)]
struct Cluster {
    count: f64,
    sum: Vector3<f64>,
    low: [f64; 3],
    high: [f64; 3],
    scatter: Matrix3<f64>,
}

impl Cluster {
    const EMPTY: Self = Self {
        count: 0.0,
        sum: Vector3::new(0.0, 0.0, 0.0),
        low: [f64::INFINITY; 3],
        high: [f64::NEG_INFINITY; 3],
        scatter: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    fn add(&mut self, point: [f64; 3]) {
        self.count += 1.0;
        self.sum += Vector3::from(point);
        for (axis, value) in point.into_iter().enumerate() {
            self.low[axis] = self.low[axis].min(value);
            self.high[axis] = self.high[axis].max(value);
        }
    }

    fn add_scatter(&mut self, point: [f64; 3]) {
        let offset = Vector3::from(point) - self.centroid();
        self.scatter += offset * offset.transpose();
    }

    fn centroid(&self) -> Vector3<f64> {
        self.sum / self.count
    }

    fn extent(&self) -> [f64; 3] {
        std::array::from_fn(|axis| self.high[axis] - self.low[axis])
    }

    /// The scatter is zero where the paper's fixed covariance is asked for.
    fn measurement(&self, std: f64) -> Measurement {
        Measurement {
            position: self.centroid(),
            covariance: Matrix3::identity() * (std * std)
                + self.scatter / (self.count * self.count),
            extent: self.extent(),
        }
    }
}
