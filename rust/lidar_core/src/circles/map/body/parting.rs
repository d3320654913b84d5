//! People who pass each other, and part again: who is who.
//!
//! While two people cover each other, what is seen of them may be taken for the wrong one. Both keep
//! their pace and their direction, though. When they part, both ways to go on are compared, and if they
//! exchanged their numbers, they get them back.

#![allow(non_snake_case)] // textbook letters

use super::RoundBody;
use super::measured::knob;
use crate::circles::map::element::Element;
use crate::estimation::kalman::Gaussian;
use nalgebra::{Matrix4, Vector4};
use serde::{Deserialize, Serialize};

/// Somebody who is passed, and how this body came.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Meeting {
    other: i64,
    before: Gaussian<5>,
    /// Time since then [s].
    pub(super) seconds: f64,
    /// Least distance since then [m].
    least: f64,
}

/// Squared distance of a state from where one goes in `seconds` who walked like this, with the
/// logarithm of its determinant.
fn off(before: &Gaussian<5>, seconds: f64, now: &Gaussian<5>) -> f64 {
    let mut F = Matrix4::identity();
    (F[(0, 2)], F[(1, 3)]) = (seconds, seconds);
    let q = knob(11, 0.5);
    let mut Q = Matrix4::zeros();
    for axis in 0..2 {
        Q[(axis, axis)] = q * seconds * seconds * seconds / 3.0 + 0.01;
        Q[(axis, axis + 2)] = q * seconds * seconds / 2.0;
        Q[(axis + 2, axis)] = Q[(axis, axis + 2)];
        Q[(axis + 2, axis + 2)] = q * seconds + 0.04;
    }
    let part = |state: &Gaussian<5>| {
        let mean = Vector4::from_fn(|row, _| state.mean[row]);
        (mean, state.covariance.fixed_view::<4, 4>(0, 0).into_owned())
    };
    let ((from, P), (to, R)) = (part(before), part(now));
    let S = F * P * F.transpose() + Q + R;
    let y = to - F * from;
    S.cholesky().map_or(0.0, |factor| y.dot(&factor.solve(&y)) + 2.0 * factor.ln_determinant() / 2.0)
}

pub(super) fn resolve(all: &mut [Element<RoundBody>]) {
    if knob(5, 1.0) <= 0.0 {
        return;
    }
    let meet = knob(12, 0.7);
    for one in 0..all.len() {
        for two in one + 1..all.len() {
            if !(all[one].state.is_somebody() && all[two].state.is_somebody()) {
                continue;
            }
            let apart = all[one].state.apart(&all[two].state.place());
            let known = |from: usize, to: usize| {
                all[from].state.met.iter().position(|meeting| meeting.other == all[to].id)
            };
            let found = known(one, two).zip(known(two, one));
            let Some((first, second)) = found else {
                if apart < meet && all[one].state.waits == 0 && all[two].state.waits == 0 {
                    for (from, to) in [(one, two), (two, one)] {
                        let other = all[to].id;
                        let before = all[from].state.circle();
                        let met = &mut all[from].state.met;
                        met.retain(|meeting| meeting.other != other);
                        met.push(Meeting { other, before, seconds: 0.0, least: apart });
                    }
                }
                continue;
            };
            let least = all[one].state.met[first].least.min(apart);
            all[one].state.met[first].least = least;
            let has_parted = apart > meet + 0.1;
            let is_seen = all[one].state.waits == 0 && all[two].state.waits == 0;
            if least < knob(13, 0.4) && apart > knob(14, 0.45) && is_seen {
                let ways = [&all[one].state.met[first], &all[two].state.met[second]];
                let now = [all[one].state.circle(), all[two].state.circle()];
                let cost = |way: usize, state: usize| off(&ways[way].before, ways[way].seconds, &now[state]);
                let gain = cost(0, 0) + cost(1, 1) - cost(0, 1) - cost(1, 0);
                if gain > if has_parted { knob(15, 2.0) } else { knob(16, 8.0) } {
                    if knob(17, 0.0) > 0.0 {
                        eprintln!("swap {} {} apart {apart:.2} gain {gain:.1} after {:.2}", all[one].id, all[two].id, ways[0].seconds);
                    }
                    exchange(all, one, two);
                }
            }
            if has_parted {
                for (from, to) in [(one, two), (two, one)] {
                    let other = all[to].id;
                    all[from].state.met.retain(|meeting| meeting.other != other);
                }
            }
        }
    }
}

/// Exchange the numbers of two elements, and what belongs to who they are.
fn exchange(all: &mut [Element<RoundBody>], one: usize, two: usize) {
    let (left, right) = all.split_at_mut(two);
    let (first, second) = (&mut left[one], &mut right[0]);
    std::mem::swap(&mut first.id, &mut second.id);
    std::mem::swap(&mut first.born_ns, &mut second.born_ns);
    std::mem::swap(&mut first.n_measurements, &mut second.n_measurements);
    std::mem::swap(&mut first.state.met, &mut second.state.met);
}
