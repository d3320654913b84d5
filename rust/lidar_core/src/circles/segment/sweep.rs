//! Hits of one sweep, and gaps between them.

use crate::circles::preprocess::polar_scan::{PolarScan, turn};

/// The hits of one scan in the order of the sweep, first to last.
pub(crate) struct HitSweep<'a> {
    pub(crate) scan: &'a PolarScan,
    /// Ranges before the scan was limited to a volume.
    pub(crate) seen: &'a [f64],
    /// Indices of the rays with a return.
    pub(crate) hits: Vec<u32>,
    /// True if the ray after the last one is the first one.
    pub(crate) wraps: bool,
}

impl HitSweep<'_> {
    /// Number of steps from ray `from` to ray `to`, across the seam if necessary.
    pub(super) fn steps(&self, from: u32, to: u32) -> usize {
        let (from, to) = (from as usize, to as usize);
        if to >= from { to - from } else { to + self.scan.len() - from }
    }

    /// Angle between two rays [rad].
    pub(crate) fn angle(&self, from: u32, to: u32) -> f64 {
        turn(self.scan.bearings[to as usize] - self.scan.bearings[from as usize]).abs()
    }

    /// True if a ray between two neighbouring hits is a miss.
    pub(super) fn passes_between(&self, from: u32, to: u32) -> bool {
        let count = self.scan.len();
        (1..self.steps(from, to))
            .any(|step| self.scan.ranges[(from as usize + step) % count] == f64::INFINITY)
    }

    /// Distance of two hits [m].
    pub(crate) fn distance(&self, from: u32, to: u32) -> f64 {
        let [a, b] = [from, to].map(|ray| self.scan.ranges[ray as usize]);
        let sine = libm::sin(0.5 * self.angle(from, to));
        ((a - b) * (a - b) + 4.0 * a * b * sine * sine).sqrt()
    }
}
