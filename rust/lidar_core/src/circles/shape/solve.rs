//! Least squares of ranges for any shape.

use crate::circles::fit::arc::Arc;
use nalgebra::{SMatrix, SVector};

/// Largest residual of a range [m]: a ray that passes a shape has no range.
const LARGEST: f64 = 0.5;
const MOST_STEPS: usize = 30;
/// The search ends when the misfit falls by less.
const ENOUGH: f64 = 1e-4;
/// Standard deviation of unmeasured parameters [m], [rad].
const UNKNOWN: f64 = 1.0;

/// A shape of K parameters.
pub(super) trait FittedShape<const K: usize> {
    /// Append the expected ranges of the hits of the arc [m].
    fn ranges(&self, parameters: &[f64; K], ranges: &mut Vec<f64>);
}

/// Parameters with least misfit to an arc.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solved<const K: usize> {
    pub(super) parameters: [f64; K],
    pub(super) covariance: SMatrix<f64, K, K>,
    /// Sum of squared residuals, in variances.
    pub(super) misfit: f64,
}

struct Problem<'a, S> {
    shape: &'a S,
    arc: &'a Arc,
    std: f64,
}

impl<S> Problem<'_, S> {
    fn residuals<const K: usize>(&self, parameters: &[f64; K], into: &mut Vec<f64>)
    where
        S: FittedShape<K>,
    {
        into.clear();
        self.shape.ranges(parameters, into);
        for (value, hit) in into.iter_mut().zip(&self.arc.hits) {
            let apart = hit.range - *value;
            // A hit that the shape misses has to cost something, but an infinite residual would
            // leave no direction to improve.
            let apart = if apart.is_finite() { apart.clamp(-LARGEST, LARGEST) } else { LARGEST };
            *value = hit.weight.sqrt() * apart / self.std;
        }
    }
}

fn square(residuals: &[f64]) -> f64 {
    residuals.iter().map(|residual| residual * residual).sum()
}

/// Minimise from `start` (Levenberg-Marquardt, numerical derivatives with `step`).
pub(super) fn solve<const K: usize>(
    shape: &impl FittedShape<K>,
    arc: &Arc,
    std: f64,
    start: [f64; K],
    step: f64,
) -> Solved<K> {
    let problem = Problem { shape, arc, std };
    let (mut residuals, mut moved) = (Vec::new(), Vec::new());
    problem.residuals(&start, &mut residuals);
    let (mut at, mut misfit, mut damping) = (start, square(&residuals), 1e-2);
    let mut normal = normal_equations(&problem, &at, &residuals, step, &mut moved);
    for _ in 0..MOST_STEPS {
        let (hessian, gradient) = normal;
        let factor = damped(&hessian, damping).cholesky();
        let Some(by) = factor.map(|factor| factor.solve(&gradient)) else { break };
        let next: [f64; K] = std::array::from_fn(|k| at[k] - by[k]);
        problem.residuals(&next, &mut moved);
        let fall = misfit - square(&moved);
        if fall > 0.0 {
            (at, misfit) = (next, misfit - fall);
            std::mem::swap(&mut residuals, &mut moved);
            if fall < ENOUGH {
                break;
            }
            damping = (damping * 0.2).max(1e-9);
            normal = normal_equations(&problem, &at, &residuals, step, &mut moved);
        } else {
            damping *= 8.0;
            if damping > 1e7 {
                break;
            }
        }
    }
    let (hessian, _) = normal_equations(&problem, &at, &residuals, step, &mut moved);
    Solved { parameters: at, covariance: spread(hessian), misfit }
}

/// Covariance of parameters with these second derivatives.
fn spread<const K: usize>(hessian: SMatrix<f64, K, K>) -> SMatrix<f64, K, K> {
    // A parameter that no range depends on gets the variance UNKNOWN^2, not a singular matrix.
    let known = hessian + SMatrix::identity() / (UNKNOWN * UNKNOWN);
    known.cholesky().map_or_else(SMatrix::identity, |factor| factor.inverse())
}

/// `hessian` with a diagonal larger by the share `damping`.
fn damped<const K: usize>(hessian: &SMatrix<f64, K, K>, damping: f64) -> SMatrix<f64, K, K> {
    let mut damped = *hessian;
    for k in 0..K {
        // The constant keeps a parameter that no range depends on solvable.
        damped[(k, k)] += damping * hessian[(k, k)] + 1e-9;
    }
    damped
}

/// Decrease of the misfit from `at` to its minimum, to first order.
pub(super) fn gain<const K: usize>(
    shape: &impl FittedShape<K>,
    arc: &Arc,
    std: f64,
    at: &[f64; K],
    step: f64,
) -> f64 {
    let problem = Problem { shape, arc, std };
    let (mut residuals, mut moved) = (Vec::new(), Vec::new());
    problem.residuals(at, &mut residuals);
    let (hessian, gradient) = normal_equations(&problem, at, &residuals, step, &mut moved);
    let known = hessian + SMatrix::identity();
    known.cholesky().map_or(f64::INFINITY, |factor| gradient.dot(&factor.solve(&gradient)))
}

type NormalEquations<const K: usize> = (SMatrix<f64, K, K>, SVector<f64, K>);

/// Half the second derivatives and half the gradient of the misfit.
fn normal_equations<const K: usize, S: FittedShape<K>>(
    problem: &Problem<'_, S>,
    at: &[f64; K],
    residuals: &[f64],
    step: f64,
    moved: &mut Vec<f64>,
) -> NormalEquations<K> {
    let mut columns: [Vec<f64>; K] = std::array::from_fn(|_| Vec::new());
    for (k, column) in columns.iter_mut().enumerate() {
        let mut there = *at;
        there[k] += step;
        problem.residuals(&there, moved);
        column.extend(moved.iter().zip(residuals).map(|(there, here)| (there - here) / step));
    }
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    (
        SMatrix::from_fn(|i, j| dot(&columns[i], &columns[j])),
        SVector::from_fn(|i, _| dot(&columns[i], residuals)),
    )
}
