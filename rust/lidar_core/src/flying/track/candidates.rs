//! Clusters that may be a track's target.

use super::occupancy::Occupancy;
use super::parameters::{MeasurementForm, TrackerParameters};
use crate::geometry::transform::norm;
use nalgebra::{Matrix3, Vector3};
use std::cmp::Ordering;

/// Something measured: where, how well, and how large.
#[derive(Clone, Debug)]
pub(super) struct Measurement {
    pub(super) position: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
    /// Time of the measurement after the state's [s]: a scan takes a while.
    pub(super) delay: f64,
    pub(super) extent: [f64; 3],
}

/// Clusters of `points`, given by their `labels`, that are small enough and far enough from the
/// background, by position.
///
/// The result does not depend on the order of the points, not even in its last bit.
///
/// # Source
/// Vrba et al., Algorithm 2, lines 38-39 and 43.
pub(super) fn candidates(
    points: &[[f32; 3]],
    labels: &[i32],
    delays: &[f32],
    occupied: &dyn Occupancy,
    parameters: &TrackerParameters,
) -> Vec<Measurement> {
    let mut clusters: Vec<Cluster> = Vec::new();
    for (row, (point, &label)) in points.iter().zip(labels).enumerate() {
        let Ok(label) = usize::try_from(label) else { continue }; // noise is negative
        if label >= clusters.len() {
            clusters.resize(label + 1, Cluster::EMPTY);
        }
        clusters[label].add(*point, delays.get(row).copied().unwrap_or(0.0));
    }
    let mut measurements: Vec<Measurement> = clusters
        .into_iter()
        .filter(|cluster| {
            let max = parameters.max_extent.unwrap_or(f64::INFINITY);
            cluster.extent().iter().all(|&side| side <= max)
        })
        .map(|cluster| cluster.measurement(parameters))
        .filter(|measurement| {
            let reach = match parameters.occupied_adds_extent {
                true => parameters.occupied_distance + norm(measurement.extent),
                false => parameters.occupied_distance,
            };
            !occupied.any_within(measurement.position.into(), reach)
        })
        .collect();
    measurements.sort_by(|one, other| order(&one.position.into(), &other.position.into()));
    measurements
}

fn order<T: Copy + PartialOrd>(one: &[T; 3], other: &[T; 3]) -> Ordering {
    one.partial_cmp(other).unwrap_or(Ordering::Equal) // finite, so never unknown
}

#[derive(Clone)]
struct Cluster {
    /// Coordinates and delay.
    points: Vec<([f32; 3], f32)>,
    low: [f32; 3],
    high: [f32; 3],
}

impl Cluster {
    const EMPTY: Self =
        Self { points: Vec::new(), low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3] };

    fn add(&mut self, point: [f32; 3], delay: f32) {
        self.points.push((point, delay));
        for (axis, value) in point.into_iter().enumerate() {
            self.low[axis] = self.low[axis].min(value);
            self.high[axis] = self.high[axis].max(value);
        }
    }

    fn extent(&self) -> [f64; 3] {
        std::array::from_fn(|axis| f64::from(self.high[axis]) - f64::from(self.low[axis]))
    }

    fn measurement(mut self, parameters: &TrackerParameters) -> Measurement {
        self.points.sort_unstable_by(|(one, early), (other, late)| {
            order(one, other).then(early.total_cmp(late))
        });
        let count = self.points.len() as f64;
        let places = || self.points.iter().map(|(point, _)| Vector3::from(point.map(f64::from)));
        let delays = self.points.iter().map(|&(_, delay)| f64::from(delay));
        let delay = match parameters.measurement {
            MeasurementForm::Paper => 0.0,
            MeasurementForm::Cluster => delays.sum::<f64>() / count,
        };
        let position = places().sum::<Vector3<f64>>() / count;
        let std = parameters.measurement_std;
        let mut covariance = Matrix3::identity() * (std * std);
        if parameters.measurement == MeasurementForm::Cluster {
            let scatter: Matrix3<f64> =
                places().map(|place| (place - position) * (place - position).transpose()).sum();
            covariance += scatter / (count * count);
        }
        Measurement { position, covariance, delay, extent: self.extent() }
    }
}
