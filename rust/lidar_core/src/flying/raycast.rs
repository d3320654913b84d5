//! Rays of one scan -> summed length per voxel. Source: Vrba et al., eqs 21-22.
//!
//! Lengths are summed as integers in a window of blocks around the rays, so the result depends
//! neither on the order of the rays nor on the number of threads.

use super::lanes::cast;
use super::marks::{Accumulator, RAYS_FROM_EMPTY, RAYS_FROM_FULL};
use super::window::Window;
use crate::Error;
use crate::geometry::lattice::Voxel;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A segment in units of voxels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub(crate) start: [f64; 3],
    pub(crate) end: [f64; 3],
    /// The voxel of the end.
    pub(crate) last: Voxel,
    /// Rays that it stands for.
    pub(crate) count: u32,
}

/// Rays handed to a thread at a time.
const RAYS_PER_CHUNK: usize = 1024;

/// Most rays that one stands for: a chunk of such rays does not fill a mark.
const MOST_MERGED: u32 = 64;

/// Keep the first of all rays that end in the same voxel, to stand for the others too.
///
/// # Errors
/// [`Error::Limit`] if they end in more than `most` blocks.
pub(crate) fn merge_ends(
    accumulator: &mut Accumulator,
    window: Window,
    rays: &mut Vec<Ray>,
    most: usize,
) -> Result<(), Error> {
    accumulator.aim(window, most);
    let mut kept = 0;
    for at in 0..rays.len() {
        let ray = rays[at];
        let Some(mark) = accumulator.mark(ray.last) else { continue }; // `check` will say why
        // The mark is the number of the last ray kept for this voxel, counted from 1.
        match (*mark as usize).checked_sub(1).and_then(|first| rays.get_mut(first)) {
            Some(first) if first.count < MOST_MERGED => first.count += 1,
            _ => {
                rays[kept] = ray;
                kept += 1;
                *mark = kept as u32;
            }
        }
    }
    rays.truncate(kept);
    accumulator.check()
}

/// Sum the lengths of `rays` into the first accumulator; one accumulator per thread. Its `check`
/// says whether they fit into `most` blocks.
pub(crate) fn cast_all(
    pool: Option<&ThreadPool>,
    accumulators: &mut [Accumulator],
    window: Window,
    rays: &[Ray],
    most: usize,
) {
    let next = AtomicUsize::new(0);
    let work = |accumulator: &mut Accumulator| {
        accumulator.aim(window, most);
        let chunk = || next.fetch_add(RAYS_PER_CHUNK, Ordering::Relaxed);
        let mut room = RAYS_FROM_EMPTY;
        for start in std::iter::repeat_with(chunk).take_while(|&start| start < rays.len()) {
            let rays = &rays[start..rays.len().min(start + RAYS_PER_CHUNK)];
            let count = rays.iter().map(|ray| ray.count as usize).sum();
            if room < count {
                accumulator.settle();
                room = RAYS_FROM_FULL;
            }
            room -= count;
            cast(accumulator, &window, rays);
            if accumulator.check().is_err() {
                break;
            }
        }
        accumulator.settle();
    };
    match pool {
        Some(pool) => pool.install(|| {
            accumulators.par_iter_mut().for_each(work);
            if let Some((sum, others)) = accumulators.split_first_mut() {
                // Integer sums: their order cannot matter.
                others.iter().for_each(|other| sum.absorb(other, &window));
            }
        }),
        None => accumulators.iter_mut().take(1).for_each(work),
    }
}

#[cfg(test)]
mod tests {
    use super::super::blocks::Place;
    use super::super::marks::{Content, Mark, tag_and_count};
    use super::*;

    fn ray(start: [f64; 3], end: [f64; 3]) -> Ray {
        Ray { start, end, last: end.map(|value| value.floor() as i32), count: 1 }
    }

    fn sum(rays: &[Ray], threads: usize) -> Result<Vec<(Place, Vec<Mark>)>, Error> {
        let pool = crate::threads::pool(threads)?;
        let mut accumulators: Vec<_> = (0..threads).map(|_| Accumulator::default()).collect();
        let window = Window::spanning([-40; 3], [40; 3])?;
        cast_all(Some(&pool), &mut accumulators, window, rays, 1 << 20);
        Ok(accumulators[0]
            .marked()
            .into_iter()
            .map(|(place, marks)| (place, marks.to_vec()))
            .collect())
    }

    #[test]
    fn any_number_of_threads_and_any_order_give_the_same_bits() -> Result<(), Error> {
        let mut rays: Vec<Ray> = (0..5000)
            .map(|index| {
                let angle = f64::from(index) * 0.37;
                let end = [
                    30.0 * libm::cos(angle),
                    30.0 * libm::sin(angle),
                    f64::from(index % 60) - 30.0,
                ];
                ray([0.3, -0.2, 0.1], end)
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

    #[test]
    fn points_beat_rays_and_background_beats_all() -> Result<(), Error> {
        let mut accumulators = [Accumulator::default()];
        let window = Window::spanning([0; 3], [15; 3])?;
        let ray = ray([0.5; 3], [3.5, 0.5, 0.5]);
        cast_all(None, &mut accumulators, window, &[ray], 1 << 20);
        let sum = &mut accumulators[0];
        for (x, class) in [
            (1, Content::Unknown),
            (1, Content::Background),
            (1, Content::Unknown),
            (2, Content::Flying),
        ] {
            sum.mark_points([x, 0, 0], class, 1);
        }
        let marks = sum.marked()[0].1;
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
        let to = |x: f64| ray([0.5; 3], [x, 0.5, 0.5]);
        let mut rays = vec![to(3.5), to(5.5), to(3.7), to(3.2)];
        rays.extend([to(9.5); 65]);
        let mut accumulators = [Accumulator::default()];
        merge_ends(&mut accumulators[0], window, &mut rays, 1 << 20)?;
        let kept: Vec<_> = rays.iter().map(|ray| (ray.end[0], ray.count)).collect();
        assert_eq!(kept, [(3.5, 3), (5.5, 1), (9.5, 64), (9.5, 1)]);
        cast_all(None, &mut accumulators, window, &rays[..2], 1 << 20);
        let marks = accumulators[0].marked()[0].1;
        assert_eq!(marks[..6], [32_768, 65_536, 65_536, 40_960, 16_384, 8_192]);
        Ok(())
    }
}
