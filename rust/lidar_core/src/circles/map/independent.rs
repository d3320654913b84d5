//! The map with a filter per element: one scan after the other.

use super::arrivals::Arrivals;
use super::belief::ElementBelief;
use super::body::RoundBody;
use super::element::{Element, State};
use super::element_motion::ElementMotion;
use super::line::Line;
use super::modes::halted;
use super::parameters::MAX_ELEMENTS;
use super::rules::Rules;
use super::scan::{KeptScan, MeasuredObjects, too_many};
use super::view::viewpoint::Viewpoint;
use super::view::visibility::CircleVisibility;
use super::{MapElement, MapShape, seconds};
use crate::Error;
use crate::circles::shape::ShapeKind;
use crate::estimation::kalman::Gaussian;
use serde::{Deserialize, Serialize};

/// All elements at one time, by ascending ID.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Elements {
    stamp_ns: Option<i64>,
    bodies: Vec<Element<RoundBody>>,
    lines: Vec<Element<Line>>,
    /// Shares of objects among new elements: for bodies and for lines.
    arrivals: [Arrivals; 2],
}

impl Elements {
    /// True if the parts of a restored state agree.
    pub(super) fn fits(&self, motion: &ElementMotion) -> bool {
        self.len() <= MAX_ELEMENTS
            && self.bodies.is_sorted_by(|one, next| one.id < next.id)
            && self.lines.is_sorted_by(|one, next| one.id < next.id)
            && self.bodies.iter().all(|body| body.state.fits(motion))
    }

    /// ID of every element, and true if it is reported.
    pub(super) fn numbers(&self) -> impl Iterator<Item = (i64, bool)> {
        let bodies = self.bodies.iter().map(|body| (body.id, body.is_reported()));
        bodies.chain(self.lines.iter().map(|line| (line.id, line.is_reported())))
    }

    pub(super) fn holds(&self, id: i64) -> bool {
        self.numbers().any(|(known, _)| known == id)
    }

    /// Change IDs of elements: pairs of the old and the new ID.
    pub(super) fn rename(&mut self, numbers: &[(i64, i64)]) {
        rename(&mut self.bodies, numbers);
        rename(&mut self.lines, numbers);
    }

    /// Predict all elements to the time of `scan` and correct them with it; returns pairs of merged
    /// elements. A scan that is processed again gives new elements the IDs that they had.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`], [`Error::Limit`]; the elements may then be half changed.
    pub(super) fn step(
        &mut self,
        rules: &Rules,
        scan: &mut KeptScan,
        next_id: &mut i64,
    ) -> Result<Vec<[i64; 2]>, Error> {
        let KeptScan { from, bodies, lines } = scan;
        let dt = self.stamp_ns.map_or(0.0, |stamp_ns| seconds(stamp_ns, from.stamp_ns));
        self.stamp_ns = Some(from.stamp_ns);
        // Elements created by this scan are included, so that one number is never given twice.
        let mut taken: Vec<i64> = self.numbers().map(|(id, _)| id).collect();
        let mut fresh = |known: Option<i64>| {
            let id = known.filter(|id| !taken.contains(id)).unwrap_or_else(|| {
                *next_id += 1;
                *next_id - 1
            });
            taken.push(id);
            id
        };
        let [new_bodies, new_lines] = &mut self.arrivals;
        take_in(rules, (&mut self.bodies, &*new_bodies), bodies, (from, dt), &mut fresh)?;
        take_in(rules, (&mut self.lines, &*new_lines), lines, (from, dt), &mut fresh)?;
        let count = self.bodies.len() + self.lines.len();
        if count > MAX_ELEMENTS {
            return Err(too_many(count));
        }
        let mut merged = tidy(rules, &mut self.bodies, new_bodies);
        merged.append(&mut tidy(rules, &mut self.lines, new_lines));
        Ok(merged)
    }

    /// Elements of the map of circles, predicted to `stamp_ns`: all except large shapes.
    pub(super) fn at(&self, rules: &Rules, stamp_ns: i64) -> Vec<MapElement> {
        let step = rules.motion().coast(seconds(self.stamp_ns.unwrap_or(stamp_ns), stamp_ns));
        let predicted = |body: &Element<RoundBody>| {
            let state = body.state.coasted(&step);
            MapElement {
                id: body.id,
                state,
                age: seconds(body.born_ns, stamp_ns),
                seen_ns: body.seen_ns,
                n_measurements: body.n_measurements,
                visible: body.is_visible(),
                confirmed: body.is_reported(),
                person: body.state.person(),
                existence: body.belief.existence(),
                kinds: body.belief.kinds().probabilities(),
                kind: body.belief.kinds().kind(),
            }
        };
        self.bodies.iter().filter(|body| !body.state.outline.is_large()).map(predicted).collect()
    }

    /// Elements that are no circles, predicted to `stamp_ns`.
    pub(super) fn shapes_at(&self, rules: &Rules, stamp_ns: i64) -> Vec<MapShape> {
        let step = rules.motion().coast(seconds(self.stamp_ns.unwrap_or(stamp_ns), stamp_ns));
        let bodies = self.bodies.iter().filter_map(|body| {
            let mut outline = body.state.outline.clone();
            outline.predict(&step);
            let (kind, state) = outline.reported()?;
            let state = if body.state.stands() { halted(state) } else { state };
            Some(shape_of(body, stamp_ns, (kind, state, None)))
        });
        let lines = self.lines.iter().map(|line| {
            let mut state = line.state.clone();
            state.predict(&step);
            let shown = (ShapeKind::Line, state.reported(), Some(state.ends()));
            shape_of(line, stamp_ns, shown)
        });
        let mut shapes: Vec<MapShape> = bodies.chain(lines).collect();
        shapes.sort_by_key(|shape| shape.id);
        shapes
    }

    /// True if all points [m], in the world, lie on one confirmed line of at least this length [m].
    /// `std`: standard deviation of the ranges [m].
    pub(super) fn is_on_line(
        &self,
        rules: &Rules,
        points: &[[f64; 2]],
        std: f64,
        length: f64,
    ) -> bool {
        self.lines.iter().any(|line| {
            line.confirmed
                && line.state.length() >= length
                && line.state.holds(points, std, rules.lines())
        })
    }

    fn len(&self) -> usize {
        self.bodies.len() + self.lines.len()
    }
}

fn rename<S>(all: &mut [Element<S>], numbers: &[(i64, i64)]) {
    for element in all.iter_mut() {
        element.id = new_number(element.id, numbers);
    }
    all.sort_by_key(|element| element.id);
}

/// Test whether the scan should have measured an element that has no measurement. Only such
/// elements are tested, because the test needs a search in the scan.
fn look_for<S: State>(
    element: &mut Element<S>,
    (from, dt): (&Viewpoint, f64),
    rules: &Rules,
) -> Result<(), Error> {
    let visibility = element.state.look(from, rules);
    let is_unknown = visibility == CircleVisibility::OutOfView;
    // What a ray or two still end on is far away, not hidden.
    let is_glimpsed = is_unknown && element.state.glimpse(from, rules)?;
    element.unmeasured(visibility, from.sensor, if is_glimpsed { 0.0 } else { dt });
    Ok(())
}

/// Create an element for every measurement that no existing one explains. Parts get the element of
/// their object, so that one object is not counted twice.
fn create<S: State>(
    rules: &Rules,
    (all, arrivals): (&mut Vec<Element<S>>, &Arrivals),
    seen: &mut [Option<i64>],
    (measurements, wholes): (&[S::Measurement], &[usize]),
    from: &Viewpoint,
    mut fresh: impl FnMut(usize) -> i64,
) {
    // Eqs 18-20, after all corrections: a new element must not take a measurement that a known one explains.
    for (index, measurement) in measurements.iter().enumerate() {
        let is_new = wholes[index] == index && seen[index].is_none();
        if is_new && S::is_born(measurement, rules) {
            let id = fresh(index);
            let state = S::new(measurement, all.iter().map(|one| &one.state), rules);
            let belief = ElementBelief::new(S::birth_place(measurement), arrivals);
            all.push(Element::new(id, state, belief, from.key()));
            seen[index] = Some(id);
        }
    }
    for (index, whole) in wholes.iter().enumerate() {
        seen[index] = seen[*whole];
    }
}

/// Predict, associate, correct and create the elements of one kind.
fn take_in<S: State>(
    rules: &Rules,
    (all, arrivals): (&mut Vec<Element<S>>, &Arrivals),
    seen: &mut MeasuredObjects<S::Measurement>,
    (from, dt): (&Viewpoint, f64),
    fresh: &mut impl FnMut(Option<i64>) -> i64,
) -> Result<(), Error> {
    // Longer than other functions: the stages of a scan in the order of the paper.
    // A second sensor may have a scan of the same stamp: no time, no noise and no switch of modes.
    if dt > 0.0 {
        let step = rules.motion().step(dt);
        all.iter_mut().for_each(|element| element.predict(&step));
    }
    let states = || all.iter().map(|one| &one.state);
    let (measurements, wholes) = S::wholes(states(), &seen.measurements, rules);
    let owners = S::associate(states(), &measurements, &wholes, from, rules)?;
    let mut is_measured = vec![false; all.len()];
    let known = std::mem::replace(&mut seen.elements, vec![None; owners.len()]);
    for (measurement, row) in owners.iter().enumerate() {
        let Some(row) = *row else { continue };
        all[row].state.correct(&measurements[measurement], rules)?;
        is_measured[row] = true;
        seen.elements[measurement] = Some(all[row].id);
    }
    for (element, is_measured) in all.iter_mut().zip(is_measured) {
        if is_measured {
            element.measured(from.key());
        } else {
            look_for(element, (from, dt), rules)?;
        }
    }
    create(
        rules,
        (&mut *all, arrivals),
        &mut seen.elements,
        (&measurements, &wholes),
        from,
        |index| fresh(known[index]),
    );
    all.sort_by_key(|element| element.id);
    Ok(())
}

/// Merge elements of one object, decide which elements are reported, and remove elements that end.
/// Returns pairs of the ID that stays and the ID that was merged into it.
fn tidy<S: State>(
    rules: &Rules,
    all: &mut Vec<Element<S>>,
    arrivals: &mut Arrivals,
) -> Vec<[i64; 2]> {
    let merged = merge(rules, all);
    for element in all.iter_mut() {
        element.settle(rules);
    }
    all.retain_mut(|element| !element.is_over(rules, arrivals));
    merged
}

/// Merge elements of one object. Returns pairs of the ID that stays and the ID that is removed. A
/// confirmed element stays before others, then the older one.
fn merge<S: State>(rules: &Rules, all: &mut Vec<Element<S>>) -> Vec<[i64; 2]> {
    let mut merged = Vec::new();
    let mut index = 0;
    // The index advances only without a twin: a merged element may have further ones.
    while index < all.len() {
        let twin = (index + 1..all.len()).find(|&other| all[index].is_twin(&all[other], rules));
        let Some(twin) = twin else {
            index += 1;
            continue;
        };
        // The user has seen the confirmed element; its number must not disappear in favour of a new
        // one.
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

/// Reported form of an element that is no circle, from its kind, state and ends.
fn shape_of<S: State>(
    element: &Element<S>,
    stamp_ns: i64,
    (kind, state, ends): (ShapeKind, Gaussian<7>, Option<[[f64; 2]; 2]>),
) -> MapShape {
    MapShape {
        id: element.id,
        kind,
        state,
        ends,
        age: seconds(element.born_ns, stamp_ns),
        seen_ns: element.seen_ns,
        visible: element.is_visible(),
        confirmed: element.is_reported(),
    }
}

/// ID of an element after a change of IDs.
pub(super) fn new_number(id: i64, numbers: &[(i64, i64)]) -> i64 {
    numbers.iter().find(|&&(from, _)| from == id).map_or(id, |&(_, to)| to)
}
