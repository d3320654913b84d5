//! How probable it is that there is an object where an element is, and of which kind it is.
//!
//! Besides an object, a chance group of rays makes an element: a piece of a surface that shows for a
//! moment between two others, or the rim of something. Every scan says how well each of both explains
//! what it showed of the element.

use super::view::visibility::CircleVisibility;
use crate::tracking::existence::{Presence, Sojourn};
use crate::tracking::kind::{KINDS, KindBelief};
use serde::{Deserialize, Serialize};

/// Mean times for which an object stays, is measured, and is not although it is in view [s].
const MEAN: Sojourn = Sojourn { lifetime: 60.0, visible: 10.0, hidden: 0.5 };
/// Probability that there is an object where one scan met something.
const NEW: f64 = 0.7;

/// How likely each cause makes what a scan shows: an object, one that is in view but not measured for
/// a while, and none.
type Causes = [f64; 3];

/// Shares of scans, of simulated rooms and posts.
const MEASURED: Causes = [0.95, 0.05, 0.6];
const SEEN_THROUGH: Causes = [0.002, 0.05, 0.2];
const UNMATCHED: Causes = [0.03, 0.9, 0.3];

/// Shares of kinds among new elements, in the order of `TrackKind::ALL`: most stand.
const SHARES: [f64; KINDS] = [0.05, 1e-3, 0.3, 0.6, 0.05];
/// Rates at which the logarithm of the odds of a kind changes [1/s]: of what moves, that it is
/// something that stands; of what stands, that it is something that moves at times.
const MOVING: f64 = -6.0;
const RESTING: f64 = -0.1;
/// Longest time that one scan speaks for [s].
const LONGEST: f64 = 0.5;

/// What is known of the cause of an element.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ElementBelief {
    presence: Presence,
    kinds: KindBelief,
}

impl ElementBelief {
    /// Of an element that one scan measured.
    pub(super) fn new() -> Self {
        Self { presence: Presence::measured(NEW), kinds: KindBelief::prior(SHARES) }
    }

    /// Probability that there is an object.
    pub(super) fn existence(&self) -> f64 {
        self.presence.existence
    }

    /// Probabilities of its kinds.
    pub(super) fn kinds(&self) -> &KindBelief {
        &self.kinds
    }

    /// The same after `dt` [s] without a scan.
    pub(super) fn predict(&mut self, dt: f64) {
        self.presence = self.presence.predicted(dt, &MEAN);
    }

    /// Take in a scan that measured the element.
    pub(super) fn measured(&mut self) {
        self.take(MEASURED);
    }

    /// Take in a scan that did not.
    pub(super) fn unmeasured(&mut self, visibility: CircleVisibility) {
        match visibility {
            CircleVisibility::SeenThrough => self.take(SEEN_THROUGH),
            CircleVisibility::Returns => self.take(UNMATCHED),
            CircleVisibility::Occluded | CircleVisibility::OutOfView => {}
        }
    }

    /// Take in whether it stands, `dt` [s] after the last time.
    pub(super) fn moves(&mut self, stands: bool, dt: f64) {
        let dt = dt.clamp(0.0, LONGEST);
        let [moving, standing] = if stands { [RESTING, 0.0] } else { [0.0, MOVING] };
        let [moving, standing] = [moving, standing].map(|rate| libm::exp(rate * dt));
        self.kinds = self.kinds.weighed([1.0, moving, moving, standing, moving]);
    }

    /// Of two elements of one object, the more probable.
    pub(super) fn united(self, other: Self) -> Self {
        if other.existence() > self.existence() { other } else { self }
    }

    fn take(&mut self, [object, hidden, none]: Causes) {
        self.presence = self.presence.weighed(object / none, hidden / none);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracking::kind::TrackKind;

    #[test]
    fn what_is_measured_exists_and_what_rays_pass_does_not() {
        let mut belief = ElementBelief::new();
        (0..4).for_each(|_| {
            belief.predict(0.05);
            belief.measured();
        });
        assert!(belief.existence() > 0.9);
        let known = belief;
        belief.unmeasured(CircleVisibility::Occluded);
        assert_eq!(belief, known);
        (0..5).for_each(|_| {
            belief.predict(0.05);
            belief.unmeasured(CircleVisibility::SeenThrough);
        });
        assert!(belief.existence() < 0.05, "{}", belief.existence());
    }

    #[test]
    fn who_stops_still_moves_at_times_and_what_never_moved_stands() {
        let mut belief = ElementBelief::new();
        (0..100).for_each(|_| belief.moves(true, 0.1));
        assert_eq!(belief.kinds().kind(), TrackKind::Static);
        (0..20).for_each(|_| belief.moves(false, 0.1));
        assert_eq!(belief.kinds().kind(), TrackKind::Ground);
        (0..50).for_each(|_| belief.moves(true, 0.1));
        assert_eq!(belief.kinds().kind(), TrackKind::Ground);
    }
}
