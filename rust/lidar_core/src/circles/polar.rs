//! A 2D scan.

use crate::Error;

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

    /// Whether there is no ray.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }

    /// # Errors
    /// [`Error::Length`] if ranges and bearings differ in number.
    pub(super) fn check_lengths(&self) -> Result<(), Error> {
        let (expected, got) = (self.ranges.len(), self.bearings.len());
        if got == expected {
            Ok(())
        } else {
            Err(Error::Length { name: "bearings", expected, got })
        }
    }

    /// Where ray `ray` ended [m]; None for a miss and for no information.
    #[must_use]
    pub fn point(&self, ray: usize) -> Option<[f64; 2]> {
        let (range, bearing) = (*self.ranges.get(ray)?, *self.bearings.get(ray)?);
        range.is_finite().then(|| [range * libm::cos(bearing), range * libm::sin(bearing)])
    }
}

#[cfg(test)]
mod tests {
    use super::PolarScan;

    #[test]
    fn only_hits_have_a_point() {
        let scan = PolarScan { ranges: vec![2.0, f64::INFINITY, f64::NAN], bearings: vec![0.0; 3] };
        assert_eq!(scan.point(0), Some([2.0, 0.0]));
        assert_eq!((scan.point(1), scan.point(2), scan.point(3)), (None, None, None));
    }
}
