//! Points of a cloud inside the regions of all tracks, in one pass over the cloud.

use super::occupancy::cell_of;
use rayon::prelude::*;

const POINTS_PER_CHUNK: usize = 16_384; // fixed: chunk borders must not move with the thread count
/// Number of bits of the filter that rejects most points after one look-up.
const FILTER_BITS: usize = 1 << 16;
/// Radius to which larger regions are cut [m]. It exceeds the range of every sensor.
const MAX_RADIUS: f64 = 1e6;

/// Search region of a track: a ball with centre and radius [m].
#[derive(Clone, Copy, Debug)]
pub(in crate::flying::track) struct Ball {
    pub(in crate::flying::track) center: [f64; 3],
    pub(in crate::flying::track) radius: f64,
}

/// Indices of a point and of a ball that contains it.
pub(in crate::flying::track) type PointInBall = (u32, u32);

/// All pairs of a point and a ball that contains it, sorted by point, then by ball.
pub(in crate::flying::track) fn hits(
    pool: &rayon::ThreadPool,
    points: &[[f32; 3]],
    balls: &[Ball],
) -> Vec<PointInBall> {
    let Some(regions) = Regions::of(balls) else { return Vec::new() };
    let parts: Vec<Vec<PointInBall>> = pool.install(|| {
        points
            .par_chunks(POINTS_PER_CHUNK)
            .enumerate()
            .map(|(chunk, points)| regions.hits(chunk * POINTS_PER_CHUNK, points))
            .collect()
    });
    parts.concat()
}

/// Balls, sorted into cubic cells as wide as the largest ball.
struct Regions {
    balls: Vec<Ball>,
    cell_size: f64,
    low: [f64; 3],
    high: [f64; 3],
    cells: Vec<([i32; 3], u32)>,
    filter: Vec<u64>,
}

impl Regions {
    fn of(balls: &[Ball]) -> Option<Self> {
        let balls: Vec<Ball> = balls
            .iter()
            .map(|ball| Ball { radius: ball.radius.min(MAX_RADIUS), ..*ball })
            .collect();
        let cell_size = 2.0 * balls.iter().map(|ball| ball.radius).reduce(f64::max)?;
        let mut regions = Self {
            balls,
            cell_size,
            low: [f64::INFINITY; 3],
            high: [f64::NEG_INFINITY; 3],
            cells: Vec::new(),
            filter: vec![0; FILTER_BITS / 64],
        };
        for index in 0..regions.balls.len() {
            regions.enter(index);
        }
        regions.cells.sort_unstable();
        Some(regions)
    }

    fn enter(&mut self, index: usize) {
        let Ball { center, radius } = self.balls[index];
        let (low, high) = (center.map(|value| value - radius), center.map(|value| value + radius));
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(low[axis]);
            self.high[axis] = self.high[axis].max(high[axis]);
        }
        let (first, last) = (cell_of(low, self.cell_size), cell_of(high, self.cell_size));
        for x in first[0]..=last[0] {
            for y in first[1]..=last[1] {
                for z in first[2]..=last[2] {
                    let bit = bit_of([x, y, z]);
                    self.filter[bit / 64] |= 1 << (bit % 64);
                    self.cells.push(([x, y, z], index as u32));
                }
            }
        }
    }

    fn hits(&self, offset: usize, points: &[[f32; 3]]) -> Vec<PointInBall> {
        let mut hits = Vec::new();
        for (index, point) in points.iter().enumerate() {
            let point = point.map(f64::from);
            // NaN fails every comparison
            if !(0..3).all(|axis| self.low[axis] <= point[axis] && point[axis] <= self.high[axis]) {
                continue;
            }
            let cell = cell_of(point, self.cell_size);
            let bit = bit_of(cell);
            if self.filter[bit / 64] >> (bit % 64) & 1 == 1 {
                self.search(cell, point, (offset + index) as u32, &mut hits);
            }
        }
        hits
    }

    fn search(&self, cell: [i32; 3], point: [f64; 3], index: u32, hits: &mut Vec<PointInBall>) {
        let start = self.cells.partition_point(|entry| entry.0 < cell);
        for &(_, ball) in self.cells[start..].iter().take_while(|entry| entry.0 == cell) {
            let Ball { center, radius } = self.balls[ball as usize];
            let squared: f64 = (0..3).map(|axis| (point[axis] - center[axis]).powi(2)).sum();
            if squared <= radius * radius {
                hits.push((index, ball));
            }
        }
    }
}

fn bit_of([x, y, z]: [i32; 3]) -> usize {
    let mixed = (x as u32).wrapping_mul(0x9E37_79B1)
        ^ (y as u32).wrapping_mul(0x85EB_CA77)
        ^ (z as u32).wrapping_mul(0xC2B2_AE3D);
    (mixed ^ (mixed >> 15)) as usize % FILTER_BITS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;

    #[test]
    fn hits_equal_those_of_a_full_search_for_any_thread_count() -> Result<(), Error> {
        let mut seed = 7_u32;
        let mut draw = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as f32 / (1 << 24) as f32 * 40.0 - 20.0
        };
        let mut points: Vec<[f32; 3]> = (0..40_000).map(|_| [draw(), draw(), draw()]).collect();
        points[5] = [f32::NAN, 0.0, 0.0];
        points[6] = [f32::INFINITY, 0.0, 0.0];
        let balls: Vec<Ball> = (0..12)
            .map(|index| Ball {
                center: [draw(), draw(), draw()].map(f64::from),
                radius: 1.0 + 0.4 * f64::from(index),
            })
            .collect();
        let mut expected = Vec::new();
        for (index, point) in points.iter().enumerate() {
            for (ball, Ball { center, radius }) in balls.iter().enumerate() {
                let squared: f64 =
                    (0..3).map(|axis| (f64::from(point[axis]) - center[axis]).powi(2)).sum();
                if squared <= radius * radius {
                    expected.push((index as u32, ball as u32));
                }
            }
        }
        assert!(expected.len() > 1000);
        for threads in [1, 2, 4] {
            assert_eq!(hits(&crate::util::threads::pool(threads)?, &points, &balls), expected);
        }
        assert!(hits(&crate::util::threads::pool(1)?, &points, &[]).is_empty());
        Ok(())
    }
}
