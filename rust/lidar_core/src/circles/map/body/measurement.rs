//! A body as one segment of one scan shows it.

use super::hull::Hull;
use super::look::Look;
use super::outline::OutlineMeasurement;
use crate::circles::map::circle_measurement::CircleMeasurement;
use crate::circles::map::view::earlier::Trace;
use serde::{Deserialize, Serialize};

/// Largest logarithm of the Bayes factor that earlier scans give.
const EVIDENCE: f64 = 1.5;
/// Traces that tell nothing, and that tell most.
const EVEN: f64 = 0.8;
pub(super) const STAYED: f64 = 0.95;
/// Share of the points of a measurement on earlier surfaces below which it is where space was free.
pub(super) const FREE: f64 = 0.5;

/// How many legs a measurement is put together of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(in crate::circles::map) enum Legs {
    /// One measurement, used as it is.
    None,
    /// A single leg of a known person.
    One,
    /// Two legs.
    Two,
}

/// A body as one segment of one scan shows it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::circles::map) struct BodyMeasurement {
    /// Circle of the body, or the circle that represents it.
    pub(in crate::circles::map) circle: CircleMeasurement,
    /// Circle that its rays may show, if its shape looks different.
    pub(in crate::circles::map) round: Option<CircleMeasurement>,
    /// Outline, if it is no circle.
    pub(in crate::circles::map) outline: Option<OutlineMeasurement>,
    /// Only one face was seen, which does not show its kind.
    pub(in crate::circles::map) is_face: bool,
    /// Time of the measurement [ns].
    pub(in crate::circles::map) time_ns: i64,
    /// Direction from the sensor to it, of length one.
    pub(in crate::circles::map) sight: [f64; 2],
    /// Place of the scanner, and its rays; None: unknown.
    pub(in crate::circles::map) look: Option<Look>,
    /// How far its points reach; None: unknown.
    pub(in crate::circles::map) hull: Option<Hull>,
    /// Share of its points where earlier scans met a surface, not free space; None: unknown.
    pub(in crate::circles::map) trace: Option<Trace>,
    /// Whether it is put together of the legs of a person.
    pub(in crate::circles::map) legs: Legs,
}

impl BodyMeasurement {
    /// True if all of it is where earlier scans met a surface.
    pub(super) fn has_stayed(&self) -> bool {
        self.trace.is_some_and(|trace| trace >= STAYED)
    }

    /// True if most of it is where earlier scans met free space.
    pub(super) fn is_in_free(&self) -> bool {
        self.trace.is_some_and(|trace| trace < FREE)
    }

    /// Logarithm of the Bayes factor for standing: what moves is where space was free.
    pub(super) fn evidence(&self) -> f64 {
        self.trace
            .map_or(0.0, |trace| EVIDENCE * ((trace - EVEN) / (STAYED - EVEN)).clamp(-1.0, 1.0))
    }
}
