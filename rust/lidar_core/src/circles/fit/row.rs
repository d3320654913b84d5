//! A scan that shows one object: all its hits are one segment.

use super::FitParameters;
use crate::circles::preprocess::polar_scan::PolarScan;
use crate::circles::segment::segments::{Segments, Side};

/// Make one segment of all hits of a scan, which may be a full circle; none if there is no hit.
pub(super) fn one_segment(
    (scan, full): (&PolarScan, bool),
    parameters: &FitParameters,
    into: &mut Segments,
) {
    into.labels.clear();
    into.labels.extend(scan.ranges.iter().map(|range| i32::from(range.is_finite())));
    into.rays.clear();
    into.sides.clear();
    into.starts.clear();
    into.starts.push(0);
    let count = scan.len();
    // The segment must not be cut by the seam of the scan: it begins behind its widest gap.
    let begin = if full { after_longest_gap(&scan.ranges) } else { 0 };
    let order = (begin..count).chain(0..begin);
    into.rays.extend(order.filter(|&ray| scan.ranges[ray].is_finite()).map(|ray| ray as u32));
    let (Some(&first), Some(&last)) = (into.rays.first(), into.rays.last()) else { return };
    into.starts.push(into.rays.len());
    let nearest = scan.ranges.iter().copied().fold(f64::INFINITY, f64::min);
    let [near, far] = parameters.range_limits;
    let reach = parameters.radius[1] + 5.0 * parameters.range_std;
    let is_cut = nearest + reach > far || nearest < near + CLOSE;
    let beside = |ray: Option<usize>| match ray.map(|ray| scan.ranges[ray]) {
        None => Side::FieldEdge,
        Some(f64::INFINITY) if is_cut => Side::RangeCut,
        Some(f64::INFINITY) => Side::Free,
        Some(_) => Side::Occluded,
    };
    let before = (first as usize).checked_sub(1).or(full.then(|| count - 1));
    let after = Some(last as usize + 1).filter(|&ray| ray < count).or(full.then_some(0));
    into.sides.push([beside(before), beside(after)]);
}

/// Distance of the nearest hit from the near range limit [m] above which no part of the object is
/// nearer than that limit.
const CLOSE: f64 = 0.15;

/// Ray after the longest run of rays without a hit, in a full circle.
fn after_longest_gap(ranges: &[f64]) -> usize {
    let count = ranges.len();
    let (mut best, mut length, mut run) = (0, 0, 0);
    // Two rounds, so that a gap across the seam counts as one.
    for step in 0..2 * count {
        if ranges[step % count].is_finite() {
            run = 0;
        } else {
            run += 1;
            if run > length && run <= count {
                (length, best) = (run, (step + 1) % count);
            }
        }
    }
    best
}
