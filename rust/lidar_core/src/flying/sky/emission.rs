//! Ray pattern of a sensor: number of rays per solid angle and scan, by direction in the frame of
//! the sensor.
//!
//! Directions without any return may be outside the field of view. But sensors are symmetric: one
//! that turns casts equally many rays at every azimuth, and one with a fixed field of view equally
//! many to the left and right, and up and down. So the part of the field of view with returns shows
//! the rest.

use super::grid::{BANDS, CELLS, GRID, SECTORS, band_of, limits_of};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// A sensor with returns in more sectors than this turns: 210 degrees, more than any fixed sensor
/// sees.
const TURNING_SECTORS: usize = 21;
/// Rank of the sector whose density counts at an elevation. The fullest sectors may contain both
/// the end and the beginning of a turn.
const RANK: usize = 3;
/// Directions without any return, inside a fixed field of view, get the density of this quantile of the
/// directions with returns.
const TYPICAL: f64 = 0.25;

/// Smallest share of rays that end on droplets in air that is full of them.
const LEAST_DROPS: f64 = 0.02;

/// Known ray pattern of a sensor, in the frame of the sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum RayPattern {
    /// Rows of a sensor that turns.
    Rows {
        /// Elevations [rad], ascending.
        elevations: Vec<f64>,
        /// Number of rays per turn in each row.
        columns: usize,
    },
    /// A sensor without rows: its scan pattern does not repeat, and fills the field of view over
    /// time.
    FieldOfView {
        /// Lowest and highest elevation [rad].
        elevation: [f64; 2],
        /// Largest azimuth to either side [rad]; pi for a sensor that turns.
        azimuth: f64,
        /// Number of rays per scan.
        rays: usize,
    },
}

/// Counts of returns by direction, and the ray density that follows from them.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Emission {
    /// Number of returns per cell in all scans; `drops`: number of droplets among them.
    counts: Vec<u64>,
    drops: Vec<u64>,
    scans: u32,
    /// Sine of the elevation of the lowest return, or of the lowest known ray.
    lowest: f64,
    density: Density,
    /// Whether the density is known, so that it is not learnt.
    is_known: bool,
}

/// Number of rays per steradian and scan, in the frame of the sensor.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
enum Density {
    /// Nothing is known yet.
    #[default]
    Unknown,
    /// Density by band of elevation, for sensors that turn.
    Turning(Vec<f64>),
    /// Density by cell, for sensors with a fixed field of view.
    Fixed(Vec<f64>),
}

impl Emission {
    /// Ray pattern of a known sensor, or one to be learnt (None).
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

    /// True if all lists have the right lengths. Checks a saved state.
    pub(super) fn is_whole(&self) -> bool {
        self.counts.len() == CELLS
            && self.drops.len() == CELLS
            && match &self.density {
                Density::Unknown => true,
                Density::Turning(bands) => bands.len() == BANDS,
                Density::Fixed(cells) => cells.len() == CELLS,
            }
    }

    /// Add a scan: returns per cell, droplets per cell among them, and the sine of the elevation of
    /// the lowest return.
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

    /// Share of the rays that end on droplets, from directions in which surfaces return the others.
    /// None in clear air.
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

    /// Number of rays per cell in all scans. Fog is the same everywhere, so where nothing but
    /// droplets return, there are as many rays for every droplet as elsewhere. `share`: share of
    /// the rays that end on droplets.
    fn rays(&self, share: f64) -> Vec<u64> {
        let rays = |(&all, &drops): (&u64, &u64)| all.max((drops as f64 / share) as u64);
        self.counts.iter().zip(&self.drops).map(rays).collect()
    }

    /// Number of rays per steradian and scan towards a unit vector in the frame of the sensor.
    pub(super) fn towards(&self, direction: [f64; 3]) -> f64 {
        match &self.density {
            Density::Unknown => 0.0,
            Density::Turning(bands) => bands[band_of(direction[2])],
            Density::Fixed(cells) => cells[GRID.cell(direction)],
        }
    }
}

impl Emission {
    /// Whether rays may go towards a unit vector in the frame of the sensor, more precisely than by
    /// cell: a sensor that turns has no rays below its lowest return. Otherwise things at the lower
    /// edge of its field of view would seem to be in the air.
    pub(super) fn reaches(&self, direction: [f64; 3]) -> bool {
        !matches!(self.density, Density::Turning(_)) || direction[2] >= self.lowest
    }
}

impl RayPattern {
    /// Sine of the lowest elevation of the rays.
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

/// Solid angle between two elevations, up to an azimuth to both sides of azimuth 0 [sr].
fn zone(low: f64, high: f64, azimuth: f64) -> f64 {
    2.0 * azimuth * (libm::sin(high) - libm::sin(low))
}

/// Density of a band. `sectors`: number of returns and solid angle [sr] of each sector.
fn of_band(sectors: &[(f64, f64); SECTORS], scans: u32) -> f64 {
    let seen = sectors.iter().filter(|(_, solid_angle)| *solid_angle > 0.0);
    let mut densities: Vec<f64> =
        seen.map(|(returns, solid_angle)| returns / solid_angle / f64::from(scans)).collect();
    densities.sort_unstable_by(|a, b| b.total_cmp(a));
    densities.get(RANK).or(densities.last()).copied().unwrap_or(0.0)
}

/// Densities of the cells of a fixed field of view: the largest of the four cells that mirror each
/// other. Cells without returns between the outermost ones of a band get a low typical density.
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
}
