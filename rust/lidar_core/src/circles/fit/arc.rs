//! Hits of one segment in polar coordinates about the direction of its middle, with the rays beside
//! it.

use super::FitParameters;
use crate::Error;
use crate::circles::preprocess::polar_scan::{PolarScan, turn};
use crate::circles::segment::segments::{Segments, Side};

/// Arcs with more hits are reduced to about this many by averaging all but the outermost: more cost
/// time and add no information.
const MANY: usize = 64;
/// Outermost hits that are not averaged: near the tangents the range is not linear in the bearing.
const KEPT: usize = 8;

/// Largest number of rays without return between two hits of an object.
const MOST_BETWEEN: usize = 50;

/// One hit of an arc, or the mean of several neighbouring hits: bearing from the middle of the arc
/// [rad] with its cosine and sine, and range [m].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::circles) struct Hit {
    pub(in crate::circles) bearing: f64,
    pub(in crate::circles) cosine: f64,
    pub(in crate::circles) sine: f64,
    pub(in crate::circles) range: f64,
    /// Number of hits joined.
    pub(in crate::circles) weight: f64,
}

/// Angle by which the object may extend beyond the outermost hit of one side.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::circles) struct Edge {
    /// Bearing of the outermost hit, from the middle of the arc [rad].
    pub(in crate::circles) bearing: f64,
    /// Largest angle from that hit to the tangent [rad].
    pub(in crate::circles) reach: f64,
    /// Angle to the next ray [rad], and its range [m]; NaN without a ray within reach.
    pub(in crate::circles) next: [f64; 2],
    /// Angles from the outermost hit to rays within reach that returned nothing [rad]. The object
    /// may cross these rays only outside the range limits.
    pub(in crate::circles) missed: Vec<f64>,
}

/// Hits of a segment, ordered by bearing, and the limits of the object on both sides.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::circles) struct Arc {
    /// Direction of its middle in the scan's frame [rad].
    pub(in crate::circles) bearing: f64,
    pub(in crate::circles) hits: Vec<Hit>,
    pub(in crate::circles) n_hits: usize,
    /// Smallest range of a hit [m].
    pub(in crate::circles) nearest: f64,
    /// Sum of squared ranges [m^2].
    pub(in crate::circles) square: f64,
    /// Sides of smaller and of larger bearings.
    pub(in crate::circles) edges: [Edge; 2],
    /// Bearings, from the middle of the arc, of rays between the hits that returned nothing [rad].
    /// Empty unless the range limits cut a side of the object: only then they may also cut it
    /// between the hits.
    pub(in crate::circles) missed: Vec<f64>,
}

/// Rays of a scan beyond one end of a segment.
struct OuterRays<'a> {
    scan: &'a PolarScan,
    /// Outermost ray.
    ray: usize,
    /// True if the rays beyond have larger indices.
    up: bool,
    /// True if the scan covers a full turn, so that its first ray is the neighbour of its last.
    wraps: bool,
}

impl OuterRays<'_> {
    /// Rays beyond the outermost one up to `reach` [rad], each with its angle from that one.
    fn rays(&self, reach: f64) -> impl Iterator<Item = (usize, f64)> + '_ {
        let (count, origin) = (self.scan.len(), self.scan.bearings[self.ray]);
        let (up, wraps) = (self.up, self.wraps);
        let step = move |ray: usize| match (up, wraps) {
            (true, true) => Some((ray + 1) % count),
            (true, false) => Some(ray + 1).filter(|&next| next < count),
            (false, true) => Some((ray + count - 1) % count),
            (false, false) => ray.checked_sub(1),
        };
        std::iter::successors(step(self.ray), move |&ray| step(ray))
            .take(count - 1)
            .map(move |ray| (ray, turn(self.scan.bearings[ray] - origin).abs()))
            .take_while(move |&(_, beyond)| beyond <= reach)
    }
}

impl Arc {
    /// Fill this arc with the segment with the index `number` of a scan. `wraps` is true if the
    /// scan covers a full turn, so that its first ray is the neighbour of its last.
    ///
    /// # Errors
    /// [`Error::Value`] if the segment is empty, or contains a ray without a hit.
    pub(in crate::circles) fn read(
        &mut self,
        (scan, wraps): (&PolarScan, bool),
        segments: &Segments,
        number: usize,
        parameters: &FitParameters,
    ) -> Result<(), Error> {
        let rays = segments.rays_of(number);
        let (Some(&first), Some(&last)) = (rays.first(), rays.last()) else {
            return Err(bad_segment(number, "no rays".into()));
        };
        self.read_hits(scan, rays).map_err(|got| bad_segment(number, got))?;
        let ascends = rises(scan);
        let mut sides = segments.sides.get(number).copied().unwrap_or([Side::Occluded; 2]);
        let mut ends = [first as usize, last as usize];
        if !ascends {
            // Scanners turn both ways: sides and ends come by number of ray, the arc is ordered by
            // bearing.
            sides.reverse();
            ends.reverse();
        }
        let bearings = [self.hits[0].bearing, self.hits[self.hits.len() - 1].bearing];
        for side in 0..2 {
            let outer = OuterRays { scan, ray: ends[side], up: (side == 1) == ascends, wraps };
            self.edges[side].bearing = bearings[side];
            self.read_edge(side, sides[side], &outer, parameters);
        }
        self.missed.clear();
        if sides.contains(&Side::RangeCut) {
            self.read_missed(scan, rays);
        }
        // An algebraic fit uses the points as they are; its caller averages them afterwards.
        if !parameters.method.is_algebraic() {
            self.join_hits();
        }
        Ok(())
    }

    fn read_hits(&mut self, scan: &PolarScan, rays: &[u32]) -> Result<(), String> {
        self.hits.clear();
        let middle = scan.bearings.get(rays[rays.len() / 2] as usize).copied().unwrap_or(f64::NAN);
        (self.bearing, self.n_hits) = (middle, rays.len());
        (self.nearest, self.square) = (f64::INFINITY, 0.0);
        for &ray in rays {
            let ray = ray as usize;
            let known = (scan.ranges.get(ray), scan.bearings.get(ray));
            let (Some(&range), Some(&bearing)) = known else { return Err(format!("ray {ray}")) };
            if !(range.is_finite() && range > 0.0 && bearing.is_finite()) {
                return Err(format!("{range} [m] at {bearing} [rad] in ray {ray}"));
            }
            // Relative to the middle no arc crosses the seam of the bearings.
            let bearing = turn(bearing - middle);
            let (cosine, sine) = (libm::cos(bearing), libm::sin(bearing));
            self.hits.push(Hit { bearing, cosine, sine, range, weight: 1.0 });
            self.nearest = self.nearest.min(range);
            self.square += range * range;
        }
        self.hits.sort_by(|a, b| a.bearing.total_cmp(&b.bearing));
        Ok(())
    }

    /// Find the angle by which the object may extend on one side, and the rays that limit it.
    fn read_edge(&mut self, side: usize, kind: Side, outer: &OuterRays<'_>, p: &FitParameters) {
        let most = p.radius[1];
        // The largest circle that is allowed, seen from tangent to tangent, since the outermost hit
        // may lie at the opposite one. A beam also returns from what it only grazes, on either
        // side.
        let widest = 2.0 * libm::asin(most / (self.nearest + most)) + 2.0 * p.beam_half_width;
        let behind = self.nearest + most + 5.0 * p.range_std; // no part of the circle is here
        let edge = &mut self.edges[side];
        edge.missed.clear();
        edge.reach = widest;
        edge.next = [f64::NAN; 2];
        let ranges = &outer.scan.ranges;
        for (index, (ray, beyond)) in outer.rays(widest).enumerate() {
            let range = ranges[ray];
            if index == 0 {
                edge.next = [beyond, range];
            }
            let passes = range > behind && range.is_finite();
            let missed = range == f64::INFINITY;
            // A ray that ends behind every possible circle passed it. One that returned nothing
            // passed it only if the circle would have been within the range limits. A nearer
            // surface hides the circle, so the search goes on behind it.
            match kind {
                Side::Free if index == 0 => edge.reach = beyond,
                Side::RangeCut if missed => edge.missed.push(beyond),
                Side::RangeCut | Side::Occluded if passes => edge.reach = beyond,
                Side::Occluded if missed && behind < p.range_limits[1] => edge.reach = beyond,
                Side::Occluded => {}
                _ => break,
            }
            if edge.reach < widest {
                break;
            }
        }
    }

    fn read_missed(&mut self, scan: &PolarScan, rays: &[u32]) {
        for pair in rays.windows(2) {
            let between = (pair[0].min(pair[1]) + 1) as usize..pair[0].max(pair[1]) as usize;
            if between.len() > MOST_BETWEEN {
                continue; // the seam of a full circle
            }
            let missed = between.filter(|&ray| scan.ranges[ray] == f64::INFINITY);
            self.missed.extend(missed.map(|ray| turn(scan.bearings[ray] - self.bearing)));
        }
    }

    /// Average the hits of a large arc, all but the outermost.
    pub(super) fn join_hits(&mut self) {
        let count = self.hits.len();
        if count <= MANY {
            return;
        }
        let joined = (count - 2 * KEPT).div_ceil(MANY - 2 * KEPT);
        let (mut target, mut start) = (KEPT, KEPT);
        while start < count - KEPT {
            let end = (start + joined).min(count - KEPT);
            let group = &self.hits[start..end];
            let weight = group.len() as f64;
            let bearing = group.iter().map(|hit| hit.bearing).sum::<f64>() / weight;
            let range = group.iter().map(|hit| hit.range).sum::<f64>() / weight;
            let (cosine, sine) = (libm::cos(bearing), libm::sin(bearing));
            self.hits[target] = Hit { bearing, cosine, sine, range, weight };
            (target, start) = (target + 1, end);
        }
        self.hits.copy_within(count - KEPT.., target);
        self.hits.truncate(target + KEPT);
        self.square = self.hits.iter().map(|hit| hit.weight * hit.range * hit.range).sum();
    }
}

/// True if the bearings grow from ray to ray.
fn rises(scan: &PolarScan) -> bool {
    match scan.bearings.as_slice() {
        [first, second, ..] => turn(second - first) >= 0.0,
        _ => true,
    }
}

fn bad_segment(number: usize, got: String) -> Error {
    Error::Value { name: "segments", expected: "rays that ended on something", index: number, got }
}
