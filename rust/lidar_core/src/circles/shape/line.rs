//! Straight surfaces: one, or two at a right angle.
//!
//! During a fit, their misfit may be far above any bound before it falls: rays miss a line with a wrong bearing, and
//! rays change from one face of a corner to the other. So the search is never ended early for these two shapes.

use super::solve::{FittedShape, Solved, solve};
use crate::circles::fit::arc::{Arc, Hit};
use std::f64::consts::{FRAC_PI_2, PI};

/// Largest range to a line, and its range on rays that do not meet it [m].
const FAR: f64 = 1e3;

/// Range along a ray to the line with normal at bearing `angle`, `distance` from the sensor, and its
/// derivatives by both.
fn range_to(angle: f64, distance: f64) -> impl Fn(&Hit) -> (f64, [f64; 2]) {
    let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
    move |hit| {
        let along = hit.cosine * cosine + hit.sine * sine;
        if along > distance / FAR {
            let (range, across) = (distance / along, hit.sine * cosine - hit.cosine * sine);
            (range, [-range * across / along, 1.0 / along])
        } else {
            (FAR, [0.0; 2])
        }
    }
}

/// One line: bearing of its normal [rad], distance [m].
struct LineShape;

impl FittedShape<2> for LineShape {
    fn range(&self, &[angle, distance]: &[f64; 2]) -> impl Fn(&Hit) -> (f64, [f64; 2]) {
        range_to(angle, distance)
    }
}

/// Two faces of a box: bearing of the normal of the one with smaller bearings [rad], distances of
/// that one and of the other [m].
struct Corner;

impl FittedShape<3> for Corner {
    fn range(&self, &[angle, first, second]: &[f64; 3]) -> impl Fn(&Hit) -> (f64, [f64; 3]) {
        let (first, second) = (range_to(angle, first), range_to(angle - FRAC_PI_2, second));
        // A ray is inside once it has passed both faces.
        move |hit| match (first(hit), second(hit)) {
            ((one, [by_angle, by_distance]), (other, _)) if one >= other => {
                (one, [by_angle, by_distance, 0.0])
            }
            (_, (other, [by_angle, by_distance])) => (other, [by_angle, 0.0, by_distance]),
        }
    }
}

/// Number, sums and sums of squares of points.
#[derive(Clone, Copy, Default)]
struct Sums {
    n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Sums {
    fn with(self, hit: &Hit) -> Self {
        let (x, y, w) = (hit.range * hit.cosine, hit.range * hit.sine, hit.weight);
        Self {
            n: self.n + w,
            x: self.x + w * x,
            y: self.y + w * y,
            xx: self.xx + w * x * x,
            xy: self.xy + w * x * y,
            yy: self.yy + w * y * y,
        }
    }

    fn without(self, less: &Self) -> Self {
        Self {
            n: self.n - less.n,
            x: self.x - less.x,
            y: self.y - less.y,
            xx: self.xx - less.xx,
            xy: self.xy - less.xy,
            yy: self.yy - less.yy,
        }
    }

    /// Scatter about the mean: xx, xy, yy.
    fn scatter(&self) -> [f64; 3] {
        let n = self.n.max(1e-9);
        [
            self.xx - self.x * self.x / n,
            self.xy - self.x * self.y / n,
            self.yy - self.y * self.y / n,
        ]
    }

    fn mean(&self) -> [f64; 2] {
        [self.x / self.n, self.y / self.n]
    }
}

/// Direction of least scatter [rad], and the scatter in this direction [m^2].
fn least([xx, xy, yy]: [f64; 3]) -> (f64, f64) {
    let angle = 0.5 * libm::atan2(2.0 * xy, xx - yy) + FRAC_PI_2;
    let spread = libm::hypot(0.5 * (xx - yy), xy);
    (angle, 0.5 * (xx + yy) - spread)
}

/// Line with least misfit to the arc; None if the misfit is not below `most`. The scatter across
/// the line shows that before any fit: no hit is farther off across the line than along its ray.
pub(super) fn fit_line(arc: &Arc, std: f64, most: f64) -> Option<Solved<2>> {
    let sums = arc.hits.iter().fold(Sums::default(), Sums::with);
    let (angle, scatter) = least(sums.scatter());
    if scatter > most * std * std {
        return None;
    }
    let [x, y] = sums.mean();
    let distance = x * libm::cos(angle) + y * libm::sin(angle);
    let turned = if distance < 0.0 { PI } else { 0.0 };
    let solved = solve(&LineShape, arc, std, [angle + turned, distance.abs()], f64::INFINITY)?;
    (solved.misfit < most).then_some(solved)
}

/// Corner with least misfit to the arc; None if it does not have two faces towards the sensor, or
/// if the misfit is not below `most`.
pub(super) fn fit_corner(arc: &Arc, std: f64, most: f64) -> Option<Solved<3>> {
    let all = arc.hits.iter().fold(Sums::default(), Sums::with);
    let mut before = Sums::default();
    let mut best: Option<(f64, f64, Sums)> = None;
    for (index, hit) in arc.hits.iter().enumerate() {
        before = before.with(hit);
        if index < 1 || index + 3 > arc.hits.len() {
            continue;
        }
        let [xx, xy, yy] = before.scatter();
        let [other_xx, other_xy, other_yy] = all.without(&before).scatter();
        // The other face turned by a right angle lies along the first.
        let (angle, scatter) = least([xx + other_yy, xy - other_xy, yy + other_xx]);
        if best.is_none_or(|(least, ..)| scatter < least) {
            best = Some((scatter, angle, before));
        }
    }
    let (_, angle, first) = best.filter(|(scatter, ..)| *scatter <= most * std * std)?;
    let (first, second) = (first.mean(), all.without(&first).mean());
    // Of the four normals, those with both faces before the sensor and the first one first.
    let starts = [0.0, FRAC_PI_2, PI, 3.0 * FRAC_PI_2].map(|turn| {
        let (a, b) = (angle + turn, angle + turn - FRAC_PI_2);
        let along = |p: [f64; 2], a: f64| p[0] * libm::cos(a) + p[1] * libm::sin(a);
        [angle + turn, along(first, a), along(second, b)]
    });
    let start = starts.into_iter().find(|start| start[1] > 0.0 && start[2] > 0.0)?;
    let solved = solve(&Corner, arc, std, start, f64::INFINITY)?;
    let [_, first, second] = solved.parameters;
    (first > 0.0 && second > 0.0 && solved.misfit < most).then_some(solved)
}
