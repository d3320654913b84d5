//! Filters with sigma points, in square-root form: unscented and cubature.

#![allow(non_snake_case)] // textbook letters

use super::engine::{AcceptInnovation, Engine, Innovation, Link, Output, Single, mixed, output};
use crate::Error;
use crate::estimation::kalman::{Gaussian, Mahalanobis};
use crate::estimation::unscented::{Rooted, SigmaRule, Triangle, stacked, transformed};
use crate::fusion::models::motion::First;
use crate::fusion::models::platform::Platform;
use crate::fusion::models::world::World;
use crate::fusion::sensors::measurement::Measurement;
use crate::fusion::sensors::sight::{Observer, SeenIn, SeenMotion, SeenValues};
use nalgebra::SVector;

/// A filter that moves sigma points through the models of `base`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigma<const N: usize, M> {
    /// Models and noise.
    pub base: Single<N, M>,
    /// Distance and weights of the points.
    pub rule: SigmaRule,
    /// If true, measurements are compared with the predicted sigma points, including those of the
    /// noise. If false, new sigma points are drawn from the predicted covariance.
    pub carries: bool,
}

/// A state, and the sigma points of its prediction if they are reused for the correction.
#[derive(Clone, Debug, PartialEq)]
pub struct SigmaState<const N: usize> {
    /// Mean and root of the covariance.
    pub rooted: Rooted<N>,
    points: Vec<Point<N>>,
}

/// Weight and state of a sigma point.
type Point<const N: usize> = (f64, SVector<f64, N>);

impl<const N: usize> SigmaState<N> {
    fn new(rooted: Rooted<N>) -> Self {
        Self { rooted, points: Vec::new() }
    }

    fn gaussian(&self) -> Gaussian<N> {
        Gaussian { mean: self.rooted.mean, covariance: self.rooted.covariance() }
    }

    /// Sigma points of the state, the central one first.
    fn points(&self, rule: &SigmaRule) -> Vec<Point<N>> {
        if !self.points.is_empty() {
            return self.points.clone();
        }
        let (mean, reach) = (self.rooted.mean, libm::sqrt(rule.spread));
        let mut points = Vec::with_capacity(1 + 2 * N);
        points.push((rule.center, mean));
        for axis in self.rooted.root.column_iter() {
            points.push((rule.around, mean + axis * reach));
            points.push((rule.around, mean - axis * reach));
        }
        points
    }
}

/// Corrects the state `prior` by a measurement if `believe` accepts its innovation.
struct SigmaCorrected<'a, 'b, const N: usize> {
    rule: &'a SigmaRule,
    prior: &'a mut SigmaState<N>,
    believe: AcceptInnovation<'b>,
}

impl<const N: usize> Observer<N> for SigmaCorrected<'_, '_, N> {
    type Output = Result<Innovation, Error>;

    /// Correct the prior by a measurement.
    ///
    /// The joint deviations of measurement and state are reduced to one triangular matrix: its
    /// upper left block is the root of S, the block below is the gain times that root, the lower
    /// right block is the root of the posterior covariance.
    fn observe<const K: usize, V: SeenValues<N, K>>(self, seen: &V) -> Self::Output {
        let Self { rule, prior, believe } = self;
        let (points, mean) = (prior.points(rule), prior.rooted.mean);
        // The mean is formed from differences to the central point: bearings on both sides of pi,
        // averaged as plain numbers, would point backwards.
        let center = seen.expected(&points[0].1);
        let apart: Vec<SVector<f64, K>> =
            points.iter().map(|(_, point)| seen.minus(&seen.expected(point), &center)).collect();
        let shift: SVector<f64, K> =
            points.iter().zip(&apart).map(|((weight, _), apart)| apart * *weight).sum();
        let mut columns = points.iter().zip(&apart).map(|((weight, point), apart)| {
            (*weight, stacked((apart - shift).as_slice(), (point - mean).as_slice()))
        });
        let central = columns.next(); // last: its weight may be negative
        let empty = Triangle::zero(K + N);
        let mut triangle =
            columns.fold(empty, |sum, (weight, column)| sum.weighted(weight, column));
        let R = seen.noise();
        let noise = R.cholesky().ok_or(Error::NotPositiveDefinite { matrix: "R" })?.l();
        noise.column_iter().for_each(|c| triangle.absorb(stacked(c.into_owned().as_slice(), &[])));
        let triangle =
            central.map_or(triangle, |(weight, column)| triangle.weighted(weight, column));
        let y = seen.minus(&seen.measured(), &(center + shift));
        let (state, innovation) = posterior(&prior.rooted, &triangle, &y);
        if believe(&innovation) {
            *prior = state;
        }
        Ok(innovation)
    }
}

impl<const N: usize, M: SeenMotion<N>> Sigma<N, M> {
    /// Predicted sigma points of the state and of its noise.
    fn carried(
        &self,
        state: &Rooted<N>,
        noise: &[SVector<f64, N>],
        moved: impl Fn(&SVector<f64, N>) -> SVector<f64, N>,
    ) -> Vec<Point<N>> {
        let SigmaRule { spread, around, .. } = self.rule;
        let (center, reach) = (moved(&state.mean), libm::sqrt(spread));
        // The noise columns are further dimensions of the state; the central weight pays for their
        // points.
        let mut points = vec![(1.0 - (N + noise.len()) as f64 / spread, center)];
        for axis in state.root.column_iter() {
            points.push((around, moved(&(state.mean + axis * reach))));
            points.push((around, moved(&(state.mean - axis * reach))));
        }
        for column in noise {
            points.extend([(around, center + column * reach), (around, center - column * reach)]);
        }
        points
    }
}

/// Posterior and innovation of the joint triangle over measurement and state, given the innovation.
fn posterior<const N: usize, const K: usize>(
    prior: &Rooted<N>,
    triangle: &Triangle,
    y: &SVector<f64, K>,
) -> (SigmaState<N>, Innovation) {
    let mut whitened = SVector::<f64, K>::zeros();
    let mut determinant = 1.0;
    // Forward substitution with the root of S: the squared norm of the result is the NIS, and the
    // block below times the result is the change of the mean. Nothing is inverted.
    for row in 0..K {
        let known: f64 = (0..row).map(|k| triangle.at(row, k) * whitened[k]).sum();
        whitened[row] = (y[row] - known) / triangle.at(row, row);
        determinant *= triangle.at(row, row);
    }
    let gained = SVector::<f64, N>::from_fn(|row, _| {
        (0..K).map(|k| triangle.at(K + row, k) * whitened[k]).sum()
    });
    let squared = whitened.norm_squared();
    let variances = std::array::from_fn(|row| (0..=row).map(|k| triangle.at(row, k).powi(2)).sum());
    let log_determinant = 2.0 * libm::log(determinant);
    let far = Mahalanobis::<K> { squared, log_determinant, variances };
    let innovation = Innovation::new(y.as_slice(), &far);
    let rooted = Rooted { mean: prior.mean + gained, root: triangle.corner(K) };
    (SigmaState::new(rooted), innovation)
}

impl<const N: usize, M: SeenMotion<N>> Engine for Sigma<N, M> {
    type State = SigmaState<N>;
    type World = M::World;

    fn first(&self, first: &First) -> SigmaState<N> {
        let start = self.base.first(first);
        SigmaState::new(Rooted::new(start.mean, &start.covariance))
    }

    fn after_velocity(&self, cv: &<M::World as World>::Cv) -> Option<SigmaState<N>> {
        let start = self.base.after_velocity(cv)?;
        Some(SigmaState::new(Rooted::new(start.mean, &start.covariance)))
    }

    fn predict(&self, state: &mut SigmaState<N>, dt: f64, platform: &Platform) {
        let (motion, before) = (&self.base.motion, state.rooted);
        let moved = |s: &SVector<f64, N>| motion.propagate(s, dt, platform);
        let (mean, mut triangle, shift) = transformed(&before, &self.rule, moved);
        let mut noise = Vec::new();
        let ends = [&before.mean, &moved(&before.mean)];
        self.base.noise.columns(motion, ends, dt, platform, |column| {
            triangle.absorb(stacked(column.as_slice(), &[]));
            if self.carries {
                noise.push(*column);
            }
        });
        // After all noise: the central weight may be negative, and then it is subtracted from a
        // larger sum.
        let triangle = triangle.weighted(self.rule.center, stacked(shift.as_slice(), &[]));
        state.rooted = Rooted { mean, root: triangle.corner(0) };
        state.points = if self.carries { self.carried(&before, &noise, moved) } else { Vec::new() };
    }

    fn update(
        &self,
        state: &mut SigmaState<N>,
        m: &Measurement,
        platform: &Platform,
        believe: AcceptInnovation<'_>,
    ) -> Result<Option<Innovation>, Error> {
        let Single { motion, sensing, .. } = &self.base;
        let mean = state.rooted.mean;
        let corrected = SigmaCorrected { rule: &self.rule, prior: state, believe };
        M::World::see(motion, &mean, m, sensing, platform, corrected).transpose()
    }

    fn blended(&self, parts: &[(f64, &SigmaState<N>)]) -> SigmaState<N> {
        let plain: Vec<_> = parts.iter().map(|(weight, part)| (*weight, part.gaussian())).collect();
        let Gaussian { mean, covariance } =
            mixed(&plain.iter().map(|(weight, part)| (*weight, part)).collect::<Vec<_>>());
        // The points are dropped: those of one part do not stand for the mixture.
        SigmaState::new(Rooted::new(mean, &covariance))
    }

    /// The predicted sigma points are dropped, because they represent the previous covariance.
    fn loosen(&self, state: &mut SigmaState<N>, factor: f64) {
        state.rooted.root *= libm::sqrt(factor);
        state.points.clear();
    }

    fn output(&self, state: &SigmaState<N>) -> Output {
        output(&state.gaussian(), M::HEADING)
    }

    /// Mean and root, then weight and state of every predicted sigma point.
    fn numbers(&self, state: &SigmaState<N>) -> Vec<f64> {
        let Rooted { mean, root } = state.rooted;
        let mut numbers = Gaussian { mean, covariance: root }.numbers();
        for (weight, place) in &state.points {
            numbers.push(*weight);
            numbers.extend(place.iter());
        }
        numbers
    }

    fn state_of_numbers(&self, numbers: &[f64]) -> Option<SigmaState<N>> {
        let (state, points) = numbers.split_at_checked(N + N * N)?;
        let Gaussian { mean, covariance: root } = Gaussian::from_numbers(state)?;
        let points = points.chunks(1 + N);
        let point =
            |of: &[f64]| (of.len() == 1 + N).then(|| (of[0], SVector::from_column_slice(&of[1..])));
        let points = points.map(point).collect::<Option<Vec<Point<N>>>>()?;
        Some(SigmaState { rooted: Rooted { mean, root }, points })
    }

    /// Transition by the Jacobian at the mean; the smoother needs only the correlation of two
    /// states.
    fn link(&self, state: &SigmaState<N>, dt: f64, platform: &Platform) -> Option<Link> {
        let mut link = self.base.link(&state.gaussian(), dt, platform)?;
        let mut predicted = SigmaState::new(state.rooted);
        self.predict(&mut predicted, dt, platform);
        // The mean is that of the sigma points: the smoother corrects what this filter predicted.
        link.mean.fixed_rows_mut::<N>(0).copy_from(&predicted.rooted.mean);
        Some(link)
    }
}
