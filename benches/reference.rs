//! Yardsticks: the plainest way to do the same work, scalar, on one thread.

use super::{MAX_RANGE, Scan, VOXEL_SIZE};
use std::collections::HashMap;

const G_INITIAL: f32 = -740.0;
const G_OCC: f32 = 0.0;
const G_FREE: f32 = -1000.0;

/// `ray_scalar`: a dense map of 100 x 100 x 40 m, z fastest, and a dense window of summed lengths
/// around the rays of a scan. Every ray is walked, every length summed, then eqs 8 and 12.
pub struct DenseMap {
    low: [f64; 3],
    size: [usize; 3],
    values: Vec<f32>,
    sums: Vec<f32>,
}

impl DenseMap {
    /// The map with its lower corner at `low` [m].
    #[must_use]
    pub fn new(low: [f64; 3]) -> Self {
        let size = [100.0, 100.0, 40.0].map(|edge: f64| (edge / VOXEL_SIZE) as usize);
        let voxels = size.iter().product();
        Self { low, size, values: vec![G_INITIAL; voxels], sums: Vec::new() }
    }

    /// Update with a scan whose points are all background. Returns the voxels visited.
    pub fn integrate(&mut self, scan: &Scan) -> usize {
        let ends = self.ends(scan);
        let start = self.scaled(scan.origin);
        let (low, window) = bounds(start, &ends);
        self.sums.clear();
        self.sums.resize(window.iter().product(), 0.0);
        let visits = ends.iter().map(|&end| walk(start, end, low, window, &mut self.sums)).sum();
        for point in scan.world.iter().filter(|point| point[0].is_finite()) {
            let voxel = self.scaled(point.map(f64::from)).map(|index| index.floor() as i64);
            if let Some(index) = self.index(voxel) {
                self.values[index] = 0.5 * (self.values[index] + G_OCC); // eq. 8
            }
            if let Some(index) = inside(voxel, low, window) {
                self.sums[index] = 0.0; // points beat rays
            }
        }
        self.update(low, window);
        visits
    }

    fn scaled(&self, point: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| (point[axis] - self.low[axis]) / VOXEL_SIZE)
    }

    fn index(&self, voxel: [i64; 3]) -> Option<usize> {
        inside(voxel, [0; 3], self.size)
    }

    /// Ends of all rays (eq. 20), in voxels.
    fn ends(&self, scan: &Scan) -> Vec<[f64; 3]> {
        let rays = scan.directions.iter().zip(&scan.local);
        rays.map(|(direction, point)| {
            let range = point.iter().map(|&value| f64::from(value).powi(2)).sum::<f64>().sqrt();
            let reach = if range.is_nan() { MAX_RANGE } else { range.min(MAX_RANGE) };
            self.scaled(std::array::from_fn(|axis| {
                scan.origin[axis] + reach * f64::from(direction[axis])
            }))
        })
        .collect()
    }

    fn update(&mut self, low: [i64; 3], window: [usize; 3]) {
        let mut sum = 0;
        for x in 0..window[0] {
            for y in 0..window[1] {
                for z in 0..window[2] {
                    let voxel = [low[0] + x as i64, low[1] + y as i64, low[2] + z as i64];
                    if self.sums[sum] > 0.0
                        && let Some(index) = self.index(voxel)
                    {
                        let keep = (-self.sums[sum]).exp2(); // eq. 12
                        self.values[index] = keep * self.values[index] + (1.0 - keep) * G_FREE;
                    }
                    sum += 1;
                }
            }
        }
    }
}

fn bounds(start: [f64; 3], ends: &[[f64; 3]]) -> ([i64; 3], [usize; 3]) {
    let (mut low, mut high) = (start, start);
    for end in ends {
        for axis in 0..3 {
            low[axis] = low[axis].min(end[axis]);
            high[axis] = high[axis].max(end[axis]);
        }
    }
    let low = low.map(|value| value.floor() as i64);
    let size = std::array::from_fn(|axis| (high[axis].floor() as i64 - low[axis] + 1) as usize);
    (low, size)
}

#[inline]
fn inside(voxel: [i64; 3], low: [i64; 3], size: [usize; 3]) -> Option<usize> {
    let mut index = 0;
    for axis in 0..3 {
        let place = voxel[axis] - low[axis];
        if place < 0 || place >= size[axis] as i64 {
            return None;
        }
        index = index * size[axis] + place as usize;
    }
    Some(index)
}

/// Amanatides & Woo, as in their paper.
fn walk(
    start: [f64; 3],
    end: [f64; 3],
    low: [i64; 3],
    size: [usize; 3],
    sums: &mut [f32],
) -> usize {
    let strides = [(size[1] * size[2]) as isize, size[2] as isize, 1];
    let (mut steps, mut index) = (0, 0isize);
    let (mut t_next, mut t_step, mut stride) = ([f64::INFINITY; 3], [0.0; 3], [0isize; 3]);
    let mut square = 0.0;
    for axis in 0..3 {
        let (from, to) = (start[axis].floor(), end[axis].floor());
        let span = end[axis] - start[axis];
        square += span * span;
        steps += (to - from).abs() as usize;
        index += (from as i64 - low[axis]) as isize * strides[axis];
        if to != from {
            let up = span > 0.0;
            t_next[axis] = (from + f64::from(u8::from(up)) - start[axis]) / span;
            t_step[axis] = 1.0 / span.abs();
            stride[axis] = if up { strides[axis] } else { -strides[axis] };
        }
    }
    let length = square.sqrt();
    let mut t = 0.0;
    for _ in 0..steps {
        let axis = if t_next[0] <= t_next[1] && t_next[0] <= t_next[2] {
            0
        } else if t_next[1] <= t_next[2] {
            1
        } else {
            2
        };
        sums[index as usize] += ((t_next[axis] - t) * length) as f32;
        t = t_next[axis];
        t_next[axis] += t_step[axis];
        index += stride[axis];
    }
    sums[index as usize] += ((1.0 - t).max(0.0) * length) as f32;
    steps + 1
}

/// `cluster_hash`: cells of the tolerance in a hash map, 13 forward neighbours, exact distances,
/// pairs already in one set skipped. Returns the number of clusters.
#[must_use]
pub fn cluster_hash(points: &[[f32; 3]], distance: f64) -> usize {
    let cell = |point: &[f32; 3]| point.map(|value| (f64::from(value) / distance).floor() as i32);
    let mut cells: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
    for (index, point) in points.iter().enumerate() {
        cells.entry(cell(point)).or_default().push(index as u32);
    }
    let mut parent: Vec<u32> = (0..points.len() as u32).collect();
    for (&[x, y, z], members) in &cells {
        for (nth, &a) in members.iter().enumerate() {
            members[nth + 1..].iter().for_each(|&b| join(points, a, b, distance, &mut parent));
        }
        for place in 14..27 {
            let beside = [x + place % 3 - 1, y + place / 3 % 3 - 1, z + place / 9 - 1];
            for &b in cells.get(&beside).into_iter().flatten() {
                members.iter().for_each(|&a| join(points, a, b, distance, &mut parent));
            }
        }
    }
    (0..points.len()).filter(|&index| parent[index] == index as u32).count()
}

fn join(points: &[[f32; 3]], a: u32, b: u32, distance: f64, parent: &mut [u32]) {
    let (root_a, root_b) = (root(parent, a), root(parent, b));
    if root_a == root_b {
        return;
    }
    let (p, q) = (points[a as usize], points[b as usize]);
    let square: f64 = (0..3).map(|axis| (f64::from(p[axis]) - f64::from(q[axis])).powi(2)).sum();
    if square <= distance * distance {
        parent[root_a.max(root_b) as usize] = root_a.min(root_b);
    }
}

fn root(parent: &mut [u32], mut index: u32) -> u32 {
    while parent[index as usize] != index {
        parent[index as usize] = parent[parent[index as usize] as usize];
        index = parent[index as usize];
    }
    index
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CLUSTERING, map_parameters, street};
    use lidar_core::Error;
    use lidar_core::flying::voxel_map::VoxelMap;
    use lidar_core::geometry::cluster::label;

    #[test]
    fn the_yardsticks_do_the_same_work() -> Result<(), Error> {
        let scan = &street(2, 1)?[0];
        let mut dense = DenseMap::new([-50.0, -50.0, -1.0]);
        let visits = dense.integrate(scan);
        let mut map = VoxelMap::new(map_parameters(), 1)?;
        let stats = map.integrate(&scan.classified())?;
        let difference = (stats.visits as f64 - visits as f64).abs() / visits as f64;
        assert!(difference < 1e-3, "{visits} and {} visits", stats.visits);
        let probes: Vec<[f32; 3]> = (0..4000)
            .map(|k| [(k % 200) as f32 * 0.2 - 20.0, (k / 200) as f32 * 0.2, 2.1])
            .collect();
        let expected = probes.iter().map(|probe| {
            let voxel = dense.scaled(probe.map(f64::from)).map(|index| index.floor() as i64);
            dense.index(voxel).map_or(G_INITIAL, |index| dense.values[index])
        });
        let same = map
            .values_at(&probes)
            .iter()
            .zip(expected)
            .filter(|(a, b)| (**a - b).abs() < 1.0)
            .count();
        assert!(same > 3960, "{same} of 4000 values agree");

        let returns = scan.returns();
        let labels = label(&returns, &CLUSTERING)?;
        let clusters = labels.iter().max().map_or(0, |&last| last as usize + 1);
        assert_eq!(cluster_hash(&returns, CLUSTERING.max_distance), clusters);
        Ok(())
    }
}
