//! Update of the detector's map by a scan.

use super::analysis::PoseSpread;
use super::classify::classified::Judged;
use super::classify::classifier::Verdict;
use super::classify::flood::distinct;
use super::detector::FlyingObjectDetector;
use super::integrate::classified_scan::{ClassifiedScan, IntegrateStats, Origins};
use super::integrate::integrator::Integrator;
use super::integrate::pose_weights::PoseError;
use super::point_class::{BACKGROUND, FLYING};
use super::scan::prepared::{Prepared, RawScan};
use crate::Error;
use crate::geometry::lattice::{floor, wide};

impl FlyingObjectDetector {
    /// The map after the scan; what flies is judged on it where that is asked for. `cast` is what came
    /// of casting the rays, if that was done before.
    pub(super) fn update_map(
        &mut self,
        raw: &RawScan<'_>,
        scan: &mut Prepared,
        judged: &mut Judged,
        integrator: &mut Integrator,
        cast: Option<Result<(), Error>>,
    ) -> Result<IntegrateStats, Error> {
        match cast {
            Some(outcome) => outcome?,
            None => {
                for ground in self.take_off_ground(scan).into_iter().flatten() {
                    scan.append_known(ground);
                    judged.class.push(BACKGROUND);
                }
                self.cast(raw, scan, integrator)?;
            }
        }
        let pose_error = self.pose_error(raw, scan);
        let stats = integrator.apply(&mut self.map, &judged.class, pose_error.as_ref())?;
        if self.parameters.classify.after_update {
            self.judge_again(scan, judged)?;
        }
        Ok(stats)
    }

    /// Uncertainty that the pose gives to points of the scan.
    pub(super) fn pose_spread(&self, raw: &RawScan<'_>, scan: &Prepared) -> Option<PoseSpread> {
        let world_from_lidar = self.map_from_world.inverse().after(&scan.pose);
        self.parameters.pose.spread(raw.pose_covariance, world_from_lidar, self.map_from_world)
    }

    /// Uncertainty that the update of the map uses.
    fn pose_error(&self, raw: &RawScan<'_>, scan: &Prepared) -> Option<PoseError> {
        let spread = self.pose_spread(raw, scan);
        self.parameters.pose.error(spread.as_ref(), self.parameters.range_std)
    }

    /// Points on the ground below the first position of the sensor, if its height is known.
    pub(super) fn take_off_ground(&self, scan: &Prepared) -> Option<[[f32; 3]; 2]> {
        let ground = self.parameters.seed.take_off_ground(scan.pose.translation);
        ground.filter(|_| self.scans == 0)
    }

    /// Cast the rays of a scan, whatever its points are.
    pub(super) fn cast(
        &self,
        raw: &RawScan<'_>,
        scan: &Prepared,
        integrator: &mut Integrator,
    ) -> Result<(), Error> {
        let pose_error = self.pose_error(raw, scan);
        let one = Origins::One(scan.pose.translation);
        let classified = ClassifiedScan {
            points: &scan.points,
            class: &scan.unknown, // not known yet
            origins: scan.origins.as_deref().map_or(one, Origins::Each),
            directions: scan.directions.as_deref(),
            no_return: scan.directions.is_some().then_some(&scan.no_return),
            no_ray: scan.no_ray.as_deref(),
            reach: scan.reach.as_deref(),
            pose_error: pose_error.as_ref(),
        };
        integrator.cast(&self.map, &classified)
    }

    /// Enclosed uncertain voxels around flying objects become free, unless they hold points.
    pub(super) fn fill_pockets(&mut self, verdicts: &[Verdict], scan: &Prepared) {
        if !self.parameters.classify.fill_pockets {
            return;
        }
        let lattice = *self.map.lattice();
        let place = |&point: &[f32; 3]| floor(lattice.scaled(wide(point)));
        let held = distinct(scan.points.iter().filter_map(place).collect());
        let below = self.map.uncertain_from().next_down();
        let flying = verdicts.iter().filter(|verdict| verdict.class == FLYING);
        for &voxel in flying.flat_map(|verdict| &verdict.explored) {
            if held.binary_search(&voxel).is_err() {
                self.map.rewrite(voxel, |value| value.min(below)); // NaN: never observed
            }
        }
    }
}
