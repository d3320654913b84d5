//! Plan of the update by a scan: rays, their bounds and the voxels of points, checked before the
//! map changes.
//!
//! The loops run over the lanes of a bundle. The compiler turns them into instructions of the
//! vector unit that the caller was compiled for.

use super::accumulate::mark::Content;
use super::classified_scan::{IntegrateStats, check_lengths, content_of};
use super::ray_segments::{Bounds, Flags, Indices, LANES, Numbers, Ray, Source};
use crate::Error;
use crate::flying::point_class::PointClass;
use crate::geometry::lattice::{Lattice, Voxel};
use crate::util::vector_unit::dispatch;
use pulp::{Simd, WithSimd};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::ops::Range;

/// Rays of a scan and voxels of its points, checked before the map changes.
#[derive(Default)]
pub(crate) struct Plan {
    pub(crate) rays: Vec<Ray>,
    /// Voxel of every point, and index of the point in the scan.
    points: Vec<(Voxel, u32)>,
    /// Number of entries of the scan. An entry is a point, a ray without return, or without
    /// information.
    pub(crate) rows: usize,
    /// Lowest and highest corner of the voxels of the rays. None without rays.
    span: Option<[Voxel; 2]>,
    /// Counts that do not depend on the classes of the points.
    pub(crate) stats: IntegrateStats,
    error: Option<Error>,
    /// Plans of the later parts of the scan, filled by other threads.
    others: Vec<Plan>,
}

impl Plan {
    /// Plan the rays and points of a scan, in parts of equal size on all threads of the pool.
    ///
    /// # Errors
    /// The first error in the order of the input.
    pub(crate) fn fill(
        &mut self,
        pool: Option<&ThreadPool>,
        source: &Source<'_>,
    ) -> Result<(), Error> {
        check_lengths(source.scan)?;
        let all = source.scan.points.len();
        let mut others = std::mem::take(&mut self.others);
        others.resize_with(pool.map_or(1, ThreadPool::current_num_threads) - 1, Self::default);
        let share = all.div_ceil(others.len() + 1);
        let part = |number: usize| (number * share).min(all)..((number + 1) * share).min(all);
        let mut fill_own = || self.fill_part(source, part(0));
        match pool {
            Some(pool) => {
                let others = others.par_iter_mut().enumerate();
                let fill = |(number, other): (usize, &mut Self)| {
                    other.fill_part(source, part(number + 1));
                };
                pool.join(fill_own, || others.for_each(fill));
            }
            None => fill_own(),
        }
        // The parts are contiguous and joined in their order: rays, points and the first error are
        // those of a single thread.
        others.iter_mut().for_each(|other| self.append(other));
        (self.others, self.rows) = (others, all);
        self.error.take().map_or(Ok(()), Err)
    }

    fn fill_part(&mut self, source: &Source<'_>, entries: Range<usize>) {
        self.rays.clear();
        self.points.clear();
        self.stats = IntegrateStats::default();
        self.rays.reserve(entries.len());
        self.points.reserve(entries.len());
        self.error = dispatch(Fill { plan: self, source, entries }).err();
        self.stats.rays = self.rays.len();
    }

    /// Add the plan of the next part of the scan.
    fn append(&mut self, next: &mut Self) {
        self.rays.extend_from_slice(&next.rays);
        self.points.extend_from_slice(&next.points);
        self.span = match (self.span, next.span) {
            (Some([low, high]), Some([other_low, other_high])) => Some([
                std::array::from_fn(|axis| low[axis].min(other_low[axis])),
                std::array::from_fn(|axis| high[axis].max(other_high[axis])),
            ]),
            (own, other) => own.or(other),
        };
        self.stats.skipped += next.stats.skipped;
        self.stats.rays += next.stats.rays;
        self.stats.no_return_rays += next.stats.no_return_rays;
        self.error = self.error.take().or(next.error.take());
    }

    /// First and last voxel of the rays. Without rays, the voxel of a point; None without points.
    pub(crate) fn bounds(&self) -> Option<[Voxel; 2]> {
        self.span.or(self.points.first().map(|&(voxel, _)| [voxel; 2]))
    }

    /// Voxel of every point, with the content that follows from the class of the point. Points of
    /// class Invalid are left out.
    pub(crate) fn classified(
        &self,
        class: &[PointClass],
    ) -> impl Iterator<Item = (Voxel, Content)> {
        let content = |row: u32| content_of(class[row as usize]);
        self.points.iter().filter_map(move |&(voxel, row)| Some((voxel, content(row)?)))
    }

    /// Plan the `entries` of the scan (at most one bundle), and extend `bounds` to their rays.
    #[inline(always)]
    fn note(
        &mut self,
        source: &Source<'_>,
        entries: Range<usize>,
        bounds: &mut Bounds,
    ) -> Result<(), Error> {
        let last = entries.end - 1;
        // Lanes past the end repeat the last entry, to fill the bundle; `EntryFlags` ignores them.
        let index: Indices = std::array::from_fn(|lane| (entries.start + lane).min(last));
        let points = source.points(&index);
        let mut flags = EntryFlags::of(source, &entries, &points);
        let (mut voxels, sure) = source.lattice.voxels_at(&points);
        // The bulk conversion can be wrong only next to a face: only such lanes pay for the exact one.
        let mut in_doubt = [false; LANES];
        for lane in 0..LANES {
            in_doubt[lane] = flags.point[lane] & (sure[lane] <= 0.0);
        }
        let mut noted = Ok(());
        if in_doubt.contains(&true) {
            noted = exact_voxels(source.lattice, &points, &in_doubt, &mut voxels, &mut flags);
        }
        // Also after an error: an entry before it may have a ray that cannot be indexed, which comes first.
        self.push(&flags, &voxels, &index);
        bounds.hold(&source.between(&index, &points), &flags.ray);
        self.stats.skipped += entries.len() - flags.count();
        noted
    }

    /// Append the entries of a bundle to the plan. The code has no branches, because the kinds of
    /// the entries are not predictable.
    #[inline(always)]
    fn push(&mut self, flags: &EntryFlags, [x, y, z]: &[[i32; LANES]; 3], index: &Indices) {
        let (mut points, mut rays) = ([([0; 3], 0); LANES], [Ray { index: 0, count: 1 }; LANES]);
        let (mut n_points, mut n_rays) = (0, 0);
        for lane in 0..LANES {
            // Every lane writes, and the count moves on only if the entry has a point: the next lane
            // overwrites the others. The count is at most `lane`, so the index is in range.
            points[n_points] = ([x[lane], y[lane], z[lane]], index[lane] as u32);
            n_points += usize::from(flags.point[lane]);
            rays[n_rays].index = index[lane] as u32;
            n_rays += usize::from(flags.ray[lane]);
            self.stats.no_return_rays += usize::from(flags.away[lane]);
        }
        self.points.extend_from_slice(&points[..n_points]);
        self.rays.extend_from_slice(&rays[..n_rays]);
    }
}

/// Replace voxels that may be wrong because of rounding by the exact ones, for the lanes
/// `in_doubt`.
///
/// # Errors
/// [`Error::PointOutOfRange`] for the first point without a voxel. All flags from it on are then
/// cleared.
#[inline(never)]
fn exact_voxels(
    lattice: &Lattice,
    points: &[Numbers; 3],
    in_doubt: &Flags,
    voxels: &mut [[i32; LANES]; 3],
    flags: &mut EntryFlags,
) -> Result<(), Error> {
    for lane in 0..LANES {
        if in_doubt[lane] {
            let voxel = lattice.voxel_at(points.map(|axis| axis[lane]));
            let voxel = voxel.inspect_err(|_| flags.keep_before(lane))?;
            (0..3).for_each(|axis| voxels[axis][lane] = voxel[axis]);
        }
    }
    Ok(())
}

/// Which entries of a bundle add points and rays. Entries that only fill the bundle add none.
struct EntryFlags {
    /// The entry is a point.
    point: Flags,
    /// The entry is a ray without return.
    away: Flags,
    /// The entry has a ray to cast, with or without return.
    ray: Flags,
}

impl EntryFlags {
    #[inline(always)]
    fn of(source: &Source<'_>, entries: &Range<usize>, [x, y, z]: &[Numbers; 3]) -> Self {
        let scan = source.scan;
        let class = padded(scan.class, entries, PointClass::Invalid);
        let flags = |flags: Option<&[bool]>| {
            flags.map_or([false; LANES], |flags| padded(flags, entries, false))
        };
        let (no_return, no_ray) = (flags(scan.no_return), flags(scan.no_ray));
        let (mut point, mut ray) = ([false; LANES], [false; LANES]);
        let away = match scan.directions.filter(|_| no_return.contains(&true)) {
            Some(directions) => lead_somewhere(&padded(directions, entries, [0.0; 3]), &no_return),
            None => [false; LANES],
        };
        for lane in 0..LANES {
            let is_finite = x[lane].is_finite() & y[lane].is_finite() & z[lane].is_finite();
            // `&` and `|` evaluate both sides: without branches the loop becomes vector code.
            point[lane] = is_finite & (class[lane] != PointClass::Invalid) & !no_return[lane];
            ray[lane] = away[lane] | (point[lane] & !no_ray[lane]);
        }
        Self { point, away, ray }
    }

    /// Clear the flags of the entries from `lane` on.
    fn keep_before(&mut self, lane: usize) {
        for flags in [&mut self.point, &mut self.away, &mut self.ray] {
            flags[lane..].fill(false);
        }
    }

    /// Number of entries that add a point or a ray.
    #[inline(always)]
    fn count(&self) -> usize {
        (0..LANES).map(|lane| usize::from(self.point[lane] | self.away[lane])).sum()
    }
}

/// Of the lanes whose flag is set: those with a direction that is finite and not zero.
#[inline(always)]
fn lead_somewhere(directions: &[[f32; 3]; LANES], flags: &Flags) -> Flags {
    let mut found = [false; LANES];
    for lane in 0..LANES {
        let [x, y, z] = directions[lane].map(f64::from);
        let square = x * x + y * y + z * z; // of numbers of 32 bits: neither too large nor too small
        found[lane] = flags[lane] & (square > 0.0) & square.is_finite();
    }
    found
}

#[inline(always)]
fn padded<T: Copy>(all: &[T], entries: &Range<usize>, filler: T) -> [T; LANES] {
    let mut lanes = [filler; LANES];
    lanes[..entries.len()].copy_from_slice(&all[entries.clone()]);
    lanes
}

struct Fill<'a> {
    plan: &'a mut Plan,
    source: &'a Source<'a>,
    entries: Range<usize>,
}

impl WithSimd for Fill<'_> {
    type Output = Result<(), Error>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Result<(), Error> {
        let Self { plan, source, entries } = self;
        let (mut bounds, mut noted) = (Bounds::default(), Ok(()));
        for from in entries.clone().step_by(LANES) {
            noted = plan.note(source, from..entries.end.min(from + LANES), &mut bounds);
            if noted.is_err() {
                break;
            }
        }
        plan.span = bounds.voxels(source.lattice);
        if plan.span.is_none() {
            // Rays before the entry that failed: the first error in the order of the scan counts.
            source.check(&plan.rays)?;
        }
        noted
    }
}
