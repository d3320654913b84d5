//! Many targets: measurements assigned to tracks, births, confirmation, deletion; scans that come
//! late.

use super::any_filter::FusionParameters;
use super::lifecycle::Life;
pub use super::tracks::{Assigned, Scan};
use super::tracks::{Births, SavedTracks, Tracks, within};
use crate::Error;
use crate::error::require;
use crate::fusion::filter::engine::Output;
use crate::fusion::sensors::measurement::Measurement;
use crate::util::full_state::{impossible, opened, sealed};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Most tracks at a time, and most measurements of a scan.
pub const MAX_TARGETS: usize = 2_000;
/// Most scanners that are told apart.
pub const MAX_SOURCES: u8 = 64;
/// Most scans, and tracks in them, that are kept for late ones.
const MOST_KEPT: usize = 100_000;
const KIND: &str = "fusion tracker";

/// Everything a tracker of many targets can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ManyParameters {
    /// The filter of each; its gate decides which measurements may belong to a track, and its
    /// buffer how late scans may come.
    pub filter: FusionParameters,
    /// A track is confirmed when so many of ...
    pub confirm_hits: u32,
    /// ... the last so many scans measured it, at most 64.
    pub confirm_window: u32,
    /// A track goes when it has not been measured for longer [s].
    pub max_coast: f64,
    /// A track goes when the standard deviation of its position in one axis is larger [m].
    pub max_position_std: f64,
    /// No track starts nearer than this [m] to one that the same scan measured.
    pub birth_distance: f64,
    /// Which measurements are of which track.
    pub association: Association,
}

/// How measurements are shared out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Association {
    /// Global nearest neighbours: each is of one track or of none.
    Nearest,
    /// By the probabilities of all ways of sharing them out:
    /// [`probabilities`](super::joint_association::probabilities).
    Joint {
        /// Probability that a scan measures a target.
        detection: f64,
        /// Density of clutter of LiDAR [1/m^2] and of radar [1/(m rad m/s)].
        clutter: [f64; 2],
    },
}

/// A track at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackState {
    /// Number, never given again.
    pub id: i64,
    /// State, carried on to the time that was asked for.
    pub output: Output,
    /// Time of the first measurement [ns].
    pub born_ns: i64,
    /// Time of the last one [ns].
    pub seen_ns: i64,
    /// How many there were.
    pub hits: u32,
    /// Whether enough scans speak for it.
    pub confirmed: bool,
}

/// A scan that has been taken in.
#[derive(Clone)]
struct Past {
    scan: Scan,
    assigned: Vec<Assigned>,
    births: Vec<Option<i64>>,
    before: Tracks,
}

/// [`Past`] as it is saved.
#[derive(Serialize, Deserialize)]
struct SavedPast {
    scan: Scan,
    assigned: Vec<Assigned>,
    births: Vec<Option<i64>>,
    before: SavedTracks,
}

/// Everything about [`ManyTargets`] that changes with scans.
#[derive(Serialize, Deserialize)]
struct SavedTargets {
    tracks: SavedTracks,
    history: Vec<SavedPast>,
    next_id: i64,
    stamp_ns: Option<i64>,
    forgotten_ns: i64,
}

/// Tracks of many targets.
#[derive(Clone)]
pub struct ManyTargets {
    parameters: ManyParameters,
    buffer_ns: i64,
    tracks: Tracks,
    /// By time: the scans of the last `buffer_ns`.
    history: VecDeque<Past>,
    next_id: i64,
    stamp_ns: Option<i64>,
    /// Time of the last scan that is no longer in `history`, or of none [ns].
    forgotten_ns: i64,
}

impl ManyTargets {
    /// A tracker that has seen nothing.
    ///
    /// # Errors
    /// As [`Filter::new`](crate::fusion::Filter::new), and [`Error::Parameter`] unless 1 <=
    /// `confirm_hits` <= `confirm_window` <= 64.
    pub fn new(parameters: &ManyParameters) -> Result<Self, Error> {
        let ManyParameters { confirm_hits: hits, confirm_window: window, .. } = *parameters;
        let fits = 1 <= hits && hits <= window && window <= u64::BITS;
        require(fits, "confirm_hits", "1 to confirm_window, at most 64", hits)?;
        let filter = parameters.filter.without_buffer(); // tracks get scans in order
        let filter = FusionParameters { life: Life { loss: None, ..filter.life }, ..filter };
        Ok(Self {
            parameters: ManyParameters { filter, ..*parameters },
            buffer_ns: parameters.filter.life.buffer_ns,
            tracks: Tracks::new(&filter)?,
            history: VecDeque::new(),
            next_id: 0,
            stamp_ns: None,
            forgotten_ns: i64::MIN,
        })
    }

    /// Take in what one scanner saw at one time; returns what becomes of every measurement.
    ///
    /// A scan that comes late, but within the buffer, is put where it belongs, and those after it
    /// are gone through again; tracks keep the numbers that these gave them. One that is there
    /// already changes nothing.
    ///
    /// # Errors
    /// [`Error::Time`] for a scan older than the buffer, [`Error::Value`] for a measurement of
    /// another time, [`Error::Parameter`] for a source of [`MAX_SOURCES`] or more,
    /// [`Error::Limit`] for more than [`MAX_TARGETS`] measurements or tracks. Nothing has changed
    /// then.
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

    /// A tracker that goes on, to the same bits, where the one went whose state was saved.
    ///
    /// # Errors
    /// As [`ManyTargets::new`]; [`Error::Format`] for bytes that [`ManyTargets::to_state`] did
    /// not make, [`Error::Parameter`] for those of a tracker with other parameters.
    pub fn from_state(parameters: &ManyParameters, bytes: &[u8]) -> Result<Self, Error> {
        let empty = Self::new(parameters)?;
        let key = (empty.parameters, empty.buffer_ns);
        let saved: SavedTargets = opened(KIND, &key, bytes)?;
        let past = |past: SavedPast| {
            if past.births.len() != past.scan.measurements.len() {
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

    /// Put a scan where it belongs, and go through those after it again.
    fn insert(&mut self, scan: Scan) -> Result<Vec<Assigned>, Error> {
        let place = self.history.partition_point(|past| past.scan.stamp_ns <= scan.stamp_ns);
        let (stamp_ns, fresh) = (scan.stamp_ns, vec![None; scan.measurements.len()]);
        let mut tracks = self.history.get(place).map_or(&self.tracks, |past| &past.before).clone();
        let (mut redone, mut next_id) = (Vec::new(), self.next_id);
        let later = self.history.range(place..).map(|past| (&past.scan, &past.births));
        for (scan, ids) in std::iter::once((&scan, &fresh)).chain(later) {
            let before = tracks.clone();
            let mut births = Births { next_id, ids: ids.clone() };
            let assigned = tracks.take(&self.parameters, scan, &mut births)?;
            next_id = births.next_id;
            redone.push(Past { scan: scan.clone(), assigned, births: births.ids, before });
        }
        let assigned = redone.first().map_or(Vec::new(), |past| past.assigned.clone());
        self.history.truncate(place);
        self.history.extend(redone);
        (self.tracks, self.next_id) = (tracks, next_id);
        self.stamp_ns = self.stamp_ns.max(Some(stamp_ns));
        self.forget();
        Ok(assigned)
    }

    /// Drop scans that are older than the buffer, and the oldest of too many.
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

    /// All tracks, carried on to `stamp_ns`, by their numbers; unconfirmed ones included.
    #[must_use]
    pub fn tracks_at(&self, stamp_ns: i64) -> Vec<TrackState> {
        self.tracks.at(stamp_ns)
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
    use crate::fusion::models::motion::{NoiseForm, Prior};
    use crate::fusion::sensors::measurement::Sensor;
    use crate::fusion::sensors::observation::Sensing;
    use crate::fusion::targets::any_filter::{Method, Model, Strengths};
    use crate::fusion::targets::lifecycle::GyroUse;

    fn parameters() -> Result<ManyParameters, Error> {
        let (form, variance) = (NoiseForm::Continuous, 25.0);
        let filter = FusionParameters {
            model: Model::ConstantVelocity,
            method: Method::Extended,
            strengths: Strengths {
                form,
                acceleration: 0.5,
                jerk: 1.0,
                turn: 1.0,
                platform: 1.0,
                start: 1.0,
            },
            prior: Prior {
                position: 0.5,
                speed: variance,
                heading: 1.0,
                turn_rate: 1.0,
                acceleration: 1.0,
                platform_rate: 1.0,
            },
            sensing: Sensing {
                lidar: [0.1; 2],
                radar: [0.1; 3],
                gyro: 0.1,
                pose: [0.0; 3],
                range_min: 0.1,
                convert_radar: false,
            },
            life: Life {
                start_rows: 1,
                gate: Life::gates(Some(0.99))?,
                loss: None,
                radar_starts_speed: true,
                gyro: GyroUse::Input,
                buffer_ns: 0,
            },
            lever: [0.0; 2],
        };
        Ok(ManyParameters {
            filter,
            confirm_hits: 2,
            confirm_window: 3,
            max_coast: 2.0,
            max_position_std: 20.0,
            birth_distance: 0.0,
            association: Association::Nearest,
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
