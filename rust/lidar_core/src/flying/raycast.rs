//! Rays of one scan -> summed length per voxel. Source: Vrba et al., eqs 21-22.
//!
//! Lengths are summed as integers in a window of blocks around the rays, so the result depends
//! neither on the order of the rays nor on the number of threads.

use super::lanes::cast;
use super::marks::{Accumulator, RAYS_FROM_EMPTY, RAYS_FROM_FULL};
use super::window::Window;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A segment in units of voxels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub(crate) start: [f64; 3],
    pub(crate) end: [f64; 3],
}

/// Rays handed to a thread at a time.
const RAYS_PER_CHUNK: usize = 1024;

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
            if room < RAYS_PER_CHUNK {
                accumulator.settle();
                room = RAYS_FROM_FULL;
            }
            room -= RAYS_PER_CHUNK;
            cast(accumulator, &window, &rays[start..rays.len().min(start + RAYS_PER_CHUNK)]);
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
    use crate::Error;

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
                Ray { start: [0.3, -0.2, 0.1], end }
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
        let ray = Ray { start: [0.5; 3], end: [3.5, 0.5, 0.5] };
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
}
