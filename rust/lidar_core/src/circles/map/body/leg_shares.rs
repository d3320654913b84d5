//! Assignment of legs to people.
//!
//! While people pass each other, the leg nearest to one person may belong to another one: a leg is
//! up to half a step away from the centre of its person. Only both legs together show to whom they
//! belong. All possible assignments of the legs of a group are therefore compared.

use super::measurement::BodyMeasurement;
use super::places::apart;
use nalgebra::Vector3;

/// Largest distance of a leg from the middle of its person [m].
const REACH: f64 = 0.6;
/// Standard deviation of the middle of two legs, or of a single leg, from the predicted position of
/// the person [m]: steps are uneven, and a leg may be partly hidden.
const SPREAD: f64 = 0.25;
/// Cost of a leg that is not seen: -2 ln of its probability.
pub(super) const HIDDEN: f64 = 6.0;
/// Cost of a person of whom no leg is seen: -2 ln of its probability.
const NOBODY: f64 = 18.0;
/// Radius up to which a limb may be a leg, whatever the radius of the other one [m].
const THICK: f64 = 0.1;
/// Standard deviation of the difference of two radii beyond `THICK` [m].
const ALIKE: f64 = 0.02;
/// Largest number of people in a group for which all assignments are compared.
const MOST_PEOPLE: usize = 4;
/// Largest number of legs that are considered for one person.
const MOST_LEGS: usize = 6;

/// A possible assignment of legs to a person: cost (-2 ln of its probability), index of the person,
/// and indices of one or two legs.
#[derive(Clone, Debug)]
struct LegChoice {
    cost: f64,
    person: usize,
    legs: Vec<usize>,
}

/// Assign legs to people: for each person the indices of at most two measurements in `seen`; no leg
/// belongs to two people. `people`: predicted positions (x, y, radius) [m]. `free`: indices of the
/// measurements that may be legs. Legs of one person are less than `step` [m] apart.
pub(super) fn shared_out(
    people: &[Vector3<f64>],
    seen: &[BodyMeasurement],
    free: &[usize],
    step: f64,
) -> Vec<Vec<usize>> {
    let mut choices: Vec<LegChoice> =
        (0..people.len()).flat_map(|person| choices_of(person, people, seen, free, step)).collect();
    choices.sort_by(|one, two| {
        let rest = (one.person, &one.legs).cmp(&(two.person, &two.legs));
        one.cost.total_cmp(&two.cost).then(rest)
    });
    let mut owned = vec![Vec::new(); people.len()];
    for members in groups(&choices, people.len(), seen.len()) {
        let own = |person: usize| choices.iter().filter(move |choice| choice.person == person);
        let found = if members.len() > MOST_PEOPLE {
            greedily(&choices, &members)
        } else {
            let all: Vec<Vec<&LegChoice>> = members.iter().map(|&one| own(one).collect()).collect();
            let mut best = (f64::INFINITY, Vec::new());
            search(&all, 0.0, &mut Vec::new(), &mut best);
            best.1
        };
        for (person, legs) in members.into_iter().zip(found) {
            owned[person] = legs;
        }
    }
    owned
}

/// Single legs and pairs of legs that a person may have.
fn choices_of(
    person: usize,
    people: &[Vector3<f64>],
    seen: &[BodyMeasurement],
    free: &[usize],
    step: f64,
) -> Vec<LegChoice> {
    let middle = &people[person];
    let place = |leg: usize| seen[leg].circle.z;
    let mut near: Vec<(f64, usize)> =
        free.iter().map(|&leg| (apart(middle, &place(leg)), leg)).collect();
    near.retain(|&(far, _)| far < REACH);
    near.sort_by(|one, two| one.0.total_cmp(&two.0).then(one.1.cmp(&two.1)));
    near.truncate(MOST_LEGS);
    let cost = |far: f64| far * far / (SPREAD * SPREAD);
    let mut choices = Vec::new();
    for (number, &(far, one)) in near.iter().enumerate() {
        choices.push(LegChoice { cost: cost(far) + HIDDEN, person, legs: vec![one] });
        for &(_, two) in &near[number + 1..] {
            if apart(&place(one), &place(two)) < step {
                let far = apart(middle, &((place(one) + place(two)) * 0.5));
                let cost = cost(far) + difference(&seen[one], &seen[two]);
                choices.push(LegChoice { cost, person, legs: vec![one, two] });
            }
        }
    }
    choices
}

/// Cost of the radii of two limbs that may be a pair of legs. It is high for an arm beside a trunk,
/// which is thicker than any leg.
pub(super) fn difference(one: &BodyMeasurement, two: &BodyMeasurement) -> f64 {
    let [first, second] = [one, two].map(|one| one.circle.z[2]);
    let off = (first.max(second) - first.min(second).max(THICK)).max(0.0);
    off * off / (one.circle.R[(2, 2)] + two.circle.R[(2, 2)] + ALIKE * ALIKE)
}

/// Indices of people in groups: only members of one group compete for the same legs.
fn groups(choices: &[LegChoice], people: usize, legs: usize) -> Vec<Vec<usize>> {
    let mut group_of: Vec<usize> = (0..people).collect();
    let mut user: Vec<Option<usize>> = vec![None; legs];
    for choice in choices {
        for &leg in &choice.legs {
            let other = *user[leg].get_or_insert(choice.person);
            let [one, two] = [group_of[choice.person], group_of[other]];
            for group in group_of.iter_mut().filter(|group| **group == one.max(two)) {
                *group = one.min(two);
            }
        }
    }
    let members = |group: usize| (0..people).filter(|&one| group_of[one] == group).collect();
    (0..people).map(members).filter(|group: &Vec<usize>| !group.is_empty()).collect()
}

/// Legs of each of `members`, assigned greedily by probability, for groups that are too large for a
/// complete search.
fn greedily(choices: &[LegChoice], members: &[usize]) -> Vec<Vec<usize>> {
    let mut found = vec![Vec::new(); members.len()];
    for choice in choices {
        let Some(own) = members.iter().position(|&one| one == choice.person) else { continue };
        if found[own].is_empty() && is_free(&found, choice) {
            found[own].clone_from(&choice.legs);
        }
    }
    found
}

/// Search for the assignment of least cost in which no leg belongs to two people. `best` receives
/// its cost and the legs of each person.
fn search(
    all: &[Vec<&LegChoice>],
    cost: f64,
    chosen: &mut Vec<Vec<usize>>,
    best: &mut (f64, Vec<Vec<usize>>),
) {
    if cost >= best.0 {
        return;
    }
    let Some(choices) = all.get(chosen.len()) else {
        *best = (cost, chosen.clone());
        return;
    };
    for choice in choices {
        if is_free(chosen, choice) {
            chosen.push(choice.legs.clone());
            search(all, cost + choice.cost, chosen, best);
            chosen.pop();
        }
    }
    chosen.push(Vec::new());
    search(all, cost + NOBODY, chosen, best);
    chosen.pop();
}

fn is_free(taken: &[Vec<usize>], choice: &LegChoice) -> bool {
    !choice.legs.iter().any(|leg| taken.iter().flatten().any(|other| other == leg))
}

#[cfg(test)]
mod tests {
    use super::super::legs::tests::leg;
    use super::*;

    fn shares(people: &[[f64; 2]], legs: &[[f64; 2]]) -> Vec<Vec<usize>> {
        let people: Vec<_> = people.iter().map(|&[x, y]| Vector3::new(x, y, 0.2)).collect();
        let seen: Vec<_> = legs.iter().map(|&[x, y]| leg(x, y, 0.0)).collect();
        let free: Vec<usize> = (0..seen.len()).collect();
        let mut owned = shared_out(&people, &seen, &free, 0.75);
        owned.iter_mut().for_each(|legs| legs.sort_unstable());
        owned
    }

    #[test]
    fn the_nearest_leg_may_be_of_another_person() {
        // The front leg of the first person is where the second one is expected.
        let legs = [[-0.3, 0.0], [0.3, 0.0], [0.2, 0.1], [0.4, -0.1]];
        assert_eq!(shares(&[[0.0, 0.0], [0.3, 0.0]], &legs), [vec![0, 1], vec![2, 3]]);
    }

    #[test]
    fn an_arm_and_a_trunk_are_no_pair_unless_their_radii_are_guesses() {
        let pair = |radii: [f64; 2], variance: f64| {
            let mut seen = vec![leg(-0.1, 0.0, 0.0), leg(0.1, 0.0, 0.0)];
            for (one, radius) in seen.iter_mut().zip(radii) {
                (one.circle.z[2], one.circle.R[(2, 2)]) = (radius, variance);
            }
            shared_out(&[Vector3::new(0.0, 0.0, 0.2)], &seen, &[0, 1], 0.75)[0].len()
        };
        assert_eq!(pair([0.045, 0.16], 1e-5), 1);
        assert_eq!(pair([0.045, 0.16], 0.01), 2); // half hidden
        assert_eq!(pair([0.045, 0.1], 1e-5), 2); // a leg of which little is seen
        assert_eq!(pair([0.15, 0.16], 1e-5), 2); // wide trousers
    }

    #[test]
    fn of_three_legs_of_two_people_one_has_both() {
        let legs = [[0.0, -0.1], [0.0, 0.1], [0.6, 0.1]];
        assert_eq!(shares(&[[0.0, 0.0], [0.5, 0.0]], &legs), [vec![0, 1], vec![2]]);
    }

    #[test]
    fn who_is_far_from_all_legs_has_none_and_far_legs_are_no_pair() {
        assert_eq!(shares(&[[0.0, 0.0], [5.0, 0.0]], &[[0.1, 0.0]]), [vec![0], vec![]]);
        assert_eq!(shares(&[[0.0, 0.0]], &[[-0.4, 0.0], [0.5, 0.0]]), [vec![0]]);
    }

    #[test]
    fn a_crowd_is_shared_out_without_a_leg_of_two_people() {
        let people: Vec<[f64; 2]> = (0..8).map(|one| [0.4 * f64::from(one), 0.0]).collect();
        let legs: Vec<[f64; 2]> =
            people.iter().flat_map(|&[x, y]| [[x, y - 0.1], [x, y + 0.1]]).collect();
        let owned = shares(&people, &legs);
        let mut all: Vec<usize> = owned.concat();
        all.sort_unstable();
        assert_eq!(all, (0..16).collect::<Vec<_>>());
        assert!(owned.iter().all(|legs| legs.len() == 2));
    }
}
