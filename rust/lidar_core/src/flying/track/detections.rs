//! newDetections of Algorithm 2: hypotheses, replay of buffered clouds, association with tracks.

use super::belief::existence::SURE;
use super::belief::kinds::TargetShape;
use super::buffer::Buffer;
use super::lifecycle::is_part;
use super::measurement::{CloudScan, Evidence, Measurement};
use super::motion::{position, position_block, position_matrix};
use super::parameters::{
    Association, Confirmation, MAX_TRACKS, MeasurementForm, Motion, TrackerParameters,
};
use super::state::PointTrack;
use super::update::Updater;
use super::visibility::occupancy::Occupancy;
use crate::Error;
use crate::estimation::kalman::{self, Gaussian, symmetrised};
use nalgebra::{Matrix3, Vector3};

/// No scan takes longer [s].
const MAX_DELAY: f64 = 10.0;

/// Detections of one time, in the tracker's frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Detections<'a> {
    /// Time they describe [ns].
    pub stamp_ns: i64,
    /// Positions [m].
    pub positions: &'a [[f64; 3]],
    /// Covariance of every position [m^2]; without it the parameters' initial one is taken.
    pub covariance: Option<&'a [[[f64; 3]; 3]]>,
    /// Sides of their bounding boxes [m].
    pub extent: Option<&'a [[f64; 3]]>,
    /// When each position was measured, after the stamp [s].
    pub delay: Option<&'a [f64]>,
    /// Confidence of each detection, 0 to 1; without it none is certain.
    pub confidence: Option<&'a [f64]>,
    /// Whether each may be a part of a surface beside it; without it none is.
    pub is_joined: Option<&'a [bool]>,
    /// Whether more returns of surfaces lie around each than it has itself; without it around none.
    pub is_among_surfaces: Option<&'a [bool]>,
    /// Size and filling of each; without it nothing is known of them.
    pub shape: Option<&'a [TargetShape]>,
}

impl Detections<'_> {
    /// One hypothesis per detection, in order.
    ///
    /// # Errors
    /// [`Error::Limit`], [`Error::Length`], or [`Error::Value`] for the first bad entry.
    pub(super) fn hypotheses(
        &self,
        parameters: &TrackerParameters,
    ) -> Result<Vec<PointTrack>, Error> {
        let count = self.positions.len();
        if count > MAX_TRACKS {
            return Err(too_many(count));
        }
        let lengths = [
            ("covariance", self.covariance.map(<[_]>::len)),
            ("extent", self.extent.map(<[_]>::len)),
            ("delay", self.delay.map(<[_]>::len)),
            ("confidence", self.confidence.map(<[_]>::len)),
            ("is_joined", self.is_joined.map(<[_]>::len)),
            ("is_among_surfaces", self.is_among_surfaces.map(<[_]>::len)),
            ("shape", self.shape.map(<[_]>::len)),
        ];
        for (name, length) in lengths {
            if let Some(got) = length.filter(|&length| length != count) {
                return Err(Error::Length { name, expected: count, got });
            }
        }
        (0..count)
            .map(|index| {
                let detection = self.measurement(index, parameters)?;
                let mut fresh = PointTrack::new(&detection, self.stamp_ns, parameters);
                fresh.first = Evidence {
                    is_sure: self.confidence.is_some_and(|confidence| confidence[index] >= SURE),
                    is_led: self.confidence.is_some_and(|confidence| confidence[index] <= 0.0),
                    is_among_surfaces: self.is_among_surfaces.is_some_and(|among| among[index]),
                    is_joined: self.is_joined.is_some_and(|joined| joined[index]),
                    shape: self.shape.map(|shape| shape[index]),
                };
                Ok(fresh)
            })
            .collect()
    }

    fn measurement(
        &self,
        index: usize,
        parameters: &TrackerParameters,
    ) -> Result<Measurement, Error> {
        let position = self.positions[index];
        let extent = self.extent.map_or([0.0; 3], |extent| extent[index]);
        let covariance = match self.covariance {
            Some(covariance) => known_covariance(&covariance[index], parameters),
            None => Matrix3::identity() * (parameters.initial_std[0] * parameters.initial_std[0]),
        };
        let is_finite = |values: [f64; 3]| values.iter().all(|value| value.is_finite());
        let bad = |name, expected, got| Err(Error::Value { name, expected, index, got });
        if !is_finite(position) {
            return bad("positions", "finite coordinates", format!("{position:?}"));
        }
        let delay = match parameters.measurement {
            MeasurementForm::Paper => 0.0,
            MeasurementForm::Cluster | MeasurementForm::Center => {
                self.delay.map_or(0.0, |delay| delay[index])
            }
        };
        if !(-MAX_DELAY..=MAX_DELAY).contains(&delay) {
            return bad("delay", "at most 10 s", delay.to_string());
        }
        if !is_finite(extent) || extent.iter().any(|&side| side < 0.0) {
            return bad("extent", "finite sides >= 0", format!("{extent:?}"));
        }
        if covariance.cholesky().is_none() || covariance != covariance.transpose() {
            let got = format!("{:?}", self.covariance.map_or([[0.0; 3]; 3], |all| all[index]));
            return bad("covariance", "a symmetric positive definite matrix", got);
        }
        let position = Vector3::from(position);
        let (n_points, is_cut, row) = (0, false, None);
        Ok(Measurement { position, covariance, delay, extent, n_points, is_cut, row })
    }
}

pub(super) fn too_many(count: usize) -> Error {
    Error::Limit {
        what: format!("a set of {count} detections or tracks"),
        limit: MAX_TRACKS as u64,
        key: "split the set",
    }
}

/// Sec. III-F3 takes it as it is, and a centre's own is whole; to a centroid's comes what clusters
/// are not told about.
fn known_covariance(rows: &[[f64; 3]; 3], parameters: &TrackerParameters) -> Matrix3<f64> {
    let given = Matrix3::from_fn(|row, column| rows[row][column]);
    match parameters.measurement {
        MeasurementForm::Paper | MeasurementForm::Center => given,
        MeasurementForm::Cluster => {
            given + Matrix3::identity() * (parameters.measurement_std * parameters.measurement_std)
        }
    }
}

/// Which track every set of detections fed.
#[derive(Debug, Default)]
pub(super) struct Matches {
    /// Places in the list of tracks, in the order of the detections, and what these tell.
    pub(super) fed: Vec<(usize, Evidence)>,
    pub(super) rejected: usize,
}

/// A target that turned while it was not seen is this share of the way that it may have flown from
/// where it was seen, as a standard deviation.
const LOITER_SHARE: f64 = 0.5;

/// A track to which detections can be assigned.
struct PendingTrack {
    track: PointTrack,
    /// Detections further away are not its own [m].
    reach: f64,
    /// A target that is lost may have gone on as predicted, or it may have turned: then it is this
    /// far from where it was seen, as a standard deviation [m].
    strayed: Option<f64>,
}

impl PendingTrack {
    /// Largest distance of its detections from where it is predicted [m].
    fn furthest(&self) -> f64 {
        let turned =
            self.strayed.map_or(0.0, |_| (self.track.position() - self.track.seen_at).norm());
        self.reach + turned
    }

    /// Difference to a detection and its covariance, of the more probable of the places where the
    /// target may be; None if the detection is out of reach.
    fn offset(&self, detection: &MeasuredPlace) -> Option<Offset> {
        match (self.if_ahead(detection), self.if_turned(detection)) {
            (Some(one), Some(other)) if cost(&other) < cost(&one) => Some(other),
            (one, other) => one.or(other),
        }
    }

    #[allow(non_snake_case)] // textbook letters
    fn if_ahead(&self, detection: &MeasuredPlace) -> Option<Offset> {
        let H = position_matrix(detection.delay);
        let covariance = symmetrised(H * self.track.estimate.covariance * H.transpose());
        self.offset_to(self.track.position_after(detection.delay), covariance, detection)
    }

    /// As if the target had turned since it was seen.
    fn if_turned(&self, detection: &MeasuredPlace) -> Option<Offset> {
        let std = self.strayed?;
        self.offset_to(self.track.seen_at, Matrix3::identity() * (std * std), detection)
    }

    fn offset_to(
        &self,
        place: Vector3<f64>,
        covariance: Matrix3<f64>,
        detection: &MeasuredPlace,
    ) -> Option<Offset> {
        let y = detection.position - place;
        (y.norm() <= self.reach).then_some((y, detection.covariance + covariance))
    }

    /// The track after a turn that led to a detection: its motion is not known any more. None if the
    /// target went on as predicted.
    fn turned_to(&self, found: &PointTrack, model: &Motion) -> Option<PointTrack> {
        let mut found = found.clone();
        found.predict(found.stamp_ns.max(self.track.stamp_ns), model);
        let place = MeasuredPlace::at_stamp(&found.estimate);
        let turned = cost(&self.if_turned(&place)?);
        let is_turned = self.if_ahead(&place).is_none_or(|one| turned < cost(&one));
        let PointTrack { estimate, aged, stamp_ns, seen_ns, seen_at, extent, .. } = found;
        let known = self.track.clone();
        is_turned.then_some(PointTrack {
            estimate,
            aged,
            stamp_ns,
            seen_ns,
            seen_at,
            extent,
            ..known
        })
    }
}

/// Where a hypothesis is at a time after its stamp.
struct MeasuredPlace {
    position: Vector3<f64>,
    covariance: Matrix3<f64>,
    /// Time after the stamp [s].
    delay: f64,
}

impl MeasuredPlace {
    fn at_stamp(estimate: &Gaussian<9>) -> Self {
        let covariance = position_block(&estimate.covariance);
        Self { position: position(estimate), covariance, delay: 0.0 }
    }

    /// Of a fresh detection at the time when it was measured: where it was at the stamp of its scan,
    /// before that, nobody knows without its velocity. A target of 30 m/s moves by metres meanwhile.
    fn of(hypothesis: &PointTrack, velocity_std: f64) -> Self {
        let at_stamp = Self::at_stamp(&hypothesis.estimate);
        if hypothesis.stamp_ns != hypothesis.born_ns || hypothesis.delay == 0.0 {
            return at_stamp;
        }
        // What its unknown velocity adds to the place at the stamp is taken off.
        let unknown = (hypothesis.delay * velocity_std).powi(2);
        let covariance = at_stamp.covariance - Matrix3::identity() * unknown;
        Self { position: hypothesis.born_at, covariance, delay: hypothesis.delay }
    }
}

/// A difference and its covariance.
type Offset = (Vector3<f64>, Matrix3<f64>);

/// -2 ln of the likelihood of a difference, without what all share.
fn cost((y, covariance): &Offset) -> f64 {
    kalman::mahalanobis(y, covariance)
        .map_or(f64::INFINITY, |distance| distance.squared + distance.log_determinant)
}

impl Updater {
    /// Bring hypotheses to the present, over the buffered clouds newer than they are.
    ///
    /// # Source
    /// Vrba et al., Algorithm 2, lines 22-25.
    pub(super) fn replay(
        &self,
        mut hypotheses: Vec<PointTrack>,
        stamp_ns: i64,
        buffer: &Buffer,
        occupied: &dyn Occupancy,
    ) -> Result<Vec<PointTrack>, Error> {
        for cloud in buffer.newer_than(stamp_ns) {
            let scan = CloudScan {
                points: &cloud.points,
                delays: cloud.delays.as_deref(),
                stamp_ns: cloud.stamp_ns,
                occupied,
                visibility: None,
            };
            self.update(&mut hypotheses, &scan)?;
        }
        let radius = &self.parameters.radius;
        hypotheses.retain(|hypothesis| hypothesis.radius(radius) <= radius.max);
        Ok(hypotheses)
    }

    /// Give every hypothesis to a track, or make it one; the newest scan is of `scanned_ns`.
    pub(super) fn join(
        &self,
        tracks: &mut Vec<PointTrack>,
        hypotheses: Vec<PointTrack>,
        scanned_ns: Option<i64>,
    ) -> Result<Matches, Error> {
        match self.parameters.association {
            Association::Paper => Ok(self.join_nearest(tracks, hypotheses)),
            Association::Global { .. } => self.join_one_to_one(tracks, hypotheses, scanned_ns),
        }
    }

    /// Source: Vrba et al., Algorithm 2, lines 26-30; the nearest of the similar tracks counts.
    fn join_nearest(&self, tracks: &mut Vec<PointTrack>, hypotheses: Vec<PointTrack>) -> Matches {
        let radius = &self.parameters.radius;
        let mut matches = Matches::default();
        for hypothesis in hypotheses {
            let distance = |track: &PointTrack| (track.position() - hypothesis.position()).norm();
            let reach = hypothesis.radius(radius);
            let nearest = (0..tracks.len())
                .filter(|&index| distance(&tracks[index]) <= tracks[index].radius(radius) + reach)
                .min_by(|&one, &other| distance(&tracks[one]).total_cmp(&distance(&tracks[other])));
            match nearest {
                Some(index) => {
                    tracks[index].n_detections = tracks[index].n_detections.saturating_add(1);
                    matches.fed.push((index, hypothesis.first));
                }
                None => tracks.push(hypothesis),
            }
        }
        matches
    }

    fn join_one_to_one(
        &self,
        tracks: &mut Vec<PointTrack>,
        hypotheses: Vec<PointTrack>,
        scanned_ns: Option<i64>,
    ) -> Result<Matches, Error> {
        let model = &self.parameters.motion;
        // All hypotheses have one time; tracks behind it are brought there.
        let Some(now_ns) = hypotheses.first().map(|hypothesis| hypothesis.stamp_ns) else {
            return Ok(Matches::default());
        };
        let waiting: Vec<PendingTrack> =
            tracks.iter().map(|track| self.waiting(track, now_ns, scanned_ns)).collect();
        // Where a hypothesis is moved to the time of a track, it may go anywhere.
        let is_ahead = waiting.iter().any(|one| one.track.stamp_ns > now_ns);
        let furthest = waiting.iter().map(PendingTrack::furthest).fold(0.0, f64::max);
        let reach = if is_ahead { f64::INFINITY } else { furthest };
        let velocity_std = self.parameters.initial_std[1];
        let places: Vec<MeasuredPlace> =
            hypotheses.iter().map(|one| MeasuredPlace::of(one, velocity_std)).collect();
        let latest = places.iter().map(|place| place.delay.abs()).fold(0.0, f64::max);
        let fastest = waiting.iter().map(|one| one.track.velocity().norm()).fold(0.0, f64::max);
        let reach = reach + latest * fastest;
        let rows = places.iter().map(|place| place.position);
        let columns = waiting.iter().map(|one| one.track.position());
        let track_of = self.assign(rows, columns, reach, |row, column| {
            let (hypothesis, waiting) = (&hypotheses[row], &waiting[column]);
            let is_behind = waiting.track.stamp_ns > now_ns;
            let reached = is_behind.then(|| hypothesis.at(waiting.track.stamp_ns, model));
            match reached {
                Some(estimate) => waiting.offset(&MeasuredPlace::at_stamp(&estimate)),
                None => waiting.offset(&places[row]),
            }
        })?;
        Ok(self.feed(tracks, &waiting, hypotheses, &track_of))
    }

    /// A track as it waits for detections of `now_ns`: it looks further if it was not found in the
    /// newest scan.
    fn waiting(&self, track: &PointTrack, now_ns: i64, scanned_ns: Option<i64>) -> PendingTrack {
        let is_lost = scanned_ns.is_some_and(|scanned_ns| track.seen_ns < scanned_ns);
        let mut waiting = track.clone();
        waiting.predict(track.stamp_ns.max(now_ns), &self.parameters.motion);
        match self.parameters.rejoin_acceleration {
            Some(acceleration) if track.confirmed && is_lost => {
                let std = self.parameters.initial_std[0];
                waiting.widen(acceleration, std);
                let strayed = std + LOITER_SHARE * waiting.distance_flown();
                let reach = self.parameters.radius.max;
                PendingTrack { track: waiting, reach, strayed: Some(strayed) }
            }
            _ => PendingTrack { track: waiting, reach: self.search_radius(track), strayed: None },
        }
    }

    /// Give every hypothesis to its track; those that have none become tracks.
    fn feed(
        &self,
        tracks: &mut Vec<PointTrack>,
        waiting: &[PendingTrack],
        hypotheses: Vec<PointTrack>,
        track_of: &[Option<usize>],
    ) -> Matches {
        let known = tracks.len();
        let mut matches = Matches::default();
        for (hypothesis, track) in hypotheses.into_iter().zip(track_of) {
            let Some(index) = *track else {
                if !self.is_seen_twice(&hypothesis, &tracks[..known]) {
                    let fast = self.fast_pair(&hypothesis, &tracks[..known]);
                    tracks.push(hypothesis);
                    tracks.extend(fast);
                }
                continue;
            };
            matches.fed.push((index, hypothesis.first));
            // What the track has not seen itself, it learns from the hypothesis.
            if tracks[index].seen_ns < hypothesis.born_ns {
                let turned = waiting[index].turned_to(&hypothesis, &self.parameters.motion);
                let is_turned = turned.is_some();
                tracks[index] = turned.unwrap_or_else(|| waiting[index].track.clone());
                let is_known = is_turned || self.learn(&mut tracks[index], hypothesis);
                matches.rejected += usize::from(!is_known);
            }
            let track = &mut tracks[index];
            track.n_detections = track.n_detections.saturating_add(1);
        }
        matches
    }

    /// True if the hypothesis is the target of a track once more: a rolling scan may meet a target
    /// at its start and again at its end, partly at least. No further away than a gap inside a
    /// cluster, or beside the box of a large target, of which it is a part.
    fn is_seen_twice(&self, hypothesis: &PointTrack, tracks: &[PointTrack]) -> bool {
        let model = &self.parameters.motion;
        let is_fresh = hypothesis.stamp_ns == hypothesis.born_ns;
        let delay = if is_fresh { hypothesis.delay } else { 0.0 };
        tracks.iter().any(|track| {
            let expected = position_matrix(delay) * track.at(hypothesis.stamp_ns, model).mean;
            let away = (hypothesis.position() - expected).norm();
            away <= self.parameters.clustering.max_distance
                || (self.parameters.merging.is_some()
                    && track.confirmed
                    && track.stamp_ns == hypothesis.stamp_ns
                    && is_part(track, hypothesis))
        })
    }

    /// A track of a detection and one before it that is too far away for the gate of a new track: a
    /// target so fast that it was seen once in each of two places. None where tracks are confirmed by
    /// counts.
    fn fast_pair(&self, hypothesis: &PointTrack, tracks: &[PointTrack]) -> Option<PointTrack> {
        let Confirmation::Existence { .. } = self.parameters.confirmation else { return None };
        let pairs = tracks.iter().filter_map(|track| Some((hypothesis.way_from(track)?, track)));
        let nearest = pairs.min_by(|(one, _), (other, _)| one.length().total_cmp(&other.length()));
        nearest.map(|(way, track)| hypothesis.paired(track, &way, self.parameters.initial_std[2]))
    }

    fn learn(&self, track: &mut PointTrack, mut hypothesis: PointTrack) -> bool {
        let model = &self.parameters.motion;
        let stamp_ns = hypothesis.stamp_ns.max(track.stamp_ns);
        track.predict(stamp_ns, model);
        let is_now = hypothesis.stamp_ns == stamp_ns;
        hypothesis.predict(stamp_ns, model);
        let place = if is_now {
            MeasuredPlace::of(&hypothesis, self.parameters.initial_std[1])
        } else {
            MeasuredPlace::at_stamp(&hypothesis.estimate)
        };
        let measurement = Measurement {
            position: place.position,
            covariance: place.covariance,
            delay: place.delay,
            extent: hypothesis.extent,
            n_points: 0,
            is_cut: false,
            row: None,
        };
        track.correct(&measurement).is_ok()
    }
}
