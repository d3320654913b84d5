//! Selection of the segments of a sweep for the map: bodies, lines, or nothing.

use super::fit::circle::CircleEstimate;
use super::frame::PreparedSweep;
use super::map::{CircleMap, MapElement, MapStats, OutlineEstimate};
use super::parameters::PipelineParameters;
use super::selection::{MapUse, doubted, is_piece, part};
use super::shape::{ShapeEstimate, ShapeKind};

/// Speed below which an element stands [m/s].
const STILL: f64 = 0.02;

/// Segments that go into the map, by index.
#[derive(Default)]
pub(super) struct Parts {
    pub(super) bodies: Vec<usize>,
    pub(super) circles: Vec<CircleEstimate>,
    /// Shapes that the circles represent.
    pub(super) outlines: Vec<Option<OutlineEstimate>>,
    lines: Vec<usize>,
    pub(super) shapes: Vec<ShapeEstimate>,
    /// For all segments: true for a body of which a part may be nearer than the smallest measurable
    /// range.
    too_near: Vec<bool>,
}

/// For every segment the IDs of its body and of its line in the map; None without one.
pub(super) struct ByKind {
    pub(super) bodies: Vec<Option<i64>>,
    pub(super) lines: Vec<Option<i64>>,
    pub(super) too_near: Vec<bool>,
}

impl Parts {
    /// Select the segments for the map.
    ///
    /// Objects of which a part may be too near to be measured are left out. A body on a line of the
    /// map is a piece of that line if the line is longer than any body, or if a nearer object hides
    /// one side of the body and the other side is not free.
    pub(super) fn of(
        prepared: &PreparedSweep,
        circles: &[CircleEstimate],
        shapes: &[ShapeEstimate],
        parameters: &PipelineParameters,
        map: &CircleMap,
    ) -> Self {
        // Longer than other functions: each rule decides by what the ones before it have found.
        let limits = [prepared.range_std, parameters.max_deviation];
        let mut parts = Self::default();
        for (number, circle) in circles.iter().enumerate() {
            let shape = shapes.get(number).zip(parameters.shapes.as_ref());
            let part = part(prepared, number, circle, shape, limits);
            let is_too_near = shape.is_some()
                && matches!(part, MapUse::Body(_))
                && prepared.is_too_near(number, limits[0]);
            parts.too_near.push(is_too_near);
            let part = if is_too_near { MapUse::Nothing } else { part };
            let is_on_wall = matches!(part, MapUse::Body(_))
                && shape.is_some_and(|(_, rules)| {
                    let is_piece = is_piece(prepared.segments.sides[number]);
                    let least = if is_piece { 0.0 } else { 2.0 * rules.max_size };
                    map.is_on_line(&prepared.points_world(number), limits[0], least)
                });
            let straight = shape.filter(|(found, _)| found.kind == ShapeKind::Line);
            match (part, straight) {
                (MapUse::Body(body), _) if !is_on_wall => {
                    parts.bodies.push(number);
                    parts.circles.push(body);
                    let outline = shape.and_then(|(found, rules)| rules.outline(found));
                    let round = || doubted(prepared, number, circle, limits);
                    parts
                        .outlines
                        .push(outline.map(|one| OutlineEstimate { round: round(), ..one }));
                }
                (MapUse::Body(_) | MapUse::Line, Some((found, _))) => {
                    parts.lines.push(number);
                    parts.shapes.push(*found);
                }
                _ => {}
            }
        }
        parts
    }

    /// Elements of all `count` segments, as assigned by the map.
    pub(super) fn elements(self, count: usize, stats: &MapStats) -> ByKind {
        let (bodies, lines) = (vec![None; count], vec![None; count]);
        let mut elements = ByKind { bodies, lines, too_near: self.too_near };
        for (&number, &element) in self.bodies.iter().zip(&stats.elements) {
            elements.bodies[number] = Some(element);
        }
        for (&number, &element) in self.lines.iter().zip(&stats.lines) {
            elements.lines[number] = element;
        }
        elements
    }
}

/// Circles of standing elements, each with the ID of its element.
pub(super) fn standing<'a>(
    map: &[MapElement],
    elements: &[Option<i64>],
    circles: &'a [CircleEstimate],
) -> impl Iterator<Item = (i64, &'a CircleEstimate)> {
    let still = |one: &&MapElement| {
        one.confirmed && libm::hypot(one.state.mean[2], one.state.mean[3]) < STILL
    };
    let ids: Vec<i64> = map.iter().filter(still).map(|one| one.id).collect();
    let pairs = elements.iter().zip(circles);
    pairs.filter_map(move |(&id, circle)| id.filter(|id| ids.contains(id)).map(|id| (id, circle)))
}
