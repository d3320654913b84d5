//! Probability that an element is an object, and probabilities of its kinds.
//!
//! An element may start from an object or from a random group of hits, such as a piece of a surface
//! that is visible for a moment between two others, or the edge of an object. There are two
//! separate questions. Was it an object? Scans that measure the element are the evidence. Is it
//! still there? Scans that do not measure it are the evidence. A new measurement cancels the
//! earlier misses, because a random group rarely appears again.

use super::arrivals::{Arrivals, BirthPlace};
use super::view::visibility::CircleVisibility;
use crate::tracking::kind::{KINDS, KindBelief, TrackKind};
use serde::{Deserialize, Serialize};

/// Mean time for which an object that has moved exists [s].
const LIFETIME: f64 = 60.0;
/// Mean time for which an object that has never moved exists [s]: furniture and posts do not leave
/// while they are out of view.
const LIFETIME_STANDING: f64 = 600.0;
/// Mean time for which a random group of hits is visible [s].
const CHANCE: f64 = 0.2;
/// Probability that a random group of hits appears a second time.
const TWICE: f64 = 0.4;
/// Rate at which the logarithm of the odds that an object is still there falls while rays pass its
/// place [1/s].
const SEEN_THROUGH: f64 = 40.0;
/// Rate at which the logarithm of the odds that an object is still there falls while rays end at
/// its place but show no object [1/s].
const UNMATCHED: f64 = 18.0;
/// Longest time for which one scan is evidence [s]. Successive scans show nearly the same, so the
/// evidence depends on time and not on the number of scans.
const SPEAKS: f64 = 0.1;
/// Likelihood ratio of an object to a random group of hits, for an element that was measured once
/// and then hidden by another object: a random group is often visible for a moment in a gap.
const COVERED: f64 = 0.15;
/// Likelihood ratio of an object to a random group of hits, for an element that ends because
/// nothing is there any more: measured once, and measured more often.
const GONE: [f64; 2] = [0.02, 0.3];

/// Probability of existence below which an element is removed.
pub(super) const OVER: f64 = 0.05;
/// Probability from which on an element certainly was an object.
const SURE: f64 = 0.99;
/// Largest probability, so that other evidence can always lower it.
const MOST: f64 = 1.0 - 1e-6;

/// Prior probabilities of the kinds of a new element, in the order of `TrackKind::ALL`: most are
/// static.
const SHARES: [f64; KINDS] = [0.05, 1e-3, 0.3, 0.6, 0.05];
/// Rate at which the logarithm of the odds of a static kind changes while an element moves [1/s].
const MOVING: f64 = -6.0;
/// Rate at which the logarithm of the odds of a moving kind changes while an element is at rest
/// [1/s].
const RESTING: f64 = -0.1;
/// Longest time for which one scan is evidence of the kind [s].
const LONGEST: f64 = 0.5;

/// Probabilities that an element of the map was an object, that it is still there, and of its
/// kinds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ElementBelief {
    /// Probability that the element was an object when it was measured last.
    was: f64,
    /// Probability that this object is still there, at the place where it is expected.
    is_there: f64,
    /// Probability that this object is at the expected place or, if its place is not known well,
    /// elsewhere.
    is_anywhere: f64,
    kinds: KindBelief,
    /// Class of the place where the element started; None after the result was passed to
    /// [`Arrivals`].
    began: Option<BirthPlace>,
    /// Time since the last scan that was evidence for or against the object [s].
    since: f64,
    is_measured_once: bool,
    /// Likelihood of all scans since the last measurement if the object is still there, divided by
    /// their likelihood if it is gone.
    missed: f64,
    /// True if the last processed scan measured the element.
    is_in_sight: bool,
}

impl ElementBelief {
    /// Belief about a new element that one scan measured at a place of this class.
    pub(super) fn new(place: BirthPlace, arrivals: &Arrivals) -> Self {
        Self {
            was: arrivals.share(place),
            is_there: 1.0,
            is_anywhere: 1.0,
            kinds: KindBelief::prior(SHARES),
            began: Some(place),
            since: 0.0,
            is_measured_once: true,
            missed: 1.0,
            is_in_sight: true,
        }
    }

    /// Probability that there is an object where it is expected.
    pub(super) fn existence(&self) -> f64 {
        self.was * self.is_there
    }

    /// Probability that there is an object, at the expected place or elsewhere. The element keeps
    /// its ID as long as this is large enough.
    pub(super) fn existence_anywhere(&self) -> f64 {
        self.was * self.is_anywhere
    }

    /// Probability that there was an object when it was measured last.
    pub(super) fn was(&self) -> f64 {
        self.was
    }

    /// Probabilities of the kinds of the element.
    pub(super) fn kinds(&self) -> &KindBelief {
        &self.kinds
    }

    /// Predict over `dt` [s]: the object may leave in this time.
    pub(super) fn predict(&mut self, dt: f64) {
        let stands = self.kinds.probabilities()[TrackKind::Static as usize];
        let rate = stands / LIFETIME_STANDING + (1.0 - stands) / LIFETIME;
        let stays = libm::exp(-dt.max(0.0) * rate);
        (self.is_there, self.is_anywhere) = (stays * self.is_there, stays * self.is_anywhere);
        self.since += dt.max(0.0);
    }

    /// Update the probabilities with a scan that measured the element.
    pub(super) fn measured(&mut self) {
        let once = if std::mem::take(&mut self.is_measured_once) { TWICE } else { 1.0 };
        let chance = once * libm::exp(-self.spoken() / CHANCE);
        self.was = weighed(self.was, 1.0 / chance);
        (self.is_there, self.is_anywhere, self.missed) = (1.0, 1.0, 1.0);
        self.is_in_sight = true;
    }

    /// Update the probabilities with a scan that did not measure the element. `doubt`: probability
    /// that an object that still exists is not at the tested place. It is a lower bound of the
    /// likelihood, however many scans there are.
    pub(super) fn unmeasured(&mut self, visibility: CircleVisibility, doubt: f64) {
        let was_in_sight = std::mem::take(&mut self.is_in_sight);
        let rate = match visibility {
            CircleVisibility::SeenThrough => SEEN_THROUGH,
            CircleVisibility::Returns => UNMATCHED,
            CircleVisibility::Occluded if was_in_sight && self.is_measured_once => {
                self.was = weighed(self.was, COVERED);
                return;
            }
            CircleVisibility::Occluded | CircleVisibility::OutOfView => return,
        };
        let miss = libm::exp(-rate * self.spoken());
        self.is_there = weighed(self.is_there, miss);
        let missed = (self.missed * miss).max(doubt).min(self.missed);
        self.is_anywhere = weighed(self.is_anywhere, missed / self.missed);
        self.missed = missed;
    }

    /// Report once to `arrivals` whether the element was an object: when this is nearly certain, or
    /// when the element ends (`is_over`).
    pub(super) fn settle(&mut self, is_over: bool, arrivals: &mut Arrivals) {
        if (is_over || self.was > SURE)
            && let Some(place) = self.began.take()
        {
            let ratio = match (self.is_there < 0.5, self.is_measured_once) {
                (false, _) => 1.0,
                (true, true) => GONE[0],
                (true, false) => GONE[1],
            };
            arrivals.learn(place, weighed(self.was, ratio));
        }
    }

    /// Update the probabilities of the kinds with whether the element stands; `dt` is the time
    /// since the last update [s].
    pub(super) fn moves(&mut self, stands: bool, dt: f64) {
        let dt = dt.clamp(0.0, LONGEST);
        let [moving, standing] = if stands { [RESTING, 0.0] } else { [0.0, MOVING] };
        let [moving, standing] = [moving, standing].map(|rate| libm::exp(rate * dt));
        self.kinds = self.kinds.weighed([1.0, moving, moving, standing, moving]);
    }

    /// Merge the beliefs about two elements of one object: the more probable one is kept.
    pub(super) fn united(self, other: Self) -> Self {
        if other.existence() > self.existence() { other } else { self }
    }

    /// Time for which the present scan is evidence [s], limited to `SPEAKS`. The time since the
    /// last such scan starts again.
    fn spoken(&mut self) -> f64 {
        std::mem::take(&mut self.since).min(SPEAKS)
    }
}

/// Probability after an observation with this likelihood ratio (Bayes' rule).
fn weighed(probability: f64, ratio: f64) -> f64 {
    let odds = ratio * probability;
    (odds / (odds + 1.0 - probability)).min(MOST)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn new() -> ElementBelief {
        ElementBelief::new(BirthPlace::Revealed, &Arrivals::default())
    }

    /// After so many scans that measured it, at this rate [Hz].
    fn known(scans: usize, rate: f64) -> ElementBelief {
        let mut belief = new();
        (0..scans).for_each(|_| {
            belief.predict(1.0 / rate);
            belief.measured();
        });
        belief
    }

    /// Time until an object is thought to be gone [s].
    fn gone(rate: f64, visibility: CircleVisibility) -> f64 {
        let mut belief = known((3.0 * rate) as usize, rate);
        let mut scans = 0;
        while belief.existence() > OVER {
            belief.predict(1.0 / rate);
            belief.unmeasured(visibility, 0.0);
            scans += 1;
        }
        f64::from(scans) / rate
    }

    #[test]
    fn what_is_measured_exists_and_what_is_hidden_stays_as_probable() {
        assert!(known(2, 20.0).existence() > 0.9);
        let mut belief = known(60, 20.0);
        let sure = belief.existence();
        assert!(sure > SURE);
        belief.unmeasured(CircleVisibility::OutOfView, 0.0);
        belief.unmeasured(CircleVisibility::Occluded, 0.0);
        assert_eq!(belief.existence(), sure);
    }

    #[test]
    fn what_flickers_is_an_object_all_the_same() {
        let mut belief = new();
        for scan in 0..40 {
            belief.predict(0.05);
            if scan % 4 == 3 {
                belief.measured();
            } else {
                belief.unmeasured(CircleVisibility::Returns, 0.0);
            }
        }
        assert!(belief.existence() > 0.9);
    }

    #[test]
    fn what_may_be_elsewhere_is_not_gone() {
        let mut belief = known(60, 20.0);
        for _ in 0..40 {
            belief.predict(0.05);
            belief.unmeasured(CircleVisibility::SeenThrough, 0.1);
        }
        assert!(belief.existence() < OVER && belief.existence_anywhere() > 0.7);
        (0..20).for_each(|_| {
            belief.predict(0.05);
            belief.unmeasured(CircleVisibility::SeenThrough, 0.0); // its place has become known
        });
        assert!(belief.existence_anywhere() < OVER);
    }

    /// One glimpse between two things says little; a second one says more.
    #[test]
    fn what_showed_once_and_is_covered_is_doubtful() {
        let (mut once, mut twice) = (new(), known(1, 20.0));
        once.unmeasured(CircleVisibility::Occluded, 0.0);
        twice.unmeasured(CircleVisibility::Occluded, 0.0);
        assert!(once.existence() < 0.8 && twice.existence() > once.existence() + 0.05);
    }

    #[test]
    fn what_rays_pass_goes_in_a_moment_at_any_rate() {
        for rate in [10.0, 20.0, 40.0] {
            let passed = gone(rate, CircleVisibility::SeenThrough);
            assert!((0.15..0.5).contains(&passed), "{rate} Hz: {passed}");
            let ended = gone(rate, CircleVisibility::Returns);
            assert!((0.3..1.1).contains(&ended), "{rate} Hz: {ended}");
        }
        // A slow scanner may miss an object once.
        assert!(gone(2.0, CircleVisibility::SeenThrough) > 0.5);
    }

    #[test]
    fn it_is_told_once_if_there_was_an_object() {
        let mut arrivals = Arrivals::default();
        let before = arrivals.share(BirthPlace::Revealed);
        let mut belief = known(60, 20.0);
        belief.settle(false, &mut arrivals);
        let after = arrivals.share(BirthPlace::Revealed);
        assert!(after > before);
        belief.settle(true, &mut arrivals);
        assert_eq!(arrivals.share(BirthPlace::Revealed), after);
        new().settle(false, &mut arrivals);
        assert_eq!(arrivals.share(BirthPlace::Revealed), after);
    }

    /// And the opposite: what has moved may leave while it is hidden.
    #[test]
    fn what_never_moved_stays_while_it_is_hidden() {
        let hidden = |stands: bool| {
            let mut belief = known(60, 20.0);
            (0..60).for_each(|_| belief.moves(stands, 0.05));
            (0..100).for_each(|_| {
                belief.predict(0.05);
                belief.unmeasured(CircleVisibility::Occluded, 0.0);
            });
            belief.existence()
        };
        let (post, walker) = (hidden(true), hidden(false));
        assert!(post > 0.95 && (0.9..0.93).contains(&walker), "{post} {walker}");
    }

    #[test]
    fn who_stops_still_moves_at_times_and_what_never_moved_stands() {
        let mut belief = new();
        (0..100).for_each(|_| belief.moves(true, 0.1));
        assert_eq!(belief.kinds().kind(), TrackKind::Static);
        (0..20).for_each(|_| belief.moves(false, 0.1));
        assert_eq!(belief.kinds().kind(), TrackKind::Ground);
        (0..50).for_each(|_| belief.moves(true, 0.1));
        assert_eq!(belief.kinds().kind(), TrackKind::Ground);
    }
}
