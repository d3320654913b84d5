//! Holes in a scan: directions beside a cluster from which nothing returned, up to a surface.
//!
//! What seems to fly may hang on something that swallows light: the body of a person whose dark legs
//! return nothing, a bright part of a dark car. The rays past a real target return from behind it, up to
//! its edges. If they do not, and the hole that they leave ends at a surface at the range of the
//! cluster, the hole is probably the missing part.

use crate::flying::classify::clusters::Cluster;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{dot, minus, norm};

/// Returns this much nearer or further away are those of something else [m].
const DEPTH: f64 = 1.0;
/// Longest hole [m]: a leg, the side of a car.
const LONGEST: f64 = 1.5;
/// Surfaces nearer to a cluster are parts of it [m].
const SHORTEST: f64 = 0.2;
/// Usual returns are counted this far around the edge of a cluster [m].
const AROUND: f64 = 2.5;
/// Narrowest hole [m]; surfaces may lie this far beside its end.
const NARROWEST: f64 = 0.3;
const ASIDE: f64 = 0.4;
/// Usual returns at the level of a hole are counted this far on both sides of it [m].
const BESIDE: f64 = 1.0;
/// A hole is this share of the way to the surface, in its middle: rows of a sensor are not straight.
const MIDDLE: f64 = 0.6;
/// Share of the usual returns that a hole still gives, and how many times more likely it must be than
/// no hole.
const LEAK: f64 = 0.15;
const ODDS: f64 = 20.0;
/// Returns further aside than this angle are not looked at: square of the cosine of 37 degrees.
const AHEAD_SQUARED: f64 = 0.64;

/// True if a hole joins a cluster to a surface at its range. `is_flying` tells of every row of the
/// scan whether it is of something that seems to fly: that is no surface.
pub(crate) fn is_joined(scan: &Prepared, cluster: &Cluster<'_>, is_flying: &[bool]) -> bool {
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
    let sides = [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)];
    sides.into_iter().any(|(axis, sign)| {
        let across = 1 - axis;
        let edge = if sign > 0.0 { high[axis] } else { -low[axis] };
        let middle = 0.5 * (low[across] + high[across]);
        let half = 0.5 * (high[across] - low[across]).max(NARROWEST);
        let is_sky = |along: f64| {
            let mut place = [middle; 2];
            place[axis] = sign * (edge + 0.5 * along);
            scan.look.as_ref().is_some_and(|look| look.is_sky_at(view.direction(place)))
        };
        has_hole(&seen, half, is_sky, |place| {
            [sign * place[axis] - edge, (place[across] - middle).abs()]
        })
    })
}

/// True if a hole begins at the edge of a cluster and ends at a surface. `beside` gives the distance
/// of a place beyond that edge, and from the middle of the cluster across it; the hole is `half` as
/// wide as twice that.
fn has_hole(
    seen: &[Seen],
    half: f64,
    is_sky: impl Fn(f64) -> bool,
    beside: impl Fn([f64; 2]) -> [f64; 2],
) -> bool {
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
        if usual.into_iter().all(|usual| is_dark(lit, usual)) && !is_sky(end) {
            return true;
        }
    }
    false
}

/// Returns beside a cluster in the order of their distance from its edge, counted up to one.
struct Counted<'a> {
    rest: std::iter::Peekable<std::slice::Iter<'a, (f64, f64, &'a Seen)>>,
    half: f64,
    /// At the level of a hole, in it and on both sides.
    level: f64,
    /// In it, at another range.
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

/// True if `count` returns are more likely those of a hole than of nothing, where `usual` ones come
/// without it: both are Poisson distributed.
fn is_dark(count: f64, usual: f64) -> bool {
    (1.0 - LEAK) * usual + count * libm::log(LEAK) > libm::log(ODDS)
}

/// A return that is seen near a cluster.
struct Seen {
    /// Right of the cluster's middle and above it, in the plane across the line of sight [m].
    place: [f64; 2],
    /// True if it is nearer or further away than the cluster.
    is_else: bool,
    /// True if it is at the range of the cluster and does not seem to fly.
    is_surface: bool,
}

/// The view from the sensor to a cluster.
struct View {
    origin: [f64; 3],
    range: f64,
    ahead: [f64; 3],
    right: [f64; 3],
    up: [f64; 3],
}

impl View {
    fn of(scan: &Prepared, cluster: &Cluster<'_>) -> Option<Self> {
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

    /// Direction of a place in the plane through the cluster.
    fn direction(&self, [right, up]: [f64; 2]) -> [f64; 3] {
        [0, 1, 2].map(|axis| {
            self.range * self.ahead[axis] + right * self.right[axis] + up * self.up[axis]
        })
    }

    /// Where a point is seen in the plane through the cluster across the line of sight [m], and how
    /// much further away than the cluster it is [m].
    fn seen(&self, point: [f64; 3]) -> Option<([f64; 2], f64)> {
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
