//! Merging of the parts of one surface if a nearer object hides the surface between them.

use super::parameters::SegmentParameters;
use super::sweep::HitSweep;

/// Hits `start..end` of a sweep whose neighbours belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) start: usize,
    pub(super) end: usize,
}

/// For every run, the index of the first run of its object. Two runs are one object if all rays
/// between them are nearer or unknown, their ends are close, and one circle or line fits both.
pub(super) fn merged(
    sweep: &HitSweep<'_>,
    runs: &[Run],
    parameters: &SegmentParameters,
) -> Vec<usize> {
    let mut roots: Vec<usize> = (0..runs.len()).collect();
    if parameters.merge_distance <= 0.0 {
        return roots;
    }
    let mut points = Vec::new();
    for first in 0..runs.len() {
        let Some(second) = continuation(sweep, runs, first, parameters) else { continue };
        let root = roots[first];
        let is_part = |&run: &usize| roots[run] == root || run == second;
        points.clear();
        let mut joint = 0;
        for part in (root..=second).filter(is_part) {
            joint = points.len(); // those of the last part begin here
            let rays = &sweep.hits[runs[part].start..runs[part].end];
            points.extend(rays.iter().filter_map(|&ray| sweep.scan.point(ray as usize)));
        }
        if is_one_surface(&points, joint, parameters.merge_deviation) {
            roots[second] = root;
        }
    }
    roots
}

/// Index of the next run that may continue run `first` behind a nearer object; None without one.
fn continuation(
    sweep: &HitSweep<'_>,
    runs: &[Run],
    first: usize,
    parameters: &SegmentParameters,
) -> Option<usize> {
    let range_of = |ray: u32| sweep.scan.ranges[ray as usize];
    let end = sweep.hits[runs[first].end - 1];
    let range = range_of(end);
    let mut last = end;
    let mut hiding = 0.0_f64; // farthest hit between
    for (second, run) in runs.iter().enumerate().skip(first + 1) {
        let rays = &sweep.hits[run.start..run.end];
        let start = rays[0];
        let is_near = range * libm::sin(sweep.angle(end, start)) <= parameters.merge_distance;
        if !is_near || sweep.passes_between(last, start) {
            return None;
        }
        let hidden = hiding < range.min(range_of(start));
        if hidden && sweep.distance(end, start) <= parameters.merge_distance {
            return Some(second);
        }
        hiding = rays.iter().map(|&ray| range_of(ray)).fold(hiding, f64::max);
        if hiding >= range {
            return None; // seen beside it
        }
        last = rays[rays.len() - 1];
    }
    None
}

/// True if one circle or line fits all points as well as one for those before `joint` and one for
/// the others: an F test, and a limit for the root mean square distance [m].
fn is_one_surface(points: &[[f64; 2]], joint: usize, limit: f64) -> bool {
    const PARAMETERS: usize = 3; // of one circle
    const LARGEST_RATIO: f64 = 8.0; // noise alone is above it once in 10,000 times
    const LEAST_VARIANCE: f64 = 1e-6; // [m^2], of noise-free scans
    let square = |part: &[[f64; 2]]| deviation(part).powi(2) * part.len() as f64;
    let (one, two) = (square(points), square(&points[..joint]) + square(&points[joint..]));
    if one > limit * limit * points.len() as f64 {
        return false;
    }
    let freedom = points.len().saturating_sub(2 * PARAMETERS);
    let variance = (two / freedom.max(1) as f64).max(LEAST_VARIANCE);
    freedom < PARAMETERS || (one - two) / PARAMETERS as f64 <= LARGEST_RATIO * variance
}

/// Root mean square distance of points from the line or the circle through them, whichever is
/// less [m].
///
/// # Source
/// Kasa, "A circle fitting procedure and its error analysis", 1976.
fn deviation(points: &[[f64; 2]]) -> f64 {
    let count = points.len() as f64;
    let mean: [f64; 2] =
        std::array::from_fn(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / count);
    let centred = || points.iter().map(|point| [point[0] - mean[0], point[1] - mean[1]]);
    let [mut xx, mut xy, mut yy, mut xz, mut yz] = [0.0; 5];
    for [x, y] in centred() {
        let z = x * x + y * y;
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        (xz, yz) = (xz + x * z, yz + y * z);
    }
    let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
    let line = 0.5 * (trace - (trace * trace - 4.0 * determinant).max(0.0).sqrt());
    let x = 0.5 * (xz * yy - yz * xy) / determinant;
    let y = 0.5 * (yz * xx - xz * xy) / determinant;
    let radius = (x * x + y * y + trace / count).sqrt();
    let circle: f64 =
        centred().map(|[px, py]| (libm::hypot(px - x, py - y) - radius).powi(2)).sum();
    (line.min(circle).max(0.0) / count).sqrt() // a line leaves no circle: NaN, which min ignores
}

#[cfg(test)]
mod tests {
    use super::{deviation, is_one_surface};

    #[test]
    fn lines_and_circles_have_no_deviation() {
        let line: Vec<[f64; 2]> = (0..9).map(|k| [f64::from(k), 2.0 - f64::from(k)]).collect();
        let arc = |radius: f64| -> Vec<[f64; 2]> {
            let angle = |k: i32| 0.2 * f64::from(k);
            (0..9).map(|k| [radius * libm::cos(angle(k)), radius * libm::sin(angle(k))]).collect()
        };
        assert!(deviation(&line) < 1e-9 && deviation(&arc(0.3)) < 1e-9);
        let two: Vec<[f64; 2]> = [arc(0.3), arc(0.5)].concat();
        assert!(deviation(&two) > 0.05);
        assert!(is_one_surface(&arc(0.3), 4, 0.02) && !is_one_surface(&two, 9, 0.5));
    }
}
