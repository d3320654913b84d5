//! Sum of the ray lengths in every voxel, for the rays of one scan. Source: Vrba et al., eqs 21-22.
//!
//! Lengths are summed as integers in a window of blocks around the rays. So the result does not
//! depend on the order of the rays or on the number of threads.

use super::accumulate::accumulator::Accumulator;
use super::accumulate::mark::{RAYS_FROM_EMPTY, RAYS_FROM_FULL};
use super::accumulate::window::Window;
use super::ray_lanes::{CastTask, cast};
use super::ray_segments::{LANES, Ray, Source, places};
use super::stretches::Stretches;
use crate::Error;
use crate::util::cancel;
use crate::util::vector_unit::dispatch;
use pulp::{Simd, WithSimd};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::slice::Chunks;
use std::sync::{Mutex, PoisonError};

/// Number of rays that are handed to a thread at a time.
const RAYS_PER_CHUNK: usize = 1024;

/// Largest number of rays that one ray stands for. A chunk of such rays cannot make a mark
/// overflow.
const MOST_MERGED: u32 = 64;

/// Of all rays that end in the same voxel, keep the first one, which then stands for the others
/// too.
///
/// # Errors
/// [`Error::Limit`] if the rays end in more than `most` blocks.
pub(crate) fn merge_ends(
    accumulator: &mut Accumulator,
    window: Window,
    source: &Source<'_>,
    rays: &mut Vec<Ray>,
    most: usize,
) -> Result<(), Error> {
    accumulator.aim(window, most);
    accumulator.check()?;
    dispatch(Merge { accumulator, window: &window, source, rays });
    accumulator.check()?;
    accumulator.clear(None);
    Ok(())
}

struct Merge<'a> {
    accumulator: &'a mut Accumulator,
    window: &'a Window,
    source: &'a Source<'a>,
    rays: &'a mut Vec<Ray>,
}

impl WithSimd for Merge<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { accumulator, window, source, rays } = self;
        // On one thread and in the order of the scan: which ray is kept does not depend on the threads.
        let mut kept = 0;
        for from in (0..rays.len()).step_by(LANES) {
            let to = rays.len().min(from + LANES);
            let ends = source.segments(&rays[from..to]).scaled(source.lattice).end;
            let last = places(&ends, window);
            for (at, last) in (from..to).zip(last) {
                let ray = rays[at];
                let mark = accumulator.mark_within(window, last as usize);
                // The mark is the number of the last ray kept for this voxel, counted from 1.
                match (*mark as usize).checked_sub(1).and_then(|first| rays.get_mut(first)) {
                    Some(first) if first.count < MOST_MERGED => first.count += 1,
                    _ => {
                        // `kept` is at most `at`: no ray is overwritten before it is read.
                        rays[kept] = ray;
                        kept += 1;
                        *mark = kept as u32;
                    }
                }
            }
        }
        rays.truncate(kept);
    }
}

/// Sum the lengths of `rays` into the first accumulator; there is one accumulator per thread.
/// `Accumulator::check` reports afterwards whether they fit into `most` blocks. The sums must not
/// be used if the call was asked to stop.
pub(crate) fn cast_all(
    pool: Option<&ThreadPool>,
    accumulators: &mut [Accumulator],
    task: &CastTask<'_>,
    rays: &[Ray],
    most: usize,
) {
    // Longer than other functions: the same closures serve one thread and several.
    let watch = cancel::watch();
    let chunks = Mutex::new(rays.chunks(RAYS_PER_CHUNK));
    let meets = |index| task.live.is_none_or(|live| live.meets(index));
    let work = |(number, accumulator): (usize, &mut Accumulator)| {
        accumulator.aim(*task.window, most);
        if accumulator.check().is_err() {
            return; // the caller reads the error from the accumulator
        }
        let mut stretches = Stretches::default();
        let mut room = RAYS_FROM_EMPTY;
        while let Some(rays) = take(&chunks, number) {
            let count = rays.iter().map(|ray| ray.count as usize).sum();
            if room < count {
                accumulator.settle(meets);
                // Settled marks are at most `MAX_COUNT`: so many more rays cannot overflow them.
                room = RAYS_FROM_FULL;
            }
            room -= count;
            cast(accumulator, task, rays, &mut stretches);
            if watch.is_asked() || accumulator.check().is_err() {
                break;
            }
        }
        accumulator.settle(meets);
    };
    match pool {
        Some(pool) => pool.install(|| {
            accumulators.par_iter_mut().enumerate().for_each(work);
            if let Some((sum, others)) =
                accumulators.split_first_mut().filter(|_| !watch.is_asked())
            {
                // Integer sums: their order cannot matter.
                others.iter_mut().for_each(|other| sum.absorb(other, task.window, pool));
            }
        }),
        None => accumulators.iter_mut().take(1).enumerate().for_each(work),
    }
}

/// The next rays for a thread. Threads take rays from both ends of the list, because rays far apart
/// in a scan have few common voxels.
fn take<'a>(chunks: &Mutex<Chunks<'a, Ray>>, thread: usize) -> Option<&'a [Ray]> {
    let mut chunks = chunks.lock().unwrap_or_else(PoisonError::into_inner);
    if thread.is_multiple_of(2) { chunks.next() } else { chunks.next_back() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::integrate::accumulate::accumulator::Slot;
    use crate::flying::integrate::accumulate::mark::{
        Content, Mark, UNITS_PER_EDGE, tag_and_count,
    };
    use crate::flying::integrate::ray_segments::tests::with_rays;
    use crate::flying::map::block_shape::VOLUME;
    use crate::flying::map::blocks::Place;
    use crate::geometry::lattice::Lattice;
    use crate::geometry::transform::{minus, norm};
    use crate::geometry::traverse::traverse;
    use std::ops::ControlFlow;

    /// Cast rays from starts to ends, in units of voxels. With `merge`, merge them first. Returns
    /// the rays that were cast.
    fn cast_some(
        sums: &mut [Accumulator],
        window: Window,
        segments: &[([f64; 3], [f32; 3])],
        merge: bool,
    ) -> Result<Vec<Ray>, Error> {
        with_rays(segments, |source, mut rays| {
            if merge {
                merge_ends(&mut sums[0], window, source, &mut rays, 1 << 20)?;
            }
            let pool = crate::util::threads::pool(sums.len())?;
            let pool = (sums.len() > 1).then_some(&pool);
            let task = CastTask { window: &window, source, live: None };
            cast_all(pool, sums, &task, &rays, 1 << 20);
            Ok(rays)
        })
    }

    fn sum(
        rays: &[([f64; 3], [f32; 3])],
        threads: usize,
    ) -> Result<Vec<(Place, Vec<Mark>)>, Error> {
        let mut sums: Vec<_> = (0..threads).map(|_| Accumulator::default()).collect();
        cast_some(&mut sums, Window::spanning([-40; 3], [40; 3])?, rays, false)?;
        let marked: Vec<_> = sums[0].marked().collect();
        let marks = |slot| sums[0].block(slot, &mut [0; VOLUME]).0.to_vec();
        Ok(marked.into_iter().map(|(place, slot)| (place, marks(slot))).collect())
    }

    #[test]
    fn any_number_of_threads_and_any_order_give_the_same_bits() -> Result<(), Error> {
        let mut rays: Vec<_> = (0..5000u16)
            .map(|index| {
                let (sin, cos) = libm::sincosf(f32::from(index) * 0.37);
                ([0.3, -0.2, 0.1], [30.0 * cos, 30.0 * sin, f32::from(index % 60) - 30.0])
            })
            .collect();
        let one = sum(&rays, 1)?;
        assert!(one.len() > 100);
        for threads in [2, 4, 7] {
            assert_eq!(sum(&rays, threads)?, one);
        }
        rays.reverse();
        assert_eq!(sum(&rays, 2)?, one);
        Ok(())
    }

    /// Start and end of a test ray within `reach` voxels. Some are on walls.
    fn ends(index: u32, reach: f64) -> [[f64; 3]; 2] {
        let at = |number: u32| {
            let share =
                f64::from((index * 6 + number).wrapping_mul(2_654_435_769)) / 4_294_967_296.0;
            let value = (2.0 * share - 1.0) * reach;
            if index.is_multiple_of(3) { value.round() / 2.0 } else { value }
        };
        [[at(0), at(1), at(2)], [at(3), at(4), at(5)]]
    }

    #[test]
    fn lengths_are_those_of_the_exact_walk_to_a_unit() -> Result<(), Error> {
        let lattice = Lattice::new(1.0, [0.0; 3])?;
        let mut sums = [Accumulator::default()];
        for (index, thin) in (0..600).flat_map(|index| [(index, 1.0), (index, 0.002)]) {
            let [start, end] = ends(index, 1000.0 / if thin < 1.0 { 1.0 } else { 20.0 })
                .map(|[x, y, z]| [x, y * thin, z * thin].map(|value| f64::from(value as f32)));
            let window = Window::spanning([-1000, -60, -60], [1000, 60, 60])?;
            let point = end.map(|value| value as f32);
            cast_some(&mut sums, window, &[(start, point)], false)?;
            let (mut visits, mut worst) = (0, 0f64);
            let bound = |visits: u64| {
                1.0 + 2.0 * (visits + 1) as f64 * norm(minus(end, start)) / 2f64.powi(16)
            };
            traverse(&lattice, start, end, |voxel, length| {
                let units = sums[0].mark(voxel).map_or(0, std::mem::take);
                worst = worst.max((f64::from(units) - length * UNITS_PER_EDGE).abs());
                visits += 1;
                ControlFlow::Continue(())
            })?;
            assert_eq!(sums[0].visits(), visits);
            assert!(worst <= bound(visits), "{worst} units of {start:?} to {end:?}");
            let slots: Vec<_> = sums[0].marked().collect();
            let left =
                slots.iter().flat_map(|&(_, slot)| *sums[0].block(slot, &mut [0; VOLUME]).0).max();
            assert!(f64::from(left.unwrap_or(0)) <= bound(visits));
            sums[0].clear(None);
        }
        Ok(())
    }

    #[test]
    fn points_beat_rays_and_background_beats_all() -> Result<(), Error> {
        let mut accumulators = [Accumulator::default()];
        let window = Window::spanning([0; 3], [15; 3])?;
        cast_some(&mut accumulators, window, &[([0.5; 3], [3.5, 0.5, 0.5])], false)?;
        let sum = &mut accumulators[0];
        for (x, class) in [
            (1, Content::Unknown),
            (1, Content::Background),
            (1, Content::Unknown),
            (2, Content::Flying),
        ] {
            sum.mark_points([x, 0, 0], class, 1);
        }
        let mut spare = [0; VOLUME];
        let (marks, met) = sum.block(Slot::Within(0), &mut spare);
        assert_eq!(met, 1);
        assert_eq!(tag_and_count(marks[0]), (Content::Rays as u32, 8192));
        assert_eq!(tag_and_count(marks[1]), (Content::Background as u32, 1));
        assert_eq!(tag_and_count(marks[2]), (Content::Flying as u32, 1));
        assert_eq!(tag_and_count(marks[3]), (Content::Rays as u32, 8192));
        assert_eq!(sum.visits(), 4);
        Ok(())
    }

    #[test]
    fn the_first_ray_into_a_voxel_stands_for_the_others() -> Result<(), Error> {
        let window = Window::spanning([0; 3], [15; 3])?;
        let to = |x: f32| ([0.5; 3], [x, 0.5, 0.5]);
        let mut rays = vec![to(3.5), to(5.5), to(3.7), to(3.2)];
        let mut sums = [Accumulator::default()];
        let kept = cast_some(&mut sums, window, &rays, true)?;
        assert_eq!(kept, [Ray { index: 0, count: 3 }, Ray { index: 1, count: 1 }]);
        let mut spare = [0; VOLUME];
        let marks = sums[0].block(Slot::Within(0), &mut spare).0;
        assert_eq!(marks[..6], [32_768, 65_536, 65_536, 40_960, 16_384, 8_192]);
        sums[0].clear(None);
        rays.extend([to(9.5); 65]);
        let kept = cast_some(&mut sums, window, &rays, true)?;
        assert_eq!(kept[2..], [Ray { index: 4, count: 64 }, Ray { index: 68, count: 1 }]);
        Ok(())
    }
}
