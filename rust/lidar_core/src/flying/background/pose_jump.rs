//! Jumps of the pose (relocalisation, GNSS step): the scan is held until the caller decides.

use super::burn_in::Gate;
use crate::flying::classify::occupied_nearby::{Near, is_observed_free};
use crate::flying::detector::FlyingObjectDetector;
use crate::flying::map::blocks::Cursor;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::{Voxel, floor, wide};
use crate::geometry::transform::Transform;

/// Returns that are looked at.
const SAMPLES: usize = 2048;
/// Observed voxels with returns that are enough to judge by: one target has far fewer.
const ENOUGH: usize = 200;

/// A scan that contradicts the map.
pub(crate) struct Held {
    pub(crate) sensor: String,
    pub(crate) world_from_lidar: Transform,
}

impl FlyingObjectDetector {
    /// A closed gate if most observed voxels with returns are free, away from anything occupied.
    /// Voxels count, not returns: a target close by may give most of them. `sampled` is memory.
    pub(crate) fn contradiction(
        &self,
        scan: &Prepared,
        sampled: &mut Vec<(Voxel, [f64; 3])>,
    ) -> Option<Gate> {
        let limit = self.parameters.mismatch_share.filter(|_| self.map.has_background())?;
        let returns = || scan.points.iter().filter(|point| point[0].is_finite());
        let step = (returns().count() / SAMPLES).max(1);
        let place = |point| Some((floor(self.map.lattice().scaled(point))?, point));
        sampled.clear();
        sampled.extend(returns().step_by(step).filter_map(|&point| place(wide(point))));
        sampled.sort_unstable_by_key(|&(voxel, point)| (voxel, point.map(f64::to_bits)));
        sampled.dedup_by_key(|(voxel, _)| *voxel);
        let mut cursor = Cursor::new(&self.map.blocks);
        sampled.retain(|&(voxel, _)| !cursor.stored(voxel).is_nan());
        let mut near = Near::new(&self.map, self.parameters.classify.close_distance);
        let free = |&&(voxel, point): &&(Voxel, [f64; 3])| {
            is_observed_free(&self.map, &mut cursor, voxel) && !near.is_close(point)
        };
        let (observed, free) = (sampled.len(), sampled.iter().filter(free).count());
        let contradicts = observed >= ENOUGH && free as f64 > limit * observed as f64;
        contradicts.then(|| Gate::PoseMismatch { per_mille: (1000 * free / observed) as u32 })
    }

    /// After a jump of the pose: shift the world so that the scan held last lies where the last
    /// scan of the same sensor before it was. False if no scan is held, or there was none before.
    pub fn reanchor(&mut self) -> bool {
        let Some(held) = self.held.take() else { return false };
        let last = self.sensors.get(&held.sensor).and_then(|sensor| sensor.last_pose);
        let Some(last) = last else { return false };
        self.map_from_world = last.after(&held.world_from_lidar.inverse());
        true
    }
}
