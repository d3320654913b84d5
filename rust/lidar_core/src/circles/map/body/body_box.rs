//! A box around a body that is not round, including its hidden sides.
//!
//! A scanner sees one or two sides of a body. The circle through them lies nearer to the scanner
//! than the middle, and moves as the body turns or the scanner passes. The box is aligned with the
//! direction of motion. The points of a scan give the position of the sides that face the scanner.
//! A side that does not face the scanner has the distance from them that it had when it was last
//! visible. Before it was visible, this length is guessed from the width, and the covariance
//! contains the uncertainty of the guess.
//!
//! Source: the idea of Granstrom, Reuter, Meissner & Scheel, "A multiple model PHD approach to tracking of cars under
//! an assumed rectangular shape", FUSION 2014: visible sides are measured, and the size is a part of the state.

#![allow(non_snake_case)] // textbook letters

use super::hull::{Hull, along};
use super::look::Look;
use crate::Error;
use crate::circles::map::circle_measurement::{Measures, at_rest};
use crate::circles::map::element_motion::{ElementMotion, ElementStep};
use crate::circles::map::modes::{ElementModes, mixture_of};
use crate::circles::map::rules::Rules;
use crate::estimation::kalman::{Gaussian, Linearised, symmetrised};
use nalgebra::{Matrix4, SMatrix, SVector, Vector2, Vector4};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI};

/// Random walk of the heading [rad^2/s].
const TURN: f64 = 0.05;
/// Standard deviation of a side that faces the scanner [m]: real sides are bent.
const FACING: f64 = 0.02;
/// Standard deviation of a side that ends at a corner [m]: real corners are rounded.
const CORNER: f64 = 0.04;
/// Cosine of the angle between a side's normal and the line of sight above which the side faces the scanner.
const GRAZING: f64 = 0.2;
/// Cosine of the angle between a side's normal and the line of sight above which the whole side is
/// visible.
const OPEN: f64 = 0.7;
/// Half depth of a body that is seen from one side, in half widths.
const DEPTH: f64 = 1.5;
/// Standard deviation of this half depth, in half widths: the depth of the body is not visible.
const DOUBT: f64 = 1.0;
/// Least half length [m].
const LEAST: f64 = 0.03;
/// Standard deviation of the distance between the reference point of a body and the middle of its
/// box, in half lengths: the reference point of a vehicle is often near an axle.
const MIDDLE: f64 = 0.4;
/// Largest distance between the last ray on a body and the first ray that passes it [m].
const GAP: f64 = 0.3;
/// Speed from which on the velocity of a body gives its heading [m/s].
const SPEED: f64 = 0.3;
/// Largest standard deviation of a velocity that gives the heading, as a share of the speed.
const SURE: f64 = 0.5;
/// Standard deviation of the heading from the direction of motion [rad].
const SLIP: f64 = 0.1;
/// Squared distance of a side, in variances, above which it gets less weight.
const FAR: f64 = 16.0;
/// Variance of a side that is not visible [m^2].
const UNSEEN: f64 = 1e4;

/// A box that tracks the sides of a body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct BodyBox {
    /// Centre, velocity, half lengths along the heading and across it.
    state: ElementModes<6>,
    /// Bearing of the first half length [rad].
    heading: f64,
    /// Variance of this bearing [rad^2].
    spread: f64,
    /// True if the body has moved, so that its heading is known.
    has_moved: bool,
}

/// Ends of a body along both axes of its box.
#[derive(Clone, Copy, Debug)]
struct Sides {
    axes: [[f64; 2]; 2],
    /// Low and high end along the first axis, then along the second [m].
    ends: [f64; 4],
    variances: [f64; 4],
    delay: f64,
}

impl Measures<6, 4> for Sides {
    fn against(&self, state: &SVector<f64, 6>) -> Linearised<6, 4> {
        let mut H = SMatrix::<f64, 4, 6>::zeros();
        for side in 0..4 {
            let axis = self.axes[side / 2];
            for place in 0..2 {
                H[(side, place)] = axis[place];
                H[(side, place + 2)] = axis[place] * self.delay;
            }
            H[(side, 4 + side / 2)] = if side % 2 == 0 { -1.0 } else { 1.0 };
        }
        let y = Vector4::from(self.ends) - H * state;
        Linearised { y, H, R: Matrix4::from_diagonal(&Vector4::from(self.variances)) }
    }
}

impl BodyBox {
    /// True if the parts of a restored state agree.
    pub(super) fn fits(&self, motion: &ElementMotion) -> bool {
        self.state.fits(motion)
    }

    /// Box of a body from its first scan: the depth along the line of sight is guessed from the width.
    pub(super) fn new(hull: &Hull, (look, delay): (&Look, f64), rules: &Rules) -> Self {
        let [from_x, from_y] = look.place();
        let middle = [[1.0, 0.0], [0.0, 1.0]].map(|axis| 0.5 * hull.ends(axis).iter().sum::<f64>());
        let heading = libm::atan2(middle[1] - from_y, middle[0] - from_x);
        let axes = axes(heading);
        let [[near, far], [low, high]] = axes.map(|axis| hull.ends(axis));
        let width = (0.5 * (high - low)).max(LEAST);
        let depth = (DEPTH * width).max(0.5 * (far - near));
        let (along, across) = (Vector2::from(axes[0]), Vector2::from(axes[1]));
        let center = along * (near + depth) + across * (0.5 * (low + high));
        let (side, doubt) = (FACING * FACING, DOUBT * DOUBT * width * width);
        let mut R = Matrix4::from_diagonal(&Vector4::new(side, side, doubt, side));
        // The near side is known, so the errors of centre and depth are correlated.
        let mut block = R.fixed_view_mut::<2, 2>(0, 0);
        block += along * along.transpose() * doubt;
        for row in 0..2 {
            R[(row, 2)] = along[row] * doubt;
            R[(2, row)] = R[(row, 2)];
        }
        let z = Vector4::new(center[0], center[1], depth, width);
        let state = ElementModes::new(at_rest(z, R, delay, rules.speed()), rules.motion());
        Self { state, heading, spread: 1.0, has_moved: false }
    }

    pub(super) fn predict(&mut self, step: &ElementStep) {
        self.state.predict(&step.extents);
        self.spread += TURN * step.seconds;
    }

    /// Set the velocity to zero and keep its uncertainty.
    pub(super) fn halt(&mut self) {
        self.state.halt();
    }

    /// Correct with the points of one scan. `is_in_free`: true if earlier scans saw free space at
    /// their place.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]; the box is then half corrected.
    pub(super) fn correct(
        &mut self,
        hull: &Hull,
        (look, delay): (&Look, f64),
        is_in_free: bool,
    ) -> Result<(), Error> {
        // When other parts of a wall come into view, it seems to move: only free space shows motion.
        if is_in_free {
            self.turn();
        }
        let state = self.state.combined();
        let mut sides = self.seen(hull, look, &state);
        sides.delay = delay;
        let Linearised { y, H, R } = sides.against(&state.mean);
        let S = H * state.covariance * H.transpose() + R;
        for side in 0..4 {
            let square = y[side] * y[side];
            if square > FAR * S[(side, side)] {
                sides.variances[side] += square / FAR;
            }
        }
        self.state.correct(&sides, None)
    }

    /// Ends of the body along both axes of the box as one scan shows them, each with its variance [m^2].
    fn seen(&self, hull: &Hull, look: &Look, state: &Gaussian<6>) -> Sides {
        let center = [state.mean[0], state.mean[1]];
        let axes = axes(self.heading);
        let [x, y] = look.place();
        let sight = [x - center[0], y - center[1]];
        let distance = libm::hypot(sight[0], sight[1]).max(1e-9);
        let sines = axes.map(|axis| along(axis, sight) / distance);
        let mut sides = Sides { axes, ends: [0.0; 4], variances: [UNSEEN; 4], delay: 0.0 };
        for side in 0..4 {
            let (number, sign) = (side / 2, if side % 2 == 0 { -1.0 } else { 1.0 });
            let believed = along(axes[number], center) + sign * state.mean[4 + number];
            // A face seen at a grazing angle has wide gaps between its points, so its end is uncertain.
            let open = sines[1 - number].abs();
            let gap = (look.gap(distance) / open.max(0.1)).min(GAP);
            let end = hull.ends(axes[number])[side % 2];
            let is_out = sign * (end - believed) > 0.0;
            let is_near = sign * sines[number] > 0.0;
            let (beyond, std) = if is_near && sines[number].abs() > GRAZING {
                (0.0, FACING)
            } else if is_near {
                (gap, FACING)
            } else if open >= OPEN && !hull.is_covered() {
                (gap, CORNER)
            } else if is_out {
                // It is at least as long as it is seen.
                (0.0, CORNER)
            } else {
                sides.ends[side] = believed;
                continue;
            };
            // The end is anywhere between the last ray and the first that passes.
            sides.ends[side] = end + sign * 0.5 * beyond;
            sides.variances[side] = std * std + beyond * beyond / 12.0;
        }
        sides
    }

    /// Turn the heading towards the direction of motion, if the velocity is known well enough.
    fn turn(&mut self) {
        let Gaussian { mean, covariance } = self.state.combined();
        let speed = libm::hypot(mean[2], mean[3]);
        let std = (0.5 * (covariance[(2, 2)] + covariance[(3, 3)])).sqrt();
        if speed < SPEED || std > SURE * speed {
            return;
        }
        let motion = libm::atan2(mean[3], mean[2]);
        if !self.has_moved {
            // The box looks the same after each quarter turn: the heading turns by the least that fits its motion.
            let quarters = libm::round((motion - self.heading) / FRAC_PI_2);
            if quarters.rem_euclid(2.0) > 0.5 {
                self.state.swap(4, 5);
            }
            self.heading += quarters * FRAC_PI_2;
            self.has_moved = true;
        }
        let off = motion - self.heading;
        let off = off - PI * libm::round(off / PI); // a box has no front
        let share = std / speed;
        let gain = self.spread / (self.spread + share * share + SLIP * SLIP);
        self.heading += gain * off;
        self.heading -= 2.0 * PI * libm::round(self.heading / (2.0 * PI));
        self.spread *= 1.0 - gain;
    }

    /// True if the body has moved.
    pub(super) fn has_moved(&self) -> bool {
        self.has_moved
    }

    /// Probability that the body stands.
    pub(super) fn standing(&self, motion: &ElementMotion) -> f64 {
        self.state.standing(motion)
    }

    /// True if both half lengths are positive.
    pub(super) fn is_sound(&self) -> bool {
        let mean = self.state.combined().mean;
        mean[4] > 0.0 && mean[5] > 0.0
    }

    /// Centre, velocity and the mean of both half lengths. The covariance contains the distance
    /// between the reference point of the body and the middle of the box.
    pub(super) fn circle(&self) -> Gaussian<5> {
        let Gaussian { mean, covariance } = self.state.combined();
        let mut J = SMatrix::<f64, 5, 6>::zeros();
        for row in 0..4 {
            J[(row, row)] = 1.0;
        }
        (J[(4, 4)], J[(4, 5)]) = (0.5, 0.5);
        let mut P = J * covariance * J.transpose();
        for (number, axis) in axes(self.heading).map(Vector2::from).into_iter().enumerate() {
            let off = MIDDLE * mean[4 + number];
            let mut block = P.fixed_view_mut::<2, 2>(0, 0);
            block += axis * axis.transpose() * (off * off);
        }
        Gaussian { mean: J * mean, covariance: symmetrised(P) }
    }

    /// Mixture of this box, with the probability `share`, and `circle`.
    pub(super) fn mixed(&self, circle: Gaussian<5>, share: f64) -> Gaussian<5> {
        mixture_of(&[circle, self.circle()], &[1.0 - share, share])
    }
}

/// Axes of a box with this heading.
fn axes(heading: f64) -> [[f64; 2]; 2] {
    let (sine, cosine) = (libm::sin(heading), libm::cos(heading));
    [[cosine, sine], [-sine, cosine]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circles::map::view::level_pose::LevelPose;
    use crate::circles::map::{CircleMapParameters, ElementFilter};
    use crate::geometry::transform::Transform;

    const LENGTH: f64 = 0.5;
    const WIDTH: f64 = 0.2;
    const STEP: f64 = 0.05;
    /// Of what a test has and does not find.
    const NOTHING: Error = Error::NotPositiveDefinite { matrix: "none" };

    fn rules() -> Result<Rules, Error> {
        let parameters = CircleMapParameters::default();
        let ElementFilter::Independent(independent) = parameters.filter else {
            return Err(NOTHING);
        };
        Rules::new(independent, parameters.gate_probability, parameters.initial_speed)
    }

    fn look() -> Look {
        let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        Look::new(&LevelPose::of(&Transform { rotation, translation: [0.0; 3] }), 0.005)
    }

    /// What the origin sees of a box with this centre, along x: points on the sides that face it.
    fn seen(x: f64, y: f64) -> Result<Hull, Error> {
        let ends = [x - 0.5 * LENGTH, x + 0.5 * LENGTH];
        let mut points = Vec::new();
        let back = if ends[0] > 0.0 { Some(ends[0]) } else { Some(ends[1]).filter(|&x| x < 0.0) };
        for part in 0..=10 {
            let share = f64::from(part) / 10.0;
            if y > 0.5 * WIDTH {
                points.push([ends[0] + share * LENGTH, y - 0.5 * WIDTH]);
            }
            points.extend(back.map(|x| [x, y + (share - 0.5) * WIDTH]));
        }
        Hull::of(&points, false).ok_or(NOTHING)
    }

    /// Boxes while one drives at 1 m/s along x from `from` to `to`, at y.
    fn driven(from: f64, to: f64, y: f64) -> Result<Vec<(f64, BodyBox)>, Error> {
        let (rules, look) = (rules()?, look());
        let step = rules.motion().step(STEP);
        let mut extent = BodyBox::new(&seen(from, y)?, (&look, 0.0), &rules);
        let mut all = vec![(from, extent.clone())];
        while let Some(&(x, _)) = all.last()
            && x < to
        {
            extent.predict(&step);
            extent.correct(&seen(x + STEP, y)?, (&look, 0.0), true)?;
            all.push((x + STEP, extent.clone()));
        }
        Ok(all)
    }

    fn off(x: f64, y: f64, extent: &BodyBox) -> [f64; 2] {
        let mean = extent.circle().mean;
        [mean[0] - x, mean[1] - y]
    }

    #[test]
    fn a_side_once_seen_is_remembered() -> Result<(), Error> {
        let all = driven(-3.0, 3.0, 0.8)?;
        let (x, last) = all.last().ok_or(NOTHING)?;
        // It shows its back only, and half its side under a small angle.
        let [along, across] = off(*x, 0.8, last);
        assert!(along.abs() < 0.06 && across.abs() < 0.04, "{along} {across}");
        let half = last.state.combined().mean;
        assert!((half[4] - 0.5 * LENGTH).abs() < 0.05, "{half}");
        assert!((last.circle().mean[2] - 1.0).abs() < 0.1);
        for (x, extent) in all.iter().skip(60) {
            let circle = extent.circle();
            let error = Vector2::from(off(*x, 0.8, extent));
            let P = circle.covariance.fixed_view::<2, 2>(0, 0).into_owned();
            let squared = P.try_inverse().map_or(f64::NAN, |inverse| error.dot(&(inverse * error)));
            assert!(squared < 5.99, "{x}: {squared}");
        }
        Ok(())
    }

    #[test]
    fn a_side_never_seen_stays_unknown() -> Result<(), Error> {
        let all = driven(1.0, 4.0, 0.0)?;
        for (x, extent) in &all {
            let circle = extent.circle();
            assert!(circle.covariance[(0, 0)].sqrt() > 0.05, "{x}");
            let [along, across] = off(*x, 0.0, extent);
            assert!(along < 0.0 && along.abs() < 3.0 * circle.covariance[(0, 0)].sqrt());
            assert!(across.abs() < 0.02);
        }
        Ok(())
    }

    #[test]
    fn what_hides_a_side_does_not_make_it_shorter() -> Result<(), Error> {
        let all = driven(-3.0, 0.0, 0.8)?;
        let (x, extent) = all.last().ok_or(NOTHING)?;
        let half = |is_covered: bool| -> Result<f64, Error> {
            let mut extent = extent.clone();
            for number in 0..10 {
                let x = x + STEP * f64::from(number + 1);
                // Only its rear quarter is seen.
                let quarter = [x - 0.5 * LENGTH, x - 0.25 * LENGTH].map(|x| [x, 0.7]);
                let hull = Hull::of(&quarter, is_covered).ok_or(NOTHING)?;
                extent.predict(&rules()?.motion().step(STEP));
                extent.correct(&hull, (&look(), 0.0), true)?;
            }
            Ok(extent.state.combined().mean[4])
        };
        assert!((half(true)? - 0.5 * LENGTH).abs() < 0.05);
        // An end in the open is measured.
        assert!(half(false)? < half(true)?);
        Ok(())
    }
}
