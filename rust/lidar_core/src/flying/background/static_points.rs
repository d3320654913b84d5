//! Points that stand still during the burn-in: background, however small.

use super::burn_in::BurnIn;
use super::parameters::SeedParameters;
use crate::flying::map::blocks::Place;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::reporting_gate::ReportingGate;
use crate::flying::track::PointCloudTracker;
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};
use crate::geometry::transform::{minus, norm};
use crate::util::key_hasher::KeyHasher;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Coordinates are summed up as integers, so that the order of the points cannot matter.
const UNITS_PER_METRE: f64 = 65_536.0;

/// Stage that finds what stands still during the burn-in: the points of every voxel so far.
#[derive(Clone, Default)]
pub(crate) struct StaticPoints {
    voxels: HashMap<Place, PointsOfVoxel, BuildHasherDefault<KeyHasher>>,
}

/// Points in one voxel.
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct PointsOfVoxel {
    scans: u32,
    last_scan: u32,
    /// Sums of coordinates and numbers of points in both halves.
    halves: [([i64; 3], i64); 2],
}

impl StaticPoints {
    /// Take a scan of the burn-in; after its last one, what stood still all the time becomes
    /// background in `map`, further than `distance` [m] from tracks that moved: the voxels of it, in
    /// ascending order. Other scans give none, and those after the burn-in change nothing.
    pub(crate) fn take(
        &mut self,
        points: &[[f32; 3]],
        gate: ReportingGate,
        seed: &SeedParameters,
        distance: f64,
        map: &mut VoxelMap,
        tracker: &mut PointCloudTracker,
    ) -> Vec<Voxel> {
        let ReportingGate::BurnIn { scans, of } = gate else { return Vec::new() };
        if seed.standing_scans == 0 {
            return Vec::new();
        }
        let lattice = *map.lattice();
        self.add(&lattice, points, scans, of);
        if scans < of {
            return Vec::new();
        }
        let moving = tracker.moved_by(seed.standing_track_distance);
        let mut standing = self.voxels(BurnIn::standing(seed, of), seed.standing_shift);
        standing.retain(|&voxel| {
            let center = lattice.center(voxel);
            moving.iter().all(|&position| norm(minus(position, center)) > distance)
        });
        map.keep(&standing);
        self.clear();
        tracker.drop_near(map, distance); // tracks of such things, still unseen
        standing
    }

    /// Add the points of scan `scan` (1 is the first) of `of`.
    fn add(&mut self, lattice: &Lattice, points: &[[f32; 3]], scan: u32, of: u32) {
        let half = usize::from(2 * scan > of);
        for &point in points {
            let point = wide(point);
            let Some(voxel) = floor(lattice.scaled(point)) else { continue };
            let of_voxel = self.voxels.entry(Place(voxel)).or_default();
            if of_voxel.last_scan != scan {
                of_voxel.scans += 1;
                of_voxel.last_scan = scan;
            }
            let (sums, count) = &mut of_voxel.halves[half];
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
    fn voxels(&self, scans: u32, shift: f64) -> Vec<Voxel> {
        let stands = |points: &PointsOfVoxel| points.scans >= scans && points.shift() <= shift;
        let mut voxels: Vec<Voxel> = self
            .voxels
            .iter()
            .filter(|(_, points)| stands(points))
            .map(|(place, _)| place.0)
            .collect();
        voxels.sort_unstable();
        voxels
    }

    /// State that goes on to the same bits, in ascending order of voxels.
    pub(crate) fn saved(&self) -> Vec<(Place, PointsOfVoxel)> {
        let mut saved: Vec<_> =
            self.voxels.iter().map(|(&place, &points)| (place, points)).collect();
        saved.sort_unstable_by_key(|(place, _)| *place);
        saved
    }

    /// Points from a saved state.
    pub(crate) fn restored(saved: Vec<(Place, PointsOfVoxel)>) -> Self {
        Self { voxels: saved.into_iter().collect() }
    }

    /// Forget all scans.
    pub(crate) fn clear(&mut self) {
        self.voxels = HashMap::default();
    }
}

impl PointsOfVoxel {
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
        let mut standing = StaticPoints::default();
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
