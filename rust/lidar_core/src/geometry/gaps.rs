//! Clustering with gaps that grow with the range, as the gaps between the rays of a LiDAR do.

use super::cluster::{Clustering, Fixed, NO_GROUP, Reach, Sets, check, linked, numbered};
use super::lattice::wide;
use crate::Error;
use crate::budget::check_points;
use crate::error::require;

/// Widest angle under which a gap is bridged [rad].
pub const MAX_ANGLE: f64 = 0.5;
/// Ranges within one band differ by this factor at most: less than 1 / 0.8661, see [`linked`].
const BAND: f64 = 1.15;
/// Room for rounding.
const MARGIN: f64 = 1e-6;

/// Gaps that are bridged as they are seen from the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngularGap {
    /// The sensor [m].
    pub origin: [f64; 3],
    /// Gaps seen under this angle are inside a cluster too [rad], 0 to [`MAX_ANGLE`].
    pub max_angle: f64,
}

/// As [`label`](super::cluster::label), but two points are also linked by a step of at most
/// `max_angle` times the range of the nearer one.
///
/// The result does not depend on the order of the points, except for the numbers.
///
/// # Errors
/// Those of [`label`](super::cluster::label), and [`Error::Parameter`] for an angle out of range
/// or an origin that is not finite.
pub fn label_seen(
    points: &[[f32; 3]],
    gap: &AngularGap,
    clustering: &Clustering,
) -> Result<Vec<i32>, Error> {
    check(clustering)?;
    gap.check()?;
    check_points(points.len())?;
    let fixed = Fixed::new(clustering.max_distance);
    let mut group_of = linked(points, clustering.max_distance, &fixed)?;
    if gap.max_angle > 0.0 {
        widen(points, gap, clustering.max_distance, &mut group_of)?;
    }
    Ok(numbered(&group_of, clustering))
}

impl AngularGap {
    fn check(&self) -> Result<(), Error> {
        let Self { origin, max_angle } = self;
        require((0.0..=MAX_ANGLE).contains(max_angle), "max_angle", "0 to 0.5", max_angle)?;
        require(
            origin.iter().all(|at| at.is_finite()),
            "origin",
            "finite",
            format_args!("{origin:?}"),
        )
    }

    /// Square of the range of a point [m^2].
    fn square(&self, point: [f64; 3]) -> f64 {
        let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| point[axis] - self.origin[axis]);
        x * x + y * y + z * z
    }
}

/// Reach among points that lie in one band of ranges.
struct InBand<'a> {
    gap: &'a AngularGap,
    /// Squares of the fixed distance and of the largest reach that counts [m^2].
    fixed: f64,
    most: f64,
}

impl Reach for InBand<'_> {
    fn most(&self) -> f64 {
        self.most
    }

    fn of(&self, one: [f64; 3], other: [f64; 3]) -> f64 {
        let nearer = self.gap.square(one).min(self.gap.square(other));
        self.fixed.max(self.gap.max_angle * self.gap.max_angle * nearer)
    }
}

/// Join groups of points that are far enough for the angle to count. Bands of ranges are taken
/// one after the other: within one, all reaches are nearly equal.
fn widen(
    points: &[[f32; 3]],
    gap: &AngularGap,
    fixed: f64,
    group_of: &mut [u32],
) -> Result<(), Error> {
    let bands = Bands::of(points, gap, fixed / gap.max_angle * (1.0 - MARGIN), group_of);
    let mut sets = Sets::new(points.len());
    for (band, &next) in bands.ends.iter().enumerate() {
        if bands.rows[band].is_empty() {
            continue;
        }
        let rows = bands.reached_from(band, next * (1.0 + gap.max_angle) * (1.0 + MARGIN));
        let cloud: Vec<[f32; 3]> = rows.iter().map(|&row| points[row as usize]).collect();
        let largest = gap.max_angle * next;
        let reach = InBand { gap, fixed: fixed * fixed, most: largest * largest };
        join(&rows, &linked(&cloud, largest, &reach)?, group_of, &mut sets);
    }
    for group in group_of.iter_mut().filter(|group| **group != NO_GROUP) {
        *group = sets.root(*group);
    }
    Ok(())
}

/// Rows of far points by their range.
struct Bands {
    /// Upper end of every band [m].
    ends: Vec<f64>,
    rows: Vec<Vec<(f64, u32)>>,
}

impl Bands {
    /// Points further away than `least` [m], with the squares of their ranges.
    fn of(points: &[[f32; 3]], gap: &AngularGap, least: f64, group_of: &[u32]) -> Self {
        let mut far: Vec<(f64, u32)> = Vec::new();
        for (row, (&point, &group)) in points.iter().zip(group_of).enumerate() {
            let square = gap.square(wide(point));
            if group != NO_GROUP && square >= least * least {
                far.push((square, row as u32)); // at most MAX_POINTS
            }
        }
        let furthest = far.iter().map(|&(square, _)| square).fold(0.0, f64::max);
        let mut ends = Vec::new();
        let mut end = least;
        while !far.is_empty() && end * end <= furthest {
            end *= BAND;
            ends.push(end);
        }
        let mut rows = vec![Vec::new(); ends.len()];
        for (square, row) in far {
            let band = ends.partition_point(|end| end * end <= square);
            rows[band].push((square, row));
        }
        Self { ends, rows }
    }

    /// Rows of `band`, and those beyond it up to the range `reached` [m].
    fn reached_from(&self, band: usize, reached: f64) -> Vec<u32> {
        let mut rows: Vec<u32> = self.rows[band].iter().map(|&(_, row)| row).collect();
        for (beyond, start) in self.rows[band + 1..].iter().zip(&self.ends[band..]) {
            if *start > reached {
                break;
            }
            let near = beyond.iter().filter(|&&(square, _)| square <= reached * reached);
            rows.extend(near.map(|&(_, row)| row));
        }
        rows
    }
}

/// Join the groups whose points `found` has in one group.
fn join(rows: &[u32], found: &[u32], group_of: &[u32], sets: &mut Sets) {
    let mut first = vec![NO_GROUP; rows.len()];
    for (&row, &place) in rows.iter().zip(found) {
        let (group, first) = (group_of[row as usize], &mut first[place as usize]);
        if *first == NO_GROUP {
            *first = group;
        } else {
            let (one, other) = (sets.root(*first), sets.root(group));
            sets.join(one, other);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearer_point_decides() -> Result<(), Error> {
        let clustering = Clustering { max_distance: 0.25, min_points: 1, max_points: None };
        let gap = AngularGap { origin: [0.0; 3], max_angle: 0.015625 };
        let points = [[32.0, 0.0, 0.0], [32.5, 0.0, 0.0], [33.25, 0.0, 0.0], [16.0, 0.0, 0.0]];
        assert_eq!(label_seen(&points, &gap, &clustering)?, [0, 0, 1, 2]);
        let nearer = AngularGap { origin: [0.125, 0.0, 0.0], ..gap };
        assert_eq!(label_seen(&points, &nearer, &clustering)?, [0, 1, 2, 3]);
        Ok(())
    }

    #[test]
    fn bad_gaps_are_refused() {
        let clustering = Clustering { max_distance: 0.25, min_points: 1, max_points: None };
        for (origin, max_angle) in [([0.0; 3], -0.1), ([0.0; 3], 0.6), ([f64::NAN; 3], 0.1)] {
            assert!(label_seen(&[], &AngularGap { origin, max_angle }, &clustering).is_err());
        }
    }
}
