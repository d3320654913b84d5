//! Joint integrated probabilistic data association (JIPDA): probabilities that a track has a
//! target, that the target is hidden, and that a measurement comes from it.

use super::joint_association::probabilities;
use crate::estimation::assignment::Pair;
use serde::{Deserialize, Serialize};

/// Largest probability of existence, so that misses can always lower it.
pub const MOST_CERTAIN: f64 = 1.0 - 1e-9;

/// Probabilities that a track has no target, an observable target, or a hidden one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Presence {
    /// Probability that there is a target.
    pub existence: f64,
    /// Probability that there is a target and that it is hidden.
    pub hidden: f64,
    /// Probability that there is a target that is observable, but was hidden at some time since its
    /// last measurement.
    pub returned: f64,
}

/// Mean times of a target [s].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sojourn {
    /// Mean time for which a target exists [s].
    pub lifetime: f64,
    /// Mean time until something hides an observable target [s].
    pub visible: f64,
    /// Mean time until a hidden target is observable again [s].
    pub hidden: f64,
}

impl Presence {
    /// Presence of a measured target that exists with probability `existence`.
    #[must_use]
    pub fn measured(existence: f64) -> Self {
        Self { existence, hidden: 0.0, returned: 0.0 }
    }

    /// Probability that there is a target and that it can be measured.
    #[must_use]
    pub fn observable(&self) -> f64 {
        (self.existence - self.hidden).max(0.0)
    }

    /// Probability, if the target exists, that it is hidden or was hidden since its last
    /// measurement.
    #[must_use]
    pub fn hidden_share(&self) -> f64 {
        if self.existence > 0.0 { (self.hidden + self.returned) / self.existence } else { 0.0 }
    }

    /// Presence after `dt` [s] without a scan.
    ///
    /// # Source
    /// Markov chain two of Musicki, Evans & Stankovic, "Integrated probabilistic data
    /// association", 1994, in continuous time.
    #[must_use]
    pub fn predicted(&self, dt: f64, mean: &Sojourn) -> Self {
        let dt = dt.max(0.0);
        let (hides, returns) = (1.0 / mean.visible, 1.0 / mean.hidden);
        let share = hides / (hides + returns);
        let kept = libm::exp(-dt / mean.lifetime);
        let mixed = -libm::expm1(-dt * (hides + returns));
        let hidden = self.hidden + mixed * (share * self.existence - self.hidden);
        let always = (self.observable() - self.returned) * libm::exp(-dt * hides);
        let returned = (self.existence - hidden - always).max(0.0);
        Self { existence: kept * self.existence, hidden: kept * hidden, returned: kept * returned }
    }

    /// Presence after an observation: `observable` and `hidden` are its likelihoods under a target
    /// that can be measured and under a hidden one, each divided by its likelihood without a
    /// target.
    ///
    /// # Source
    /// Bayes' rule. One measurement of likelihood ratio L, of a target measured with probability d, is
    /// `observable` = 1 - d + d L and `hidden` = 1: integrated probabilistic data association.
    #[must_use]
    pub fn weighed(&self, observable: f64, hidden: f64) -> Self {
        let (seen, unseen) = (observable * self.observable(), hidden * self.hidden);
        let total = (1.0 - self.existence) + seen + unseen;
        let existence = ((seen + unseen) / total).min(MOST_CERTAIN);
        let hidden = (unseen / total).min(existence);
        Self { existence, hidden, returned: observable * self.returned / total }
    }

    /// Presence of a target with two hypotheses that exclude each other: their probabilities add
    /// up.
    #[must_use]
    pub fn united(&self, other: &Self) -> Self {
        let existence = self.existence + other.existence;
        let kept = (MOST_CERTAIN / existence).min(1.0);
        Self {
            existence: kept * existence,
            hidden: kept * (self.hidden + other.hidden),
            returned: kept * (self.returned + other.returned),
        }
    }
}

/// A track before a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedTrack {
    /// Presence of its target, predicted to the time of the scan.
    pub presence: Presence,
    /// Probability that the scan measures the target within its gate if it is observable.
    pub detection: f64,
    /// True if the scanner is known to see the place: a scan without a measurement then lowers the
    /// probability of existence.
    pub is_in_view: bool,
}

/// A measurement within the gate of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatedPair {
    /// Index of the track.
    pub track: usize,
    /// Index of the measurement.
    pub measurement: usize,
    /// Natural logarithm of the ratio of the predicted probability density of the measurement to
    /// the density of clutter.
    pub log_ratio: f64,
}

/// Evidence of one scan about tracks.
#[derive(Clone, Debug, PartialEq)]
pub struct JointEvidence {
    /// Presence of the target of every track.
    pub presence: Vec<Presence>,
    /// Probability of every pair: the target exists, and the measurement comes from it.
    pub pair: Vec<f64>,
    /// True for a pair that alone would be more likely than a missed detection.
    pub is_likely: Vec<bool>,
    /// Probability of every measurement that it comes from no track.
    pub unexplained: Vec<f64>,
    /// Probability of every track that this scan measured it for the first time after it was
    /// hidden.
    pub returns: Vec<f64>,
}

/// Probabilities of existence and association after a scan.
///
/// The events of JPDA, in which a track without a measurement does not exist, is hidden, or was
/// missed: together they have the weight 1 - `detection` times the probability of an observable
/// target. A measurement of it has that product times its ratio. Groups of tracks with common
/// measurements are independent; they are enumerated up to
/// [`MOST_EVENTS`](super::joint_association::MOST_EVENTS) events.
///
/// # Source
/// Musicki & Evans, "Joint integrated probabilistic data association: JIPDA", 2004; for one track:
/// Musicki, Evans & Stankovic, "Integrated probabilistic data association", 1994.
#[must_use]
pub fn associate(
    tracks: &[PredictedTrack],
    measurements: usize,
    pairs: &[GatedPair],
) -> JointEvidence {
    let seen = |track: &PredictedTrack| track.detection * track.presence.observable();
    let cost = |pair: &GatedPair| {
        let seen = seen(&tracks[pair.track]);
        let cost = libm::log(1.0 - seen) - libm::log(seen) - pair.log_ratio;
        Pair { row: pair.track, column: pair.measurement, cost }
    };
    let costs: Vec<Pair> = pairs.iter().map(cost).collect();
    let pair = probabilities(tracks.len(), measurements, &costs);
    let (mut measured, mut unexplained) = (vec![0.0; tracks.len()], vec![1.0; measurements]);
    for (gated, probability) in pairs.iter().zip(&pair) {
        measured[gated.track] += probability;
        unexplained[gated.measurement] -= probability;
    }
    unexplained.iter_mut().for_each(|left| *left = left.max(0.0));
    let presence = tracks.iter().zip(&measured).map(|(track, measured)| {
        // Without a measurement: what could be measured was missed, what is hidden says nothing.
        let (missed, miss) =
            if track.is_in_view { (1.0 - track.detection, 1.0 - seen(track)) } else { (1.0, 1.0) };
        let unmeasured = (1.0 - measured).max(0.0) / miss;
        let Presence { hidden, returned, .. } = track.presence;
        let kept = missed * track.presence.observable() + hidden;
        let existence = (measured + unmeasured * kept).min(MOST_CERTAIN);
        let hidden = (unmeasured * hidden).min(existence);
        Presence { existence, hidden, returned: unmeasured * missed * returned }
    });
    let returns = tracks.iter().zip(&measured).map(|(track, measured)| {
        let observable = track.presence.observable();
        if observable > 0.0 { measured * track.presence.returned / observable } else { 0.0 }
    });
    let (presence, returns) = (presence.collect(), returns.collect());
    let is_likely = costs.iter().map(|pair| pair.cost < 0.0).collect();
    JointEvidence { presence, pair, is_likely, unexplained, returns }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRACK: PredictedTrack =
        PredictedTrack { presence: SOME, detection: 0.8, is_in_view: true };
    const SOME: Presence = Presence { existence: 0.5, hidden: 0.0, returned: 0.0 };
    const MEAN: Sojourn = Sojourn { lifetime: 60.0, visible: 30.0, hidden: 1.5 };

    /// One track: r' = r (1 - d) / (1 - r d) without a measurement, and with the factor
    /// 1 - d + d L in place of 1 - d with one of likelihood ratio L.
    #[test]
    fn one_track_is_integrated_probabilistic_data_association() {
        let missed = associate(&[TRACK], 0, &[]);
        assert!((missed.presence[0].existence - 0.5 * 0.2 / 0.6).abs() < 1e-15);
        let pair = GatedPair { track: 0, measurement: 0, log_ratio: libm::log(30.0) };
        let seen = associate(&[TRACK], 1, &[pair]);
        let weight = 0.2 + 0.8 * 30.0;
        let expected = 0.5 * weight / (0.5 + 0.5 * weight);
        assert!((seen.presence[0].existence - expected).abs() < 1e-12);
        assert!((seen.unexplained[0] + seen.pair[0] - 1.0).abs() < 1e-15);
    }

    #[test]
    fn evidence_of_one_measurement_is_that_of_the_association() {
        let presence = Presence { existence: 0.6, hidden: 0.1, returned: 0.05 };
        let track = PredictedTrack { presence, ..TRACK };
        let pair = GatedPair { track: 0, measurement: 0, log_ratio: libm::log(30.0) };
        for (pairs, ratio) in [(vec![pair], 0.2 + 0.8 * 30.0), (Vec::new(), 0.2)] {
            let expected = associate(&[track], pairs.len(), &pairs).presence[0];
            let found = presence.weighed(ratio, 1.0);
            assert!((found.existence - expected.existence).abs() < 1e-12);
            assert!((found.hidden - expected.hidden).abs() < 1e-12);
        }
        let sure = (0..100).fold(presence, |now, _| now.weighed(1e6, 1.0));
        assert!(sure.existence <= MOST_CERTAIN && sure.hidden >= 0.0);
    }

    /// No target .4, observable .5, hidden .1; events by hand with a ratio of 30.
    #[test]
    fn what_is_hidden_is_neither_measured_nor_missed() {
        let presence = Presence { existence: 0.6, hidden: 0.1, returned: 0.05 };
        let track = PredictedTrack { presence, ..TRACK };
        let missed = associate(&[track], 0, &[]);
        assert!((missed.presence[0].existence - 0.2 / 0.6).abs() < 1e-15);
        assert!((missed.presence[0].hidden - 0.1 / 0.6).abs() < 1e-15);
        assert!((missed.presence[0].returned - 0.2 * 0.05 / 0.6).abs() < 1e-15);
        assert_eq!(missed.returns, [0.0]);
        let pair = GatedPair { track: 0, measurement: 0, log_ratio: libm::log(30.0) };
        let seen = associate(&[track], 1, &[pair]);
        let total = 0.6 + 0.4 * 30.0;
        assert!((seen.pair[0] - 12.0 / total).abs() < 1e-12);
        assert!((seen.presence[0].existence - 12.2 / total).abs() < 1e-12);
        assert!((seen.presence[0].hidden - 0.1 / total).abs() < 1e-12);
        assert!((seen.returns[0] - 0.1 * 12.0 / total).abs() < 1e-12);
    }

    #[test]
    fn a_scanner_that_may_not_see_the_place_takes_nothing_away() {
        let presence = Presence { existence: 0.5, hidden: 0.1, returned: 0.05 };
        let unseen = PredictedTrack { presence, is_in_view: false, ..TRACK };
        assert_eq!(associate(&[unseen], 0, &[]).presence, [presence]);
        let pair = GatedPair { track: 0, measurement: 0, log_ratio: 4.0 };
        assert!(associate(&[unseen], 1, &[pair]).presence[0].existence > 0.9);
    }

    /// Two tracks on one target: one measurement is not evidence for two targets.
    #[test]
    fn a_second_track_on_the_same_measurements_fades() {
        let mut presence = [0.99, 0.9].map(Presence::measured);
        for _ in 0..30 {
            let tracks = presence.map(|presence| PredictedTrack { presence, ..TRACK });
            let pair = |track| GatedPair { track, measurement: 0, log_ratio: 5.0 };
            let found = associate(&tracks, 1, &[pair(0), pair(1)]).presence;
            presence = [found[0], found[1]];
        }
        let [first, second] = presence.map(|one| one.existence);
        assert!(first > 0.99 && second < 0.2, "{presence:?}");
    }

    #[test]
    fn existence_fades_with_the_mean_lifetime() {
        let later = Presence::measured(0.8).predicted(60.0, &MEAN);
        assert!((later.existence - 0.8 / std::f64::consts::E).abs() < 1e-12);
        assert_eq!(Presence::measured(0.8).predicted(-1.0, &MEAN).existence, 0.8);
    }

    /// By Euler steps; and one step of a second is as good as ten of a tenth.
    #[test]
    fn targets_hide_and_return_at_their_rates() {
        let start = Presence { existence: 0.9, hidden: 0.6, returned: 0.0 };
        let ([mut seen, mut hidden], steps) = ([0.3, 0.6], 100_000);
        for _ in 0..steps {
            let flow = (seen / MEAN.visible - hidden / MEAN.hidden) / f64::from(steps);
            let gone = 1.0 - 1.0 / MEAN.lifetime / f64::from(steps);
            (seen, hidden) = ((seen - flow) * gone, (hidden + flow) * gone);
        }
        let once = start.predicted(1.0, &MEAN);
        assert!((once.hidden - hidden).abs() < 1e-5 && (once.observable() - seen).abs() < 1e-5);
        let often = (0..10).fold(start, |now, _| now.predicted(0.1, &MEAN));
        assert!((once.hidden - often.hidden).abs() < 1e-12);
        assert!((once.existence - often.existence).abs() < 1e-12);
        assert!(once.returned > 0.2 && once.returned < once.observable());
    }

    /// Of what is always measured, at any rate of scans.
    #[test]
    fn a_gap_is_survived_and_an_end_is_not() {
        for rate in [2.0, 10.0, 20.0] {
            let mut presence = Presence::measured(1.0 - 1e-6);
            let mut gap = |seconds: f64| {
                for _ in 0..(seconds * rate) as usize {
                    let next = presence.predicted(1.0 / rate, &MEAN);
                    let track =
                        PredictedTrack { presence: next, detection: 0.99, is_in_view: true };
                    presence = associate(&[track], 0, &[]).presence[0];
                }
                presence.existence
            };
            assert!(gap(2.0) > 0.2);
            assert!(gap(10.0) < 0.01);
        }
    }
}
