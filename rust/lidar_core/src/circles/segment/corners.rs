//! Corners of rooms: two surfaces that touch are separate, though no ray passes between them.

use crate::circles::preprocess::polar_scan::PolarScan;
use std::f64::consts::PI;
use std::ops::Range;

/// Largest angle around the sensor that one surface can cover [rad].
const ROUND: f64 = 0.9 * PI;
/// Number of hits on either side of a corner that are left out: noise may have put them there.
const UNCLEAR: usize = 1;
/// Largest number of nested splits of one surface; the rest then stays whole.
const DEEPEST: usize = 24;

/// Rules for the split of surfaces at a corner that the sensor looks into.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CornerParameters {
    /// Least depth of the corner behind the chord between the ends [m]; 0: no splits.
    pub depth: f64,
    /// Least length of the chord [m]; smaller objects stay whole.
    pub width: f64,
}

/// Corner rules of the best mode.
impl Default for CornerParameters {
    fn default() -> Self {
        Self { depth: 0.15, width: 1.2 }
    }
}

/// Append the surfaces of an object to `found`, as ranges of its `rays`. An object that bulges
/// towards the sensor is one surface.
pub(crate) fn surfaces(
    scan: &PolarScan,
    rays: &[u32],
    parameters: &CornerParameters,
    found: &mut Vec<Range<usize>>,
) {
    let point = |&ray: &u32| scan.point(ray as usize).unwrap_or([0.0, 0.0]);
    let chord = |rays: &[u32]| {
        let (first, last) = (rays.first().map(point), rays.last().map(point));
        first.zip(last).map_or([0.0; 2], |([x, y], [to_x, to_y])| [to_x - x, to_y - y])
    };
    let [x, y] = chord(rays);
    if parameters.depth <= 0.0 || span(scan, rays) < ROUND && libm::hypot(x, y) < parameters.width {
        found.push(0..rays.len());
        return;
    }
    let points: Vec<[f64; 2]> = rays.iter().map(point).collect();
    let mut waiting = vec![(0, rays.len(), 0)];
    while let Some((start, end, depth)) = waiting.pop() {
        let corner = if depth >= DEEPEST {
            None
        } else if span(scan, &rays[start..end]) >= ROUND {
            farthest(&points[start..end])
        } else {
            deepest(&points[start..end], parameters)
        };
        match corner {
            Some(corner) => {
                let corner = start + corner;
                waiting.push((end.min(corner + UNCLEAR + 1), end, depth + 1));
                waiting.push((start, start.max(corner.saturating_sub(UNCLEAR)), depth + 1));
            }
            None => found.push(start..end),
        }
    }
}

/// Angle from the first to the last ray, over all between [rad].
fn span(scan: &PolarScan, rays: &[u32]) -> f64 {
    let bearing = |ray: u32| scan.bearings[ray as usize];
    let steps = rays.windows(2).map(|pair| {
        crate::circles::preprocess::polar_scan::turn(bearing(pair[1]) - bearing(pair[0]))
    });
    steps.sum::<f64>().abs()
}

/// Index of the hit farthest from the sensor, in the middle half of the points; None if that is
/// empty.
fn farthest(points: &[[f64; 2]]) -> Option<usize> {
    let square = |index: &usize| points[*index][0].powi(2) + points[*index][1].powi(2);
    let quarter = points.len() / 4;
    (quarter..points.len() - quarter).max_by(|one, other| square(one).total_cmp(&square(other)))
}

/// Index of the hit deepest behind the chord; None if the corner is not deep or the chord not long
/// enough.
fn deepest(points: &[[f64; 2]], parameters: &CornerParameters) -> Option<usize> {
    let ([x, y], [to_x, to_y]) = (*points.first()?, *points.last()?);
    let length = libm::hypot(to_x - x, to_y - y);
    if length < parameters.width {
        return None;
    }
    let normal = [(to_y - y) / length, (x - to_x) / length];
    let outward = if normal[0] * x + normal[1] * y < 0.0 { -1.0 } else { 1.0 };
    let depth = |at: &[f64; 2]| outward * (normal[0] * (at[0] - x) + normal[1] * (at[1] - y));
    let depths = points.iter().map(depth).enumerate();
    let (corner, depth) = depths.max_by(|one, other| one.1.total_cmp(&other.1))?;
    (depth >= parameters.depth && corner + 1 < points.len()).then_some(corner)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARAMETERS: CornerParameters = CornerParameters { depth: 0.15, width: 1.2 };

    fn found(range: impl Fn(f64) -> f64, degrees: [i32; 2]) -> Vec<(usize, usize)> {
        let bearings: Vec<f64> =
            (degrees[0]..degrees[1]).map(|degree| f64::from(degree).to_radians()).collect();
        let ranges: Vec<f64> = bearings.iter().map(|&bearing| range(bearing)).collect();
        let rays: Vec<u32> = (0..ranges.len() as u32).collect();
        let mut found = Vec::new();
        surfaces(&PolarScan { ranges, bearings }, &rays, &PARAMETERS, &mut found);
        found.into_iter().map(|one| (one.start, one.end)).collect()
    }

    /// Range to the walls of a square room around the sensor.
    fn room(bearing: f64) -> f64 {
        3.0 / libm::cos(bearing).abs().max(libm::sin(bearing).abs())
    }

    #[test]
    fn a_room_is_cut_at_its_corners_only() {
        assert_eq!(found(room, [-40, 40]), [(0, 80)]); // one wall
        assert_eq!(found(room, [-10, 101]), [(0, 54), (57, 111)]); // two: the corner is at 45 degrees
        assert_eq!(found(room, [-135, 136]), [(0, 89), (92, 179), (182, 271)]);
    }

    #[test]
    fn what_bulges_or_is_small_stays_whole() {
        let corner = |bearing: f64| 3.0 / (libm::cos(bearing) - libm::sin(bearing).abs());
        assert_eq!(found(corner, [-30, 31]), [(0, 61)]);
        assert_eq!(found(|bearing| 0.2 * room(bearing), [0, 90]), [(0, 90)]);
        let none = CornerParameters { depth: 0.0, ..PARAMETERS };
        let scan = PolarScan { ranges: vec![3.0; 9], bearings: vec![0.0; 9] };
        let mut found = Vec::new();
        surfaces(&scan, &[0, 3, 8], &none, &mut found);
        assert_eq!((found.len(), found[0].end), (1, 3));
    }
}
