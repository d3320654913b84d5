//! Model of an open frame: rotors, arms and a body, through which rays pass.

use super::coherence::{Coherence, coherence};
use super::filled::filled_share;
use super::sphere::Start;
use super::target_observation::{MARGIN, TargetObservation, TargetRay};
use super::{Center, Matrix3, Vector3};
use crate::estimation::kalman::symmetrised;
use crate::flying::large_targets::shape_weight;
use std::f64::consts::PI;

/// Solid shares of an open frame and of a closed body. The following pairs of values belong to
/// these two; between them they are interpolated linearly. They were measured on simulated
/// multicopters and boxes of 0.15 to 0.60 m radius at 5 to 20 m.
const SHARES: [f64; 2] = [0.3, 0.6];
/// Number of gaps between rays from the outermost points to the rim of the target: open frame,
/// closed body.
const RIM_GAPS: [f64; 2] = [1.5, 0.75];
/// Number of points from which on the spacing of the points limits the gap between rays. If it is
/// not known which rays passed, there is no other limit.
const SPACED: f64 = 3.0;
/// Distance of a closed body's centre behind the centroid, as a share of the radius. For a ball it
/// would be 0.68.
const CLOSED_SHIFT: f64 = 0.40;
/// Distance of an open frame's centre behind the centroid, as a share of the radius: if the whole
/// disc is visible, and if the frame is seen from its own height, where near rims hide the far
/// ones.
const OPEN_SHIFTS: [f64; 2] = [0.12, 0.25];
/// Sine of the elevation, above or below, from which on the whole disc of a frame is visible.
const WHOLE_DISC: f64 = 0.25;
/// Standard deviation of the distance between centroid and centre along the line of sight, as a
/// share of the radius: for one point, and the largest value. Points are samples from the depth of
/// the target, and some may be on one side of it.
const SHIFT_STD: [f64; 2] = [0.5, 0.2];
/// Height of a frame's centre above the centroid if it is seen from its own height, as a share of
/// the radius: skids hang below it.
const LIFT: f64 = 0.06;
/// Standard deviation of the centre across the line of sight that remains with any number of points
/// [m].
const ASIDE_STD: f64 = 0.02;
/// Standard deviations of a large target's centre across and along the line of sight, as shares of
/// half its size.
const LARGE_STD: [f64; 2] = [0.03, 0.1];
/// Distance of a ball's centre behind the centroid of its near side, as a share of the radius.
const BALL_SHIFT: f64 = 0.66;
/// Rays above a target belong to several rows if their heights differ by more than this [m].
const ROWS_APART: f64 = 0.1;
/// Number of rays above a target that make it improbable that none is below by chance.
const FEWEST_ABOVE: usize = 4;
/// Share of the gap between rays that a ray must be below a target to count as below. Rays of the
/// target's own lowest row are nearer: a row is a cone, and so a curve in the plane of the target.
const BELOW_GAPS: f64 = 0.5;
/// Rays that pass less than this below a target show nothing [m]. The next part of something that
/// stands on the ground may be just below the lower edge of the field of view, as shoulders are
/// below a head.
const BELOW: f64 = 0.1;
/// Smallest number of rays that end in front of what is just below a target, for the rays that pass there to show
/// nothing. A single one may be a drop of rain.
const ENOUGH_HIDDEN: usize = 2;
/// Share of a target's width, around its middle, below which rays count. Rays beside something that
/// stands on the ground reach the ground behind it.
const MIDDLE: f64 = 0.5;
/// Smallest radius with which the fit of a ball starts [m].
const LEAST_RADIUS: f64 = 0.05;

/// Estimate of the centre of an open frame or closed body, from the spread of the points alone.
pub(super) struct OpenFrame {
    pub(crate) position: Vector3<f64>,
    pub(crate) covariance: Matrix3<f64>,
    /// Half the width across the line of sight, as far as the passing rays bound it [m].
    pub(crate) radius: f64,
    /// Half the width, as far as the spacing of the points bounds it too [m].
    pub(super) least_radius: f64,
    /// Share of the rays inside the outline that hit the target. It is 1 for a solid target.
    pub(super) solid_share: f64,
    /// Share of the rays inside the ellipse around the points that hit the target.
    pub(super) filled_share: f64,
    pub(super) coherence: Coherence,
    /// Whether rays pass below the target. None if nothing shows it.
    pub(super) is_free_below: Option<bool>,
    centroid: Vector3<f64>,
    sight: Vector3<f64>,
    /// Half the width of the points [m].
    reach: f64,
}

impl OpenFrame {
    pub(crate) fn of(observation: &TargetObservation, range_std: f64) -> Self {
        // Longer than other functions: one estimate, whose terms share nearly all values.
        let count = observation.hits.len() as f64;
        let centroid = observation.hits.iter().map(|hit| hit.point).sum::<Vector3<f64>>() / count;
        let origin = observation.origin();
        let axes = axes_towards(centroid - origin);
        let outline = SeenExtent::of(observation, &centroid, origin, &axes);
        let [open, closed] = SHARES;
        let share = ((outline.solid_share - open) / (closed - open)).clamp(0.0, 1.0);
        let between = |[open, closed]: [f64; 2]| open + share * (closed - open);
        let [radius, least_radius] =
            [outline.ray_gap, outline.least_gap].map(|gap| outline.reach + between(RIM_GAPS) * gap);
        let sight = axes[2];
        let offsets = || observation.hits.iter().map(|hit| hit.point - centroid);
        let scatter: Matrix3<f64> = offsets().map(|offset| offset * offset.transpose()).sum();
        let along = sight * sight.transpose();
        let gap = outline.ray_gap * outline.ray_gap / (12.0 * count.sqrt());
        let level = (1.0 - sight.z.abs() / WHOLE_DISC).max(0.0);
        let [disc, rims] = OPEN_SHIFTS;
        let shift = between([disc + level * (rims - disc), CLOSED_SHIFT]) * radius;
        let shift_std = (SHIFT_STD[0] / count.sqrt()).min(SHIFT_STD[1]) * radius;
        let lift = (Vector3::z() - sight * sight.z) * (LIFT * level * radius); // across the sight
        let [low, high] = ends(offsets().map(|offset| offset.dot(&sight)));
        let half = outline.reach.max(0.5 * (high - low));
        // The middle of the box counts instead of the centroid: many rays meet the ends of a large target, and
        // its parts do not give returns alike.
        let large = shape_weight(2.0 * half);
        let middle = box_middle(offsets(), axes[0]);
        // Far parts are hidden or missed by the rays: both estimates are too near.
        let middle = middle + sight * (shift - middle.dot(&sight)).max(0.0);
        let [aside_std, depth_std] = LARGE_STD.map(|share| large * share * half);
        Self {
            position: centroid + (sight * shift + lift) * (1.0 - large) + middle * large,
            covariance: scatter / (count * count)
                + (Matrix3::identity() - along)
                    * (gap + ASIDE_STD * ASIDE_STD + aside_std * aside_std)
                + along
                    * (shift_std * shift_std
                        + depth_std * depth_std
                        + range_std * range_std / count),
            radius,
            least_radius,
            solid_share: outline.solid_share,
            filled_share: outline.filled_share,
            coherence: outline.coherence,
            is_free_below: outline.is_free_below,
            centroid,
            sight,
            reach: outline.reach,
        }
    }

    /// Start values for the fit of a ball.
    pub(crate) fn start(&self) -> Start {
        let radius = self.reach.max(LEAST_RADIUS);
        Start { center: self.centroid + self.sight * (BALL_SHIFT * radius), radius }
    }

    pub(super) fn into_center(self, observation: &TargetObservation) -> Center {
        let Self { position, radius, least_radius, filled_share, coherence, is_free_below, .. } =
            self;
        Center {
            position,
            covariance: symmetrised(self.covariance),
            radius,
            least_radius,
            filled_share,
            coherence,
            is_free_below,
            is_cut: observation.is_cut,
            is_at_edge: observation.is_at_edge,
        }
    }
}

/// Unit vectors: two across the line of sight (the first is horizontal), and along it.
fn axes_towards(span: Vector3<f64>) -> [Vector3<f64>; 3] {
    let forward = Vector3::x();
    let sight = span.try_normalize(f64::MIN_POSITIVE).unwrap_or(forward);
    let level = Vector3::new(-sight.y, sight.x, 0.0);
    let aside = level.try_normalize(1e-9).unwrap_or(Vector3::y()); // straight up or down
    [aside, sight.cross(&aside), sight]
}

/// Middle of the upright box around some places, turned to the line of sight. `aside`: the
/// horizontal side across the line of sight. Seen from below, the near end of a wing is higher in
/// the view than the far one, so the middle in the view would not be the middle of the wing.
fn box_middle(
    places: impl Iterator<Item = Vector3<f64>> + Clone,
    aside: Vector3<f64>,
) -> Vector3<f64> {
    let up = Vector3::z();
    let middle = |axis: Vector3<f64>| {
        let [low, high] = ends(places.clone().map(|place| place.dot(&axis)));
        axis * (0.5 * (low + high))
    };
    [aside, aside.cross(&up), up].map(middle).iter().sum()
}

/// The smallest and the largest of some values.
fn ends(values: impl Iterator<Item = f64> + Clone) -> [f64; 2] {
    [values.clone().fold(f64::MAX, f64::min), values.fold(f64::MIN, f64::max)]
}

/// Size and shares of a target, as seen from the sensor.
struct SeenExtent {
    /// Largest distance of the points from their middle, across the line of sight [m].
    reach: f64,
    /// Distance between neighbouring rays at the target [m].
    ray_gap: f64,
    /// The distance between neighbouring rays, or the spacing of the points if that is less [m].
    least_gap: f64,
    solid_share: f64,
    filled_share: f64,
    coherence: Coherence,
    is_free_below: Option<bool>,
}

impl SeenExtent {
    fn of(
        observation: &TargetObservation,
        centroid: &Vector3<f64>,
        origin: Vector3<f64>,
        axes: &[Vector3<f64>; 3],
    ) -> Self {
        // Longer than other functions: the widths and shares of one outline, from the same rays and
        // points.
        let [across, up, sight] = axes;
        let flat =
            |point: Vector3<f64>| [(point - centroid).dot(across), (point - centroid).dot(up)];
        let hits: Vec<[f64; 2]> = observation.hits.iter().map(|hit| flat(hit.point)).collect();
        let middle = [0, 1].map(|axis| {
            let [low, high] = ends(hits.iter().map(|hit| hit[axis]));
            0.5 * (low + high)
        });
        let off = |place: [f64; 2]| {
            ((place[0] - middle[0]).powi(2) + (place[1] - middle[1]).powi(2)).sqrt()
        };
        let reach = hits.iter().map(|&hit| off(hit)).fold(0.0, f64::max);
        let distance = (centroid - origin).norm();
        let crossings = |rays: &[TargetRay]| -> Vec<[f64; 2]> {
            let ahead = rays.iter().filter(|ray| ray.direction.dot(sight) > 0.0);
            ahead
                .map(|ray| ray.origin + ray.direction * (distance / ray.direction.dot(sight)))
                .map(flat)
                .collect()
        };
        let passing = crossings(&observation.passing);
        let within = |radius: f64| passing.iter().filter(|&&ray| off(ray) < radius).count() as f64;
        let window = reach + MARGIN;
        let count = hits.len() as f64;
        let ray_gap = window * (PI / (count + within(window))).sqrt();
        // So many rays fill a disc that reaches half a gap beyond the points.
        let root = (PI / count).sqrt();
        let own_gap = if count < SPACED { ray_gap } else { reach * root / (1.0 - 0.5 * root) };
        let solid_share = count / (count + within(reach + 0.5 * ray_gap));
        Self {
            reach,
            ray_gap,
            least_gap: ray_gap.min(own_gap),
            solid_share,
            filled_share: filled_share(&hits, &passing, ray_gap),
            coherence: coherence(&hits, &crossings(&observation.missed), ray_gap),
            is_free_below: is_free_below(&hits, &passing, &crossings(&observation.hiding), ray_gap),
        }
    }
}

/// Whether rays pass below the hits. `hits`, `passing` and `hiding` (rays that end in front of the
/// target) are positions in a plane across the line of sight [m], with the second axis up. No rays
/// pass below an object that stands on the ground, or that the lower edge of the field of view cuts
/// off. If more rays just below end in front than pass, the result is false: the passing rays go
/// through a mirror image, through glass or between leaves. None if few rays pass above too, because
/// the rays are then too far apart for a decision, or if rays pass only just below.
fn is_free_below(
    hits: &[[f64; 2]],
    passing: &[[f64; 2]],
    hiding: &[[f64; 2]],
    ray_gap: f64,
) -> Option<bool> {
    let bounds = |axis: usize| ends(hits.iter().map(|hit| hit[axis]));
    let ([left, right], [low, high]) = (bounds(0), bounds(1));
    let half = (0.5 * MIDDLE * (right - left)).max(ray_gap);
    let in_line = |ray: &&[f64; 2]| (ray[0] - 0.5 * (left + right)).abs() <= half;
    let just_below = low - MARGIN..low - BELOW_GAPS * ray_gap;
    let count = |rays: &[[f64; 2]]| {
        rays.iter().filter(in_line).filter(|ray| just_below.contains(&ray[1])).count()
    };
    let (passed, hidden) = (count(passing), count(hiding));
    if passed > 0 && hidden >= ENOUGH_HIDDEN && hidden > passed {
        return Some(false);
    }
    let level = passing.iter().filter(in_line).map(|ray| ray[1]);
    let lowest = level.clone().fold(f64::MAX, f64::min);
    if lowest < low - BELOW_GAPS * ray_gap {
        return (lowest < low - BELOW).then_some(true);
    }
    let above = level.filter(|&up| up > high);
    let rows = above.clone().fold(f64::MIN, f64::max) - above.clone().fold(f64::MAX, f64::min);
    (rows >= ROWS_APART && above.count() >= FEWEST_ABOVE).then_some(false)
}

#[cfg(test)]
mod tests {
    use super::is_free_below;

    /// Rows of rays 0.02 m apart, from `low` upwards. Each is lower at its ends, as a cone is in a
    /// plane.
    fn rows(low: f64) -> Vec<[f64; 2]> {
        let place = |at: i32| f64::from(at) * 0.02;
        let row = |up: i32| {
            (-10..=10).map(move |x| [place(x), low + place(up) - 0.05 * place(x).powi(2)])
        };
        (0..12).flat_map(row).collect()
    }

    #[test]
    fn a_row_that_bends_is_not_below() {
        let hits: Vec<[f64; 2]> =
            rows(0.0).into_iter().take(21).filter(|hit| hit[0].abs() < 0.09).collect();
        let beside = |ray: &[f64; 2]| !hits.contains(ray);
        let passing: Vec<[f64; 2]> = rows(0.0).into_iter().filter(beside).collect();
        assert!(passing.iter().any(|ray| ray[0].abs() < 0.11 && ray[1] < -0.0004));
        assert_eq!(is_free_below(&hits, &passing, &[], 0.02), Some(false));
        // Rows below it are, if they reach down far enough.
        for (low, is_free) in [(-0.02, None), (-0.08, None), (-0.12, Some(true))] {
            let passing: Vec<[f64; 2]> = rows(low).into_iter().filter(beside).collect();
            assert_eq!(is_free_below(&hits, &passing, &[], 0.02), is_free, "{low}");
        }
        // Rays on both sides of a thing that is wider than the gaps between them are not below it.
        let wide: Vec<[f64; 2]> = (-10..=10).map(|x| [0.02 * f64::from(x), 0.0]).collect();
        let mut passing = rows(0.04);
        passing.extend((-5..=0).flat_map(|up| [-0.21, 0.21].map(|x| [x, 0.02 * f64::from(up)])));
        assert_eq!(is_free_below(&wide, &passing, &[], 0.02), Some(false));
        passing.push([0.09, -0.12]);
        assert_eq!(is_free_below(&wide, &passing, &[], 0.02), Some(true));
        // Where more rays end in front, those that pass go through a mirror image or between leaves.
        let in_front = |count: usize| vec![[0.05, -0.12]; count];
        assert_eq!(is_free_below(&wide, &passing, &in_front(1), 0.02), Some(true));
        assert_eq!(is_free_below(&wide, &passing, &in_front(2), 0.02), Some(false));
        assert_eq!(is_free_below(&hits, &[], &in_front(5), 0.02), None); // no ray passes anywhere
        let aside_or_far_below: Vec<_> = [[0.3, -0.12], [0.05, -0.5]].repeat(2);
        assert_eq!(is_free_below(&wide, &passing, &aside_or_far_below, 0.02), Some(true));
        // Three rays above tell nothing.
        assert_eq!(is_free_below(&hits, &[[0.0, 0.1], [0.0, 0.2], [0.0, 0.3]], &[], 0.02), None);
    }
}
