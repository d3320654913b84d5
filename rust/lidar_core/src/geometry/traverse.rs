//! Walk of Amanatides and Woo: the voxels that a segment crosses, and its length in each.

use super::lattice::{Lattice, Voxel};
use super::transform::{minus, norm};
use crate::Error;
use crate::util::budget::MAX_VOXELS_PER_RAY;
use std::ops::ControlFlow;

/// Call `visit` in order for every voxel that the segment from `start` to `end` [m] crosses, with
/// the length of the segment inside it [m].
///
/// Consecutive voxels share a face. At an edge or corner the lowest axis goes first, so the result
/// is the same on every platform. `visit` may stop the walk.
///
/// # Errors
/// [`Error::PointOutOfRange`] if an end has no voxel, [`Error::Limit`] above [`MAX_VOXELS_PER_RAY`]
/// voxels. In both cases nothing is visited.
///
/// # Source
/// Amanatides & Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987.
pub fn traverse(
    lattice: &Lattice,
    start: [f64; 3],
    end: [f64; 3],
    mut visit: impl FnMut(Voxel, f64) -> ControlFlow<()>,
) -> Result<(), Error> {
    let first = lattice.voxel_at(start)?;
    let last = lattice.voxel_at(end)?;
    // Counted before the walk: a segment that is refused visits nothing.
    let voxels = voxel_count(first, last);
    if voxels > MAX_VOXELS_PER_RAY as u64 {
        return Err(Error::Limit {
            what: format!("a segment through {voxels} voxels"),
            limit: MAX_VOXELS_PER_RAY as u64,
            key: "voxel_size",
        });
    }
    let mut walk = SegmentWalk::new(lattice, start, end, first, last);
    while let Some((voxel, length)) = walk.next() {
        if visit(voxel, length).is_break() {
            break;
        }
    }
    Ok(())
}

/// Number of voxels that a walk from voxel `first` to voxel `last` visits.
#[must_use]
pub fn voxel_count(first: Voxel, last: Voxel) -> u64 {
    1 + (0..3).map(|axis| u64::from(first[axis].abs_diff(last[axis]))).sum::<u64>()
}

/// State of a walk along a segment.
struct SegmentWalk {
    voxel: Voxel,
    last: Voxel,
    step: [i32; 3],
    /// Start relative to the lattice's origin; `span`: vector from start to end [m].
    from: [f64; 3],
    span: [f64; 3],
    voxel_size: f64,
    /// Ray parameter (0 at the start, 1 at the end) of the next wall for each axis. Infinite where
    /// the walk has reached the last voxel along the axis.
    t_next: [f64; 3],
    t_enter: f64,
    length: f64,
    done: bool,
}

impl SegmentWalk {
    fn new(lattice: &Lattice, start: [f64; 3], end: [f64; 3], first: Voxel, last: Voxel) -> Self {
        let from = minus(start, lattice.origin());
        let mut walk = Self {
            voxel: first,
            last,
            step: std::array::from_fn(|axis| last[axis].cmp(&first[axis]) as i32),
            from,
            span: minus(minus(end, lattice.origin()), from),
            voxel_size: lattice.voxel_size(),
            t_next: [f64::INFINITY; 3],
            t_enter: 0.0,
            length: norm(minus(end, start)),
            done: false,
        };
        for axis in 0..3 {
            walk.aim(axis);
        }
        walk
    }

    /// Compute the parameter of the wall through which the walk leaves its voxel along `axis`. It
    /// is computed anew and not summed up, with one rounding before the division, so that lengths
    /// are exact to 1e-9 m even 1000 km away and along a wall.
    fn aim(&mut self, axis: usize) {
        // Infinity is never the least: the walk cannot pass the last voxel along this axis.
        self.t_next[axis] = if self.voxel[axis] == self.last[axis] {
            f64::INFINITY
        } else {
            let wall = f64::from(self.voxel[axis] + i32::from(self.step[axis] > 0));
            libm::fma(wall, self.voxel_size, -self.from[axis]) / self.span[axis]
        };
    }

    /// The next voxel, and the length inside it [m]. None at the end of the walk.
    fn next(&mut self) -> Option<(Voxel, f64)> {
        if self.done {
            return None;
        }
        let voxel = self.voxel;
        let axis = argmin(self.t_next);
        let t_exit = self.t_next[axis].clamp(self.t_enter, 1.0); // rounding: never backwards
        let length = (t_exit - self.t_enter) * self.length;
        if voxel == self.last {
            self.done = true;
            return Some((voxel, length));
        }
        self.t_enter = t_exit;
        self.voxel[axis] += self.step[axis];
        self.aim(axis);
        Some((voxel, length))
    }
}

fn argmin([x, y, z]: [f64; 3]) -> usize {
    if x <= y && x <= z {
        0
    } else if y <= z {
        1
    } else {
        2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn collect(start: [f64; 3], end: [f64; 3]) -> Result<Vec<(Voxel, f64)>, Error> {
        let mut visits = Vec::new();
        traverse(&Lattice::new(1.0, [0.0; 3])?, start, end, |voxel, length| {
            visits.push((voxel, length));
            ControlFlow::Continue(())
        })?;
        Ok(visits)
    }

    #[test]
    fn an_axis_parallel_segment() -> Result<(), Error> {
        let visits = collect([0.5, 0.5, 0.5], [4.5, 0.5, 0.5])?; // a span of 4: exact in binary
        let lengths = [0.5, 1.0, 1.0, 1.0, 0.5];
        assert_eq!(visits, std::array::from_fn::<_, 5, _>(|x| ([x as i32, 0, 0], lengths[x])));
        Ok(())
    }

    #[test]
    fn at_a_corner_the_lowest_axis_goes_first() -> Result<(), Error> {
        let voxels: Vec<_> =
            collect([0.5; 3], [1.5; 3])?.into_iter().map(|(voxel, _)| voxel).collect();
        assert_eq!(voxels, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]]);
        Ok(())
    }

    #[test]
    fn a_point_visits_its_voxel() -> Result<(), Error> {
        assert_eq!(collect([-0.5, 0.5, 0.5], [-0.5, 0.5, 0.5])?, [([-1, 0, 0], 0.0)]);
        Ok(())
    }

    #[test]
    fn a_span_whose_reciprocal_overflows_is_walked() -> Result<(), Error> {
        for (from, to) in [(-1e-310, 0.0), (0.0, -1e-310), (-5e-324, 5e-324)] {
            assert_eq!(collect([0.5, from, 0.5], [0.5, to, 0.5])?.len(), 2);
        }
        Ok(())
    }

    #[test]
    fn a_segment_through_too_many_voxels_is_refused() {
        assert!(matches!(collect([0.0; 3], [1e6, 0.0, 0.0]), Err(Error::Limit { .. })));
        assert!(matches!(collect([0.0; 3], [f64::NAN; 3]), Err(Error::PointOutOfRange { .. })));
    }
}
