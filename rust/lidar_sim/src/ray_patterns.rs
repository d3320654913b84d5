//! LiDAR models: ray patterns, firing times and range errors.

use crate::random::{self, Purpose};
use crate::refused;
use lidar_core::Error;
use lidar_core::util::budget;
use std::f64::consts::TAU;

/// Largest number of lines of a beam.
const MOST_LINES: usize = 64;

/// Turns, or swings, of a rosette in azimuth [Hz]. Ten times the golden ratio and a thousand times
/// the root of five (`SWING_RATE`) have no common measure with each other or with usual scan rates,
/// so the pattern does not repeat.
const TURN_RATE: f64 = 16.180_339_887;
/// Swings of a rosette in elevation [Hz].
const SWING_RATE: f64 = 2_236.067_977;

/// Ray directions of a scan and their firing times.
#[derive(Clone, Debug)]
pub enum Pattern {
    /// Rows of fixed elevation turn through equal steps of azimuth, counter-clockwise from above.
    /// Rays are ordered row by row; all rows of a column are fired together.
    Spinning {
        /// Elevation of every row [rad], top first.
        elevations: Vec<f64>,
        /// Steps of azimuth in one turn.
        columns: usize,
        /// Azimuth of the first column [rad].
        azimuth_start: f64,
        /// Turn of the whole pattern from one scan to the next [rad].
        azimuth_per_scan: f64,
    },
    /// Single rays along a rosette that does not repeat. The azimuth turns or swings to and fro,
    /// the elevation swings at an incommensurable rate.
    Rosette {
        /// Rays per scan.
        rays: usize,
        /// Lowest and highest elevation [rad].
        elevation: [f64; 2],
        /// Largest azimuth to either side of the x axis [rad]; None for whole turns.
        azimuth_half: Option<f64>,
    },
    /// Single rays in the plane z = 0: a 2D LiDAR.
    Planar {
        /// Rays per scan.
        rays: usize,
        /// Bearing of the first ray [rad].
        angle_min: f64,
        /// Bearing from one ray to the next [rad], < 0 for clockwise.
        angle_increment: f64,
        /// Time from one ray to the next [ns].
        time_increment_ns: i64,
    },
}

/// Width of the beam in azimuth: any surface within it may return.
#[derive(Clone, Copy, Debug)]
pub struct Beam {
    /// Half width to either side of the ray [rad].
    pub half_width: f64,
    /// Number of lines that represent the beam, evenly from edge to edge.
    pub lines: usize,
    /// Distance behind the first hit within which the range is the mean over the lines [m]: 0 for
    /// the first return, infinite for the mean of all hits.
    pub echo_length: f64,
}

/// Model of a LiDAR.
#[derive(Clone, Debug)]
pub struct Lidar {
    /// Ray pattern.
    pub pattern: Pattern,
    /// Duration of a scan [ns].
    pub period_ns: i64,
    /// True: all rays are fired at the start of the scan.
    pub snapshot: bool,
    /// Range below which surfaces give no information [m].
    pub range_min: f64,
    /// Range from which on surfaces give no return [m].
    pub range_max: f64,
    /// Standard deviation of the ranges [m].
    pub range_std: f64,
    /// Probability that a return is lost: the ray then has no information.
    pub dropout: f64,
    /// Width of the beam; None for single lines.
    pub beam: Option<Beam>,
}

/// Rays of one scan in the LiDAR's frame.
#[derive(Clone, Debug)]
pub struct SweepRays {
    /// Unit directions of the rays.
    pub directions: Vec<[f64; 3]>,
    /// Firing of every ray, as an index into `offsets_ns`.
    pub firings: Vec<u32>,
    /// Time of every firing after the start of the scan [ns].
    pub offsets_ns: Vec<i64>,
}

impl Lidar {
    /// Check the values of the sensor.
    ///
    /// # Errors
    /// [`Error::Parameter`] if a value is outside the range that its field states,
    /// [`Error::Limit`] if a scan has too many rays.
    pub fn check(&self) -> Result<(), Error> {
        budget::check_points(self.rays())?;
        if self.rays() == 0 {
            return Err(refused("pattern", "at least one ray", &0));
        }
        if self.period_ns <= 0 {
            return Err(refused("period_ns", "> 0", &self.period_ns));
        }
        if !(0.0 <= self.range_min && self.range_min < self.range_max) {
            let got = [self.range_min, self.range_max];
            return Err(refused("range", "0 <= range_min < range_max", &got));
        }
        if !(self.range_std.is_finite() && self.range_std >= 0.0) {
            return Err(refused("range_std", "finite and >= 0", &self.range_std));
        }
        if !(0.0..=1.0).contains(&self.dropout) {
            return Err(refused("dropout", "0 to 1", &self.dropout));
        }
        self.check_sweep()?;
        self.beam.as_ref().map_or(Ok(()), Beam::check)
    }

    /// Check that a planar scan ends before the next one begins, and turns once at most.
    fn check_sweep(&self) -> Result<(), Error> {
        let Pattern::Planar { rays, angle_min, angle_increment, time_increment_ns } = self.pattern
        else {
            return Ok(());
        };
        let angle = angle_increment * rays.saturating_sub(1) as f64;
        if !(angle_min.is_finite() && angle.abs() <= TAU + 1e-6) {
            let got = [angle_min, angle_increment];
            return Err(refused("angles", "finite, at most one turn in all", &got));
        }
        let last = i128::from(time_increment_ns) * rays as i128;
        if !(0..=i128::from(self.period_ns)).contains(&last) {
            return Err(refused("time_increment_ns", "rays within period_ns", &time_increment_ns));
        }
        Ok(())
    }

    /// Number of rays per scan.
    #[must_use]
    pub fn rays(&self) -> usize {
        match &self.pattern {
            Pattern::Spinning { elevations, columns, .. } => {
                elevations.len().saturating_mul(*columns)
            }
            Pattern::Rosette { rays, .. } | Pattern::Planar { rays, .. } => *rays,
        }
    }

    /// Rays of scan number `scan`.
    #[must_use]
    pub fn sweep(&self, scan: u64) -> SweepRays {
        match &self.pattern {
            Pattern::Spinning { elevations, columns, azimuth_start, azimuth_per_scan } => {
                let start = azimuth_start + azimuth_per_scan * scan as f64;
                self.spinning(elevations, *columns, start)
            }
            Pattern::Rosette { rays, elevation, azimuth_half } => {
                self.rosette(scan, *rays, *elevation, *azimuth_half)
            }
            Pattern::Planar { rays, angle_min, angle_increment, time_increment_ns } => {
                let step_ns = if self.snapshot { 0 } else { *time_increment_ns };
                planar(*rays, [*angle_min, *angle_increment], step_ns)
            }
        }
    }

    fn spinning(&self, elevations: &[f64], columns: usize, start: f64) -> SweepRays {
        let turns: Vec<[f64; 2]> = (0..columns)
            .map(|column| TAU * column as f64 / columns as f64 + start)
            .map(|azimuth| [libm::cos(azimuth), libm::sin(azimuth)])
            .collect();
        let mut directions = Vec::with_capacity(elevations.len() * columns);
        for &elevation in elevations {
            let (flat, up) = (libm::cos(elevation), libm::sin(elevation));
            directions.extend(turns.iter().map(|[x, y]| [flat * x, flat * y, up]));
        }
        let firings = (0..directions.len()).map(|ray| (ray % columns) as u32).collect();
        SweepRays { directions, firings, offsets_ns: self.offsets(columns) }
    }

    fn rosette(
        &self,
        scan: u64,
        rays: usize,
        elevation: [f64; 2],
        azimuth_half: Option<f64>,
    ) -> SweepRays {
        let offsets_ns = self.offsets(rays);
        let step = self.period_ns as f64 * 1e-9 / rays as f64;
        let direction = |ray: usize| {
            let time = (scan as f64 * rays as f64 + ray as f64) * step;
            let [turn, swing] = [TURN_RATE * time, SWING_RATE * time].map(f64::fract);
            let azimuth = match azimuth_half {
                Some(half) => half * (2.0 * triangle(turn) - 1.0),
                None => TAU * turn,
            };
            let swing = triangle(swing);
            let height = elevation[0] + swing * (elevation[1] - elevation[0]);
            let flat = libm::cos(height);
            [flat * libm::cos(azimuth), flat * libm::sin(azimuth), libm::sin(height)]
        };
        SweepRays {
            directions: (0..rays).map(direction).collect(),
            firings: (0..rays as u32).collect(),
            offsets_ns,
        }
    }

    fn offsets(&self, firings: usize) -> Vec<i64> {
        let offset = |firing: usize| {
            let share = i128::from(self.period_ns) * firing as i128 / firings as i128;
            share as i64 // < period_ns
        };
        (0..firings).map(|firing| if self.snapshot { 0 } else { offset(firing) }).collect()
    }

    /// Reported range for a surface at `distance` [m]: +inf for no return, NaN for no information.
    /// It depends only on the arguments.
    #[must_use]
    pub fn measured(&self, distance: f64, seed: u64, scan: u64, ray: u32) -> f64 {
        if distance >= self.range_max {
            return f64::INFINITY;
        }
        if distance < self.range_min {
            return f64::NAN;
        }
        if self.range_std == 0.0 && self.dropout == 0.0 {
            return distance;
        }
        let drawn = random::words(seed, random::place(Purpose::Ray, scan, ray));
        if random::uniform(drawn[2]) < self.dropout {
            return f64::NAN;
        }
        let range = (distance + self.range_std * random::normal(drawn[0], drawn[1])).max(0.0);
        match self.pattern {
            Pattern::Planar { .. } => self.limited(range),
            _ => range,
        }
    }

    /// Reported range of a 2D LiDAR: its driver reports no range outside the limits, also after
    /// noise.
    fn limited(&self, range: f64) -> f64 {
        if range >= self.range_max {
            f64::INFINITY
        } else if range < self.range_min {
            f64::NAN
        } else {
            range
        }
    }
}

impl Beam {
    /// Check the values of the beam.
    ///
    /// # Errors
    /// [`Error::Parameter`] if a value is outside the range that its field states.
    pub fn check(&self) -> Result<(), Error> {
        if !(self.half_width > 0.0 && self.half_width <= 0.1) {
            return Err(refused("half_width", "> 0, <= 0.1", &self.half_width));
        }
        if !(2..=MOST_LINES).contains(&self.lines) {
            return Err(refused("lines", "2 to 64", &self.lines));
        }
        if self.echo_length.is_nan() || self.echo_length < 0.0 {
            return Err(refused("echo_length", ">= 0", &self.echo_length));
        }
        Ok(())
    }

    /// Cosine and sine of the angle between every line and the ray.
    #[must_use]
    pub fn turns(&self) -> Vec<[f64; 2]> {
        let step = 2.0 * self.half_width / (self.lines - 1).max(1) as f64;
        (0..self.lines)
            .map(|line| step * line as f64 - self.half_width)
            .map(|angle| [libm::cos(angle), libm::sin(angle)])
            .collect()
    }
}

/// A triangle wave, from 1 down to 0 and up again while `phase` goes from 0 to 1.
fn triangle(phase: f64) -> f64 {
    (2.0 * phase - 1.0).abs()
}

fn planar(rays: usize, [start, step]: [f64; 2], step_ns: i64) -> SweepRays {
    let direction = |ray: usize| {
        let bearing = start + step * ray as f64;
        [libm::cos(bearing), libm::sin(bearing), 0.0]
    };
    SweepRays {
        directions: (0..rays).map(direction).collect(),
        firings: (0..rays as u32).collect(),
        offsets_ns: (0..rays as i64).map(|ray| ray * step_ns).collect(),
    }
}
