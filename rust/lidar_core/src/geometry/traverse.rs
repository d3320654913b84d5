//! Amanatides-Woo walk: the voxels of a segment and the length of the segment in each.

use super::lattice::{Lattice, Voxel, floor};
use crate::Error;
use crate::budget::MAX_VOXELS_PER_RAY;
use std::ops::ControlFlow;

/// Visit, in order, every voxel crossed by the segment `start` -> `end` [m], with the length
/// of the segment inside it [m].
///
/// Consecutive voxels share a face. At an edge or corner the lowest axis goes first, so the
/// result is the same on every platform. `visit` may stop the walk.
///
/// # Errors
/// [`Error::PointOutOfRange`] if an end cannot be indexed, [`Error::Limit`] above
/// [`MAX_VOXELS_PER_RAY`]; nothing is visited then.
///
/// # Source
/// Amanatides & Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987.
pub fn traverse(
    lattice: &Lattice,
    start: [f64; 3],
    end: [f64; 3],
    mut visit: impl FnMut(Voxel, f64) -> ControlFlow<()>,
) -> Result<(), Error> {
    let scaled = [lattice.scaled(start), lattice.scaled(end)];
    let first = floor(scaled[0]).ok_or(Error::PointOutOfRange { point: start })?;
    let last = floor(scaled[1]).ok_or(Error::PointOutOfRange { point: end })?;
    let voxels = voxel_count(first, last);
    if voxels > MAX_VOXELS_PER_RAY as u64 {
        return Err(Error::Limit {
            what: format!("a segment through {voxels} voxels"),
            limit: MAX_VOXELS_PER_RAY as u64,
            key: "voxel_size",
        });
    }
    let size = lattice.voxel_size();
    let mut walk = Walk::new(scaled[0], scaled[1], first, last);
    while let Some((voxel, length, _)) = walk.next() {
        if visit(voxel, length * size).is_break() {
            break;
        }
    }
    Ok(())
}

/// Number of voxels that a walk from `first` to `last` visits.
#[must_use]
pub fn voxel_count(first: Voxel, last: Voxel) -> u64 {
    1 + (0..3).map(|axis| u64::from(first[axis].abs_diff(last[axis]))).sum::<u64>()
}

/// The walk itself, in units of voxels: one formula for `traverse` and for the ray integration.
pub(crate) struct Walk {
    voxel: Voxel,
    last: Voxel,
    step: [i32; 3],
    start: [f64; 3],
    per_span: [f64; 3],
    /// Ray parameter (0 at the start, 1 at the end) of the next wall per axis.
    t_next: [f64; 3],
    t_enter: f64,
    length: f64,
    done: bool,
}

impl Walk {
    /// `first` and `last` are the voxels of `start` and `end`, all in units of voxels.
    #[inline]
    pub(crate) fn new(start: [f64; 3], end: [f64; 3], first: Voxel, last: Voxel) -> Self {
        let span: [f64; 3] = std::array::from_fn(|axis| end[axis] - start[axis]);
        let mut walk = Self {
            voxel: first,
            last,
            step: std::array::from_fn(|axis| last[axis].cmp(&first[axis]) as i32),
            start,
            per_span: std::array::from_fn(|axis| 1.0 / span[axis]),
            t_next: [f64::INFINITY; 3],
            t_enter: 0.0,
            length: (span[0] * span[0] + span[1] * span[1] + span[2] * span[2]).sqrt(),
            done: false,
        };
        for axis in 0..3 {
            if walk.step[axis] != 0 {
                walk.t_next[axis] = walk.wall(axis);
            }
        }
        walk
    }

    /// Ray parameter of the wall through which the walk leaves its voxel along `axis`: computed
    /// afresh, not summed up, so that its error does not grow along a long ray.
    #[inline]
    fn wall(&self, axis: usize) -> f64 {
        let wall = f64::from(self.voxel[axis] + i32::from(self.step[axis] > 0));
        (wall - self.start[axis]) * self.per_span[axis]
    }

    /// The next voxel, the length inside it in units of voxels, and the axis along which the
    /// walk leaves it.
    #[inline]
    pub(crate) fn next(&mut self) -> Option<(Voxel, f64, usize)> {
        if self.done {
            return None;
        }
        let voxel = self.voxel;
        let axis = argmin(self.t_next);
        let t_exit = self.t_next[axis].clamp(self.t_enter, 1.0); // rounding: never backwards
        let length = (t_exit - self.t_enter) * self.length;
        if voxel == self.last {
            self.done = true;
            return Some((voxel, length, axis));
        }
        self.t_enter = t_exit;
        self.voxel[axis] += self.step[axis];
        self.t_next[axis] =
            if self.voxel[axis] == self.last[axis] { f64::INFINITY } else { self.wall(axis) };
        Some((voxel, length, axis))
    }
}

#[inline]
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
    fn a_segment_through_too_many_voxels_is_refused() {
        assert!(matches!(collect([0.0; 3], [1e6, 0.0, 0.0]), Err(Error::Limit { .. })));
        assert!(matches!(collect([0.0; 3], [f64::NAN; 3]), Err(Error::PointOutOfRange { .. })));
    }
}
