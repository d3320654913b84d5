//! Selection of segments for the map of circles: round objects, and small ones that are nearly
//! round.

use super::fit::circle::{Circle, CircleEstimate};
use super::frame::PreparedSweep;
use super::map::OutlineEstimate;
use super::segment::segments::Side;
use super::shape::{ShapeEstimate, ShapeKind};
use crate::Error;
use crate::error::require_positive;
use nalgebra::{Matrix3, Matrix5};

/// Standard deviations by which a mean square of noise may exceed its expectation by chance.
const CHANCE: f64 = 2.0;

/// Rules for segments that are not circles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeParameters {
    /// Largest half length of a line that is used as a circle, and of every object that is reported
    /// as a circle [m].
    pub max_size: f64,
    /// Standard deviation of real outlines from their ideal shape [m].
    pub model_std: f64,
    /// Least number of rays of a circle that a nearer object may hide in part. A circle with fewer
    /// rays is used only if its other end is free. Other shapes always need a free end there.
    pub min_hits: usize,
}

/// Shape rules of the best mode.
impl Default for ShapeParameters {
    fn default() -> Self {
        Self { max_size: 0.5, model_std: 0.03, min_hits: 6 }
    }
}

impl ShapeParameters {
    /// Check the ranges of the parameters.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a parameter outside its range.
    pub(super) fn check(&self) -> Result<(), Error> {
        require_positive("max_size", self.max_size)?;
        require_positive("model_std", self.model_std)
    }

    /// Circle that represents a line with free space on both sides. Its middle lies behind the
    /// line. None if the line is too long for a body.
    fn behind(&self, shape: &ShapeEstimate) -> Option<CircleEstimate> {
        let [start, end] = shape.ends()?;
        let half = 0.5 * libm::hypot(end[0] - start[0], end[1] - start[1]);
        let depth = 0.5 * half; // nobody knows: between none and its length
        let normal = [libm::cos(shape.parameters[0]), libm::sin(shape.parameters[0])];
        let spread = depth * depth + self.model_std * self.model_std;
        let mut covariance = [[0.0; 3]; 3];
        for (axis, row) in covariance.iter_mut().enumerate() {
            row[axis] = spread;
        }
        (half > 0.0 && half <= self.max_size).then_some(CircleEstimate {
            circle: Circle {
                center: [0, 1].map(|i| 0.5 * (start[i] + end[i]) + depth * normal[i]),
                radius: half,
            },
            covariance,
            n_hits: shape.n_hits,
            is_fallback: false,
        })
    }

    /// Outline of a shape that the map represents by a circle; None for a circle, or if the outline
    /// is not known.
    pub(super) fn outline(&self, shape: &ShapeEstimate) -> Option<OutlineEstimate> {
        if shape.kind == ShapeKind::Line {
            return Some(OutlineEstimate { shape: *shape, is_large: false, round: None });
        }
        let longest = shape.kind.half_length()? * shape.parameters[2];
        let covariance = Matrix5::from_fn(|row, column| shape.covariance[row][column]);
        let is_known = covariance.cholesky().is_some() && shape.parameters[3] > 0.0;
        let is_large = longest > self.max_size;
        is_known.then_some(OutlineEstimate { shape: *shape, is_large, round: None })
    }

    /// Circle that represents an ellipse or rectangle, with the mean half length as radius. None
    /// for a line, or without a usable radius and covariance.
    fn equivalent(&self, shape: &ShapeEstimate) -> Option<CircleEstimate> {
        let [x, y, long, short, _] = shape.parameters;
        let scale = shape.kind.half_length().unwrap_or(1.0);
        let radius = 0.5 * scale * (long + short);
        // The depth of a line is unknown: see `behind`.
        let is_usable = shape.kind != ShapeKind::Line && radius > 0.0;
        let slope = 0.5 * scale;
        let c = &shape.covariance;
        let with_radius = |i: usize| slope * (c[i][2] + c[i][3]);
        let of_radius = slope * (with_radius(2) + with_radius(3));
        let spread = self.model_std * self.model_std;
        let covariance = [
            [c[0][0] + spread, c[0][1], with_radius(0)],
            [c[0][1], c[1][1] + spread, with_radius(1)],
            [with_radius(0), with_radius(1), of_radius + spread],
        ];
        let is_finite = covariance.iter().flatten().all(|value| value.is_finite());
        (is_usable && is_finite).then_some(CircleEstimate {
            circle: Circle { center: [x, y], radius },
            covariance,
            n_hits: shape.n_hits,
            is_fallback: false,
        })
    }
}

/// Use of a segment in the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum MapUse {
    /// A round object, or a small and nearly round one.
    Body(CircleEstimate),
    /// A line.
    Line,
    /// The segment is not used.
    Nothing,
}

/// Use of segment `number` in the map; none if its hits do not lie on its circle or other shape. A
/// circle is used as estimated, another shape as the circle of its mean half length.
pub(super) fn part(
    prepared: &PreparedSweep,
    number: usize,
    circle: &CircleEstimate,
    shape: Option<(&ShapeEstimate, &ShapeParameters)>,
    [range_std, max_deviation]: [f64; 2],
) -> MapUse {
    let round = || round(prepared, number, circle, max_deviation);
    let Some((shape, parameters)) = shape else { return MapUse::of(round()) };
    let off = range_std * (shape.misfit / shape.n_hits as f64).sqrt();
    let sides = prepared.segments.sides[number];
    match shape.kind {
        ShapeKind::Circle if is_piece(sides) && shape.n_hits < parameters.min_hits => {
            MapUse::Nothing
        }
        ShapeKind::Circle => MapUse::of(round().filter(is_certain)),
        _ if off > max_deviation => MapUse::Nothing,
        ShapeKind::Line => {
            let is_face = sides == [Side::Free; 2];
            parameters.behind(shape).filter(|_| is_face).map_or(MapUse::Line, MapUse::Body)
        }
        _ if is_piece(sides) => MapUse::Nothing,
        ShapeKind::Ellipse | ShapeKind::Rectangle => MapUse::of(parameters.equivalent(shape)),
    }
}

/// Circle of a segment; None if its hits do not lie on it.
fn round(
    prepared: &PreparedSweep,
    number: usize,
    circle: &CircleEstimate,
    max_deviation: f64,
) -> Option<CircleEstimate> {
    Some(*circle).filter(|_| deviation(prepared, number, circle) <= max_deviation)
}

/// Variance of the distances of `count` hits from a circle that noise does not explain [m^2]; 0 if
/// it may be chance. `deviation` is their root mean square distance [m].
fn departure(deviation: f64, range_std: f64, count: usize) -> f64 {
    let by_chance = 1.0 + CHANCE * (2.0 / count as f64).sqrt();
    (deviation * deviation - range_std * range_std * by_chance).max(0.0)
}

/// Circle of a segment that looks like another shape; None if its hits do not lie on it, or if its
/// covariance is not positive definite. The variance of the hits that noise does not explain is
/// added to that of the centre: a circle that looks like another shape by chance is known as well
/// as ever.
pub(super) fn doubted(
    prepared: &PreparedSweep,
    number: usize,
    circle: &CircleEstimate,
    [range_std, max_deviation]: [f64; 2],
) -> Option<CircleEstimate> {
    let found = deviation(prepared, number, circle);
    let excess = departure(found, range_std, prepared.segments.rays_of(number).len());
    let mut circle = *circle;
    for (axis, row) in circle.covariance.iter_mut().enumerate().take(2) {
        row[axis] += excess;
    }
    (found <= max_deviation && is_certain(&circle)).then_some(circle)
}

impl MapUse {
    fn of(body: Option<CircleEstimate>) -> Self {
        body.map_or(Self::Nothing, Self::Body)
    }
}

/// True if the rays may show only a part of an object: something nearer hides one side, and the
/// other side is not free.
pub(super) fn is_piece(sides: [Side; 2]) -> bool {
    sides.contains(&Side::Occluded) && !sides.contains(&Side::Free)
}

/// True if the covariance is positive definite; that of a circle fitted to a wall may be singular.
pub(super) fn is_certain(estimate: &CircleEstimate) -> bool {
    Matrix3::from_fn(|i, j| estimate.covariance[i][j]).cholesky().is_some()
}

/// Root mean square distance of the hits of a segment from a circle [m].
fn deviation(prepared: &PreparedSweep, number: usize, estimate: &CircleEstimate) -> f64 {
    let rays = prepared.segments.rays_of(number);
    let [x, y] = estimate.circle.center;
    let square: f64 = rays
        .iter()
        .filter_map(|&ray| prepared.level.scan.point(ray as usize))
        .map(|point| {
            let distance = libm::hypot(point[0] - x, point[1] - y) - estimate.circle.radius;
            distance * distance
        })
        .sum();
    (square / rays.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: ShapeParameters = ShapeParameters { max_size: 0.5, model_std: 0.02, min_hits: 6 };

    fn shape(kind: ShapeKind, long: f64, short: f64) -> ShapeEstimate {
        let mut covariance = [[0.0; 5]; 5];
        for (axis, row) in covariance.iter_mut().enumerate() {
            row[axis] = 1e-4 * (axis + 1) as f64;
        }
        let parameters = [3.0, 1.0, long, short, 0.4];
        ShapeEstimate { kind, parameters, covariance, misfit: 10.0, n_hits: 10 }
    }

    #[test]
    fn the_circle_has_the_mean_half_length_and_its_variance() {
        for (kind, scale) in [(ShapeKind::Ellipse, 1.0), (ShapeKind::Rectangle, 0.5)] {
            let found = RULES.equivalent(&shape(kind, 0.4, 0.1));
            let expected = 0.25 * scale * scale * (3e-4 + 4e-4) + 4e-4;
            assert!(found.is_some_and(|found| {
                (found.circle.radius - 0.25 * scale).abs() < 1e-12
                    && (found.covariance[2][2] - expected).abs() < 1e-12
            }));
        }
    }

    #[test]
    fn what_is_straight_stays_out_and_what_is_large_is_told() {
        let large = |long| RULES.outline(&shape(ShapeKind::Ellipse, long, 0.1));
        assert!(large(0.6).is_some_and(|outline| outline.is_large));
        assert!(large(0.4).is_some_and(|outline| !outline.is_large));
        assert!(RULES.equivalent(&shape(ShapeKind::Line, 0.4, 0.1)).is_none());
        assert!(RULES.equivalent(&shape(ShapeKind::Ellipse, 0.0, 0.0)).is_none());
        assert!(ShapeParameters { max_size: 0.0, ..RULES }.check().is_err());
    }

    #[test]
    fn a_short_face_has_its_middle_behind_it() {
        let mut face = shape(ShapeKind::Line, 0.0, 0.0);
        face.parameters = [0.0, 2.0, -0.2, 0.2, 0.0];
        let found = RULES.behind(&face);
        assert!(found.is_some_and(|found| {
            let [x, y] = found.circle.center;
            (x - 2.1).abs() < 1e-12 && y.abs() < 1e-12 && (found.circle.radius - 0.2).abs() < 1e-12
        }));
        face.parameters[3] = 2.0;
        assert!(RULES.behind(&face).is_none());
    }

    #[test]
    fn what_departs_from_its_circle_by_chance_is_known_and_what_does_so_clearly_is_not() {
        assert_eq!(departure(0.012, 0.01, 9), 0.0);
        assert!(departure(0.03, 0.01, 20) > 7e-4);
        // More hits tell more: the same deviation is no chance then.
        assert!(departure(0.012, 0.01, 200) > 0.0);
    }

    #[test]
    fn what_nothing_free_is_beside_is_a_piece() {
        use Side::{FieldEdge, Free, Occluded, RangeCut};
        assert!(is_piece([RangeCut, Occluded]) && is_piece([Occluded, FieldEdge]));
        assert!(!is_piece([Free, Occluded]) && !is_piece([RangeCut; 2]));
    }
}
