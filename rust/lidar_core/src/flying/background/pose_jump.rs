//! Jumps of the pose (relocalisation, GNSS step). A scan after a jump is held: it is not used until
//! the caller decides.

use crate::flying::classify::occupied_nearby::{OccupiedNearby, is_observed_free};
use crate::flying::map::blocks::Cursor;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::reporting_gate::ReportingGate;
use crate::geometry::lattice::{Voxel, floor, wide};
use crate::geometry::transform::Transform;
use serde::{Deserialize, Serialize};

/// Largest number of returns that are compared with the map.
const SAMPLES: usize = 2048;
/// Number of observed voxels with returns that is enough for a decision. One target has far fewer.
const ENOUGH: usize = 200;

/// A scan that contradicts the map, so that it was not used.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct HeldScan {
    pub(crate) sensor: String,
    pub(crate) world_from_lidar: Transform,
}

/// Comparison of a scan with the map before anything of the scan is used.
#[derive(Clone, Default)]
pub(crate) struct PoseCheck {
    /// The last scan, if it was held. None if it was used.
    pub(crate) held: Option<HeldScan>,
    /// Voxels that contain returns, with one return of each [m].
    sampled: Vec<(Voxel, [f64; 3])>,
}

impl PoseCheck {
    /// The gate `PoseMismatch` if the scan contradicts the map: more than the share `limit` of the
    /// observed voxels with returns is free, and further than `close_distance` [m] from any
    /// occupied voxel. Voxels are counted instead of returns, because a near target may give most
    /// returns. None if the scan fits, without a limit, or while there is no background.
    pub(crate) fn check(
        &mut self,
        points: &[[f32; 3]],
        map: &VoxelMap,
        limit: Option<f64>,
        close_distance: f64,
    ) -> Option<ReportingGate> {
        let limit = limit.filter(|_| map.has_background())?;
        let returns = || points.iter().filter(|point| point[0].is_finite());
        let step = (returns().count() / SAMPLES).max(1);
        let place = |point| Some((floor(map.lattice().scaled(point))?, point));
        let sampled = &mut self.sampled;
        sampled.clear();
        sampled.extend(returns().step_by(step).filter_map(|&point| place(wide(point))));
        sampled.sort_unstable_by_key(|&(voxel, point)| (voxel, point.map(f64::to_bits)));
        sampled.dedup_by_key(|(voxel, _)| *voxel);
        let mut cursor = Cursor::new(&map.blocks);
        sampled.retain(|&(voxel, _)| !cursor.stored(voxel).is_nan());
        let mut near = OccupiedNearby::new(map, close_distance);
        let free = |&&(voxel, point): &&(Voxel, [f64; 3])| {
            is_observed_free(map, &mut cursor, voxel) && !near.is_close(point)
        };
        let (observed, free) = (sampled.len(), sampled.iter().filter(free).count());
        let contradicts = observed >= ENOUGH && free as f64 > limit * observed as f64;
        contradicts
            .then(|| ReportingGate::PoseMismatch { per_mille: (1000 * free / observed) as u32 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::flying::integrate::classified_scan::{ClassifiedScan, Origins};
    use crate::flying::integrate::integrator::Integrator;
    use crate::flying::map::parameters::{MapParameters, Separation};
    use crate::flying::point_class::PointClass;

    /// Returns of a wall at `x` [m], across the x axis.
    fn wall(x: f32) -> Vec<[f32; 3]> {
        let along = |index: u16| f32::from(index) * 0.25 - 4.0;
        (0..1024).map(|index| [x, along(index % 32), along(index / 32)]).collect()
    }

    #[test]
    fn a_wall_in_free_space_contradicts_the_map_and_the_same_wall_does_not() -> Result<(), Error> {
        let mut map = VoxelMap::new(MapParameters::default())?;
        let (mut check, mut integrator) = (PoseCheck::default(), Integrator::new(1)?);
        let seen = wall(10.1);
        assert_eq!(check.check(&seen, &map, Some(0.5), 0.8), None); // no background yet
        for _ in 0..30 {
            let scan = ClassifiedScan {
                points: &seen,
                class: &[PointClass::Background; 1024],
                origins: Origins::One([0.1; 3]),
                directions: None,
                no_return: None,
                no_ray: None,
                reach: None,
                pose_error: None,
            };
            integrator.integrate(&mut map, &scan)?;
        }
        map.remove_separate(Separation::default())?;
        assert_eq!(check.check(&seen, &map, Some(0.5), 0.8), None);
        let jumped = check.check(&wall(6.1), &map, Some(0.5), 0.8);
        assert!(
            matches!(jumped, Some(ReportingGate::PoseMismatch { per_mille: 501.. })),
            "{jumped:?}"
        );
        assert_eq!(check.check(&wall(6.1), &map, None, 0.8), None);
        Ok(())
    }
}
