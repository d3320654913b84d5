//! A 2D scan.

use crate::Error;
use std::f64::consts::TAU;

/// One sweep of a 2D LiDAR as ranges over bearings, eqs 1-2, one entry per ray in the order of
/// measurement.
///
/// A range is the distance to a surface [m]; +inf is a miss (nothing within range), NaN no
/// information (REP-117). Bearings [rad] count counter-clockwise from the x axis of the scan's
/// frame; they need not be equally spaced, since a projection into the horizontal plane moves
/// them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolarScan {
    /// Distance of every ray [m], +inf or NaN.
    pub ranges: Vec<f64>,
    /// Direction of every ray [rad].
    pub bearings: Vec<f64>,
}

impl PolarScan {
    /// Number of rays.
    #[must_use]
    pub fn len(&self) -> usize {
        self.ranges.len()
    }

    /// True if there are no rays.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }

    /// Check that every range has a bearing.
    ///
    /// # Errors
    /// [`Error::Length`] if ranges and bearings differ in number.
    pub(crate) fn check_lengths(&self) -> Result<(), Error> {
        let (expected, got) = (self.ranges.len(), self.bearings.len());
        if got == expected {
            Ok(())
        } else {
            Err(Error::Length { name: "bearings", expected, got })
        }
    }

    /// True if the bearings cover a full turn, so that the first ray is the neighbour of the last.
    pub(crate) fn is_full_circle(&self) -> bool {
        let steps = self.bearings.windows(2).map(|pair| turn(pair[1] - pair[0]));
        let turned = steps.sum::<f64>().abs();
        let count = self.bearings.len();
        count > 2 && TAU - turned <= 1.5 * turned / (count - 1) as f64
    }

    /// Mean angle from ray to ray [rad]; None without two rays.
    pub(crate) fn spacing(&self) -> Option<f64> {
        let steps = self.bearings.windows(2).map(|pair| turn(pair[1] - pair[0]));
        let mean = steps.sum::<f64>().abs() / (self.bearings.len() as f64 - 1.0);
        (mean > 0.0 && mean.is_finite()).then_some(mean)
    }

    /// End point of ray `ray` [m]; None for a miss and for no information.
    #[must_use]
    pub fn point(&self, ray: usize) -> Option<[f64; 2]> {
        let (range, bearing) = (*self.ranges.get(ray)?, *self.bearings.get(ray)?);
        range.is_finite().then(|| [range * libm::cos(bearing), range * libm::sin(bearing)])
    }
}

/// `angle` shifted by full turns into -pi..pi.
#[must_use]
#[inline]
pub(crate) fn turn(angle: f64) -> f64 {
    if angle.abs() <= TAU / 2.0 { angle } else { angle - TAU * libm::round(angle / TAU) }
}

#[cfg(test)]
mod tests {
    use super::{PolarScan, TAU};

    #[test]
    fn a_full_circle_may_begin_anywhere() {
        let scan = |first: f64, count: i32| {
            let bearing = |ray: i32| (first + f64::from(ray) * TAU / 100.0 + 3.0) % TAU - 3.0;
            PolarScan { ranges: Vec::new(), bearings: (0..count).map(bearing).collect() }
        };
        for first in [0.0, 1.0, 3.0] {
            assert!(scan(first, 100).is_full_circle());
            assert!(!scan(first, 90).is_full_circle());
        }
    }

    #[test]
    fn only_hits_have_a_point() {
        let scan = PolarScan { ranges: vec![2.0, f64::INFINITY, f64::NAN], bearings: vec![0.0; 3] };
        assert_eq!(scan.point(0), Some([2.0, 0.0]));
        assert_eq!((scan.point(1), scan.point(2), scan.point(3)), (None, None, None));
    }
}
