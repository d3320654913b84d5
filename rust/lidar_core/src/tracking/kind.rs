//! Kind of the target of a track: probabilities of all kinds.

use serde::{Deserialize, Serialize};

/// Number of kinds.
pub const KINDS: usize = 5;
/// Least probability of a kind: no evidence rules one out for good.
pub const LEAST: f64 = 1e-6;
/// Probability above which a kind counts as known: it is then more probable than all others
/// together.
const DECIDED: f64 = 0.5;

/// Kind of the target of a track.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum TrackKind {
    /// None of the others, or not decided.
    #[default]
    Unknown = 0,
    /// The target flies.
    Flying = 1,
    /// The target moves on the ground.
    Ground = 2,
    /// The target is at rest.
    Static = 3,
    /// Something that moves but is not a target: insects, leaves, dust, rain.
    Clutter = 4,
}

impl TrackKind {
    /// All kinds, by number: the order of probabilities and likelihoods.
    pub const ALL: [Self; KINDS] =
        [Self::Unknown, Self::Flying, Self::Ground, Self::Static, Self::Clutter];
}

impl From<TrackKind> for u8 {
    fn from(kind: TrackKind) -> Self {
        kind as Self
    }
}

/// Probabilities of the kinds of the target of a track, if it has one.
///
/// A capability supplies the shares of the kinds among its new tracks, and the likelihood of the
/// observations of a track under each kind. The rest is Bayes' rule.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KindBelief {
    /// Natural logarithms of the probabilities, in the order of [`TrackKind::ALL`].
    log: [f64; KINDS],
}

impl KindBelief {
    /// Belief about a new track. `shares` are the frequencies of the kinds; only their ratios
    /// count.
    #[must_use]
    pub fn prior(shares: [f64; KINDS]) -> Self {
        let even = [0.0; KINDS];
        let prior = Self { log: even }.weighed(shares);
        // Shares that say nothing: all kinds are alike.
        if prior.log == even { Self::normalised(even) } else { prior }
    }

    /// Belief after an observation; `likelihood` is its likelihood under each kind, >= 0.
    ///
    /// Only ratios count. Likelihoods that are negative or not a number, or all zero, are no
    /// information.
    #[must_use]
    pub fn weighed(&self, likelihood: [f64; KINDS]) -> Self {
        let largest = likelihood.iter().copied().fold(0.0, f64::max);
        let is_usable = likelihood.iter().all(|value| *value >= 0.0 && value.is_finite());
        if !is_usable || largest == 0.0 {
            return *self;
        }
        // A kind that excludes what was observed keeps a least probability: a model may be wrong, and
        // the logarithm of zero would exclude the kind for good.
        let log = |value: f64| libm::log((value / largest).max(LEAST));
        Self::normalised(std::array::from_fn(|kind| self.log[kind] + log(likelihood[kind])))
    }

    /// Probability of every kind, in the order of [`TrackKind::ALL`]; their sum is 1.
    #[must_use]
    pub fn probabilities(&self) -> [f64; KINDS] {
        self.log.map(libm::exp)
    }

    /// Probability of one kind.
    #[must_use]
    pub fn probability(&self, kind: TrackKind) -> f64 {
        libm::exp(self.log[usize::from(u8::from(kind))])
    }

    /// The kind that is more probable than all others together; Unknown without such a kind.
    #[must_use]
    pub fn kind(&self) -> TrackKind {
        let is_decided = |kind: &TrackKind| self.probability(*kind) > DECIDED;
        TrackKind::ALL.into_iter().find(is_decided).unwrap_or_default()
    }

    /// Logarithms of probabilities with a sum of 1, none below [`LEAST`] but for rounding.
    fn normalised(mut log: [f64; KINDS]) -> Self {
        for _ in 0..2 {
            let largest = log.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let sum: f64 = log.iter().map(|value| libm::exp(value - largest)).sum();
            let total = largest + libm::log(sum);
            log = log.map(|value| (value - total).max(libm::log(LEAST)));
        }
        Self { log }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHARES: [f64; KINDS] = [1.0, 4.0, 2.0, 2.0, 1.0];

    /// In plain probabilities, without logarithms.
    #[test]
    fn evidence_is_weighed_by_the_rule_of_bayes() {
        let evidence = [[0.2, 0.9, 0.9, 0.1, 0.3], [1.0, 2.0, 0.5, 1.0, 3.0], [5.0; 5]];
        let mut expected = SHARES;
        let mut belief = KindBelief::prior(SHARES);
        for likelihood in evidence {
            belief = belief.weighed(likelihood);
            expected.iter_mut().zip(likelihood).for_each(|(share, value)| *share *= value);
        }
        let sum: f64 = expected.iter().sum();
        for (kind, share) in TrackKind::ALL.into_iter().zip(expected) {
            assert!((belief.probability(kind) - share / sum).abs() < 1e-12);
        }
        assert_eq!(belief.probabilities()[1], belief.probability(TrackKind::Flying));
    }

    /// Found by `make fuzz`: their sum was 5.
    #[test]
    fn shares_that_say_nothing_make_all_kinds_alike() {
        for shares in [[0.0; KINDS], [f64::NAN; KINDS], [-1.0, 1.0, 1.0, 1.0, 1.0]] {
            let even = KindBelief::prior(shares).probabilities();
            assert!(even.iter().all(|share| (share - 0.2).abs() < 1e-12), "{even:?}");
        }
    }

    #[test]
    fn no_kind_is_ruled_out_for_good() {
        let against = [1.0, 0.0, 1.0, 1.0, 1.0];
        let mut belief = KindBelief::prior(SHARES);
        for _ in 0..1000 {
            belief = belief.weighed(against);
        }
        let flying = belief.probability(TrackKind::Flying);
        assert!((0.5 * LEAST..2.0 * LEAST).contains(&flying), "{flying}");
        assert!((belief.probabilities().iter().sum::<f64>() - 1.0).abs() < 1e-9);
        for _ in 0..4 {
            belief = belief.weighed([0.1, 10.0, 0.1, 0.1, 0.1]);
        }
        assert_eq!(belief.kind(), TrackKind::Flying);
    }

    #[test]
    fn a_kind_is_decided_if_it_outweighs_all_others() {
        assert_eq!(KindBelief::prior(SHARES).kind(), TrackKind::Unknown);
        assert_eq!(KindBelief::prior([0.0, 6.0, 2.0, 2.0, 1.0]).kind(), TrackKind::Flying);
        assert_eq!(KindBelief::prior([0.0, 2.0, 2.0, 5.1, 1.0]).kind(), TrackKind::Static);
        assert_eq!(KindBelief::prior([1.0; KINDS]).kind(), TrackKind::Unknown);
    }

    #[test]
    fn what_is_no_likelihood_says_nothing() {
        let belief = KindBelief::prior(SHARES);
        for bad in [f64::NAN, -1.0, f64::INFINITY] {
            assert_eq!(belief.weighed([1.0, bad, 1.0, 1.0, 1.0]), belief);
        }
        assert_eq!(belief.weighed([0.0; KINDS]), belief);
        let scaled = belief.weighed([2e300; KINDS]).probabilities();
        assert!((scaled[1] - belief.probabilities()[1]).abs() < 1e-12);
    }

    #[test]
    fn numbers_of_kinds_are_those_of_the_interface() {
        assert_eq!(TrackKind::ALL.map(u8::from), [0, 1, 2, 3, 4]);
    }
}
