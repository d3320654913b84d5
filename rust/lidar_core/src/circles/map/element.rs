//! Elements with a filter each: what they are, what a scan tells about them, when they go.

#![allow(non_snake_case)] // textbook letters

use super::modes::Step;
use super::parameters::{Independent, Patience};
use super::rules::Rules;
use super::seconds;
use super::viewpoint::Viewpoint;
use super::visibility::Visibility;
use crate::Error;
use nalgebra::SMatrix;
use serde::{Deserialize, Serialize};

/// Where an object is, and what scans tell about that: what differs from kind to kind.
pub(super) trait State: Clone {
    /// What a scan shows of one.
    type Measurement;

    /// As the first measurement shows it.
    fn new(seen: &Self::Measurement, rules: &Rules) -> Self;

    /// Whether a measurement that belongs to no element makes one.
    fn is_born(_: &Self::Measurement, _: &Rules) -> bool {
        true
    }

    /// Per measurement of one scan, the one of which it is a part: itself if it is a whole.
    fn wholes(seen: &[Self::Measurement], _: &Rules) -> Vec<usize> {
        (0..seen.len()).collect()
    }

    /// Move on.
    fn predict(&mut self, step: &Step);

    /// # Errors
    /// [`Error::NotPositiveDefinite`]; nothing changes then.
    fn correct(&mut self, seen: &Self::Measurement, rules: &Rules) -> Result<(), Error>;

    /// The object, by its place among `all`, that each measurement shows which is a whole.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`].
    fn associate<'a>(
        all: impl ExactSizeIterator<Item = &'a Self> + Clone,
        seen: &[Self::Measurement],
        wholes: &[usize],
        rules: &Rules,
    ) -> Result<Vec<Option<usize>>, Error>
    where
        Self: 'a;

    /// What a scan that did not measure it says about it.
    fn look(&self, from: &Viewpoint, rules: &Rules) -> Visibility;

    /// Whether too little is known about it.
    fn is_vague(&self, rules: &Rules) -> bool;

    /// Whether the two are one object.
    fn is_twin(&self, other: &Self, rules: &Rules) -> bool;

    /// Take in a twin.
    fn absorb(&mut self, twin: Self, is_newer: bool);

    /// How long it stays without a measurement.
    fn patience(rules: &Rules) -> Patience;
}

/// What the last scan said about an element.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Seen {
    Measured,
    Unmeasured(Visibility),
}

impl Seen {
    fn is_visible(self) -> bool {
        let hidden = [Visibility::Occluded, Visibility::OutOfView];
        !hidden.map(Self::Unmeasured).contains(&self)
    }
}

/// Scans in a row that gave one reason to let an element go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Misses {
    scans: u32,
    /// Time that they cover [s].
    time: f64,
}

impl Misses {
    fn add(&mut self, dt: f64) {
        self.scans = self.scans.saturating_add(1);
        self.time += dt;
    }
}

/// One object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Element<S> {
    pub(super) id: i64,
    pub(super) state: S,
    pub(super) born_ns: i64,
    /// Time of the last measurement.
    pub(super) seen_ns: i64,
    pub(super) n_measurements: u32,
    /// The last scans, newest in the lowest bit: 1 where it was measured.
    history: u64,
    pub(super) confirmed: bool,
    /// What the newest scan of `watcher` said.
    seen: Seen,
    /// The sensor that last measured it or should have.
    watcher: u32,
    /// Without a measurement: seen through, with returns, hidden.
    absent: Misses,
    unmatched: Misses,
    hidden: Misses,
}

impl<S: State> Element<S> {
    pub(super) fn new(id: i64, state: S, (stamp_ns, sensor): (i64, u32)) -> Self {
        Self {
            id,
            state,
            born_ns: stamp_ns,
            seen_ns: stamp_ns,
            n_measurements: 1,
            history: 1,
            confirmed: false,
            seen: Seen::Measured,
            watcher: sensor,
            absent: Misses::default(),
            unmatched: Misses::default(),
            hidden: Misses::default(),
        }
    }

    /// Count a scan that measured it.
    pub(super) fn measured(&mut self, (stamp_ns, sensor): (i64, u32)) {
        self.seen_ns = stamp_ns;
        self.n_measurements = self.n_measurements.saturating_add(1);
        self.history = self.history << 1 | 1;
        (self.seen, self.watcher) = (Seen::Measured, sensor);
        (self.absent, self.unmatched, self.hidden) = Default::default();
    }

    /// Count a scan, `dt` seconds after the one before, that did not. A sensor from which it is
    /// hidden has no say in what another one sees.
    pub(super) fn unmeasured(&mut self, visibility: Visibility, sensor: u32, dt: f64) {
        match visibility {
            Visibility::SeenThrough => self.absent.add(dt),
            Visibility::Returns => self.unmatched.add(dt),
            Visibility::Occluded | Visibility::OutOfView => self.hidden.add(dt),
        }
        let seen = Seen::Unmeasured(visibility);
        if seen.is_visible() || sensor == self.watcher {
            self.history <<= 1;
            (self.seen, self.watcher) = (seen, sensor);
        }
    }

    /// Whether a sensor's newest scan measured it or should have.
    pub(super) fn is_visible(&self) -> bool {
        self.seen.is_visible()
    }

    /// Confirm it if enough scans speak for it.
    pub(super) fn confirm(&mut self, parameters: &Independent) {
        let hits = self.recent(parameters.confirmation.window).count_ones();
        self.confirmed |= hits >= parameters.confirmation.hits;
    }

    /// Whether it goes: never confirmed, not there, or too uncertain, eq. 33 with a limit per block.
    pub(super) fn is_over(&self, rules: &Rules) -> bool {
        if !self.confirmed && self.recent(rules.parameters().confirmation.window) == 0 {
            return true;
        }
        let patience = S::patience(rules);
        let is_long = |misses: Misses, most| misses.scans >= patience.scans && misses.time > most;
        is_long(self.absent, patience.absent)
            || is_long(self.unmatched, patience.unmatched)
            || patience.hidden.is_some_and(|most| is_long(self.hidden, most))
            || self.is_visible() && self.state.is_vague(rules)
    }

    /// Whether two elements are one object. Both are in sight, or were a moment ago: what is inside
    /// another is hidden by it.
    pub(super) fn is_twin(&self, other: &Self, rules: &Rules) -> bool {
        let (newest, moment) = (self.seen_ns.max(other.seen_ns), S::patience(rules).unmatched);
        let is_known = |one: &Self| one.is_visible() || seconds(one.seen_ns, newest) <= moment;
        is_known(self) && is_known(other) && self.state.is_twin(&other.state, rules)
    }

    /// Take in a twin: the state of the one measured last, else the one measured more often.
    pub(super) fn absorb(&mut self, twin: Self) {
        let rank = |element: &Self| (element.seen_ns, element.n_measurements);
        let is_newer = rank(&twin) > rank(self);
        if is_newer {
            (self.seen, self.watcher) = (twin.seen, twin.watcher);
            self.seen_ns = twin.seen_ns;
            (self.absent, self.unmatched) = (twin.absent, twin.unmatched);
            self.hidden = twin.hidden;
        }
        self.state.absorb(twin.state, is_newer);
        self.n_measurements = self.n_measurements.max(twin.n_measurements);
        self.history |= twin.history;
    }

    /// Of the last `window` scans those that measured it.
    fn recent(&self, window: u32) -> u64 {
        self.history & (u64::MAX >> (u64::BITS - window))
    }
}

/// Whether the largest eigenvalue of `P` is `limit` or more: then `limit I - P` is not positive.
pub(super) fn exceeds<const N: usize>(P: &SMatrix<f64, N, N>, limit: f64) -> bool {
    (SMatrix::<f64, N, N>::identity() * limit - P).cholesky().is_none()
}
