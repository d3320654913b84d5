//! Yardsticks: the plainest way to do the same work, scalar, on one thread.

use super::{MAX_RANGE, Scan, VOXEL_SIZE};

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

/// Amanatides & Woo, as in their paper; the parameter along the ray is the length [voxels].
fn walk(
    start: [f64; 3],
    end: [f64; 3],
    low: [i64; 3],
    size: [usize; 3],
    sums: &mut [f32],
) -> usize {
    let strides = [(size[1] * size[2]) as isize, size[2] as isize, 1];
    let length = (0..3).map(|axis| (end[axis] - start[axis]).powi(2)).sum::<f64>().sqrt();
    let (mut steps, mut index) = (0, 0isize);
    let (mut next, mut step, mut stride) = ([f32::INFINITY; 3], [0f32; 3], [0isize; 3]);
    for axis in 0..3 {
        let (from, to) = (start[axis].floor(), end[axis].floor());
        let pace = length / (end[axis] - start[axis]);
        steps += (to - from).abs() as usize;
        index += (from as i64 - low[axis]) as isize * strides[axis];
        if to != from {
            let edge = from + f64::from(u8::from(pace > 0.0));
            next[axis] = ((edge - start[axis]) * pace) as f32;
            step[axis] = pace.abs() as f32;
            stride[axis] = if pace > 0.0 { strides[axis] } else { -strides[axis] };
        }
    }
    let ([mut next_x, mut next_y, mut next_z], mut at) = (next, 0f32);
    for _ in 0..steps {
        let here = index as usize;
        let until;
        if next_x <= next_y && next_x <= next_z {
            until = next_x;
            next_x += step[0];
            index = index.wrapping_add(stride[0]);
        } else if next_y <= next_z {
            until = next_y;
            next_y += step[1];
            index = index.wrapping_add(stride[1]);
        } else {
            until = next_z;
            next_z += step[2];
            index = index.wrapping_add(stride[2]);
        }
        sums[here] += until - at;
        at = until;
    }
    sums[index as usize] += (length as f32 - at).max(0.0);
    steps + 1
}

/// `cluster_hash`: cells of the tolerance sorted by their key, points copied in that order, 13
/// forward neighbours, exact distances, pairs already in one set skipped. Returns the number of
/// clusters.
#[must_use]
pub fn cluster_hash(points: &[[f32; 3]], distance: f64) -> usize {
    const MIDDLE: i64 = 1 << 20; // 21 bits per axis
    let cell = |value: f32| (f64::from(value) / distance).floor() as i64 + MIDDLE;
    let key = |point: &[f32; 3]| point.iter().fold(0, |key, &value| key << 21 | cell(value));
    let mut order: Vec<(i64, u32)> = points.iter().map(key).zip(0..).collect();
    order.sort_unstable();
    let sorted: Vec<[f32; 3]> = order.iter().map(|&(_, index)| points[index as usize]).collect();
    let mut cells: Vec<(i64, usize)> = Vec::new();
    for (place, &(key, _)) in order.iter().enumerate() {
        if cells.last().is_none_or(|&(last, _)| last != key) {
            cells.push((key, place));
        }
    }
    let ends = cells.iter().skip(1).map(|&(_, start)| start).chain([points.len()]);
    let ends: Vec<usize> = ends.collect();
    let mut parent: Vec<u32> = (0..points.len() as u32).collect();
    let forward = (14..27i64).map(|n| ((n / 9 - 1) << 42) + ((n / 3 % 3 - 1) << 21) + n % 3 - 1);
    let mut forward: Vec<(i64, usize)> = forward.map(|offset| (offset, 0)).collect();
    for (&(key, start), &end) in cells.iter().zip(&ends) {
        for a in start..end {
            (a + 1..end).for_each(|b| join(&sorted, a, b, distance, &mut parent));
        }
        for (offset, place) in &mut forward {
            // keys grow, so the place of the neighbour only moves on
            while cells.get(*place).is_some_and(|&(found, _)| found < key + *offset) {
                *place += 1;
            }
            if let Some(&(found, beside)) = cells.get(*place)
                && found == key + *offset
            {
                for b in beside..ends[*place] {
                    (start..end).for_each(|a| join(&sorted, a, b, distance, &mut parent));
                }
            }
        }
    }
    (0..points.len()).filter(|&index| parent[index] == index as u32).count()
}

fn join(points: &[[f32; 3]], a: usize, b: usize, distance: f64, parent: &mut [u32]) {
    let (root_a, root_b) = (root(parent, a as u32), root(parent, b as u32));
    if root_a == root_b {
        return;
    }
    let (p, q) = (points[a], points[b]);
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
    use super::super::street;
    use super::*;
    use lidar_core::Error;
    use lidar_core::flying::integrate::integrator::Integrator;
    use lidar_core::flying::map::parameters::MapParameters;
    use lidar_core::flying::map::voxel_map::VoxelMap;
    use lidar_core::geometry::cluster::{Clustering, label};

    #[test]
    fn the_yardsticks_do_the_same_work() -> Result<(), Error> {
        let scan = &street(2, 1)?[0];
        let mut dense = DenseMap::new([-50.0, -50.0, -1.0]);
        let visits = dense.integrate(scan);
        let parameters = MapParameters::default();
        assert_eq!([parameters.voxel_size, parameters.max_range], [VOXEL_SIZE, MAX_RANGE]);
        let mut map = VoxelMap::new(parameters)?;
        let stats = Integrator::new(1)?.integrate(&mut map, &scan.classified())?;
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
        let clustering = Clustering::default();
        let labels = label(&returns, &clustering)?;
        let clusters = labels.iter().max().map_or(0, |&last| last as usize + 1);
        assert_eq!(cluster_hash(&returns, clustering.max_distance), clusters);
        Ok(())
    }
}
