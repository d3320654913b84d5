//! Test whether a track of a radar is a double echo: the wave goes from the radar to a nearer
//! target, back to the platform, to the target again and back.
//!
//! Such an echo is near the bearing of the target, at about twice its range or more, and its range
//! changes by twice as much. Another reflector on the way adds a constant length to the range.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

/// Standard deviation of the difference between the bearings of an echo and of its target [rad]:
/// targets are several metres long.
const APART: f64 = 6.0 * PI / 180.0;
/// Standard deviations of the change, over time, of the difference between echo and target: bearing
/// [rad], and range beyond twice the range of the target [m].
const DRIFTS: [f64; 2] = [4.0 * PI / 180.0, 15.0];
/// Standard deviation, across the line of sight, of the reflecting part of a target and of the
/// position of the target [m]. It corresponds to a larger angle for a nearer target.
const ACROSS: f64 = 5.0;
/// Standard deviation of the velocity of targets along every axis [m/s].
const SPEED: f64 = 3.0;
/// Share of the targets that are at rest.
const RESTS: f64 = 0.3;
/// Least ratio of the range of an echo to that of its target: about 2, with a tolerance for long
/// targets.
const LEAST_RATIO: f64 = 1.8;
/// Ratio of the path length of an echo to that of the direct return.
const LEGS: f64 = 2.0;
/// Prior probability that a track beyond twice the range of a target is an echo. In simulated
/// scenes, a value of 0.05 hides 0.5 % of the measurements of other boats, and 0.2 hides 0.8 % and
/// more of the echoes.
const SHARE: f64 = 0.2;
/// If static objects count as targets: time after which a track counts as an echo only if it has
/// moved with its target [s], because a static object behind another one looks like its echo.
const PATIENCE: f64 = 10.0;
/// Least logarithm of the likelihood ratio for this decision: motion with the target to rest (a
/// ratio of 20).
const MOVED: f64 = 3.0;
/// Largest number of targets with which a track is compared.
const MOST_TARGETS: usize = 16;
/// Largest difference of bearings at which a comparison starts, in standard deviations.
const FARTHEST: f64 = 5.0;
/// Least number of measurements for a decision.
const FEWEST: u32 = 3;

/// Position relative to a radar.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolarPlace {
    /// Direction of the track, counter-clockwise from x [rad].
    pub bearing: f64,
    /// Distance of the track from the sensor [m].
    pub range: f64,
}

impl PolarPlace {
    /// Bearing [rad] and range [m] of `place` as seen from `from`; None if these are not finite or
    /// equal.
    #[must_use]
    pub fn between(from: [f64; 2], place: [f64; 2]) -> Option<Self> {
        let [x, y] = [place[0] - from[0], place[1] - from[1]];
        let range = libm::hypot(x, y);
        let is_known = range.is_finite() && range > 0.0;
        is_known.then(|| Self { bearing: libm::atan2(y, x), range })
    }
}

/// Positions of a track in the scans that measured it, and the measured or predicted positions of a
/// nearer target at the same times.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EchoTrace {
    first_ns: i64,
    last_ns: i64,
    first: [PolarPlace; 2],
    last_bearing: f64,
    /// Change of the bearing of the track since its first position [rad].
    turned: f64,
    count: u32,
    /// Sums of the difference of the bearings [rad] and of both ranges [m].
    sums: [f64; 3],
    /// Largest changes since the first position: of the difference of the bearings [rad], of the
    /// range beyond twice that of the target [m], of the bearing [rad], and of the range [m].
    most: [f64; 4],
}

impl EchoTrace {
    /// Trace that starts with positions of a track and of a target.
    #[must_use]
    pub fn new(stamp_ns: i64, own: PolarPlace, target: PolarPlace) -> Self {
        Self {
            first_ns: stamp_ns,
            last_ns: stamp_ns,
            first: [own, target],
            last_bearing: own.bearing,
            turned: 0.0,
            count: 1,
            sums: [turn(target.bearing, own.bearing), own.range, target.range],
            most: [0.0; 4],
        }
    }

    /// Add a later observation at `stamp_ns` [ns]. `own`: position of the track; `target`: position
    /// of the target at this time; both relative to the radar. Call this in the order of the times.
    pub fn take(&mut self, stamp_ns: i64, own: PolarPlace, target: PolarPlace) {
        let [first, of_target] = self.first;
        let apart = turn(target.bearing, own.bearing);
        self.turned += turn(self.last_bearing, own.bearing);
        let beyond = |own: PolarPlace, target: PolarPlace| own.range - LEGS * target.range;
        let changes = [
            turn(turn(of_target.bearing, first.bearing), apart),
            beyond(own, target) - beyond(first, of_target),
            self.turned,
            own.range - first.range,
        ];
        for (most, change) in self.most.iter_mut().zip(changes) {
            *most = change.abs().max(*most);
        }
        for (sum, value) in self.sums.iter_mut().zip([apart, own.range, target.range]) {
            *sum += value;
        }
        (self.last_ns, self.last_bearing, self.count) =
            (stamp_ns, own.bearing, self.count.saturating_add(1));
    }

    /// True if the track is more likely an echo of the target than another target. `stands`:
    /// whether static objects count as targets.
    #[must_use]
    pub fn is_echo(&self, stands: bool) -> bool {
        self.count >= FEWEST && self.log_odds(stands) > 0.0
    }

    /// Logarithm of the odds of an echo. It is negative infinity for a track that is too near and,
    /// if `stands` is true, for a track that may as well be a static target.
    #[must_use]
    pub fn log_odds(&self, stands: bool) -> f64 {
        let [apart, range, of_target] = self.sums.map(|sum| sum / f64::from(self.count));
        if range < LEAST_RATIO * of_target {
            return f64::NEG_INFINITY;
        }
        let seconds = self.last_ns.saturating_sub(self.first_ns) as f64 * 1e-9;
        let free = [SPEED * seconds / range, SPEED * seconds];
        let free = [0, 1].map(|k| libm::hypot(free[k], DRIFTS[k]));
        let [bearing, beyond, turned, moved] = self.most;
        let near = ACROSS / of_target;
        let drifts = libm::hypot(DRIFTS[0], near);
        let follows = log_density(bearing, drifts) + log_density(beyond, DRIFTS[1]);
        let moves = log_density(turned, free[0]) + log_density(moved, free[1]);
        let rests = log_density(turned, DRIFTS[0]) + log_density(moved, DRIFTS[1]);
        if stands && seconds > PATIENCE && follows - rests < MOVED {
            return f64::NEG_INFINITY;
        }
        let own = log_mixed([(1.0 - RESTS, moves), (RESTS, rests)]);
        let prior = libm::log(SHARE / (1.0 - SHARE));
        prior + log_density(apart, libm::hypot(APART, near)) + libm::log(TAU) + follows - own
    }
}

/// Comparison of a track with the nearer targets of which it may be an echo.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrackEchoes {
    traces: BTreeMap<i64, EchoTrace>,
    /// True once another scanner has measured the track.
    is_denied: bool,
    /// True while the track is more likely an echo than a target.
    pub is_echo: bool,
}

impl TrackEchoes {
    /// True if the parts of a restored state agree.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let is_finite = |place: &PolarPlace| place.bearing.is_finite() && place.range.is_finite();
        self.traces.len() <= MOST_TARGETS
            && !(self.is_denied && self.is_echo)
            && self.traces.values().all(|trace| {
                let sums = trace.sums.iter().chain(&trace.most);
                trace.first.iter().all(is_finite)
                    && trace.first_ns <= trace.last_ns
                    && sums.chain([&trace.last_bearing, &trace.turned]).all(|sum| sum.is_finite())
            })
    }

    /// Record that another scanner has measured the track, so that it is a target and no echo.
    pub fn deny(&mut self) {
        *self = Self { is_denied: true, ..Self::default() };
    }

    /// Compare the track with nearer `targets`, each with its ID and position. `measured`: time
    /// [ns] and position of the track; None if the scan did not measure it. Traces of unknown
    /// targets are removed; at most [`MOST_TARGETS`] are kept. `stands`: whether static objects
    /// count as targets.
    pub fn compare(
        &mut self,
        measured: Option<(i64, PolarPlace)>,
        targets: &[(i64, PolarPlace)],
        is_known: impl Fn(i64) -> bool,
        stands: bool,
    ) {
        if self.is_denied {
            return;
        }
        self.traces.retain(|id, _| is_known(*id));
        self.is_echo = false;
        for (id, target) in targets {
            if let Some((stamp_ns, own)) = measured {
                let has_room = self.traces.len() < MOST_TARGETS;
                match self.traces.get_mut(id) {
                    Some(trace) => trace.take(stamp_ns, own, *target),
                    None if has_room && may_be_echo(own, *target) => {
                        self.traces.insert(*id, EchoTrace::new(stamp_ns, own, *target));
                    }
                    None => {}
                }
            }
            self.is_echo |= self.traces.get(id).is_some_and(|trace| trace.is_echo(stands));
        }
    }
}

/// True if a track may be an echo of a target by its position alone.
fn may_be_echo(own: PolarPlace, target: PolarPlace) -> bool {
    let apart = turn(target.bearing, own.bearing).abs();
    own.range >= LEAST_RATIO * target.range && apart < FARTHEST * APART
}

/// Difference between two bearings, between -pi and pi [rad].
fn turn(from: f64, to: f64) -> f64 {
    let turn = (to - from) % TAU;
    turn - if turn.abs() > PI { TAU.copysign(turn) } else { 0.0 }
}

/// Logarithm of the density of a normal distribution.
fn log_density(value: f64, std: f64) -> f64 {
    let z = value / std;
    -0.5 * (z * z + libm::log(TAU)) - libm::log(std)
}

/// Logarithm of the sum of shares of exponentials.
fn log_mixed([(a, x), (b, y)]: [(f64, f64); 2]) -> f64 {
    let most = x.max(y);
    most + libm::log(a * libm::exp(x - most) + b * libm::exp(y - most))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sight(bearing_deg: f64, range: f64) -> PolarPlace {
        PolarPlace { bearing: bearing_deg.to_radians(), range }
    }

    /// Thirty seconds of a target and of what is seen beyond it.
    fn trace(of: impl Fn(f64) -> [PolarPlace; 2]) -> EchoTrace {
        let [own, target] = of(0.0);
        let mut trace = EchoTrace::new(0, own, target);
        for k in 1..=15 {
            let [own, target] = of(2.0 * f64::from(k));
            trace.take(i64::from(k) * 2_000_000_000, own, target);
        }
        trace
    }

    #[test]
    fn what_goes_along_at_twice_the_range_is_an_echo() {
        for start in [70.0, 170.0, -170.0] {
            for detour in [0.0, 40.0, 150.0] {
                let of = |t: f64| {
                    let range = 150.0 - t;
                    [sight(start + 2.0 + t, 2.0 * range + detour), sight(start + t, range)]
                };
                assert!(trace(of).is_echo(true), "{start} {detour}");
            }
        }
    }

    /// The opposite: boats that pass behind, follow in line, come nearer in line, or lie beside.
    #[test]
    fn other_boats_are_no_echoes() {
        let passes = |t: f64| [sight(85.0 + 0.2 * t, 300.0), sight(80.0 + t, 140.0)];
        let follows = |t: f64| [sight(80.0 + t, 280.0 - 2.0 * t), sight(80.0 + t, 140.0 - 2.5 * t)];
        let comes = |t: f64| [sight(80.0, 360.0 - 3.0 * t), sight(80.0, 140.0 + t)];
        let beside = |t: f64| [sight(110.0 + t, 300.0), sight(80.0 + t, 150.0)];
        assert!(!trace(passes).is_echo(true));
        assert!(!trace(follows).is_echo(true));
        assert!(!trace(comes).is_echo(true));
        assert!(!trace(beside).is_echo(true));
    }

    /// Nothing tells an echo of what rests from something else that rests there.
    #[test]
    fn what_rests_in_line_is_no_echo() {
        for range in [280.0, 300.0, 500.0] {
            let rest = |t: f64| [sight(80.0 + 0.5 * libm::sin(t), range), sight(81.0, 150.0)];
            assert!(!trace(rest).is_echo(true), "{range}");
        }
    }

    #[test]
    fn a_state_that_cannot_be_is_not_sound() {
        let mut echoes = TrackEchoes::default();
        echoes.compare(Some((0, sight(80.0, 300.0))), &[(1, sight(80.0, 150.0))], |_| true, true);
        assert!(echoes.is_sound() && echoes.traces.len() == 1);
        assert!(!TrackEchoes { is_denied: true, is_echo: true, ..echoes.clone() }.is_sound());
        let mut bad = echoes.clone();
        bad.traces.values_mut().for_each(|trace| trace.sums[1] = f64::NAN);
        assert!(!bad.is_sound());
        // What is far beside, or nearer than the least ratio, is not compared.
        let mut other = TrackEchoes::default();
        let apart = [(1, sight(20.0, 150.0)), (2, sight(80.0, 200.0))];
        other.compare(Some((0, sight(80.0, 300.0))), &apart, |_| true, true);
        assert_eq!(other.traces.len(), 0);
    }

    #[test]
    fn two_sights_say_nothing_and_turns_are_the_short_way() {
        let mut short = EchoTrace::new(0, sight(80.0, 300.0), sight(80.0, 150.0));
        short.take(2_000_000_000, sight(81.0, 300.0), sight(81.0, 150.0));
        assert!(!short.is_echo(true));
        assert!((turn(3.1, -3.1) - (TAU - 6.2)).abs() < 1e-12);
        assert!((turn(-3.1, 3.1) + (TAU - 6.2)).abs() < 1e-12);
        assert_eq!(PolarPlace::between([1.0, 2.0], [1.0, 2.0]), None);
        assert_eq!(PolarPlace::between([f64::NAN, 2.0], [1.0, 2.0]), None);
    }
}
