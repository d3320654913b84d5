//! The semantic map: circles with identities, radii, velocities and covariances.
//!
//! Source: Sanchez-Lopez et al., sec. V. Beside the joint filter of the paper there is a filter
//! per element, which is told how certain every circle is, what the scan could see, and how
//! objects move: see [`Independent`].

mod body;
mod covariance;
mod element;
mod history;
mod independent;
mod joint;
mod level_pose;
mod line;
mod modes;
mod outline;
mod parameters;
mod rules;
mod scan;
mod viewpoint;
mod visibility;

#[cfg(test)]
mod tests;

pub use modes::MAX_MODES;
pub use outline::OutlineEstimate;
pub use parameters::{
    CircleMapParameters, Confirmation, Filter, Independent, Joint, Limits, LineRules, Looking,
    MAX_ELEMENTS, MAX_WINDOW, Mode, Patience,
};
pub use scan::{CircleScan, PoseCovariance};
pub use visibility::{SortedView, View, Visibility};

use super::shape::ShapeKind;
use crate::Error;
use crate::estimation::kalman::Gaussian;
use crate::util::full_state::{impossible, opened, sealed};
use history::History;
use joint::JointMap;
use rules::Rules;
use scan::{Found, Placed};
use serde::{Deserialize, Serialize};

const KIND: &str = "circle map";

/// An element, predicted to one time.
#[derive(Clone, Debug, PartialEq)]
pub struct MapElement {
    /// Number, never reused.
    pub id: i64,
    /// Centre x and y [m], its velocity [m/s], radius [m]: the order of eq. 9.
    pub state: Gaussian<5>,
    /// Time since its first measurement [s].
    pub age: f64,
    /// Time of its last measurement [ns].
    pub seen_ns: i64,
    /// Scans that measured it.
    pub n_measurements: u32,
    /// A sensor's newest scan measured it, or should have.
    pub visible: bool,
    /// Enough scans speak for it.
    pub confirmed: bool,
}

/// An element that is no circle, predicted to one time.
#[derive(Clone, Debug, PartialEq)]
pub struct MapShape {
    /// Number, never reused; an ellipse or rectangle that is not large has it in the map of circles,
    /// too.
    pub id: i64,
    /// What it is.
    pub kind: ShapeKind,
    /// Centre x and y [m], its velocity [m/s], bearing of the longer half length [rad], longer and
    /// shorter half length [m]. Of a line the covariance knows what lies across it, and the bearing.
    pub state: Gaussian<7>,
    /// Ends of a line [m]: on the way from one to the other its face is on the left.
    pub ends: Option<[[f64; 2]; 2]>,
    /// Time since its first measurement [s].
    pub age: f64,
    /// Time of its last measurement [ns].
    pub seen_ns: i64,
    /// A sensor's newest scan measured it, or should have.
    pub visible: bool,
    /// Enough scans speak for it.
    pub confirmed: bool,
}

/// What a scan did to the map, by the numbers of the elements.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapStats {
    /// The scan was older than the newest one.
    pub late: bool,
    /// Element of every circle of the scan, which may have been removed since.
    pub elements: Vec<i64>,
    /// Element of every line of the scan; None for one that is too short to be new.
    pub lines: Vec<Option<i64>>,
    /// New.
    pub born: Vec<i64>,
    /// Reported from now on.
    pub confirmed: Vec<i64>,
    /// No more; also those that went into others.
    pub removed: Vec<i64>,
    /// Pairs: the element that stays and the one that went into it.
    pub merged: Vec<[i64; 2]>,
}

/// What a scan did that the elements do not show.
struct Outcome {
    late: bool,
    found: Found,
    merged: Vec<[i64; 2]>,
}

enum Engine {
    Paper(JointMap),
    Independent(Box<Rules>, History),
}

/// A map of circles in the world, fed by scans.
pub struct CircleMap {
    parameters: CircleMapParameters,
    engine: Engine,
    next_id: i64,
}

/// Everything about a [`CircleMap`] that changes with scans.
#[derive(Serialize)]
pub(super) struct MapState<'a> {
    paper: Option<&'a joint::State>,
    independent: Option<&'a History>,
    next_id: i64,
}

/// [`MapState`], read.
#[derive(Deserialize)]
pub(super) struct SavedMap {
    paper: Option<joint::State>,
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
            Filter::Paper(joint) => Engine::Paper(JointMap::new(joint, gate, speed)),
            Filter::Independent(independent) => {
                let rules = Rules::new(independent, parameters.gate_probability, speed)?;
                Engine::Independent(Box::new(rules), History::default())
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

    /// A map that goes on, to the same bits, where the one went whose state was saved.
    ///
    /// # Errors
    /// As [`CircleMap::new`]; [`Error::Format`] for bytes that [`CircleMap::to_state`] did not
    /// make, [`Error::Parameter`] for those of a map with other parameters.
    pub fn from_state(parameters: CircleMapParameters, bytes: &[u8]) -> Result<Self, Error> {
        let saved = opened(KIND, &parameters, bytes)?;
        let mut map = Self::new(parameters)?;
        map.restore(saved)?;
        Ok(map)
    }

    pub(super) fn state(&self) -> MapState<'_> {
        let (paper, independent) = match &self.engine {
            Engine::Paper(joint) => (Some(joint.state()), None),
            Engine::Independent(_, history) => (None, Some(history)),
        };
        MapState { paper, independent, next_id: self.next_id }
    }

    pub(super) fn restore(&mut self, saved: SavedMap) -> Result<(), Error> {
        match (&mut self.engine, saved.paper, saved.independent) {
            (Engine::Paper(joint), Some(state), None) => joint.restore(state)?,
            (Engine::Independent(rules, history), None, Some(read)) if read.fits(rules) => {
                *history = read;
            }
            _ => return Err(impossible("a map of circles whose parts do not agree")),
        }
        self.next_id = saved.next_id;
        Ok(())
    }

    /// Take in the circles of one scan, an empty set included.
    ///
    /// # Errors
    /// [`Error::Value`] for a pose, circle or covariance that cannot be used, [`Error::Time`] for
    /// a scan that was processed or comes too late, [`Error::Limit`] above [`MAX_ELEMENTS`]. The
    /// map is unchanged then.
    pub fn update(&mut self, scan: &CircleScan<'_>) -> Result<MapStats, Error> {
        let before = self.numbers();
        let outcome = match &mut self.engine {
            Engine::Paper(joint) => joint.update(scan, &mut self.next_id)?,
            Engine::Independent(rules, history) => {
                history.is_late((scan.stamp_ns, scan.sensor))?;
                history.push(rules, Placed::new(scan)?, &mut self.next_id)?
            }
        };
        let after = self.numbers();
        let lacks = |list: &[(i64, bool)], id: i64| list.iter().all(|&(known, _)| known != id);
        let reported = |list: &[(i64, bool)], id: i64| list.contains(&(id, true));
        let confirmed = after.iter().filter(|&&(id, yes)| yes && !reported(&before, id));
        Ok(MapStats {
            late: outcome.late,
            elements: outcome.found.circles,
            lines: outcome.found.lines,
            merged: outcome.merged,
            born: after.iter().map(|&(id, _)| id).filter(|&id| lacks(&before, id)).collect(),
            confirmed: confirmed.map(|&(id, _)| id).collect(),
            removed: before.iter().map(|&(id, _)| id).filter(|&id| lacks(&after, id)).collect(),
        })
    }

    /// Every element, unconfirmed ones included, predicted to `stamp_ns`, by number. Changes
    /// nothing, so that it does not matter how often it is asked.
    #[must_use]
    pub fn map_at(&self, stamp_ns: i64) -> Vec<MapElement> {
        match &self.engine {
            Engine::Paper(joint) => joint.at(stamp_ns),
            Engine::Independent(rules, history) => history.now.at(rules, stamp_ns),
        }
    }

    /// Every element that is no circle, unconfirmed ones included, predicted to `stamp_ns`, by
    /// number; none with the filter of the paper. Changes nothing.
    #[must_use]
    pub fn shapes_at(&self, stamp_ns: i64) -> Vec<MapShape> {
        match &self.engine {
            Engine::Paper(_) => Vec::new(),
            Engine::Independent(rules, history) => history.now.shapes_at(rules, stamp_ns),
        }
    }

    /// Whether points of the world all lie on a reported line of at least `length` [m], as ranges of
    /// deviation `std` [m] would.
    #[must_use]
    pub fn is_on_line(&self, points: &[[f64; 2]], std: f64, length: f64) -> bool {
        match &self.engine {
            Engine::Paper(_) => false,
            Engine::Independent(rules, history) => {
                history.now.is_on_line(rules, points, std, length)
            }
        }
    }

    /// Whether a scan would come at a time that can be used.
    ///
    /// # Errors
    /// [`Error::Time`] as [`CircleMap::update`].
    pub fn check_stamp(&self, stamp_ns: i64, sensor: u32) -> Result<(), Error> {
        match &self.engine {
            Engine::Paper(joint) => joint.check_stamp((stamp_ns, sensor)),
            Engine::Independent(_, history) => history.is_late((stamp_ns, sensor)).map(drop),
        }
    }

    /// Forget all elements and scans. Numbers go on where they were.
    pub fn reset(&mut self) {
        match &mut self.engine {
            Engine::Paper(joint) => joint.reset(),
            Engine::Independent(_, history) => *history = History::default(),
        }
    }

    /// Numbers of all elements, and whether they are reported.
    fn numbers(&self) -> Vec<(i64, bool)> {
        match &self.engine {
            Engine::Paper(joint) => joint.numbers().map(|id| (id, true)).collect(),
            Engine::Independent(_, history) => history.now.numbers().collect(),
        }
    }
}

/// Time from one stamp to another [s].
fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    (i128::from(to_ns) - i128::from(from_ns)) as f64 * 1e-9
}
