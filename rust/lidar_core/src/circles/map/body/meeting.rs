//! Decides which measurements and bodies may be one object, and which bodies certainly are separate
//! objects.

#![allow(non_snake_case)] // textbook letters

use super::places::{apart, are_alike, is_one};
use super::{BESIDE_FOR, BodyMeasurement, FARTHEST, KNOWN, MET, PERSON, RoundBody};
use crate::circles::map::element::exceeds;
use crate::circles::map::rules::Rules;
use nalgebra::{Matrix3, Vector3};

/// Ratio of radii up to which a measurement may belong to a body nearby.
const ALIKE: f64 = 2.0;
/// Tolerance that is added to this limit of the radius [m].
const SLACK: f64 = 0.05;
/// Distance of a person from the surface of a measurement up to which it may show this person and
/// another one at once [m].
const TOUCH: f64 = 0.1;

impl RoundBody {
    /// Assign measurements that no body explains to bodies that touch them and have no measurement:
    /// the visible part of such a body changed, and there is no new object. The entries in `owners`
    /// are set.
    pub(super) fn adopt<'a>(
        all: impl Iterator<Item = &'a Self>,
        seen: &[BodyMeasurement],
        wholes: &[usize],
        owners: &mut [Option<usize>],
        rules: &Rules,
    ) {
        let bodies: Vec<(usize, Vector3<f64>, &Self)> =
            all.enumerate().map(|(row, body)| (row, body.place(), body)).collect();
        for (column, measurement) in seen.iter().enumerate() {
            if owners[column].is_some() || wholes[column] != column {
                continue;
            }
            let z = &measurement.circle.z;
            let is_known = |body: &Self| {
                let P = body.circle().covariance.fixed_view::<2, 2>(0, 0).into_owned();
                !exceeds(&P, KNOWN * KNOWN)
            };
            let nearest = bodies
                .iter()
                .filter(|(row, ..)| !owners.contains(&Some(*row)))
                .filter(|(_, circle, body)| {
                    is_one(circle, z, rules) && are_alike(circle[2], z[2]) && is_known(body)
                })
                .map(|(row, circle, _)| (*row, libm::hypot(circle[0] - z[0], circle[1] - z[1])))
                .filter(|&(_, apart)| apart <= FARTHEST)
                .min_by(|one, other| one.1.total_cmp(&other.1));
            owners[column] = nearest.map(|(row, _)| row);
        }
    }

    /// True if both bodies certainly are separate objects, however close they are: people who pass
    /// each other or a static object, and static objects that were seen beside each other.
    pub(super) fn passes(&self, other: &Self) -> bool {
        self.is_known() && other.is_known()
    }

    /// True if the body certainly is a separate object.
    fn is_known(&self) -> bool {
        self.is_somebody() || self.is_fixture()
    }

    /// Separate measurements that were merged in `wholes` although they belong to two separate
    /// bodies: the gap between the fits of two bodies may disappear in some scans.
    pub(super) fn keep_apart(bodies: &[&Self], seen: &[BodyMeasurement], wholes: &mut [usize]) {
        let owner = |number: usize| {
            let z = &seen[number].circle.z;
            let own = bodies.iter().enumerate().filter(|(_, body)| body.is_known());
            let near = own.filter_map(|(row, body)| {
                let place = body.place();
                let is_of_size = place[2].max(z[2]) < ALIKE * place[2].min(z[2]) + SLACK;
                let apart = body.apart(z);
                (is_of_size && apart < place[2].max(SLACK)).then_some((apart, row))
            });
            near.min_by(|one, other| one.0.total_cmp(&other.0)).map(|(_, row)| row)
        };
        for (part, whole) in wholes.iter_mut().enumerate().filter(|(part, whole)| **whole != *part)
        {
            let own = owner(part);
            if own.is_some() && owner(*whole).is_some_and(|other| Some(other) != own) {
                *whole = part;
            }
        }
    }

    /// Increase the covariance of measurements that show two people at once: their centre is
    /// between the people and contains little information about either.
    pub(super) fn share(bodies: &[&Self], seen: &mut [BodyMeasurement], wholes: &[usize]) {
        let people: Vec<Vector3<f64>> =
            bodies.iter().filter(|body| body.is_somebody()).map(|body| body.place()).collect();
        let mut owners: Vec<Vec<usize>> = vec![Vec::new(); seen.len()];
        for (number, person) in people.iter().enumerate() {
            let own = (0..seen.len())
                .filter(|&one| wholes[one] == one && are_alike(person[2], seen[one].circle.z[2]))
                .map(|one| (apart(person, &seen[one].circle.z), one))
                .min_by(|one, two| one.0.total_cmp(&two.0));
            if let Some((off, one)) = own
                && off < seen[one].circle.z[2].max(person[2]) + TOUCH
            {
                owners[one].push(number);
            }
        }
        for (one, owners) in seen.iter_mut().zip(owners) {
            let [first, second, ..] = owners[..] else { continue };
            let spread = apart(&people[first], &people[second]) + TOUCH;
            one.circle.R += Matrix3::identity() * (spread * spread);
            (one.round, one.outline, one.look, one.hull) = (None, None, None, None);
        }
    }

    /// True if the body is a person, and certainly no part of another person.
    pub(super) fn is_somebody(&self) -> bool {
        self.is_like_a_person() && self.is_its_own()
    }

    /// True if the body stands, is no person, and certainly is no part of a person.
    pub(super) fn is_fixture(&self) -> bool {
        self.stands && !self.is_like_a_person() && self.is_its_own()
    }

    /// True if the body was measured for long enough to be a separate object. A part of a person
    /// that was first seen beside this person is merged with it before that time.
    fn is_its_own(&self) -> bool {
        self.known >= if self.is_beside { BESIDE_FOR } else { MET }
    }

    /// True if the body was seen on two legs, or is most probably a person.
    pub(super) fn is_like_a_person(&self) -> bool {
        self.person.has_legs() || self.person() > PERSON
    }

    /// Distance of a circle from the body [m].
    pub(super) fn apart(&self, z: &Vector3<f64>) -> f64 {
        apart(&self.place(), z)
    }

    /// True if a measurement may belong to this body by its size. A large body and a small object
    /// inside its circle are two objects.
    pub(super) fn is_alike(&self, seen: &BodyMeasurement) -> bool {
        are_alike(self.place()[2], seen.circle.z[2])
    }
}

#[cfg(test)]
mod tests {
    use super::super::legs::tests::leg;
    use super::super::measurement::Legs;
    use super::super::person::Gait;
    use super::*;
    use crate::Error;
    use crate::circles::map::element::State;
    use crate::circles::map::{CircleMapParameters, ElementFilter};

    /// Somebody who was measured here for long enough and walks, with a trunk of this kind.
    fn person(x: f64, is_round: bool) -> Result<RoundBody, Error> {
        let parameters = CircleMapParameters::default();
        let ElementFilter::Independent(independent) = parameters.filter else {
            return Err(Error::NotPositiveDefinite { matrix: "none" });
        };
        let rules = Rules::new(independent, parameters.gate_probability, parameters.initial_speed)?;
        let mut body = RoundBody::new(&leg(x, 0.0, 0.0), std::iter::empty(), &rules);
        let gait = Gait { legs: Legs::None, speed: 1.0, radius: 0.2, is_angular: false };
        (0..40).for_each(|_| body.person.hear(&gait, 0.1));
        (body.known, body.stands) = (3.0, false);
        (0..200).for_each(|_| body.outline.doubted(!is_round));
        Ok(body)
    }

    #[test]
    fn what_shows_two_people_is_uncertain_and_what_shows_one_is_not() -> Result<(), Error> {
        let (one, two) = (person(2.0, true)?, person(2.2, true)?);
        let between = [leg(2.1, 0.0, 0.0)];
        let sure = between[0].circle.R;
        let mut large = leg(2.9, 0.0, 0.0);
        large.circle.z[2] = 1.5;
        for (people, own, is_shared) in [
            (vec![&one, &two], between.to_vec(), true),
            (vec![&one], between.to_vec(), false),
            (vec![&one, &two], vec![leg(2.0, 0.0, 0.0), leg(2.2, 0.0, 0.0)], false),
            (vec![&one, &two], vec![large], false), // a column that hides both
        ] {
            let (mut seen, wholes) = (own.clone(), (0..own.len()).collect::<Vec<_>>());
            RoundBody::share(&people, &mut seen, &wholes);
            for one in seen {
                assert_eq!(one.circle.R != sure, is_shared);
                assert!(!is_shared || one.circle.R[(0, 0)] > 0.03);
            }
        }
        Ok(())
    }

    /// The same error over a time, whatever the rate of the scans; none of what is round or stands.
    #[test]
    fn who_walks_sways_for_a_part_of_a_step() -> Result<(), Error> {
        let mut body = person(2.0, false)?;
        let [fast, slow] = [0.025, 0.05].map(|dt| body.sway(Legs::None, dt) * dt);
        assert!(fast > 0.0 && (fast / slow - 1.0).abs() < 0.1);
        assert!(body.sway(Legs::One, 0.05) > 0.1 && body.sway(Legs::Two, 0.05) == 0.0);
        assert_eq!(person(2.0, true)?.sway(Legs::None, 0.05), 0.0);
        body.stands = true;
        assert_eq!(body.sway(Legs::None, 0.05), 0.0);
        Ok(())
    }
}
