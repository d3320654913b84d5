//! Track before detect: targets of one or two returns per scan, and targets beyond the range of the map.
//!
//! Such a target cannot be detected in one scan. Its returns are alone in the air: earlier scans saw past its place,
//! and nothing else returns beside it. Hypotheses of targets with nearly constant velocity are weighed with the
//! returns of up to some seconds. The evidence of a return is its likelihood ratio: caused by the target, or by
//! chance, given the other lone returns around it.
//!
//! Source of the method: Blackman & Popoli, "Design and Analysis of Modern Tracking Systems", 1999, sec. 6.2 (track
//! score). Here the density of false returns is measured around every return.

mod hypothesis;
mod lone_returns;
mod seen_ranges;

use crate::Error;
use crate::flying::classify::clusters::Clusters;
use crate::flying::classify::parameters::ClassifyParameters;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::scan::prepared::Prepared;
use crate::flying::track::FoundTarget;
use crate::geometry::transform::{minus, norm};
use crate::util::full_state::impossible;
use hypothesis::{FirstReturn, Hypothesis};
use lone_returns::{LoneReturn, LoneReturns};
use seen_ranges::SeenRanges;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::f64::consts::PI;

/// Time of the earlier scans whose lone returns show how many come by chance [s].
const WINDOW: f64 = 2.0;
/// Largest time between the two returns with which a hypothesis begins [s]; alternatively `PAIR_SCANS`, in scans.
const PAIR_TIME: f64 = 0.55;
const PAIR_SCANS: usize = 2;
/// Largest speed with which a hypothesis begins [m/s].
const MOST_SPEED: f64 = 30.0;
/// Number of lone returns in a scan above which no hypothesis begins: they are rain, dust or leaves.
const MOST_RETURNS: usize = 400;
/// Largest number of hypotheses that continue to the next scan.
const MOST_HYPOTHESES: usize = 400;
/// Largest number of earlier scans that are used.
const MOST_SCANS: usize = 40;
/// Returns within this distance of a track, plus three standard deviations of the return, belong to the track [m].
const OF_TRACK: f64 = 1.5;
/// Radius of the ball in which lone returns are counted [m]; the second constant: in distances between rays.
const AROUND: f64 = 8.0;
const AROUND_GAPS: f64 = 10.0;
/// Score from which on a hypothesis keeps its return for itself: no other hypothesis may use it.
const HOLDS: f64 = 4.0;

/// A scan, as input of the search for targets of few returns.
pub(crate) struct ScanOfFew<'a> {
    pub(crate) scan: &'a Prepared,
    pub(crate) map: &'a VoxelMap,
    pub(crate) clusters: &'a Clusters,
    pub(crate) parameters: &'a ClassifyParameters,
    /// Largest distance of the targets that the search finds [m].
    pub(crate) max_distance: f64,
    pub(crate) stamp_ns: i64,
}

/// Lone returns of one scan: time, position of the sensor, and places [m].
#[derive(Clone, Debug, Serialize, Deserialize)]
struct ReturnsOfScan {
    stamp_ns: i64,
    origin: [f64; 3],
    places: Vec<[f64; 3]>,
}

impl ReturnsOfScan {
    /// True if a scan can have given these values. Checks a saved state.
    fn is_possible(&self) -> bool {
        self.places.iter().flatten().chain(&self.origin).all(|value| value.is_finite())
    }
}

/// Number of lone returns around a place.
struct Clutter {
    count: usize,
    /// Volume in which they were counted, summed over the scans [m^3].
    volume: f64,
}

impl Clutter {
    /// Density of lone returns by chance in a scan [1/m^3], if `own` of the counted returns belong to the target
    /// itself.
    fn without(&self, own: u32) -> f64 {
        (self.count.saturating_sub(own as usize) as f64 + 1.0) / self.volume
    }
}

/// Hypotheses of targets that no single scan detects.
#[derive(Default)]
pub(crate) struct TrackBeforeDetect {
    seen: SeenRanges,
    returns: VecDeque<ReturnsOfScan>,
    hypotheses: Vec<Hypothesis>,
    /// Lone returns of the newest scan. Its memory is used again for the next scan.
    lone: LoneReturns,
}

/// State of [`TrackBeforeDetect`] between two scans.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct SavedTrackBeforeDetect {
    seen: SeenRanges,
    returns: VecDeque<ReturnsOfScan>,
    hypotheses: Vec<Hypothesis>,
}

impl TrackBeforeDetect {
    /// Find the lone returns of a scan, and store how far its rays reach.
    pub(crate) fn look(&mut self, input: &ScanOfFew<'_>) {
        let seen_scan = self.lone.find(input, &self.seen);
        self.seen.push(input.stamp_ns, seen_scan);
    }

    /// Whether the point `row` of the newest scan belongs to a lone return.
    pub(crate) fn is_lone(&self, row: u32) -> bool {
        self.lone.holds(row)
    }

    /// Weigh all hypotheses with the newest scan. Returns the targets of the hypotheses that are now certain, and
    /// removes these hypotheses.
    ///
    /// `tracked`: positions of tracks [m]. Returns near them belong to the tracks.
    pub(crate) fn weigh(
        &mut self,
        input: &ScanOfFew<'_>,
        tracked: &[[f64; 3]],
    ) -> Vec<FoundTarget> {
        let found = std::mem::take(&mut self.lone.found);
        let certain =
            self.weigh_found(&found, input.stamp_ns, input.scan.pose.translation, tracked);
        self.lone.found = found;
        certain
    }

    /// Like [`Self::weigh`], with the lone returns of a scan from the sensor position `origin` [m].
    fn weigh_found(
        &mut self,
        found: &[LoneReturn],
        stamp_ns: i64,
        origin: [f64; 3],
        tracked: &[[f64; 3]],
    ) -> Vec<FoundTarget> {
        let is_free = |found: &&LoneReturn| {
            let reach = OF_TRACK + 3.0 * found.std;
            !tracked.iter().any(|&place| norm(minus(found.place, place)) <= reach)
        };
        let found: Vec<LoneReturn> = found.iter().filter(is_free).copied().collect();
        self.forget(stamp_ns);
        let clutter: Vec<Clutter> = found.iter().map(|one| self.clutter(one)).collect();
        let is_held = self.correct(&found, &clutter, stamp_ns);
        if found.len() <= MOST_RETURNS {
            self.begin(&found, &clutter, &is_held, stamp_ns);
        }
        let places = found.iter().map(|one| one.place).collect();
        self.returns.push_back(ReturnsOfScan { stamp_ns, origin, places });
        let is_tracked = |one: &Hypothesis| {
            tracked.iter().any(|&place| norm(minus(one.position, place)) <= OF_TRACK)
        };
        self.hypotheses.retain(|one| one.may_be(stamp_ns) && !is_tracked(one));
        self.keep_best();
        let (certain, rest) = std::mem::take(&mut self.hypotheses)
            .into_iter()
            .partition(|one| one.is_certain(origin));
        self.hypotheses = rest;
        let certain: Vec<Hypothesis> = certain;
        certain.iter().map(Hypothesis::target).collect()
    }

    fn forget(&mut self, now_ns: i64) {
        let is_old = |one: &ReturnsOfScan| seconds(one.stamp_ns, now_ns) > WINDOW;
        while self.returns.len() >= MOST_SCANS || self.returns.front().is_some_and(is_old) {
            self.returns.pop_front();
        }
    }

    /// Count the lone returns around one of them.
    fn clutter(&self, found: &LoneReturn) -> Clutter {
        let radius = AROUND.max(AROUND_GAPS * found.gap);
        let is_near = |place: &&[f64; 3]| norm(minus(**place, found.place)) <= radius;
        let count = |one: &ReturnsOfScan| one.places.iter().filter(is_near).count();
        let volume = 4.0 / 3.0 * PI * radius * radius * radius;
        Clutter {
            count: self.returns.iter().map(count).sum(),
            volume: self.returns.len().max(1) as f64 * volume,
        }
    }

    /// Predict all hypotheses to the scan, and assign to each the return that fits best, highest score first. Well
    /// established hypotheses keep their return for themselves. Returns whether each return is kept like this.
    fn correct(&mut self, found: &[LoneReturn], clutter: &[Clutter], stamp_ns: i64) -> Vec<bool> {
        self.hypotheses.sort_by(|one, other| other.score.total_cmp(&one.score));
        let mut is_held = vec![false; found.len()];
        for hypothesis in &mut self.hypotheses {
            hypothesis.predict(stamp_ns);
            let fit = |index: usize| {
                let cost = hypothesis.cost(&found[index])?;
                (!is_held[index]).then_some((cost, index))
            };
            let best =
                (0..found.len()).filter_map(fit).min_by(|one, other| one.0.total_cmp(&other.0));
            match best {
                Some((_, index)) => {
                    is_held[index] = hypothesis.score >= HOLDS;
                    hypothesis.correct(&found[index], &clutter[index]);
                }
                None if self.seen.is_clear_in_last(hypothesis.position) => hypothesis.miss(),
                None => {}
            }
        }
        is_held
    }

    /// Begin hypotheses from pairs of returns.
    fn begin(
        &mut self,
        found: &[LoneReturn],
        clutter: &[Clutter],
        is_held: &[bool],
        stamp_ns: i64,
    ) {
        let mut begun = Vec::new();
        for ((one, around), _) in
            found.iter().zip(clutter).zip(is_held).filter(|(_, is_held)| !**is_held)
        {
            for (back, earlier) in self.returns.iter().rev().enumerate() {
                let time = seconds(earlier.stamp_ns, stamp_ns);
                if time <= 0.0 || (time > PAIR_TIME && back >= PAIR_SCANS) {
                    continue;
                }
                let reach = MOST_SPEED * time;
                let ReturnsOfScan { stamp_ns: first_ns, origin, ref places } = *earlier;
                for &place in places {
                    if norm(minus(one.place, place)) <= reach {
                        let first = FirstReturn { place, origin, stamp_ns: first_ns, missed: back };
                        begun.extend(Hypothesis::of_pair(&first, one, stamp_ns, around));
                    }
                }
            }
        }
        self.hypotheses.extend(begun);
    }

    /// Of several hypotheses of the same target, keep only the one with the highest score.
    fn keep_best(&mut self) {
        let mut all = std::mem::take(&mut self.hypotheses);
        all.sort_by(|one, other| other.score.total_cmp(&one.score));
        for one in all {
            if self.hypotheses.len() >= MOST_HYPOTHESES {
                break;
            }
            if !self.hypotheses.iter().any(|better| better.is_same(&one)) {
                self.hypotheses.push(one);
            }
        }
    }

    /// Forget everything, because the map has another origin.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }

    pub(crate) fn saved(&self) -> SavedTrackBeforeDetect {
        let Self { seen, returns, hypotheses, .. } = self;
        let (seen, returns, hypotheses) = (seen.clone(), returns.clone(), hypotheses.clone());
        SavedTrackBeforeDetect { seen, returns, hypotheses }
    }

    /// The stage of a saved state.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no scans leave.
    pub(crate) fn restored(saved: SavedTrackBeforeDetect) -> Result<Self, Error> {
        let SavedTrackBeforeDetect { seen, returns, hypotheses } = saved;
        let is_possible = seen.is_possible()
            && returns.iter().all(ReturnsOfScan::is_possible)
            && hypotheses.iter().all(Hypothesis::is_possible);
        if !is_possible {
            return Err(impossible("impossible positions of lone returns"));
        }
        Ok(Self { seen, returns, hypotheses, lone: LoneReturns::default() })
    }
}

/// Time from one stamp to another [s]. The stamps of a damaged state may be any time apart.
fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    (i128::from(to_ns) - i128::from(from_ns)) as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Weigh the lone returns of 40 scans, ten per second, from a sensor at `origin(t)` [m]. Returns the number of
    /// targets that become certain, the number of the scan in which the first does, and that target.
    fn certain(
        origin: impl Fn(f64) -> [f64; 3],
        returns: impl Fn(f64) -> Vec<[f64; 3]>,
    ) -> (usize, Option<usize>, Option<FoundTarget>) {
        let (mut stage, mut count, mut first, mut target) =
            (TrackBeforeDetect::default(), 0, None, None);
        for scan in 0..40 {
            let t = scan as f64 * 0.1;
            let lone = |place: [f64; 3]| {
                let span = minus(place, origin(t));
                let elevation = libm::asin(span[2] / norm(span));
                LoneReturn { place, delay: 0.0, std: 0.15, gap: 0.4, elevation }
            };
            let found: Vec<LoneReturn> = returns(t).into_iter().map(lone).collect();
            let stamp_ns = scan as i64 * 100_000_000;
            let more = stage.weigh_found(&found, stamp_ns, origin(t), &[]);
            if let Some(one) = more.first() {
                (first, target) = (first.or(Some(scan)), target.or(Some(*one)));
            }
            count += more.len();
        }
        (count, first, target)
    }

    const AT_REST: fn(f64) -> [f64; 3] = |_| [0.0; 3];
    const DRIVES: fn(f64) -> [f64; 3] = |t| [9.0 * t, 0.0, 0.0];

    /// Error of a return, different in every scan, up to 0.15 m.
    fn error(t: f64) -> f64 {
        0.15 * libm::sin(137.0 * t + 1.0)
    }

    #[test]
    fn a_target_of_one_return_in_every_second_scan_is_found() {
        let target = |t: f64| {
            let is_met = (t * 10.0).round() as i64 % 2 == 0;
            let up = 6.0 + 2.0 * error(3.0 * t); // rays meet it up to 0.3 m from its centre
            let place = [25.0 + error(t), -4.0 + 5.0 * t + error(2.0 * t), up];
            if is_met { vec![place] } else { Vec::new() }
        };
        for origin in [AT_REST, |t| [0.0, 2.0 * t, 0.0]] {
            let (count, first, found) = certain(origin, target);
            assert!(count >= 1 && first.is_some_and(|scan| scan <= 24), "{count} {first:?}");
            let Some(found) = found else { return };
            let std = found.covariance.map(|value| value.max(0.0).sqrt());
            assert!((found.velocity[1] - 5.0).abs() < 3.0 * std[2], "{found:?}");
            assert!(found.velocity[0].abs() < 3.0 * std[2], "{found:?}");
        }
    }

    #[test]
    fn what_stands_is_no_target() {
        let place = |t: f64| vec![[25.0 + error(t), error(2.0 * t), 6.0 + error(3.0 * t)]];
        assert_eq!(certain(AT_REST, place).0, 0);
        assert_eq!(certain(DRIVES, place).0, 0);
    }

    #[test]
    fn where_a_row_of_a_moving_sensor_meets_a_pole_nothing_flies() {
        // A row at 11 degrees; the sensor drives towards a pole, or towards a cable that rises to one side.
        let up = libm::tan(11.0_f64.to_radians());
        let pole = |t: f64| vec![[60.0, 1.0, up * libm::hypot(60.0 - 9.0 * t, 1.0)]];
        assert_eq!(certain(DRIVES, pole).0, 0);
        let cable = |t: f64| {
            let away = 60.0 - 9.0 * t;
            let aside = (up * away - 4.0) / (0.5 - up * 0.2); // about where it is as high as the row
            vec![[60.0, aside, up * libm::hypot(away, aside)]]
        };
        assert_eq!(certain(DRIVES, cable).0, 0);
        // Seen at rest, something that rises does fly.
        let rises = |t: f64| vec![[30.0 + error(t), 1.0 + error(2.0 * t), 4.0 + 3.0 * t]];
        assert!(certain(AT_REST, rises).0 >= 1);
    }

    #[test]
    fn returns_by_chance_are_no_target() {
        let mut state = 1_u64;
        let mut number = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        for per_scan in [3, 30, 150] {
            let mut scans: Vec<Vec<[f64; 3]>> = Vec::new();
            for _ in 0..40 {
                let place =
                    |_| [20.0 + 40.0 * number(), 60.0 * number() - 30.0, 4.0 + 12.0 * number()];
                scans.push((0..per_scan).map(place).collect());
            }
            let (count, ..) = certain(AT_REST, |t| scans[(t * 10.0).round() as usize].clone());
            assert_eq!(count, 0, "{per_scan} in every scan");
        }
    }

    #[test]
    fn what_is_near_a_track_is_its_own() {
        let mut stage = TrackBeforeDetect::default();
        for scan in 0..30 {
            let place = [25.0, 0.5 * f64::from(scan), 6.0];
            let lone = LoneReturn { place, delay: 0.0, std: 0.15, gap: 0.4, elevation: 0.2 };
            let found =
                stage.weigh_found(&[lone], i64::from(scan) * 100_000_000, [0.0; 3], &[place]);
            assert!(found.is_empty() && stage.hypotheses.is_empty());
        }
    }

    #[test]
    fn a_state_without_places_is_refused() {
        let saved = |origin: [f64; 3], place: [f64; 3]| SavedTrackBeforeDetect {
            returns: VecDeque::from([ReturnsOfScan { stamp_ns: 0, origin, places: vec![place] }]),
            ..SavedTrackBeforeDetect::default()
        };
        let bad = [0.0, f64::NAN, 1.0];
        assert!(TrackBeforeDetect::restored(saved([0.0; 3], [1.0; 3])).is_ok());
        assert!(TrackBeforeDetect::restored(saved([0.0; 3], bad)).is_err());
        assert!(TrackBeforeDetect::restored(saved(bad, [1.0; 3])).is_err());
    }
}
