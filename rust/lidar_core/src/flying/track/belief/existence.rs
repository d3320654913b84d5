//! Probability that the target of a track exists, and probabilities of its kinds.
//!
//! Besides a target, there are two causes of detections: a static object that has just come into
//! view, such as a part of a surface, and returns that appear and disappear, such as rain, dust and
//! leaves. Every set of detections gives the likelihood of the observation of a track under each of
//! the three causes. The rate of new tracks without a target is learnt from the tracks that end.
//!
//! The same evidence shows whether the target is at rest: see [`Kinds`].

use super::super::measurement::Evidence;
use super::super::motion::seconds;
use super::super::visibility::occupancy::ENOUGH_RAYS;
use super::kinds::Kinds;
use crate::tracking::existence::{Presence, Sojourn};
use crate::tracking::kind::KindBelief;
use serde::{Deserialize, Serialize};

/// Probability of existence below which a track is removed.
pub(in crate::flying::track) const DELETED: f64 = 0.01;
/// Share of the probability for reporting (`report`) at which a reported track stops being
/// reported.
pub(in crate::flying::track) const KEPT: f64 = 0.5;
/// Confidence below which a detection is weak.
pub(in crate::flying::track) const SURE: f64 = 0.7;
/// A track has moved if it is further than this, plus two standard deviations, from its first
/// detection [m], and nothing is left there: see [`CLEARED`].
pub(in crate::flying::track) const MOVED: f64 = 0.5;
/// No point may be left within this distance of the first detection of a track that has moved [m].
pub(in crate::flying::track) const CLEARED: f64 = 0.3;
/// Number of rays through the place of a target that hardly ever all miss it.
pub(in crate::flying::track) const MANY_RAYS: usize = 12;

/// Probability of existence for the target of a track that several scans together showed to move.
const OF_MOVER: f64 = 0.98;

/// Mean times for which a target exists, gives returns, and gives none although it is in view [s].
const MEAN: Sojourn = Sojourn { lifetime: 30.0, visible: 5.0, hidden: 0.3 };

/// What a set of detections, and the scan before it, show of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(in crate::flying::track) enum Sight {
    /// The track is outside of the field of view, or hidden: no evidence.
    Unseen,
    /// Many rays passed through its place without a hit.
    Missed,
    /// A few rays passed through its place without a hit.
    BarelyMissed,
    /// There are points at its place, but no evidence that they are in free space.
    Followed,
    /// There are points in free space, but too few for a detection.
    Few,
    /// A detection that is not certain.
    Weak,
    /// A certain detection.
    Sure,
}

/// Likelihoods of an observation under each cause: a target; a target that gives no returns for a
/// while; a static object; returns that appear and disappear. Only their ratios count.
pub(super) type CauseLikelihoods = [f64; 4];

impl Sight {
    /// Observation of a track without points, through whose place this number of rays went.
    pub(in crate::flying::track) fn without(rays: usize) -> Self {
        match rays {
            MANY_RAYS.. => Self::Missed,
            ENOUGH_RAYS.. => Self::BarelyMissed,
            _ => Self::Unseen,
        }
    }

    /// Whether the observation is evidence for this track. Points at its place that may belong to
    /// any object (`Followed`) are no evidence once the track has moved. Too few points for a
    /// detection (`Few`) are evidence only then.
    pub(super) fn tells(self, has_moved: bool) -> bool {
        match self {
            Self::Followed => !has_moved,
            Self::Few => has_moved,
            _ => true,
        }
    }

    /// Whether points were observed in free space, so that the clutter of the place counts.
    pub(super) fn is_in_free_space(self) -> bool {
        matches!(self, Self::Few | Self::Weak | Self::Sure)
    }

    pub(super) fn of_detection(evidence: Evidence) -> Self {
        match evidence {
            Evidence { is_led: true, .. } => Self::Followed,
            Evidence { is_sure: true, .. } => Self::Sure,
            _ => Self::Weak,
        }
    }

    /// Likelihoods of the observation under each cause. They are frequencies from simulations of
    /// sensors, as their drivers deliver the data, with and without targets, in rain, dust and
    /// leaves and among insects.
    pub(super) fn likelihood(self, around: ExpectedClutter) -> CauseLikelihoods {
        let [target, hidden, standing, fleeting] = self.shares();
        let more = if self.is_in_free_space() { around.clutter } else { 1.0 };
        [target, hidden, standing, more * fleeting]
    }

    fn shares(self) -> CauseLikelihoods {
        match self {
            Self::Unseen => [1.0; 4],
            Self::Missed => [0.06, 0.42, 0.10, 0.60],
            Self::BarelyMissed => [0.20, 0.42, 0.10, 0.60],
            Self::Followed => [0.25, 0.03, 0.55, 0.16],
            Self::Few => [0.04, 0.02, 0.005, 0.015],
            Self::Weak => [0.33, 0.03, 0.15, 0.20],
            Self::Sure => [0.33, 0.02, 0.02, 0.08],
        }
    }
}

/// Likelihoods of the causes for a detection that seems to be part of a surface: one in thirty
/// detections of targets, half of those of parts of surfaces.
const JOINED: CauseLikelihoods = [0.033, 0.033, 0.5, 0.033];
/// Likelihood, for a target, of having more points around it than its own, relative to other
/// causes.
const AMONG_STRAYS: f64 = 0.02;

/// Probabilities of the causes that may have made a track.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(in crate::flying::track) struct TrackBelief {
    pub(super) presence: Presence,
    /// Probability that something stands at the track's place, given that there is no target.
    pub(super) standing: f64,
    pub(super) stamp_ns: i64,
    pub(super) has_moved: bool,
    kinds: Kinds,
}

impl TrackBelief {
    /// Belief before any observation.
    pub(in crate::flying::track) fn unknown(stamp_ns: i64) -> Self {
        let presence = Presence::measured(0.5);
        let kinds = Kinds::new();
        Self { presence, standing: 0.5, stamp_ns, has_moved: false, kinds }
    }

    /// Belief about a target that several scans together show to move.
    pub(in crate::flying::track) fn of_mover(stamp_ns: i64) -> Self {
        let presence = Presence::measured(OF_MOVER);
        let kinds = Kinds::of_mover();
        Self { presence, standing: 0.0, stamp_ns, has_moved: true, kinds }
    }

    /// The belief predicted to `stamp_ns`, without a new observation.
    pub(in crate::flying::track) fn at(&self, stamp_ns: i64) -> Self {
        let presence = self.presence.predicted(seconds(self.stamp_ns, stamp_ns), &MEAN);
        Self { presence, stamp_ns, ..*self }
    }

    /// Probability that the target exists. `is_among_strays`: there are more points around the
    /// track that belong to no track than its own. It is then probably one of these points.
    pub(in crate::flying::track) fn existence(&self, is_among_strays: bool) -> f64 {
        let odds = if is_among_strays { AMONG_STRAYS } else { 1.0 };
        self.presence.weighed(odds, odds).existence
    }

    /// Whether the track was seen away from its first detection, with nothing left there.
    pub(in crate::flying::track) fn has_moved(&self) -> bool {
        self.has_moved
    }

    /// Raise the probability that the target exists to at least `existence`: something was there
    /// before.
    pub(super) fn exists(&mut self, existence: f64) {
        if self.presence.existence < existence {
            self.presence = Presence::measured(existence);
        }
    }

    /// Of two beliefs about the same target, the one with the higher probability of existence.
    pub(in crate::flying::track) fn more_probable(self, other: Self) -> Self {
        if other.presence.existence > self.presence.existence { other } else { self }
    }

    /// Probabilities of the kinds of the target.
    pub(in crate::flying::track) fn kinds(&self) -> KindBelief {
        self.kinds.belief(self.has_moved)
    }

    /// Enter what a detection shows of the target itself: whether it seems part of a surface, and
    /// its shape.
    pub(super) fn take_shape(&mut self, evidence: Evidence) {
        if evidence.is_joined {
            self.take(JOINED);
            self.kinds.see_joined();
        }
        if let Some(shape) = evidence.shape {
            self.kinds.measure(shape, evidence.is_led);
        }
    }

    /// Enter one detection: how often detections appeared and disappeared at its place before, 0 to
    /// 1, and whether the track stays beside structure.
    pub(in crate::flying::track) fn visit(&mut self, share: f64, hangs: bool) {
        self.kinds.visit(share, hangs);
    }

    /// Enter for one detection whether something stood at its place before the track began, 0 (no)
    /// to 1 (yes).
    pub(in crate::flying::track) fn stand(&mut self, stood: f64) {
        self.kinds.stand(stood);
    }

    /// Enter that something stood at the places of all detections so far.
    pub(super) fn stood_so_far(&mut self) {
        self.kinds.stood_so_far();
    }

    /// Enter the track's acceleration [m/s^2] and its variance along every axis, `seconds` after
    /// the last entry. `expected`: standard deviation of the acceleration of a new track [m/s^2].
    pub(super) fn take_acceleration(
        &mut self,
        accelerations: [[f64; 2]; 3],
        expected: f64,
        seconds: f64,
    ) {
        self.kinds.feel(accelerations, expected, seconds);
    }

    pub(super) fn take(&mut self, [target, hidden, standing, fleeting]: CauseLikelihoods) {
        let share = self.presence.hidden / self.presence.existence;
        let of_target = share * hidden + (1.0 - share) * target;
        self.kinds.see(of_target, standing);
        let without = self.standing * standing + (1.0 - self.standing) * fleeting;
        self.standing *= standing / without;
        self.presence = self.presence.weighed(target / without, hidden / without);
    }
}

/// Number of sets of detections after which the weight of an old set has fallen to 1/e.
const MEMORY: f64 = 300.0;
/// Expected number of tracks with a target that one set of detections begins.
const TARGETS: f64 = 0.05;
/// Prior of the statistics: this number of tracks without a target began in `SETS_PRIOR` sets.
const FALSE_PRIOR: f64 = 1.0;
/// Number of sets in which the tracks of [`FALSE_PRIOR`] began.
const SETS_PRIOR: f64 = 10.0;
/// Tracks without a target that one set begins where the likelihoods of the cause "comes and goes"
/// hold as they are. If more begin, more detections of that cause also fall into the gates of
/// tracks.
const USUAL: f64 = 0.1;
/// Limits of the factor for the likelihood of detections that come and go.
const CLUTTER_BOUNDS: [f64; 2] = [0.5, 1.8];
/// Smallest expected number of tracks without a target that one set begins.
const FEWEST: f64 = 0.02;

/// What is expected of the next set of detections, from the statistics of tracks without a target.
#[derive(Clone, Copy, Debug)]
pub(in crate::flying::track) struct ExpectedClutter {
    /// Prior probability that a new track has a target.
    pub(super) prior: f64,
    /// Factor for the likelihood of detections that come and go, relative to the usual rate.
    clutter: f64,
}

/// Statistics: how often tracks without a target begin.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(in crate::flying::track) struct FalseBirths {
    sets: f64,
    without_target: f64,
}

impl FalseBirths {
    /// Count a set of detections.
    pub(in crate::flying::track) fn count_set(&mut self) {
        let kept = 1.0 - 1.0 / MEMORY;
        self.sets = kept * self.sets + 1.0;
        self.without_target *= kept;
    }

    /// Count the end of a track that was never confirmed. `existence`: probability that it had a
    /// target.
    pub(in crate::flying::track) fn count_end(&mut self, existence: f64) {
        self.without_target += 1.0 - existence;
    }

    /// What to expect of the next set of detections. `alive`: expected number of present tracks
    /// without a target.
    pub(in crate::flying::track) fn expected(&self, alive: f64) -> ExpectedClutter {
        let without = (FALSE_PRIOR + self.without_target + alive) / (SETS_PRIOR + self.sets);
        let [low, high] = CLUTTER_BOUNDS;
        ExpectedClutter {
            prior: TARGETS / (TARGETS + without.max(FEWEST)),
            clutter: (without / USUAL).sqrt().clamp(low, high),
        }
    }
}
