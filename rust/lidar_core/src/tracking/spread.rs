//! Spread of the measurements of one target: uncertainty of a position within its extent.

use serde::{Deserialize, Serialize};

/// Number of scans with measurements after which the weight of a scan is 1/e.
const MEMORY: f64 = 80.0;
/// Share of the spread that is added to the covariance of the position. It would be 1 for a body
/// that is measured evenly over its length, and a third for one measured at its two ends. One half
/// was chosen with the six Autoferry scenarios of `lidar-core reproduce fusion-real`.
const SHARE: f64 = 0.5;
/// Least ratio of the variance across a body to the variance along it. Only the near side of a body
/// gives returns, half a width from its centre. For a boat four times as long as wide, this ratio
/// is 3 (1/4)^2.
const NARROWEST: f64 = 3.0 / 16.0;

/// Spread of the measurements around the position of a target.
///
/// # Source The scatter of a random matrix: Koch, "Bayesian approach to extended object and cluster
/// tracking using random matrices", 2008; here the noise of the sensor is part of the spread,
/// because it cannot be separated from the extent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MeasuredSpread {
    /// Mean of the products xx, xy and yy of the offsets [m^2].
    mean: [f64; 3],
    scans: f64,
}

impl MeasuredSpread {
    /// Add the measurements of a scan, relative to the position of the target [m].
    pub fn take(&mut self, offsets: &[[f64; 2]]) {
        if offsets.is_empty() {
            return;
        }
        self.scans = (self.scans + 1.0).min(MEMORY);
        let of = |product: fn(&[f64; 2]) -> f64| {
            offsets.iter().map(product).sum::<f64>() / offsets.len() as f64
        };
        let now = [of(|[x, _]| x * x), of(|[x, y]| x * y), of(|[_, y]| y * y)];
        for (mean, now) in self.mean.iter_mut().zip(now) {
            *mean += (now - *mean) / self.scans;
        }
    }

    /// Covariance of a position within the target relative to the mean of the measurements [m^2].
    #[must_use]
    pub fn covariance(&self) -> [[f64; 2]; 2] {
        let [xx, xy, yy] = self.mean.map(|value| SHARE * value);
        let middle = 0.5 * (xx + yy);
        let half = libm::hypot(0.5 * (xx - yy), xy);
        let (largest, least) = (middle + half, middle - half);
        let lacks = NARROWEST * largest - least;
        if lacks <= 0.0 || half <= 0.0 {
            return [[xx, xy], [xy, yy]];
        }
        // Only the direction of the least variance grows: the other one is wide enough.
        let across = |value: f64| lacks * (0.5 - 0.5 * value / half);
        let more = -0.5 * lacks * xy / half;
        [[xx + across(0.5 * (xx - yy)), xy + more], [xy + more, yy + across(0.5 * (yy - xx))]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ship of 20 m along x: the middle of a body is uncertain by half of the spread.
    #[test]
    fn a_long_body_is_uncertain_along_its_length() {
        let mut ship = MeasuredSpread::default();
        for k in 0..400 {
            ship.take(&[[10.0 * (2.0 * (f64::from(k) * 0.618_034 % 1.0) - 1.0), 0.5]]);
        }
        let [[xx, xy], [_, yy]] = ship.covariance();
        assert!((xx / (0.5 * 100.0 / 3.0) - 1.0).abs() < 0.1, "{xx}");
        assert!(xy.abs() < 0.5 && (yy / (NARROWEST * xx) - 1.0).abs() < 0.01, "{xy} {yy}");
    }

    /// In any direction; what is round stays as it is.
    #[test]
    fn a_body_has_a_width() {
        let of = |offsets: &[[f64; 2]]| {
            let mut body = MeasuredSpread::default();
            body.take(offsets);
            let [[xx, xy], [_, yy]] = body.covariance();
            [xx, xy, yy]
        };
        let slanted = of(&[[6.0, 8.0], [-6.0, -8.0]]);
        let expected = [18.0 + 6.0, 24.0 - 4.5, 32.0 + 3.375];
        assert!(slanted.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{slanted:?}");
        assert_eq!(of(&[[2.0, 0.0], [-2.0, 0.0], [0.0, 2.0], [0.0, -2.0]]), [1.0, 0.0, 1.0]);
    }

    /// The opposite: what is measured at one place is uncertain by nothing more, also after a time
    /// in which it was not.
    #[test]
    fn a_point_has_no_spread() {
        let mut point = MeasuredSpread::default();
        point.take(&[]);
        assert_eq!(point, MeasuredSpread::default());
        point.take(&[[4.0, -4.0]]);
        (0..800).for_each(|_| point.take(&[[0.0, 0.0]]));
        assert!(point.covariance()[0][0] < 1e-3);
    }
}
