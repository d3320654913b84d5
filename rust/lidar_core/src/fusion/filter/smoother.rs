//! Rauch-Tung-Striebel smoother over a whole run or with a fixed lag.

#![allow(non_snake_case)] // textbook letters

use super::engine::{Link, MAX_STATES, Output};
use crate::estimation::kalman::symmetrised;
use crate::fusion::models::turn::wrapped;
use nalgebra::{SMatrix, SVector};

/// Largest number of states of a model in the plane.
const IN_PLANE: usize = 6;

/// One step of a run: state of the filter, its time, and the transition from the previous step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunRow {
    /// Time of the state [ns].
    pub stamp_ns: i64,
    /// Output of the filter; None before the target has been seen.
    pub output: Option<Output>,
    /// Transition from the previous step to this one; None where a target starts.
    pub link: Option<Link>,
}

/// Smoothed states, each given the measurements up to `lag_ns` after it, or all measurements.
///
/// Covariances are sums of squares: they stay positive semidefinite.
///
/// # Source
/// Rauch, Tung & Striebel, "Maximum likelihood estimates of linear dynamic systems", 1965.
#[must_use]
pub fn smoothed(rows: &[RunRow], lag_ns: Option<i64>) -> Vec<Option<Output>> {
    let Some(lag_ns) = lag_ns else { return back_from(rows, rows.len(), 0) };
    let mut last = 0;
    (0..rows.len())
        .map(|first| {
            let until = rows[first].stamp_ns.saturating_add(lag_ns);
            last = last.max(first);
            while rows.get(last + 1).is_some_and(|row| row.stamp_ns <= until) {
                last += 1;
            }
            back_from(rows, last + 1, first).first().copied().flatten()
        })
        .collect()
}

/// Smoothed states of the steps from `first` to before `end`, given the measurements of the steps
/// before `end`.
fn back_from(rows: &[RunRow], end: usize, first: usize) -> Vec<Option<Output>> {
    let mut states: Vec<Option<Output>> = rows[first..end].iter().map(|row| row.output).collect();
    for index in (first + 1..end).rev() {
        let (earlier, later) = (states[index - 1 - first], states[index - first]);
        if let (Some(link), Some(earlier), Some(later)) = (&rows[index].link, earlier, later) {
            states[index - 1 - first] = Some(step_back(&earlier, link, &later).unwrap_or(earlier));
        }
    }
    states
}

/// State `earlier` corrected by the smoothed state after it; None if the covariance is singular.
fn step_back(earlier: &Output, link: &Link, later: &Output) -> Option<Output> {
    // Models in the plane have six states at most: padded to nine they would take three times as
    // long.
    if earlier.count <= IN_PLANE {
        return step_back_in::<IN_PLANE>(earlier, link, later);
    }
    step_back_in::<MAX_STATES>(earlier, link, later)
}

/// One smoother step with states padded to S.
fn step_back_in<const S: usize>(earlier: &Output, link: &Link, later: &Output) -> Option<Output> {
    let (m, P) = padded::<S>(earlier);
    let (ms, Ps) = padded::<S>(later);
    let F = &link.F.fixed_view::<S, S>(0, 0).into_owned();
    let Q = &link.Q.fixed_view::<S, S>(0, 0).into_owned();
    let FP = F * P;
    let predicted = symmetrised(FP * F.transpose() + Q);
    let G = solved(&predicted, FP)?.transpose();
    let mut change = ms - link.mean.fixed_rows::<S>(0);
    // The smoothed heading is wrapped, the predicted one is not: a full turn is no change.
    if let Some(index) = link.heading {
        change[index] = wrapped(change[index]);
    }
    for index in earlier.count..S {
        change[index] = 0.0;
    }
    // Joseph form of the smoother: a sum of squares, where P + G (Ps - predicted) G' could turn
    // indefinite by rounding.
    let kept = SMatrix::identity() - G * F;
    let P = symmetrised(kept * P * kept.transpose() + G * (Q + Ps) * G.transpose());
    let mut mean = m + G * change;
    if let Some(index) = link.heading {
        mean[index] = wrapped(mean[index]);
    }
    let finite = mean.iter().chain(P.iter()).all(|value| value.is_finite());
    finite.then(|| cut(earlier.count, &mean, &P))
}

/// Solution X of `P` X = `B`; None unless `P` is positive definite.
fn solved<const S: usize>(
    P: &SMatrix<f64, S, S>,
    B: SMatrix<f64, S, S>,
) -> Option<SMatrix<f64, S, S>> {
    Some(P.cholesky()?.solve(&B))
}

/// Mean and covariance of S states; states that the model does not have get unit covariance, so
/// that the predicted covariance stays invertible.
fn padded<const S: usize>(output: &Output) -> (SVector<f64, S>, SMatrix<f64, S, S>) {
    let mut P = SMatrix::<f64, S, S>::from_fn(|row, column| output.covariance[row][column]);
    for index in output.count..S {
        P[(index, index)] = 1.0;
    }
    (SVector::from_fn(|row, _| output.mean[row]), P)
}

fn cut<const S: usize>(count: usize, mean: &SVector<f64, S>, P: &SMatrix<f64, S, S>) -> Output {
    let mut covariance = [[0.0; MAX_STATES]; MAX_STATES];
    for (row, entries) in covariance.iter_mut().enumerate().take(count) {
        for (column, entry) in entries.iter_mut().enumerate().take(count) {
            *entry = P[(row, column)];
        }
    }
    let mut wide = [0.0; MAX_STATES];
    wide[..S].copy_from_slice(mean.as_slice());
    Output { count, mean: wide, covariance }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn output(mean: [f64; 2], covariance: [[f64; 2]; 2]) -> Output {
        let mut wide = Output { count: 2, mean: [0.0; 9], covariance: [[0.0; 9]; 9] };
        wide.mean[..2].copy_from_slice(&mean);
        for (row, entries) in wide.covariance.iter_mut().zip(&covariance) {
            row[..2].copy_from_slice(entries);
        }
        wide
    }

    /// A point that stands still: the smoother knows at the start what the filter knows at the end.
    #[test]
    fn what_does_not_move_is_known_from_the_end() {
        let link = Link {
            F: SMatrix::identity(),
            Q: SMatrix::zeros(),
            mean: SVector::zeros(),
            heading: None,
        };
        let first = output([0.0, 0.0], [[4.0, 1.0], [1.0, 2.0]]);
        let last = output([1.0, -1.0], [[0.5, 0.1], [0.1, 0.3]]);
        let row = |stamp_ns, output, link| RunRow { stamp_ns, output: Some(output), link };
        let rows = [row(0, first, None), row(10, last, Some(link))];
        let whole = smoothed(&rows, None);
        assert!(whole[0].is_some_and(|got| {
            let far = got.mean.iter().zip(last.mean).map(|(a, b)| (a - b).abs());
            let wide = got.covariance.as_flattened().iter().zip(last.covariance.as_flattened());
            far.chain(wide.map(|(a, b)| (a - b).abs())).all(|difference| difference < 1e-12)
        }));
        assert_eq!(smoothed(&rows, Some(9)), vec![Some(first), Some(last)]);
        assert_eq!(smoothed(&rows, Some(10)), whole);
    }
}
