//! Many targets: measurements assigned to tracks, births, confirmation, deletion.

use super::engine::Output;
use super::filter::{Filter, FusionParameters};
use super::joint::probabilities;
use super::measurement::{Measurement, Sensor};
use super::target::{Life, Outcome};
use crate::Error;
use crate::error::require;
use crate::estimation::association::{Pair, assign};

/// Most tracks at a time, and most measurements of a scan.
pub const MAX_TARGETS: usize = 2_000;
/// Most scanners that are told apart.
pub const MAX_SOURCES: u8 = 64;
/// What it costs to leave a track without a measurement that its gate lets through: far more
/// than any pair, so that as many tracks as possible get one.
const UNASSIGNED: f64 = 1e6;

/// Everything a tracker of many targets can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ManyParameters {
    /// The filter of each; its gate decides which measurements may belong to a track.
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
    /// By the probabilities of all ways of sharing them out: [`probabilities`].
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

impl Association {
    /// The filter of `track` after a measurement within its gate, and what the pair costs.
    fn corrected(&self, track: &Track, m: &Measurement) -> Option<(Filter, f64)> {
        let mut filter = track.filter.clone();
        let (outcome, innovation) = filter.take(m);
        let innovation = innovation.filter(|_| outcome == Outcome::Updated)?;
        let distance = innovation.nis + innovation.log_determinant;
        let cost = match self {
            Self::Nearest => distance,
            Self::Joint { detection, clutter } => {
                let constant = innovation.count as f64 * libm::log(std::f64::consts::TAU);
                let density = clutter[usize::from(m.sensor() == Sensor::Radar)];
                0.5 * (distance + constant) + libm::log(density * (1.0 - detection) / detection)
            }
        };
        cost.is_finite().then_some((filter, cost))
    }
}

#[derive(Clone)]
struct Track {
    id: i64,
    filter: Filter,
    /// Bit per scan of scanners that have seen it, the last one lowest: was it measured?
    history: u64,
    looks: u32,
    sources: u64,
    born_ns: i64,
    seen_ns: i64,
    hits: u32,
    confirmed: bool,
}

/// Tracks of many targets.
#[derive(Clone)]
pub struct ManyTargets {
    parameters: ManyParameters,
    /// Knows how the platform moves, and no target.
    unseen: Filter,
    tracks: Vec<Track>,
    next_id: i64,
    stamp_ns: Option<i64>,
}

impl ManyTargets {
    /// A tracker that has seen nothing.
    ///
    /// # Errors
    /// As [`Filter::new`], and [`Error::Parameter`] unless 1 <= `confirm_hits` <=
    /// `confirm_window` <= 64.
    pub fn new(parameters: &ManyParameters) -> Result<Self, Error> {
        let ManyParameters { confirm_hits: hits, confirm_window: window, .. } = *parameters;
        let fits = 1 <= hits && hits <= window && window <= u64::BITS;
        require(fits, "confirm_hits", "1 to confirm_window, at most 64", hits)?;
        let filter = parameters.filter.without_buffer(); // scans come in order
        let filter = FusionParameters { life: Life { loss: None, ..filter.life }, ..filter };
        Ok(Self {
            parameters: ManyParameters { filter, ..*parameters },
            unseen: Filter::new(&filter)?,
            tracks: Vec::new(),
            next_id: 0,
            stamp_ns: None,
        })
    }

    /// Take in what one scanner saw at one time; returns the track of every measurement, none for
    /// those that cannot be used, started nothing, or tell how the platform moves.
    ///
    /// # Errors
    /// [`Error::Time`] for a scan older than the last, [`Error::Value`] for a measurement of
    /// another time, [`Error::Parameter`] for a source of [`MAX_SOURCES`] or more,
    /// [`Error::Limit`] for more than [`MAX_TARGETS`] measurements or tracks. Nothing has changed
    /// then.
    pub fn process(
        &mut self,
        stamp_ns: i64,
        source: u8,
        scan: &[Measurement],
    ) -> Result<Vec<Option<i64>>, Error> {
        self.check(stamp_ns, source, scan)?;
        let mut next = self.clone();
        let numbers = next.take(stamp_ns, source, scan)?;
        *self = next;
        Ok(numbers)
    }

    /// All tracks, carried on to `stamp_ns`, by their numbers; unconfirmed ones included.
    #[must_use]
    pub fn tracks_at(&self, stamp_ns: i64) -> Vec<TrackState> {
        let states = self.tracks.iter().filter_map(|track| {
            let output = track.filter.output_at(stamp_ns)?;
            let Track { id, born_ns, seen_ns, hits, confirmed, .. } = *track;
            Some(TrackState { id, output, born_ns, seen_ns, hits, confirmed })
        });
        states.collect()
    }

    fn check(&self, stamp_ns: i64, source: u8, scan: &[Measurement]) -> Result<(), Error> {
        require(source < MAX_SOURCES, "source", "0 to 63", source)?;
        if let Some(last) = self.stamp_ns.filter(|last| stamp_ns < *last) {
            return Err(Error::Time {
                what: format!(
                    "scan of {stamp_ns} ns, the last one was of {last} ns; give scans in order"
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

    fn take(
        &mut self,
        stamp_ns: i64,
        source: u8,
        scan: &[Measurement],
    ) -> Result<Vec<Option<i64>>, Error> {
        self.stamp_ns = Some(stamp_ns);
        let mut numbers = vec![None; scan.len()];
        for m in scan.iter().filter(|m| is_of_platform(m)) {
            self.unseen.step(m);
            self.tracks.iter_mut().for_each(|track| {
                track.filter.step(m);
            });
        }
        let seen = 1 << source;
        for track in &mut self.tracks {
            if track.sources & seen != 0 {
                track.history <<= 1;
                track.looks += 1;
            }
        }
        for confirmed in [true, false] {
            self.associate(scan, seen, confirmed, &mut numbers)?;
        }
        let (parameters, measured) = (self.parameters, self.measured_at(stamp_ns));
        self.tracks.iter_mut().for_each(|track| track.judge(&parameters));
        self.tracks.retain(|track| track.stays(stamp_ns, &parameters));
        self.start(stamp_ns, seen, scan, &measured, &mut numbers);
        within("tracks", self.tracks.len())?;
        Ok(numbers)
    }

    /// Share out measurements that have no track yet among tracks; by global nearest neighbours
    /// the likelihood of the innovation counts.
    ///
    /// # Source
    /// Bar-Shalom, Li & Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    /// 2001; Blackman & Popoli, "Design and Analysis of Modern Tracking Systems", 1999, sec. 6.4.
    fn associate(
        &mut self,
        scan: &[Measurement],
        seen: u64,
        confirmed: bool,
        numbers: &mut [Option<i64>],
    ) -> Result<(), Error> {
        let (mut pairs, mut updated) = (Vec::new(), Vec::new());
        for (row, track) in self.tracks.iter().enumerate() {
            for (column, m) in scan.iter().enumerate() {
                if track.confirmed != confirmed || numbers[column].is_some() || is_of_platform(m) {
                    continue;
                }
                if let Some((filter, cost)) = self.parameters.association.corrected(track, m) {
                    pairs.push(Pair { row, column, cost });
                    updated.push(filter);
                }
            }
        }
        if let Association::Joint { .. } = self.parameters.association {
            self.associate_jointly(scan, seen, numbers, &pairs);
            return Ok(());
        }
        let column_of = assign(self.tracks.len(), scan.len(), &pairs, UNASSIGNED)?;
        for (Pair { row, column, .. }, filter) in pairs.iter().zip(updated) {
            if column_of[*row] == Some(*column) {
                let track = &mut self.tracks[*row];
                track.filter = filter;
                track.see(scan[*column].stamp_ns(), seen);
                numbers[*column] = Some(track.id);
            }
        }
        Ok(())
    }

    /// Joint probabilistic data association among measurements that have no track yet. One that
    /// is more likely of some track than of none has the likeliest.
    fn associate_jointly(
        &mut self,
        scan: &[Measurement],
        seen: u64,
        numbers: &mut [Option<i64>],
        pairs: &[Pair],
    ) {
        let weights = probabilities(self.tracks.len(), scan.len(), pairs);
        let mut of_track = vec![Vec::new(); self.tracks.len()];
        let mut of_any = vec![(0.0, 0.0, 0); scan.len()]; // sum, largest, its track
        for (Pair { row, column, .. }, weight) in pairs.iter().zip(weights) {
            of_track[*row].push((weight, scan[*column]));
            let (sum, most, best) = &mut of_any[*column];
            *sum += weight;
            if weight > *most {
                (*most, *best) = (weight, self.tracks[*row].id);
            }
        }
        for (number, (sum, _, best)) in numbers.iter_mut().zip(of_any) {
            if sum > 0.5 {
                *number = Some(best);
            }
        }
        for (track, weighted) in self.tracks.iter_mut().zip(of_track) {
            track.absorb(&weighted, seen);
        }
    }

    /// Positions of the tracks that were measured at `stamp_ns`.
    fn measured_at(&self, stamp_ns: i64) -> Vec<[f64; 2]> {
        let measured = self.tracks.iter().filter(|track| track.seen_ns == stamp_ns);
        let outputs = measured.filter_map(|track| track.filter.output_at(stamp_ns));
        outputs.map(|output| [output.mean[0], output.mean[1]]).collect()
    }

    fn start(
        &mut self,
        stamp_ns: i64,
        seen: u64,
        scan: &[Measurement],
        measured: &[[f64; 2]],
        numbers: &mut [Option<i64>],
    ) {
        for (m, number) in scan.iter().zip(numbers) {
            if number.is_some() || is_of_platform(m) {
                continue;
            }
            let mut filter = self.unseen.clone();
            let step = filter.step(m);
            let Some(output) = step.output.filter(|_| step.outcome == Outcome::Started) else {
                continue;
            };
            let [x, y] = [output.mean[0], output.mean[1]];
            let reach = self.parameters.birth_distance;
            if measured.iter().any(|at| libm::hypot(at[0] - x, at[1] - y) < reach) {
                continue;
            }
            let mut track = Track {
                id: self.next_id,
                filter,
                history: 1,
                looks: 1,
                sources: seen,
                born_ns: stamp_ns,
                seen_ns: stamp_ns,
                hits: 1,
                confirmed: false,
            };
            track.judge(&self.parameters);
            *number = Some(self.next_id);
            self.next_id += 1;
            self.tracks.push(track);
        }
    }
}

impl Track {
    fn see(&mut self, stamp_ns: i64, seen: u64) {
        if self.sources & seen == 0 {
            self.history <<= 1; // the first scan of this scanner that counts
            self.looks += 1;
        }
        self.history |= 1;
        self.sources |= seen;
        self.seen_ns = stamp_ns;
        self.hits += 1;
    }

    /// Take in measurements that are of this track with some probability.
    fn absorb(&mut self, weighted: &[(f64, Measurement)], seen: u64) {
        let Some((_, first)) = weighted.first() else { return };
        self.filter.absorb(first.stamp_ns(), weighted);
        if weighted.iter().map(|(weight, _)| weight).sum::<f64>() > 0.5 {
            self.see(first.stamp_ns(), seen);
        }
    }

    /// Measured scans among the last ones that count, and how many these are.
    fn recent(&self, window: u32) -> (u32, u32) {
        let mask = u64::MAX >> (u64::BITS - window);
        ((self.history & mask).count_ones(), self.looks.min(window))
    }

    fn judge(&mut self, parameters: &ManyParameters) {
        let (hits, _) = self.recent(parameters.confirm_window);
        self.confirmed |= hits >= parameters.confirm_hits;
    }

    fn stays(&self, stamp_ns: i64, parameters: &ManyParameters) -> bool {
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

fn is_of_platform(m: &Measurement) -> bool {
    matches!(m.sensor(), Sensor::Gyro | Sensor::Pose)
}

fn within(what: &'static str, count: usize) -> Result<(), Error> {
    if count <= MAX_TARGETS {
        return Ok(());
    }
    let (what, limit) = (format!("{count} {what}"), MAX_TARGETS as u64);
    Err(Error::Limit { what, limit, key: "leave clutter out before" })
}

#[cfg(test)]
mod tests {
    use super::super::filter::{Method, Model, Strengths};
    use super::super::motion::{NoiseForm, Prior};
    use super::super::sensors::Sensing;
    use super::super::target::GyroUse;
    use super::*;

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

    /// The nearest pair alone would leave the second track without a measurement.
    #[test]
    fn as_many_tracks_as_possible_are_measured() -> Result<(), Error> {
        let mut tracker = ManyTargets::new(&parameters()?)?;
        assert_eq!(
            tracker.process(0, 0, &scan(0, &[[0.0, 0.0], [0.6, 0.0]])?)?,
            [Some(0), Some(1)]
        );
        let stamp = 100_000_000;
        let seen = scan(stamp, &[[0.5, 0.0], [1.9, 0.0]])?;
        assert_eq!(tracker.process(stamp, 0, &seen)?, [Some(0), Some(1)]);
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
