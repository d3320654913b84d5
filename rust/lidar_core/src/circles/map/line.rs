//! Lines: walls and other straight surfaces, which do not move.

#![allow(non_snake_case)] // textbook letters

use super::element::State;
use super::element_motion::ElementStep;
use super::parameters::LineRules;
use super::rules::Rules;
use super::view::viewpoint::Viewpoint;
use super::view::visibility::CircleVisibility;
use crate::Error;
use crate::circles::preprocess::polar_scan::turn;
use crate::estimation::kalman::{Gaussian, Linearised, mahalanobis, symmetrised, update};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_2;

/// Least half length for the rotation of a line whose ends move [m].
const LEAST_HALF: f64 = 0.25;
/// Largest angle between the normals of one surface [rad]; no gate is wider.
const WIDEST: f64 = 0.5;

/// A line in the world, as one segment of one scan shows it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct LineMeasurement {
    /// Middle of the line [m].
    pub(super) middle: [f64; 2],
    /// Bearing of the normal, which points away from the sensor [rad].
    pub(super) angle: f64,
    /// Half length [m].
    pub(super) half: f64,
    /// Covariance of the angle and of the position across the middle.
    pub(super) R: Matrix2<f64>,
}

impl LineMeasurement {
    /// Covariance that a surface adds because it is not exactly straight.
    fn bent(&self, rules: &LineRules) -> Matrix2<f64> {
        let (variance, half) = (rules.std * rules.std, self.half.max(LEAST_HALF));
        Matrix2::new(variance / (half * half), 0.0, 0.0, variance)
    }
}

/// A line, given by its normal and by its distance from an anchor near it, which never moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Line {
    anchor: [f64; 2],
    /// Bearing of the normal [rad], distance from the anchor along it [m].
    state: Gaussian<2>,
    /// Ends of the part that was seen, counter-clockwise from the foot of the anchor [m].
    extent: [f64; 2],
}

/// Unit vector in a direction.
fn direction(angle: f64) -> Vector2<f64> {
    Vector2::new(libm::cos(angle), libm::sin(angle))
}

impl Line {
    /// Line from its first measurement.
    fn new(seen: &LineMeasurement, rules: &LineRules) -> Self {
        let covariance = seen.R + seen.bent(rules);
        Self {
            // An anchor on the line keeps angle and distance nearly independent. Measured from the
            // origin of the world, a small angle would move a far line by metres.
            anchor: seen.middle,
            state: Gaussian { mean: Vector2::new(seen.angle, 0.0), covariance },
            extent: [-seen.half, seen.half],
        }
    }

    fn normal(&self) -> Vector2<f64> {
        direction(self.state.mean[0])
    }

    /// Direction along the line, counter-clockwise as seen from its front.
    fn tangent(&self) -> Vector2<f64> {
        let normal = self.normal();
        Vector2::new(-normal[1], normal[0])
    }

    fn offset(&self, [x, y]: [f64; 2]) -> Vector2<f64> {
        Vector2::new(x - self.anchor[0], y - self.anchor[1])
    }

    /// Linearised measurement of the line by its angle and the point `at`.
    fn model(&self, at: [f64; 2], angle: f64, R: Matrix2<f64>) -> Linearised<2, 2> {
        let away = self.offset(at);
        // The position across depends on the angle by the distance along the line.
        let across = self.normal().dot(&away) - self.state.mean[1];
        let slope = -self.tangent().dot(&away);
        Linearised {
            y: Vector2::new(turn(angle - self.state.mean[0]), across),
            H: Matrix2::new(1.0, 0.0, slope, 1.0),
            R,
        }
    }

    /// Gap between the seen part of the line and a piece of half length `half` about `middle` [m];
    /// negative if they overlap.
    fn gap(&self, middle: [f64; 2], half: f64) -> f64 {
        let along = self.tangent().dot(&self.offset(middle));
        (self.extent[0] - along - half).max(along - half - self.extent[1])
    }

    /// Extend the seen part of the line by a piece of half length `half` about `middle` [m].
    fn extend(&mut self, middle: [f64; 2], half: f64) {
        let along = self.tangent().dot(&self.offset(middle));
        self.extent = [self.extent[0].min(along - half), self.extent[1].max(along + half)];
    }

    /// Length of the part that was seen [m].
    pub(super) fn length(&self) -> f64 {
        self.extent[1] - self.extent[0]
    }

    /// Both ends [m], counter-clockwise as seen from the front.
    pub(super) fn ends(&self) -> [[f64; 2]; 2] {
        let (normal, tangent) = (self.normal() * self.state.mean[1], self.tangent());
        self.extent.map(|along| {
            let at = normal + tangent * along;
            [self.anchor[0] + at[0], self.anchor[1] + at[1]]
        })
    }

    fn middle(&self) -> [f64; 2] {
        let [start, end] = self.ends();
        [0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])]
    }

    /// Bearing of the normal [rad], and the covariance of it and of the position across the middle.
    pub(super) fn about_middle(&self) -> (f64, Matrix2<f64>) {
        let H = self.model(self.middle(), 0.0, Matrix2::zeros()).H;
        (turn(self.state.mean[0]), symmetrised(H * self.state.covariance * H.transpose()))
    }

    /// Reported state: middle, at rest, bearing and half length. The covariance contains the
    /// bearing and the position across the line only.
    pub(super) fn reported(&self) -> Gaussian<7> {
        let ([x, y], (angle, P)) = (self.middle(), self.about_middle());
        let heading = turn(angle + FRAC_PI_2);
        let mean = SVector::from([x, y, 0.0, 0.0, heading, 0.5 * self.length(), 0.0]);
        let mut J = SMatrix::<f64, 7, 2>::zeros();
        J[(4, 0)] = 1.0;
        J.fixed_view_mut::<2, 1>(0, 1).copy_from(&self.normal());
        Gaussian { mean, covariance: symmetrised(J * P * J.transpose()) }
    }

    /// True if all `points` [m] lie on the line. `std`: standard deviation of the ranges [m].
    pub(super) fn holds(&self, points: &[[f64; 2]], std: f64, rules: &LineRules) -> bool {
        let mut square = 0.0;
        let mut variance = 0.0;
        for &point in points {
            let model = self.model(point, self.state.mean[0], Matrix2::zeros());
            if self.gap(point, 0.0) > rules.gap {
                return false;
            }
            // The mean square must fit the sum of the variances: single points may be farther off.
            let own = (model.H * self.state.covariance * model.H.transpose())[(1, 1)];
            square += model.y[1] * model.y[1];
            variance += own + std * std + rules.std * rules.std;
        }
        square <= rules.reach * rules.reach * variance
    }

    /// Linearised measurement of a surface that is not exactly straight, and its squared
    /// Mahalanobis distance.
    fn compared(
        &self,
        seen: &LineMeasurement,
        rules: &Rules,
    ) -> Result<(Linearised<2, 2>, f64), Error> {
        let model = self.model(seen.middle, seen.angle, seen.R + seen.bent(rules.lines()));
        let S = symmetrised(model.H * self.state.covariance * model.H.transpose() + model.R);
        let squared = mahalanobis(&model.y, &S)?.squared;
        Ok((model, squared))
    }

    /// Squared Mahalanobis distance of a measurement of the same surface; None for another surface.
    fn distance(&self, seen: &LineMeasurement, rules: &Rules) -> Result<Option<f64>, Error> {
        let turned = turn(seen.angle - self.state.mean[0]).abs();
        if turned > WIDEST || self.gap(seen.middle, seen.half) > rules.lines().gap {
            return Ok(None);
        }
        let (Linearised { y, .. }, squared) = self.compared(seen, rules)?;
        // After many scans the covariance is tighter than real walls are straight. Within the
        // margin of the rays a measurement belongs to the line in any case.
        let farthest = y[1].abs() + seen.half * libm::sin(y[0]).abs();
        let is_same = squared <= rules.line_gate() || farthest <= rules.visibility_test().margin;
        Ok(is_same.then_some(squared))
    }

    /// The line as a measurement.
    fn as_measurement(&self) -> LineMeasurement {
        let (angle, R) = self.about_middle();
        LineMeasurement { middle: self.middle(), angle, half: 0.5 * self.length(), R }
    }
}

impl State for Line {
    type Measurement = LineMeasurement;

    fn new<'a>(seen: &LineMeasurement, _: impl Iterator<Item = &'a Self>, rules: &Rules) -> Self {
        Self::new(seen, rules.lines())
    }

    /// Short lines do not start an element: they may be parts of any object.
    fn is_born(seen: &LineMeasurement, rules: &Rules) -> bool {
        2.0 * seen.half >= rules.lines().length
    }

    /// Predict: the ends move at random across the line.
    fn predict(&mut self, step: &ElementStep) {
        // Two independent ends: the mean of their movements shifts the line, their difference over
        // the length turns it.
        let half = (0.5 * self.length()).max(LEAST_HALF);
        let wander = step.line_variance();
        self.state.covariance += Matrix2::new(wander / (half * half), 0.0, 0.0, wander);
    }

    /// Correct the line. A measurement outside the gate gets a larger covariance, so that it is
    /// inside.
    fn correct(&mut self, seen: &LineMeasurement, rules: &Rules) -> Result<(), Error> {
        let (mut model, squared) = self.compared(seen, rules)?;
        // Without this one bad segment would bend a well known wall.
        model.R *= (squared / rules.line_gate()).max(1.0);
        self.state = update(&self.state, &model)?.posterior;
        self.extend(seen.middle, seen.half);
        Ok(())
    }

    /// Assign every measurement to the line that fits best: a line may be seen in pieces.
    fn associate<'a>(
        all: impl ExactSizeIterator<Item = &'a Self> + Clone,
        seen: &[LineMeasurement],
        _: &[usize],
        _: &Viewpoint,
        rules: &Rules,
    ) -> Result<Vec<Option<usize>>, Error> {
        let mut owners = Vec::with_capacity(seen.len());
        for measurement in seen {
            let mut best: Option<(f64, usize)> = None;
            for (row, line) in all.clone().enumerate() {
                let squared = line.distance(measurement, rules)?;
                if let Some(squared) = squared.filter(|&one| best.is_none_or(|(so, _)| one < so)) {
                    best = Some((squared, row));
                }
            }
            owners.push(best.map(|(_, row)| row));
        }
        Ok(owners)
    }

    fn look(&self, from: &Viewpoint, rules: &Rules) -> CircleVisibility {
        let Some(view) = &from.view else { return CircleVisibility::SeenThrough };
        let ends = self.ends().map(|end| from.pose.level(end, 0.0).center);
        view.of_line(ends, rules.visibility_test())
    }

    fn is_vague(&self, rules: &Rules) -> bool {
        let most = rules.parameters().limits.position;
        self.about_middle().1[(1, 1)] > most * most
    }

    /// True if the shorter line is a piece of the longer one.
    fn is_twin(&self, other: &Self, rules: &Rules) -> bool {
        let (long, short) =
            if self.length() < other.length() { (other, self) } else { (self, other) };
        let squared = long.distance(&short.as_measurement(), rules);
        squared.is_ok_and(|squared| squared.is_some())
    }

    /// Keep the longer line, extended to the ends of both.
    fn absorb(&mut self, mut twin: Self, _: bool) {
        if twin.length() > self.length() {
            std::mem::swap(self, &mut twin);
        }
        self.extend(twin.middle(), 0.5 * twin.length());
    }

    /// Rays that end on a line show that it is there.
    fn is_shown_by_returns() -> bool {
        true
    }

    fn coast(rules: &Rules) -> Option<f64> {
        rules.lines().coast
    }
}
