//! A track, its update by scans, and the scan itself.

use super::company::RecentPath;
use super::kinds::TargetKinds;
use super::parameters::{ExistenceParameters, ManyParameters};
use super::score::TrackScore;
use crate::estimation::assignment::Pair;
use crate::fusion::filter::engine::{Innovation, Output};
use crate::fusion::sensors::measurement::{Measurement, Sensor};
use crate::fusion::targets::any_filter::Filter;
use crate::tracking::echo::TrackEchoes;
use crate::tracking::existence::Presence;
use crate::tracking::kind::{KINDS, TrackKind};
use crate::tracking::spread::MeasuredSpread;
use crate::tracking::standing_clutter::PlaceLog;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Measurements of one scanner at one time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// Time [ns].
    pub stamp_ns: i64,
    /// Index of the scanner, below 64.
    pub source: u8,
    /// Measurements of targets, one each, and of the platform's motion.
    pub measurements: Vec<Measurement>,
}

/// Result of a measurement for a tracker.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Assigned {
    /// ID of the track of the measurement; None if the measurement cannot be used, starts no track,
    /// or describes the platform.
    pub id: Option<i64>,
    /// Innovation for that track; None if the measurement started it.
    pub innovation: Option<Innovation>,
}

/// IDs of the tracks that a scan starts; they stay the same if the scan is processed again.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct NewNumbers {
    /// IDs of tracks that start with one measurement, by index of the measurement.
    pub of_column: Vec<Option<i64>>,
    /// IDs of tracks that continue an older track with one measurement, by ID of the older track
    /// and index of the measurement.
    pub of_pair: BTreeMap<(i64, usize), i64>,
}

/// Next unused track ID, and the IDs of the tracks that a scan starts.
#[derive(Clone, Debug)]
pub struct Births {
    /// Next unused track ID.
    pub next_id: i64,
    /// IDs that were given to tracks of the scan.
    pub ids: NewNumbers,
}

/// Data that tracks of all times share while a scan is processed.
pub(super) struct Shared<'a> {
    pub(super) births: &'a mut Births,
    pub(super) work: &'a mut TrackingWork,
    /// Positions of the measurements of every scanner, for the density of static clutter.
    pub(super) places: &'a mut BTreeMap<u8, PlaceLog>,
}

/// A track at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackState {
    /// ID of the track, never reused.
    pub id: i64,
    /// State, predicted to the requested time.
    pub output: Output,
    /// Time of the first measurement [ns].
    pub born_ns: i64,
    /// Time of the last measurement [ns].
    pub seen_ns: i64,
    /// Number of measurements.
    pub hits: u32,
    /// True if enough scans measured the track, or if its probability of existence is high enough.
    pub confirmed: bool,
    /// Probability that there is a target; None where the association does not estimate it.
    pub existence: Option<f64>,
    /// Kind of target that the track follows.
    pub kind: TrackKind,
    /// Probability of every kind, in the order of `TrackKind::ALL`.
    pub kind_probability: [f64; KINDS],
}

/// Work that the scans so far have caused, as counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrackingWork {
    /// Scans processed; a late scan counts those after it again.
    pub scans: u64,
    /// Predictions of a track to the time of a scan.
    pub predictions: u64,
    /// Pairs of a track and a measurement that were compared.
    pub pairs: u64,
}

/// Possible pairs of tracks and measurements, each with its innovation.
#[derive(Default)]
pub(super) struct Candidates {
    pub(super) pairs: Vec<Pair>,
    pub(super) innovations: Vec<Innovation>,
}

/// A measurement of a scan: stamp [ns], scanner and index.
pub type Sighting = (i64, u8, usize);

/// Existence of the target of a track.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Belief {
    /// Probabilities that there is no target, an observable target, or a hidden one.
    pub presence: Presence,
    /// Time of the probabilities [ns].
    pub stamp_ns: i64,
    /// The last two measurements that most likely came from the target.
    pub last: [Option<Sighting>; 2],
    /// Position at the first measurement [m].
    pub start: [f64; 2],
    /// Scanner and sensor of that measurement.
    pub origin: (u8, usize),
    /// True once the probability of existence was above 0.9 (`CERTAIN`).
    pub was_certain: bool,
    /// True while a track that was certain counts as ended in the learnt statistics.
    pub is_doubtful: bool,
    /// True if the track will count as a newly arrived target when it becomes certain. False for
    /// targets that were there before the first scans.
    pub will_arrive: bool,
}

impl Default for Belief {
    /// Nothing is known.
    fn default() -> Self {
        Self {
            presence: Presence::measured(f64::NAN),
            stamp_ns: 0,
            last: [None; 2],
            start: [f64::NAN; 2],
            origin: (0, 0),
            was_certain: false,
            is_doubtful: false,
            will_arrive: false,
        }
    }
}

/// A scan, and how it is processed.
pub(super) struct IntegratedScan<'a> {
    pub parameters: &'a ManyParameters,
    pub existence: &'a ExistenceParameters,
    pub scan: &'a Scan,
    /// Density of static clutter at each measurement [1/m^2].
    pub standing: &'a [f64],
}

/// A track with its filter, or with the saved form of that.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct TargetTrack<F = Filter> {
    pub(super) id: i64,
    pub(super) filter: F,
    /// One bit per scan of scanners that have measured the track, the last scan in the lowest bit:
    /// 1 if the scan measured the track.
    pub(super) history: u64,
    /// Number of scans in `history`.
    pub(super) looks: u32,
    /// Scanners that have measured the track, one bit each.
    pub(super) sources: u64,
    pub(super) born_ns: i64,
    pub(super) seen_ns: i64,
    pub(super) hits: u32,
    pub(super) confirmed: bool,
    pub(super) belief: Belief,
    pub(super) way: RecentPath,
    pub(super) score: TrackScore,
    /// Spread of the measurements near the track; not used if targets are points (`birth_distance`
    /// is 0).
    pub(super) spread: MeasuredSpread,
    pub(super) kinds: TargetKinds,
    pub(super) echoes: TrackEchoes,
}

impl Births {
    /// ID of the track that starts with measurement `column`.
    pub(super) fn of(&mut self, column: usize) -> i64 {
        let id = self.ids.of_column[column].unwrap_or(self.next_id);
        self.next_id = self.next_id.max(id.saturating_add(1));
        self.ids.of_column[column] = Some(id);
        id
    }

    /// ID of the track that continues track `id` with measurement `column`.
    pub(super) fn of_pair(&mut self, id: i64, column: usize) -> i64 {
        let next = self.next_id;
        let new = *self.ids.of_pair.entry((id, column)).or_insert(next);
        self.next_id = self.next_id.max(new.saturating_add(1));
        new
    }
}

impl NewNumbers {
    /// True if all IDs are below `next_id`.
    #[must_use]
    pub(super) fn are_below(&self, next_id: i64) -> bool {
        let mut all = self.of_column.iter().flatten().chain(self.of_pair.values());
        all.all(|id| (0..next_id).contains(id))
    }

    /// Empty table of IDs for a scan of `count` measurements.
    #[must_use]
    pub fn of_scan(count: usize) -> Self {
        Self { of_column: vec![None; count], of_pair: BTreeMap::new() }
    }
}

impl<F> TargetTrack<F> {
    /// The same track with another form of its filter.
    pub(super) fn with_filter<G>(&self, filter: G) -> TargetTrack<G> {
        TargetTrack {
            id: self.id,
            filter,
            history: self.history,
            looks: self.looks,
            sources: self.sources,
            born_ns: self.born_ns,
            seen_ns: self.seen_ns,
            hits: self.hits,
            confirmed: self.confirmed,
            belief: self.belief,
            way: self.way.clone(),
            score: self.score,
            spread: self.spread,
            kinds: self.kinds.clone(),
            echoes: self.echoes.clone(),
        }
    }
}

impl TargetTrack {
    pub(super) fn new(id: i64, filter: Filter, scan: &Scan) -> Self {
        Self {
            id,
            filter,
            history: 1,
            looks: 1,
            sources: 1 << scan.source,
            born_ns: scan.stamp_ns,
            seen_ns: scan.stamp_ns,
            hits: 1,
            confirmed: false,
            belief: Belief::default(),
            way: RecentPath::default(),
            score: TrackScore::default(),
            spread: MeasuredSpread::default(),
            kinds: TargetKinds::default(),
            echoes: TrackEchoes::default(),
        }
    }

    pub(super) fn see(&mut self, scan: &Scan) {
        let seen = 1 << scan.source;
        if self.sources & seen == 0 {
            self.history <<= 1; // the first scan of this scanner that counts
            self.looks = self.looks.saturating_add(1);
        }
        self.history |= 1;
        self.sources |= seen;
        self.seen_ns = scan.stamp_ns;
        self.hits = self.hits.saturating_add(1);
    }

    /// Process measurements, each with its probability to come from the target of this track.
    pub(super) fn absorb(&mut self, scan: &Scan, weighted: &[(f64, Measurement)]) {
        if weighted.is_empty() {
            return;
        }
        self.filter.absorb(scan.stamp_ns, weighted);
        if weighted.iter().map(|(weight, _)| weight).sum::<f64>() > 0.5 {
            self.see(scan);
        }
    }

    /// True unless the track is at rest, is a part or an echo of another track, or is explained by
    /// clutter.
    pub(super) fn is_reported(&self) -> bool {
        self.is_of_target() && !self.echoes.is_echo
    }

    /// Like `is_reported`, but echoes count as targets.
    pub(super) fn is_of_target(&self) -> bool {
        self.confirmed && !self.way.is_left_out() && self.score.is_credible
    }

    /// Position at `stamp_ns` [m]; None if it is not finite.
    pub(super) fn place_at(&self, stamp_ns: i64) -> Option<[f64; 2]> {
        let output = self.filter.output_at(stamp_ns)?;
        let place = [output.mean[0], output.mean[1]];
        place.iter().all(|value| value.is_finite()).then_some(place)
    }

    /// State at `stamp_ns`. If targets have an extent, the covariance of the position contains it.
    pub(super) fn reported_at(&self, stamp_ns: i64) -> Option<Output> {
        let mut output = self.filter.output_at(stamp_ns)?;
        for (row, spread) in output.covariance.iter_mut().zip(self.spread.covariance()) {
            row.iter_mut().zip(spread).for_each(|(value, more)| *value += more);
        }
        Some(output)
    }

    /// Number of recent scans that measured the track, and number of recent scans that count.
    pub(super) fn recent(&self, window: u32) -> (u32, u32) {
        let mask = u64::MAX >> (u64::BITS - window);
        ((self.history & mask).count_ones(), self.looks.min(window))
    }

    pub(super) fn judge(&mut self, parameters: &ManyParameters) {
        let (hits, _) = self.recent(parameters.confirm_window);
        self.confirmed |= hits >= parameters.confirm_hits;
    }

    pub(super) fn stays(&self, stamp_ns: i64, parameters: &ManyParameters) -> bool {
        let (hits, looks) = self.recent(parameters.confirm_window);
        let misses = parameters.confirm_window - parameters.confirm_hits;
        let unseen = stamp_ns.saturating_sub(self.seen_ns) as f64 * 1e-9;
        let Some(output) = self.filter.output_at(stamp_ns) else { return false };
        let variance = output.covariance[0][0].max(output.covariance[1][1]);
        (self.confirmed || looks - hits <= misses)
            && unseen <= parameters.max_coast
            && variance <= parameters.max_position_std * parameters.max_position_std
    }
}

/// Index of the sensor of a measurement in the properties of its scanner: 0 for LiDAR, 1 for radar.
pub(super) fn kind(m: &Measurement) -> usize {
    usize::from(m.sensor() == Sensor::Radar)
}
