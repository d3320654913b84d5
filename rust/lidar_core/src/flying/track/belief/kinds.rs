//! What the target of a track is.
//!
//! Every set of detections tells whether it stands. Its size, and how much of its outline is filled,
//! are the same in all of them: these are averaged, and weighed once. Insects are smaller than what
//! is looked for; of dust and leaves few rays come back among many that pass. Rays pass below what
//! flies, and not below what stands on the ground.

use crate::tracking::kind::{KINDS, KindBelief};
use serde::{Deserialize, Serialize};

/// Shares of the kinds among new tracks, in the order of `TrackKind::ALL`.
const SHARES: [f64; KINDS] = [0.03, 0.6, 0.05, 0.07, 0.25];
/// What is part of a surface is so many times likelier to seem so: it stands, or is on the ground.
const JOINED: [f64; KINDS] = [1.0, 0.5, 5.0, 5.0, 0.5];
/// Most detections that count: those of one target are alike in their errors.
const MOST: f64 = 20.0;
/// Of the logarithm of a value in one detection: its standard deviation around that of the target.
const NOISE: f64 = 0.4;

/// Of what rays pass below, and of what none do: that stands on the ground, or is cut off by the edge
/// of the field of view, as people near a scanner are.
const FREE_BELOW: [f64; KINDS] = [0.8, 1.0, 0.15, 0.4, 1.0];
const NOT_FREE_BELOW: [f64; KINDS] = [0.7, 0.35, 1.5, 1.0, 0.35];
/// The same of the first look at it: what comes into view like this nearly always walks or drives in over
/// the lower edge of the field of view. What flies is seen as a whole before, or soon after.
const NOT_FREE_AT_FIRST: [f64; KINDS] = [0.7, 0.08, 1.5, 1.0, 0.08];

/// What a detection shows of a target itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TargetShape {
    /// Radius of the sphere around it [m].
    pub radius: f64,
    /// Share of the rays inside the ellipse of its points that hit; not a number if unknown.
    pub filled_share: f64,
    /// Whether rays pass below it; None if nothing tells.
    pub is_free_below: Option<bool>,
}

/// Mean and standard deviation of the natural logarithm of a value.
#[derive(Clone, Copy)]
struct LogNormal(f64, f64);

/// A sort of target: its share among its kind, its radius [m], and how much of it is filled.
struct Sort {
    share: f64,
    radius: LogNormal,
    filled: LogNormal,
}

/// Birds and small frames; targets of half a metre and more.
const FLYING: [Sort; 2] = [
    Sort { share: 0.5, radius: LogNormal(-1.6, 0.35), filled: LogNormal(-0.7, 0.5) },
    Sort { share: 0.5, radius: LogNormal(-0.7, 0.6), filled: LogNormal(-0.7, 0.5) },
];
/// Insects; dust, smoke and rain; leaves and whatever else.
const CLUTTER: [Sort; 3] = [
    Sort { share: 0.35, radius: LogNormal(-3.0, 0.4), filled: LogNormal(-0.7, 0.7) },
    Sort { share: 0.35, radius: LogNormal(-1.2, 0.8), filled: LogNormal(-2.3, 0.5) },
    Sort { share: 0.3, radius: LogNormal(-1.6, 1.0), filled: LogNormal(-1.2, 1.0) },
];

/// Mean of the logarithms of a value over detections.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct MeanLog {
    count: f64,
    mean: f64,
}

impl MeanLog {
    /// Values that are not positive say nothing.
    fn add(&mut self, value: f64) {
        if value > 0.0 && value.is_finite() {
            self.count = (self.count + 1.0).min(MOST);
            self.mean += (libm::log(value) - self.mean) / self.count;
        }
    }

    /// Probability density of the mean, up to a factor that all sorts share.
    fn density(&self, of: LogNormal) -> f64 {
        if self.count == 0.0 {
            return 1.0;
        }
        let LogNormal(mean, std) = of;
        let variance = std * std + NOISE * NOISE / self.count;
        let off = self.mean - mean;
        libm::exp(-0.5 * off * off / variance) / variance.sqrt()
    }
}

/// What is known of the kind of a target.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(in crate::flying::track) struct Kinds {
    /// From what was seen in every set of detections.
    seen: KindBelief,
    radius: MeanLog,
    filled: MeanLog,
    /// Whether a look has told if rays pass below it.
    is_known_below: bool,
}

impl Kinds {
    /// Of a new track.
    pub(in crate::flying::track) fn new() -> Self {
        let (radius, filled) = (MeanLog::default(), MeanLog::default());
        Self { seen: KindBelief::prior(SHARES), radius, filled, is_known_below: false }
    }

    /// Enter how likely something that moves, and something that stands, makes what was seen.
    pub(super) fn see(&mut self, moving: f64, standing: f64) {
        self.seen = self.seen.weighed([moving, moving, moving, standing, moving]);
    }

    /// Enter that a detection seemed to be part of a surface.
    pub(super) fn see_joined(&mut self) {
        self.seen = self.seen.weighed(JOINED);
    }

    /// Enter the shape of a detection.
    pub(super) fn measure(&mut self, shape: TargetShape) {
        self.radius.add(shape.radius);
        self.filled.add(shape.filled_share);
        if let Some(is_free) = shape.is_free_below {
            self.seen = self.seen.weighed(match (is_free, self.is_known_below) {
                (true, _) => FREE_BELOW,
                (false, true) => NOT_FREE_BELOW,
                (false, false) => NOT_FREE_AT_FIRST,
            });
            self.is_known_below = true;
        }
    }

    /// Probabilities of the kinds.
    pub(in crate::flying::track) fn belief(&self) -> KindBelief {
        let density = |sorts: &[Sort]| {
            let of = |sort: &Sort| {
                sort.share * self.radius.density(sort.radius) * self.filled.density(sort.filled)
            };
            sorts.iter().map(of).sum::<f64>()
        };
        let (flying, clutter) = (density(&FLYING), density(&CLUTTER));
        // Nothing is said of the sizes of the others: as if they were of either of the two.
        let other = 0.5 * (flying + clutter);
        self.seen.weighed([other, flying, other, other, clutter])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracking::kind::TrackKind;

    fn kind(shapes: &[(f64, f64)]) -> TrackKind {
        let mut kinds = Kinds::new();
        for &(radius, filled_share) in shapes {
            kinds.measure(TargetShape { radius, filled_share, is_free_below: None });
        }
        kinds.belief().kind()
    }

    #[test]
    fn what_flies_is_large_enough_and_filled() {
        assert_eq!(kind(&[]), TrackKind::Flying);
        for target in [(0.12, 0.6), (0.17, 0.5), (0.33, 0.35), (0.5, 0.9), (1.1, 0.4)] {
            assert_eq!(kind(&[target; 3]), TrackKind::Flying, "{target:?}");
            assert_eq!(kind(&[(target.0, f64::NAN); 3]), TrackKind::Flying, "{target:?}");
        }
    }

    #[test]
    fn insects_are_small_and_dust_is_loose() {
        for clutter in [(0.035, 0.6), (0.05, 0.4), (0.065, 0.5), (0.4, 0.07), (0.3, 0.1)] {
            assert_eq!(kind(&[clutter; 2]), TrackKind::Clutter, "{clutter:?}");
        }
        // One detection that is too large does not hide what the others show.
        assert_eq!(kind(&[(0.05, 0.5), (0.16, 0.5), (0.05, 0.5), (0.05, 0.5)]), TrackKind::Clutter);
    }

    #[test]
    fn what_touches_the_ground_does_not_fly() {
        let person = TargetShape { radius: 0.4, filled_share: 0.7, is_free_below: Some(false) };
        let drone = TargetShape { is_free_below: Some(true), ..person };
        let mut kinds = Kinds::new();
        for _ in 0..2 {
            kinds.measure(person);
            assert_ne!(kinds.belief().kind(), TrackKind::Flying); // from the first look on
        }
        // What has come in over the lower edge of the view flies once all of it is seen.
        let mut kinds_of_drone = kinds;
        (0..4).for_each(|_| kinds_of_drone.measure(drone));
        assert_eq!(kinds_of_drone.belief().kind(), TrackKind::Flying);
        (0..4).for_each(|_| kinds.measure(person));
        assert_eq!(kinds.belief().kind(), TrackKind::Ground);
        // What was seen in the air for long flies on where the view ends below it.
        let mut kinds = Kinds::new();
        (0..20).for_each(|_| kinds.measure(drone));
        (0..5).for_each(|_| kinds.measure(person));
        assert_eq!(kinds.belief().kind(), TrackKind::Flying);
    }

    #[test]
    fn what_stands_is_static_and_what_moves_is_not() {
        let mut kinds = Kinds::new();
        (0..3).for_each(|_| kinds.see(0.1, 0.5));
        assert_eq!(kinds.belief().kind(), TrackKind::Static);
        (0..5).for_each(|_| kinds.see(0.5, 0.1));
        assert_eq!(kinds.belief().kind(), TrackKind::Flying);
    }
}
