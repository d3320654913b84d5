//! One filter type for every model and method.

use super::phase::CvOf;
use super::sensor_errors::SensorErrors;
use super::target::{FilterStep, MeasurementResult, SavedTarget, Target};
use crate::Error;
use crate::error::require;
use crate::estimation::chi2;
use crate::estimation::kalman::Gaussian;
use crate::estimation::unscented::SigmaRule;
use crate::fusion::filter::engine::{Engine, Innovation, Link, Output, Single};
use crate::fusion::filter::imm::{Imm, Mode, mode};
use crate::fusion::filter::paper::Paper;
use crate::fusion::filter::sigma_points::Sigma;
use crate::fusion::model_list::{ForMixable, ForMotion, MIXABLE, Model};
use crate::fusion::models::cartesian::ConstantVelocity;
use crate::fusion::models::motion::{Noise, NoiseForm, ProcessNoise};
use crate::fusion::models::platform::Platform;
use crate::fusion::models::space::SpaceVelocity;
use crate::fusion::models::state_conversion::StateConversion;
use crate::fusion::models::world::{Plane, Space, World};
use crate::fusion::parameters::{FusionParameters, Method, Strengths};
use crate::fusion::sensors::measurement::Measurement;
use crate::fusion::sensors::sight::SeenMotion;
use crate::util::full_state::{opened, sealed};
use std::sync::Arc;

/// A filter of one target.
pub struct Filter(Box<dyn Tracked>);

/// A [`Target`] with any engine.
trait Tracked: Send + Sync {
    fn step(&mut self, m: &Measurement) -> FilterStep;
    fn take(&mut self, m: &Measurement) -> MeasurementResult;
    fn absorb(&mut self, stamp_ns: i64, weighted: &[(f64, Measurement)]);
    fn foresee(&mut self, stamp_ns: i64) -> bool;
    fn innovations(&mut self, m: &Measurement, visit: &mut dyn FnMut(f64, &Innovation)) -> bool;
    fn score(&mut self, m: &Measurement) -> Option<Innovation>;
    fn stamp_ns(&self) -> i64;
    fn output(&self) -> Option<Output>;
    fn output_at(&self, stamp_ns: i64) -> Option<Output>;
    fn link(&self, stamp_ns: i64) -> Option<Link>;
    fn looseness(&self) -> f64;
    fn expect_speed(&mut self, variance: f64);
    fn sight(&self, m: &Measurement) -> Option<[[f64; 3]; 2]>;
    fn errors(&self) -> SensorErrors;
    fn boxed(&self) -> Box<dyn Tracked>;
    fn saved(&self) -> SavedTarget;
    fn restore(&mut self, saved: &SavedTarget) -> Result<(), Error>;
}

impl<E: Engine, S: Engine<World = E::World, State = CvOf<E>>> Tracked for Target<E, S> {
    fn step(&mut self, m: &Measurement) -> FilterStep {
        Target::step(self, m)
    }

    fn take(&mut self, m: &Measurement) -> MeasurementResult {
        Target::take(self, m)
    }

    fn absorb(&mut self, stamp_ns: i64, weighted: &[(f64, Measurement)]) {
        Target::absorb(self, stamp_ns, weighted);
    }

    fn foresee(&mut self, stamp_ns: i64) -> bool {
        Target::foresee(self, stamp_ns)
    }

    fn innovations(&mut self, m: &Measurement, visit: &mut dyn FnMut(f64, &Innovation)) -> bool {
        Target::innovations(self, m, visit)
    }

    fn score(&mut self, m: &Measurement) -> Option<Innovation> {
        Target::score(self, m)
    }

    fn stamp_ns(&self) -> i64 {
        Target::stamp_ns(self)
    }

    fn output(&self) -> Option<Output> {
        Target::output(self)
    }

    fn output_at(&self, stamp_ns: i64) -> Option<Output> {
        Target::output_at(self, stamp_ns)
    }

    fn link(&self, stamp_ns: i64) -> Option<Link> {
        Target::link(self, stamp_ns)
    }

    fn looseness(&self) -> f64 {
        Target::looseness(self)
    }

    fn expect_speed(&mut self, variance: f64) {
        Target::expect_speed(self, variance);
    }

    fn sight(&self, m: &Measurement) -> Option<[[f64; 3]; 2]> {
        Target::sight(self, m)
    }

    fn errors(&self) -> SensorErrors {
        Target::errors(self)
    }

    fn boxed(&self) -> Box<dyn Tracked> {
        Box::new(self.clone())
    }

    fn saved(&self) -> SavedTarget {
        Target::saved(self)
    }

    fn restore(&mut self, saved: &SavedTarget) -> Result<(), Error> {
        Target::restore(self, saved)
    }
}

impl Clone for Filter {
    fn clone(&self) -> Self {
        Self(self.0.boxed())
    }
}

impl Filter {
    /// Filter without measurements.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a method that does not fit the model.
    pub fn new(parameters: &FusionParameters) -> Result<Self, Error> {
        let p = parameters;
        let linear = matches!(
            p.model,
            Model::ConstantVelocity
                | Model::ConstantAcceleration
                | Model::SpaceVelocity
                | Model::SpaceAcceleration
        );
        let fits = p.method != Method::Linear || linear;
        let expected = "\"kf\" with model \"cv\", \"ca\", \"cv-3d\" or \"ca-3d\" only";
        require(fits, "method", expected, format!("{:?}", p.model))?;
        if let Method::Interacting { sojourn, .. } = p.method {
            let in_plane: Vec<Arc<dyn Mode<Plane>>> =
                p.modes(|model, task| model.with_mixable(task));
            let in_space: Vec<Arc<dyn Mode<Space>>> =
                p.modes(|model, task| model.with_mixable_in_space(task));
            let fits = in_plane.is_empty() != in_space.is_empty();
            let expected = "at least one model, and none in space beside one in the plane";
            require(fits, "imm_models", expected, in_plane.len() + in_space.len())?;
            return Ok(Self(if p.is_in_space() {
                p.tracked(Imm::<_, 9>::new(in_space, sojourn), SpaceVelocity)
            } else {
                p.tracked(Imm::<_, 6>::new(in_plane, sojourn), ConstantVelocity)
            }));
        }
        Ok(Self(p.model.with_motion(p.life.gyro, TargetOf(p))))
    }

    /// State that changes with measurements.
    pub(super) fn saved(&self) -> SavedTarget {
        self.0.saved()
    }

    /// Continue from a state of a filter with the same parameters.
    pub(super) fn restore_saved(&mut self, saved: &SavedTarget) -> Result<(), Error> {
        self.0.restore(saved)
    }

    /// The whole state as bytes; `parameters` are those of the filter.
    ///
    /// # Errors
    /// [`Error::Limit`] if the bytes do not fit into memory.
    pub fn to_state(&self, parameters: &FusionParameters) -> Result<Vec<u8>, Error> {
        sealed("fusion filter", parameters, &self.saved())
    }

    /// Filter from a saved state; it continues with the same bits as the saved one.
    ///
    /// # Errors
    /// Errors of [`Filter::new`]; [`Error::Format`] for bytes that [`Filter::to_state`] did not
    /// make, [`Error::Parameter`] for the state of a filter with other parameters.
    pub fn from_state(parameters: &FusionParameters, bytes: &[u8]) -> Result<Self, Error> {
        let saved: SavedTarget = opened("fusion filter", parameters, bytes)?;
        let mut filter = Self::new(parameters)?;
        filter.restore_saved(&saved)?;
        Ok(filter)
    }

    /// Process a measurement.
    pub fn step(&mut self, m: &Measurement) -> FilterStep {
        self.0.step(m)
    }

    /// Like [`Self::step`], but returns only outcome and innovation.
    pub fn take(&mut self, m: &Measurement) -> MeasurementResult {
        self.0.take(m)
    }

    /// Process measurements of one time, not older than the state, each with its probability to
    /// come from the target. The sum of the probabilities is at most 1. Neither the gate nor the
    /// test for a lost filter is applied.
    pub fn absorb(&mut self, stamp_ns: i64, weighted: &[(f64, Measurement)]) {
        self.0.absorb(stamp_ns, weighted);
    }

    /// Predict the state to `stamp_ns` and keep the prediction until the state changes; returns
    /// whether it had to be computed.
    pub(super) fn foresee(&mut self, stamp_ns: i64) -> bool {
        self.0.foresee(stamp_ns)
    }

    /// Call `visit` with weight and innovation of a measurement for each component of the predicted
    /// state. Returns false if one of them is not defined.
    pub(super) fn innovations(
        &mut self,
        m: &Measurement,
        visit: &mut dyn FnMut(f64, &Innovation),
    ) -> bool {
        self.0.innovations(m, visit)
    }

    /// Innovation of a measurement for the predicted state; None outside the gate, or if no state
    /// was predicted with [`Self::foresee`].
    pub(super) fn score(&mut self, m: &Measurement) -> Option<Innovation> {
        self.0.score(m)
    }

    /// Probability that a measurement of the target is further from the predicted state than this
    /// one, in standard deviations of each component of the state.
    pub(super) fn tail(&mut self, m: &Measurement) -> f64 {
        let mut tail = 0.0;
        self.innovations(m, &mut |weight, innovation| {
            tail += weight * (1.0 - chi2::cdf(innovation.nis, innovation.count as u32));
        });
        tail
    }

    /// Set the variance of the speed of a new target [m^2/s^2], instead of that of the prior.
    pub(super) fn expect_speed(&mut self, variance: f64) {
        self.0.expect_speed(variance);
    }

    /// Position from a measurement alone [m] and its variances along the axes [m^2], in the frame
    /// of the state; None for a measurement without a position.
    pub(super) fn sight(&self, m: &Measurement) -> Option<[[f64; 3]; 2]> {
        self.0.sight(m)
    }

    /// Time of the state [ns]; the smallest integer before the first measurement.
    #[must_use]
    pub fn stamp_ns(&self) -> i64 {
        self.0.stamp_ns()
    }

    /// Transition from the state to the one at `stamp_ns`, for smoothing; None as for [`Target::link`].
    pub(super) fn link(&self, stamp_ns: i64) -> Option<Link> {
        self.0.link(stamp_ns)
    }

    /// Factor by which the last step enlarged the predicted covariance beyond that of its link.
    pub(super) fn looseness(&self) -> f64 {
        self.0.looseness()
    }

    /// Noise of the sensors, estimated from the measurements.
    #[must_use]
    pub fn errors(&self) -> SensorErrors {
        self.0.errors()
    }

    /// Output of the state; None before the target has been seen.
    #[must_use]
    pub fn output(&self) -> Option<Output> {
        self.0.output()
    }

    /// State predicted to `stamp_ns`, without changing the filter; None before the target has been seen. For a time
    /// before the last measurement it is the state at that measurement.
    #[must_use]
    pub fn output_at(&self, stamp_ns: i64) -> Option<Output> {
        self.0.output_at(stamp_ns)
    }
}

impl FusionParameters {
    /// The models to mix that `make` supports, and their copies with less process noise
    /// (`imm_quiet`).
    fn modes<T>(&self, make: impl Fn(Model, ModeOf<'_>) -> Option<T>) -> Vec<T> {
        let Method::Interacting { models, quiet, .. } = self.method else { return Vec::new() };
        let loud = std::iter::once(*self);
        let shares = loud.chain(quiet.map(|share| self.with_noise(share)));
        let mut modes = Vec::new();
        for (copy, p) in shares.enumerate() {
            let named = MIXABLE
                .iter()
                .zip(models)
                .filter(|(model, wanted)| *wanted && (copy == 0 || **model != Model::Standing));
            modes.extend(named.filter_map(|(model, _)| make(*model, ModeOf(&p))));
        }
        modes
    }

    fn tracked<E: Engine, const N: usize, M>(&self, engine: E, start: M) -> Box<dyn Tracked>
    where
        M: SeenMotion<N, World = E::World>,
        E::World: World<Cv = Gaussian<N>>,
    {
        let strength = M::NOISES.map(|noise| match noise {
            Noise::Acceleration => self.strengths.start,
            _ => 0.0,
        });
        let starter = Single {
            motion: start,
            noise: ProcessNoise { form: NoiseForm::Discrete, strength },
            prior: self.prior,
            sensing: self.sensing,
        };
        let platform = Platform { lever: self.lever, ..Platform::still() };
        Box::new(Target::new(engine, starter, self.sensing, self.life, platform))
    }

    fn single<const N: usize, M: SeenMotion<N>>(&self, motion: M) -> Single<N, M> {
        let noise = ProcessNoise {
            form: self.strengths.form,
            strength: M::NOISES.map(|noise| self.strengths.of(noise)),
        };
        Single { motion, noise, prior: self.prior, sensing: self.sensing }
    }

    fn target<const N: usize, const S: usize, M, C>(&self, motion: M, start: C) -> Box<dyn Tracked>
    where
        M: SeenMotion<N>,
        M::World: World<Cv = Gaussian<S>>,
        C: SeenMotion<S, World = M::World>,
    {
        let base = self.single(motion);
        match self.method {
            Method::Sigma { spread, carries } => {
                let rule = SigmaRule::new(N, spread.unwrap_or((N + 2) as f64));
                self.tracked(Sigma { base, rule, carries }, start)
            }
            Method::Cubature => {
                let rule = SigmaRule::new(N, N as f64);
                self.tracked(Sigma { base, rule, carries: false }, start)
            }
            _ => self.tracked(base, start),
        }
    }
}

/// A target whose motion is that of a model.
struct TargetOf<'a>(&'a FusionParameters);

impl ForMotion for TargetOf<'_> {
    type Output = Box<dyn Tracked>;

    fn run<const N: usize, M: SeenMotion<N, World = Plane>>(self, motion: M) -> Self::Output {
        self.0.target(motion, ConstantVelocity)
    }

    fn run_in_space<const N: usize, M: SeenMotion<N, World = Space>>(
        self,
        motion: M,
    ) -> Self::Output {
        self.0.target(motion, SpaceVelocity)
    }

    fn published(self, paper: Paper) -> Self::Output {
        let Strengths { acceleration, turn, platform, .. } = self.0.strengths;
        let std = [acceleration, turn, platform];
        self.0.tracked(Paper { std, prior: self.0.prior, ..paper }, ConstantVelocity)
    }
}

/// A mode of [`Imm`] whose motion is that of a model.
struct ModeOf<'a>(&'a FusionParameters);

impl<W: World> ForMixable<W> for ModeOf<'_> {
    type Output = Arc<dyn Mode<W>>;

    fn run<const N: usize, M: StateConversion<N, World = W> + SeenMotion<N>>(
        self,
        motion: M,
    ) -> Self::Output {
        mode(self.0.single(motion))
    }
}
