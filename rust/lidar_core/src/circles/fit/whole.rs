//! Circles larger than `FitParameters::radius` allows, of which both sides are seen.
//!
//! A part of a large circle looks like a piece of a wall, so that the largest radius bounds every
//! circle whose sides may be hidden. Where free space begins on both sides of an arc, its tangents
//! are known: between them a circle of radius r at the distance d bulges by r (1 - r / d), and a wall
//! does not.

use super::arc::{Arc, Hit};
use super::circle::CircleEstimate;
use super::likelihood::Likelihood;
use super::posterior::Posterior;
use super::{FitParameters, algebraic, estimate};

/// Largest radius of a circle that is seen from side to side, in largest radii of any other.
pub(in crate::circles) const WHOLE: f64 = 3.0;
/// Share of the largest radius above which a circle may be limited by it.
const LIMITED: f64 = 0.8;

/// Largest mean square distance of the hits from such a circle, in variances of a range: between two
/// known tangents nothing but the distance is left to fit.
const MISFIT: f64 = 4.0;

/// Circle of an arc on whose both sides space is free, and its misfit; None if it is not larger than
/// usual, or none explains the rays.
pub(in crate::circles) fn whole(
    arc: &Arc,
    parameters: &FitParameters,
    posterior: &mut Posterior,
) -> Option<(CircleEstimate, f64)> {
    let [least, most] = parameters.radius;
    if width(arc) <= most {
        return None;
    }
    let wide = FitParameters { radius: [least, WHOLE * most], ..*parameters };
    // Most wide arcs are walls: the algebraic circle rules them out in one loop over the hits.
    let ([.., radius], _) = algebraic::fit(arc, &wide);
    if !(LIMITED * most..WHOLE * most).contains(&radius) {
        return None;
    }
    let found = posterior.of(&Likelihood { arc, parameters: &wide })?;
    let misfit = -2.0 * posterior.log_likelihood()?;
    (misfit < MISFIT * arc.n_hits as f64).then(|| (estimate(arc, &wide, Some(found)), misfit))
}

/// Length from the first hit to the last one [m].
pub(in crate::circles) fn width(arc: &Arc) -> f64 {
    let (Some(first), Some(last)) = (arc.hits.first(), arc.hits.last()) else {
        return 0.0;
    };
    let at = |hit: &Hit| [hit.range * hit.cosine, hit.range * hit.sine];
    let ([x, y], [to_x, to_y]) = (at(first), at(last));
    libm::hypot(to_x - x, to_y - y)
}
