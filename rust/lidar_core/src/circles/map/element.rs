//! Elements with a filter each: state, visibility, confirmation and removal.

#![allow(non_snake_case)] // textbook letters

use super::arrivals::{Arrivals, BirthPlace};
use super::belief::{ElementBelief, OVER};
use super::element_motion::ElementStep;
use super::rules::Rules;
use super::seconds;
use super::view::viewpoint::Viewpoint;
use super::view::visibility::CircleVisibility;
use crate::Error;
use nalgebra::SMatrix;
use serde::{Deserialize, Serialize};

/// State of an element, and the operations that differ between kinds.
pub(super) trait State: Clone {
    /// Measurement of an element by one scan.
    type Measurement: Clone;

    /// State of a new element from its first measurement; `others` are the states of all other
    /// elements.
    fn new<'a>(
        seen: &Self::Measurement,
        others: impl Iterator<Item = &'a Self>,
        rules: &Rules,
    ) -> Self
    where
        Self: 'a;

    /// True if a measurement without element starts a new one.
    fn is_born(_: &Self::Measurement, _: &Rules) -> bool {
        true
    }

    /// Measurements of a scan, with parts of one object merged. Also, for each measurement, the
    /// index of the measurement of which it is a part, or its own index.
    fn wholes<'a>(
        _all: impl Iterator<Item = &'a Self>,
        seen: &[Self::Measurement],
        _: &Rules,
    ) -> (Vec<Self::Measurement>, Vec<usize>)
    where
        Self: 'a,
    {
        (seen.to_vec(), (0..seen.len()).collect())
    }

    /// Predict the state.
    fn predict(&mut self, step: &ElementStep);

    /// Correct the state with a measurement.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]; nothing changes then.
    fn correct(&mut self, seen: &Self::Measurement, rules: &Rules) -> Result<(), Error>;

    /// For each measurement that is not a part, the index of its object in `all`.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`].
    fn associate<'a>(
        all: impl ExactSizeIterator<Item = &'a Self> + Clone,
        seen: &[Self::Measurement],
        wholes: &[usize],
        from: &Viewpoint,
        rules: &Rules,
    ) -> Result<Vec<Option<usize>>, Error>
    where
        Self: 'a;

    /// Visibility of the element in a scan that did not measure it.
    fn look(&self, from: &Viewpoint, rules: &Rules) -> CircleVisibility;

    /// Use rays of a scan that end on the element but are too few to measure it. True if there are
    /// any.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]; nothing changes then.
    fn glimpse(&mut self, _: &Viewpoint, _: &Rules) -> Result<bool, Error> {
        Ok(false)
    }

    /// True if the state is too uncertain for a visible element.
    fn is_vague(&self, rules: &Rules) -> bool;

    /// True if the position is too uncertain to be reported.
    fn is_lost(&self, _: &Rules) -> bool {
        false
    }

    /// Decide after a scan whether the element is reported as standing. Returns the decision.
    fn settle(&mut self, _: &Rules) -> bool {
        true
    }

    /// True if both states are of one object.
    fn is_twin(&self, other: &Self, rules: &Rules) -> bool;

    /// Merge with the state of the same object.
    fn absorb(&mut self, twin: Self, is_newer: bool);

    /// What earlier scans saw at the place of a measurement.
    fn birth_place(_: &Self::Measurement) -> BirthPlace {
        BirthPlace::Revealed
    }

    /// True if rays that end at the place of the object are evidence that it exists.
    fn is_shown_by_returns() -> bool {
        false
    }

    /// Probability that the object is not at the place that [`Self::look`] tests.
    fn doubt(&self, _: CircleVisibility) -> f64 {
        0.0
    }

    /// Time for which an element stays while hidden or out of view [s]; None: for ever.
    fn coast(rules: &Rules) -> Option<f64>;
}

/// Observation of an element by the last scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum ScanEvidence {
    Measured,
    Unmeasured(CircleVisibility),
}

impl ScanEvidence {
    fn is_visible(self) -> bool {
        let hidden = [CircleVisibility::Occluded, CircleVisibility::OutOfView];
        !hidden.map(Self::Unmeasured).contains(&self)
    }
}

/// Time after a measurement for which the position of an element counts as known [s].
const MOMENT: f64 = 0.5;
/// Time for which an element that is not found at its expected place is kept, so that it can come
/// back with its ID [s].
const AWAY: f64 = 2.5;

/// One object of the map: its state, and the evidence from the scans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Element<S> {
    pub(super) id: i64,
    pub(super) state: S,
    pub(super) born_ns: i64,
    /// Time of the last measurement [ns].
    pub(super) seen_ns: i64,
    pub(super) n_measurements: u32,
    /// True if the probability of existence is high enough for a report. It stays true until the
    /// probability falls below half of that limit.
    pub(super) confirmed: bool,
    pub(super) belief: ElementBelief,
    /// Time since the probabilities of the kinds were updated [s].
    unheard: f64,
    /// True if the position is too uncertain to be reported.
    lost: bool,
    /// Observation by the newest scan of `watcher`.
    seen: ScanEvidence,
    /// Sensor that last measured the element or should have measured it.
    watcher: u32,
    /// Time for which it has been hidden or out of view [s].
    hidden: f64,
    /// Time for which it has not been where it is expected [s].
    away: f64,
}

impl<S: State> Element<S> {
    pub(super) fn new(
        id: i64,
        state: S,
        belief: ElementBelief,
        (stamp_ns, sensor): (i64, u32),
    ) -> Self {
        Self {
            id,
            state,
            born_ns: stamp_ns,
            seen_ns: stamp_ns,
            n_measurements: 1,
            confirmed: false,
            belief,
            unheard: 0.0,
            lost: false,
            seen: ScanEvidence::Measured,
            watcher: sensor,
            hidden: 0.0,
            away: 0.0,
        }
    }

    /// Predict the element by `step`.
    pub(super) fn predict(&mut self, step: &ElementStep) {
        self.state.predict(step);
        self.belief.predict(step.seconds);
        self.unheard += step.seconds;
    }

    /// Count a scan that measured the element.
    pub(super) fn measured(&mut self, (stamp_ns, sensor): (i64, u32)) {
        self.seen_ns = stamp_ns;
        self.n_measurements = self.n_measurements.saturating_add(1);
        self.belief.measured();
        (self.seen, self.watcher) = (ScanEvidence::Measured, sensor);
        (self.hidden, self.away) = (0.0, 0.0);
    }

    /// Count a scan, `dt` seconds after the one before, that did not measure the element. A sensor
    /// from which the element is hidden does not override one that sees it.
    pub(super) fn unmeasured(&mut self, visibility: CircleVisibility, sensor: u32, dt: f64) {
        let seen = ScanEvidence::Unmeasured(visibility);
        if seen.is_visible() || sensor == self.watcher {
            if S::is_shown_by_returns() && visibility == CircleVisibility::Returns {
                self.belief.measured();
            } else {
                self.belief.unmeasured(visibility, self.state.doubt(visibility));
            }
            (self.seen, self.watcher) = (seen, sensor);
        }
        if !seen.is_visible() {
            self.hidden += dt;
        }
        if self.belief.existence() < OVER {
            self.away += dt;
        }
    }

    /// True if the newest scan of a sensor measured the element, or it was in view and not hidden.
    pub(super) fn is_visible(&self) -> bool {
        self.seen.is_visible()
    }

    /// Update `confirmed` from the probability of existence.
    fn confirm(&mut self, rules: &Rules) {
        let (existence, report) = (self.belief.existence(), rules.parameters().report_existence);
        let least = if self.confirmed { 0.5 * report } else { report };
        self.confirmed = existence >= least;
    }

    /// Decide what is reported of the element after a scan.
    pub(super) fn settle(&mut self, rules: &Rules) {
        self.confirm(rules);
        let stands = self.state.settle(rules);
        if self.seen == ScanEvidence::Measured {
            self.belief.moves(stands, self.unheard);
            self.unheard = 0.0;
        }
        self.lost = self.state.is_lost(rules);
    }

    /// True if the element is reported: it is confirmed, and its position is not too uncertain
    /// while it is out of sight.
    pub(super) fn is_reported(&self) -> bool {
        self.confirmed && !self.lost
    }

    /// True if the element is to be removed: most probably there is no object, it was hidden for
    /// too long, or it is too uncertain (eq. 33 with a limit per block). Its result is counted in
    /// `arrivals`.
    pub(super) fn is_over(&mut self, rules: &Rules, arrivals: &mut Arrivals) -> bool {
        let coast = S::coast(rules);
        // Chance groups of rays would fill the map: only an element that was once certain is kept long.
        let was_sure = self.confirmed || self.belief.was() >= rules.parameters().report_existence;
        let coast = if was_sure { coast } else { Some(coast.map_or(MOMENT, |c| c.min(MOMENT))) };
        let is_over = self.belief.existence_anywhere() < OVER
            || self.away > AWAY
            || !self.is_visible() && coast.is_some_and(|most| self.hidden > most)
            // The covariance grows while an element is hidden, and comes back into view as it is;
            // the measured part alone is tested by it.
            || self.seen == ScanEvidence::Measured && self.state.is_vague(rules);
        self.belief.settle(is_over, arrivals);
        is_over
    }

    /// True if two elements are one object. Both must be visible or must have been visible a moment
    /// ago, because an object inside another one is hidden by it.
    pub(super) fn is_twin(&self, other: &Self, rules: &Rules) -> bool {
        let newest = self.seen_ns.max(other.seen_ns);
        let is_known = |one: &Self| one.is_visible() || seconds(one.seen_ns, newest) <= MOMENT;
        is_known(self) && is_known(other) && self.state.is_twin(&other.state, rules)
    }

    /// Merge with a twin: the state measured last is kept, else the one measured more often.
    pub(super) fn absorb(&mut self, twin: Self) {
        let rank = |element: &Self| (element.seen_ns, element.n_measurements);
        let is_newer = rank(&twin) > rank(self);
        if is_newer {
            (self.seen, self.watcher) = (twin.seen, twin.watcher);
            self.seen_ns = twin.seen_ns;
            (self.hidden, self.away) = (twin.hidden, twin.away);
        }
        self.state.absorb(twin.state, is_newer);
        self.belief = self.belief.united(twin.belief);
        self.n_measurements = self.n_measurements.max(twin.n_measurements);
    }
}

/// True if the largest eigenvalue of `P` is `limit` or more: then `limit I - P` is not positive.
pub(super) fn exceeds<const N: usize>(P: &SMatrix<f64, N, N>, limit: f64) -> bool {
    // One factorisation decides, where eigenvalues would need an iteration.
    (SMatrix::<f64, N, N>::identity() * limit - P).cholesky().is_none()
}
