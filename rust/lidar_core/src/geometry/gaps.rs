//! Clustering with gaps that grow with the range, as the gaps between the rays of a LiDAR do.

use super::cluster::{Clustering, NO_GROUP, Sets, check, label, numbered};
use super::lattice::wide;
use super::octants::{Fixed, Reach, check_extent, is_finite, linked};
use crate::Error;
use crate::budget::check_points;
use crate::error::require;
use rayon::ThreadPool;
use rayon::prelude::*;

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
/// The result does not depend on the order of the points, except for the numbers, nor on the
/// threads of `pool`.
///
/// # Errors
/// Those of [`label`](super::cluster::label), and [`Error::Parameter`] for an angle out of range
/// or an origin that is not finite.
pub fn label_seen(
    points: &[[f32; 3]],
    gap: &AngularGap,
    clustering: &Clustering,
    pool: Option<&ThreadPool>,
) -> Result<Vec<i32>, Error> {
    check(clustering)?;
    gap.check()?;
    check_points(points.len())?;
    if gap.max_angle == 0.0 {
        return label(points, clustering);
    }
    check_extent(points, clustering.max_distance)?;
    let bands = Bands::of(points, gap, clustering.max_distance);
    let linked = |band: usize| bands.linked(points, band);
    let found: Vec<Result<Found, Error>> = match pool {
        Some(pool) => pool.install(|| (0..bands.ends.len()).into_par_iter().map(linked).collect()),
        None => (0..bands.ends.len()).map(linked).collect(),
    };
    let mut sets = Sets::new(points.len());
    for found in found {
        found?.join(&mut sets);
    }
    let root = |(row, &point): (u32, &[f32; 3])| match is_finite(point) {
        true => sets.root(row),
        false => NO_GROUP,
    };
    let group_of: Vec<u32> = (0..).zip(points).map(root).collect();
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
        (x * x + y * y + z * z).min(f64::MAX)
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

    #[inline]
    fn links(&self, square: f64, one: [f64; 3], other: [f64; 3]) -> bool {
        let nearer = || self.gap.square(one).min(self.gap.square(other));
        square <= self.fixed || square <= self.gap.max_angle * self.gap.max_angle * nearer()
    }
}

/// Points by their range. In the first band the angle does not count yet; within each of the
/// others all reaches are nearly equal.
struct Bands<'a> {
    gap: &'a AngularGap,
    /// The fixed distance [m].
    fixed: f64,
    /// Upper end of every band [m].
    ends: Vec<f64>,
    /// Rows of finite points, by band.
    rows: Vec<u32>,
    /// Where the rows of every band end.
    row_ends: Vec<usize>,
}

impl<'a> Bands<'a> {
    fn of(points: &[[f32; 3]], gap: &'a AngularGap, fixed: f64) -> Self {
        let finite = (0..).zip(points).filter(|(_, point)| is_finite(**point));
        let squares: Vec<(u32, f64)> =
            finite.map(|(row, &point)| (row, gap.square(wide(point)))).collect();
        let furthest = squares.iter().map(|&(_, square)| square).fold(0.0, f64::max);
        let mut ends = vec![fixed / gap.max_angle * (1.0 - MARGIN)];
        while let Some(end) = ends.last().filter(|&&end| end * end <= furthest) {
            ends.push(end * BAND);
        }
        let band_of = |square: f64| ends.partition_point(|end| end * end <= square);
        let mut row_ends = vec![0; ends.len() + 1];
        squares.iter().for_each(|&(_, square)| row_ends[band_of(square) + 1] += 1);
        for band in 0..ends.len() {
            row_ends[band + 1] += row_ends[band];
        }
        let mut rows = vec![0; squares.len()];
        for (row, square) in squares {
            let place = &mut row_ends[band_of(square)]; // where the band begins, at first
            rows[*place] = row;
            *place += 1;
        }
        Self { gap, fixed, ends, rows, row_ends }
    }

    fn rows_in(&self, band: usize) -> &[u32] {
        let start = if band == 0 { 0 } else { self.row_ends[band - 1] };
        &self.rows[start..self.row_ends[band]]
    }

    /// Rows of `band`, and those beyond it that are within reach of its furthest points.
    fn reached_from(&self, points: &[[f32; 3]], band: usize) -> Vec<u32> {
        let reached = self.ends[band] * (1.0 + self.gap.max_angle) * (1.0 + MARGIN);
        let mut rows = self.rows_in(band).to_vec();
        for beyond in (band + 1..self.ends.len()).take_while(|at| self.ends[at - 1] <= reached) {
            let is_near =
                |row: &u32| self.gap.square(wide(points[*row as usize])) <= reached * reached;
            rows.extend(self.rows_in(beyond).iter().copied().filter(is_near));
        }
        rows
    }

    /// What is linked to the points of a band.
    fn linked(&self, points: &[[f32; 3]], band: usize) -> Result<Found, Error> {
        if self.rows_in(band).is_empty() {
            return Ok(Found::default());
        }
        let rows = self.reached_from(points, band);
        let cloud: Vec<[f32; 3]> = rows.iter().map(|&row| points[row as usize]).collect();
        let (fixed, widest) = (self.fixed, self.gap.max_angle * self.ends[band]);
        let groups = if band == 0 {
            linked(&cloud, fixed, &Fixed::new(fixed))?
        } else {
            let reach = InBand { gap: self.gap, fixed: fixed * fixed, most: widest * widest };
            linked(&cloud, widest, &reach)?
        };
        Ok(Found { rows, groups })
    }
}

/// Rows of finite points, and for each the place in this list of one of its group.
#[derive(Default)]
struct Found {
    rows: Vec<u32>,
    groups: Vec<u32>,
}

impl Found {
    fn join(&self, sets: &mut Sets) {
        for (&row, &group) in self.rows.iter().zip(&self.groups) {
            let (one, other) = (sets.root(row), sets.root(self.rows[group as usize]));
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
        assert_eq!(label_seen(&points, &gap, &clustering, None)?, [0, 0, 1, 2]);
        let nearer = AngularGap { origin: [0.125, 0.0, 0.0], ..gap };
        assert_eq!(label_seen(&points, &nearer, &clustering, None)?, [0, 1, 2, 3]);
        Ok(())
    }

    #[test]
    fn any_number_of_threads_gives_the_same_labels() -> Result<(), Error> {
        let clustering = Clustering { max_distance: 0.25, min_points: 2, max_points: None };
        let gap = AngularGap { origin: [1.0, -2.0, 0.5], max_angle: 0.0125 };
        let mut seed = 5_u32;
        let mut draw = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as f32 / (1 << 24) as f32 * 80.0 - 40.0
        };
        let points: Vec<[f32; 3]> = (0..20_000).map(|_| [draw(), draw(), 0.1 * draw()]).collect();
        let one = label_seen(&points, &gap, &clustering, None)?;
        assert!(one.iter().max() > Some(&100));
        for threads in [2, 3] {
            let pool = crate::threads::pool(threads)?;
            assert_eq!(label_seen(&points, &gap, &clustering, Some(&pool))?, one);
        }
        Ok(())
    }

    #[test]
    fn bad_gaps_are_refused() {
        let clustering = Clustering { max_distance: 0.25, min_points: 1, max_points: None };
        for (origin, max_angle) in [([0.0; 3], -0.1), ([0.0; 3], 0.6), ([f64::NAN; 3], 0.1)] {
            assert!(label_seen(&[], &AngularGap { origin, max_angle }, &clustering, None).is_err());
        }
    }
}
