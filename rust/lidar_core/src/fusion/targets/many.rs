//! Many targets: assignment of measurements to tracks, birth, confirmation and deletion of tracks,
//! and late scans.

use super::lifecycle::LifecycleRules;
pub use super::many_parameters::{
    ExistenceParameters, MAX_TARGETS, ManyParameters, TargetAssociation,
};
pub use super::track::{Assigned, Scan, TrackState, TrackingWork};
use super::track::{Births, NewNumbers};
use super::tracks::{SavedTracks, Tracks, within};
use crate::Error;
use crate::error::require;
use crate::fusion::parameters::FusionParameters;
use crate::fusion::sensors::measurement::Measurement;
use crate::util::full_state::{impossible, opened, sealed};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Largest number of scanners.
pub const MAX_SOURCES: u8 = 64;
/// Largest number of scans, and of tracks in them, kept for late scans.
const MOST_KEPT: usize = 100_000;
const KIND: &str = "fusion tracker";

/// A processed scan.
#[derive(Clone)]
struct Past {
    scan: Scan,
    assigned: Vec<Assigned>,
    births: NewNumbers,
    before: Tracks,
}

/// Saved form of [`Past`].
#[derive(Serialize, Deserialize)]
struct SavedPast {
    scan: Scan,
    assigned: Vec<Assigned>,
    births: NewNumbers,
    before: SavedTracks,
}

/// State of [`ManyTargets`] that changes with scans.
#[derive(Serialize, Deserialize)]
struct SavedTargets {
    tracks: SavedTracks,
    history: Vec<SavedPast>,
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
    next_id: i64,
    work: TrackingWork,
    stamp_ns: Option<i64>,
    /// Time of the last scan dropped from `history`, or before all [ns].
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
    /// are processed again; tracks keep their numbers. A scan that was processed before changes
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
        let past = |past: &Past| SavedPast {
            scan: past.scan.clone(),
            assigned: past.assigned.clone(),
            births: past.births.clone(),
            before: past.before.saved(),
        };
        let saved = SavedTargets {
            tracks: self.tracks.saved(),
            history: self.history.iter().map(past).collect(),
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
        let past = |past: SavedPast| {
            if past.births.of_column.len() != past.scan.measurements.len() {
                return Err(impossible("births and measurements differ in number"));
            }
            let before = empty.tracks.restored(&past.before)?;
            Ok(Past { scan: past.scan, assigned: past.assigned, births: past.births, before })
        };
        Ok(Self {
            tracks: empty.tracks.restored(&saved.tracks)?,
            history: saved.history.into_iter().map(past).collect::<Result<_, Error>>()?,
            next_id: saved.next_id,
            stamp_ns: saved.stamp_ns,
            forgotten_ns: saved.forgotten_ns,
            ..empty
        })
    }

    /// Insert a scan at its time, and process the later ones again.
    fn insert(&mut self, scan: Scan) -> Result<Vec<Assigned>, Error> {
        let place = self.history.partition_point(|past| past.scan.stamp_ns <= scan.stamp_ns);
        let (stamp_ns, fresh) = (scan.stamp_ns, NewNumbers::of_scan(scan.measurements.len()));
        let is_last = place == self.history.len();
        let mut tracks = match self.history.get(place) {
            Some(past) => past.before.clone(),
            None => self.tracks.moved_out(), // a scan in order needs one copy of the tracks, not two
        };
        let (mut redone, mut next_id, mut work) = (Vec::new(), self.next_id, self.work);
        let later = self.history.range(place..).map(|past| (&past.scan, &past.births));
        for (scan, ids) in std::iter::once((&scan, &fresh)).chain(later) {
            let before = tracks.clone();
            let mut births = Births { next_id, ids: ids.clone() };
            let assigned = match tracks.take(&self.parameters, scan, &mut births, &mut work) {
                Ok(assigned) => assigned,
                Err(error) => {
                    if is_last {
                        self.tracks = before;
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
        self.forget();
        Ok(assigned)
    }

    /// Drop scans that are older than the buffer, and the oldest if there are too many.
    fn forget(&mut self) {
        let oldest = self.stamp_ns.unwrap_or(i64::MIN).saturating_sub(self.buffer_ns);
        let mut kept: usize = self.history.iter().map(|past| 1 + past.before.len()).sum();
        let is_old = |past: &Past| self.buffer_ns == 0 || past.scan.stamp_ns < oldest;
        while let Some(past) = self.history.front().filter(|past| kept > MOST_KEPT || is_old(past))
        {
            kept -= 1 + past.before.len();
            self.forgotten_ns = past.scan.stamp_ns;
            self.history.pop_front();
        }
    }

    /// All tracks, unconfirmed ones included, predicted to `stamp_ns` and ordered by number.
    #[must_use]
    pub fn tracks_at(&self, stamp_ns: i64) -> Vec<TrackState> {
        self.tracks.at(stamp_ns)
    }

    /// What the scans have cost so far; a tracker from a saved state begins anew.
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
mod tests {
    use super::*;
    use crate::fusion::model::Model;
    use crate::fusion::parameters::Strengths;
    use crate::fusion::sensors::measurement::Sensor;
    use crate::fusion::sensors::sensing::Sensing;

    fn parameters() -> Result<ManyParameters, Error> {
        let filter = FusionParameters {
            model: Model::ConstantVelocity,
            strengths: Strengths { acceleration: 0.5, start: 1.0, ..Strengths::default() },
            sensing: Sensing { lidar: [0.1; 3], radar: [0.1; 4], ..Sensing::default() },
            life: LifecycleRules {
                start_rows: 1,
                gate: LifecycleRules::gates(Some(0.99))?,
                loss_ratio: None,
                buffer_ns: 0,
                ..LifecycleRules::default()
            },
            ..FusionParameters::default()
        };
        Ok(ManyParameters {
            filter,
            confirm_hits: 2,
            confirm_window: 3,
            max_position_std: 20.0,
            association: TargetAssociation::Nearest,
            ..ManyParameters::default()
        })
    }

    fn scan(stamp_ns: i64, places: &[[f64; 2]]) -> Result<Vec<Measurement>, Error> {
        places.iter().map(|at| Measurement::new(stamp_ns, Sensor::Lidar, at, None)).collect()
    }

    fn numbers(assigned: &[Assigned]) -> Vec<Option<i64>> {
        assigned.iter().map(|one| one.id).collect()
    }

    /// Two targets that part, two scanners in turn, 50 ms from scan to scan.
    fn parting() -> Result<Vec<(i64, u8, Vec<Measurement>)>, Error> {
        let one = |k: i64| {
            let (stamp, y) = (k * 50_000_000, 0.1 * k as f64);
            Ok((stamp, (k % 2) as u8, scan(stamp, &[[0.2 * y, y], [3.0, -y]])?))
        };
        (0..12).map(one).collect()
    }

    fn buffered(seconds: f64) -> Result<ManyTargets, Error> {
        let mut parameters = parameters()?;
        parameters.filter.life.buffer_ns = (seconds * 1e9) as i64;
        ManyTargets::new(&parameters)
    }

    /// Also of scans from before all others; the numbers are those of the order of arrival.
    #[test]
    fn the_order_of_arrival_changes_only_numbers() -> Result<(), Error> {
        let scans = parting()?;
        let (mut sorted, mut mixed) = (buffered(0.0)?, buffered(0.2)?);
        for (stamp, source, seen) in &scans {
            sorted.process(*stamp, *source, seen)?;
        }
        for k in [2, 0, 1, 5, 4, 3, 6, 7, 10, 8, 9, 11] {
            let (stamp, source, seen) = &scans[k];
            mixed.process(*stamp, *source, seen)?;
        }
        let (expected, found) = (sorted.tracks_at(1_000_000_000), mixed.tracks_at(1_000_000_000));
        assert_eq!(found.len(), 2);
        for (one, other) in expected.iter().zip(&found) {
            assert_eq!(TrackState { id: one.id, ..*other }, *one);
        }
        Ok(())
    }

    #[test]
    fn tracks_keep_their_numbers_when_a_scan_comes_late() -> Result<(), Error> {
        let mut tracker = buffered(0.2)?;
        tracker.process(0, 0, &scan(0, &[[0.0, 0.0]])?)?;
        let third = scan(100_000_000, &[[0.0, 0.1], [8.0, 0.0]])?;
        assert_eq!(numbers(&tracker.process(100_000_000, 0, &third)?), [Some(0), Some(1)]);
        let second = scan(50_000_000, &[[0.0, 0.05], [-9.0, 0.0]])?;
        assert_eq!(numbers(&tracker.process(50_000_000, 0, &second)?), [Some(0), Some(2)]);
        let ids = tracker.tracks_at(100_000_000).iter().map(|t| t.id).collect::<Vec<i64>>();
        assert_eq!(ids, [0, 1, 2]);
        Ok(())
    }

    #[test]
    fn a_scan_that_is_there_already_changes_nothing() -> Result<(), Error> {
        let mut tracker = buffered(0.2)?;
        for (stamp, source, seen) in parting()? {
            let first = tracker.process(stamp, source, &seen)?;
            let states = tracker.tracks_at(stamp);
            assert_eq!(tracker.process(stamp, source, &seen)?, first);
            assert_eq!(tracker.tracks_at(stamp), states);
        }
        Ok(())
    }

    #[test]
    fn scans_older_than_the_buffer_are_refused() -> Result<(), Error> {
        let mut tracker = buffered(0.2)?;
        for (stamp, source, seen) in parting()? {
            tracker.process(stamp, source, &seen)?;
        }
        let (late, last) = (349_999_999, 350_000_000);
        assert!(matches!(tracker.process(late, 0, &[]), Err(Error::Time { .. })));
        assert!(tracker.process(last, 1, &[]).is_ok());
        Ok(())
    }

    /// The nearest pair alone would leave the second track without a measurement.
    #[test]
    fn as_many_tracks_as_possible_are_measured() -> Result<(), Error> {
        let mut tracker = ManyTargets::new(&parameters()?)?;
        let seen = scan(0, &[[0.0, 0.0], [0.6, 0.0]])?;
        assert_eq!(numbers(&tracker.process(0, 0, &seen)?), [Some(0), Some(1)]);
        let stamp = 100_000_000;
        let seen = scan(stamp, &[[0.5, 0.0], [1.9, 0.0]])?;
        let assigned = tracker.process(stamp, 0, &seen)?;
        assert_eq!(numbers(&assigned), [Some(0), Some(1)]);
        assert!(assigned.iter().all(|one| one.innovation.is_some_and(|y| y.nis > 0.0)));
        assert!(tracker.tracks_at(stamp).iter().all(|track| track.confirmed && track.hits == 2));
        Ok(())
    }

    #[test]
    fn a_refused_scan_changes_nothing() -> Result<(), Error> {
        let mut tracker = ManyTargets::new(&parameters()?)?;
        tracker.process(5, 0, &scan(5, &[[0.0, 0.0]])?)?;
        let before = tracker.tracks_at(5);
        assert!(matches!(tracker.process(4, 0, &[]), Err(Error::Time { .. })));
        assert!(matches!(tracker.process(6, 0, &scan(7, &[[0.0; 2]])?), Err(Error::Value { .. })));
        assert!(matches!(tracker.process(6, 64, &[]), Err(Error::Parameter { .. })));
        let many = vec![[0.0; 2]; MAX_TARGETS + 1];
        assert!(matches!(tracker.process(6, 0, &scan(6, &many)?), Err(Error::Limit { .. })));
        assert_eq!(tracker.tracks_at(5), before);
        Ok(())
    }

    #[test]
    fn windows_that_cannot_be_are_refused() -> Result<(), Error> {
        for (confirm_hits, confirm_window) in [(0, 3), (4, 3), (3, 65)] {
            let wrong = ManyParameters { confirm_hits, confirm_window, ..parameters()? };
            assert!(ManyTargets::new(&wrong).is_err());
        }
        Ok(())
    }
}
