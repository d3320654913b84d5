//! Least squares of ranges for any shape.

use crate::circles::fit::arc::{Arc, Hit};
use nalgebra::{SMatrix, SVector};

/// Largest residual of a range [m]: a ray that passes a shape has no range.
const LARGEST: f64 = 0.5;
/// Largest number of steps of the search for the minimum.
const MOST_STEPS: usize = 30;
/// The search ends when the misfit falls by less than this in one step.
const ENOUGH: f64 = 1e-4;
/// Standard deviation of unmeasured parameters [m], [rad].
const UNKNOWN: f64 = 1.0;
/// The search also ends where this many times the fall of the misfit that the second derivatives
/// predict does not lead to the misfit that is asked for: near a minimum the prediction is nearly
/// right, far from it, it is large.
const PROMISES: f64 = 3.0;

/// A shape of K parameters.
pub(super) trait FittedShape<const K: usize> {
    /// Expected range of a hit [m], and its derivatives by the parameters.
    fn range(&self, parameters: &[f64; K]) -> impl Fn(&Hit) -> (f64, [f64; K]);
}

/// Parameters with least misfit to an arc.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solved<const K: usize> {
    pub(super) parameters: [f64; K],
    pub(super) covariance: SMatrix<f64, K, K>,
    /// Sum of squared residuals, in variances.
    pub(super) misfit: f64,
}

/// Misfit of a shape, half its second derivatives and half its gradient.
#[derive(Clone, Copy)]
struct NormalEquations<const K: usize> {
    misfit: f64,
    hessian: SMatrix<f64, K, K>,
    gradient: SVector<f64, K>,
}

impl<const K: usize> NormalEquations<K> {
    fn of(shape: &impl FittedShape<K>, arc: &Arc, std: f64, at: &[f64; K]) -> Self {
        let range = shape.range(at);
        let mut sums = Self { misfit: 0.0, hessian: SMatrix::zeros(), gradient: SVector::zeros() };
        for hit in &arc.hits {
            let (expected, by) = range(hit);
            let apart = hit.range - expected;
            let weight = hit.weight / (std * std);
            if apart.abs() < LARGEST {
                sums.misfit += weight * apart * apart;
                for i in 0..K {
                    sums.gradient[i] -= weight * by[i] * apart;
                    for j in 0..=i {
                        sums.hessian[(i, j)] += weight * by[i] * by[j];
                    }
                }
            } else {
                // A hit that the shape misses has to cost something, but an infinite residual would
                // leave no direction to improve.
                sums.misfit += weight * LARGEST * LARGEST;
            }
        }
        sums.hessian.fill_upper_triangle_with_lower_triangle();
        sums
    }

    /// Step to the minimum that the second derivatives predict, with a diagonal larger by the share
    /// `damping`; None without curvature.
    fn step(&self, damping: f64) -> Option<SVector<f64, K>> {
        let mut damped = self.hessian;
        for k in 0..K {
            // The constant keeps a parameter that no range depends on solvable.
            damped[(k, k)] += damping * self.hessian[(k, k)] + 1e-9;
        }
        Some(-damped.cholesky()?.solve(&self.gradient))
    }

    /// Fall of the misfit from here to its minimum that the second derivatives predict.
    fn promise(&self) -> f64 {
        let known = self.hessian + SMatrix::identity();
        let factor = known.cholesky();
        factor.map_or(f64::INFINITY, |factor| self.gradient.dot(&factor.solve(&self.gradient)))
    }

    /// Covariance of the parameters.
    fn covariance(&self) -> SMatrix<f64, K, K> {
        // A parameter that no range depends on gets the variance UNKNOWN^2, not a singular matrix.
        let known = self.hessian + SMatrix::identity() / (UNKNOWN * UNKNOWN);
        known.cholesky().map_or_else(SMatrix::identity, |factor| factor.inverse())
    }
}

/// Minimise from `start` (Levenberg-Marquardt); None where no misfit below `most` is in reach.
pub(super) fn solve<const K: usize>(
    shape: &impl FittedShape<K>,
    arc: &Arc,
    std: f64,
    start: [f64; K],
    most: f64,
) -> Option<Solved<K>> {
    let (mut at, mut damping) = (start, 1e-2);
    let mut normal = NormalEquations::of(shape, arc, std, &at);
    for _ in 0..MOST_STEPS {
        let Some(by) = normal.step(damping) else { break };
        let next: [f64; K] = std::array::from_fn(|k| at[k] + by[k]);
        let there = NormalEquations::of(shape, arc, std, &next);
        let fall = normal.misfit - there.misfit;
        if fall > 0.0 {
            (at, normal) = (next, there);
            if fall < ENOUGH {
                break;
            }
            if normal.misfit - PROMISES * normal.promise() > most {
                return None;
            }
            damping = (damping * 0.2).max(1e-9);
        } else {
            damping *= 8.0;
            if damping > 1e7 {
                break;
            }
        }
    }
    (normal.misfit < most).then(|| Solved {
        parameters: at,
        covariance: normal.covariance(),
        misfit: normal.misfit,
    })
}

/// Decrease of the misfit from `at` to its minimum, to first order.
pub(super) fn gain<const K: usize>(
    shape: &impl FittedShape<K>,
    arc: &Arc,
    std: f64,
    at: &[f64; K],
) -> f64 {
    NormalEquations::of(shape, arc, std, at).promise()
}
