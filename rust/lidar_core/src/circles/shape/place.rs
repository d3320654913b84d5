//! Transform of shapes from the frame of their arc to the frame of the scan, with covariances.

use super::ellipse::Ellipse;
use super::solve::Solved;
use super::{ShapeEstimate, ShapeKind};
use crate::circles::fit::arc::Arc;
use crate::circles::fit::circle::CircleEstimate;
use crate::circles::preprocess::polar_scan::turn;
use nalgebra::{SMatrix, SVector};
use std::f64::consts::{FRAC_PI_2, PI};

/// Standard deviation of an end that was not seen [m].
const OPEN: f64 = 1.0;
/// Extent beyond the last hit above which an edge is open [rad].
const LONG_REACH: f64 = 0.1;
/// Largest distance from a line of a ray beside it that still belongs to it, as a share of its
/// range.
const ON_LINE: f64 = 0.05;
/// Least angle between a ray and a line that it meets [rad].
const STEEP: f64 = FRAC_PI_2 - 1e-3;
/// Step for numerical derivatives.
const STEP: f64 = 1e-6;
/// Factor on the first-order variances of an ellipse's parameters, which is far from linear near
/// its tangents (measured with 1,000 simulated ellipses).
const EXCESS: f64 = 2.0;
/// Factor on the correlations of these parameters.
const CORRELATED: f64 = 0.97;

/// Shape estimate of a circle that is already in the frame of the scan.
pub(super) fn circle(arc: &Arc, found: CircleEstimate, misfit: f64) -> ShapeEstimate {
    let [x, y] = found.circle.center;
    let mut covariance = [[0.0; 5]; 5];
    for (row, from) in covariance.iter_mut().zip(found.covariance) {
        row[..3].copy_from_slice(&from);
    }
    let parameters = [x, y, found.circle.radius, 0.0, 0.0];
    let kind = ShapeKind::Circle;
    ShapeEstimate { kind, parameters, covariance, misfit, n_hits: arc.n_hits }
}

/// Shape estimate of a fitted ellipse, in the frame of the scan.
pub(super) fn ellipse(shape: &Ellipse<'_>, found: &Solved<5>) -> ShapeEstimate {
    let arc = shape.arc;
    let report = |parameters: &[f64; 5]| {
        let [x, y, long, short, heading] = shape.reported(parameters);
        let [x, y] = turned(arc, [x, y]);
        [x, y, long, short, arc.bearing + heading]
    };
    let (parameters, covariance) = reported(found.parameters, &found.covariance, report);
    let covariance = SMatrix::<f64, 5, 5>::from_fn(|i, j| {
        covariance[(i, j)] * EXCESS * if i == j { 1.0 } else { CORRELATED }
    });
    estimate(arc, ShapeKind::Ellipse, parameters, covariance, found.misfit)
}

/// Shape estimate of a fitted line between the outermost rays, in the frame of the scan.
pub(super) fn line(arc: &Arc, found: &Solved<2>) -> ShapeEstimate {
    let [angle, distance] = found.parameters;
    let ends = [0, 1].map(|side| end(arc, side, [angle, distance]));
    let known = [angle, distance, ends[0].0, ends[1].0, 0.0];
    let covariance = joined(&found.covariance, [ends[0].1, ends[1].1], 2);
    let report = |&[angle, distance, start, stop, _]: &[f64; 5]| {
        [arc.bearing + angle, distance, start, stop, 0.0]
    };
    let (parameters, covariance) = reported(known, &covariance, report);
    estimate(arc, ShapeKind::Line, parameters, covariance, found.misfit)
}

/// Shape estimate of a rectangle of which two faces are seen, in the frame of the scan; None if one
/// of them has no length.
pub(super) fn rectangle(arc: &Arc, found: &Solved<3>) -> Option<ShapeEstimate> {
    let [angle, first, second] = found.parameters;
    let ends = [end(arc, 0, [angle, first]), end(arc, 1, [angle - FRAC_PI_2, second])];
    // Along the first face the corner lies at the distance of the second one, and the other way.
    let lengths = [-second - ends[0].0, ends[1].0 - first];
    let known = [angle, first, second, ends[0].0, ends[1].0];
    let covariance = joined(&found.covariance, [ends[0].1, ends[1].1], 3);
    let long = usize::from(lengths[1].abs() > lengths[0].abs());
    let report = |&[angle, first, second, start, stop]: &[f64; 5]| {
        let sides = [(start + second).abs(), (stop - first).abs()];
        // The middle: half a side behind each face.
        let depth = [first + 0.5 * sides[1], second + 0.5 * sides[0]];
        let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
        let middle = [depth[0] * cosine + depth[1] * sine, depth[0] * sine - depth[1] * cosine];
        let [x, y] = turned(arc, middle);
        let heading = arc.bearing + angle + if long == 0 { FRAC_PI_2 } else { 0.0 };
        [x, y, sides[long], sides[1 - long], heading]
    };
    let (parameters, covariance) = reported(known, &covariance, report);
    (lengths[0] > 0.0 && lengths[1] > 0.0)
        .then(|| estimate(arc, ShapeKind::Rectangle, parameters, covariance, found.misfit))
}

fn turned(arc: &Arc, [x, y]: [f64; 2]) -> [f64; 2] {
    let (sine, cosine) = (libm::sin(arc.bearing), libm::cos(arc.bearing));
    [cosine * x - sine * y, sine * x + cosine * y]
}

/// Position of one end along a line, from the foot of its normal [m], and its variance [m^2].
fn end(arc: &Arc, side: usize, [angle, distance]: [f64; 2]) -> (f64, f64) {
    let edge = &arc.edges[side];
    let sign = if side == 0 { -1.0 } else { 1.0 };
    let limited = |bearing: f64| turn(bearing - angle).clamp(-STEEP, STEEP);
    let hit = if side == 0 { arc.hits.first() } else { arc.hits.last() };
    let range = hit.map_or(distance, |hit| hit.range);
    let at = range * libm::sin(edge.bearing - angle);
    let [next, next_range] = edge.next;
    let there = distance / libm::cos(limited(edge.bearing + sign * next));
    let goes_on = (next_range - there).abs() < ON_LINE * there; // too far for the segment only
    let along = |bearing: f64| distance * libm::tan(limited(bearing));
    let beyond = along(edge.bearing + sign * edge.reach) - along(edge.bearing);
    if edge.reach > LONG_REACH || goes_on || beyond.abs() > OPEN {
        return (at, OPEN * OPEN);
    }
    // The end is anywhere between the last hit and the first ray that passed: uniform in between.
    (at + 0.5 * beyond, beyond * beyond / 12.0)
}

/// Covariance of parameters, and of two ends after them.
fn joined<const K: usize>(
    covariance: &SMatrix<f64, K, K>,
    ends: [f64; 2],
    from: usize,
) -> SMatrix<f64, 5, 5> {
    let mut whole = SMatrix::<f64, 5, 5>::zeros();
    for i in 0..K {
        for j in 0..K {
            whole[(i, j)] = covariance[(i, j)];
        }
    }
    // Ends follow from the bearings of rays, angle and distance from ranges: independent errors.
    whole[(from, from)] = ends[0];
    whole[(from + 1, from + 1)] = ends[1];
    whole
}

/// Reported form of the parameters, and its covariance to first order.
fn reported(
    known: [f64; 5],
    covariance: &SMatrix<f64, 5, 5>,
    report: impl Fn(&[f64; 5]) -> [f64; 5],
) -> ([f64; 5], SMatrix<f64, 5, 5>) {
    let here = report(&known);
    let mut slope = SMatrix::<f64, 5, 5>::zeros();
    for k in 0..5 {
        let mut there = known;
        there[k] += STEP;
        let moved = report(&there);
        let mut apart: [f64; 5] = std::array::from_fn(|i| moved[i] - here[i]);
        apart[4] -= PI * libm::round(apart[4] / PI); // a heading has no front
        let column = apart.map(|apart| apart / STEP);
        slope.set_column(k, &SVector::from(column));
    }
    (here, slope * covariance * slope.transpose())
}

fn estimate(
    arc: &Arc,
    kind: ShapeKind,
    mut parameters: [f64; 5],
    covariance: SMatrix<f64, 5, 5>,
    misfit: f64,
) -> ShapeEstimate {
    let angle = if kind == ShapeKind::Line { 0 } else { 4 };
    let period = if kind == ShapeKind::Line { 2.0 * PI } else { PI }; // headings have no front
    parameters[angle] -= period * libm::round(parameters[angle] / period);
    let covariance = std::array::from_fn(|i| {
        std::array::from_fn(|j| 0.5 * (covariance[(i, j)] + covariance[(j, i)]))
    });
    ShapeEstimate { kind, parameters, covariance, misfit, n_hits: arc.n_hits }
}
