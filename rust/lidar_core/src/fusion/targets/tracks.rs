//! Tracks of a tracker of many targets at one time, and their update by a scan.

use super::any_filter::Filter;
use super::company::{Fellow, keep_company, measure_spread};
use super::hypotheses::is_another_target;
use super::lifecycle::Outcome;
use super::many_parameters::{MAX_TARGETS, ManyParameters, TargetAssociation};
use super::near_pairs::{Placed, ScanIndex, clutter_at, places_of};
use super::target::SavedTarget;
use super::track::{
    Assigned, Births, Candidates, IntegratedScan, Scan, TargetTrack, TrackState, TrackingWork,
};
use crate::Error;
use crate::estimation::assignment::{Pair, assign};
use crate::fusion::parameters::FusionParameters;
use crate::tracking::joint_association::probabilities;
use crate::tracking::near::NearIndex;
use crate::tracking::standing_clutter::StandingClutter;
use crate::tracking::surroundings::{Population, Surroundings};
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// Cost of a track without a measurement although one is in its gate. It is far above that of any
/// pair, so that as many tracks as possible get one.
const UNASSIGNED: f64 = 1e6;

/// Saved form of all tracks.
#[derive(Serialize, Deserialize)]
pub struct SavedTracks {
    unseen: SavedTarget,
    all: Vec<TargetTrack<SavedTarget>>,
    scanners: BTreeMap<u8, [Surroundings; 2]>,
    population: Population,
    standing: BTreeMap<u8, StandingClutter>,
}

/// All tracks at one time.
#[derive(Clone)]
pub struct Tracks {
    /// Filter without a target that holds the motion of the platform.
    pub(super) unseen: Filter,
    pub(super) all: Vec<TargetTrack>,
    /// What is known about every scanner, of its LiDAR and its radar measurements.
    pub(super) scanners: BTreeMap<u8, [Surroundings; 2]>,
    /// How long targets stay.
    pub(super) population: Population,
    /// What stands, by scanner; nothing where targets may stand.
    standing: BTreeMap<u8, StandingClutter>,
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
        })
    }

    /// The tracks, of which none stay here.
    #[must_use]
    pub fn moved_out(&mut self) -> Self {
        Self { all: std::mem::take(&mut self.all), ..self.clone() }
    }

    /// State that changes with scans.
    pub fn saved(&self) -> SavedTracks {
        let one = |track: &TargetTrack| track.with_filter(track.filter.saved());
        SavedTracks {
            unseen: self.unseen.saved(),
            all: self.all.iter().map(one).collect(),
            scanners: self.scanners.clone(),
            population: self.population,
            standing: self.standing.clone(),
        }
    }

    /// Saved tracks, with filters of the parameters of `self`.
    ///
    /// # Errors
    /// [`Error::Format`] for the state of another model.
    pub fn restored(&self, saved: &SavedTracks) -> Result<Self, Error> {
        let with = |state: &SavedTarget| {
            let mut filter = self.unseen.clone();
            filter.restore_saved(state).map(|()| filter)
        };
        let one = |track: &TargetTrack<SavedTarget>| {
            with(&track.filter).map(|own| track.with_filter(own))
        };
        let all = saved.all.iter().map(one).collect::<Result<_, Error>>()?;
        Ok(Self {
            unseen: with(&saved.unseen)?,
            all,
            scanners: saved.scanners.clone(),
            population: saved.population,
            standing: saved.standing.clone(),
        })
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

    /// Tracks predicted to `stamp_ns`, ordered by number.
    #[must_use]
    pub fn at(&self, stamp_ns: i64) -> Vec<TrackState> {
        let states = self.all.iter().filter_map(|track| {
            let output = track.reported_at(stamp_ns)?;
            let TargetTrack { id, born_ns, seen_ns, hits, belief, .. } = *track;
            let confirmed = track.is_reported();
            let existence = Some(belief.presence.existence).filter(|p| !p.is_nan());
            Some(TrackState { id, output, born_ns, seen_ns, hits, confirmed, existence })
        });
        let mut states: Vec<TrackState> = states.collect();
        states.sort_by_key(|state| state.id);
        states
    }

    /// Process a scan that is not older than the last one.
    ///
    /// # Errors
    /// [`Error::Limit`] for more than [`MAX_TARGETS`] tracks; the tracks are then unusable.
    pub fn take(
        &mut self,
        parameters: &ManyParameters,
        scan: &Scan,
        births: &mut Births,
        work: &mut TrackingWork,
    ) -> Result<Vec<Assigned>, Error> {
        work.scans += 1;
        let (stamp_ns, seen) = (scan.stamp_ns, 1 << scan.source);
        let mut assigned = vec![Assigned::default(); scan.measurements.len()];
        for m in scan.measurements.iter().filter(|m| m.is_of_platform()) {
            self.unseen.step(m);
            self.all.iter_mut().for_each(|track| {
                track.filter.step(m);
            });
        }
        for track in &mut self.all {
            if track.sources & seen != 0 {
                track.history <<= 1;
                track.looks += 1;
            }
        }
        let foreseen = self.all.iter_mut().map(|track| u64::from(track.filter.foresee(stamp_ns)));
        work.predictions += foreseen.sum::<u64>();
        let index = ScanIndex::new(&scan.measurements, &parameters.filter.sensing);
        let has_places = parameters.birth_distance > 0.0 || parameters.report_speed > 0.0;
        let places = if has_places {
            places_of(&self.unseen, &parameters.filter.sensing, &scan.measurements)
        } else {
            Vec::new()
        };
        let standing = self.standing_clutter(parameters, scan, &places);
        if let TargetAssociation::Integrated(existence) = &parameters.association {
            let seen = (scan, standing.as_slice());
            let candidates = self.candidates(parameters, seen, &index, |_| true, &assigned, work);
            let space = IntegratedScan { parameters, existence, scan, standing: &standing };
            self.integrate(&space, &candidates, births, &mut assigned);
            self.keep_company(parameters, stamp_ns);
            self.learn_places(parameters, scan, &places);
            within("tracks", self.all.len())?;
            return Ok(assigned);
        }
        for confirmed in [true, false] {
            let wanted = |track: &TargetTrack| track.confirmed == confirmed;
            let seen = (scan, standing.as_slice());
            let candidates = self.candidates(parameters, seen, &index, wanted, &assigned, work);
            self.associate(parameters, scan, &candidates, &mut assigned)?;
        }
        let measured = self.measured_at(stamp_ns);
        self.all.iter_mut().for_each(|track| track.judge(parameters));
        self.all.retain(|track| track.stays(stamp_ns, parameters));
        self.keep_company(parameters, stamp_ns);
        self.learn_places(parameters, scan, &places);
        self.start(parameters, scan, &measured, births, &mut assigned);
        within("tracks", self.all.len())?;
        Ok(assigned)
    }

    /// Assign measurements to tracks. The global nearest neighbour uses the likelihood of the
    /// innovations.
    ///
    /// # Source
    /// Bar-Shalom, Li & Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    /// 2001; Blackman & Popoli, "Design and Analysis of Modern Tracking Systems", 1999, sec. 6.4.
    fn associate(
        &mut self,
        parameters: &ManyParameters,
        scan: &Scan,
        candidates: &Candidates,
        assigned: &mut [Assigned],
    ) -> Result<(), Error> {
        if let TargetAssociation::Joint { detection, .. } = parameters.association {
            self.associate_jointly(scan, assigned, candidates, detection);
            return Ok(());
        }
        let Candidates { pairs, innovations } = candidates;
        let column_of = assign(self.all.len(), scan.measurements.len(), pairs, UNASSIGNED)?;
        for (Pair { row, column, .. }, innovation) in pairs.iter().zip(innovations) {
            if column_of[*row] == Some(*column) {
                let track = &mut self.all[*row];
                track.filter.take(&scan.measurements[*column]);
                track.see(scan);
                assigned[*column] = Assigned { id: Some(track.id), innovation: Some(*innovation) };
            }
        }
        Ok(())
    }

    /// The `wanted` tracks with those measurements in their gates that have no track yet.
    fn candidates(
        &mut self,
        parameters: &ManyParameters,
        (scan, standing): (&Scan, &[f64]),
        index: &ScanIndex,
        wanted: impl Fn(&TargetTrack) -> bool,
        assigned: &[Assigned],
        work: &mut TrackingWork,
    ) -> Candidates {
        let (mut found, mut near) = (Candidates::default(), Vec::new());
        let rows = self.all.iter_mut().enumerate();
        for (row, track) in rows.filter(|(_, track)| wanted(track)) {
            index.near(&mut track.filter, &parameters.filter.life.gate, &mut near);
            near.retain(|column| assigned[*column].id.is_none());
            work.pairs += near.len() as u64;
            for column in &near {
                let m = &scan.measurements[*column];
                let Some(innovation) = track.filter.score(m) else { continue };
                if is_another_target(track, m) {
                    continue;
                }
                let cost = parameters.association.cost(m, &innovation, standing[*column]);
                if cost.is_finite() {
                    found.pairs.push(Pair { row, column: *column, cost });
                    found.innovations.push(innovation);
                }
            }
        }
        found
    }

    /// Joint probabilistic data association of measurements without a track. A measurement that
    /// more likely comes from some track than from none is assigned to the most likely one.
    fn associate_jointly(
        &mut self,
        scan: &Scan,
        assigned: &mut [Assigned],
        candidates: &Candidates,
        detection: f64,
    ) {
        let Candidates { pairs, innovations } = candidates;
        let weights = probabilities(self.all.len(), scan.measurements.len(), pairs);
        let mut of_track = vec![Vec::new(); self.all.len()];
        let mut of_any = vec![(0.0, 0.0, Assigned::default()); assigned.len()]; // sum, largest
        let mut odds = vec![0.0; self.all.len()];
        for ((Pair { row, column, cost }, innovation), weight) in
            pairs.iter().zip(innovations).zip(weights)
        {
            odds[*row] += libm::exp(-cost);
            of_track[*row].push((weight, scan.measurements[*column]));
            let (sum, most, best) = &mut of_any[*column];
            *sum += weight;
            if weight > *most {
                let innovation = Some(*innovation);
                (*most, *best) = (weight, Assigned { id: Some(self.all[*row].id), innovation });
            }
        }
        for (given, (sum, _, best)) in assigned.iter_mut().zip(of_any) {
            if sum > 0.5 {
                *given = best;
            }
        }
        let has_clutter = !self.standing.is_empty();
        for ((track, weighted), odds) in self.all.iter_mut().zip(of_track).zip(odds) {
            let hits = track.hits;
            track.absorb(scan, &weighted);
            if track.hits > hits && has_clutter {
                track.score.weigh(odds, detection);
            }
        }
    }

    /// Density of clutter that stands where each measurement is: zero where targets may stand.
    fn standing_clutter(
        &mut self,
        parameters: &ManyParameters,
        scan: &Scan,
        places: &[Placed],
    ) -> Vec<f64> {
        if parameters.report_speed <= 0.0 {
            return vec![0.0; scan.measurements.len()];
        }
        let own = self.standing.entry(scan.source).or_default();
        clutter_at(own, scan.stamp_ns, &scan.measurements, places)
    }

    /// Keep the places of a scan for those to come, and let reported tracks learn their extent.
    fn learn_places(&mut self, parameters: &ManyParameters, scan: &Scan, places: &[Placed]) {
        let places: Vec<[f64; 2]> = places.iter().flatten().map(|(place, _)| *place).collect();
        if parameters.birth_distance > 0.0 {
            let reported = self.all.iter_mut().filter(|track| track.is_reported());
            let tracks = reported.filter_map(|track| {
                let output = track.filter.output_at(scan.stamp_ns)?;
                Some(([output.mean[0], output.mean[1]], &mut track.spread))
            });
            measure_spread(tracks.collect(), parameters.birth_distance, &places);
        }
        if let Some(own) = self.standing.get_mut(&scan.source) {
            own.take(scan.stamp_ns, places.into_iter());
        }
    }

    /// Say of every confirmed track whether it stands or is part of another one.
    fn keep_company(&mut self, parameters: &ManyParameters, stamp_ns: i64) {
        let ManyParameters { report_speed, birth_distance, .. } = *parameters;
        if report_speed <= 0.0 && birth_distance <= 0.0 {
            return;
        }
        let confirmed = self.all.iter_mut().filter(|track| track.confirmed);
        let fellows = confirmed.filter_map(|track| {
            let output = track.filter.output_at(stamp_ns)?;
            let place = [output.mean[0], output.mean[1]];
            let rank = (Reverse(track.hits), track.born_ns, track.id);
            let is_finite = place.iter().all(|value| value.is_finite());
            is_finite.then_some(Fellow { path: &mut track.way, place, rank })
        });
        keep_company(fellows.collect(), report_speed, birth_distance, stamp_ns);
    }

    /// Positions of the tracks that were measured at `stamp_ns`.
    fn measured_at(&self, stamp_ns: i64) -> NearIndex {
        let measured = self.all.iter().filter(|track| track.seen_ns == stamp_ns);
        let outputs = measured.filter_map(|track| track.filter.output_at(stamp_ns));
        let places = outputs.map(|output| [output.mean[0], output.mean[1]]);
        let finite = places.filter(|place| place.iter().all(|value| value.is_finite()));
        NearIndex::new(finite.zip(0..).collect())
    }

    /// New track for every measurement without one that is far enough from the `measured` tracks.
    fn start(
        &mut self,
        parameters: &ManyParameters,
        scan: &Scan,
        measured: &NearIndex,
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
            if measured.is_near(place, parameters.birth_distance) {
                continue;
            }
            let mut track = TargetTrack::new(births.of(column), filter, scan);
            track.judge(parameters);
            assigned[column].id = Some(track.id);
            self.all.push(track);
        }
    }
}

/// # Errors
/// [`Error::Limit`] for more than [`MAX_TARGETS`].
pub fn within(what: &'static str, count: usize) -> Result<(), Error> {
    if count <= MAX_TARGETS {
        return Ok(());
    }
    let (what, limit) = (format!("{count} {what}"), MAX_TARGETS as u64);
    Err(Error::Limit { what, limit, key: "leave clutter out before" })
}
