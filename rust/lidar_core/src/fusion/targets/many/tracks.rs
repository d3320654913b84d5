//! Tracks of a tracker of many targets at one time, and their update by a scan.

use super::company::Bodies;
use super::near_pairs::{ScanIndex, places_of};
use super::parameters::{MAX_TARGETS, ManyParameters, TargetAssociation};
use super::track::{
    Assigned, Births, IntegratedScan, Scan, Shared, TargetTrack, TrackState, TrackingWork, kind,
};
use crate::Error;
use crate::fusion::parameters::FusionParameters;
use crate::fusion::targets::any_filter::Filter;
use crate::fusion::targets::lifecycle::Outcome;
use crate::fusion::targets::target::SavedTarget;
use crate::tracking::standing_clutter::{PlaceLog, StandingClutter};
use crate::tracking::surroundings::{Population, Surroundings};
use crate::util::full_state::impossible;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Saved form of all tracks.
#[derive(Serialize, Deserialize)]
pub struct SavedTracks {
    unseen: SavedTarget,
    all: Vec<TargetTrack<SavedTarget>>,
    scanners: BTreeMap<u8, [Surroundings; 2]>,
    population: Population,
    standing: BTreeMap<u8, StandingClutter>,
    radars: u64,
}

/// All tracks at one time.
#[derive(Clone)]
pub struct Tracks {
    /// Filter without a target that holds the motion of the platform.
    pub(super) unseen: Filter,
    pub(super) all: Vec<TargetTrack>,
    /// Learnt properties of every scanner, for its LiDAR and its radar measurements.
    pub(super) scanners: BTreeMap<u8, [Surroundings; 2]>,
    /// Statistics of certain tracks: how long targets exist, how often they are hidden and how fast
    /// they move.
    pub(super) population: Population,
    /// Static clutter, by scanner; empty if static targets are reported.
    pub(super) standing: BTreeMap<u8, StandingClutter>,
    /// Scanners for which the position of a radar is known, one bit each.
    pub(super) radars: u64,
}

impl Tracks {
    /// Tracker without tracks.
    ///
    /// # Errors
    /// Errors of [`Filter::new`].
    pub fn new(filter: &FusionParameters) -> Result<Self, Error> {
        Ok(Self {
            unseen: Filter::new(filter)?,
            all: Vec::new(),
            scanners: BTreeMap::new(),
            population: Population::default(),
            standing: BTreeMap::new(),
            radars: 0,
        })
    }

    /// Move all tracks out of this value.
    #[must_use]
    pub fn moved_out(&mut self) -> Self {
        Self { all: std::mem::take(&mut self.all), ..self.clone() }
    }

    /// The state of all tracks, for saving.
    pub fn saved(&self) -> SavedTracks {
        let one = |track: &TargetTrack| track.with_filter(track.filter.saved());
        SavedTracks {
            unseen: self.unseen.saved(),
            all: self.all.iter().map(one).collect(),
            scanners: self.scanners.clone(),
            population: self.population,
            standing: self.standing.clone(),
            radars: self.radars,
        }
    }

    /// Saved tracks, with filters of the parameters of `self`.
    ///
    /// # Errors
    /// [`Error::Format`] for the state of another model, or parts that do not agree.
    pub fn restored(&self, saved: &SavedTracks) -> Result<Self, Error> {
        let with = |state: &SavedTarget| {
            let mut filter = self.unseen.clone();
            filter.restore_saved(state).map(|()| filter)
        };
        let one = |track: &TargetTrack<SavedTarget>| {
            if !track.echoes.is_sound() {
                return Err(impossible("impossible values of an echo"));
            }
            if !track.kinds.is_sound() {
                return Err(impossible("impossible values of a motion"));
            }
            with(&track.filter).map(|own| track.with_filter(own))
        };
        let all = saved.all.iter().map(one).collect::<Result<_, Error>>()?;
        Ok(Self {
            unseen: with(&saved.unseen)?,
            all,
            scanners: saved.scanners.clone(),
            population: saved.population,
            standing: saved.standing.clone(),
            radars: saved.radars,
        })
    }

    /// True if every track has an ID below `next_id`.
    #[must_use]
    pub(super) fn are_below(&self, next_id: i64) -> bool {
        self.all.iter().all(|track| (0..next_id).contains(&track.id))
    }

    /// True if `places` contain all positions to which the static clutter of these tracks refers.
    #[must_use]
    pub fn know(&self, places: &BTreeMap<u8, PlaceLog>) -> bool {
        let mut own = self.standing.iter();
        own.all(|(source, own)| places.get(source).is_some_and(|log| own.is_of(log)))
    }

    /// Remove positions that are older than those of these tracks, which are the oldest that are
    /// kept.
    pub fn forget_before(&self, places: &mut BTreeMap<u8, PlaceLog>) {
        for (source, own) in &self.standing {
            if let Some(log) = places.get_mut(source) {
                log.forget(own);
            }
        }
    }

    /// Remove positions to which these tracks, the newest, do not refer: scans that were rejected
    /// had added them.
    pub fn keep_known(&self, places: &mut BTreeMap<u8, PlaceLog>) {
        places.retain(|source, log| {
            let own = self.standing.get(source);
            own.into_iter().for_each(|own| log.end_with(own));
            own.is_some()
        });
    }

    /// Number of tracks.
    #[must_use]
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// True if there are no tracks.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Tracks predicted to `stamp_ns`, ordered by ID.
    #[must_use]
    pub fn at(&self, stamp_ns: i64) -> Vec<TrackState> {
        let states = self.all.iter().filter_map(|track| {
            let output = track.reported_at(stamp_ns)?;
            let TargetTrack { id, born_ns, seen_ns, hits, belief, .. } = *track;
            let confirmed = track.is_reported();
            let existence = Some(belief.presence.existence).filter(|p| !p.is_nan());
            let kinds = track.kinds.belief();
            let (kind, kind_probability) = (kinds.kind(), kinds.probabilities());
            let state = TrackState {
                id,
                output,
                born_ns,
                seen_ns,
                hits,
                confirmed,
                existence,
                kind,
                kind_probability,
            };
            Some(state)
        });
        let mut states: Vec<TrackState> = states.collect();
        states.sort_by_key(|state| state.id);
        states
    }

    /// Process a scan that is not older than the last one.
    ///
    /// # Errors
    /// [`Error::Limit`] for more than [`MAX_TARGETS`] tracks; the tracks are then unusable.
    pub(super) fn take(
        &mut self,
        parameters: &ManyParameters,
        scan: &Scan,
        shared: Shared<'_>,
    ) -> Result<Vec<Assigned>, Error> {
        let Shared { births, work, places: known } = shared;
        let stamp_ns = scan.stamp_ns;
        let mut assigned = vec![Assigned::default(); scan.measurements.len()];
        work.scans += 1;
        work.predictions += self.predict(scan);
        let index = ScanIndex::new(&scan.measurements, &parameters.filter.sensing);
        let has_places = parameters.birth_distance > 0.0 || parameters.report_speed > 0.0;
        let places = if has_places {
            places_of(&self.unseen, &parameters.filter.sensing, &scan.measurements)
        } else {
            Vec::new()
        };
        let standing = self.standing_clutter(parameters, scan, &places, known);
        let seen = (scan, standing.as_slice());
        // Probabilities of existence start tracks with the association; counts start them after it.
        let measured = if let TargetAssociation::Integrated(existence) = &parameters.association {
            let candidates = self.candidates(parameters, seen, &index, |_| true, &assigned, work);
            let space = IntegratedScan { parameters, existence, scan, standing: &standing };
            self.integrate(&space, &candidates, births, &mut assigned);
            None
        } else {
            Some(self.count_hits(parameters, seen, &index, &mut assigned, work)?)
        };
        self.keep_company(parameters, stamp_ns);
        self.hear_echoes(parameters, scan);
        self.learn_places(parameters, scan, &places, known);
        if let Some(measured) = measured {
            self.start(parameters, scan, &measured, births, &mut assigned);
        }
        self.learn_kinds(parameters, scan, &assigned);
        within("tracks", self.all.len())?;
        Ok(assigned)
    }

    /// Associate confirmed tracks, then the others; confirm and end tracks by counts of their
    /// measurements. Returns the positions of the measured targets [m].
    fn count_hits(
        &mut self,
        parameters: &ManyParameters,
        (scan, standing): (&Scan, &[f64]),
        index: &ScanIndex,
        assigned: &mut [Assigned],
        work: &mut TrackingWork,
    ) -> Result<Bodies, Error> {
        let clutter = self.clutter(parameters, scan, standing);
        for confirmed in [true, false] {
            let wanted = |track: &TargetTrack| track.confirmed == confirmed;
            let seen = (scan, clutter.as_slice());
            let candidates = self.candidates(parameters, seen, index, wanted, assigned, work);
            self.associate(parameters, scan, &candidates, assigned)?;
        }
        let measured = self.bodies_at(scan.stamp_ns);
        self.all.iter_mut().for_each(|track| track.judge(parameters));
        let ended: Vec<TargetTrack> =
            self.all.extract_if(.., |track| !track.stays(scan.stamp_ns, parameters)).collect();
        if let TargetAssociation::Joint { .. } = parameters.association {
            self.learn_clutter(scan, &ended);
        }
        Ok(measured)
    }

    /// Predict all tracks to the time of a scan, with the motion of the platform that it states.
    /// Returns the number of predictions.
    fn predict(&mut self, scan: &Scan) -> u64 {
        for m in scan.measurements.iter().filter(|m| m.is_of_platform()) {
            self.unseen.step(m);
            self.all.iter_mut().for_each(|track| {
                track.filter.step(m);
            });
        }
        let seen = 1 << scan.source;
        for track in self.all.iter_mut().filter(|track| track.sources & seen != 0) {
            track.history <<= 1;
            track.looks = track.looks.saturating_add(1);
        }
        self.all.iter_mut().map(|track| u64::from(track.filter.foresee(scan.stamp_ns))).sum()
    }

    /// Start a track for every measurement without a track that is far enough from the `measured`
    /// tracks.
    fn start(
        &mut self,
        parameters: &ManyParameters,
        scan: &Scan,
        measured: &Bodies,
        births: &mut Births,
        assigned: &mut [Assigned],
    ) {
        for (column, m) in scan.measurements.iter().enumerate() {
            if assigned[column].id.is_some() || m.is_of_platform() {
                continue;
            }
            let mut filter = self.unseen.clone();
            let step = filter.step(m);
            let Some(output) = step.output.filter(|_| step.outcome == Outcome::Started) else {
                continue;
            };
            let place = [output.mean[0], output.mean[1]];
            if measured.hold(place, parameters.birth_distance) {
                continue;
            }
            let mut track = TargetTrack::new(births.of(column), filter, scan);
            track.belief.origin = (scan.source, kind(m));
            track.judge(parameters);
            assigned[column].id = Some(track.id);
            self.all.push(track);
        }
    }
}

/// Check a number of measurements or tracks; `what` names them in the error.
///
/// # Errors
/// [`Error::Limit`] for more than [`MAX_TARGETS`].
pub fn within(what: &'static str, count: usize) -> Result<(), Error> {
    if count <= MAX_TARGETS {
        return Ok(());
    }
    let (what, limit) = (format!("{count} {what}"), MAX_TARGETS as u64);
    Err(Error::Limit { what, limit, key: "leave clutter out before" })
}
