//! Interfaces through which the tracker uses the map and the scan.

use crate::flying::detect::center::Center;

/// Voxels that are tentatively or confidently occupied: the set O of Algorithm 2.
pub trait Occupancy: Sync {
    /// True if the centre of a tentatively or confidently occupied voxel is within `distance` [m]
    /// of `point` [m], borders included.
    fn any_within(&self, point: [f64; 3], distance: f64) -> bool;
}

/// Number of rays that must pass through the place of a target, so that it should have given
/// returns.
pub const ENOUGH_RAYS: usize = 3;

/// Visibility of targets in a scan.
pub trait Visibility: Sync {
    /// Number of rays that end in the ball around `position` [m] with `radius` [m] or pass through
    /// it, counted up to `most`. These rays would have met a target of that size: it was in the
    /// field of view and in range, and nothing hid it.
    fn rays(&self, position: [f64; 3], radius: f64, most: usize) -> usize;

    /// True if a target in the ball around `position` [m] with `radius` [m] should have given
    /// returns: at least [`ENOUGH_RAYS`] rays would have met it.
    fn expected(&self, position: [f64; 3], radius: f64) -> bool {
        self.rays(position, radius, ENOUGH_RAYS) >= ENOUGH_RAYS
    }

    /// Centre of every target, given the indices of its points in the scan. None if it is not known
    /// which rays passed beside the targets.
    fn centers(&self, targets: &[&[u32]]) -> Option<Vec<Center>> {
        let _ = targets;
        None
    }
}

type Cell = [i32; 3];

/// Centres of occupied voxels from a plain list, sorted into cells.
#[derive(Debug)]
pub struct OccupiedPoints {
    cell_size: f64,
    entries: Vec<(Cell, [f32; 3])>,
}

impl OccupiedPoints {
    /// Sort the points [m]; those that are not finite are left out. `distance` [m]: the distance
    /// that later queries will use. Other distances are slower but also correct.
    #[must_use]
    pub fn new(points: &[[f32; 3]], distance: f64) -> Self {
        let cell_size = if distance.is_normal() && distance > 0.0 { distance } else { 1.0 };
        let mut entries: Vec<(Cell, [f32; 3])> = points
            .iter()
            .filter(|point| point.iter().all(|value| value.is_finite()))
            .map(|point| (cell_of(point.map(f64::from), cell_size), *point))
            .collect();
        entries.sort_unstable_by_key(|entry| entry.0);
        Self { cell_size, entries }
    }

    fn column_has(&self, low: Cell, high: Cell, is_near: &impl Fn(&[f32; 3]) -> bool) -> bool {
        let start = self.entries.partition_point(|entry| entry.0 < low);
        self.entries[start..]
            .iter()
            .take_while(|entry| entry.0 <= high)
            .any(|(_, point)| is_near(point))
    }
}

impl Occupancy for OccupiedPoints {
    fn any_within(&self, point: [f64; 3], distance: f64) -> bool {
        let is_near = |other: &[f32; 3]| {
            let offset: [f64; 3] = std::array::from_fn(|axis| f64::from(other[axis]) - point[axis]);
            offset.iter().map(|value| value * value).sum::<f64>() <= distance * distance
        };
        let low = cell_of(point.map(|value| value - distance), self.cell_size);
        let high = cell_of(point.map(|value| value + distance), self.cell_size);
        let width = |axis: usize| f64::from(high[axis]) - f64::from(low[axis]) + 1.0;
        if width(0) * width(1) > self.entries.len() as f64 {
            return self.entries.iter().any(|(_, point)| is_near(point));
        }
        (low[0]..=high[0]).any(|x| {
            (low[1]..=high[1]).any(|y| self.column_has([x, y, low[2]], [x, y, high[2]], &is_near))
        })
    }
}

/// Cell that contains a point. Very far points share the outermost cell, which costs time but no
/// correctness.
pub(in crate::flying::track) fn cell_of(point: [f64; 3], cell_size: f64) -> Cell {
    point.map(|value| {
        let scaled = value / cell_size;
        let whole = scaled as i32; // towards zero; `floor` is a function call on baseline x86-64
        whole.saturating_sub(i32::from(scaled < f64::from(whole)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_are_included_and_far_points_found() {
        let points = [[1.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0], [-1e30, 5.0, 0.0]];
        let occupied = OccupiedPoints::new(&points, 1.0);
        assert!(occupied.any_within([0.0; 3], 1.0));
        assert!(!occupied.any_within([0.0; 3], 0.999));
        assert!(!occupied.any_within([3.0, 3.0, 0.0], 1.0));
        assert!(occupied.any_within([f64::from(-1e30_f32), 5.5, 0.0], 1.0));
        assert!(occupied.any_within([4.0, 0.0, 0.0], 100.0));
        assert!(!OccupiedPoints::new(&[], 1.0).any_within([0.0; 3], 1e9));
    }

    #[test]
    fn the_grid_agrees_with_a_full_search() {
        let mut seed = 1_u32;
        let mut draw = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (f64::from(seed >> 8) / f64::from(1 << 24) - 0.5) * 20.0
        };
        let points: Vec<[f32; 3]> =
            (0..300).map(|_| [draw() as f32, draw() as f32, draw() as f32]).collect();
        let occupied = OccupiedPoints::new(&points, 0.9);
        for _ in 0..2000 {
            let at = [draw(), draw(), draw()];
            let expected = points.iter().any(|point| {
                (0..3).map(|axis| (f64::from(point[axis]) - at[axis]).powi(2)).sum::<f64>() <= 0.81
            });
            assert_eq!(occupied.any_within(at, 0.9), expected);
        }
    }
}
