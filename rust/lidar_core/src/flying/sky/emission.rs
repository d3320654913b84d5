//! Ray pattern of a sensor: rays per solid angle and scan, by direction in the sensor's frame.
//!
//! Directions without any return may lie outside the field of view, but sensors are symmetric: one that
//! turns casts as many rays at every azimuth, and one with a fixed field of view as many on the left
//! as on the right, above as below. So the part of the field of view that returns tells of the rest.

use super::grid::{BANDS, CELLS, GRID, SECTORS, band_of, limits_of};
use crate::geometry::transform::norm;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// A sensor with returns in more sectors than this turns: 210 degrees, more than any fixed one sees.
const TURNING_SECTORS: usize = 21;
/// The density at an elevation is that of the sector with this rank: the fullest ones may hold the
/// end and the beginning of a turn.
const RANK: usize = 3;
/// Directions inside a fixed field of view that never returned get this share of those that did.
const TYPICAL: f64 = 0.25;

/// Fewer of the rays do not end on droplets in air that is full of them.
const LEAST_DROPS: f64 = 0.02;

/// Known ray pattern of a sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum RayPattern {
    /// Rows that turn.
    Rows {
        /// Elevations [rad], ascending.
        elevations: Vec<f64>,
        /// Rays per turn of each row.
        columns: usize,
    },
    /// A field of view that is filled by and by, without rows.
    FieldOfView {
        /// Lowest and highest elevation [rad].
        elevation: [f64; 2],
        /// Largest azimuth to either side [rad]; pi for a sensor that turns.
        azimuth: f64,
        /// Rays per scan.
        rays: usize,
    },
}

/// Counts of returns by direction, and what follows from them.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Emission {
    /// Returns per cell in all scans, and those of droplets among them.
    counts: Vec<u64>,
    drops: Vec<u64>,
    scans: u32,
    /// Sine of the elevation of the lowest return.
    lowest: f64,
    density: Density,
    /// The density is known and not learnt.
    is_known: bool,
}

/// Rays per steradian and scan.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
enum Density {
    /// Nothing is known yet.
    #[default]
    Unknown,
    /// Density by band of elevation, for turning sensors.
    Turning(Vec<f64>),
    /// Density by cell, for sensors with a fixed field of view.
    Fixed(Vec<f64>),
}

impl Emission {
    /// Emission of a known sensor, or one to be learnt.
    pub(super) fn of(rays: Option<&RayPattern>) -> Self {
        Self {
            counts: vec![0; CELLS],
            drops: vec![0; CELLS],
            density: rays.map_or(Density::Unknown, Density::of),
            is_known: rays.is_some(),
            scans: 0,
            lowest: rays.map_or(f64::INFINITY, RayPattern::lowest),
        }
    }

    /// True if its parts have their lengths.
    pub(super) fn is_whole(&self) -> bool {
        self.counts.len() == CELLS
            && self.drops.len() == CELLS
            && match &self.density {
                Density::Unknown => true,
                Density::Turning(bands) => bands.len() == BANDS,
                Density::Fixed(cells) => cells.len() == CELLS,
            }
    }

    /// Add the returns of a scan, per cell, those of droplets among them, and the sine of the elevation
    /// of the lowest one.
    pub(super) fn learn(&mut self, [returns, drops]: [&[u32]; 2], lowest: f64) {
        if self.is_known {
            return;
        }
        self.lowest = self.lowest.min(lowest);
        for (sums, counts) in [(&mut self.counts, returns), (&mut self.drops, drops)] {
            for (sum, &count) in sums.iter_mut().zip(counts) {
                *sum += u64::from(count);
            }
        }
        self.scans = self.scans.saturating_add(1);
        self.density = match self.share_of_drops() {
            Some(share) => Density::learnt(&self.rays(share), self.scans),
            None => Density::learnt(&self.counts, self.scans),
        };
    }

    /// Share of the rays that end on droplets, seen where surfaces return the others; none in clear
    /// air.
    fn share_of_drops(&self) -> Option<f64> {
        let cells = || self.counts.iter().zip(&self.drops);
        if cells().all(|(_, &drops)| drops == 0) {
            return None;
        }
        let surfaces = cells().filter(|&(&all, &drops)| 2 * drops < all);
        let (all, drops) =
            surfaces.fold((0, 0), |sum, (&all, &drops)| (sum.0 + all, sum.1 + drops));
        Some((drops as f64 / (all.max(1)) as f64).max(LEAST_DROPS))
    }

    /// Rays per cell in all scans. Fog is the same everywhere: where nothing but droplets return, there
    /// are as many rays to every droplet as elsewhere.
    fn rays(&self, share: f64) -> Vec<u64> {
        let rays = |(&all, &drops): (&u64, &u64)| all.max((drops as f64 / share) as u64);
        self.counts.iter().zip(&self.drops).map(rays).collect()
    }

    /// Rays per steradian and scan towards a unit direction in the sensor's frame.
    pub(super) fn towards(&self, direction: [f64; 3]) -> f64 {
        match &self.density {
            Density::Unknown => 0.0,
            Density::Turning(bands) => bands[band_of(direction[2])],
            Density::Fixed(cells) => cells[GRID.cell(direction)],
        }
    }
}

impl Emission {
    /// Whether rays may go in a unit direction in the sensor's frame, as far as that is known more
    /// sharply than by cell: those of a sensor that turns are not below its lowest return. What stands
    /// at the lower edge of its field of view would else seem to be in the air.
    pub(super) fn reaches(&self, direction: [f64; 3]) -> bool {
        !matches!(self.density, Density::Turning(_)) || direction[2] >= self.lowest
    }
}

impl RayPattern {
    /// Sine of the lowest elevation.
    fn lowest(&self) -> f64 {
        let lowest = match self {
            Self::Rows { elevations, .. } => elevations.first().copied(),
            Self::FieldOfView { elevation, .. } => Some(elevation[0]),
        };
        lowest.map_or(-1.0, libm::sin)
    }
}

impl Density {
    fn of(rays: &RayPattern) -> Self {
        match rays {
            RayPattern::Rows { elevations, columns } => Self::Turning(
                (0..BANDS)
                    .map(|band| {
                        let [low, high] = limits_of(band);
                        let rows = elevations.iter().filter(|&&row| low <= row && row < high);
                        (rows.count() * columns) as f64 / zone(low, high, PI)
                    })
                    .collect(),
            ),
            RayPattern::FieldOfView { elevation: [low, high], azimuth, rays } => {
                let density = *rays as f64 / zone(*low, *high, *azimuth);
                let (bottom, top) = (libm::sin(*low), libm::sin(*high));
                let is_seen = |cell: usize| {
                    (bottom..=top).contains(&GRID.centers[cell][2])
                        && GRID.azimuths[cell].abs() <= *azimuth
                };
                Self::Fixed(
                    (0..CELLS).map(|cell| if is_seen(cell) { density } else { 0.0 }).collect(),
                )
            }
        }
    }

    fn learnt(counts: &[u64], scans: u32) -> Self {
        let mut sums = vec![[(0.0, 0.0); SECTORS]; BANDS];
        for (cell, &count) in counts.iter().enumerate() {
            let (band, sector) = GRID.bands[cell];
            let (returns, solid_angle) = &mut sums[usize::from(band)][usize::from(sector)];
            *returns += count as f64;
            *solid_angle += GRID.solid_angles[cell];
        }
        let seen = |sector: &usize| sums.iter().any(|band| band[*sector].0 > 0.0);
        if (0..SECTORS).filter(seen).count() >= TURNING_SECTORS {
            return Self::Turning(sums.iter().map(|band| of_band(band, scans)).collect());
        }
        Self::Fixed(of_mirrored_cells(counts, scans))
    }
}

/// Solid angle of a zone [sr], to both sides of azimuth 0.
fn zone(low: f64, high: f64, azimuth: f64) -> f64 {
    2.0 * azimuth * (libm::sin(high) - libm::sin(low))
}

/// The density of a band, whose sectors hold returns and solid angles.
fn of_band(sectors: &[(f64, f64); SECTORS], scans: u32) -> f64 {
    let seen = sectors.iter().filter(|(_, solid_angle)| *solid_angle > 0.0);
    let mut densities: Vec<f64> =
        seen.map(|(returns, solid_angle)| returns / solid_angle / f64::from(scans)).collect();
    densities.sort_unstable_by(|a, b| b.total_cmp(a));
    densities.get(RANK).or(densities.last()).copied().unwrap_or(0.0)
}

/// Densities of the cells of a fixed field of view: the largest of the four that mirror each other,
/// and something between the outermost of every band.
fn of_mirrored_cells(counts: &[u64], scans: u32) -> Vec<f64> {
    let density = |cell: usize| counts[cell] as f64 / GRID.solid_angles[cell] / f64::from(scans);
    let mirrored = |cell: usize| {
        let [x, y, z] = GRID.centers[cell];
        let twins = [[x, y, z], [x, -y, z], [x, y, -z], [x, -y, -z]];
        twins.map(|twin| density(GRID.cell(twin))).into_iter().fold(0.0, f64::max)
    };
    let mut cells: Vec<f64> = (0..CELLS).map(mirrored).collect();
    let mut seen: Vec<f64> = cells.iter().copied().filter(|&density| density > 0.0).collect();
    seen.sort_unstable_by(f64::total_cmp);
    let typical = seen.get((TYPICAL * seen.len() as f64) as usize).copied().unwrap_or(0.0);
    let mut widths = [-1.0f64; BANDS];
    for (cell, _) in cells.iter().enumerate().filter(|(_, density)| **density > 0.0) {
        let width = &mut widths[usize::from(GRID.bands[cell].0)];
        *width = width.max(GRID.azimuths[cell].abs());
    }
    for (cell, density) in cells.iter_mut().enumerate().filter(|(_, density)| **density == 0.0) {
        if GRID.azimuths[cell].abs() < widths[usize::from(GRID.bands[cell].0)] {
            *density = typical;
        }
    }
    cells
}

/// Elevations of the returns of a scan, to test whether a known ray pattern fits.
#[derive(Clone, Debug, Default)]
pub(super) struct Elevations {
    /// Elevation of the returns that are far enough to be sharp [rad].
    values: Vec<f64>,
    azimuths: Vec<f64>,
    /// Largest distance of every return from its row [rad].
    reaches: Vec<f64>,
}

/// Nearer returns are smeared by the way of the sensor during a scan [m].
const SHARP_RANGE: f64 = 3.0;
/// Fewer returns tell nothing.
const ENOUGH_RETURNS: usize = 500;
/// Returns beyond the field of view by this much contradict it [rad]: 2 degrees.
const BEYOND: f64 = 2.0 * PI / 180.0;
/// Returns that may lie beyond it: reflections, rows that the motion of the sensor moves.
const STRAY_SHARE: f64 = 0.05;
/// Returns this far from every row contradict the rows [rad]: 0.3 degrees.
const OFF_ROW: f64 = 0.3 * PI / 180.0;
/// Height by which beams may begin above or below the origin of the points [m]: 0.04 m in an Ouster.
const BEAM_ORIGIN: f64 = 0.05;
/// Rows nearer than this to each other cannot be told from returns between them [rad].
const LEAST_GAP: f64 = 0.8 * PI / 180.0;
/// Shares of returns off the rows that contradict these: where returns show rows, and where they show
/// none, and all lie in a part of the turn, as those of sensors that do not turn. Recordings of Velodyne
/// and Hesai sensors have none off their own rows, and 0.32 or more off the rows of another one.
const OFF_SHARE: f64 = 0.25;
const OFF_SHARE_WITHOUT_ROWS: f64 = 0.5;
/// Largest part of the turn that a sensor which does not turn is taken to see [rad].
const PART_OF_TURN: f64 = PI;
/// Share of the rows between those that return something, below which they are of another sensor, and
/// the least number of gaps between them: sky between the ground and what is above it is one gap. A few
/// returns far above or below the others do not count.
const USED_SHARE: f64 = 0.6;
const FEWEST_GAPS: usize = 4;
const OUTER_SHARE: f64 = 0.05;
/// Width of a bin in which rows show [rad]: 0.1 degrees.
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

    /// True if there are enough returns to recognise a sensor.
    pub(super) fn tell_enough(&self) -> bool {
        self.values.len() >= ENOUGH_RETURNS
    }

    /// True if the returns show rows: nine of ten lie in a fifth of the bins between the lowest and
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

    /// Share of the returns that `rays` cannot have given; None if there are too few returns.
    pub(super) fn against(&self, rays: &RayPattern) -> Option<f64> {
        if self.values.len() < ENOUGH_RETURNS {
            return None;
        }
        let strays = (0..self.values.len()).filter(|&index| self.is_stray(index, rays)).count();
        Some(strays as f64 / self.values.len() as f64)
    }

    /// True if `rays` cannot have given the scan; false if it has too few returns to decide.
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

    /// Share of the returns between the rows; 0 for rows too near to each other to tell.
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

    /// True if many rows return nothing between those that do.
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

    /// True if all returns lie in one part of the turn: the largest gap between their azimuths is the
    /// rest of it.
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
    use super::super::grid::part_of;
    use super::*;

    fn counts(is_seen: impl Fn([f64; 3]) -> bool) -> Vec<u32> {
        (0..CELLS).map(|cell| if is_seen(part_of(cell, [0.5; 2])) { 20 } else { 0 }).collect()
    }

    #[test]
    fn a_sensor_that_turns_looks_everywhere_at_the_elevations_that_it_returns_from() {
        let mut emission = Emission::of(None);
        // Sky over a third of the turn, nothing above 30 degrees anywhere.
        let seen = counts(|d| (-0.2..0.5).contains(&d[2]) && (d[1] < 0.0 || d[0] < 0.0));
        (0..3).for_each(|_| emission.learn([&seen, &vec![0; CELLS]], -0.19));
        let expected = 20.0 / GRID.solid_angles[GRID.cell([1.0, 1.0, 0.1])];
        assert!((emission.towards([0.7, 0.7, 0.1]) / expected - 1.0).abs() < 0.2);
        assert_eq!(emission.towards([0.6, 0.0, 0.8]), 0.0);
        // The lowest return is in the middle of a cell: nothing is cast below it, on any side.
        assert!(emission.reaches([0.7, 0.7, -0.18]) && !emission.reaches([0.7, 0.7, -0.2]));
        emission.learn([&seen, &vec![0; CELLS]], -0.3);
        assert!(emission.reaches([0.7, 0.7, -0.2]), "a lower one was seen since");
    }

    #[test]
    fn a_fixed_field_of_view_is_symmetric_and_has_no_holes() {
        let mut emission = Emission::of(None);
        let seen = counts(|d| d[0] > 0.8 && d[2] < -0.1 && d[2] > -0.4 && d[1].abs() > 0.1);
        (0..3).for_each(|_| emission.learn([&seen, &vec![0; CELLS]], -0.19));
        for direction in [[0.93, 0.2, 0.3], [0.93, -0.2, 0.3], [0.95, 0.0, -0.3]] {
            assert!(emission.towards(direction) > 0.0, "{direction:?}");
        }
        assert_eq!(emission.towards([-1.0, 0.0, 0.0]), 0.0);
        assert_eq!(emission.towards([0.5, 0.0, 0.86]), 0.0);
        assert!(emission.reaches([0.9, 0.0, -0.4]), "its lower half may be hidden");
    }

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
