//! Errors of circles that do not average out while the scanner sees the object from the same place.
//!
//! The edge of an object is somewhere between the last ray that hits it and the first ray that
//! passes it. The resulting error is the same in every scan while the rays hit the object at the
//! same bearings. If the scanner turns or moves, the error changes.

#![allow(non_snake_case)] // textbook letters

use crate::circles::map::view::level_pose::LevelPose;
use crate::circles::preprocess::polar_scan::turn;
use crate::estimation::kalman::{Gaussian, symmetrised};
use nalgebra::{Matrix3, SMatrix, Vector3};
use serde::{Deserialize, Serialize};

/// Change of the bearing of an object's side, in spacings of rays, above which its error is a new
/// one.
const OTHER: f64 = 0.3;
/// Weight of the newest scan in the share of scans with the same error.
const NEWEST: f64 = 0.1;
/// Rows of x, y and the radius in the state of an element.
const PLACES: [usize; 3] = [0, 1, 4];
/// Largest share of the covariance of a fit that errors which do not average out may have.
const MOST: f64 = 0.9;

/// View of a scanner on an object: position and yaw of the scanner in the world, and the spacing of
/// its rays.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::circles::map) struct Look {
    /// Place of the scanner [m], and its yaw [rad].
    place: [f64; 2],
    yaw: f64,
    /// Angle from ray to ray [rad].
    spacing: f64,
}

impl Look {
    pub(in crate::circles::map) fn new(pose: &LevelPose, spacing: f64) -> Self {
        Self { place: pose.origin(), yaw: pose.yaw(), spacing }
    }

    /// Place of the scanner [m].
    pub(super) fn place(&self) -> [f64; 2] {
        self.place
    }

    /// Distance between neighbouring rays at `distance` [m] from the scanner [m].
    pub(super) fn gap(&self, distance: f64) -> f64 {
        self.spacing.abs() * distance
    }

    /// Bearings of both sides of a circle (x, y, r) as the scanner sees it, from its yaw [rad].
    fn sides(&self, circle: &Vector3<f64>) -> [f64; 2] {
        let [x, y] = [circle[0] - self.place[0], circle[1] - self.place[1]];
        let half = libm::asin((circle[2] / libm::hypot(x, y).max(1e-9)).min(1.0));
        let bearing = libm::atan2(y, x) - self.yaw;
        [bearing - half, bearing + half]
    }

    /// True if the sides of a circle are at nearly the same bearings as `before` [rad], so that the
    /// error is the same.
    fn is_same(&self, circle: &Vector3<f64>, before: [f64; 2]) -> bool {
        let mut sides = self.sides(circle).into_iter().zip(before);
        sides.all(|(one, other)| turn(one - other).abs() < OTHER * self.spacing)
    }

    /// Covariance of the part of the error of a fit (x, y, r) that does not average out. Each side
    /// of the circle is uniformly distributed between two rays. `R`: covariance of the fit [m^2].
    fn lasting(&self, circle: &Vector3<f64>, R: &Matrix3<f64>) -> Matrix3<f64> {
        let [x, y] = [circle[0] - self.place[0], circle[1] - self.place[1]];
        let distance = libm::hypot(x, y).max(1e-9);
        let gap = distance * self.spacing;
        let mut information = Matrix3::zeros();
        for side in [-1.0, 1.0] {
            let across = Vector3::new(-y / distance, x / distance, side);
            information += across * across.transpose() * (12.0 / (gap * gap));
        }
        // The fit weights what it knows by its information: error = R * information * error of sides.
        let lasting = R * information * R;
        lasting * (MOST * R.trace() / lasting.trace()).min(1.0)
    }
}

/// Statistics of the views on one object: size of the errors that do not average out, and how often
/// the error was the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(in crate::circles::map) struct Looks {
    /// Bearings of the sides of the object in the last view [rad]; None before the first one.
    last: Option<[f64; 2]>,
    /// Share of recent views that were the same as the view before.
    same: f64,
    /// Mean covariance of the lasting errors of x, y and radius [m^2].
    lasting: Matrix3<f64>,
    /// Share of the lasting errors in the covariance of the fits.
    share: f64,
}

impl Looks {
    /// Update the statistics with a view on an object. `circle`: best estimate (x, y, r) [m]; `R`:
    /// covariance of its fit [m^2].
    pub(in crate::circles::map) fn add(
        &mut self,
        look: Look,
        circle: &Vector3<f64>,
        R: &Matrix3<f64>,
    ) {
        let is_same = self.last.is_some_and(|last| look.is_same(circle, last));
        self.same += NEWEST * (f64::from(u8::from(is_same)) - self.same);
        let weight = if self.last.is_none() { 1.0 } else { NEWEST };
        let lasting = look.lasting(circle, R);
        self.lasting += (lasting - self.lasting) * weight;
        self.share += (lasting.trace() / R.trace() - self.share) * weight;
        self.last = Some(look.sides(circle));
    }

    /// Add the lasting error to the covariance of `state`, because equal views do not reduce it. It
    /// replaces the part of the covariance that the filter treats as independent in every scan.
    pub(in crate::circles::map) fn widen(&self, state: &mut Gaussian<5>) {
        let mut kept = SMatrix::<f64, 5, 5>::identity();
        let lasting = self.lasting * self.same;
        for place in PLACES {
            kept[(place, place)] = (1.0 - self.share * self.same).sqrt();
        }
        let mut covariance = kept * state.covariance * kept;
        for (row, i) in PLACES.into_iter().enumerate() {
            for (column, j) in PLACES.into_iter().enumerate() {
                covariance[(i, j)] += lasting[(row, column)];
            }
        }
        state.covariance = symmetrised(covariance);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::transform::Transform;
    use nalgebra::SVector;

    /// Covariance of a well-known place after 50 looks from the origin, turned by `step` each time.
    fn after(step: f64) -> SMatrix<f64, 5, 5> {
        let (mut looks, circle) = (Looks::default(), Vector3::new(5.0, 0.0, 0.2));
        for scan in 0..50 {
            let (sin, cos) = (libm::sin(step * f64::from(scan)), libm::cos(step * f64::from(scan)));
            let rotation = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]];
            let pose = LevelPose::of(&Transform { rotation, translation: [0.0; 3] });
            looks.add(Look::new(&pose, 0.01), &circle, &(Matrix3::identity() * 1e-4));
        }
        let mut state = Gaussian { mean: SVector::zeros(), covariance: SMatrix::identity() * 1e-9 };
        looks.widen(&mut state);
        state.covariance
    }

    #[test]
    fn what_the_same_rays_show_keeps_its_error_and_what_others_show_does_not() {
        let (still, turning) = (after(0.0), after(0.004));
        // Sides known to 0.05 m / sqrt(12): the fit of 0.01 m hangs on them by 0.96 of its weight.
        assert!((still[(1, 1)].sqrt() - 0.01 * 0.96).abs() < 0.0011, "{still}");
        assert!(still[(0, 0)] < 1e-9); // they tell nothing about the distance
        assert!((turning - SMatrix::identity() * 1e-9).abs().max() < 1e-15);
        assert!((still - still.transpose()).abs().max() < 1e-15);
    }
}
