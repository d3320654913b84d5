//! The semantic map: circles with identities, radii, velocities and covariances.
//!
//! Source: Sanchez-Lopez et al., sec. V. Besides the joint filter of the paper there is one filter
//! per element. It uses the covariance of every circle, the view of the scan, and several modes of
//! motion: see [`Independent`].

mod arrivals;
mod belief;
mod body;
mod circle_measurement;
mod element;
mod element_motion;
mod history;
mod independent;
mod joint;
mod line;
mod modes;
mod parameters;
mod place;
mod rules;
mod scan;
mod view;

#[cfg(test)]
mod tests;

pub use body::outline::OutlineEstimate;
pub use parameters::{
    CircleMapParameters, ElementFilter, Independent, Joint, Limits, LineRules, MAX_ELEMENTS,
    MAX_MODES, MotionMode, Standing, VisibilityTest,
};
pub use scan::{CircleScan, PoseCovariance};
pub use view::visibility::{CircleVisibility, ScanWithLimits, SortedView};

use super::shape::ShapeKind;
use crate::Error;
use crate::estimation::kalman::Gaussian;
use crate::tracking::kind::{KINDS, TrackKind};
use crate::util::full_state::{impossible, next_number, opened, sealed};
use history::History;
use joint::JointMap;
use rules::Rules;
use scan::{KeptScan, ScanElements};
use serde::{Deserialize, Serialize};

/// Name that identifies the type of a saved state.
const KIND: &str = "circle map";

/// An element, predicted to a time.
#[derive(Clone, Debug, PartialEq)]
pub struct MapElement {
    /// ID of the element, never reused.
    pub id: i64,
    /// Centre x and y [m], its velocity [m/s], radius [m]: the order of eq. 9.
    pub state: Gaussian<5>,
    /// Time since its first measurement [s].
    pub age: f64,
    /// Time of its last measurement [ns].
    pub seen_ns: i64,
    /// Number of scans that measured it.
    pub n_measurements: u32,
    /// True if the newest scan of a sensor measured the element, or if it was in view and not
    /// hidden.
    pub visible: bool,
    /// True if the element is reported: it probably exists, and its position is known well enough.
    pub confirmed: bool,
    /// Probability that it is a person; 0 with the filter of the paper.
    pub person: f64,
    /// Probability that there is an object; 1 with the filter of the paper.
    pub existence: f64,
    /// Probabilities of the kinds of the object, if there is one.
    pub kinds: [f64; KINDS],
    /// The kind that is more probable than all others together; `Unknown` without such a kind.
    pub kind: TrackKind,
}

/// Map element with another shape than a circle, predicted to a time.
#[derive(Clone, Debug, PartialEq)]
pub struct MapShape {
    /// ID, never reused. An ellipse or rectangle that is not large has the same ID in the map of
    /// circles.
    pub id: i64,
    /// Kind of the shape.
    pub kind: ShapeKind,
    /// Centre x and y [m], velocity [m/s], bearing of the longer half length [rad], longer and
    /// shorter half length [m]. The covariance of a line contains only the bearing and the position
    /// across it.
    pub state: Gaussian<7>,
    /// Ends of a line [m]: seen from the first towards the second, the face is on the left. None
    /// for other shapes.
    pub ends: Option<[[f64; 2]; 2]>,
    /// Time since its first measurement [s].
    pub age: f64,
    /// Time of its last measurement [ns].
    pub seen_ns: i64,
    /// True if the newest scan of a sensor measured the element, or if it was in view and not
    /// hidden.
    pub visible: bool,
    /// True if the element is reported: it probably exists, and its position is known well enough.
    pub confirmed: bool,
}

/// Changes of the map by a scan, as IDs of elements.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapStats {
    /// True if the scan was older than the newest one.
    pub late: bool,
    /// True if the scanner moved although an earlier scan has the same pose: the source of the
    /// poses stopped.
    pub stuck_pose: bool,
    /// ID of the element of every circle of the scan; it may have been removed since.
    pub elements: Vec<i64>,
    /// ID of the element of every line of the scan; None for a line too short to start one.
    pub lines: Vec<Option<i64>>,
    /// IDs of new elements.
    pub born: Vec<i64>,
    /// IDs of elements that are reported from now on.
    pub confirmed: Vec<i64>,
    /// IDs of removed elements, including those merged into others.
    pub removed: Vec<i64>,
    /// Pairs of the ID that stays and the ID that was merged into it.
    pub merged: Vec<[i64; 2]>,
}

/// Result of an update that the list of elements does not show: whether the scan was late, the
/// elements of its objects, and which elements were merged.
struct MapOutcome {
    late: bool,
    found: ScanElements,
    merged: Vec<[i64; 2]>,
}

enum MapFilter {
    Paper(JointMap),
    Independent(Box<Rules>, History),
}

/// Map of circles in the world, updated by scans.
pub struct CircleMap {
    parameters: CircleMapParameters,
    engine: MapFilter,
    next_id: i64,
}

/// State of a [`CircleMap`] that changes with scans.
#[derive(Serialize)]
pub(super) struct CircleMapState<'a> {
    paper: Option<&'a joint::JointState>,
    independent: Option<&'a History>,
    next_id: i64,
}

/// [`CircleMapState`] as it is read back.
#[derive(Deserialize)]
pub(super) struct SavedCircleMap {
    paper: Option<joint::JointState>,
    independent: Option<History>,
    next_id: i64,
}

impl CircleMap {
    /// An empty map.
    ///
    /// # Errors
    /// [`Error::Parameter`] for values that cannot work.
    pub fn new(parameters: CircleMapParameters) -> Result<Self, Error> {
        let (gate, speed) = (parameters.gate()?, parameters.initial_speed);
        let engine = match parameters.filter.clone() {
            ElementFilter::Paper(joint) => MapFilter::Paper(JointMap::new(joint, gate, speed)),
            ElementFilter::Independent(independent) => {
                let rules = Rules::new(independent, parameters.gate_probability, speed)?;
                MapFilter::Independent(Box::new(rules), History::default())
            }
        };
        Ok(Self { parameters, engine, next_id: 0 })
    }

    /// The whole state as bytes.
    ///
    /// # Errors
    /// [`Error::Limit`] if the bytes do not fit into memory.
    pub fn to_state(&self) -> Result<Vec<u8>, Error> {
        sealed(KIND, &self.parameters, &self.state())
    }

    /// Map from a saved state; it continues with the same bits as the saved one.
    ///
    /// # Errors
    /// Errors of [`CircleMap::new`]; [`Error::Format`] for bytes that [`CircleMap::to_state`] did
    /// not make, [`Error::Parameter`] for the state of a map with other parameters.
    pub fn from_state(parameters: CircleMapParameters, bytes: &[u8]) -> Result<Self, Error> {
        let saved = opened(KIND, &parameters, bytes)?;
        let mut map = Self::new(parameters)?;
        map.restore(saved)?;
        Ok(map)
    }

    pub(super) fn state(&self) -> CircleMapState<'_> {
        let (paper, independent) = match &self.engine {
            MapFilter::Paper(joint) => (Some(joint.state()), None),
            MapFilter::Independent(_, history) => (None, Some(history)),
        };
        CircleMapState { paper, independent, next_id: self.next_id }
    }

    pub(super) fn restore(&mut self, saved: SavedCircleMap) -> Result<(), Error> {
        let next_id = next_number(saved.next_id)?;
        match (&mut self.engine, saved.paper, saved.independent) {
            (MapFilter::Paper(joint), Some(state), None) => joint.restore(state)?,
            (MapFilter::Independent(rules, history), None, Some(read)) if read.fits(rules) => {
                *history = read;
            }
            _ => return Err(impossible("parts of the map of circles contradict each other")),
        }
        self.next_id = next_id;
        Ok(())
    }

    /// Update the map with the circles of one scan, which may be empty.
    ///
    /// # Errors
    /// [`Error::Value`] for a pose, circle or covariance that cannot be used, [`Error::Time`] for a
    /// scan that was processed or comes too late, [`Error::Limit`] above [`MAX_ELEMENTS`]. After an
    /// error the map is unchanged.
    pub fn update(&mut self, scan: &CircleScan<'_>) -> Result<MapStats, Error> {
        let before = self.numbers();
        let mut stuck_pose = false;
        let outcome = match &mut self.engine {
            MapFilter::Paper(joint) => joint.update(scan, &mut self.next_id)?,
            MapFilter::Independent(rules, history) => {
                // Before the scan is transformed, which would be in vain for a refused stamp.
                history.is_late((scan.stamp_ns, scan.sensor))?;
                let mut kept = KeptScan::new(scan)?;
                stuck_pose = kept.compare(scan, &history.earlier);
                history.push(rules, kept, &mut self.next_id)?
            }
        };
        let after = self.numbers();
        let lacks = |list: &[(i64, bool)], id: i64| list.iter().all(|&(known, _)| known != id);
        let reported = |list: &[(i64, bool)], id: i64| list.contains(&(id, true));
        let confirmed = after.iter().filter(|&&(id, yes)| yes && !reported(&before, id));
        // From the difference of both lists: a late scan also changes what later scans created or
        // removed.
        Ok(MapStats {
            late: outcome.late,
            stuck_pose,
            elements: outcome.found.circles,
            lines: outcome.found.lines,
            merged: outcome.merged,
            born: after.iter().map(|&(id, _)| id).filter(|&id| lacks(&before, id)).collect(),
            confirmed: confirmed.map(|&(id, _)| id).collect(),
            removed: before.iter().map(|&(id, _)| id).filter(|&id| lacks(&after, id)).collect(),
        })
    }

    /// All elements, unconfirmed ones included, predicted to `stamp_ns`, ordered by ID. The map is
    /// not changed.
    #[must_use]
    pub fn map_at(&self, stamp_ns: i64) -> Vec<MapElement> {
        match &self.engine {
            MapFilter::Paper(joint) => joint.at(stamp_ns),
            MapFilter::Independent(rules, history) => history.now.at(rules, stamp_ns),
        }
    }

    /// Map elements with other shapes than circles, including unconfirmed ones, predicted to
    /// `stamp_ns` and ordered by ID; none with the filter of the paper. The map is not changed.
    #[must_use]
    pub fn shapes_at(&self, stamp_ns: i64) -> Vec<MapShape> {
        match &self.engine {
            MapFilter::Paper(_) => Vec::new(),
            MapFilter::Independent(rules, history) => history.now.shapes_at(rules, stamp_ns),
        }
    }

    /// True if all points [m], in the world, lie on one reported line of at least `length` [m].
    /// `std`: standard deviation of the ranges [m].
    #[must_use]
    pub fn is_on_line(&self, points: &[[f64; 2]], std: f64, length: f64) -> bool {
        match &self.engine {
            MapFilter::Paper(_) => false,
            MapFilter::Independent(rules, history) => {
                history.now.is_on_line(rules, points, std, length)
            }
        }
    }

    /// Check if a scan with this stamp can be processed.
    ///
    /// # Errors
    /// [`Error::Time`] for the stamps that [`CircleMap::update`] refuses.
    pub fn check_stamp(&self, stamp_ns: i64, sensor: u32) -> Result<(), Error> {
        match &self.engine {
            MapFilter::Paper(joint) => joint.check_stamp((stamp_ns, sensor)),
            MapFilter::Independent(_, history) => history.is_late((stamp_ns, sensor)).map(drop),
        }
    }

    /// Remove all elements and scans. IDs are not used again.
    pub fn reset(&mut self) {
        match &mut self.engine {
            MapFilter::Paper(joint) => joint.reset(),
            MapFilter::Independent(_, history) => *history = History::default(),
        }
    }

    /// IDs of all elements, each with true if it is reported.
    fn numbers(&self) -> Vec<(i64, bool)> {
        match &self.engine {
            MapFilter::Paper(joint) => joint.numbers().map(|id| (id, true)).collect(),
            MapFilter::Independent(_, history) => history.now.numbers().collect(),
        }
    }
}

/// Time from one stamp to another [s].
fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    // Subtracted as integers: stamps as floats would lose their nanoseconds, and the difference of
    // two may exceed 64 bits.
    (i128::from(to_ns) - i128::from(from_ns)) as f64 * 1e-9
}
