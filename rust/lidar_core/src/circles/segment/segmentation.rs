//! Object segmentation, sec. III-C: groups of rays that ended on the same object.

use super::corners;
use super::merge::{self, Run};
use super::parameters::{Bound, SegmentParameters};
use super::segments::{Segments, Side};
use super::sweep::HitSweep;
use crate::Error;
use crate::circles::preprocess::polar_scan::PolarScan;
use crate::util::budget::check_points;
use std::ops::Range;

/// Group the rays of a scan by object, eq. 6.
///
/// Segments are numbered in the order of their first rays; the first one does not cross the seam of
/// a full circle. `seen` contains the ranges before the scan was limited to a volume, if it was: an
/// object that continues outside does not end there.
///
/// # Errors
/// [`Error::Length`] if the arrays differ in length, [`Error::Value`] for a bearing that is not
/// finite or a range that is negative.
///
/// # Source
/// Borges & Aldon, "Line Extraction in 2D Range Images for Mobile Robotics", 2004 (bound).
pub fn segment(
    scan: &PolarScan,
    seen: Option<&[f64]>,
    parameters: &SegmentParameters,
) -> Result<Segments, Error> {
    check(scan, seen)?;
    let hits: Vec<u32> =
        (0..scan.len()).filter(|&ray| scan.ranges[ray].is_finite()).map(|ray| ray as u32).collect();
    let seen = seen.unwrap_or(&scan.ranges);
    let mut sweep = HitSweep { scan, seen, hits, wraps: scan.is_full_circle() };
    let runs = sweep.runs(parameters);
    let roots = merge::merged(&sweep, &runs, parameters);
    Ok(sweep.segments(&runs, &roots, parameters))
}

fn check(scan: &PolarScan, seen: Option<&[f64]>) -> Result<(), Error> {
    let expected = scan.len();
    check_points(expected)?;
    let lengths = [("bearings", scan.bearings.len()), ("seen", seen.map_or(expected, <[_]>::len))];
    if let Some((name, got)) = lengths.into_iter().find(|&(_, got)| got != expected) {
        return Err(Error::Length { name, expected, got });
    }
    if let Some(index) = scan.bearings.iter().position(|bearing| !bearing.is_finite()) {
        let got = scan.bearings[index].to_string();
        return Err(Error::Value { name: "bearings", expected: "finite values", index, got });
    }
    match scan.ranges.iter().position(|&range| range < 0.0) {
        Some(index) => Err(Error::Value {
            name: "ranges",
            expected: ">= 0, +inf (a miss) or NaN (no information)",
            index,
            got: scan.ranges[index].to_string(),
        }),
        None => Ok(()),
    }
}

impl HitSweep<'_> {
    /// True if the hits of two rays, neighbours among the hits, belong together.
    fn joins(&self, from: u32, to: u32, parameters: &SegmentParameters) -> bool {
        let ranges = [from, to].map(|ray| self.scan.ranges[ray as usize]);
        are_close(ranges, self.angle(from, to), self.steps(from, to), parameters)
    }

    /// Runs of neighbouring hits that belong together, as ranges of `hits`. In a full circle `hits`
    /// is rotated so that the seam cuts no run.
    fn runs(&mut self, parameters: &SegmentParameters) -> Vec<Run> {
        if self.wraps && !self.hits.is_empty() {
            let begins = |place: usize| {
                let before = self.hits[(place + self.hits.len() - 1) % self.hits.len()];
                let here = self.hits[place];
                (!self.joins(before, here, parameters), self.passes_between(before, here))
            };
            let start = (0..self.hits.len()).find(|&place| begins(place) == (true, true));
            let start = start.or_else(|| (0..self.hits.len()).find(|&place| begins(place).0));
            self.hits.rotate_left(start.unwrap_or(0));
        }
        let mut runs: Vec<Run> = Vec::new();
        for place in 0..self.hits.len() {
            let joined =
                place > 0 && self.joins(self.hits[place - 1], self.hits[place], parameters);
            match runs.last_mut().filter(|_| joined) {
                Some(run) => run.end = place + 1,
                None => runs.push(Run { start: place, end: place + 1 }),
            }
        }
        runs
    }

    /// Segments from runs, given the first run of the object of every run.
    fn segments(&self, runs: &[Run], roots: &[usize], parameters: &SegmentParameters) -> Segments {
        let fewest = parameters.min_fraction * self.scan.len() as f64;
        let mut segments =
            Segments { labels: vec![0; self.scan.len()], starts: vec![0], ..Segments::default() };
        let (mut rays, mut surfaces) = (Vec::new(), Vec::new());
        for root in (0..runs.len()).filter(|&run| roots[run] == run) {
            rays.clear();
            for run in (root..runs.len()).filter(|&run| roots[run] == root) {
                rays.extend(&self.hits[runs[run].start..runs[run].end]);
            }
            surfaces.clear();
            corners::surfaces(self.scan, &rays, &parameters.corner, &mut surfaces);
            for surface in &surfaces {
                let Range { start, end } = *surface;
                let size = end - start;
                if size >= parameters.min_points.max(1) && size as f64 >= fewest {
                    let sides = [
                        self.side_at(rays[start], start > 0, false, parameters),
                        self.side_at(rays[end - 1], end < rays.len(), true, parameters),
                    ];
                    segments.push(&rays[start..end], sides);
                }
            }
        }
        segments
    }

    /// What lies beside a surface, beyond its last ray (`after`) or its first one; `ray` is this
    /// outermost ray. `Occluded` if the surface ends there in a corner.
    fn side_at(&self, ray: u32, corner: bool, after: bool, parameters: &SegmentParameters) -> Side {
        if corner { Side::Occluded } else { self.side(ray, after, parameters) }
    }

    /// Index of the ray after `ray`, or of the ray before it; None at an end of the field of view.
    fn neighbour(&self, ray: u32, after: bool) -> Option<u32> {
        let last = self.scan.len() as u32 - 1;
        match (after, ray) {
            (true, ray) if ray < last => Some(ray + 1),
            (false, ray) if ray > 0 => Some(ray - 1),
            (true, _) => self.wraps.then_some(0),
            (false, _) => self.wraps.then_some(last),
        }
    }

    /// What lies beyond `ray`, the last ray of a segment (`after`) or its first one.
    fn side(&self, ray: u32, after: bool, parameters: &SegmentParameters) -> Side {
        let Some(next) = self.neighbour(ray, after) else { return Side::FieldEdge };
        let range = self.scan.ranges[ray as usize];
        let beyond = self.scan.ranges[next as usize];
        let seen = self.seen[next as usize];
        if beyond.is_nan() || seen.is_nan() || beyond <= range {
            return Side::Occluded;
        }
        if beyond.is_finite() {
            return Side::Free;
        }
        if seen.is_finite() {
            // Outside the volume: the same object goes on, something before it, or behind it.
            let ranges = [self.seen[ray as usize], seen];
            let goes_on = are_close(ranges, self.angle(ray, next), 1, parameters);
            return if goes_on || seen < range { Side::Occluded } else { Side::Free };
        }
        let [nearest, farthest] = parameters.range_limits;
        let [near, far] = parameters.cut_margins;
        if range > farthest - far || range < nearest + near { Side::RangeCut } else { Side::Free }
    }
}

/// True if two hits, `steps` rays and `angle` [rad] apart, belong together: in polar space, where
/// ranges are similar and few rays between, and in Cartesian space, eq. 6.
fn are_close([a, b]: [f64; 2], angle: f64, steps: usize, parameters: &SegmentParameters) -> bool {
    if steps > parameters.max_gap + 1 {
        return false;
    }
    let (near, jump) = (a.min(b), (a - b).abs());
    let bound = match parameters.bound {
        Bound::Fixed(distance) => distance,
        Bound::Adaptive { incidence, slack } => {
            let step = angle / steps as f64;
            adaptive(near, step, incidence) + near * (angle - step) + slack
        }
    };
    if jump > bound {
        return false;
    }
    let sine = libm::sin(0.5 * angle);
    jump * jump + 4.0 * a * b * sine * sine <= bound * bound
}

/// Largest distance between neighbours, `step` [rad] apart, on a surface met at `incidence`.
fn adaptive(range: f64, step: f64, incidence: f64) -> f64 {
    let step = step.min(0.25 * incidence); // rays further apart tell little about a surface
    range * libm::sin(step) / libm::sin(incidence - step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const INF: f64 = f64::INFINITY;
    fn parameters() -> SegmentParameters {
        SegmentParameters {
            bound: Bound::Fixed(0.2),
            max_gap: 1,
            merge_deviation: 0.02,
            min_points: 2,
            ..SegmentParameters::default()
        }
    }

    fn scan(ranges: &[f64], step: f64) -> PolarScan {
        let bearings = (0..ranges.len()).map(|ray| step * ray as f64).collect();
        PolarScan { ranges: ranges.to_vec(), bearings }
    }

    fn found(ranges: &[f64], step: f64) -> Result<Segments, Error> {
        segment(&scan(ranges, step), None, &parameters())
    }

    #[test]
    fn sides_say_what_lies_beside_a_segment() -> Result<(), Error> {
        let nan = f64::NAN;
        let segments = found(&[2.0, 2.0, 5.0, 5.0, INF, 3.0, 3.0, nan, INF, 9.5, 9.5, INF], 0.01)?;
        assert_eq!(segments.labels, [1, 1, 2, 2, 0, 3, 3, 0, 0, 4, 4, 0]);
        let expected = [
            [Side::FieldEdge, Side::Free],
            [Side::Occluded, Side::Free],
            [Side::Free, Side::Occluded],
            [Side::RangeCut, Side::RangeCut],
        ];
        assert_eq!(segments.sides, expected);
        Ok(())
    }

    #[test]
    fn what_goes_on_outside_the_volume_does_not_end_there() -> Result<(), Error> {
        let seen = [3.0, 3.0, 3.05, 3.1, INF];
        let limited = scan(&[3.0, 3.0, INF, INF, INF], 0.01);
        let segments = segment(&limited, Some(&seen), &parameters())?;
        assert_eq!(segments.sides, [[Side::FieldEdge, Side::Occluded]]);
        let behind = [3.0, 3.0, 6.0, 6.0, INF];
        let segments = segment(&limited, Some(&behind), &parameters())?;
        assert_eq!(segments.sides, [[Side::FieldEdge, Side::Free]]);
        Ok(())
    }

    #[test]
    fn a_segment_runs_over_the_seam_of_a_full_circle() -> Result<(), Error> {
        let mut ranges = vec![INF; 360];
        for ray in [358, 359, 0, 1, 2] {
            ranges[ray] = 4.0;
        }
        let segments = found(&ranges, TAU / 360.0)?;
        assert_eq!(segments.rays, [358, 359, 0, 1, 2]);
        assert_eq!(segments.sides, [[Side::Free, Side::Free]]);
        assert_eq!(found(&ranges, 0.01)?.len(), 2);
        Ok(())
    }

    #[test]
    fn gaps_and_thin_things_before_it_do_not_split_a_wall() -> Result<(), Error> {
        let mut ranges = vec![4.0; 40];
        ranges[10] = INF; // one lost return
        for range in &mut ranges[20..23] {
            *range = 2.0;
        }
        let segments = found(&ranges, 0.01)?;
        assert_eq!(segments.len(), 2);
        assert_eq!((segments.labels[0], segments.labels[21], segments.labels[39]), (1, 2, 1));
        Ok(())
    }

    #[test]
    fn bad_scans_are_refused() {
        assert!(found(&[1.0, -1.0], 0.01).is_err());
        assert!(found(&[1.0, 1.0], f64::NAN).is_err());
        let short = PolarScan { ranges: vec![1.0], bearings: vec![] };
        assert!(segment(&short, None, &parameters()).is_err());
        assert!(found(&[], 0.01).is_ok_and(|segments| segments.is_empty()));
    }
}
