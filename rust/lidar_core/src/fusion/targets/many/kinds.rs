//! Kinds of targets: at rest, moving, flying, or clutter.
//!
//! The measured positions show whether a target is at rest. Their noise is estimated from their own
//! scatter, not from the configured noise of the sensors. In space, a line through the positions
//! also shows whether the target climbs. The probability of clutter comes from the association.

use crate::tracking::kind::{KINDS, KindBelief, TrackKind};
use crate::tracking::place_trend::{PlaceTrend, Slope};
use crate::tracking::resting::MotionBelief;
use serde::{Deserialize, Serialize};

/// Prior probabilities of the kinds of a new track, in the order of `TrackKind::ALL`.
const SHARES: [f64; KINDS] = [0.02, 0.3, 0.3, 0.33, 0.05];
/// Largest logarithm of the likelihood ratio for flying that all stored positions give together:
/// one of them may be wrong.
const MOST: f64 = 5.0;
/// Standard deviation of the rate of climb of flying targets [m/s].
const CLIMBS: f64 = 1.0;
/// Standard deviation of the rate of climb of targets on level ground [m/s].
const LEVEL: f64 = 0.1;
/// Standard deviation of the slope of the ground (rise over run, no unit).
const SLOPES: f64 = 0.1;
/// Least number of positions for the decision whether a target is at rest, because their scatter
/// gives the noise. If the noise were estimated too small, later positions would contradict a
/// target at rest.
const FEWEST: usize = 6;
/// Least number of positions for a rate of climb. With fewer, every second car would seem to climb
/// slightly more steeply than its road.
const FEWEST_OF_CLIMB: usize = 6;
/// Share of the time in which flying targets neither climb nor sink.
const CRUISES: f64 = 0.5;

/// Probabilities of the kinds of a target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct TargetKinds {
    /// Belief about the kind from the rate of climb alone.
    climbs: KindBelief,
    /// Belief whether the target is at rest; None before there are [`FEWEST`] positions.
    motion: Option<MotionBelief>,
    trend: PlaceTrend,
    /// Probability that its last measurements are clutter; None if the association gives no such
    /// probability.
    clutter: Option<f64>,
}

impl Default for TargetKinds {
    /// Nothing was measured.
    fn default() -> Self {
        let climbs = KindBelief::prior(SHARES);
        Self { climbs, motion: None, trend: PlaceTrend::default(), clutter: None }
    }
}

impl TargetKinds {
    /// Update the belief with a measured position [m] and its configured variances along the axes
    /// [m^2]. `speed`: variance of the speed of new targets [m^2/s^2].
    pub(super) fn see(
        &mut self,
        stamp_ns: i64,
        (place, told): ([f64; 3], [f64; 3]),
        speed: f64,
        is_in_space: bool,
    ) {
        let dt = self.trend.take(stamp_ns, place, told);
        let at = [place[0], place[1]];
        let noise = [0, 1].map(|axis| self.trend.noise(axis));
        let first = || {
            let stands = SHARES[usize::from(u8::from(TrackKind::Static))];
            MotionBelief::new(stands, at, noise.map(|noise| noise.variance), speed)
        };
        if self.motion.is_none() {
            self.motion = (self.trend.count() >= FEWEST).then(first);
            return;
        }
        // Of one time: one sight of the target.
        let Some(motion) = self.motion.as_mut().filter(|_| dt > 0.0) else { return };
        motion.see(dt, at, noise, speed);
        if !motion.is_sound() {
            self.motion = Some(first()).filter(MotionBelief::is_sound);
        }
        let tells_climb = is_in_space && self.trend.count() >= FEWEST_OF_CLIMB;
        let slopes = [0, 1, 2].map(|axis| self.trend.slope(axis).filter(|_| tells_climb));
        let [Some(x), Some(y), Some(climb)] = slopes else { return };
        let speed = libm::hypot(x.velocity, y.velocity);
        let climbs = climbing(&climb, speed) / self.trend.count() as f64;
        // All of it for what flies, and half of it for what is none of the kinds.
        let [unknown, flies] = [0.5, 1.0].map(|share| libm::exp(share * climbs));
        self.climbs = self.climbs.weighed([unknown, flies, 1.0, 1.0, 1.0]);
    }

    /// Set the probability that the measurements are clutter. It is kept from the last measurement:
    /// missed detections do not raise it.
    pub(super) fn tell_clutter(&mut self, probability: Option<f64>) {
        self.clutter = probability;
    }

    /// Probabilities of the kinds.
    pub(super) fn belief(&self) -> KindBelief {
        let seen = self.motion.as_ref().map_or(self.climbs, |motion| {
            let before = SHARES[usize::from(u8::from(TrackKind::Static))];
            let stands = motion.stands() / before;
            let moves = (1.0 - motion.stands()) / (1.0 - before);
            self.climbs.weighed([moves, moves, moves, stands, moves])
        });
        let Some(clutter) = self.clutter else { return seen };
        let own = seen.probability(TrackKind::Clutter);
        // As much of it as that, in place of what motion alone says.
        let mut shares = seen.probabilities().map(|kind| kind * (1.0 - clutter) / (1.0 - own));
        shares[usize::from(u8::from(TrackKind::Clutter))] = clutter;
        KindBelief::prior(shares)
    }

    /// True if the values of a restored state are valid.
    pub(super) fn is_sound(&self) -> bool {
        self.motion.as_ref().is_none_or(MotionBelief::is_sound)
    }
}

/// Logarithm of the likelihood ratio of this rate of climb, from 0 to [`MOST`]: flying target to
/// ground vehicle with the horizontal `speed` [m/s]. It is never negative, because level flight is
/// no evidence against a flying target.
fn climbing(climb: &Slope, speed: f64) -> f64 {
    let slope = SLOPES * speed;
    let level = LEVEL * LEVEL + slope * slope;
    let ratio = climb.log_density(level + CLIMBS * CLIMBS) - climb.log_density(level);
    log_sum([libm::log(1.0 - CRUISES) + ratio, libm::log(CRUISES)]).clamp(0.0, MOST)
}

/// Logarithm of the sum of exponentials.
fn log_sum<const N: usize>(values: [f64; N]) -> f64 {
    let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest + libm::log(values.iter().map(|value| libm::exp(value - largest)).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOLD: [f64; 3] = [0.01; 3];

    /// Seen ten times a second for so many scans, at places by time [s], with errors up to 0.1 m.
    fn followed(place: impl Fn(f64) -> [f64; 3], scans: u32, is_in_space: bool) -> TargetKinds {
        let mut kinds = TargetKinds::default();
        for k in 0..scans {
            let error = |n: u32| 0.2 * (f64::from(3 * k + n) * 0.618_034 % 1.0 - 0.5);
            let [x, y, z] = place(0.1 * f64::from(k));
            let at = [x + error(0), y + error(1), z + error(2)];
            kinds.see(i64::from(k) * 100_000_000, (at, TOLD), 225.0, is_in_space);
        }
        kinds
    }

    fn told(kinds: &TargetKinds, clutter: f64) -> KindBelief {
        let mut kinds = kinds.clone();
        kinds.tell_clutter(Some(clutter));
        kinds.belief()
    }

    fn kind(kinds: &TargetKinds) -> TrackKind {
        told(kinds, 0.01).kind()
    }

    #[test]
    fn what_stands_is_static_after_some_seconds() {
        assert_eq!(kind(&TargetKinds::default()), TrackKind::Unknown);
        assert_eq!(kind(&followed(|_| [3.0, 4.0, 0.0], 2, false)), TrackKind::Unknown);
        for is_in_space in [false, true] {
            let stands = followed(|_| [3.0, 4.0, 1.0], 120, is_in_space);
            assert_eq!(kind(&stands), TrackKind::Static);
        }
    }

    /// The opposite, at all speeds; in the plane nothing tells what flies from what drives.
    #[test]
    fn what_moves_is_not_static_and_no_one_knows_whether_it_flies() {
        for speed in [0.5, 1.5, 8.0, 40.0] {
            for scans in [20, 60, 400] {
                let moves = told(&followed(|t| [speed * t, 1.0, 0.0], scans, false), 0.01);
                assert!(moves.probability(TrackKind::Static) < 0.2, "{speed} {scans}");
                assert_eq!(moves.kind(), TrackKind::Unknown);
                let [flying, ground] =
                    [TrackKind::Flying, TrackKind::Ground].map(|kind| moves.probability(kind));
                assert_eq!(flying, ground);
            }
        }
    }

    #[test]
    fn what_has_moved_rests_before_it_stands() {
        let parked = |rest: f64| {
            followed(|t| [2.0 * t.min(5.0), 0.0, 0.0], (10.0 * (5.0 + rest)) as u32, false)
        };
        assert_eq!(kind(&parked(10.0)), TrackKind::Unknown);
        assert_eq!(kind(&parked(400.0)), TrackKind::Static);
        let starts = followed(|t| [2.0 * (t - 30.0).max(0.0), 0.0, 0.0], 380, false);
        assert_eq!(kind(&starts), TrackKind::Unknown);
    }

    /// A car uphill, and what flies level, do not climb like this.
    #[test]
    fn what_climbs_in_space_flies() {
        let climbs = |t: f64| [0.5 * t, 0.0, 1.5 * t];
        assert_eq!(kind(&followed(climbs, 40, true)), TrackKind::Flying);
        assert_eq!(kind(&followed(|t| [0.0, 0.0, 1.5 * t], 40, true)), TrackKind::Flying);
        assert_eq!(kind(&followed(climbs, 40, false)), TrackKind::Unknown);
        for [speed, climb] in [[10.0, 1.0], [3.0, 0.0], [3.0, 0.2]] {
            let car = followed(|t| [speed * t, 0.0, climb * t], 400, true);
            assert_eq!(kind(&car), TrackKind::Unknown, "{speed} {climb}");
        }
    }

    /// Told noise that is too small by three, and by six, does not make what stands move.
    #[test]
    fn what_stands_need_not_be_told_the_noise() {
        for wrong in [1.0, 3.0, 6.0] {
            let at = |scans| {
                let error = |t: f64, n: f64| (7.1 * wrong * (10.0 * t + n)).sin() * 0.1 * wrong;
                followed(|t| [3.0 + error(t, 0.0), 4.0 + error(t, 0.3), 0.0], scans, false)
            };
            assert_eq!(kind(&at(5)), TrackKind::Unknown);
            assert_eq!(kind(&at(200)), TrackKind::Static, "{wrong}");
        }
    }

    /// What the association says of clutter is the probability of that kind; the others share the rest as
    /// before.
    #[test]
    fn clutter_is_what_the_association_says() {
        let stands = followed(|_| [3.0, 4.0, 0.0], 120, false);
        let seen = stands.belief();
        for clutter in [0.001, 0.3, 0.9] {
            let belief = told(&stands, clutter);
            assert!((belief.probability(TrackKind::Clutter) - clutter).abs() < 1e-4);
            let share = |belief: &KindBelief| {
                belief.probability(TrackKind::Static) / belief.probability(TrackKind::Unknown)
            };
            assert!((share(&belief) / share(&seen) - 1.0).abs() < 1e-9);
        }
        assert_eq!(told(&stands, 0.9).kind(), TrackKind::Clutter);
    }

    #[test]
    fn places_of_one_time_or_none_say_nothing() {
        let mut kinds = TargetKinds::default();
        for k in 0..50 {
            kinds.see(7, ([f64::from(k), 0.0, 0.0], TOLD), 225.0, true);
            kinds.see(7, ([f64::NAN; 3], TOLD), 225.0, true);
        }
        let first = MotionBelief::new(SHARES[3], [5.0, 0.0], [TOLD[0]; 2], 225.0);
        assert_eq!(kinds.motion, Some(first));
    }
}
