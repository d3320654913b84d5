//! A body as one segment of one scan shows it.

use super::hull::Hull;
use super::look::Look;
use super::outline::OutlineMeasurement;
use crate::circles::map::circle_measurement::CircleMeasurement;
use crate::circles::map::view::earlier::Trace;
use serde::{Deserialize, Serialize};

/// Largest logarithm of the Bayes factor for standing that the traces of earlier scans give.
const EVIDENCE: f64 = 1.5;
/// Trace (share of points on earlier surfaces) that is no evidence for standing or moving.
const EVEN: f64 = 0.8;
/// Trace from which on a measurement shows that the body has not moved.
pub(super) const STAYED: f64 = 0.95;
/// Share of the points of a measurement on earlier surfaces, below which its place counts as free
/// before.
pub(super) const FREE: f64 = 0.5;

/// Legs from which a measurement was merged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(in crate::circles::map) enum Legs {
    /// No legs: one measurement, used as it is.
    None,
    /// A single leg of a known person.
    One,
    /// Two legs of a person.
    Two,
}

/// A body as one segment of one scan shows it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::circles::map) struct BodyMeasurement {
    /// Circle of the body, or the circle that represents it.
    pub(in crate::circles::map) circle: CircleMeasurement,
    /// Circle that the rays may show if the segment looks like another shape; None otherwise.
    pub(in crate::circles::map) round: Option<CircleMeasurement>,
    /// Ellipse or rectangle that the segment shows; None if it is a circle.
    pub(in crate::circles::map) outline: Option<OutlineMeasurement>,
    /// True if only one face was seen, which does not show the kind of the body.
    pub(in crate::circles::map) is_face: bool,
    /// Time of the measurement [ns].
    pub(in crate::circles::map) time_ns: i64,
    /// Direction from the sensor to the body in the world, of length one.
    pub(in crate::circles::map) sight: [f64; 2],
    /// Place of the scanner and spacing of its rays in this scan; None: unknown.
    pub(in crate::circles::map) look: Option<Look>,
    /// Points of the body that reach farthest; None: unknown.
    pub(in crate::circles::map) hull: Option<Hull>,
    /// Share of its points at which earlier scans saw a surface and not free space; None: unknown.
    pub(in crate::circles::map) trace: Option<Trace>,
    /// Legs of a person from which it was merged.
    pub(in crate::circles::map) legs: Legs,
}

impl BodyMeasurement {
    /// True if nearly all of its points are where earlier scans saw a surface.
    pub(super) fn has_stayed(&self) -> bool {
        self.trace.is_some_and(|trace| trace >= STAYED)
    }

    /// True if most of its points are where earlier scans saw free space.
    pub(super) fn is_in_free(&self) -> bool {
        self.trace.is_some_and(|trace| trace < FREE)
    }

    /// Logarithm of the Bayes factor for standing, from the trace: a moving body is at a place that
    /// was free. 0 if the trace is unknown.
    pub(super) fn evidence(&self) -> f64 {
        self.trace
            .map_or(0.0, |trace| EVIDENCE * ((trace - EVEN) / (STAYED - EVEN)).clamp(-1.0, 1.0))
    }
}
