//! Entry of detections, as evidence, into the belief about the targets of tracks.

use super::super::measurement::Evidence;
use super::super::motion::{position_block, seconds};
use super::super::state::PointTrack;
use super::existence::{CauseLikelihoods, ExpectedClutter, MOVED, Sight, TrackBelief};
use crate::tracking::existence::Presence;

/// Likelihoods of the causes for a first detection with more returns of surfaces around it than its
/// own. Parts of a surface come into view beside the rest of the surface; few targets do.
const AMONG_SURFACES: CauseLikelihoods = [0.18, 0.18, 1.0, 0.6];
/// Likelihoods of the causes for a track that has moved.
const HAS_MOVED: CauseLikelihoods = [0.9, 0.9, 0.03, 0.6];
/// Likelihood ratio for the position of a detection, at distance zero and for the largest gate:
/// targets are found near the prediction (chi-squared distribution of the squared Mahalanobis
/// distance), while other detections are uniformly distributed in the gate. `NEAR_BOUNDS` limits
/// the ratio, because real targets fit less well, and other detections are less scattered.
const NEAREST: f64 = 25.0;
/// Limits of the likelihood ratio for the position of a detection.
const NEAR_BOUNDS: [f64; 2] = [0.4, 2.5];
/// Upper limit of that ratio for the third detection of a fast target, whose track began with two.
/// Returns that appear and disappear hardly ever give three detections on a straight line that are
/// metres apart.
const NEAR_THIRD: f64 = 10.0;
/// Likelihoods of the causes for two detections that only a fast target explains. Few targets are
/// that fast.
const IS_FAST: CauseLikelihoods = [0.3, 0.3, 1.0, 1.0];

/// Belief about a new track, from the evidence of its first detections.
pub(in crate::flying::track) fn born(
    around: ExpectedClutter,
    track: &PointTrack,
    stamp_ns: i64,
) -> TrackBelief {
    let mut belief = TrackBelief::unknown(stamp_ns);
    belief.presence = Presence::measured(around.prior);
    for evidence in track.before.into_iter().chain([track.first]) {
        belief.take(Sight::of_detection(evidence).likelihood(around));
        belief.take_shape(evidence);
    }
    if track.before.is_some() {
        belief.take(IS_FAST);
    }
    if track.first.is_among_surfaces {
        belief.take(AMONG_SURFACES);
    }
    belief
}

/// Enter a set of detections of `stamp_ns` into the belief about a track. `evidence`: that of its
/// detection; None if the set has none for it. `acceleration_std`: standard deviation of the
/// acceleration of a new track [m/s^2].
pub(in crate::flying::track) fn weigh(
    track: &mut PointTrack,
    evidence: Option<Evidence>,
    around: ExpectedClutter,
    acceleration_std: f64,
    stamp_ns: i64,
) {
    let seen = std::mem::replace(&mut track.sight, Sight::Unseen);
    let sight = evidence.map_or(seen, Sight::of_detection);
    let mut belief = track.belief.at(stamp_ns.max(track.belief.stamp_ns));
    let is_clear = evidence.is_some_and(|evidence| !evidence.is_led && !evidence.is_among_surfaces);
    if is_clear && track.was_confirmed && !track.confirmed {
        belief.exists(around.prior); // it was lost: what it has found may as well be a new target
    }
    let near = track.nis.take().map(|nis| NEAREST * libm::exp(-0.5 * nis));
    if sight.is_in_free_space() && !belief.has_moved && has_moved(track) {
        belief.has_moved = true;
        belief.take(HAS_MOVED);
        belief.standing = 0.0; // it may be something else yet, but it does not stand
    }
    if sight.tells(belief.has_moved) {
        belief.take(sight.likelihood(around));
        if let Some(near) = near.filter(|_| evidence.is_some()) {
            let is_third = track.before.is_some() && track.n_detections == 3;
            let most = if is_third { NEAR_THIRD } else { NEAR_BOUNDS[1] };
            let near = near.clamp(NEAR_BOUNDS[0], most);
            belief.take([near, near, near, 1.0]);
        }
    }
    if let Some(evidence) = evidence {
        belief.take_shape(evidence);
        let state = &track.estimate;
        let axis = |at: usize| [state.mean[6 + at], state.covariance[(6 + at, 6 + at)]];
        let since = seconds(track.belief.stamp_ns, stamp_ns);
        belief.take_acceleration([0, 1, 2].map(axis), acceleration_std, since);
    }
    track.belief = belief;
}

/// Whether a track is certainly away from its first detection and nothing is left there.
fn has_moved(track: &PointTrack) -> bool {
    let spread = position_block(&track.estimate.covariance).trace() / 3.0;
    let reach = MOVED + 2.0 * spread.max(0.0).sqrt();
    track.left && (track.position() - track.born_at).norm() > reach
}
