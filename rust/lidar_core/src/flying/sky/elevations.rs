//! Elevations of the returns of a scan, to test whether a stated sensor can have given the scan.

use super::emission::RayPattern;
use crate::geometry::transform::norm;
use std::f64::consts::{PI, TAU};

/// Directions of the returns of a scan, to test whether a known ray pattern fits.
#[derive(Clone, Debug, Default)]
pub(super) struct Elevations {
    /// Elevations of the returns that are far enough away to be sharp [rad].
    values: Vec<f64>,
    azimuths: Vec<f64>,
    /// Largest possible distance of every return from its row [rad].
    reaches: Vec<f64>,
}

/// Smallest range of the returns that are used [m]. The motion of the sensor during a scan changes
/// the directions of nearer returns.
const SHARP_RANGE: f64 = 3.0;
/// Smallest number of returns for a test.
const ENOUGH_RETURNS: usize = 500;
/// Angle beyond the field of view from which on returns contradict a sensor [rad]: 2 degrees.
const BEYOND: f64 = 2.0 * PI / 180.0;
/// Share of the returns that may be beyond the field of view: reflections, or rows that the motion
/// of the sensor moves.
const STRAY_SHARE: f64 = 0.05;
/// Distance from every row from which on a return contradicts the rows [rad]: 0.3 degrees.
const OFF_ROW: f64 = 0.3 * PI / 180.0;
/// Largest height by which beams may begin above or below the origin of the points [m]. It is 0.04
/// m in an Ouster.
const BEAM_ORIGIN: f64 = 0.05;
/// Smallest median distance of rows that can be tested [rad]. Between closer rows no return is off
/// the rows.
const LEAST_GAP: f64 = 0.8 * PI / 180.0;
/// Share of returns off the rows that contradicts them, if the returns show rows;
/// `OFF_SHARE_WITHOUT_ROWS`: if they show none and all are in a part of the turn, as with sensors
/// that do not turn. Recordings of Velodyne and Hesai sensors have none off their own rows, and
/// 0.32 or more off the rows of another one.
const OFF_SHARE: f64 = 0.25;
/// Share of returns off the rows that contradicts these, if the returns show no rows.
const OFF_SHARE_WITHOUT_ROWS: f64 = 0.5;
/// Largest angle of azimuth that a sensor which does not turn is assumed to see [rad].
const PART_OF_TURN: f64 = PI;
/// Share of used rows, between the lowest and highest with returns, below which the rows are of
/// another sensor; `FEWEST_GAPS`: smallest number of gaps between used rows. Sky between the ground
/// and something above it is one gap. `OUTER_SHARE`: share of the lowest and of the highest returns
/// that is ignored.
const USED_SHARE: f64 = 0.6;
/// Smallest number of gaps between used rows that contradicts the rows.
const FEWEST_GAPS: usize = 4;
/// Share of the lowest and of the highest returns that is ignored.
const OUTER_SHARE: f64 = 0.05;
/// Width of a bin of elevation in which rows show [rad]: 0.1 degrees.
const BIN: f64 = PI / 1800.0;

impl Elevations {
    pub(super) fn of(points: &[[f32; 3]]) -> Self {
        let mut all = Self::default();
        for point in points {
            let point = point.map(f64::from);
            let range = norm(point);
            if range.is_finite() && range > SHARP_RANGE {
                all.values.push(libm::asin((point[2] / range).clamp(-1.0, 1.0)));
                all.azimuths.push(libm::atan2(point[1], point[0]));
                all.reaches.push(OFF_ROW.max(BEAM_ORIGIN / range));
            }
        }
        all
    }

    /// True if there are enough returns to test a sensor.
    pub(super) fn tell_enough(&self) -> bool {
        self.values.len() >= ENOUGH_RETURNS
    }

    /// True if the returns show rows: nine of ten are in a fifth of the bins between the lowest and
    /// the highest.
    pub(super) fn are_rows(&self) -> bool {
        let mut bins = vec![0usize; (PI / BIN) as usize + 2];
        for value in &self.values {
            bins[((value + PI / 2.0) / BIN) as usize] += 1;
        }
        let used = |index: &usize| bins[*index] > 0;
        let (Some(first), Some(last)) =
            ((0..bins.len()).find(used), (0..bins.len()).rev().find(used))
        else {
            return false;
        };
        let fullest = (last - first + 1) / 5;
        bins.sort_unstable_by(|a, b| b.cmp(a));
        let held: usize = bins.iter().take(fullest).sum();
        self.values.len() >= ENOUGH_RETURNS && 10 * held >= 9 * self.values.len()
    }

    /// Share of the returns that are outside the field of view of `rays`. None if there are too few
    /// returns.
    pub(super) fn against(&self, rays: &RayPattern) -> Option<f64> {
        if self.values.len() < ENOUGH_RETURNS {
            return None;
        }
        let strays = (0..self.values.len()).filter(|&index| self.is_stray(index, rays)).count();
        Some(strays as f64 / self.values.len() as f64)
    }

    /// True if `rays` cannot have given the scan. False also if it has too few returns to decide.
    pub(super) fn contradict(&self, rays: &RayPattern) -> bool {
        let Some(share) = self.against(rays) else { return false };
        let RayPattern::Rows { elevations, .. } = rays else { return share > STRAY_SHARE };
        let off = self.off_rows(elevations);
        share > STRAY_SHARE
            || if self.are_rows() {
                off > OFF_SHARE || self.skip_rows(elevations)
            } else {
                // The motion of a sensor that turns smears its rows: it is told by what it sees.
                off > OFF_SHARE_WITHOUT_ROWS && self.lie_in_a_part()
            }
    }

    fn is_stray(&self, index: usize, rays: &RayPattern) -> bool {
        let ([low, high], azimuth) = match rays {
            RayPattern::Rows { elevations, .. } => {
                let first = elevations.first().copied().unwrap_or(-PI);
                ([first, elevations.last().copied().unwrap_or(PI)], TAU)
            }
            RayPattern::FieldOfView { elevation, azimuth, .. } => (*elevation, *azimuth),
        };
        let value = self.values[index];
        value < low - BEYOND
            || value > high + BEYOND
            || self.azimuths[index].abs() > azimuth + BEYOND
    }

    /// Share of the returns between the rows. 0 if the rows are too close to each other for this
    /// test.
    fn off_rows(&self, rows: &[f64]) -> f64 {
        let mut gaps: Vec<f64> = rows.windows(2).map(|pair| pair[1] - pair[0]).collect();
        gaps.sort_unstable_by(f64::total_cmp);
        if gaps.get(gaps.len() / 2).is_none_or(|&middle| middle < LEAST_GAP) {
            return 0.0;
        }
        let is_off = |&(value, reach): &(&f64, &f64)| {
            let above = rows.partition_point(|row| row < value);
            let near = |row: Option<&f64>| row.is_some_and(|row| (row - value).abs() <= *reach);
            !near(rows.get(above)) && !near(above.checked_sub(1).and_then(|at| rows.get(at)))
        };
        let off = self.values.iter().zip(&self.reaches).filter(is_off).count();
        off as f64 / self.values.len() as f64
    }

    /// True if many rows between the lowest and the highest with returns have none.
    fn skip_rows(&self, rows: &[f64]) -> bool {
        let mut returns: Vec<(f64, f64)> =
            self.values.iter().copied().zip(self.reaches.iter().copied()).collect();
        returns.sort_unstable_by(|one, other| one.0.total_cmp(&other.0));
        let outer = (OUTER_SHARE * returns.len() as f64) as usize;
        let returns = &returns[outer..returns.len() - outer];
        let widest = OFF_ROW.max(BEAM_ORIGIN / SHARP_RANGE);
        let is_used = |row: &f64| {
            let first = returns.partition_point(|(value, _)| *value < row - widest);
            let near = returns[first..].iter().take_while(|(value, _)| *value <= row + widest);
            near.into_iter().any(|(value, reach)| (value - row).abs() <= *reach)
        };
        let used: Vec<bool> = rows.iter().map(is_used).collect();
        let ends = used.iter().position(|&used| used).zip(used.iter().rposition(|&used| used));
        let Some((first, last)) = ends else { return true };
        let between = &used[first..=last];
        let count = between.iter().filter(|&&used| used).count();
        let gaps = between.windows(2).filter(|pair| pair[0] && !pair[1]).count();
        gaps >= FEWEST_GAPS && (count as f64) < USED_SHARE * between.len() as f64
    }

    /// True if all returns are in one part of the turn, at most [`PART_OF_TURN`] wide.
    fn lie_in_a_part(&self) -> bool {
        let mut azimuths = self.azimuths.clone();
        azimuths.sort_unstable_by(f64::total_cmp);
        let around =
            azimuths.last().zip(azimuths.first()).map_or(0.0, |(last, first)| TAU - (last - first));
        let gap = azimuths.windows(2).map(|pair| pair[1] - pair[0]).fold(around, f64::max);
        TAU - gap <= PART_OF_TURN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_another_sensor_are_contradicted() {
        let row = |elevation: f64| {
            (0..200).map(move |step| {
                let azimuth = f64::from(step) / 200.0 * TAU;
                let run = 9.0 * libm::cos(elevation);
                [run * libm::cos(azimuth), run * libm::sin(azimuth), 9.0 * libm::sin(elevation)]
                    .map(|value| value as f32)
            })
        };
        let degrees =
            |rows: Vec<f64>| rows.iter().map(|row| row * PI / 180.0).collect::<Vec<f64>>();
        let vlp16 = degrees((0..16).map(|row| 2.0 * f64::from(row) - 15.0).collect());
        let hdl32 = degrees((0..32).map(|row| 4.0 / 3.0 * f64::from(row) - 30.67).collect());
        let points: Vec<[f32; 3]> = vlp16.iter().flat_map(|&elevation| row(elevation)).collect();
        let seen = Elevations::of(&points);
        assert!(seen.are_rows());
        assert!(!seen.contradict(&RayPattern::Rows { elevations: vlp16, columns: 1800 }));
        assert!(seen.contradict(&RayPattern::Rows { elevations: hdl32.clone(), columns: 2170 }));
        let xt32 = degrees((0..32).map(|row| f64::from(row) - 16.0).collect()); // every other row
        assert!(seen.contradict(&RayPattern::Rows { elevations: xt32, columns: 2000 }));
        let points: Vec<[f32; 3]> = hdl32.iter().flat_map(|&elevation| row(elevation)).collect();
        let seen = Elevations::of(&points);
        let mid360 = RayPattern::FieldOfView {
            elevation: [-7.0 * PI / 180.0, 52.0 * PI / 180.0],
            azimuth: PI,
            rays: 20_000,
        };
        assert!(seen.contradict(&mid360));
        assert!(!Elevations::of(&points[..100]).contradict(&mid360)); // too few to tell
        // Rows that are too near to each other to be missed are missed in number.
        let os1 = degrees((0..128).map(|row| 0.35 * f64::from(row) - 22.5).collect());
        assert!(seen.contradict(&RayPattern::Rows { elevations: os1.clone(), columns: 1024 }));
        let points: Vec<[f32; 3]> = os1.iter().flat_map(|&elevation| row(elevation)).collect();
        let seen = Elevations::of(&points);
        assert!(!seen.contradict(&RayPattern::Rows { elevations: os1, columns: 1024 }));
    }

    #[test]
    fn sky_between_the_ground_and_a_drone_is_no_other_sensor() {
        let degrees =
            |rows: Vec<f64>| rows.iter().map(|row| row * PI / 180.0).collect::<Vec<f64>>();
        let vlp16 = degrees((0..16).map(|row| 2.0 * f64::from(row) - 15.0).collect());
        let os1 = degrees((0..128).map(|row| 0.35 * f64::from(row) - 22.5).collect());
        for (rows, columns, height) in [(vlp16, 1800, 1.5), (os1, 1024, 1.5)] {
            let ground = rows.iter().filter(|row| **row < -0.03);
            let below = ground.flat_map(|row| {
                let (run, step) = (height / libm::tan(-row), TAU / 400.0);
                (0..400).map(move |ray| {
                    let azimuth = step * f64::from(ray);
                    [run * libm::cos(azimuth), run * libm::sin(azimuth), -height]
                })
            });
            let last = rows[rows.len() - 1];
            let drone = (0..6).map(|ray| {
                let azimuth = 0.002 * f64::from(ray);
                let run = 25.0 * libm::cos(last);
                [run * libm::cos(azimuth), run * libm::sin(azimuth), 25.0 * libm::sin(last)]
            });
            let points: Vec<[f32; 3]> =
                below.chain(drone).map(|point| point.map(|value| value as f32)).collect();
            let seen = Elevations::of(&points);
            assert!(seen.are_rows() || rows.len() > 16);
            assert!(!seen.contradict(&RayPattern::Rows { elevations: rows, columns }));
        }
    }

    #[test]
    fn beams_that_begin_above_the_origin_lie_on_their_rows() {
        // 32 rows 1.45 degrees apart in a room of 7 m, 0.038 m above the origin of the points.
        let rows: Vec<f64> =
            (0..32).map(|row| (1.45 * f64::from(row) - 22.5) * PI / 180.0).collect();
        let points: Vec<[f32; 3]> = rows
            .iter()
            .flat_map(|&row| {
                (0..300).map(move |ray| {
                    let azimuth = TAU * f64::from(ray) / 300.0;
                    let run = 3.5 / libm::cos(azimuth).abs().max(libm::sin(azimuth).abs());
                    let height = run * libm::tan(row) + 0.038;
                    [run * libm::cos(azimuth), run * libm::sin(azimuth), height]
                        .map(|value| value as f32)
                })
            })
            .collect();
        let seen = Elevations::of(&points);
        assert!(!seen.contradict(&RayPattern::Rows { elevations: rows, columns: 1024 }));
    }

    #[test]
    fn a_part_of_the_turn_without_rows_is_of_no_sensor_with_wide_rows() {
        let vlp16: Vec<f64> =
            (0..16).map(|row| (2.0 * f64::from(row) - 15.0) * PI / 180.0).collect();
        let rows = RayPattern::Rows { elevations: vlp16, columns: 1800 };
        let rosette = |width: f64| -> Vec<[f32; 3]> {
            (0..4000)
                .map(|ray| {
                    let (azimuth, elevation) = (
                        width * (libm::fmod(0.618 * f64::from(ray), 1.0) - 0.5),
                        0.4 * (libm::fmod(0.755 * f64::from(ray), 1.0) - 0.5),
                    );
                    let run = 9.0 * libm::cos(elevation);
                    [run * libm::cos(azimuth), run * libm::sin(azimuth), 9.0 * libm::sin(elevation)]
                        .map(|value| value as f32)
                })
                .collect()
        };
        assert!(Elevations::of(&rosette(2.1)).contradict(&rows));
        // All around, it may be a sensor with rows that its own motion smeared.
        assert!(!Elevations::of(&rosette(TAU)).contradict(&rows));
    }
}
