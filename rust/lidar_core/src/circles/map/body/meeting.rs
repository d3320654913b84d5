//! Which bodies may be one, and which are surely two.

#![allow(non_snake_case)] // textbook letters

use super::places::{are_alike, is_one};
use super::{BESIDE_FOR, BodyMeasurement, FARTHEST, KNOWN, MET, PERSON, RoundBody};
use crate::circles::map::element::exceeds;
use crate::circles::map::rules::Rules;
use nalgebra::Vector3;

/// Ratio of radii, and a length [m], up to which a measurement is of a body that is near.
const ALIKE: f64 = 2.0;
const SLACK: f64 = 0.05;

impl RoundBody {
    /// Bodies that were not measured but touch a measurement that none explains: a change of the
    /// visible part, not a new object. Owners of such measurements are set.
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

    /// True if they surely are two, however close they come: people who pass each other or something
    /// that stands, and what has stood beside each other.
    pub(super) fn passes(&self, other: &Self) -> bool {
        self.is_known() && other.is_known()
    }

    /// True if it surely is an object of its own.
    fn is_known(&self) -> bool {
        self.is_somebody() || self.is_fixture()
    }

    /// Give back their own measurements to bodies that surely are two: gaps between them come and go
    /// with their fits.
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

    /// True if it is a person, and surely no part of another one.
    pub(super) fn is_somebody(&self) -> bool {
        self.is_like_a_person() && self.is_its_own()
    }

    /// True if it is something that stands, and surely no part of a person.
    pub(super) fn is_fixture(&self) -> bool {
        self.stands && !self.is_like_a_person() && self.is_its_own()
    }

    /// True if it was measured for long enough to be no part of another: what was first seen beside a
    /// person and is one of its parts becomes one with it before.
    fn is_its_own(&self) -> bool {
        self.known >= if self.is_beside { BESIDE_FOR } else { MET }
    }

    /// True if it was seen on two legs, or is most probably a person.
    pub(super) fn is_like_a_person(&self) -> bool {
        self.person.has_legs() || self.person() > PERSON
    }

    /// Distance of a circle from the body [m].
    pub(super) fn apart(&self, z: &Vector3<f64>) -> f64 {
        let place = self.place();
        libm::hypot(place[0] - z[0], place[1] - z[1])
    }

    /// True if a measurement may be of this body by its size. A large body and what stands inside
    /// its circle are two objects.
    pub(super) fn is_alike(&self, seen: &BodyMeasurement) -> bool {
        are_alike(self.place()[2], seen.circle.z[2])
    }
}
