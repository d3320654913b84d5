//! Circles larger than `FitParameters::radius` allows, of which one side is visible.
//!
//! A part of a large circle looks like a piece of a wall, so the largest radius bounds every circle
//! whose sides may be hidden. If free space begins beside an arc, its tangent is known: a circle
//! recedes there until rays graze it, and a wall ends. With both tangents, only the distance is
//! fitted; with one of them, the arc itself must determine the radius.

use super::arc::{Arc, Hit};
use super::circle::CircleEstimate;
use super::likelihood::Likelihood;
use super::posterior::Posterior;
use super::{FitParameters, algebraic, estimate};

/// Largest radius of a circle beside which free space begins, in units of the largest radius of all
/// other circles.
const WHOLE: f64 = 3.0;
/// Share of the largest radius above which a circle may be limited by it.
const LIMITED: f64 = 0.8;
/// Largest mean square distance of the hits from a circle above the usual largest radius, in
/// variances of a range.
const MISFIT: f64 = 4.0;
/// Largest standard deviation of the radius of such a large circle, as a share of its radius.
const KNOWN: f64 = 0.05;

impl FitParameters {
    /// These parameters with a largest radius that is three times as large, for circles beside
    /// which free space begins.
    pub(in crate::circles) fn of_whole(&self) -> Self {
        let [least, most] = self.radius;
        Self { radius: [least, WHOLE * most], ..*self }
    }

    /// True if the hits of an arc may show a circle that is too large for these parameters.
    ///
    /// Most wide arcs are walls: the algebraic circle rules them out in one loop over the hits.
    pub(in crate::circles) fn is_exceeded(&self, arc: &Arc) -> bool {
        let most = self.radius[1];
        if width(arc) <= most {
            return false;
        }
        let ([.., radius], _) = algebraic::fit(arc, &self.of_whole());
        (LIMITED * most..WHOLE * most).contains(&radius)
    }
}

/// Circle of an arc that was read with the parameters [`FitParameters::of_whole`], and its misfit;
/// None if no such circle explains the rays, or if they leave its radius open.
pub(in crate::circles) fn whole(
    arc: &Arc,
    wide: &FitParameters,
    posterior: &mut Posterior,
) -> Option<(CircleEstimate, f64)> {
    let found = posterior.of(&Likelihood { arc, parameters: wide })?;
    let misfit = -2.0 * posterior.log_likelihood()?;
    let circle = estimate(arc, wide, Some(found));
    let (radius, variance) = (circle.circle.radius, circle.covariance[2][2]);
    let is_known = variance < KNOWN * KNOWN * radius * radius;
    (is_known && misfit < MISFIT * arc.n_hits as f64).then_some((circle, misfit))
}

/// Distance between the first hit of an arc and its last one [m]; 0 without hits.
pub(in crate::circles) fn width(arc: &Arc) -> f64 {
    let (Some(first), Some(last)) = (arc.hits.first(), arc.hits.last()) else {
        return 0.0;
    };
    let at = |hit: &Hit| [hit.range * hit.cosine, hit.range * hit.sine];
    let ([x, y], [to_x, to_y]) = (at(first), at(last));
    libm::hypot(to_x - x, to_y - y)
}
