//! Merges two legs into one person.
//!
//! Near the ground a scan hits two legs that move alternately: one stands while the other swings at
//! twice the walking speed. Two legs near each other are merged if both places were free space a
//! moment ago, because their middle moves steadily. A known person gets the legs nearby, also a
//! single one that hides the other. Higher up, a scan hits two swinging arms, and the trunk between
//! them.

#![allow(non_snake_case)] // textbook letters

use super::RoundBody;
use super::leg_shares::{HIDDEN, difference, shared_out};
use super::measurement::{BodyMeasurement, Legs};
use super::places::{apart, are_alike};
use nalgebra::Vector3;

/// Largest radius of the circle of a leg [m]; it allows for trousers and for few rays.
const THICKEST: f64 = 0.17;
/// Longest step from leg to leg [m].
const STEP: f64 = 0.75;
/// Largest mean share of the points of two legs that lie on surfaces of earlier scans.
const BOTH: f64 = 0.5;
/// Largest share of the points of each of two legs that lie on surfaces of earlier scans: one leg
/// stands during half a step.
const EACH: f64 = 0.85;
/// Standard deviation of the middle of a person from that of both legs [m].
const MIDDLE: f64 = 0.05;
/// Standard deviation of the middle of a person from a single leg [m].
const SINGLE: f64 = 0.12;
/// Standard deviations of the radius of a person of whom two legs are seen, and one leg [m].
const SIZE: [f64; 2] = [0.1, 0.3];
/// Distance within which a leg belongs to a body that is no person [m].
const OWN: f64 = 0.12;
/// Least time for which such a body was measured [s].
const KNOWN: f64 = 1.0;

/// Merge legs: the measurement of the person replaces one leg, and the other leg becomes a part of
/// it.
pub(super) fn put_together(
    bodies: &[&RoundBody],
    seen: &mut [BodyMeasurement],
    wholes: &mut [usize],
) {
    // Longer than other functions: three rules for the same legs, in their order, share what is
    // still free.
    let mut free: Vec<usize> = (0..seen.len())
        .filter(|&one| {
            let is_thin = |leg: usize| {
                let is_large = seen[leg].outline.is_some_and(|outline| outline.is_large);
                seen[leg].circle.z[2] <= THICKEST && !is_large
            };
            is_thin(one) && is_thin(wholes[one])
        })
        .filter(|&one| !bodies.iter().any(|body| body.holds(&seen[one])))
        .collect();
    let people: Vec<Vector3<f64>> =
        bodies.iter().filter(|body| body.person.has_legs()).map(|body| body.place()).collect();
    let shares = shared_out(&people, seen, &free, STEP);
    // What stands between two legs, and legs of others, are no trunk.
    let mut others: Vec<usize> = shares.concat();
    others.extend((0..seen.len()).filter(|&one| bodies.iter().any(|body| body.is_at(&seen[one]))));
    for own in shares {
        match own[..] {
            [one, two, ..] => {
                join(seen, wholes, [one, two], &others);
                free.retain(|&leg| leg != one && leg != two);
            }
            [one, ..] if wholes[one] == one => {
                let leg = &mut seen[one];
                for axis in 0..2 {
                    leg.circle.R[(axis, axis)] += SINGLE * SINGLE;
                }
                leg.circle.R[(2, 2)] += SIZE[1] * SIZE[1];
                (leg.round, leg.outline, leg.look, leg.hull) = (None, None, None, None);
                leg.legs = Legs::One;
                free.retain(|&leg| leg != one);
            }
            _ => {}
        }
    }
    while let Some([one, two]) = next_pair(seen, &free) {
        join(seen, wholes, [one, two], &others);
        free.retain(|&leg| leg != one && leg != two);
    }
}

impl RoundBody {
    /// True if a measurement belongs to this body, which was measured for long enough and is no
    /// person on two legs. A measurement at a place that was free does not belong to a standing
    /// body.
    fn holds(&self, seen: &BodyMeasurement) -> bool {
        self.known >= KNOWN
            && !self.person.has_legs()
            && !(self.stands && seen.trace.is_some_and(|trace| trace < BOTH))
            && apart(&self.place(), &seen.circle.z) < OWN
    }

    /// True if a measurement belongs to this body, which stands and is no person.
    fn is_at(&self, seen: &BodyMeasurement) -> bool {
        self.is_fixture() && apart(&self.place(), &seen.circle.z) < OWN
    }
}

/// Indices of the two nearest legs in `free` that may belong to one person; None if there are none.
fn next_pair(seen: &[BodyMeasurement], free: &[usize]) -> Option<[usize; 2]> {
    let mut best: Option<(f64, [usize; 2])> = None;
    for (place, &one) in free.iter().enumerate() {
        for &two in &free[place + 1..] {
            let (Some(first), Some(second)) = (seen[one].trace, seen[two].trace) else { continue };
            let far = apart(&seen[one].circle.z, &seen[two].circle.z);
            let moved = first.max(second) < EACH && 0.5 * (first + second) < BOTH;
            let is_pair = moved && difference(&seen[one], &seen[two]) < HIDDEN;
            if is_pair && far < STEP && best.is_none_or(|(least, _)| far < least) {
                best = Some((far, [one, two]));
            }
        }
    }
    best.map(|(_, pair)| pair)
}

/// Merge two legs, or arms, into the first measurement. An object between them is a part of the
/// person (a trunk), unless it is one of the `others`.
fn join(
    seen: &mut [BodyMeasurement],
    wholes: &mut [usize],
    [one, two]: [usize; 2],
    others: &[usize],
) {
    let (left, right) = (seen[one], seen[two]);
    let (a, b) = (left.circle, right.circle);
    let mut person = left;
    let middle = (a.z + b.z) * 0.5;
    let radius = (0.5 * apart(&a.z, &b.z)).max(middle[2]);
    person.circle.z = Vector3::new(middle[0], middle[1], radius);
    person.circle.R = (a.R + b.R) * 0.25;
    for axis in 0..2 {
        person.circle.R[(axis, axis)] += MIDDLE * MIDDLE;
    }
    person.circle.R[(2, 2)] += SIZE[0] * SIZE[0];
    person.circle.delay = 0.5 * (a.delay + b.delay);
    person.time_ns = left.time_ns / 2 + right.time_ns / 2;
    person.trace = left.trace.zip(right.trace).map(|(first, second)| 0.5 * (first + second));
    (person.round, person.outline, person.look, person.hull) = (None, None, None, None);
    (person.is_face, person.legs) = (false, Legs::Two);
    seen[one] = person;
    wholes[one] = one;
    let far = apart(&a.z, &b.z);
    let is_between = |other: usize| {
        let z = &seen[other].circle.z;
        are_alike(z[2], radius) && apart(&middle, z) < 0.5 * far && !others.contains(&other)
    };
    for other in (0..seen.len()).filter(|&other| other != one) {
        if other == two || wholes[other] == other && is_between(other) {
            wholes.iter_mut().filter(|whole| **whole == other).for_each(|whole| *whole = one);
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::circles::map::circle_measurement::CircleMeasurement;
    use nalgebra::Matrix3;

    pub(in crate::circles::map::body) fn leg(x: f64, y: f64, trace: f64) -> BodyMeasurement {
        BodyMeasurement {
            circle: CircleMeasurement {
                z: Vector3::new(x, y, 0.07),
                R: Matrix3::identity() * 1e-4,
                delay: 0.0,
            },
            round: None,
            outline: None,
            is_face: false,
            time_ns: 0,
            sight: [1.0, 0.0],
            look: None,
            hull: None,
            trace: Some(trace),
            legs: Legs::None,
        }
    }

    fn joined(mut seen: Vec<BodyMeasurement>) -> (Vec<BodyMeasurement>, Vec<usize>) {
        let mut wholes = (0..seen.len()).collect::<Vec<_>>();
        put_together(&[], &mut seen, &mut wholes);
        (seen, wholes)
    }

    #[test]
    fn two_legs_where_space_was_free_are_one_person_in_their_middle() {
        let (seen, wholes) =
            joined(vec![leg(2.0, 0.0, 0.1), leg(2.4, 0.2, 0.6), leg(5.0, 0.0, 0.0)]);
        assert_eq!(wholes, [0, 0, 2]);
        assert_eq!((seen[0].legs, seen[2].legs), (Legs::Two, Legs::None));
        assert!(
            (seen[0].circle.z[0] - 2.2).abs() < 1e-12 && (seen[0].circle.z[1] - 0.1).abs() < 1e-12
        );
    }

    #[test]
    fn what_stands_and_what_is_far_apart_is_not_put_together() {
        assert_eq!(joined(vec![leg(2.0, 0.0, 1.0), leg(2.3, 0.0, 1.0)]).1, [0, 1]);
        assert_eq!(joined(vec![leg(2.0, 0.0, 0.0), leg(2.3, 0.0, 1.0)]).1, [0, 1]);
        assert_eq!(joined(vec![leg(2.0, 0.0, 0.0), leg(2.9, 0.0, 0.0)]).1, [0, 1]);
    }

    #[test]
    fn a_trunk_between_two_arms_is_a_part_of_the_person() {
        let of = |middle: [f64; 2], radius: f64| {
            let mut seen = vec![leg(2.0, -0.25, 0.0), leg(2.0, 0.25, 0.0), leg(0.0, 0.0, 0.0)];
            (seen[2].circle.z[0], seen[2].circle.z[1]) = (middle[0], middle[1]);
            seen[2].circle.z[2] = radius;
            joined(seen).1
        };
        assert_eq!(of([2.0, 0.05], 0.2), [0, 0, 0]);
        assert_eq!(of([2.6, 0.0], 0.2), [0, 0, 2]); // somebody in front
        assert_eq!(of([2.2, 0.0], 1.5), [0, 0, 2]); // a column
    }

    #[test]
    fn what_belongs_to_others_is_no_trunk() {
        let mut seen = vec![leg(2.0, -0.25, 0.0), leg(2.0, 0.25, 0.0), leg(2.0, 0.05, 0.0)];
        let mut wholes = vec![0, 1, 2];
        join(&mut seen, &mut wholes, [0, 1], &[2]);
        assert_eq!(wholes, [0, 0, 2]);
    }

    #[test]
    fn of_three_legs_the_nearest_two_are_one_person() {
        assert_eq!(
            joined(vec![leg(2.0, 0.0, 0.0), leg(2.7, 0.0, 0.0), leg(2.9, 0.0, 0.0)]).1,
            [0, 1, 1]
        );
    }
}
