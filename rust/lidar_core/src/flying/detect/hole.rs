//! Holes in a scan: directions beside a cluster from which nothing returns, up to a surface.
//!
//! A cluster that seems to fly may be part of an object that absorbs light: the body of a person whose dark legs return
//! nothing, or a bright part of a dark car. Rays past a real target return from behind it, up to its edges. If they do
//! not, and the hole ends at a surface at the range of the cluster, the hole is probably the missing part.

use crate::flying::classify::clusters::Cluster;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{dot, minus, norm};

/// Returns that are nearer or further away than the cluster by more than this belong to another object [m].
const DEPTH: f64 = 1.0;
/// Length of the longest hole [m]: a leg, or the side of a car.
const LONGEST: f64 = 1.5;
/// Distance from the cluster within which surfaces are parts of it [m].
const SHORTEST: f64 = 0.2;
/// Distance from the edge of a cluster up to which returns are counted to find the usual density [m].
const AROUND: f64 = 2.5;
/// Width of the narrowest hole [m]. `ASIDE`: distance beside the end of a hole within which its surface may be [m].
const NARROWEST: f64 = 0.3;
const ASIDE: f64 = 0.4;
/// Distance to both sides of a hole up to which returns are counted at its level [m].
const BESIDE: f64 = 1.0;
/// Share of the distance to the surface, in its middle, that must be dark. Rows of a sensor are not straight.
const MIDDLE: f64 = 0.6;
/// Share of the usual returns that a hole still gives. `ODDS`: likelihood ratio of a hole to no hole that is
/// required.
const LEAK: f64 = 0.15;
const ODDS: f64 = 20.0;
/// Square of the cosine of the largest angle, 37 degrees, up to which returns aside are looked at.
const AHEAD_SQUARED: f64 = 0.64;

/// True if a hole connects a cluster with a surface at its range. `is_flying`: for every point of the scan, whether it
/// belongs to an object that seems to fly and is therefore no surface.
pub(crate) fn is_joined(scan: &Prepared, cluster: &Cluster<'_>, is_flying: &[bool]) -> bool {
    // Longer than other functions: four sides are asked alike; the closures share the edges of the
    // cluster.
    let Some(view) = View::of(scan, cluster) else { return false };
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let own = cluster.members.iter().filter_map(|&row| view.seen(wide(scan.points[row as usize])));
    for (place, _) in own {
        for axis in 0..2 {
            low[axis] = low[axis].min(place[axis]);
            high[axis] = high[axis].max(place[axis]);
        }
    }
    let is_near = |place: &[f64; 2]| {
        [0, 1].iter().all(|&axis| (low[axis] - AROUND..high[axis] + AROUND).contains(&place[axis]))
    };
    let seen: Vec<Seen> = (scan.points.iter().zip(is_flying))
        .filter_map(|(&point, &is_flying)| {
            let (place, beyond) = view.seen(wide(point)).filter(|(place, _)| is_near(place))?;
            let is_level = beyond.abs() <= DEPTH;
            Some(Seen { place, is_else: !is_level, is_surface: is_level && !is_flying })
        })
        .collect();
    let sky = scan.sky_observation.as_ref();
    let sides = [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)].map(|(axis, sign)| {
        let across = 1 - axis;
        let edge = if sign > 0.0 { high[axis] } else { -low[axis] };
        let middle = 0.5 * (low[across] + high[across]);
        let half = 0.5 * (high[across] - low[across]).max(NARROWEST);
        ClusterSide { axis, sign, edge, middle, half }
    });
    let is_sky = |side: &ClusterSide, along: f64| {
        let direction = view.direction(side.place(0.5 * along));
        sky.is_some_and(|sky| sky.reach_at(direction) > view.range)
    };
    let cast = |side: &ClusterSide, along: f64| {
        let direction = view.direction(side.place(0.5 * along));
        sky.map_or(0.0, |sky| sky.density_at(direction) / (view.range * view.range))
    };
    let has_rows = sky.is_some_and(|sky| sky.has_rows());
    sides.iter().any(|side| {
        let density = |along| (!has_rows).then(|| cast(side, along));
        has_hole(&seen, side.half, |along| is_sky(side, along), density, |place| side.seen(place))
    })
}

/// One of the four sides of a cluster, in the plane across the line of sight.
struct ClusterSide {
    /// The axis that points away from the cluster, and its sign.
    axis: usize,
    sign: f64,
    /// Position of the cluster's edge along this axis [m].
    edge: f64,
    /// Middle of the cluster across this axis, and half its width [m].
    middle: f64,
    half: f64,
}

impl ClusterSide {
    /// The place in the plane at a distance beyond the edge [m].
    fn place(&self, along: f64) -> [f64; 2] {
        let mut place = [self.middle; 2];
        place[self.axis] = self.sign * (self.edge + along);
        place
    }

    /// Distance of a place beyond the edge, and its distance from the middle [m].
    fn seen(&self, place: [f64; 2]) -> [f64; 2] {
        let across = 1 - self.axis;
        [self.sign * place[self.axis] - self.edge, (place[across] - self.middle).abs()]
    }
}

/// True if a hole begins at the edge of a cluster and ends at a surface. `beside` gives the distance of a place
/// beyond that edge, and from the middle of the cluster across it. `half`: half the width of the hole [m].
fn has_hole(
    seen: &[Seen],
    half: f64,
    is_sky: impl Fn(f64) -> bool,
    density: impl Fn(f64) -> Option<f64>,
    beside: impl Fn([f64; 2]) -> [f64; 2],
) -> bool {
    // Longer than other functions: one pass over the returns beside an edge, each of which may be
    // the end of a hole.
    let (mut all, mut column, mut row) = (0.0, 0.0, Vec::new());
    for one in seen {
        let [along, aside] = beside(one.place);
        if along.abs() < AROUND && aside < AROUND {
            all += 1.0;
            column += f64::from(u8::from(aside <= half));
            if along > 0.0 && along < LONGEST {
                row.push((along, aside, one));
            }
        }
    }
    row.sort_unstable_by(|one, other| one.0.total_cmp(&other.0));
    let (length_share, width_share) = (MIDDLE * 0.5 / AROUND, half / AROUND);
    let level_share = half / (half + BESIDE);
    let (mut to_begin, mut to_end) = (Counted::of(&row, half), Counted::of(&row, half));
    for &(end, aside, one) in &row {
        if !one.is_surface || end < SHORTEST || aside > half + ASIDE {
            continue;
        }
        to_begin.count_to(0.5 * (1.0 - MIDDLE) * end);
        to_end.count_to(0.5 * (1.0 + MIDDLE) * end);
        let (lit, level) = (to_end.lit - to_begin.lit, to_end.level - to_begin.level);
        // Sensors with rows leave gaps: what the row and the column of the hole hold elsewhere is
        // usual, too.
        let length_share = end * length_share;
        let usual = [all * length_share * width_share, level * level_share, column * length_share];
        let cast = density(end).map(|density| density * MIDDLE * end * 2.0 * half);
        let is_hole = usual.into_iter().all(|usual| is_dark(lit, usual))
            || cast.is_some_and(|cast| is_dark(lit, cast));
        if is_hole && !is_sky(end) {
            return true;
        }
    }
    false
}

/// Counts of the returns beside a cluster, in the order of their distance from its edge, up to some distance.
struct Counted<'a> {
    rest: std::iter::Peekable<std::slice::Iter<'a, (f64, f64, &'a Seen)>>,
    half: f64,
    /// Number of returns at the level of the hole, in it and on both sides.
    level: f64,
    /// Number of returns inside the hole at another range than the cluster.
    lit: f64,
}

impl<'a> Counted<'a> {
    fn of(row: &'a [(f64, f64, &'a Seen)], half: f64) -> Self {
        Self { rest: row.iter().peekable(), half, level: 0.0, lit: 0.0 }
    }

    fn count_to(&mut self, distance: f64) {
        while let Some(&(_, aside, one)) = self.rest.next_if(|(along, ..)| *along < distance) {
            self.level += f64::from(u8::from(aside <= self.half + BESIDE));
            self.lit += f64::from(u8::from(one.is_else && aside <= self.half));
        }
    }
}

/// True if `count` returns are much more likely with a hole than without one. `usual`: expected number without a
/// hole. Both counts are Poisson distributed.
fn is_dark(count: f64, usual: f64) -> bool {
    (1.0 - LEAK) * usual + count * libm::log(LEAK) > libm::log(ODDS)
}

/// A return that is seen near a cluster.
struct Seen {
    /// Position to the right of the cluster's middle and above it, in the plane across the line of sight [m].
    place: [f64; 2],
    /// Whether it is nearer or further away than the cluster, and so belongs to another object.
    is_else: bool,
    /// Whether it is at the range of the cluster and does not seem to fly.
    is_surface: bool,
}

/// The view from the sensor to a cluster: range [m] and axes.
pub(super) struct View {
    origin: [f64; 3],
    pub(super) range: f64,
    ahead: [f64; 3],
    right: [f64; 3],
    up: [f64; 3],
}

impl View {
    pub(super) fn of(scan: &Prepared, cluster: &Cluster<'_>) -> Option<Self> {
        let origin = scan.pose.translation;
        let to = minus(cluster.centroid, origin);
        let range = norm(to);
        if range <= 0.0 {
            return None;
        }
        let ahead = to.map(|part| part / range);
        let level = libm::hypot(ahead[0], ahead[1]);
        let right = match level > 0.0 {
            true => [ahead[1] / level, -ahead[0] / level, 0.0],
            false => [1.0, 0.0, 0.0],
        };
        Some(Self { origin, range, ahead, right, up: cross(right, ahead) })
    }

    /// Vector from the sensor to a place in the plane through the cluster [m].
    pub(super) fn direction(&self, [right, up]: [f64; 2]) -> [f64; 3] {
        [0, 1, 2].map(|axis| {
            self.range * self.ahead[axis] + right * self.right[axis] + up * self.up[axis]
        })
    }

    /// Vector from the sensor to a point [m].
    pub(super) fn way(&self, point: [f64; 3]) -> [f64; 3] {
        minus(point, self.origin)
    }

    /// Position of a point as seen in the plane through the cluster across the line of sight [m], and the difference
    /// of its range to that of the cluster [m]. None if it is not ahead.
    pub(super) fn seen(&self, point: [f64; 3]) -> Option<([f64; 2], f64)> {
        let offset = minus(point, self.origin);
        let (ahead, squared) = (dot(offset, self.ahead), dot(offset, offset));
        let is_ahead = ahead > 0.0 && ahead * ahead > AHEAD_SQUARED * squared;
        let scale = self.range / ahead;
        let place = [scale * dot(offset, self.right), scale * dot(offset, self.up)];
        is_ahead.then(|| (place, squared.sqrt() - self.range))
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::classify::clusters::Clusters;
    use crate::geometry::transform::Transform;

    /// Height of the ground relative to the sensor; distances of the object and the wall behind it [m].
    const GROUND: f64 = -1.5;
    const OBJECT: f64 = 10.0;
    const WALL: f64 = 16.0;

    /// Objects in the test scenes: a person whose legs return nothing, only the body, or two bodies.
    #[derive(Clone, Copy, PartialEq)]
    enum Shown {
        DarkLegs,
        Body,
        TwoBodies,
    }

    /// A scan of a scene: the returns in front of the sensor, and the labels of their clusters.
    fn scene(shown: Shown, row_step_deg: f64, has_wall: bool) -> (Prepared, Vec<i32>) {
        let (mut points, mut labels) = (Vec::new(), Vec::new());
        let rows = (24.0 / row_step_deg) as i32;
        for row in -rows / 2..=rows / 2 {
            for column in -40..=40 {
                let slope = libm::tan((f64::from(row) * row_step_deg).to_radians());
                let aside = libm::tan((f64::from(column) * 0.3).to_radians());
                let at = |distance: f64| [distance, aside * distance, slope * distance];
                let [_, y, z] = at(OBJECT);
                let is_body = y.abs() < 0.25 && (-0.6..0.2).contains(&z);
                let is_leg = y.abs() < 0.25 && z < -0.6;
                let is_other = (y - 1.0).abs() < 0.25 && (-0.6..0.2).contains(&z);
                let ground = GROUND / slope.min(-1e-9);
                let (point, label) = if is_body {
                    (at(OBJECT), 0)
                } else if shown == Shown::TwoBodies && is_other {
                    (at(OBJECT), 1)
                } else if shown == Shown::DarkLegs && is_leg && ground > OBJECT {
                    continue;
                } else if ground < WALL {
                    (at(ground), -1)
                } else if has_wall {
                    (at(WALL), -1)
                } else {
                    continue;
                };
                points.push(point.map(|value| value as f32));
                labels.push(label);
            }
        }
        let mut scan = Prepared::default();
        scan.pose = Transform::IDENTITY;
        scan.points = points;
        (scan, labels)
    }

    /// Whether the first cluster is joined to a surface, if the clusters `flying` seem to fly.
    fn joined(scan: &Prepared, labels: &[i32], flying: &[i32]) -> bool {
        let mut clusters = Clusters::default();
        clusters.fill(&scan.points, labels);
        let is_flying: Vec<bool> = labels.iter().map(|label| flying.contains(label)).collect();
        is_joined(scan, &clusters.get(0), &is_flying)
    }

    #[test]
    fn dark_legs_join_a_body_to_the_ground() {
        let (scan, labels) = scene(Shown::DarkLegs, 0.3, true);
        assert!(joined(&scan, &labels, &[0]));
    }

    #[test]
    fn a_body_with_returns_from_behind_below_it_is_alone() {
        for step in [0.3, 1.0, 2.0] {
            let (scan, labels) = scene(Shown::Body, step, true);
            assert!(!joined(&scan, &labels, &[0]), "rows {step} deg apart");
        }
    }

    #[test]
    fn open_sky_around_a_body_is_no_hole() {
        for step in [0.3, 1.0, 2.0] {
            let (scan, labels) = scene(Shown::Body, step, false);
            assert!(!joined(&scan, &labels, &[0]), "rows {step} deg apart");
        }
    }

    #[test]
    fn what_flies_beside_a_body_is_no_surface() {
        let (scan, labels) = scene(Shown::TwoBodies, 0.3, true);
        let mut cut = Prepared::default();
        cut.pose = scan.pose;
        let keeps = |point: &[f32; 3], label: i32| {
            label >= 0 || !(0.25..0.75).contains(&(10.0 * point[1] / point[0]))
        };
        let kept: Vec<usize> =
            (0..labels.len()).filter(|&row| keeps(&scan.points[row], labels[row])).collect();
        cut.points = kept.iter().map(|&row| scan.points[row]).collect();
        let labels: Vec<i32> = kept.iter().map(|&row| labels[row]).collect();
        assert!(joined(&cut, &labels, &[0])); // nothing returns from between them
        assert!(!joined(&cut, &labels, &[0, 1]));
    }

    /// Reference implementation of the search, one hole at a time.
    fn has_hole_plainly(seen: &[Seen], half: f64) -> bool {
        let count = |holds: &dyn Fn(f64, f64, &Seen) -> bool| {
            let is_in = |one: &&Seen| {
                let [along, aside] = [one.place[0], one.place[1].abs()];
                along.abs() < AROUND && aside < AROUND && holds(along, aside, one)
            };
            seen.iter().filter(is_in).count() as f64
        };
        seen.iter().any(|end| {
            let [length, aside] = [end.place[0], end.place[1].abs()];
            if !end.is_surface || !(SHORTEST..LONGEST).contains(&length) || aside > half + ASIDE {
                return false;
            }
            let middle = 0.5 * (1.0 - MIDDLE) * length..0.5 * (1.0 + MIDDLE) * length;
            let lit =
                count(&|along, aside, one| middle.contains(&along) && aside <= half && one.is_else);
            let area = [MIDDLE * length / (2.0 * AROUND), 2.0 * half / (2.0 * AROUND)];
            let usual = [
                count(&|_, _, _| true) * area[0] * area[1],
                count(&|along, aside, _| middle.contains(&along) && aside <= half + BESIDE) * half
                    / (half + BESIDE),
                count(&|_, aside, _| aside <= half) * area[0],
            ];
            usual.iter().all(|&usual| is_dark(lit, usual))
        })
    }

    #[test]
    fn holes_are_those_of_the_definition() {
        let mut state = 12_345_u64;
        let mut uniform = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut found = [0; 2];
        for round in 0..200 {
            let (half, cleared) = (0.15 + 0.3 * uniform(), 2.0 * uniform());
            let mut seen = Vec::new();
            for _ in 0..600 {
                let place = [6.0 * uniform() - 3.0, 6.0 * uniform() - 3.0];
                let is_level = uniform() < 0.2;
                let is_cleared = (0.0..cleared).contains(&place[0]) && place[1].abs() < half;
                if !is_cleared || uniform() < 0.05 {
                    seen.push(Seen { place, is_else: !is_level, is_surface: is_level });
                }
            }
            let holes = has_hole(&seen, half, |_| false, |_| None, |[x, y]| [x, y.abs()]);
            assert_eq!(holes, has_hole_plainly(&seen, half), "round {round}");
            assert!(
                !has_hole(&seen, half, |_| true, |_| None, |[x, y]| [x, y.abs()]),
                "all of it is sky"
            );
            found[usize::from(holes)] += 1;
        }
        assert!(found.iter().all(|&count| count > 20), "{found:?}");
    }
}
