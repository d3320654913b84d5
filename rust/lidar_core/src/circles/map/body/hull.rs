//! Extent of the points of an object in 16 directions.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::sync::LazyLock;

/// Number of directions. Between two of them the farthest point may be missed by 2 % of the extent.
const DIRECTIONS: usize = 16;
/// The directions as vectors of length one, computed only once.
static AXES: LazyLock<[[f64; 2]; DIRECTIONS]> = LazyLock::new(|| {
    std::array::from_fn(|number| {
        let angle = TAU * number as f64 / DIRECTIONS as f64;
        [libm::cos(angle), libm::sin(angle)]
    })
});

/// The points of one object in one scan that reach farthest in 16 directions all around.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::circles::map) struct Hull {
    /// Points of the hull in the world, seen from above [m].
    points: [[f64; 2]; DIRECTIONS],
    /// True if a nearer object hides one side of the object.
    is_covered: bool,
}

impl Hull {
    /// Hull of points in the world, seen from above [m]; None without points. `is_covered`: true if
    /// a nearer object hides a side of the object.
    pub(in crate::circles::map) fn of(points: &[[f64; 2]], is_covered: bool) -> Option<Self> {
        let (&first, others) = points.split_first()?;
        let start = Self { points: [first; DIRECTIONS], is_covered };
        Some(others.iter().fold(start, |hull, &point| hull.with([point; DIRECTIONS])))
    }

    /// Hull of this and of another part of the same object.
    pub(super) fn joined(self, other: &Self) -> Self {
        let both = Self { is_covered: self.is_covered || other.is_covered, ..self };
        both.with(other.points)
    }

    pub(super) fn is_covered(&self) -> bool {
        self.is_covered
    }

    /// Least and largest position along an axis of length one [m].
    pub(super) fn ends(&self, axis: [f64; 2]) -> [f64; 2] {
        let along = self.points.iter().map(|&point| along(axis, point));
        along.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], at| {
            [least.min(at), most.max(at)]
        })
    }

    fn with(mut self, others: [[f64; 2]; DIRECTIONS]) -> Self {
        for ((point, other), &axis) in self.points.iter_mut().zip(others).zip(AXES.iter()) {
            if along(axis, other) > along(axis, *point) {
                *point = other;
            }
        }
        self
    }
}

/// Position of a point along an axis of length one.
pub(super) fn along(axis: [f64; 2], point: [f64; 2]) -> f64 {
    axis[0] * point[0] + axis[1] * point[1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;

    #[test]
    fn it_reaches_as_far_as_its_points_and_those_of_its_parts() -> Result<(), Error> {
        let box_of = |x: f64| [[x, 0.0], [x + 0.4, 0.0], [x, 0.2], [x + 0.4, 0.2], [x + 0.1, 0.1]];
        let (one, two) = (Hull::of(&box_of(1.0), false), Hull::of(&box_of(1.3), true));
        let (one, two) = one.zip(two).ok_or(Error::NotPositiveDefinite { matrix: "none" })?;
        assert_eq!(one.ends([1.0, 0.0]), [1.0, 1.4]);
        assert_eq!(one.ends([0.0, 1.0]), [0.0, 0.2]);
        let both = one.joined(&two);
        assert_eq!(both.ends([1.0, 0.0]), [1.0, 1.3 + 0.4]);
        assert!(both.is_covered() && !one.is_covered());
        assert!(Hull::of(&[], false).is_none());
        Ok(())
    }
}
