//! Rays without return, rebuilt for drivers that drop them (KITTI, Velodyne).
//!
//! A spinning sensor fires rows of known elevation at a fixed step of azimuth. Where a row has no
//! point, the ray met nothing. Rows come from a preset, or are learnt from the points.

use crate::geometry::lattice::wide;
use crate::geometry::transform::norm;
use std::f64::consts::{PI, TAU};

/// What is known of the rays of a sensor.
#[derive(Clone, Debug, PartialEq)]
pub enum BeamTable {
    /// Elevation of every row [rad], ascending, and the rays per revolution.
    Rows {
        /// Elevations [rad].
        elevations: Vec<f64>,
        /// Rays per revolution.
        columns: usize,
    },
    /// Rows are learnt from the points of earlier scans.
    Learnt {
        /// Rays per revolution.
        columns: usize,
    },
}

/// Elevation bins of the learner [rad]: 0.05 degrees.
const BIN: f64 = PI / 3600.0;
/// Bins are halved above this, long before they overflow: a scan has fewer points.
const MOST_POINTS: u32 = 1 << 30;
/// A bin is a row once it held this share of a revolution in all scans together.
const ROW_SHARE: f64 = 0.25;
/// Rows further apart than this do not bound a row's tolerance [rad].
const MAX_HALF_STEP: f64 = 0.02;

/// Finds the rays that are missing in a scan.
#[derive(Clone, Debug)]
pub(crate) struct Rebuilder {
    elevations: Vec<f64>,
    columns: usize,
    /// Points per elevation bin so far; empty with a preset.
    histogram: Vec<u32>,
}

/// Rays that returned nothing and that the driver dropped, and memory for the next scan.
#[derive(Default)]
pub(crate) struct Missing {
    /// Rays by row and column that have a point.
    hit: Vec<bool>,
    /// Directions in the lidar frame.
    pub(crate) directions: Vec<[f32; 3]>,
}

impl Rebuilder {
    pub(crate) fn new(table: &BeamTable) -> Self {
        match table {
            BeamTable::Rows { elevations, columns } => {
                Self { elevations: elevations.clone(), columns: *columns, histogram: Vec::new() }
            }
            BeamTable::Learnt { columns } => Self {
                elevations: Vec::new(),
                columns: *columns,
                histogram: vec![0; (PI / BIN) as usize + 1],
            },
        }
    }

    /// Whether any row is known yet.
    pub(crate) fn is_ready(&self) -> bool {
        !self.elevations.is_empty()
    }

    /// Learn the rows of a scan, if rows are to be learnt.
    pub(crate) fn learn(&mut self, points: &[[f32; 3]]) {
        if self.histogram.is_empty() {
            return;
        }
        for (elevation, _) in points.iter().filter_map(|&point| angles(point)) {
            let bin = ((elevation + PI / 2.0) / BIN) as usize;
            let last = self.histogram.len() - 1;
            self.histogram[bin.min(last)] += 1;
        }
        if self.histogram.iter().any(|&count| count > MOST_POINTS) {
            self.histogram.iter_mut().for_each(|count| *count /= 2);
        }
        let enough = (ROW_SHARE * self.columns as f64) as u32;
        self.elevations.clear();
        self.elevations.extend(peaks(&self.histogram, enough.max(1)));
    }

    /// Whether a scan holds any return: without one it tells nothing, not even of open sky.
    pub(crate) fn has_returns(points: &[[f32; 3]]) -> bool {
        points.iter().any(|&point| angles(point).is_some())
    }

    /// Find the rays that returned nothing.
    pub(crate) fn find_missing(&self, points: &[[f32; 3]], missing: &mut Missing) {
        let Missing { hit, directions } = missing;
        hit.clear();
        hit.resize(self.elevations.len() * self.columns, false);
        for (elevation, azimuth) in points.iter().filter_map(|&point| angles(point)) {
            if let Some(row) = self.row_of(elevation) {
                let column = (azimuth / TAU * self.columns as f64) as usize % self.columns;
                hit[row * self.columns + column] = true;
            }
        }
        directions.clear();
        for (row, &elevation) in self.elevations.iter().enumerate() {
            let (rise, run) = (libm::sin(elevation), libm::cos(elevation));
            for column in (0..self.columns).filter(|column| !self.near_hit(hit, row, *column)) {
                let azimuth = (column as f64 + 0.5) / self.columns as f64 * TAU;
                let (sine, cosine) = (libm::sin(azimuth), libm::cos(azimuth));
                directions.push([(run * cosine) as f32, (run * sine) as f32, rise as f32]);
            }
        }
    }

    /// A cell counts as hit if it or a neighbour in its row is: firing times jitter by up to a cell.
    fn near_hit(&self, hit: &[bool], row: usize, column: usize) -> bool {
        let row = &hit[row * self.columns..(row + 1) * self.columns];
        row[column]
            || row[(column + 1) % self.columns]
            || row[(column + self.columns - 1) % self.columns]
    }

    fn row_of(&self, elevation: f64) -> Option<usize> {
        let above = self.elevations.partition_point(|&row| row < elevation);
        let nearest = [above.checked_sub(1), (above < self.elevations.len()).then_some(above)]
            .into_iter()
            .flatten()
            .min_by(|&a, &b| {
                let gap = |row: usize| (self.elevations[row] - elevation).abs();
                gap(a).total_cmp(&gap(b))
            })?;
        ((self.elevations[nearest] - elevation).abs() <= MAX_HALF_STEP).then_some(nearest)
    }
}

/// Centres of runs of bins with at least `enough` points: local maxima, in ascending order.
fn peaks(histogram: &[u32], enough: u32) -> impl Iterator<Item = f64> {
    let at = |bin: usize| histogram.get(bin).copied().unwrap_or(0);
    (1..histogram.len())
        .filter(move |&bin| at(bin) >= enough && at(bin) > at(bin - 1) && at(bin) >= at(bin + 1))
        .map(move |bin| {
            let (low, middle, high) = (at(bin - 1), at(bin), at(bin + 1));
            let sum = f64::from(low) + f64::from(middle) + f64::from(high);
            let shift = (f64::from(high) - f64::from(low)) / sum;
            (bin as f64 + 0.5 + shift) * BIN - PI / 2.0
        })
}

/// Elevation and azimuth (0..2 pi) of a point [rad]; None without direction.
fn angles(point: [f32; 3]) -> Option<(f64, f64)> {
    let point = wide(point);
    let range = norm(point);
    if !(range.is_finite() && range > 0.0) {
        return None;
    }
    let azimuth = libm::atan2(point[1], point[0]).rem_euclid(TAU);
    Some((libm::asin((point[2] / range).clamp(-1.0, 1.0)), azimuth))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(elevation: f64, columns: usize) -> Vec<[f32; 3]> {
        (0..columns)
            .map(|column| {
                let azimuth = (column as f64 + 0.5) / columns as f64 * TAU;
                let run = libm::cos(elevation);
                [
                    (9.0 * run * libm::cos(azimuth)) as f32,
                    (9.0 * run * libm::sin(azimuth)) as f32,
                    (9.0 * libm::sin(elevation)) as f32,
                ]
            })
            .collect()
    }

    #[test]
    fn the_gap_in_a_row_is_what_is_missing() {
        let table = BeamTable::Rows { elevations: vec![-0.1, 0.2], columns: 360 };
        let mut points = ring(-0.1, 360);
        points.extend(&ring(0.2, 360)[..180]);
        let mut missing = Missing::default();
        Rebuilder::new(&table).find_missing(&points, &mut missing);
        assert_eq!(missing.directions.len(), 178); // the two at the border of the gap are left out
        assert!(
            missing.directions.iter().all(|direction| direction[1] < 0.0 && direction[2] > 0.19)
        );
    }

    #[test]
    fn rows_are_learnt_to_a_fraction_of_a_bin() {
        let mut rebuilder = Rebuilder::new(&BeamTable::Learnt { columns: 360 });
        assert!(!rebuilder.is_ready());
        for elevation in [-0.2, 0.0, 0.15] {
            rebuilder.learn(&ring(elevation, 360));
        }
        assert_eq!(rebuilder.elevations.len(), 3);
        for (learnt, truth) in rebuilder.elevations.iter().zip([-0.2, 0.0, 0.15]) {
            assert!((learnt - truth).abs() < BIN);
        }
        let mut missing = Missing::default();
        for _ in 0..2 {
            rebuilder.find_missing(&ring(0.0, 360), &mut missing);
            assert_eq!(missing.directions.len(), 720);
        }
    }
}
