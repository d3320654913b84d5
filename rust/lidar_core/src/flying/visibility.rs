//! What one scan could see, for the tracker: is a target in the field of view and not hidden?

use super::scan::Prepared;
use super::track::Visibility;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{dot, minus, norm};

/// Rays that must pass, so that a target in the ball should have given returns.
const ENOUGH: usize = 3;

/// The rays of one scan.
pub(crate) struct ScanView<'a> {
    scan: &'a Prepared,
    /// Radius of the smallest target that must be seen [m].
    target_radius: f64,
}

impl<'a> ScanView<'a> {
    pub(crate) fn new(scan: &'a Prepared, target_radius: f64) -> Self {
        Self { scan, target_radius }
    }

    /// Unit direction and length of the ray `row`; None where it tells nothing.
    fn ray(&self, row: usize) -> Option<([f64; 3], f64)> {
        if self.scan.no_return[row] {
            let direction = self.scan.directions.as_ref()?[row];
            return Some((wide(direction), f64::INFINITY));
        }
        let span = minus(wide(self.scan.points[row]), self.scan.origins[row]);
        let length = norm(span);
        (length > 0.0).then(|| (span.map(|value| value / length), length))
    }
}

impl Visibility for ScanView<'_> {
    fn expected(&self, position: [f64; 3], radius: f64) -> bool {
        let radius = radius.min(self.target_radius);
        let passes = |row: usize| {
            let Some((direction, length)) = self.ray(row) else { return false };
            let span = minus(position, self.scan.origins[row]);
            let along = dot(span, direction);
            along > 0.0
                && dot(span, span) - along * along <= radius * radius
                && length >= along - radius
        };
        (0..self.scan.points.len()).filter(|&row| passes(row)).take(ENOUGH).count() == ENOUGH
    }
}
