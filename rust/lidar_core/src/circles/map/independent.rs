//! The map with a filter per element: one scan after the other.

#![allow(non_snake_case)] // textbook letters

use super::element::Element;
use super::modes::{Measurement, Motion};
use super::parameters::{Independent, MAX_ELEMENTS};
use super::scan::{Placed, too_many};
use super::visibility::Visibility;
use super::{MapElement, seconds};
use crate::Error;
use crate::estimation::association::{Pair, assign};
use crate::estimation::kalman::Gaussian;
use nalgebra::Matrix2;

/// Standard deviations from its centre at which an element is looked for, along each axis.
const LOOK: [f64; 4] = [-2.0, -1.0, 1.0, 2.0];

/// How elements are treated.
pub(super) struct Rules {
    parameters: Independent,
    motion: Motion,
    gate: f64,
    speed: f64,
}

/// All elements at one time, by ascending number.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Elements {
    stamp_ns: Option<i64>,
    pub(super) all: Vec<Element>,
}

impl Elements {
    pub(super) fn holds(&self, id: i64) -> bool {
        self.all.iter().any(|element| element.id == id)
    }

    /// Give elements other numbers: pairs of the one they have and the one they get.
    pub(super) fn rename(&mut self, numbers: &[(i64, i64)]) {
        for element in &mut self.all {
            element.id = new_number(element.id, numbers);
        }
        self.all.sort_by_key(|element| element.id);
    }
}

impl Rules {
    pub(super) fn new(parameters: Independent, gate: f64, speed: f64) -> Self {
        let motion = Motion::new(&parameters.modes, parameters.radius_density);
        Self { parameters, motion, gate, speed }
    }

    pub(super) fn parameters(&self) -> &Independent {
        &self.parameters
    }

    /// Move all elements to the time of `scan` and correct them with it; pairs of elements that
    /// were merged. A scan that is taken in again gives new elements the numbers that they had.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`], [`Error::Limit`]; `elements` may then be half changed.
    pub(super) fn step(
        &self,
        elements: &mut Elements,
        scan: &mut Placed,
        next_id: &mut i64,
    ) -> Result<Vec<[i64; 2]>, Error> {
        let dt = elements.stamp_ns.map_or(0.0, |stamp_ns| seconds(stamp_ns, scan.stamp_ns));
        if dt > 0.0 {
            let step = self.motion.step(dt);
            for element in &mut elements.all {
                element.modes.predict(&step);
            }
        }
        elements.stamp_ns = Some(scan.stamp_ns);
        let column_of = self.associate(&elements.all, &scan.measurements)?;
        let mut numbers = vec![None; scan.measurements.len()];
        for (element, column) in elements.all.iter_mut().zip(column_of) {
            if let Some(column) = column {
                element.modes.correct(&scan.measurements[column])?;
                element.measured(scan.key());
                numbers[column] = Some(element.id);
            } else {
                element.unmeasured(self.look(element, scan), scan.sensor, dt);
            }
        }
        self.create(elements, scan, &mut numbers, next_id);
        scan.elements = numbers;
        if elements.all.len() > MAX_ELEMENTS {
            return Err(too_many(elements.all.len()));
        }
        Ok(self.tidy(elements))
    }

    /// Number of the measurement of every element.
    fn associate(
        &self,
        elements: &[Element],
        measurements: &[Measurement],
    ) -> Result<Vec<Option<usize>>, Error> {
        let unassigned = -2.0 * libm::log(self.parameters.birth_density);
        let mut pairs = Vec::new();
        for (row, element) in elements.iter().enumerate() {
            for (column, measurement) in measurements.iter().enumerate() {
                if let Some(cost) = element.modes.cost(measurement, self.gate)? {
                    pairs.push(Pair { row, column, cost });
                }
            }
        }
        assign(elements.len(), measurements.len(), &pairs, unassigned)
    }

    /// What `scan` says about an element that it did not measure: it is seen through only if
    /// rays pass wherever it may be.
    fn look(&self, element: &Element, scan: &Placed) -> Visibility {
        let Some(sight) = &scan.sight else { return Visibility::SeenThrough };
        let state = element.modes.combined();
        let ask = |[x, y]: [f64; 2]| {
            let circle = scan.pose.level([state.mean[0] + x, state.mean[1] + y], state.mean[4]);
            sight.of(&circle, &self.parameters.looking)
        };
        let here = ask([0.0, 0.0]);
        if here != Visibility::SeenThrough {
            return here;
        }
        let around = axes(&state)
            .into_iter()
            .flat_map(|axis| LOOK.map(|reach| axis.map(|value| value * reach)));
        around.map(ask).fold(here, Visibility::max)
    }

    /// Eqs 18-20 for every circle that has no element.
    fn create(
        &self,
        elements: &mut Elements,
        scan: &Placed,
        numbers: &mut [Option<i64>],
        next_id: &mut i64,
    ) {
        for (index, number) in numbers.iter_mut().enumerate().filter(|(_, number)| number.is_none())
        {
            let is_free = |id: &i64| elements.all.iter().all(|element| element.id != *id);
            let id = scan.elements[index].filter(is_free).unwrap_or_else(|| {
                *next_id += 1;
                *next_id - 1
            });
            *number = Some(id);
            let measurement = &scan.measurements[index];
            let element = Element::new(id, measurement, scan.key(), self.speed, &self.motion);
            elements.all.push(element);
        }
        elements.all.sort_by_key(|element| element.id);
    }

    /// Confirm, merge and remove.
    fn tidy(&self, elements: &mut Elements) -> Vec<[i64; 2]> {
        let merged = merge(&mut elements.all, self.parameters.merge_gap);
        for element in &mut elements.all {
            element.confirm(&self.parameters);
        }
        elements.all.retain(|element| !element.is_over(&self.parameters));
        merged
    }

    /// Every element, predicted to `stamp_ns`.
    pub(super) fn at(&self, elements: &Elements, stamp_ns: i64) -> Vec<MapElement> {
        let step = self.motion.step(seconds(elements.stamp_ns.unwrap_or(stamp_ns), stamp_ns));
        elements
            .all
            .iter()
            .map(|element| {
                let mut modes = element.modes.clone();
                modes.predict(&step);
                MapElement {
                    id: element.id,
                    state: modes.combined(),
                    age: seconds(element.born_ns, stamp_ns),
                    seen_ns: element.seen_ns,
                    n_measurements: element.n_measurements,
                    visible: element.is_visible(),
                    confirmed: element.confirmed,
                }
            })
            .collect()
    }
}

/// Merge elements of one object; pairs of the number that stays and the one that goes. A confirmed
/// element stays before any other, then the elder.
fn merge(all: &mut Vec<Element>, gap: f64) -> Vec<[i64; 2]> {
    let mut merged = Vec::new();
    let mut index = 0;
    while index < all.len() {
        let twin = (index + 1..all.len()).find(|&other| all[index].is_twin(&all[other], gap));
        let Some(twin) = twin else {
            index += 1;
            continue;
        };
        let mut dropped = all.remove(twin);
        if dropped.confirmed && !all[index].confirmed {
            std::mem::swap(&mut all[index], &mut dropped);
        }
        merged.push([all[index].id, dropped.id]);
        all[index].absorb(dropped);
    }
    all.sort_by_key(|element| element.id);
    merged
}

/// The two axes of the ellipse of one standard deviation of the centre [m].
fn axes(state: &Gaussian<5>) -> [[f64; 2]; 2] {
    let P: Matrix2<f64> = state.covariance.fixed_view::<2, 2>(0, 0).into_owned();
    let (mean, half) = (0.5 * (P[(0, 0)] + P[(1, 1)]), 0.5 * (P[(0, 0)] - P[(1, 1)]));
    let root = (half * half + P[(0, 1)] * P[(0, 1)]).sqrt();
    let [long, short] = [mean + root, mean - root].map(|value| value.max(0.0).sqrt());
    let angle = 0.5 * libm::atan2(P[(0, 1)], half);
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    [[long * cos, long * sin], [-short * sin, short * cos]]
}

/// The number that an element gets, if it gets another.
pub(super) fn new_number(id: i64, numbers: &[(i64, i64)]) -> i64 {
    numbers.iter().find(|&&(from, _)| from == id).map_or(id, |&(_, to)| to)
}
