//! Clustering with gaps that grow with the range, as the distances between the rays of a LiDAR do.

use super::keys::is_finite;
use super::octree_link::{Fixed, Linker, Reach, check_extent};
use super::{Clustering, Labeller, NO_GROUP, Sets, check};
use crate::Error;
use crate::error::require;
use crate::geometry::lattice::wide;
use crate::util::budget::check_points;
use crate::util::cancel;
use crate::util::object_pool::ObjectPool;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Largest angle under which a gap may be bridged [rad].
pub const MAX_ANGLE: f64 = 0.5;
/// Largest ratio of the ranges in one band. It must be less than 1 / 0.8661: see [`Linker`].
const BAND: f64 = 1.15;
/// Largest ratio of ranges in a band in which the angle does not count. Such bands only distribute
/// the work.
const NEAR_BAND: f64 = 1.4;
/// Bands are not cut at ranges below this number times the fixed distance: most points of such a band
/// would also be in reach of the neighbouring band.
const LEAST_WIDTHS: f64 = 32.0;
/// Relative margin for rounding errors.
const MARGIN: f64 = 1e-6;

/// Gaps that are bridged because they are seen under a small angle from the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngularGap {
    /// Position of the sensor, in the frame of the points [m].
    pub origin: [f64; 3],
    /// Largest angle under which a gap inside a cluster is seen [rad], 0 to [`MAX_ANGLE`]. 0: the
    /// angle does not count.
    pub max_angle: f64,
}

/// Like [`label`](super::label), but two points are also linked if their distance is at most
/// `max_angle` times the range of the nearer one.
///
/// Except for the labels of the clusters, the result does not depend on the order of the points. It does not depend on
/// the threads of `pool`.
///
/// # Errors
/// Errors of [`label`](super::label), and [`Error::Parameter`] for an angle out of range or an
/// origin that is not finite.
pub fn label_seen(
    points: &[[f32; 3]],
    gap: &AngularGap,
    clustering: &Clustering,
    pool: Option<&ThreadPool>,
) -> Result<Vec<i32>, Error> {
    let mut labeller = SeenLabeller::default();
    labeller.label(points, gap, clustering, pool)?;
    Ok(labeller.near.labels.labels)
}

/// Labels clouds that are seen from a sensor, one after another. It keeps its memory.
#[derive(Default)]
pub struct SeenLabeller {
    near: Labeller,
    bands: Bands,
    parts: ObjectPool<BandPoints>,
    sets: Mutex<Sets>,
}

impl SeenLabeller {
    /// Label one cloud, like [`label_seen`].
    ///
    /// # Errors
    /// As [`label_seen`].
    pub fn label(
        &mut self,
        points: &[[f32; 3]],
        gap: &AngularGap,
        clustering: &Clustering,
        pool: Option<&ThreadPool>,
    ) -> Result<&[i32], Error> {
        check(clustering)?;
        gap.check()?;
        check_points(points.len())?;
        if gap.max_angle == 0.0 {
            return self.near.label(points, clustering);
        }
        check_extent(points, clustering.max_distance)?;
        let Self { near, bands, parts, sets } = self;
        bands.fill(points, gap, clustering.max_distance)?;
        sets.get_mut().unwrap_or_else(PoisonError::into_inner).restart(points.len());
        let watch = cancel::watch();
        let link = |band: usize| watch.run(|| parts.acquire().link(points, gap, bands, band, sets));
        match pool {
            Some(pool) => {
                pool.install(|| (0..bands.len()).into_par_iter().try_for_each(link))?;
            }
            None => (0..bands.len()).try_for_each(link)?,
        }
        watch.check()?;
        let roots = sets.get_mut().unwrap_or_else(PoisonError::into_inner).roots();
        for (root, _) in roots.iter_mut().zip(points).filter(|(_, point)| !is_finite(**point)) {
            *root = NO_GROUP;
        }
        Ok(near.labels.number(roots, clustering))
    }

    /// Labels of the last cloud: number of the cluster of every point, or [`NOISE`](super::NOISE).
    #[must_use]
    pub fn labels(&self) -> &[i32] {
        self.near.labels()
    }
}

impl AngularGap {
    pub(super) fn check(&self) -> Result<(), Error> {
        let Self { origin, max_angle } = self;
        require((0.0..=MAX_ANGLE).contains(max_angle), "max_angle", "0 to 0.5", max_angle)?;
        require(
            origin.iter().all(|at| at.is_finite()),
            "origin",
            "finite",
            format_args!("{origin:?}"),
        )
    }

    /// Square of the range of a point, seen from the sensor [m^2].
    fn square(&self, point: [f64; 3]) -> f64 {
        let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| point[axis] - self.origin[axis]);
        // Never infinite, or `cut` would add bands without end.
        (x * x + y * y + z * z).min(f64::MAX)
    }
}

/// Rule for linking points whose ranges are in one band.
struct InBand<'a> {
    gap: &'a AngularGap,
    /// Square of the fixed distance within which points are always linked [m^2].
    fixed: f64,
    /// Square of the largest distance at which points of the band may be linked [m^2].
    most: f64,
}

impl Reach for InBand<'_> {
    fn most(&self) -> f64 {
        self.most
    }

    #[inline]
    fn links(&self, square: f64, one: [f64; 3], other: [f64; 3]) -> bool {
        let nearer = || self.gap.square(one).min(self.gap.square(other));
        // The fixed distance first: it needs no ranges.
        square <= self.fixed || square <= self.gap.max_angle * self.gap.max_angle * nearer()
    }
}

/// Points sorted into bands by range. In the first bands the angle does not count. Within each of
/// the others, the distances at which points are linked are nearly equal.
#[derive(Default)]
struct Bands {
    /// The distance within which points are always linked [m].
    fixed: f64,
    /// Upper end of every band [m].
    ends: Vec<f64>,
    /// Index of the band of every point. [`NO_BAND`] if the point is not finite.
    band_of: Vec<u16>,
    /// Indices of finite points, by band.
    rows: Vec<u32>,
    /// End of every band's entries in `rows`.
    row_ends: Vec<usize>,
}

/// Band of points that are not finite. There are never as many bands, since each is wider than the
/// one before.
const NO_BAND: u16 = u16::MAX;

impl Bands {
    fn len(&self) -> usize {
        self.ends.len()
    }

    /// Sort the points into bands of range. `fixed`: distance within which points are always linked
    /// [m].
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    fn fill(&mut self, points: &[[f32; 3]], gap: &AngularGap, fixed: f64) -> Result<(), Error> {
        cancel::check()?;
        let finite = points.iter().filter(|point| is_finite(**point));
        let furthest = finite.map(|&point| gap.square(wide(point))).fold(0.0, f64::max);
        self.cut(fixed, gap.max_angle, furthest);
        cancel::check()?;
        let Self { ends, band_of, rows, row_ends, .. } = self;
        let band = |&point: &[f32; 3]| {
            let square = gap.square(wide(point));
            let band = || ends.partition_point(|end| end * end <= square) as u16;
            if is_finite(point) { band() } else { NO_BAND }
        };
        band_of.clear();
        band_of.extend(points.iter().map(band));
        cancel::check()?;
        row_ends.clear();
        row_ends.resize(ends.len() + 1, 0);
        for &band in band_of.iter().filter(|&&band| band != NO_BAND) {
            row_ends[usize::from(band) + 1] += 1;
        }
        for band in 0..ends.len() {
            row_ends[band + 1] += row_ends[band];
        }
        rows.clear();
        rows.resize(row_ends[ends.len()], 0);
        // Counting sort keeps rows ascending within a band. Each start moves to the end of its band.
        for (row, &band) in (0..).zip(&*band_of).filter(|(_, band)| **band != NO_BAND) {
            let place = &mut row_ends[usize::from(band)];
            rows[*place] = row;
            *place += 1;
        }
        cancel::check()
    }

    /// Find the ends of the bands. `furthest`: square of the largest range [m^2].
    fn cut(&mut self, fixed: f64, max_angle: f64, furthest: f64) {
        // From here on the angle counts.
        let counts = (fixed / max_angle).min(f64::MAX) * (1.0 - MARGIN);
        let Self { ends, .. } = self;
        ends.clear();
        ends.push(counts);
        let mut near = counts.min(furthest.sqrt());
        while near > LEAST_WIDTHS * fixed {
            near /= NEAR_BAND;
            ends.push(near);
        }
        ends.reverse();
        while let Some(end) = ends.last().filter(|&&end| end * end <= furthest) {
            ends.push(end * BAND);
        }
        self.fixed = fixed;
    }

    /// Largest distance of two linked points in a band [m].
    fn widest(&self, gap: &AngularGap, band: usize) -> f64 {
        self.fixed.max(gap.max_angle * self.ends[band])
    }

    fn rows_in(&self, band: usize) -> &[u32] {
        let start = if band == 0 { 0 } else { self.row_ends[band - 1] };
        &self.rows[start..self.row_ends[band]]
    }
}

/// Points of one band, and further points to which they may be linked.
#[derive(Default)]
struct BandPoints {
    rows: Vec<u32>,
    points: Vec<[f32; 3]>,
    linker: Linker,
}

impl BandPoints {
    /// Link the points of a band with each other and with further points. The links are added to `sets`.
    fn link(
        &mut self,
        points: &[[f32; 3]],
        gap: &AngularGap,
        bands: &Bands,
        band: usize,
        sets: &Mutex<Sets>,
    ) -> Result<(), Error> {
        if bands.rows_in(band).is_empty() {
            return Ok(());
        }
        self.take(points, gap, bands, band);
        cancel::check()?;
        let (fixed, widest) = (bands.fixed, bands.widest(gap, band));
        let groups = if widest == fixed {
            self.linker.linked(&self.points, fixed, &Fixed::new(fixed))?
        } else {
            let reach = InBand { gap, fixed: fixed * fixed, most: widest * widest };
            self.linker.linked(&self.points, widest, &reach)?
        };
        cancel::check()?;
        // Only the joins are locked. The smallest member is the root, so the order of bands does not matter.
        let mut sets = sets.lock().unwrap_or_else(PoisonError::into_inner);
        for (&row, &group) in self.rows.iter().zip(groups) {
            let (one, other) = (sets.root(row), sets.root(self.rows[group as usize]));
            sets.join(one, other);
        }
        Ok(())
    }

    /// Collect the points of `band`, and points beyond it that are in reach of its farthest ones.
    fn take(&mut self, points: &[[f32; 3]], gap: &AngularGap, bands: &Bands, band: usize) {
        let Self { rows, points: taken, .. } = self;
        let reached = (bands.ends[band] + bands.widest(gap, band)) * (1.0 + MARGIN);
        let is_near = |row: &&u32| gap.square(wide(points[**row as usize])) <= reached * reached;
        rows.clear();
        rows.extend_from_slice(bands.rows_in(band));
        // Outwards only: the nearer point decides the reach, so its band finds the pair.
        for beyond in (band + 1..bands.len()).take_while(|at| bands.ends[at - 1] <= reached) {
            rows.extend(bands.rows_in(beyond).iter().filter(is_near));
        }
        taken.clear();
        taken.extend(rows.iter().map(|&row| points[row as usize]));
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
            let pool = crate::util::threads::pool(threads)?;
            assert_eq!(label_seen(&points, &gap, &clustering, Some(&pool))?, one);
        }
        Ok(())
    }

    #[test]
    fn the_least_angle_there_is_links_nothing_more() -> Result<(), Error> {
        let clustering = Clustering { max_distance: 0.25, min_points: 1, max_points: None };
        let points = [[49.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 45.0, 0.0]];
        for max_angle in [0.0, 5e-324, 1e-310, 1e-308] {
            let gap = AngularGap { origin: [0.0; 3], max_angle };
            assert_eq!(label_seen(&points, &gap, &clustering, None)?, [0, 1, 2]);
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
