//! Clusters of a scan that may be the target of a track.

use super::measurement::{CloudScan, Measurement};
use super::parameters::{MeasurementForm, TrackerParameters};
use nalgebra::{Matrix3, Vector3};
use std::cmp::Ordering;

/// Clusters of the points with the indices `rows`, given by their `labels`, that are small enough
/// and far enough from the background. They are sorted by position.
///
/// The result does not depend on the order of the points, not even in its last bit.
///
/// # Source
/// Vrba et al., Algorithm 2, lines 38-39 and 43.
pub(super) fn candidates(
    rows: &[u32],
    labels: &[i32],
    scan: &CloudScan<'_>,
    parameters: &TrackerParameters,
) -> Vec<Measurement> {
    let max_extent = parameters.max_extent.unwrap_or(f64::INFINITY);
    let mut found: Vec<(CandidateCluster, Measurement)> = clusters(rows, labels, scan)
        .into_iter()
        .filter(|cluster| cluster.extent().iter().all(|&side| side <= max_extent))
        .map(|cluster| {
            let measurement = cluster.measurement(scan, parameters);
            (cluster, measurement)
        })
        .filter(|(_, measurement)| {
            let position = measurement.position.into();
            !scan.occupied.any_within(position, parameters.occupied_distance)
        })
        .collect();
    found.sort_by(|(_, one), (_, other)| order(&one.position.into(), &other.position.into()));
    if parameters.measurement == MeasurementForm::Center {
        take_centers(&mut found, scan);
    }
    found.into_iter().map(|(_, measurement)| measurement).collect()
}

fn clusters(rows: &[u32], labels: &[i32], scan: &CloudScan<'_>) -> Vec<CandidateCluster> {
    let mut clusters: Vec<CandidateCluster> = Vec::new();
    for (&row, &label) in rows.iter().zip(labels) {
        let Ok(label) = usize::try_from(label) else { continue }; // noise is negative
        if label >= clusters.len() {
            clusters.resize(label + 1, CandidateCluster::EMPTY);
        }
        clusters[label].add(row, scan.points[row as usize]);
    }
    clusters.retain(|cluster| !cluster.rows.is_empty());
    for cluster in &mut clusters {
        cluster.rows.sort_by(|&one, &other| {
            let key = |row: u32| (scan.points[row as usize], scan.delay(row));
            let ((one, early), (other, late)) = (key(one), key(other));
            order(&one, &other).then(early.total_cmp(&late))
        });
    }
    clusters
}

/// Replace the centroids of clusters by estimated centres, if the rays of the scan are known.
fn take_centers(found: &mut [(CandidateCluster, Measurement)], scan: &CloudScan<'_>) {
    let rows: Vec<&[u32]> = found.iter().map(|(cluster, _)| cluster.rows.as_slice()).collect();
    let centers = scan.visibility.and_then(|visibility| visibility.centers(&rows));
    for ((_, measurement), center) in found.iter_mut().zip(centers.into_iter().flatten()) {
        (measurement.position, measurement.covariance) = (center.position, center.covariance);
        measurement.is_cut = center.is_cut;
    }
}

fn order<T: Copy + PartialOrd>(one: &[T; 3], other: &[T; 3]) -> Ordering {
    one.partial_cmp(other).unwrap_or(Ordering::Equal) // finite, so never unknown
}

#[derive(Clone)]
struct CandidateCluster {
    /// Indices of its points in the scan, sorted by coordinates.
    rows: Vec<u32>,
    low: [f32; 3],
    high: [f32; 3],
}

impl CandidateCluster {
    const EMPTY: Self =
        Self { rows: Vec::new(), low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3] };

    fn add(&mut self, row: u32, point: [f32; 3]) {
        self.rows.push(row);
        for (axis, value) in point.into_iter().enumerate() {
            self.low[axis] = self.low[axis].min(value);
            self.high[axis] = self.high[axis].max(value);
        }
    }

    fn extent(&self) -> [f64; 3] {
        std::array::from_fn(|axis| f64::from(self.high[axis]) - f64::from(self.low[axis]))
    }

    fn measurement(&self, scan: &CloudScan<'_>, parameters: &TrackerParameters) -> Measurement {
        let count = self.rows.len() as f64;
        let place = |&row: &u32| Vector3::from(scan.points[row as usize].map(f64::from));
        let delay = match parameters.measurement {
            MeasurementForm::Paper => 0.0,
            MeasurementForm::Cluster | MeasurementForm::Center => {
                self.rows.iter().map(|&row| f64::from(scan.delay(row))).sum::<f64>() / count
            }
        };
        let position = self.rows.iter().map(place).sum::<Vector3<f64>>() / count;
        let std = parameters.measurement_std;
        let mut covariance = Matrix3::identity() * (std * std);
        if parameters.measurement != MeasurementForm::Paper {
            let offsets = self.rows.iter().map(|row| place(row) - position);
            let scatter: Matrix3<f64> = offsets.map(|offset| offset * offset.transpose()).sum();
            covariance += scatter / (count * count);
        }
        Measurement {
            position,
            covariance,
            delay,
            extent: self.extent(),
            n_points: self.rows.len(),
            is_cut: true,
            row: self.rows.first().copied(),
        }
    }
}
