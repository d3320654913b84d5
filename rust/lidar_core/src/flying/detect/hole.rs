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
const LONGEST: f64 = 2.0;
/// Surfaces nearer to a cluster are parts of it [m].
const SHORTEST: f64 = 0.2;
/// The returns of how many rays are usual is counted in a square of this half width [m].
const AROUND: f64 = 2.5;
/// Narrowest hole [m]; surfaces may lie this far beside its end.
const NARROWEST: f64 = 0.3;
const ASIDE: f64 = 0.4;
/// A hole has less than this share of the usual returns, when one return more is counted: where few
/// are usual, none tells nothing.
const DARK: f64 = 0.2;
/// Returns further aside than this angle belong to no hole: cosine of 37 degrees.
const AHEAD: f64 = 0.8;

/// True if a hole joins a cluster to a surface at its range.
pub(crate) fn is_joined(scan: &Prepared, cluster: &Cluster<'_>) -> bool {
    let Some(view) = Side::facing(scan, cluster) else { return false };
    let seen: Vec<Seen> = scan.points.iter().filter_map(|&point| view.seen(wide(point))).collect();
    let own = cluster.members.iter().filter_map(|&row| view.seen(wide(scan.points[row as usize])));
    let mut low = [f64::INFINITY; 2];
    let mut high = [f64::NEG_INFINITY; 2];
    let mut count = 0.0;
    for Seen { place, .. } in own {
        for axis in 0..2 {
            low[axis] = low[axis].min(place[axis]);
            high[axis] = high[axis].max(place[axis]);
        }
        count += 1.0;
    }
    let middle = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]));
    let is_around =
        |seen: &&Seen| [0, 1].iter().all(|&axis| (seen.place[axis] - middle[axis]).abs() < AROUND);
    let around = seen.iter().filter(is_around).count() as f64 - count;
    let usual = around / (2.0 * AROUND).powi(2);
    let sides = [(0, 1.0, high[0]), (0, -1.0, -low[0]), (1, 1.0, high[1]), (1, -1.0, -low[1])];
    sides.into_iter().any(|(axis, sign, edge)| {
        let across = 1 - axis;
        let half = 0.5 * (high[across] - low[across]).max(NARROWEST);
        let (mut ends, mut lit) = (Vec::new(), Vec::new());
        for Seen { place, beyond } in &seen {
            let along = sign * place[axis] - edge;
            let aside = (place[across] - middle[across]).abs();
            if along <= 0.0 || along > LONGEST {
                continue;
            }
            if beyond.abs() <= DEPTH {
                if along > SHORTEST && aside <= half + ASIDE {
                    ends.push(along);
                }
            } else if aside <= half {
                lit.push(along);
            }
        }
        ends.iter().any(|&end| {
            let inside = lit.iter().filter(|&&along| along < end).count() as f64;
            inside + 1.0 < DARK * usual * end * 2.0 * half
        })
    })
}

/// A return, seen beside a cluster.
struct Seen {
    /// Right and up of the cluster's middle, where its line of sight meets the plane across the line
    /// of sight to the cluster [m].
    place: [f64; 2],
    /// How much further away than the cluster it is [m].
    beyond: f64,
}

/// The view from the sensor to a cluster.
struct Side {
    origin: [f64; 3],
    range: f64,
    ahead: [f64; 3],
    right: [f64; 3],
    up: [f64; 3],
}

impl Side {
    fn facing(scan: &Prepared, cluster: &Cluster<'_>) -> Option<Self> {
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
        let up = cross(right, ahead);
        Some(Self { origin, range, ahead, right, up })
    }

    fn seen(&self, point: [f64; 3]) -> Option<Seen> {
        let offset = minus(point, self.origin);
        let range = norm(offset);
        let ahead = dot(offset, self.ahead);
        if !(ahead > AHEAD * range) {
            return None; // also where a coordinate is not finite
        }
        let scale = self.range / ahead;
        let place = [scale * dot(offset, self.right), scale * dot(offset, self.up)];
        Some(Seen { place, beyond: range - self.range })
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
