//! Probability that a body is a person.

use super::measurement::Legs;
use serde::{Deserialize, Serialize};

/// Logarithm of the odds that a new body is a person.
const PRIOR: f64 = -1.5;
/// Largest logarithm of the odds, for and against a person.
const MOST: f64 = 4.0;
/// Rate at which the logarithm of the odds changes while a body walks on two legs [1/s]. Successive
/// scans show nearly the same, so that time counts and not their number.
const TWO_LEGS: f64 = 4.0;
/// Rate at which the logarithm of the odds changes while a body of the size of a person moves at
/// walking speed [1/s].
const WALKS: f64 = 2.0;
/// Rate at which the logarithm of the odds changes while a body is too fast for a person, or walks
/// and has another size [1/s].
const OTHERWISE: f64 = -2.0;
/// Rate at which the logarithm of the odds changes while a body does not walk [1/s].
const STANDS: f64 = -0.5;
/// Rate at which the logarithm of the odds changes while a body that was probably a person does not
/// walk [1/s]: people stop.
const STOPPED: f64 = -0.02;
/// Lowest and highest speed at which people walk [m/s].
const PACE: [f64; 2] = [0.3, 2.5];
/// Speed above which nobody walks [m/s].
const FASTEST: f64 = 3.5;
/// Smallest and largest radius of a person [m].
const SIZE: [f64; 2] = [0.03, 0.45];
/// Radius above which a rectangle is no person [m]; one side of a near trunk looks straight.
const SQUARE: f64 = 0.25;
/// Longest time for which one measurement is evidence [s].
const LONGEST: f64 = 0.5;

/// Properties of a body that are evidence for or against a person.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gait {
    pub(super) legs: Legs,
    /// Speed [m/s]; 0 if it stands.
    pub(super) speed: f64,
    /// Radius [m].
    pub(super) radius: f64,
    /// True if the body looks like a rectangle.
    pub(super) is_angular: bool,
}

/// Odds that a body is a person.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Person {
    log_odds: f64,
    /// True if the body was seen on two legs.
    has_legs: bool,
}

impl Default for Person {
    fn default() -> Self {
        Self { log_odds: PRIOR, has_legs: false }
    }
}

impl Person {
    pub(super) fn probability(&self) -> f64 {
        1.0 / (1.0 + libm::exp(-self.log_odds))
    }

    /// True if the body was seen on two legs and may be a person.
    pub(super) fn has_legs(&self) -> bool {
        self.has_legs && self.log_odds > PRIOR - 1.0
    }

    /// Update the odds with a measurement, `dt` seconds after the last one.
    pub(super) fn hear(&mut self, gait: &Gait, dt: f64) {
        self.has_legs |= gait.legs == Legs::Two;
        let is_square = gait.is_angular && gait.radius > SQUARE;
        let is_of_size = gait.radius >= SIZE[0] && gait.radius <= SIZE[1] && !is_square;
        let walks = gait.speed >= PACE[0] && gait.speed <= PACE[1];
        let rate = if walks && gait.legs == Legs::Two {
            TWO_LEGS
        } else if gait.speed > FASTEST || walks && !is_of_size {
            OTHERWISE
        } else if walks {
            WALKS
        } else if self.log_odds > 0.0 {
            STOPPED
        } else {
            STANDS
        };
        self.log_odds = (self.log_odds + rate * dt.clamp(0.0, LONGEST)).clamp(-MOST, MOST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(gait: Gait, seconds: f64) -> f64 {
        let mut person = Person::default();
        for _ in 0..(10.0 * seconds) as u32 {
            person.hear(&gait, 0.1);
        }
        person.probability()
    }

    #[test]
    fn what_walks_is_a_person_and_what_stands_drives_or_is_square_is_not() {
        let gait = Gait { legs: Legs::None, speed: 1.2, radius: 0.2, is_angular: false };
        assert!(after(gait, 3.0) > 0.9);
        assert!(after(Gait { legs: Legs::Two, ..gait }, 1.0) > 0.9);
        for other in [
            Gait { speed: 0.0, ..gait },
            Gait { speed: 6.0, ..gait },
            Gait { radius: 0.8, ..gait },
            Gait { is_angular: true, radius: 0.3, ..gait },
            Gait { legs: Legs::Two, speed: 0.0, ..gait },
        ] {
            assert!(after(other, 3.0) < 0.1, "{other:?}");
        }
    }

    #[test]
    fn who_stops_stays_a_person() {
        let mut person = Person::default();
        let gait = Gait { legs: Legs::Two, speed: 1.2, radius: 0.2, is_angular: false };
        (0..20).for_each(|_| person.hear(&gait, 0.1));
        (0..600).for_each(|_| person.hear(&Gait { speed: 0.0, ..gait }, 0.1));
        assert!(person.probability() > 0.8);
    }
}
