//! Points that stand still during the burn-in: background, however small.

use super::burn_in::Gate;
use super::burn_in_time::BurnIn;
use crate::flying::detector::FlyingObjectDetector;
use crate::flying::map::blocks::Place;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};
use crate::geometry::transform::{minus, norm};
use crate::util::key_hasher::Spread;
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Coordinates are summed up as integers, so that the order of the points cannot matter.
const UNITS_PER_METRE: f64 = 65_536.0;

/// Points that every voxel held in the scans so far.
#[derive(Default)]
pub(crate) struct Standing {
    voxels: HashMap<Place, Held, BuildHasherDefault<Spread>>,
}

#[derive(Clone, Copy, Default)]
struct Held {
    scans: u32,
    last_scan: u32,
    /// Sums of coordinates and numbers of points in both halves.
    halves: [([i64; 3], i64); 2],
}

impl Standing {
    /// Add the points of scan `scan` (1 is the first) of `of`.
    pub(crate) fn add(&mut self, lattice: &Lattice, points: &[[f32; 3]], scan: u32, of: u32) {
        let half = usize::from(2 * scan > of);
        for &point in points {
            let point = wide(point);
            let Some(voxel) = floor(lattice.scaled(point)) else { continue };
            let held = self.voxels.entry(Place(voxel)).or_default();
            if held.last_scan != scan {
                held.scans += 1;
                held.last_scan = scan;
            }
            let (sums, count) = &mut held.halves[half];
            let center = lattice.center(voxel);
            for axis in 0..3 {
                let offset = ((point[axis] - center[axis]) * UNITS_PER_METRE).round() as i64;
                sums[axis] = sums[axis].saturating_add(offset);
            }
            *count += 1;
        }
    }

    /// Voxels that held points in at least `scans` scans, which moved by at most `shift` [m]
    /// between the halves of the burn-in, in ascending order.
    pub(crate) fn voxels(&self, scans: u32, shift: f64) -> Vec<Voxel> {
        let stands = |held: &Held| held.scans >= scans && held.shift() <= shift;
        let mut voxels: Vec<Voxel> =
            self.voxels.iter().filter(|(_, held)| stands(held)).map(|(place, _)| place.0).collect();
        voxels.sort_unstable();
        voxels
    }

    pub(crate) fn clear(&mut self) {
        self.voxels = HashMap::default();
    }
}

impl FlyingObjectDetector {
    /// At the end of the burn-in, what stood still all the time becomes background.
    pub(crate) fn keep_standing(&mut self, scan: &Prepared, gate: Gate) {
        let seed = &self.parameters.seed;
        let Gate::BurnIn { scans, of } = gate else { return };
        if seed.standing_scans == 0 {
            return;
        }
        self.standing.add(self.map.lattice(), &scan.points, scans, of);
        if scans >= of {
            let distance = self.parameters.classify.close_distance;
            let lattice = *self.map.lattice();
            let moving = self.tracker.moved_by(seed.standing_track_distance);
            let mut standing =
                self.standing.voxels(BurnIn::standing(seed, of), seed.standing_shift);
            standing.retain(|&voxel| {
                let center = lattice.center(voxel);
                moving.iter().all(|&position| norm(minus(position, center)) > distance)
            });
            self.map.keep(&standing);
            self.standing.clear();
            self.tracker.drop_near(&self.map, distance); // tracks of such things, still unseen
        }
    }
}

impl Held {
    /// Distance between the mean points of both halves [m]; infinite if one is empty.
    fn shift(&self) -> f64 {
        let [(early, n_early), (late, n_late)] = self.halves;
        let mean = |sums: [i64; 3], count: i64, axis: usize| sums[axis] as f64 / count as f64;
        let square: f64 = (0..3)
            .map(|axis| (mean(late, n_late, axis) - mean(early, n_early, axis)).powi(2))
            .sum();
        if square.is_finite() { square.sqrt() / UNITS_PER_METRE } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;

    #[test]
    fn what_moves_through_a_voxel_does_not_stand() -> Result<(), Error> {
        let lattice = Lattice::new(0.25, [0.0; 3])?;
        let mut standing = Standing::default();
        for scan in 1..=10 {
            let along = 0.02 * scan as f32;
            let rare = if scan % 3 == 0 { 2.1 } else { 9.0 + scan as f32 };
            standing.add(
                &lattice,
                &[[0.1, 0.1, 0.1], [along, 1.1, 0.1], [rare, 0.1, 0.1]],
                scan,
                10,
            );
        }
        assert_eq!(standing.voxels(6, 0.04), [[0, 0, 0]]);
        assert_eq!(standing.voxels(3, 0.04), [[0, 0, 0], [8, 0, 0]]);
        assert_eq!(standing.voxels(6, 0.25), [[0, 0, 0], [0, 4, 0]]);
        Ok(())
    }
}
