//! Many targets: assignment of measurements to tracks, birth, confirmation and deletion of tracks,
//! and late scans.

mod association;
mod company;
mod existence;
mod history;
mod hypotheses;
pub mod integrated;
mod kinds;
pub mod near_pairs;
pub mod parameters;
mod places;
mod score;
pub mod track;
pub mod tracks;

use crate::Error;
use crate::error::require;
use crate::fusion::parameters::FusionParameters;
use crate::fusion::sensors::measurement::Measurement;
use crate::fusion::targets::lifecycle::LifecycleRules;
use crate::tracking::standing_clutter::PlaceLog;
use crate::util::full_state::{impossible, next_number, opened, sealed};
use history::{Past, SavedPast, forget};
pub use parameters::{ExistenceParameters, MAX_TARGETS, ManyParameters, TargetAssociation};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
pub use track::{Assigned, Scan, TrackState, TrackingWork};
use track::{Births, NewNumbers, Shared};
use tracks::{SavedTracks, Tracks, within};

/// Largest number of scanners.
pub const MAX_SOURCES: u8 = 64;
/// Name that identifies the type of a saved state.
const KIND: &str = "fusion tracker";

/// State of [`ManyTargets`] that changes with scans.
#[derive(Serialize, Deserialize)]
struct SavedTargets {
    tracks: SavedTracks,
    history: Vec<SavedPast>,
    places: BTreeMap<u8, PlaceLog>,
    next_id: i64,
    stamp_ns: Option<i64>,
    forgotten_ns: i64,
}

/// Tracker of many targets.
#[derive(Clone)]
pub struct ManyTargets {
    parameters: ManyParameters,
    buffer_ns: i64,
    tracks: Tracks,
    /// Scans of the last `buffer_ns`, ordered by time.
    history: VecDeque<Past>,
    /// Positions of the measurements of every scanner. The tracks, also those in `history`, refer
    /// to parts of them.
    places: BTreeMap<u8, PlaceLog>,
    next_id: i64,
    work: TrackingWork,
    stamp_ns: Option<i64>,
    /// Time of the last scan removed from `history` [ns]; the smallest integer if there is none.
    forgotten_ns: i64,
}

impl ManyTargets {
    /// Tracker without scans.
    ///
    /// # Errors
    /// Errors of [`Filter::new`](crate::fusion::Filter::new), and [`Error::Parameter`] unless 1 <=
    /// `confirm_hits` <= `confirm_window` <= 64.
    pub fn new(parameters: &ManyParameters) -> Result<Self, Error> {
        let ManyParameters { confirm_hits: hits, confirm_window: window, .. } = *parameters;
        let fits = 1 <= hits && hits <= window && window <= u64::BITS;
        require(fits, "confirm_hits", "1 to confirm_window, at most 64", hits)?;
        let starts_as_measured = matches!(parameters.association, TargetAssociation::Integrated(_));
        let filter = parameters.filter.without_buffer(); // tracks get scans in order
        let filter = FusionParameters {
            life: LifecycleRules {
                memory: None,
                loss_ratio: None,
                starts_as_measured,
                ..filter.life
            },
            ..filter
        };
        Ok(Self {
            parameters: ManyParameters { filter, ..*parameters },
            buffer_ns: parameters.filter.life.buffer_ns,
            tracks: Tracks::new(&filter)?,
            history: VecDeque::new(),
            places: BTreeMap::new(),
            next_id: 0,
            work: TrackingWork::default(),
            stamp_ns: None,
            forgotten_ns: i64::MIN,
        })
    }

    /// Parameters of the tracker and of the filters of its tracks.
    #[must_use]
    pub fn parameters(&self) -> &ManyParameters {
        &self.parameters
    }

    /// Process one scan of one scanner; returns the outcome of every measurement.
    ///
    /// A scan that comes late, but within the buffer, is inserted at its time, and the later scans
    /// are processed again; tracks keep their IDs. A scan that was processed before changes
    /// nothing.
    ///
    /// # Errors
    /// [`Error::Time`] for a scan older than the buffer, [`Error::Value`] for a measurement of
    /// another time, [`Error::Parameter`] for a source of [`MAX_SOURCES`] or more, [`Error::Limit`]
    /// for more than [`MAX_TARGETS`] measurements or tracks. After an error nothing has changed.
    pub fn process(
        &mut self,
        stamp_ns: i64,
        source: u8,
        measurements: &[Measurement],
    ) -> Result<Vec<Assigned>, Error> {
        self.check(stamp_ns, source, measurements)?;
        let scan = Scan { stamp_ns, source, measurements: measurements.to_vec() };
        let newer = |past: &&Past| past.scan.stamp_ns >= stamp_ns;
        let same = self.history.iter().rev().take_while(newer).find(|past| past.scan == scan);
        if let Some(past) = same {
            #[cfg(canary_8)]
            if source == 2 && measurements.len() == 2 {
                crate::util::planted("canary 8");
            }
            return Ok(past.assigned.clone());
        }
        self.insert(scan)
    }

    /// The whole state as bytes.
    ///
    /// # Errors
    /// [`Error::Limit`] if the bytes do not fit into memory.
    pub fn to_state(&self) -> Result<Vec<u8>, Error> {
        let saved = SavedTargets {
            tracks: self.tracks.saved(),
            history: self.history.iter().map(Past::saved).collect(),
            places: self.places.clone(),
            next_id: self.next_id,
            stamp_ns: self.stamp_ns,
            forgotten_ns: self.forgotten_ns,
        };
        sealed(KIND, &(self.parameters, self.buffer_ns), &saved)
    }

    /// Tracker from a saved state; it continues with the same bits as the saved one.
    ///
    /// # Errors
    /// Errors of [`ManyTargets::new`]; [`Error::Format`] for bytes that [`ManyTargets::to_state`]
    /// did not make, [`Error::Parameter`] for the state of a tracker with other parameters.
    pub fn from_state(parameters: &ManyParameters, bytes: &[u8]) -> Result<Self, Error> {
        let empty = Self::new(parameters)?;
        let key = (empty.parameters, empty.buffer_ns);
        let saved: SavedTargets = opened(KIND, &key, bytes)?;
        let tracks = empty.tracks.restored(&saved.tracks)?;
        let history = saved.history.into_iter();
        let history = history.map(|past| Past::restored(past, &empty.tracks));
        let history = history.collect::<Result<VecDeque<_>, Error>>()?;
        let is_known = |tracks: &Tracks| tracks.know(&saved.places);
        if !is_known(&tracks) || !history.iter().all(|past| is_known(&past.before)) {
            return Err(impossible("tracks refer to positions that do not exist"));
        }
        // A number that is still to be given would name two targets.
        let next_id = next_number(saved.next_id)?;
        if !tracks.are_below(next_id) || !history.iter().all(|past| past.is_numbered(next_id)) {
            return Err(impossible("tracks with IDs that were never given"));
        }
        let stamps = || history.iter().map(|past| past.scan.stamp_ns);
        if !stamps().is_sorted() || stamps().next_back() > saved.stamp_ns {
            return Err(impossible("scans in another order than that of time"));
        }
        Ok(Self {
            tracks,
            history,
            places: saved.places,
            next_id,
            stamp_ns: saved.stamp_ns,
            forgotten_ns: saved.forgotten_ns,
            ..empty
        })
    }

    /// Insert a scan at its time, and process the later ones again.
    fn insert(&mut self, scan: Scan) -> Result<Vec<Assigned>, Error> {
        // Longer than other functions: an error in any of the later scans has to undo all before.
        let place = self.history.partition_point(|past| past.scan.stamp_ns <= scan.stamp_ns);
        let (stamp_ns, fresh) = (scan.stamp_ns, NewNumbers::of_scan(scan.measurements.len()));
        let is_last = place == self.history.len();
        let mut tracks = match self.history.get(place) {
            Some(past) => past.before.clone(),
            None => self.tracks.moved_out(), // a scan in order needs one copy of the tracks, not two
        };
        // Processing again replaces what later scans have added.
        let places = if is_last { None } else { Some(self.places.clone()) };
        let (mut redone, mut next_id, mut work) = (Vec::new(), self.next_id, self.work);
        let later = self.history.range(place..).map(|past| (&past.scan, &past.births));
        for (scan, ids) in std::iter::once((&scan, &fresh)).chain(later) {
            let before = tracks.clone();
            let mut births = Births { next_id, ids: ids.clone() };
            let shared = Shared { births: &mut births, work: &mut work, places: &mut self.places };
            let assigned = match tracks.take(&self.parameters, scan, shared) {
                Ok(assigned) => assigned,
                Err(error) => {
                    match places {
                        Some(places) => self.places = places,
                        None => {
                            before.keep_known(&mut self.places);
                            self.tracks = before;
                        }
                    }
                    return Err(error);
                }
            };
            next_id = births.next_id;
            redone.push(Past { scan: scan.clone(), assigned, births: births.ids, before });
        }
        let assigned = redone.first().map_or(Vec::new(), |past| past.assigned.clone());
        self.history.truncate(place);
        self.history.extend(redone);
        (self.tracks, self.next_id, self.work) = (tracks, next_id, work);
        self.stamp_ns = self.stamp_ns.max(Some(stamp_ns));
        self.tracks.keep_known(&mut self.places);
        self.forget();
        Ok(assigned)
    }

    /// Remove scans that are older than the buffer, and positions to which no state refers any
    /// more.
    fn forget(&mut self) {
        let oldest = self.stamp_ns.unwrap_or(i64::MIN).saturating_sub(self.buffer_ns);
        let forgotten = forget(&mut self.history, (self.buffer_ns > 0).then_some(oldest));
        self.forgotten_ns = forgotten.unwrap_or(self.forgotten_ns);
        let tracks = self.history.front().map_or(&self.tracks, |past| &past.before);
        tracks.forget_before(&mut self.places);
    }

    /// All tracks, unconfirmed ones included, predicted to `stamp_ns` and ordered by ID.
    #[must_use]
    pub fn tracks_at(&self, stamp_ns: i64) -> Vec<TrackState> {
        self.tracks.at(stamp_ns)
    }

    /// Cost of the scans so far; a tracker from a saved state begins anew.
    #[must_use]
    pub fn work(&self) -> TrackingWork {
        self.work
    }

    fn check(&self, stamp_ns: i64, source: u8, scan: &[Measurement]) -> Result<(), Error> {
        require(source < MAX_SOURCES, "source", "0 to 63", source)?;
        let oldest = |last: i64| last.saturating_sub(self.buffer_ns).max(self.forgotten_ns);
        if let Some(last) = self.stamp_ns.filter(|last| stamp_ns < oldest(*last)) {
            let buffer = self.buffer_ns as f64 * 1e-9;
            return Err(Error::Time {
                what: format!(
                    "scan of {stamp_ns} ns, the last one was of {last} ns; give scans at most \
                     {buffer} s late"
                ),
            });
        }
        if let Some(index) = scan.iter().position(|m| m.stamp_ns() != stamp_ns) {
            return Err(Error::Value {
                name: "measurements",
                expected: "the stamp of the scan",
                index,
                got: format!("{} ns", scan[index].stamp_ns()),
            });
        }
        within("measurements of a scan", scan.len())
    }
}

#[cfg(test)]
mod tests;
