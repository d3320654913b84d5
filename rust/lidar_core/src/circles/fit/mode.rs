//! Minimum of the misfit within bounds of the roots.

use super::likelihood::{Likelihood, MisfitDerivatives, Roots};

/// Lowest and highest value of each of the two roots (see [`Roots`]) [rad^(1/2)].
pub(super) type RootBounds = [[f64; 2]; 2];

/// A minimum of the misfit and its derivatives there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MisfitMinimum {
    pub(super) roots: Roots,
    pub(super) normal: MisfitDerivatives,
}

/// Largest number of steps of the search for the minimum.
const MOST_STEPS: usize = 25;
/// The search ends when the misfit falls by less than this in one step.
const ENOUGH: f64 = 1e-9;
/// Start values per side, as shares of the bounds.
const STARTS: [f64; 3] = [0.15, 0.5, 0.85];

/// Least distance of a root from its lower bound, as a share of the range: at a tangent through a
/// hit the derivatives vanish.
pub(super) const LEAST_SHARE: f64 = 0.01;

/// Minimum of the misfit within `bounds`, searched from the best of a few starts
/// (Levenberg-Marquardt, projected on the bounds).
pub(super) fn mode(likelihood: &Likelihood<'_>, bounds: &RootBounds) -> MisfitMinimum {
    let bounds = &bounds.map(|[low, high]| [low + LEAST_SHARE * (high - low), high]);
    let mut best =
        MisfitMinimum { roots: [0.0; 2], normal: likelihood.normal(inside([0.5; 2], bounds)) };
    best.normal.misfit = f64::INFINITY;
    // The misfit may have several minima: the descent begins at the best point of a grid.
    for low in STARTS {
        for high in STARTS {
            let roots = inside([low, high], bounds);
            let normal = likelihood.normal(roots);
            if normal.misfit < best.normal.misfit {
                best = MisfitMinimum { roots, normal };
            }
        }
    }
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        let roots = step(&best, damping, bounds);
        let normal = likelihood.normal(roots);
        let fall = best.normal.misfit - normal.misfit;
        if fall >= 0.0 {
            best = MisfitMinimum { roots, normal };
            // Nearly a Newton step after success, nearly steepest descent after failure.
            damping = (damping * 0.1).max(1e-9);
            if fall < ENOUGH {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e9 {
                break;
            }
        }
    }
    best
}

fn inside(shares: [f64; 2], bounds: &RootBounds) -> Roots {
    [0, 1].map(|side| {
        let [low, high] = bounds[side];
        low + shares[side] * (high - low)
    })
}

/// True if the root of `side` is at a bound and the gradient points beyond it.
pub(super) fn is_held(mode: &MisfitMinimum, side: usize, bounds: &RootBounds) -> bool {
    let ([low, high], root) = (bounds[side], mode.roots[side]);
    let gradient = mode.normal.gradient[side];
    (root <= low && gradient > 0.0) || (root >= high && gradient < 0.0)
}

fn step(from: &MisfitMinimum, damping: f64, bounds: &RootBounds) -> Roots {
    let MisfitDerivatives { gradient: [g0, g1], hessian: [h00, h01, h11], .. } = from.normal;
    let held = [is_held(from, 0, bounds), is_held(from, 1, bounds)];
    // The small constant keeps a direction without curvature (a single hit) from a division by
    // zero.
    let (d0, d1) = (h00 * (1.0 + damping) + 1e-12, h11 * (1.0 + damping) + 1e-12);
    // A root at its bound does not move, so the other one is solved for alone.
    let cross = if held[0] || held[1] { 0.0 } else { h01 };
    let determinant = d0 * d1 - cross * cross;
    let mut move0 = -(d1 * g0 - cross * g1) / determinant;
    let mut move1 = -(d0 * g1 - cross * g0) / determinant;
    move0 = if held[0] { 0.0 } else { move0 };
    move1 = if held[1] { 0.0 } else { move1 };
    [
        (from.roots[0] + move0).clamp(bounds[0][0], bounds[0][1]),
        (from.roots[1] + move1).clamp(bounds[1][0], bounds[1][1]),
    ]
}
