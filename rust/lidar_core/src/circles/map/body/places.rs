//! Places of bodies: when two are one object, and where one may be.

#![allow(non_snake_case)] // textbook letters

use super::measurement::BodyMeasurement;
use crate::circles::map::rules::Rules;
use crate::estimation::kalman::Gaussian;
use nalgebra::{Matrix2, Vector2, Vector3};

/// Radius from which a body is large [m].
const LARGE: f64 = 0.5;
/// Least ratio of the radii of two circles of one large object: a small object inside its circle is
/// another object.
const LEAST_RATIO: f64 = 0.5;

/// True if two circles may belong to one object by their radii [m].
pub(super) fn are_alike(one: f64, two: f64) -> bool {
    let (least, most) = (one.min(two), one.max(two));
    most < LARGE || least >= LEAST_RATIO * most
}

/// Distance between two centres [m].
pub(super) fn apart(one: &Vector3<f64>, two: &Vector3<f64>) -> f64 {
    libm::hypot(one[0] - two[0], one[1] - two[1])
}

/// True if two circles (x, y, r) show one object: one contains the centre of the other, or the gap
/// between them is small.
pub(super) fn is_one(one: &Vector3<f64>, two: &Vector3<f64>, rules: &Rules) -> bool {
    let gap = rules.parameters().merge_gap;
    let [x, y] = [one[0] - two[0], one[1] - two[1]];
    let touching = if gap > 0.0 { one[2] + two[2] + gap } else { 0.0 };
    let reach = one[2].max(two[2]).max(touching);
    x * x + y * y < reach * reach
}

/// For each measurement the index of the larger one that it nearly touches, or its own.
pub(super) fn wholes(seen: &[BodyMeasurement], rules: &Rules) -> Vec<usize> {
    let is_small = |one: &BodyMeasurement| !one.outline.is_some_and(|outline| outline.is_large);
    let mut order: Vec<usize> = (0..seen.len()).filter(|&i| is_small(&seen[i])).collect();
    // The largest first: a part belongs to a whole, never to another part.
    order.sort_by(|&i, &j| seen[j].circle.z[2].total_cmp(&seen[i].circle.z[2]));
    let mut wholes: Vec<usize> = (0..seen.len()).collect();
    let mut larger: Vec<usize> = Vec::new();
    for index in order {
        let z = &seen[index].circle.z;
        let is_near = |&&other: &&usize| is_one(z, &seen[other].circle.z, rules);
        match larger.iter().find(is_near) {
            Some(&whole) => wholes[index] = whole,
            None => larger.push(index),
        }
    }
    wholes
}

/// Squared velocity of a body, normalised by its covariance (no unit): small if the body may be
/// standing.
pub(super) fn moves_by(state: &Gaussian<5>) -> f64 {
    let velocity = Vector2::new(state.mean[2], state.mean[3]);
    let P: Matrix2<f64> = state.covariance.fixed_view::<2, 2>(2, 2).into_owned();
    P.try_inverse().map_or(0.0, |inverse| velocity.dot(&(inverse * velocity)))
}

/// Axes of the ellipse of one standard deviation of the centre [m].
pub(super) fn axes(state: &Gaussian<5>) -> [[f64; 2]; 2] {
    let P: Matrix2<f64> = state.covariance.fixed_view::<2, 2>(0, 0).into_owned();
    let (mean, half) = (0.5 * (P[(0, 0)] + P[(1, 1)]), 0.5 * (P[(0, 0)] - P[(1, 1)]));
    // Eigenvalues of a 2x2 matrix in closed form: fixed operations, the same bits everywhere.
    let root = (half * half + P[(0, 1)] * P[(0, 1)]).sqrt();
    let [long, short] = [mean + root, mean - root].map(|value| value.max(0.0).sqrt());
    let angle = 0.5 * libm::atan2(P[(0, 1)], half);
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    [[long * cos, long * sin], [-short * sin, short * cos]]
}
