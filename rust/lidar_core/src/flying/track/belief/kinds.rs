//! Probabilities of the kinds of a track's target (flying, on the ground, static, clutter, unknown).
//!
//! Every set of detections is evidence whether the target is static. Its size and its fill (share
//! of its outline that returns rays) are the same in all detections, so they are averaged and
//! weighed once. Insects are smaller than the targets. Dust and leaves return few of many rays.
//! Rays pass below flying targets, and not below objects that stand on the ground.

use crate::flying::detect::center::Coherence;
use crate::tracking::kind::{KINDS, KindBelief};
use serde::{Deserialize, Serialize};

/// Prior probabilities of the kinds of a new track, in the order of `TrackKind::ALL`, as in all tables of this file.
const SHARES: [f64; KINDS] = [0.03, 0.6, 0.05, 0.07, 0.25];
/// Likelihoods, per kind, that a detection seems to be part of a surface: higher for static objects
/// and objects on the ground.
const JOINED: [f64; KINDS] = [1.0, 0.5, 5.0, 5.0, 0.5];
/// Largest number of detections that count: the errors of detections of one target are correlated.
const MOST: f64 = 20.0;
/// Standard deviation of the logarithm of a value in one detection around the value of the target.
const NOISE: f64 = 0.4;

/// Number of returns at which a detection has half the weight of one with very many. Rows that lie far apart often
/// meet only a part of a target: such a detection has few returns, and its size says little about the target. The
/// certainty of all detections together is not changed by this.
const HALF_WEIGHT: f64 = 10.0;

/// Share of the tracks that seem to have moved although their targets stand.
const STILL_THOUGH_MOVED: f64 = 0.03;

/// Likelihoods, per kind, that rays pass below a target (`FREE_BELOW`), or that none do (`NOT_FREE_BELOW`): it stands
/// on the ground, or the edge of the field of view cuts it off, as it does people near a scanner.
const FREE_BELOW: [f64; KINDS] = [0.8, 1.0, 0.15, 0.4, 1.0];
const NOT_FREE_BELOW: [f64; KINDS] = [0.7, 0.35, 1.5, 1.0, 0.35];
/// Likelihoods of `NOT_FREE_BELOW` for the first look. Nearly everything that comes into view like this walks or
/// drives in over the lower edge of the field of view. A flying target is seen as a whole before or soon after.
const NOT_FREE_AT_FIRST: [f64; KINDS] = [0.35, 0.08, 1.5, 1.0, 0.08];
/// Likelihoods, per kind, that a target has moved over space that was never seen, or that something in front of it
/// hides the space below: behind a table, a car or a wall, most moving things are people. They count once, since the
/// same thing hides the space in every scan, also if the space seemed free before: the track of a person may begin
/// with an arm. Where rays below the target are lost, as over a wet road, nothing is hidden.
const OVER_UNSEEN: [f64; KINDS] = [0.2, 0.03, 1.5, 1.0, 0.03];

/// Standard deviation of the acceleration of a target that moves steadily (`STEADY`) or manoeuvres (`AGILE`) [m/s^2].
const STEADY: f64 = 1.0;
const AGILE: f64 = 4.0;
/// Share of each kind that manoeuvres all the time: people and vehicles hardly ever do. The
/// accelerations of static objects are errors of the estimate and no evidence.
const AGILE_SHARES: [f64; KINDS] = [0.5, 0.5, 0.02, 0.5, 0.5];
/// Estimates of an acceleration that are closer in time use mostly the same measurements, so they count in proportion
/// to the time between them [s].
const APART: f64 = 0.5;
/// Share of the variance of a new track above which an acceleration counts as not measured.
const KNOWN_SHARE: f64 = 0.95;
/// Largest absolute value of `Kinds::agility`. Without this limit, the distant past would outweigh all that follows.
const MOST_AGILITY: f64 = 8.0;

/// Likelihoods, per kind, if detections appeared and disappeared at the places of all detections
/// before the track began. Few targets come to just such places. A smaller share of detections
/// counts for less.
const RECURS: [f64; KINDS] = [0.2, 0.02, 1.0, 1.0, 1.0];
/// Likelihoods, per kind, if the target stayed beside structure in all detections and does not manoeuvre: leaves,
/// wires and flags hang on something and sway. Few targets begin beside structure, stay there and hardly accelerate.
const HANGS: [f64; KINDS] = [0.3, 0.1, 0.3, 1.0, 1.0];

/// Likelihoods, per kind, if something stood at the places of the last detections before the track began. Few targets
/// come to just such places, except one that hovered before it was noticed. What manoeuvres does not stand.
const STOOD: [f64; KINDS] = [6.0, 0.02, 1.0, 2.0, 1.0];
/// Number of last detections that `Kinds::stood` averages.
const LAST: f64 = 5.0;

/// Likelihoods, per kind, if all detections end at the edge of something nearer that a moving sensor looks past.
/// Parts of static objects appear behind such an edge in every scan, each time elsewhere. Targets are soon seen as a
/// whole, but so are static objects: a track with one of its first `FIRST` detections at an edge counts as if all
/// were, until it has moved. After that only the share beyond one half counts, since targets pass behind things.
const UNCOVERED: [f64; KINDS] = [6.0, 0.02, 1.0, 2.0, 1.0];
/// Number of first detections that show whether a track began at an edge.
const FIRST: f64 = 3.0;

/// What one detection shows of the target itself: size, fill and surroundings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TargetShape {
    /// Number of its returns.
    pub n_points: usize,
    /// Radius of the sphere around it [m].
    pub radius: f64,
    /// Radius of the sphere if the rays beside the target were as close to each other as its points [m].
    pub least_radius: f64,
    /// Share of the rays inside the ellipse around its points that hit it. NaN if unknown.
    pub filled_share: f64,
    /// Hits next to hits beyond chance. Zero if unknown.
    pub coherence: Coherence,
    /// Whether rays pass below it. None if unknown.
    pub is_free_below: Option<bool>,
    /// Whether it has moved over space that was never seen, or something in front of it hides the space below it.
    pub is_over_unseen: bool,
    /// Whether it ends at the edge of something nearer that the moving sensor looks past.
    pub is_uncovered: bool,
}

/// Mean and standard deviation of the natural logarithm of a value.
#[derive(Clone, Copy)]
struct LogNormal(f64, f64);

/// A sort of targets of one kind: its share of the kind, distribution of the radius [m] and of the fill (0 to 1), and
/// the share of bodies, which neighbouring rays meet. Rays meet the others at random.
struct Sort {
    share: f64,
    radius: LogNormal,
    filled: LogNormal,
    bodies: f64,
}

/// Sorts of flying targets: birds and small frames; targets of half a metre and more. Their fill was measured on
/// spheres and frames in recordings of five sensors: logarithms of -1.1 to 0 in the mean of a target.
const FLYING: [Sort; 2] = [
    Sort { share: 0.5, radius: LogNormal(-1.6, 0.35), filled: LogNormal(-0.65, 0.4), bodies: 1.0 },
    Sort { share: 0.5, radius: LogNormal(-0.7, 0.6), filled: LogNormal(-0.65, 0.4), bodies: 1.0 },
];
/// Sorts of clutter: insects; dust, smoke and rain (simulated puffs and drops have a logarithm of the fill of -3.1 to
/// -1.6); dust that is as dense as a frame; leaves and everything else.
const CLUTTER: [Sort; 4] = [
    Sort { share: 0.35, radius: LogNormal(-3.0, 0.4), filled: LogNormal(-0.7, 0.7), bodies: 1.0 },
    Sort { share: 0.25, radius: LogNormal(-1.2, 0.8), filled: LogNormal(-2.2, 0.6), bodies: 0.0 },
    Sort { share: 0.1, radius: LogNormal(-1.0, 0.8), filled: LogNormal(-0.7, 0.5), bodies: 0.0 },
    Sort { share: 0.3, radius: LogNormal(-1.6, 1.0), filled: LogNormal(-1.2, 1.0), bodies: 0.5 },
];

/// Weighted mean of a value over the last detections.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Mean {
    count: f64,
    /// Sum of the weights of the values.
    weight: f64,
    mean: f64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.add_weighted(value, 1.0);
    }

    fn add_weighted(&mut self, value: f64, weight: f64) {
        if weight <= 0.0 {
            return;
        }
        let forgotten = (self.count + 1.0 - MOST).max(0.0) / MOST;
        self.count = (self.count + 1.0).min(MOST);
        self.weight = (1.0 - forgotten) * self.weight + weight;
        self.mean += (value - self.mean) * weight / self.weight;
    }

    /// Add the logarithm of a value from a detection of `returns` returns. A value that is not positive and finite is
    /// ignored.
    fn add_log(&mut self, value: f64, returns: usize) {
        if value > 0.0 && value.is_finite() {
            let count = returns as f64;
            self.add_weighted(libm::log(value), count / (count + HALF_WEIGHT));
        }
    }

    /// Probability density of the mean of the logarithms under distribution `of`, without a factor that all sorts
    /// share.
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

/// Evidence for the kind of a track's target, summed over its detections.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(in crate::flying::track) struct Kinds {
    /// Belief from the evidence that is weighed at once, without the averaged values below.
    seen: KindBelief,
    /// Mean logarithm of the radius [m] (`radius`, `least_radius`), and of the fill.
    radius: Mean,
    least_radius: Mean,
    filled: Mean,
    coherence: Coherence,
    /// Mean of how often something came and went before at the places of its detections, 0 to 1.
    recurs: Mean,
    /// Share of the detections in which it was beside structure and near its first detection.
    hangs: Mean,
    /// Mean, over the last detections, of whether something stood at their places before, 0 to 1.
    stood: Mean,
    /// Share of the detections that end at the edge of something nearer that the sensor looks past.
    uncovered: Mean,
    /// Whether one of the first detections ends at such an edge.
    began_uncovered: bool,
    /// Whether rays passed below it in the first look that showed this. None before such a look.
    was_free_at_first: Option<bool>,
    /// Whether the newest look that showed anything found it above space that was never seen.
    is_over_unseen: bool,
    /// Whether any look found it above space that was never seen.
    was_over_unseen: bool,
    /// Logarithm of the likelihood ratio of its accelerations: manoeuvring to not manoeuvring.
    agility: f64,
}

impl Kinds {
    /// Belief about a new track.
    pub(in crate::flying::track) fn new() -> Self {
        let [radius, least_radius, filled] = [Mean::default(); 3];
        let seen = KindBelief::prior(SHARES);
        let [recurs, hangs, stood, uncovered] = [Mean::default(); 4];
        Self {
            seen,
            radius,
            least_radius,
            filled,
            coherence: Coherence::default(),
            recurs,
            hangs,
            stood,
            uncovered,
            began_uncovered: false,
            was_free_at_first: None,
            is_over_unseen: false,
            was_over_unseen: false,
            agility: 0.0,
        }
    }

    /// Belief about a target that is known to have moved through the air.
    pub(super) fn of_mover() -> Self {
        let mut kinds = Self::new();
        kinds.see(1.0, STILL_THOUGH_MOVED);
        kinds
    }

    /// Enter evidence by its likelihood if the target moves (`moving`) and if it stands (`standing`).
    pub(super) fn see(&mut self, moving: f64, standing: f64) {
        self.seen = self.seen.weighed([moving, moving, moving, standing, moving]);
    }

    /// Enter that a detection seems to be part of a surface.
    pub(super) fn see_joined(&mut self) {
        self.seen = self.seen.weighed(JOINED);
    }

    /// Enter the shape of a detection. `is_led`: only its track tells that it flies. For such a detection over space
    /// that was never seen, it tells nothing more that no ray passes below.
    pub(super) fn measure(&mut self, shape: TargetShape, is_led: bool) {
        self.radius.add_log(shape.radius, shape.n_points);
        self.least_radius.add_log(shape.least_radius, shape.n_points);
        self.filled.add_log(shape.filled_share, shape.n_points);
        self.coherence.add(&shape.coherence);
        self.began_uncovered |= shape.is_uncovered && self.uncovered.count < FIRST;
        self.uncovered.add(f64::from(u8::from(shape.is_uncovered)));
        if shape.is_over_unseen && shape.is_free_below == Some(false) {
            if !self.was_over_unseen {
                self.seen = self.seen.weighed(self.over_unseen());
            }
            self.was_free_at_first.get_or_insert(false);
            (self.is_over_unseen, self.was_over_unseen) = (true, true);
        } else if let Some(is_free) = shape.is_free_below
            && !(is_led && self.is_over_unseen && !is_free)
        {
            self.seen = self.seen.weighed(match (is_free, self.was_free_at_first) {
                (true, _) => FREE_BELOW,
                (false, Some(_)) => NOT_FREE_BELOW,
                (false, None) => NOT_FREE_AT_FIRST,
            });
            self.was_free_at_first.get_or_insert(is_free);
            self.is_over_unseen = false;
        }
    }

    /// Likelihoods of the first look above space that was never seen. Often the same thing hid this space in the very
    /// first look: what that look has told already is divided out.
    fn over_unseen(&self) -> [f64; KINDS] {
        if self.was_free_at_first != Some(false) {
            return OVER_UNSEEN;
        }
        std::array::from_fn(|kind| OVER_UNSEEN[kind] / NOT_FREE_AT_FIRST[kind])
    }

    /// Enter one detection: how often something came and went at its place before the track began (`share`, 0 to 1),
    /// and whether the place is beside structure and near the first detection (`hangs`).
    pub(super) fn visit(&mut self, share: f64, hangs: bool) {
        self.recurs.add(share);
        self.hangs.add(f64::from(u8::from(hangs)));
    }

    /// Enter for one detection whether something stood at its place before the track began, 0 (no) to 1 (yes).
    pub(super) fn stand(&mut self, stood: f64) {
        self.stood.count = self.stood.count.min(LAST - 1.0);
        self.stood.weight = self.stood.count;
        self.stood.add(stood);
    }

    /// Enter that something stood at the places of all detections so far.
    pub(super) fn stood_so_far(&mut self) {
        self.stood.mean = 1.0;
    }

    /// Enter the track's acceleration [m/s^2] and its variance along every axis, `seconds` after the last entry.
    ///
    /// The prior of a new track, with the standard deviation `expected` [m/s^2], is removed first, so that only the
    /// measurements count.
    pub(super) fn feel(&mut self, accelerations: [[f64; 2]; 3], expected: f64, seconds: f64) {
        let prior = expected * expected;
        let log_ratio = |[mean, variance]: [f64; 2]| {
            if !(variance > 0.0 && variance < KNOWN_SHARE * prior) {
                return 0.0; // nothing was measured yet
            }
            let measured = 1.0 / (1.0 / variance - 1.0 / prior);
            let value = mean * measured / variance;
            let [steady, agile] = [STEADY, AGILE].map(|std| measured + std * std);
            0.5 * (value * value * (1.0 / steady - 1.0 / agile) - libm::log(agile / steady))
        };
        let weight = (seconds / APART).clamp(0.0, 1.0);
        self.agility += weight * accelerations.map(log_ratio).iter().sum::<f64>();
        self.agility = self.agility.clamp(-MOST_AGILITY, MOST_AGILITY);
    }

    /// Probabilities of the kinds. `has_moved`: whether the target was seen away from its first detection.
    pub(in crate::flying::track) fn belief(&self, has_moved: bool) -> KindBelief {
        let uncovered = match (has_moved, self.began_uncovered) {
            (true, _) => (2.0 * self.uncovered.mean - 1.0).max(0.0),
            (false, true) => 1.0,
            (false, false) => self.uncovered.mean,
        };
        let hangs = self.hangs.mean;
        // Between leaves it is not known which rays passed. The spacing of the points tells the size there.
        let least = if self.least_radius.count > 0.0 { self.least_radius } else { self.radius };
        let radius =
            Mean { mean: (1.0 - hangs) * self.radius.mean + hangs * least.mean, ..self.radius };
        let [body, loose] = self.coherence.densities();
        let density = |sorts: &[Sort]| {
            let of = |sort: &Sort| {
                sort.share
                    * radius.density(sort.radius)
                    * self.filled.density(sort.filled)
                    * (sort.bodies * body + (1.0 - sort.bodies) * loose)
            };
            sorts.iter().map(of).sum::<f64>()
        };
        let (flying, clutter) = (density(&FLYING), density(&CLUTTER));
        // Nothing is said of the sizes of the others: as if they were of either of the two.
        let other = 0.5 * (flying + clutter);
        let times = libm::exp(self.agility);
        let moves = AGILE_SHARES.map(|share| 1.0 - share + share * times);
        let power = |likelihoods: [f64; KINDS], share: f64| {
            likelihoods.map(|likelihood| libm::exp(share * libm::log(likelihood)))
        };
        self.seen
            .weighed([other, flying, other, other, clutter])
            .weighed(moves)
            .weighed(power(RECURS, self.recurs.mean))
            .weighed(power(HANGS, hangs / (1.0 + times)))
            .weighed(power(UNCOVERED, uncovered))
            .weighed(power(STOOD, self.stood.mean * (2.0 / (1.0 + times)).min(1.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracking::kind::TrackKind;

    fn kind(shapes: &[(f64, f64)]) -> TrackKind {
        let mut kinds = Kinds::new();
        for &(radius, filled_share) in shapes {
            let shape = TargetShape {
                n_points: 10,
                radius,
                least_radius: radius,
                filled_share,
                coherence: Coherence::default(),
                is_free_below: None,
                is_over_unseen: false,
                is_uncovered: false,
            };
            kinds.measure(shape, false);
        }
        kinds.belief(true).kind()
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

    /// Kind after detections with these numbers of points and radii [m].
    fn kind_of_parts(parts: &[(usize, f64)]) -> TrackKind {
        let mut kinds = Kinds::new();
        for &(n_points, radius) in parts.iter().cycle().take(12) {
            let shape = TargetShape {
                n_points,
                radius,
                least_radius: radius,
                filled_share: 0.75,
                coherence: Coherence::default(),
                is_free_below: None,
                is_over_unseen: false,
                is_uncovered: false,
            };
            kinds.measure(shape, false);
        }
        kinds.belief(true).kind()
    }

    #[test]
    fn a_row_that_meets_a_part_of_a_target_says_less_than_several() {
        assert_eq!(kind_of_parts(&[(20, 0.3), (5, 0.07), (4, 0.06), (5, 0.07)]), TrackKind::Flying);
        // The opposites: what is small however many rays meet it, and a single large detection.
        assert_eq!(kind_of_parts(&[(20, 0.07), (5, 0.07), (4, 0.06)]), TrackKind::Clutter);
        let mut insect = [(5, 0.06); 12];
        insect[6] = (20, 0.3);
        assert_eq!(kind_of_parts(&insect), TrackKind::Clutter);
    }

    #[test]
    fn what_touches_the_ground_does_not_fly() {
        let person = TargetShape {
            n_points: 10,
            radius: 0.4,
            least_radius: 0.4,
            filled_share: 0.7,
            coherence: Coherence::default(),
            is_free_below: Some(false),
            is_over_unseen: false,
            is_uncovered: false,
        };
        let drone = TargetShape { is_free_below: Some(true), ..person };
        let mut kinds = Kinds::new();
        for _ in 0..2 {
            kinds.measure(person, false);
            assert_ne!(kinds.belief(true).kind(), TrackKind::Flying); // from the first look on
        }
        // What has come in over the lower edge of the view flies once all of it is seen.
        let mut kinds_of_drone = kinds;
        (0..4).for_each(|_| kinds_of_drone.measure(drone, false));
        assert_eq!(kinds_of_drone.belief(true).kind(), TrackKind::Flying);
        (0..4).for_each(|_| kinds.measure(person, false));
        assert_eq!(kinds.belief(true).kind(), TrackKind::Ground);
        // What was seen in the air for long flies on where the view ends below it.
        let mut kinds = Kinds::new();
        (0..20).for_each(|_| kinds.measure(drone, false));
        (0..5).for_each(|_| kinds.measure(person, false));
        assert_eq!(kinds.belief(true).kind(), TrackKind::Flying);
    }

    /// Evidence of `scans` detections of a target with this acceleration [m/s^2] above space that was never seen.
    fn over_unseen(acceleration: [f64; 3], scans: usize) -> Kinds {
        let shape = TargetShape {
            n_points: 10,
            radius: 0.35,
            least_radius: 0.35,
            filled_share: 0.8,
            coherence: Coherence::default(),
            is_free_below: Some(false),
            is_over_unseen: true,
            is_uncovered: false,
        };
        let mut kinds = Kinds::new();
        for _ in 0..scans {
            kinds.measure(shape, false);
            kinds.see(0.33, 0.02);
            kinds.feel(acceleration.map(|value| [value, 2.0]), 3.0, 0.1);
        }
        kinds
    }

    #[test]
    fn what_manoeuvres_above_unseen_space_flies_and_what_walks_there_does_not() {
        for walks in [[0.0; 3], [1.0, -1.0, 0.0], [2.0, 0.0, 0.5]] {
            for scans in [1, 2, 5, 50] {
                let kind = over_unseen(walks, scans).belief(true).kind();
                assert_ne!(kind, TrackKind::Flying, "{walks:?} {scans}");
            }
            assert_eq!(over_unseen(walks, 50).belief(true).kind(), TrackKind::Ground);
        }
        assert_ne!(over_unseen([5.0, 4.0, 0.5], 1).belief(true).kind(), TrackKind::Flying);
        assert_eq!(over_unseen([5.0, 4.0, 0.5], 10).belief(true).kind(), TrackKind::Flying);
        // Over a road that returns nothing it needs not, since nothing hides what is below it.
        let shape = TargetShape {
            n_points: 10,
            radius: 0.35,
            least_radius: 0.35,
            filled_share: 0.8,
            coherence: Coherence::default(),
            is_free_below: None,
            is_over_unseen: true,
            is_uncovered: false,
        };
        let mut kinds = Kinds::new();
        (0..5).for_each(|_| kinds.measure(shape, false));
        assert_eq!(kinds.belief(true).kind(), TrackKind::Flying);
        // Once rays pass below it, it needs not manoeuvre; what stands on the ground may, for a while.
        let mut kinds = over_unseen([0.0; 3], 5);
        let seen = |is_free| TargetShape {
            n_points: 10,
            radius: 0.35,
            least_radius: 0.35,
            filled_share: 0.8,
            coherence: Coherence::default(),
            is_free_below: Some(is_free),
            is_over_unseen: false,
            is_uncovered: false,
        };
        (0..5).for_each(|_| kinds.measure(seen(true), false));
        assert_eq!(kinds.belief(true).kind(), TrackKind::Flying);
        let mut kinds = over_unseen([5.0, 4.0, 0.5], 10);
        (0..5).for_each(|_| kinds.measure(seen(false), false));
        assert_eq!(kinds.belief(true).kind(), TrackKind::Ground);
    }

    #[test]
    fn what_was_free_below_for_a_moment_does_not_fly_above_unseen_space() {
        let person = TargetShape {
            n_points: 10,
            radius: 0.6,
            least_radius: 0.6,
            filled_share: 0.6,
            coherence: Coherence::default(),
            is_free_below: Some(false),
            is_over_unseen: true,
            is_uncovered: false,
        };
        let arm = TargetShape { radius: 0.15, least_radius: 0.15, ..person };
        let free = TargetShape { is_free_below: Some(true), is_over_unseen: false, ..arm };
        let kind_after = |looks: usize| {
            let mut kinds = Kinds::new();
            (0..looks).for_each(|_| kinds.measure(free, false));
            (0..10).for_each(|_| kinds.measure(person, false));
            kinds.belief(true).kind()
        };
        assert_ne!(kind_after(1), TrackKind::Flying);
        // The opposite: what rays have passed below for a second flies on behind a wall.
        assert_eq!(kind_after(10), TrackKind::Flying);
    }

    #[test]
    fn what_passes_behind_something_for_a_moment_flies_again() {
        let looks = |is_free: bool| TargetShape {
            n_points: 30,
            radius: 0.3,
            least_radius: 0.3,
            filled_share: 0.8,
            coherence: Coherence::default(),
            is_free_below: Some(is_free),
            is_over_unseen: !is_free,
            is_uncovered: false,
        };
        let kind_of = |looks_free: &[bool]| {
            let mut kinds = Kinds::new();
            looks_free.iter().for_each(|&is_free| kinds.measure(looks(is_free), false));
            kinds.belief(true).kind()
        };
        assert_eq!(kind_of(&[true, true, true, false, true, true]), TrackKind::Flying);
        // The opposite: what stays behind it, such as a person behind a desk.
        assert_ne!(kind_of(&[true, false, false, false, false, false]), TrackKind::Flying);
    }

    #[test]
    fn what_hides_the_space_below_counts_once() {
        let over_unseen = TargetShape {
            n_points: 10,
            radius: 0.35,
            least_radius: 0.35,
            filled_share: 0.8,
            coherence: Coherence::default(),
            is_free_below: Some(false),
            is_over_unseen: true,
            is_uncovered: false,
        };
        let hidden = TargetShape { is_over_unseen: false, ..over_unseen };
        let seen_as = |shapes: [TargetShape; 2]| {
            let mut kinds = Kinds::new();
            shapes.into_iter().for_each(|shape| kinds.measure(shape, false));
            kinds.seen.probabilities()
        };
        let [later, at_once] = [[hidden, over_unseen], [over_unseen; 2]].map(seen_as);
        for (later, at_once) in later.into_iter().zip(at_once) {
            assert!((later - at_once).abs() < 1e-12, "{later} {at_once}");
        }
        // The opposite: where rays passed below at first, it is something else that hides it.
        let free = TargetShape { is_free_below: Some(true), ..hidden };
        assert_ne!(seen_as([free, over_unseen]), at_once);
    }

    #[test]
    fn what_stays_at_an_edge_that_the_sensor_looks_past_does_not_fly() {
        let open = TargetShape {
            n_points: 10,
            radius: 0.3,
            least_radius: 0.3,
            filled_share: 0.8,
            coherence: Coherence::default(),
            is_free_below: Some(true),
            is_over_unseen: false,
            is_uncovered: false,
        };
        let at_edge = TargetShape { is_uncovered: true, ..open };
        let kind_of = |parts: &[(TargetShape, usize)], has_moved: bool| {
            let mut kinds = Kinds::new();
            for &(shape, count) in parts {
                (0..count).for_each(|_| kinds.measure(shape, false));
            }
            kinds.belief(has_moved).kind()
        };
        assert_ne!(kind_of(&[(at_edge, 1)], true), TrackKind::Flying);
        assert_ne!(kind_of(&[(at_edge, 10)], true), TrackKind::Flying);
        assert_ne!(kind_of(&[(at_edge, 1), (open, 20)], false), TrackKind::Flying);
        // The opposites: what comes out from behind the edge and moves on, what passes behind one, and what comes
        // to stand beside one.
        assert_eq!(kind_of(&[(at_edge, 3), (open, 4)], true), TrackKind::Flying);
        assert_eq!(kind_of(&[(open, 20), (at_edge, 5)], true), TrackKind::Flying);
        assert_eq!(kind_of(&[(open, 20), (at_edge, 5)], false), TrackKind::Flying);
    }

    #[test]
    fn accelerations_that_were_not_measured_tell_nothing() {
        let mut kinds = Kinds::new();
        for unknown in [[0.0, 9.0], [5.0, 8.9], [5.0, 0.0], [5.0, f64::NAN]] {
            kinds.feel([unknown; 3], 3.0, 0.1);
            assert_eq!(kinds.agility, 0.0, "{unknown:?}");
        }
        kinds.feel([[0.0, 1.0]; 3], 1.0, 0.1); // as much as a track with another prior begins with
        assert_eq!(kinds.agility, 0.0);
        // Two short steps are one long one.
        let mut other = kinds;
        kinds.feel([[4.0, 1.0]; 3], 3.0, 0.2);
        (0..2).for_each(|_| other.feel([[4.0, 1.0]; 3], 3.0, 0.1));
        assert!((kinds.agility - other.agility).abs() < 1e-12 && kinds.agility > 0.0);
    }

    /// Kind after ten detections with this radius [m] and acceleration, whose places have these properties.
    fn at_place(radius: f64, share: f64, hangs: bool, acceleration: f64) -> TrackKind {
        let shape = TargetShape {
            n_points: 10,
            radius: 0.25,
            least_radius: radius,
            filled_share: 0.5,
            coherence: Coherence::default(),
            is_free_below: None,
            is_over_unseen: false,
            is_uncovered: false,
        };
        let mut kinds = Kinds::new();
        for _ in 0..10 {
            kinds.measure(shape, false);
            kinds.visit(share, hangs);
            kinds.feel([[acceleration, 1.0]; 3], 3.0, 0.1);
        }
        kinds.belief(true).kind()
    }

    #[test]
    fn what_hangs_beside_structure_is_clutter_if_it_is_small_and_sways() {
        assert_eq!(at_place(0.1, 0.0, true, 1.0), TrackKind::Clutter);
        // The opposites: away from structure, much larger, or with hard manoeuvres.
        assert_eq!(at_place(0.1, 0.0, false, 1.0), TrackKind::Flying);
        assert_eq!(at_place(0.5, 0.0, true, 1.0), TrackKind::Unknown); // it may hover
        assert_eq!(at_place(0.2, 0.0, true, 6.0), TrackKind::Flying);
    }

    #[test]
    fn what_comes_where_things_often_came_and_went_does_not_fly() {
        assert_ne!(at_place(0.25, 0.8, false, 1.0), TrackKind::Flying);
        assert_eq!(at_place(0.25, 0.3, false, 1.0), TrackKind::Flying);
    }

    #[test]
    fn what_stands_is_static_and_what_moves_is_not() {
        let mut kinds = Kinds::new();
        (0..3).for_each(|_| kinds.see(0.1, 0.5));
        assert_eq!(kinds.belief(true).kind(), TrackKind::Static);
        (0..5).for_each(|_| kinds.see(0.5, 0.1));
        assert_eq!(kinds.belief(true).kind(), TrackKind::Flying);
    }
}
