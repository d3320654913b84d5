//! What the segments of a sweep are for the map: bodies, lines, or nothing.

use super::bodies::{Part, part};
use super::circle::CircleEstimate;
use super::frame::PreparedSweep;
use super::map::{CircleMap, MapStats};
use super::pipeline::PipelineParameters;
use super::shape::{ShapeEstimate, ShapeKind};

/// Segments that go into the map, by their numbers.
#[derive(Default)]
pub(super) struct Parts {
    pub(super) bodies: Vec<usize>,
    pub(super) circles: Vec<CircleEstimate>,
    lines: Vec<usize>,
    pub(super) shapes: Vec<ShapeEstimate>,
}

/// Elements of all segments.
pub(super) struct ByKind {
    pub(super) bodies: Vec<Option<i64>>,
    pub(super) lines: Vec<Option<i64>>,
}

impl Parts {
    /// Bodies that lie on a line of the map, longer than any of them, are pieces of it.
    pub(super) fn of(
        prepared: &PreparedSweep,
        circles: &[CircleEstimate],
        shapes: &[ShapeEstimate],
        parameters: &PipelineParameters,
        map: &CircleMap,
    ) -> Self {
        let limits = [parameters.fit.range_std, parameters.max_deviation];
        let mut parts = Self::default();
        for (number, circle) in circles.iter().enumerate() {
            let shape = shapes.get(number).zip(parameters.shapes.as_ref());
            let part = part(prepared, number, circle, shape, limits);
            let is_on_wall = matches!(part, Part::Body(_))
                && shape.is_some_and(|(_, rules)| {
                    let points = prepared.points_world(number);
                    map.is_on_line(&points, limits[0], 2.0 * rules.max_size)
                });
            let straight = shape.filter(|(found, _)| found.kind == ShapeKind::Line);
            match (part, straight) {
                (Part::Body(body), _) if !is_on_wall => {
                    parts.bodies.push(number);
                    parts.circles.push(body);
                }
                (Part::Body(_) | Part::Line, Some((found, _))) => {
                    parts.lines.push(number);
                    parts.shapes.push(*found);
                }
                _ => {}
            }
        }
        parts
    }

    /// Elements of all `count` segments, as the map says.
    pub(super) fn elements(&self, count: usize, stats: &MapStats) -> ByKind {
        let mut elements = ByKind { bodies: vec![None; count], lines: vec![None; count] };
        for (&number, &element) in self.bodies.iter().zip(&stats.elements) {
            elements.bodies[number] = Some(element);
        }
        for (&number, &element) in self.lines.iter().zip(&stats.lines) {
            elements.lines[number] = element;
        }
        elements
    }
}
