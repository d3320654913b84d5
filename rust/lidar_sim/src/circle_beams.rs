//! Rays of a 2D scanner, and the part of a scan that one circle fills.

use lidar_core::Error;
use lidar_core::circles::segment::segments::Side;
use std::f64::consts::TAU;
use std::ops::Range;

/// Rays of a 2D scanner, all measured at once.
#[derive(Clone, Copy, Debug)]
pub struct Beams {
    /// Bearing of the first ray, two turns at most [rad].
    pub angle_min: f64,
    /// Step from ray to ray [rad], not 0.
    pub angle_increment: f64,
    /// Number of rays.
    pub n_beams: u32,
    /// Smallest and largest range that is measured [m].
    pub range_limits: [f64; 2],
}

/// The part of a scan that one circle fills.
pub(crate) struct CircleWindow {
    pub(crate) first_ray: u32,
    pub(crate) ranges: Vec<f64>,
}

impl Beams {
    pub(crate) fn check(&self) -> Result<(), Error> {
        let [near, far] = self.range_limits;
        let turned = self.angle_increment.abs() * f64::from(self.n_beams);
        let is_bearing = self.angle_min.abs() <= 2.0 * TAU;
        if self.n_beams > 0 && is_bearing && turned > 0.0 && turned < 2.0 * TAU && near < far {
            return Ok(());
        }
        let expected = "a first bearing of two turns at most, rays that turn once at most, and a nearer\
            \x20limit below the farther one";
        Err(Error::Parameter { name: "beams", expected, got: format!("{self:?}") })
    }

    /// Direction of ray `ray` [rad].
    fn bearing(&self, ray: u32) -> f64 {
        self.angle_min + self.angle_increment * f64::from(ray)
    }

    /// Indices of the rays within `half_angle` of `bearing` [rad]: a first run of rays, and one
    /// after the seam.
    fn runs(&self, bearing: f64, half_angle: f64) -> [Range<u32>; 2] {
        let mut runs = [0..0, 0..0];
        let middle = (bearing - self.angle_min) / self.angle_increment;
        let half = (half_angle / self.angle_increment).abs();
        let turn = (TAU / self.angle_increment).abs();
        let most = f64::from(self.n_beams - 1);
        // The lowest place of the middle, counted in rays, from which the circle may reach ray 0.
        let mut middle = middle - ((middle + half) / turn).floor() * turn;
        let mut found = 0;
        while middle - half <= most && found < 2 {
            let (from, to) = ((middle - half).ceil().max(0.0), (middle + half).floor().min(most));
            if from <= to {
                runs[found] = from as u32..to as u32 + 1;
                found += 1;
            }
            middle += turn;
        }
        if found == 2 {
            runs.swap(0, 1); // over the seam: the later rays come first
        }
        runs
    }

    /// Window of a circle in a scan without noise; None without a hit, or for a scanner inside it.
    pub(crate) fn window(&self, [x, y, radius]: [f64; 3], half_width: f64) -> Option<CircleWindow> {
        let (distance, bearing) = (libm::hypot(x, y), libm::atan2(y, x));
        let [near, far] = self.range_limits;
        if distance <= radius || distance - radius > far {
            return None;
        }
        let half_angle = libm::asin(radius / distance);
        let runs = self.runs(bearing, half_angle + half_width + 1e-9);
        let mut ranges = Vec::with_capacity(runs.iter().map(ExactSizeIterator::len).sum());
        let first_ray = runs[0].start;
        for ray in runs.into_iter().flatten() {
            let off = self.bearing(ray) - bearing;
            let aside = distance * libm::sin(off);
            let depth = radius * radius - aside * aside;
            let range = if depth >= 0.0 {
                distance * libm::cos(off) - depth.sqrt()
            } else if half_width > 0.0 && turned(off) < half_angle + half_width {
                (distance * distance - radius * radius).sqrt() // its edge meets the flank
            } else {
                f64::INFINITY
            };
            ranges.push(if (near..=far).contains(&range) { range } else { f64::INFINITY });
        }
        CircleWindow { first_ray, ranges }.trimmed(self.n_beams)
    }

    /// What lies beside both ends of a window.
    pub(crate) fn sides(&self, window: &CircleWindow, cut_margins: [f64; 2]) -> [Side; 2] {
        let last = (window.first_ray + window.ranges.len() as u32 - 1) % self.n_beams;
        let turned = self.angle_increment.abs() * (f64::from(self.n_beams) - 0.5);
        let closed = turned >= TAU - self.angle_increment.abs();
        let ends = [(window.first_ray, 0, 0), (last, self.n_beams - 1, window.ranges.len() - 1)];
        ends.map(|(ray, edge, place)| {
            let range = window.ranges[place];
            let cut = range < self.range_limits[0] + cut_margins[0]
                || range > self.range_limits[1] - cut_margins[1];
            match (ray == edge && !closed, cut) {
                (true, _) => Side::FieldEdge,
                (_, true) => Side::RangeCut,
                _ => Side::Free,
            }
        })
    }
}

/// Absolute value of `angle` by the shorter way round [rad].
fn turned(angle: f64) -> f64 {
    (angle - (angle / TAU).round() * TAU).abs()
}

impl CircleWindow {
    /// Window without misses at its ends; None if there are only misses.
    pub(crate) fn trimmed(mut self, n_beams: u32) -> Option<Self> {
        let from = self.ranges.iter().position(|range| range.is_finite())?;
        let to = self.ranges.iter().rposition(|range| range.is_finite())?;
        self.ranges.truncate(to + 1);
        self.ranges.drain(..from);
        self.first_ray = (self.first_ray + from as u32) % n_beams;
        Some(self)
    }
}
