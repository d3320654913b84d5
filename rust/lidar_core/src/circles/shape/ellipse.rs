//! Ellipses between two tangents from the sensor.
//!
//! In coordinates that are the distances from the two tangents, in units of those of the centre,
//! every ellipse between the tangents has its centre at (1, 1) and the matrix [1 k; k 1]: two
//! tangents, two distances and k are the five parameters. A ray that has w1 and w2 per metre in
//! these coordinates meets it at (1 - k) (w1 + w2 - sqrt(2 (1 + k) w1 w2)) / (w1^2 + w2^2
//! - 2 k w1 w2), smooth up to the tangents in the roots of how far these lie beyond the hits.

use super::solve::{FittedShape, Solved, gain, solve};
use crate::circles::fit::arc::{Arc, Edge, Hit};
use crate::circles::fit::circle::Circle;
use crate::circles::preprocess::polar_scan::turn;
use std::f64::consts::{FRAC_PI_2, PI};

/// Least distance from a tangent by which a derivative is divided, in units of that of the centre:
/// the factor of that derivative vanishes there.
const LEAST_DISTANCE: f64 = 1e-9;
/// Smallest semi-axis [m].
const LEAST_AXIS: f64 = 0.01;
/// Start values of the ratio of both distances of the centre from the tangents.
const RATIOS: [f64; 5] = [0.4, 0.65, 1.0, 1.5, 2.5];
/// Start values of the inverse hyperbolic tangent of k, relative to that of a circle.
const TURNS: [f64; 5] = [-1.6, -0.8, 0.0, 0.8, 1.6];
/// Number of starts that are refined.
const FOLLOWED: usize = 3;
/// Smallest angle under which a circle appears [rad].
const ROUNDEST: f64 = 1e-4;
/// Largest cosine of a start angle: at 1 the derivative by the angle vanishes.
const INNER: f64 = 0.98;
/// Start positions of the tangents, as angles over their reach.
const START: f64 = 1.2;

/// Ellipses that end at the ends of an arc. Parameters: an angle over the reach of either side,
/// logarithms of the distances of the centre from the tangents [m], inverse hyperbolic tangent of
/// k.
pub(super) struct Ellipse<'a> {
    pub(super) arc: &'a Arc,
}

impl Ellipse<'_> {
    /// Lower and upper bearing of the tangents, from the middle of the arc [rad].
    fn tangents(&self, parameters: &[f64; 5]) -> [f64; 2] {
        let [low, high] = &self.arc.edges;
        let beyond = |reach: f64, angle: f64| 0.5 * reach * (1.0 - libm::cos(angle));
        [
            low.bearing - beyond(low.reach, parameters[0]),
            high.bearing + beyond(high.reach, parameters[1]),
        ]
    }

    /// Decrease of the misfit from the best circle of the arc to an ellipse, to first order.
    pub(super) fn gain(&self, circle: &Circle, std: f64) -> f64 {
        let [x, y] = circle.center;
        let half = libm::asin((circle.radius / libm::hypot(x, y)).min(1.0));
        let bearing = turn(libm::atan2(y, x) - self.arc.bearing);
        let [low, high] = &self.arc.edges;
        let size = libm::log(circle.radius);
        let squeeze = libm::atanh(-libm::cos((2.0 * half).clamp(ROUNDEST, PI - ROUNDEST)));
        let angles = [
            angle_of(low, low.bearing - (bearing - half)),
            angle_of(high, bearing + half - high.bearing),
        ];
        gain(self, self.arc, std, &[angles[0], angles[1], size, size, squeeze])
    }

    /// Centre x, y, longer and shorter semi-axis [m], and bearing of the longer one [rad], in the
    /// frame of the arc.
    pub(super) fn reported(&self, parameters: &[f64; 5]) -> [f64; 5] {
        let [low, high] = self.tangents(parameters);
        let scale = 1.0 / libm::sin(high - low);
        let [first, second] = [parameters[2], parameters[3]].map(|log| scale * libm::exp(log));
        let k = libm::tanh(parameters[4]);
        // Vectors to the centre along one tangent each.
        let a = [first * libm::cos(high), first * libm::sin(high)];
        let b = [second * libm::cos(low), second * libm::sin(low)];
        let entry =
            |i: usize, j: usize| a[i] * a[j] + b[i] * b[j] + k * (a[i] * b[j] + a[j] * b[i]);
        let (xx, xy, yy) = (entry(0, 0), entry(0, 1), entry(1, 1));
        let (mean, apart) = (0.5 * (xx + yy), libm::hypot(0.5 * (xx - yy), xy));
        [
            a[0] + b[0],
            a[1] + b[1],
            (mean + apart).sqrt(),
            (mean - apart).max(0.0).sqrt(),
            0.5 * libm::atan2(2.0 * xy, xx - yy),
        ]
    }
}

impl FittedShape<5> for Ellipse<'_> {
    fn range(&self, parameters: &[f64; 5]) -> impl Fn(&Hit) -> (f64, [f64; 5]) {
        let [low, high] = self.tangents(parameters);
        let low = [libm::cos(low), libm::sin(low)];
        let high = [libm::cos(high), libm::sin(high)];
        let inverse = [parameters[2], parameters[3]].map(|log| libm::exp(-log));
        let k = libm::tanh(parameters[4]);
        // By how much the tangents turn away from the hits with the first two parameters.
        let turns =
            [0, 1].map(|side| 0.5 * self.arc.edges[side].reach * libm::sin(parameters[side]));
        move |hit| {
            // Distances from the tangents, and their derivatives by the bearings of these.
            let first = inverse[0] * (hit.sine * low[0] - hit.cosine * low[1]).max(0.0);
            let second = inverse[1] * (hit.cosine * high[1] - hit.sine * high[0]).max(0.0);
            let first_turned = inverse[0] * (hit.cosine * low[0] + hit.sine * low[1]);
            let second_turned = inverse[1] * (hit.cosine * high[0] + hit.sine * high[1]);
            let root = (2.0 * (1.0 + k) * first * second).sqrt();
            let above = first + second - root;
            let square = first * first + second * second - 2.0 * k * first * second;
            let share = 1.0 / square;
            let range = (1.0 - k) * above * share;
            let half = 0.5 * root;
            let by_first = (1.0 - k) * share * (1.0 - half / first.max(LEAST_DISTANCE))
                - range * share * 2.0 * (first - k * second);
            let by_second = (1.0 - k) * share * (1.0 - half / second.max(LEAST_DISTANCE))
                - range * share * 2.0 * (second - k * first);
            let by_k = -share * (above + (1.0 - k) * half / (1.0 + k))
                + 2.0 * range * share * first * second;
            let derivatives = [
                by_first * first_turned * turns[0],
                by_second * second_turned * turns[1],
                -by_first * first,
                -by_second * second,
                by_k * (1.0 - k * k),
            ];
            (range, derivatives)
        }
    }
}

/// Angle over the reach of a side for a tangent `beyond` its last hit [rad].
fn angle_of(edge: &Edge, beyond: f64) -> f64 {
    libm::acos((1.0 - 2.0 * beyond / edge.reach).clamp(-INNER, INNER))
}

/// Ellipse with least misfit to the arc, from several starts, with semi-axes up to `largest`; None if
/// its misfit is not below `most`.
pub(super) fn fit_ellipse(
    ellipse: &Ellipse<'_>,
    std: f64,
    largest: f64,
    most: f64,
) -> Option<Solved<5>> {
    let arc = ellipse.arc;
    let span = arc.edges[1].bearing - arc.edges[0].bearing;
    let reach = arc.edges[0].reach + arc.edges[1].reach;
    if span + reach >= PI {
        return None; // tangents that do not meet before the sensor
    }
    let mut starts: Vec<(f64, [f64; 5])> = Vec::with_capacity(RATIOS.len() * TURNS.len());
    let round = libm::atanh(-libm::cos((span + 0.4 * reach).clamp(0.05, FRAC_PI_2)));
    for ratio in RATIOS {
        for turn in TURNS {
            starts.push(scaled(ellipse, [START, START, 0.0, libm::log(ratio), round + turn]));
        }
    }
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let solved =
        starts.iter().take(FOLLOWED).filter_map(|&(_, at)| solve(ellipse, arc, std, at, most));
    let best = solved.min_by(|a, b| a.misfit.total_cmp(&b.misfit))?;
    let [_, _, long, short, _] = ellipse.reported(&best.parameters);
    (long <= largest && short >= LEAST_AXIS).then_some(best)
}

/// Sum of squared residuals of the ranges [m^2] and parameters of the ellipse `start` in the size
/// that fits the ranges best.
fn scaled(ellipse: &Ellipse<'_>, start: [f64; 5]) -> (f64, [f64; 5]) {
    let range = ellipse.range(&start);
    let (mut gg, mut gz) = (0.0, 0.0);
    for hit in &ellipse.arc.hits {
        let (g, _) = range(hit);
        gg += hit.weight * g * g;
        gz += hit.weight * g * hit.range;
    }
    let scale = gz / gg;
    let [low, high, first, second, k] = start;
    let larger = libm::log(scale);
    (ellipse.arc.square - scale * gz, [low, high, first + larger, second + larger, k])
}
