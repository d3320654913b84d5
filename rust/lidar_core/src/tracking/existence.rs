//! Joint integrated probabilistic data association: how probable it is that a track follows a
//! target at all, and which measurement is of it.

use super::joint_association::probabilities;
use crate::estimation::assignment::Pair;

/// Largest probability of existence, so that misses can always lower it.
pub const MOST_CERTAIN: f64 = 1.0 - 1e-9;

/// A track before a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prospect {
    /// Probability that the target exists, predicted to the time of the scan.
    pub existence: f64,
    /// Probability that the scan measures the target within its gate if it exists.
    pub detection: f64,
    /// True if the scanner is known to see the place: then a scan without the target counts
    /// against it.
    pub is_in_view: bool,
}

/// A measurement within the gate of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatedPair {
    /// Index of the track.
    pub track: usize,
    /// Index of the measurement.
    pub measurement: usize,
    /// Natural logarithm of the probability density of the measurement as the track predicts it,
    /// over the density of clutter.
    pub log_ratio: f64,
}

/// What a scan says about tracks.
#[derive(Clone, Debug, PartialEq)]
pub struct JointEvidence {
    /// Probability of existence of every track.
    pub existence: Vec<f64>,
    /// Probability of every pair: the target exists, and the measurement is of it.
    pub pair: Vec<f64>,
    /// Probability of every measurement that it is of no track.
    pub unexplained: Vec<f64>,
}

/// Probability of existence after a time without a scan, for targets that stay `lifetime` [s] on
/// average.
#[must_use]
pub fn survived(existence: f64, dt: f64, lifetime: f64) -> f64 {
    existence * libm::exp(-dt.max(0.0) / lifetime)
}

/// Probabilities of existence and association after a scan.
///
/// The events of JPDA, in which a track without a measurement either does not exist or was missed:
/// that has the weight 1 - `detection` * `existence`, a measurement of it has `detection` *
/// `existence` times its ratio. Groups of tracks with common measurements are independent; they are
/// enumerated up to [`MOST_EVENTS`](super::joint_association::MOST_EVENTS) events.
///
/// # Source
/// Musicki & Evans, "Joint integrated probabilistic data association: JIPDA", 2004; for one track:
/// Musicki, Evans & Stankovic, "Integrated probabilistic data association", 1994.
#[must_use]
pub fn associate(tracks: &[Prospect], measurements: usize, pairs: &[GatedPair]) -> JointEvidence {
    let miss = |track: &Prospect| 1.0 - track.detection * track.existence;
    let cost = |pair: &GatedPair| {
        let track = &tracks[pair.track];
        let seen = libm::log(track.detection * track.existence) + pair.log_ratio;
        Pair { row: pair.track, column: pair.measurement, cost: libm::log(miss(track)) - seen }
    };
    let costs: Vec<Pair> = pairs.iter().map(cost).collect();
    let pair = probabilities(tracks.len(), measurements, &costs);
    let (mut seen, mut unexplained) = (vec![0.0; tracks.len()], vec![1.0; measurements]);
    for (gated, probability) in pairs.iter().zip(&pair) {
        seen[gated.track] += probability;
        unexplained[gated.measurement] -= probability;
    }
    let existence = tracks.iter().zip(&seen).map(|(track, seen)| {
        let kept = if track.is_in_view {
            (1.0 - track.detection) * track.existence / miss(track)
        } else {
            track.existence
        };
        (seen + (1.0 - seen).max(0.0) * kept).min(MOST_CERTAIN)
    });
    let existence = existence.collect();
    unexplained.iter_mut().for_each(|left| *left = left.max(0.0));
    JointEvidence { existence, pair, unexplained }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRACK: Prospect = Prospect { existence: 0.5, detection: 0.8, is_in_view: true };

    /// One track: r' = r (1 - d) / (1 - r d) without a measurement, and with the factor
    /// 1 - d + d L in place of 1 - d with one of likelihood ratio L.
    #[test]
    fn one_track_is_integrated_probabilistic_data_association() {
        let missed = associate(&[TRACK], 0, &[]);
        assert!((missed.existence[0] - 0.5 * 0.2 / 0.6).abs() < 1e-15);
        let pair = GatedPair { track: 0, measurement: 0, log_ratio: libm::log(30.0) };
        let seen = associate(&[TRACK], 1, &[pair]);
        let weight = 0.2 + 0.8 * 30.0;
        assert!((seen.existence[0] - 0.5 * weight / (0.5 + 0.5 * weight)).abs() < 1e-12);
        assert!((seen.unexplained[0] + seen.pair[0] - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_scanner_that_may_not_see_the_place_takes_nothing_away() {
        let hidden = Prospect { is_in_view: false, ..TRACK };
        assert_eq!(associate(&[hidden], 0, &[]).existence, [0.5]);
        let pair = GatedPair { track: 0, measurement: 0, log_ratio: 4.0 };
        assert!(associate(&[hidden], 1, &[pair]).existence[0] > 0.9);
    }

    /// Two tracks on one target: one measurement is not evidence for two targets.
    #[test]
    fn a_second_track_on_the_same_measurements_fades() {
        let mut existence = [0.99, 0.9];
        for _ in 0..30 {
            let tracks = existence.map(|existence| Prospect { existence, ..TRACK });
            let pair = |track| GatedPair { track, measurement: 0, log_ratio: 5.0 };
            let found = associate(&tracks, 1, &[pair(0), pair(1)]).existence;
            existence = [found[0], found[1]];
        }
        assert!(existence[0] > 0.99 && existence[1] < 0.2, "{existence:?}");
    }

    #[test]
    fn existence_fades_with_the_mean_lifetime() {
        assert!((survived(0.8, 60.0, 60.0) - 0.8 / std::f64::consts::E).abs() < 1e-12);
        assert_eq!(survived(0.8, -1.0, 60.0), 0.8);
    }
}
