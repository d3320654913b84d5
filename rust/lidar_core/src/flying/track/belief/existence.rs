//! Probability that the target of a track exists, and probabilities of its kinds.
//!
//! Besides a target, two other causes make detections: something that stands still and has just come
//! into view, such as a part of a surface, and returns that come and go, such as rain, dust and leaves.
//! Every set of detections says how well each of the three explains what was seen of a track. How often
//! tracks begin that have no target is learnt from those that end.
//!
//! The same evidence shows whether the target is at rest: see [`Kinds`].

use super::super::measurement::Evidence;
use super::super::motion::seconds;
use super::super::visibility::occupancy::ENOUGH_RAYS;
use super::kinds::Kinds;
use crate::tracking::existence::{Presence, Sojourn};
use crate::tracking::kind::KindBelief;
use serde::{Deserialize, Serialize};

/// A track is removed if its target is less probable.
pub(in crate::flying::track) const DELETED: f64 = 0.01;
/// Share of the probability from which on a track is reported, below which it is not any more.
pub(in crate::flying::track) const KEPT: f64 = 0.5;
/// Detections of less confidence are weak.
pub(in crate::flying::track) const SURE: f64 = 0.7;
/// A track this far from where it began has moved, with two standard deviations on top [m] ...
pub(in crate::flying::track) const MOVED: f64 = 0.5;
/// ... if nothing is left this near to its start [m].
pub(in crate::flying::track) const CLEARED: f64 = 0.3;
/// Rays through the place of a target that hardly ever miss it.
pub(in crate::flying::track) const MANY_RAYS: usize = 12;

/// Probability that the target exists of a track that begins with many scans.
const OF_MOVER: f64 = 0.98;

/// Mean times for which a target stays, gives returns, and gives none although it is in view [s].
const MEAN: Sojourn = Sojourn { lifetime: 30.0, visible: 5.0, hidden: 0.3 };

/// What a set of detections, and the scan before it, show of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(in crate::flying::track) enum Sight {
    /// It is outside of the field of view, or hidden: no evidence.
    Unseen,
    /// Many rays passed its place without a hit.
    Missed,
    /// A few rays did.
    BarelyMissed,
    /// There are points, but no evidence that they are in free space.
    Followed,
    /// Too few points for a detection, in free space.
    Few,
    /// A detection that is not certain.
    Weak,
    /// A certain detection.
    Sure,
}

/// How likely each cause makes something: a target, one that gives no returns for a while, something
/// that stands, and what comes and goes. Only ratios count.
pub(super) type CauseLikelihoods = [f64; 4];

impl Sight {
    /// Of a track without points, through whose place so many rays went.
    pub(in crate::flying::track) fn without(rays: usize) -> Self {
        match rays {
            MANY_RAYS.. => Self::Missed,
            ENOUGH_RAYS.. => Self::BarelyMissed,
            _ => Self::Unseen,
        }
    }

    /// Whether it tells about a track at all. Points that may be of anything say that what began the
    /// track stands, but nothing about what has moved; few points say something about that alone.
    pub(super) fn tells(self, has_moved: bool) -> bool {
        match self {
            Self::Followed => !has_moved,
            Self::Few => has_moved,
            _ => true,
        }
    }

    /// Whether it is something in free space, of which the place tells.
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

    /// Shares of what was seen of tracks, with and without targets, of simulated sensors as their
    /// drivers deliver them and in rain, dust, leaves and among insects.
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

/// Of a detection that seems to be a part of a surface: one in thirty of those of targets, half of
/// those of parts.
const JOINED: CauseLikelihoods = [0.033, 0.033, 0.5, 0.033];
/// Of having more points around it than its own.
const AMONG_STRAYS: f64 = 0.02;

/// Probabilities of the causes of a track.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(in crate::flying::track) struct TrackBelief {
    pub(super) presence: Presence,
    /// Probability that something stands there, if there is no target.
    pub(super) standing: f64,
    pub(super) stamp_ns: i64,
    pub(super) has_moved: bool,
    kinds: Kinds,
}

impl TrackBelief {
    /// Before anything was seen.
    pub(in crate::flying::track) fn unknown(stamp_ns: i64) -> Self {
        let presence = Presence::measured(0.5);
        let kinds = Kinds::new();
        Self { presence, standing: 0.5, stamp_ns, has_moved: false, kinds }
    }

    /// Of a target that many scans together show to move.
    pub(in crate::flying::track) fn of_mover(stamp_ns: i64) -> Self {
        let presence = Presence::measured(OF_MOVER);
        let kinds = Kinds::of_mover();
        Self { presence, standing: 0.0, stamp_ns, has_moved: true, kinds }
    }

    /// At another time, without anything seen.
    pub(in crate::flying::track) fn at(&self, stamp_ns: i64) -> Self {
        let presence = self.presence.predicted(seconds(self.stamp_ns, stamp_ns), &MEAN);
        Self { presence, stamp_ns, ..*self }
    }

    /// Probability that the target exists: one among many returns that belong to nothing is rather one
    /// of them.
    pub(in crate::flying::track) fn existence(&self, is_among_strays: bool) -> f64 {
        let odds = if is_among_strays { AMONG_STRAYS } else { 1.0 };
        self.presence.weighed(odds, odds).existence
    }

    /// Whether the track was seen away from where it began.
    pub(in crate::flying::track) fn has_moved(&self) -> bool {
        self.has_moved
    }

    /// Enter that something was there before, with this probability at least.
    pub(super) fn exists(&mut self, existence: f64) {
        if self.presence.existence < existence {
            self.presence = Presence::measured(existence);
        }
    }

    /// The more probable belief of two tracks of one target.
    pub(in crate::flying::track) fn more_probable(self, other: Self) -> Self {
        if other.presence.existence > self.presence.existence { other } else { self }
    }

    /// Probabilities of what the target is.
    pub(in crate::flying::track) fn kinds(&self) -> KindBelief {
        self.kinds.belief(self.has_moved)
    }

    /// Enter what a detection shows of the target itself.
    pub(super) fn take_shape(&mut self, evidence: Evidence) {
        if evidence.is_joined {
            self.take(JOINED);
            self.kinds.see_joined();
        }
        if let Some(shape) = evidence.shape {
            self.kinds.measure(shape, evidence.is_led);
        }
    }

    /// Enter how much came and went, 0 to 1, where it was detected, and whether it stays beside structure.
    pub(in crate::flying::track) fn visit(&mut self, share: f64, hangs: bool) {
        self.kinds.visit(share, hangs);
    }

    /// Enter whether something stood where it was detected before it began, 0 to 1.
    pub(in crate::flying::track) fn stand(&mut self, stood: f64) {
        self.kinds.stand(stood);
    }

    /// Enter the acceleration of the track along every axis [m/s^2] and its variance, `seconds` after the
    /// last one; `expected` is the standard deviation that a new track has.
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

/// Number of sets after which one counts 1/e.
const MEMORY: f64 = 300.0;
/// Tracks that begin with a target, in a set of detections.
const TARGETS: f64 = 0.05;
/// Tracks that begin without one, and the sets in which they did, before tracks tell.
const FALSE_PRIOR: f64 = 1.0;
const SETS_PRIOR: f64 = 10.0;
/// Tracks without a target that a set begins where the likelihoods of what comes and goes hold; where
/// there are more of them, more detections of it fall into the gate of a track.
const USUAL: f64 = 0.1;
const CLUTTER_BOUNDS: [f64; 2] = [0.5, 1.8];
/// Fewest tracks without a target that a set is expected to begin.
const FEWEST: f64 = 0.02;

/// What new tracks, and detections in the gates of tracks, are expected to be.
#[derive(Clone, Copy, Debug)]
pub(in crate::flying::track) struct ExpectedClutter {
    /// Probability that a new track has a target.
    pub(super) prior: f64,
    /// Detections of what comes and goes, over the usual.
    clutter: f64,
}

/// How often tracks begin that have no target.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(in crate::flying::track) struct FalseBirths {
    sets: f64,
    without_target: f64,
}

impl FalseBirths {
    /// Take in a set of detections.
    pub(in crate::flying::track) fn count_set(&mut self) {
        let kept = 1.0 - 1.0 / MEMORY;
        self.sets = kept * self.sets + 1.0;
        self.without_target *= kept;
    }

    /// Take in the end of a track that was never confirmed and had a target with this probability.
    pub(in crate::flying::track) fn count_end(&mut self, existence: f64) {
        self.without_target += 1.0 - existence;
    }

    /// What is expected of the next set, beside so many tracks without a target that are there already.
    pub(in crate::flying::track) fn expected(&self, alive: f64) -> ExpectedClutter {
        let without = (FALSE_PRIOR + self.without_target + alive) / (SETS_PRIOR + self.sets);
        let [low, high] = CLUTTER_BOUNDS;
        ExpectedClutter {
            prior: TARGETS / (TARGETS + without.max(FEWEST)),
            clutter: (without / USUAL).sqrt().clamp(low, high),
        }
    }
}
