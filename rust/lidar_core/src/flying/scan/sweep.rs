//! Turn of a spinning sensor during a scan, from the order of the points.

use crate::geometry::lattice::wide;
use libm::{atan2, hypot};
use std::f64::consts::{PI, TAU};

/// A scan has about this number of blocks, if they are large enough.
const BLOCKS: usize = 1024;
/// Smallest and largest number of points of a block. A block has points of all rows of the sensor, so that its mean
/// azimuth does not depend on the place of the lasers.
const BLOCK: [usize; 2] = [64, 256];
/// Points nearer to the axis do not tell an azimuth well [m].
const NEAREST: f64 = 0.3;
/// Largest share of the turn that blocks may go back. Otherwise the points are not in the order of firing.
const MOST_BACK: f64 = 0.02;
/// Largest step from a block to the next one [rad]. For larger steps, the sense of turning is not clear.
const LARGEST_STEP: f64 = 2.0;
/// Smallest and largest turn of a scan [rad].
const TURN: [f64; 2] = [0.8 * TAU, 2.2 * TAU];

/// How far the sensor had turned at the points of a scan.
#[derive(Clone, Debug)]
pub(crate) struct Sweep {
    /// Number of points of a block, in the order of the scan.
    pub(crate) block: usize,
    /// Number of points of the scan. With several returns per ray: of one return.
    pub(crate) rows: usize,
    /// Angle from the first point to the middle of every block [rad], positive in the sense of turning.
    pub(crate) angles: Vec<f64>,
    /// Angle from the first to the last point [rad].
    pub(crate) turn: f64,
    /// +1 if the azimuth increases during the scan, else -1.
    pub(crate) sense: f64,
}

impl Sweep {
    /// The turn about the z axis of the sensor during a scan. None if the points are not in the order of firing of a
    /// spinning sensor. `is_point`: whether the point with an index is a return. `returns`: number of equal parts, one
    /// per return of a ray.
    pub(crate) fn of(
        points: &[[f32; 3]],
        returns: usize,
        is_point: impl Fn(usize) -> bool,
    ) -> Option<Self> {
        let rows = points.len() / returns.max(1);
        let block = (rows / BLOCKS).clamp(BLOCK[0], BLOCK[1]);
        let mut steps = BlockAzimuths::default();
        let count = rows / block;
        for number in 0..count {
            let mut sum = [0.0; 2];
            for row in (number * block..(number + 1) * block).filter(|&row| is_point(row)) {
                let [x, y, _] = wide(points[row]);
                let length = hypot(x, y);
                if length > NEAREST && length.is_finite() {
                    sum = [sum[0] + x / length, sum[1] + y / length];
                }
            }
            if sum != [0.0; 2] && !steps.add(number, atan2(sum[1], sum[0])) {
                return None;
            }
        }
        let (&(first, from), &(last, to)) = (steps.known.first()?, steps.known.last()?);
        let sense = (to - from).signum();
        let back = if sense > 0.0 { steps.back } else { steps.ahead };
        let per_block = (to - from).abs() / (last - first).max(1) as f64;
        let turn = per_block * rows as f64 / block as f64;
        if !(TURN[0]..=TURN[1]).contains(&turn) || back > MOST_BACK * turn {
            return None;
        }
        let start = sense * from - per_block * (first as f64 + 0.5);
        let angles = steps.at_every(count, per_block).map(|angle| sense * angle - start).collect();
        Some(Self { block, rows, angles, turn, sense })
    }

    /// Index of the block of the point with this index.
    #[inline]
    pub(crate) fn block_of(&self, row: usize) -> usize {
        (row % self.rows / self.block).min(self.angles.len() - 1)
    }

    /// Part of the scan that was over at the middle of every block: 0 at the first point, 1 at the last one.
    pub(crate) fn parts(&self) -> impl Iterator<Item = f64> {
        self.angles.iter().map(|angle| angle / self.turn)
    }
}

/// Unwrapped azimuths of blocks [rad].
#[derive(Default)]
struct BlockAzimuths {
    /// Number of a block, and its azimuth.
    known: Vec<(usize, f64)>,
    /// Sums of the steps of increasing and of decreasing azimuth [rad].
    ahead: f64,
    back: f64,
}

impl BlockAzimuths {
    /// Add a block. False if the step to it is too large.
    fn add(&mut self, number: usize, azimuth: f64) -> bool {
        let Some(&(_, last)) = self.known.last() else {
            self.known.push((number, azimuth));
            return true;
        };
        let step = wrapped(azimuth - last);
        self.known.push((number, last + step));
        if step > 0.0 {
            self.ahead += step
        } else {
            self.back -= step
        }
        step.abs() < LARGEST_STEP
    }

    /// Azimuth of every block. Between known blocks it is interpolated, before the first and after the last one it
    /// goes on with `per_block`.
    fn at_every(&self, count: usize, per_block: f64) -> impl Iterator<Item = f64> {
        let turned = self.known.last().map_or(0.0, |last| last.1 - self.known[0].1);
        let slope = per_block * turned.signum();
        let mut next = 0;
        (0..count).map(move |number| {
            while next < self.known.len() && self.known[next].0 < number {
                next += 1;
            }
            let (before, after) = (next.checked_sub(1), self.known.get(next));
            match (before.map(|at| self.known[at]), after) {
                (_, Some(&(at, angle))) if at == number => angle,
                (Some((from, start)), Some(&(to, end))) => {
                    start + (end - start) * (number - from) as f64 / (to - from) as f64
                }
                (Some((from, start)), None) => start + slope * (number - from) as f64,
                (None, Some(&(to, end))) => end - slope * (to - number) as f64,
                (None, None) => 0.0, // there is at least one
            }
        })
    }
}

/// The same angle between -pi and pi [rad].
pub(crate) fn wrapped(angle: f64) -> f64 {
    let turned = angle % TAU;
    if turned > PI {
        turned - TAU
    } else if turned < -PI {
        turned + TAU
    } else {
        turned
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;

    /// A scan of 16 rows at 10 m that turns by `turn` [rad] from `start`.
    fn scan(start: f64, turn: f64, columns: usize) -> Vec<[f32; 3]> {
        let ray = |index: usize| {
            let azimuth = start + turn * (index / 16) as f64 / columns as f64;
            [10.0 * libm::cos(azimuth) as f32, 10.0 * libm::sin(azimuth) as f32, 0.1]
        };
        (0..16 * columns).map(ray).collect()
    }

    #[test]
    fn the_order_of_the_points_gives_the_turn() -> Result<(), Error> {
        for (start, turn) in [(0.3, -6.9), (-3.0, 6.3), (3.1, 7.5)] {
            let found = Sweep::of(&scan(start, turn, 1800), 1, |_| true);
            let sweep = found.ok_or(Error::Interrupted)?;
            assert!((sweep.turn - turn.abs()).abs() < 0.01, "{} for {turn}", sweep.turn);
            assert_eq!(sweep.sense, turn.signum());
            let parts: Vec<f64> = sweep.parts().collect();
            assert!(parts[0] > 0.0 && parts[0] < 0.005 && parts[parts.len() - 1] < 1.0);
            assert!((parts[parts.len() / 2] - 0.5).abs() < 0.005);
            assert_eq!(sweep.block_of(16 * 1800 - 1), parts.len() - 1);
        }
        Ok(())
    }

    #[test]
    fn blocks_without_returns_are_interpolated() -> Result<(), Error> {
        let points = scan(0.0, 6.5, 1800);
        let full = Sweep::of(&points, 1, |_| true).ok_or(Error::Interrupted)?.angles;
        // An eighth of the scan, both ends among it, has no returns.
        let holes = |row: usize| !(row / 1000).is_multiple_of(8);
        let part = Sweep::of(&points, 1, holes).ok_or(Error::Interrupted)?.angles;
        let far = full.iter().zip(&part).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(far < 0.02, "{far}");
        Ok(())
    }

    #[test]
    fn the_second_returns_are_of_the_same_blocks() -> Result<(), Error> {
        let points = scan(0.0, 6.5, 1800);
        let twice = [points.clone(), points.clone()].concat();
        let sweep = Sweep::of(&twice, 2, |_| true).ok_or(Error::Interrupted)?;
        assert_eq!((sweep.rows, sweep.block_of(points.len() + 700)), (points.len(), 700 / 64));
        Ok(())
    }

    #[test]
    fn other_orders_have_no_turn() {
        let points = scan(0.0, 6.5, 1800);
        let mut by_row = Vec::new(); // one row after another
        for row in 0..16 {
            by_row.extend(points.iter().skip(row).step_by(16));
        }
        let shuffled: Vec<_> =
            (0..points.len()).map(|at| points[at * 7919 % points.len()]).collect();
        let half = scan(0.0, 3.0, 900);
        for (name, other) in [("rows", by_row), ("shuffled", shuffled), ("half a turn", half)] {
            assert!(Sweep::of(&other, 1, |_| true).is_none(), "{name}");
        }
        assert!(Sweep::of(&[], 1, |_| true).is_none());
        assert!(Sweep::of(&points, 1, |_| false).is_none());
    }
}
