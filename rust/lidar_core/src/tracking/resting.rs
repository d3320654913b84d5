//! Decision whether a target is static: probabilities of several kinds of motion.

use super::kind::LEAST;
use super::place_trend::PlaceNoise;
use serde::{Deserialize, Serialize};

/// Number of kinds of motion: static, resting between two motions, moving at one of several speeds.
const MOTIONS: usize = 2 + SPEEDS.len();
/// Standard deviation of the velocity of static and resting targets [m/s]: poses of the platform
/// drift.
const WANDERS: f64 = 0.05;
/// Standard deviations of the velocity of moving targets, as multiples of that of new targets: few
/// targets are as fast as possible.
const SPEEDS: [f64; 4] = [1.0, 0.3, 0.1, 0.03];
/// Least standard deviation of the velocity of moving targets [m/s]: slower motion counts as drift.
const SLOWEST: f64 = 0.1;
/// Share of the time for which moving targets rest.
const RESTS: f64 = 0.3;
/// Mean time between two changes of the motion of moving targets [s].
const CHANGES: f64 = 10.0;
/// Mean time for which a target is static, and after which a moving target becomes static [s].
const STANDS: f64 = 300.0;
/// Correlation time of the velocity while the kind of motion does not change [s]: targets turn.
const KEEPS: f64 = 30.0;
/// Largest logarithm of the likelihood ratio from one position, because it may be an outlier.
const MOST: f64 = 3.0;
/// Time, in units of [`KEEPS`], below which differences of exponentials lose their digits.
const SHORT: f64 = 0.01;
/// Tolerance of the probabilities of a restored state, for rounding errors.
const ROUNDING: f64 = 1e-6;

/// State along one axis: position and velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct AxisMotion {
    /// Expected position [m].
    place: f64,
    /// Expected velocity [m/s].
    velocity: f64,
    /// Variance of the position [m^2], covariance [m^2/s], variance of the velocity [m^2/s^2].
    spread: [f64; 3],
}

/// Probabilities of the motions of a target.
///
/// Each kind of motion has a Kalman filter, and Bayes' rule weights their predictions. The velocity
/// of a moving target changes slowly. With a velocity that is independent in every step, a slow
/// target would count as static, because each step alone is weak evidence.
///
/// # Source
/// Blom & Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
/// coefficients", 1988; velocity: Uhlenbeck & Ornstein, "On the theory of the Brownian motion", 1930.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct MotionBelief {
    probability: [f64; MOTIONS],
    /// State along x and along y for each motion.
    axes: [[AxisMotion; 2]; MOTIONS],
}

/// Shares of rest and of the speeds among the motions of moving targets; zero for static.
fn shares() -> [f64; MOTIONS] {
    let speed = (1.0 - RESTS) / SPEEDS.len() as f64;
    std::array::from_fn(|motion| match motion {
        0 => 0.0,
        1 => RESTS,
        _ => speed,
    })
}

/// Variances of the velocity by kind of motion [m^2/s^2]; `speed`: that of new targets.
fn velocities(speed: f64) -> [f64; MOTIONS] {
    std::array::from_fn(|motion| match motion {
        0 | 1 => WANDERS * WANDERS,
        _ => (SPEEDS[motion - 2] * SPEEDS[motion - 2] * speed).max(SLOWEST * SLOWEST),
    })
}

impl MotionBelief {
    /// Belief at the first position [m], with its variances along x and y [m^2]. `stands`: prior
    /// probability that the target is static; `speed`: variance of the speed of new targets
    /// [m^2/s^2].
    pub(crate) fn new(stands: f64, place: [f64; 2], variance: [f64; 2], speed: f64) -> Self {
        let probability = shares().map(|share| (1.0 - stands) * share);
        let axes = velocities(speed).map(|velocity| {
            [0, 1].map(|axis| AxisMotion::drawn([place[axis], variance[axis]], velocity))
        });
        let mut belief = Self { probability, axes };
        belief.probability[0] = stands;
        belief
    }

    /// Probability that the target is static.
    pub(crate) fn stands(&self) -> f64 {
        self.probability[0]
    }

    /// True if the probabilities and states are possible. They are not in a forged state, or after
    /// positions that overflow.
    pub(crate) fn is_sound(&self) -> bool {
        let is_share = |p: &f64| (-ROUNDING..=1.0 + ROUNDING).contains(p);
        let sum: f64 = self.probability.iter().sum();
        self.probability.iter().all(is_share)
            && (sum - 1.0).abs() < ROUNDING
            && self.axes.iter().flatten().all(AxisMotion::is_sound)
    }

    /// Update the belief with a position [m] after `dt` > 0 [s], with its noise along x and y.
    /// `speed`: variance of the speed of new targets [m^2/s^2].
    pub(crate) fn see(&mut self, dt: f64, place: [f64; 2], noise: [PlaceNoise; 2], speed: f64) {
        let velocities = velocities(speed);
        self.renew(dt, &velocities);
        let mut log = [0.0; MOTIONS];
        for ((own, log), velocity) in self.axes.iter_mut().zip(&mut log).zip(velocities) {
            for ((axis, place), noise) in own.iter_mut().zip(place).zip(noise) {
                *axis = axis.predicted(dt, velocity);
                *log += axis.correct(place, noise);
            }
        }
        let largest = log.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let weighed: [f64; MOTIONS] = std::array::from_fn(|motion| {
            self.probability[motion] * libm::exp((log[motion] - largest).max(-MOST))
        });
        let sum: f64 = weighed.iter().sum();
        self.probability = weighed.map(|p| (p / sum).max(LEAST));
        let sum: f64 = self.probability.iter().sum();
        self.probability.iter_mut().for_each(|p| *p /= sum);
    }

    /// Let the kind of motion change during `dt` [s]: a new motion starts at the position of the
    /// old one, with another velocity.
    fn renew(&mut self, dt: f64, velocities: &[f64; MOTIONS]) {
        let changes = -libm::expm1(-dt / CHANGES);
        let ends = -libm::expm1(-dt / STANDS);
        let [stands, moving @ ..] = self.probability;
        let moves: f64 = moving.iter().sum();
        let shares = shares();
        let before = self.axes;
        for axis in [0, 1] {
            let movers: [_; MOTIONS - 1] =
                std::array::from_fn(|mover| (moving[mover], before[mover + 1][axis]));
            let moved = AxisMotion::mixed(&movers);
            let [moved, stood] = [moved, before[0][axis]].map(|from| [from.place, from.spread[0]]);
            for (motion, own) in self.axes.iter_mut().enumerate() {
                let weights = arrivals(motion, [changes, ends], shares[motion]);
                let drawn = |place| AxisMotion::drawn(place, velocities[motion]);
                own[axis] = AxisMotion::mixed(&[
                    (weights[0] * self.probability[motion], own[axis]),
                    (weights[1] * moves, drawn(moved)),
                    (weights[2] * stands, drawn(stood)),
                ]);
            }
        }
        let before = self.probability;
        for (motion, p) in self.probability.iter_mut().enumerate() {
            let weights = arrivals(motion, [changes, ends], shares[motion]);
            *p = weights[0] * before[motion] + weights[1] * moves + weights[2] * stands;
        }
    }
}

/// Probabilities that a kind of motion continues, that it starts while the target is moving, and
/// that it starts while the target is static. `changes`: probability that the motion changes;
/// `ends`: probability that the target becomes static or no longer is.
fn arrivals(motion: usize, [changes, ends]: [f64; 2], share: f64) -> [f64; 3] {
    match motion {
        0 => [1.0 - ends, ends, 0.0],
        _ => [(1.0 - changes) * (1.0 - ends), changes * (1.0 - ends) * share, ends * share],
    }
}

impl AxisMotion {
    /// State at a position with its variance [m, m^2], and a velocity of zero with the variance
    /// `velocity` [m^2/s^2].
    fn drawn([place, variance]: [f64; 2], velocity: f64) -> Self {
        Self { place, velocity: 0.0, spread: [variance, 0.0, velocity] }
    }

    /// Mean and covariance of several states with their weights, not all zero.
    fn mixed(parts: &[(f64, Self)]) -> Self {
        let sum: f64 = parts.iter().map(|(weight, _)| weight).sum();
        let mean = |value: fn(&Self) -> f64| {
            parts.iter().map(|(weight, one)| weight / sum * value(one)).sum::<f64>()
        };
        let (place, velocity) = (mean(|one| one.place), mean(|one| one.velocity));
        let mut spread = [0.0; 3];
        for (weight, one) in parts {
            let [x, v] = [one.place - place, one.velocity - velocity];
            let away = [x * x, x * v, v * v];
            for ((sum_of, own), away) in spread.iter_mut().zip(one.spread).zip(away) {
                *sum_of += weight / sum * (own + away);
            }
        }
        Self { place, velocity, spread }
    }

    /// State after `dt` [s]. `velocity`: stationary variance of the velocity [m^2/s^2], whose
    /// correlation time is [`KEEPS`].
    fn predicted(&self, dt: f64, velocity: f64) -> Self {
        let steps = dt / KEEPS;
        let [lost, lost_twice] = [1.0, 2.0].map(|times| -libm::expm1(-times * steps));
        let (kept, reach) = (1.0 - lost, KEEPS * lost);
        let wanders = if steps < SHORT {
            dt * dt * dt / 3.0 * (1.0 - 0.75 * steps)
        } else {
            KEEPS * KEEPS * (dt - 2.0 * reach + 0.5 * KEEPS * lost_twice)
        };
        let noise = 2.0 * velocity / KEEPS;
        let [pp, pv, vv] = self.spread;
        Self {
            place: self.place + reach * self.velocity,
            velocity: kept * self.velocity,
            spread: [
                (pp + reach * (2.0 * pv + reach * vv)).max(0.0) + noise * wanders,
                kept * (pv + reach * vv) + noise * 0.5 * reach * reach,
                kept * kept * vv + noise * 0.5 * KEEPS * lost_twice,
            ],
        }
    }

    /// Correct with a measured position [m]. Returns the logarithm of its density, up to a constant
    /// (Student's t, because the noise is estimated).
    fn correct(&mut self, place: f64, noise: PlaceNoise) -> f64 {
        let [pp, pv, vv] = self.spread;
        let variance = (pp + noise.variance).max(f64::MIN_POSITIVE);
        let away = place - self.place;
        let (gain, turns) = (pp / variance, pv / variance);
        self.place += gain * away;
        self.velocity += turns * away;
        self.spread = [pp - gain * pp, pv - gain * pv, (vv - turns * pv).max(0.0)];
        let far = away * away / (noise.freedom * variance);
        -0.5 * ((noise.freedom + 1.0) * libm::log1p(far) + libm::log(variance))
    }

    fn is_sound(&self) -> bool {
        let [pp, _, vv] = self.spread;
        let values = [self.place, self.velocity, pp, self.spread[1], vv];
        values.iter().all(|value| value.is_finite()) && pp >= 0.0 && vv >= 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEED: f64 = 36.0;

    /// Numbers of a sequence of low discrepancy, evenly between -0.5 and 0.5.
    fn spread(k: u32) -> f64 {
        (0.5 + 0.618_033_99 * f64::from(k)) % 1.0 - 0.5
    }

    /// Probability of standing after so many places, two a second, scattered over `length` by a body that moves
    /// as `way` says.
    fn seen(way: impl Fn(f64) -> f64, count: u32, length: f64) -> f64 {
        seen_among(way, count, length, SPEED)
    }

    /// The same where new targets have a speed of that variance.
    fn seen_among(way: impl Fn(f64) -> f64, count: u32, length: f64, speed: f64) -> f64 {
        let noise = PlaceNoise { variance: length * length / 12.0, freedom: 11.0 };
        let place = |k: u32| [way(0.5 * f64::from(k)) + length * spread(k), length * spread(7 * k)];
        let mut belief = MotionBelief::new(0.33, place(0), [noise.variance; 2], speed);
        for k in 1..count {
            belief.see(0.5, place(k), [noise; 2], speed);
            assert!(belief.is_sound());
        }
        belief.stands()
    }

    /// Within 12 places, 6 s, a ship of 18 m at 1 m/s moves by a third of its length: no stretch of its way
    /// alone tells that it moves.
    #[test]
    fn a_long_way_tells_what_no_stretch_of_it_does() {
        for speed in [0.5, 1.0, 4.0] {
            let p = seen(|t| speed * t, 120, 18.0);
            assert!(p < 0.15, "{speed}: {p}");
        }
    }

    #[test]
    fn what_stands_stands_however_long_it_is() {
        for length in [1.0, 6.0, 18.0, 36.0] {
            let p = seen(|_| 5.0, 120, length);
            assert!(p > 0.9, "{length}: {p}");
        }
        // Also where all targets are so slow that a share of their speed is less than what stands wanders.
        let p = seen_among(|_| 5.0, 120, 0.1, 1.0);
        assert!(p > 0.9, "{p}");
    }

    #[test]
    fn what_stops_rests_first_and_what_starts_is_noticed() {
        let parked = |rest: f64| seen(|t| 2.0 * t.min(20.0), (2.0 * (20.0 + rest)) as u32, 2.0);
        assert!(parked(10.0) < 0.5, "{}", parked(10.0));
        assert!(parked(200.0) > 0.9, "{}", parked(200.0));
        let started = |after: f64| seen(|t| 2.0 * (t - 300.0).max(0.0), 600 + after as u32, 2.0);
        assert!(started(0.0) > 0.9 && started(12.0) < 0.1, "{}", started(12.0));
    }

    /// By the rule for linear differential equations, in small steps.
    #[test]
    fn predictions_are_those_of_the_differential_equation() {
        // Without spread at the start all of it is that of the motion, in both forms of its arithmetic.
        let spreads = [[0.4, 0.1, 0.9], [0.0; 3]];
        for (dt, spread) in
            [0.01, 0.25, 0.31, 4.0, 90.0].into_iter().flat_map(|dt| spreads.map(|of| (dt, of)))
        {
            let start = AxisMotion { place: 3.0, velocity: -2.0, spread };
            let (mut stepped, steps, velocity) = (start, 20_000, 0.7);
            let h = dt / f64::from(steps);
            for _ in 0..steps {
                let AxisMotion { place, velocity: v, spread: [pp, pv, vv] } = stepped;
                stepped = AxisMotion {
                    place: place + h * v,
                    velocity: v - h * v / KEEPS,
                    spread: [
                        pp + 2.0 * h * pv,
                        pv + h * (vv - pv / KEEPS),
                        vv + 2.0 * h * (velocity - vv) / KEEPS,
                    ],
                };
            }
            let found = start.predicted(dt, velocity);
            let pairs = [(found.place, stepped.place), (found.velocity, stepped.velocity)];
            for (a, b) in pairs.into_iter().chain(found.spread.into_iter().zip(stepped.spread)) {
                assert!((a - b).abs() < 3e-3 * b.abs(), "{dt}: {found:?} {stepped:?}");
            }
        }
    }

    #[test]
    fn what_is_no_number_makes_no_belief() {
        let mut belief = MotionBelief::new(0.3, [1.0, 2.0], [1.0; 2], SPEED);
        let none = PlaceNoise { variance: 0.0, freedom: 1.0 };
        for (dt, place) in [(1e-9, 1.0), (1e12, -1e300), (0.1, 1e300), (5.0, 0.0)] {
            belief.see(dt, [place, 0.0], [none; 2], SPEED);
            assert!((0.0..=1.0).contains(&belief.stands()), "{belief:?}");
        }
        let sound = MotionBelief::new(0.3, [1.0, 2.0], [1.0; 2], SPEED);
        assert!(sound.is_sound());
        let forged: [fn(&mut MotionBelief); 4] = [
            |one| one.probability[2] = f64::NAN,
            |one| one.probability[0] = 0.9,
            |one| one.axes[1][0].place = f64::INFINITY,
            |one| one.axes[5][1].spread[2] = -1.0,
        ];
        for forge in forged {
            let mut forged = sound.clone();
            forge(&mut forged);
            assert!(!forged.is_sound());
        }
    }
}
