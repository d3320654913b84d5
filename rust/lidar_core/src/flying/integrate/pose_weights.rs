//! Update of the map under an uncertain pose: which voxels rays must not clear, and which voxels
//! background points may be in.
//!
//! The true position of a point may be nearer or farther than the measured one, so its ray ends earlier. A background
//! point may be in the measured voxel or in a voxel near it: the share of each voxel is the probability that the point
//! is in it (Vrba et al., eqs 41-46). Shares are computed along each axis of the map, for a point in the middle of its
//! voxel, so that all points of a voxel have the same shares.

use super::accumulate::accumulator::Accumulator;
use super::accumulate::mark::{Content, POINT_UNITS};
use crate::flying::analysis::{PoseSpread, pose_jacobian};
use crate::flying::map::voxel_map::VoxelMap;
use crate::geometry::lattice::{Lattice, Voxel};
use crate::geometry::transform::{Transform, dot, minus, norm};

/// Largest distance of a point from its own voxel, along each axis [voxels].
const REACH: i32 = 2;
/// Smaller shares are set to 0.
const LEAST_SHARE: f64 = 0.02;

/// How the update of the map uses the uncertainty of the pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseWeighting {
    /// Rays with a return end earlier, so that they do not clear voxels in which their ends may be.
    Ends,
    /// Rays with a return end earlier. In addition, a background point updates every voxel in which
    /// it may be, each with its share.
    Spread,
}

/// Uncertainty of the points of a scan, from the pose and the range.
#[derive(Clone, Copy, Debug)]
pub struct PoseError {
    /// How the update of the map uses the uncertainty.
    pub weighting: PoseWeighting,
    /// Pose of the sensor in the world.
    pub world_from_lidar: Transform,
    /// Transform from the world to the frame of the map.
    pub map_from_world: Transform,
    /// Covariance of the pose: translation [m], then the angles about x, y, z [rad] (eq. 38).
    pub covariance: [[f64; 6]; 6],
    /// Standard deviation of a range [m].
    pub range_std: f64,
    /// Number of standard deviations by which rays with a return end earlier.
    pub end_sigmas: f64,
}

/// Shares, along one axis, of the voxels from `-REACH` to `REACH` around a point's own voxel.
type Shares = [f64; 2 * REACH as usize + 1];

impl PoseError {
    /// True if a point updates every voxel in which it may be, by its share.
    pub(crate) fn weighs_points(&self) -> bool {
        self.weighting == PoseWeighting::Spread
    }

    /// Variance of a point at `point` (frame of the map) along every axis of the map [m^2].
    fn variance(&self, point: [f64; 3]) -> [f64; 3] {
        let world_from_map = self.map_from_world.inverse();
        let jacobian = pose_jacobian(&self.world_from_lidar, world_from_map.apply(point));
        let sight = minus(point, self.map_from_world.apply(self.world_from_lidar.translation));
        // A point in the sensor itself then gives 0 and not NaN.
        let range = norm(sight).max(f64::MIN_POSITIVE);
        std::array::from_fn(|axis| {
            let row: [f64; 6] = std::array::from_fn(|column| {
                let derivative = [0, 1, 2].map(|world: usize| jacobian[world][column]);
                dot(self.map_from_world.rotation[axis], derivative)
            });
            let along = self.range_std * sight[axis] / range;
            let of_pose: f64 = (0..6)
                .map(|i| row[i] * (0..6).map(|j| self.covariance[i][j] * row[j]).sum::<f64>())
                .sum();
            // Rounding may leave a covariance slightly indefinite.
            of_pose.max(0.0) + along * along
        })
    }

    /// Add the lengths by which rays along `spans` (by axis, frame of the map) end earlier because of the uncertainty
    /// to their `margins` [m]. Margins that are not finite stay as they are: these rays have no measured end.
    #[inline(always)]
    pub(crate) fn add_to_margins<const N: usize>(
        &self,
        spans: &[[f64; N]; 3],
        margins: &mut [f64; N],
    ) {
        let world_from_map = self.map_from_world.inverse();
        for lane in 0..N {
            let span = [0, 1, 2].map(|axis: usize| spans[axis][lane]);
            // The angles move its end across, not along.
            let along = world_from_map.rotate(span);
            let length = norm(span).max(f64::MIN_POSITIVE);
            let of_position: f64 = (0..3)
                .map(|i| along[i] * (0..3).map(|j| self.covariance[i][j] * along[j]).sum::<f64>())
                .sum::<f64>()
                / (length * length);
            let variance = of_position.max(0.0) + self.range_std * self.range_std;
            let margin = margins[lane] + self.end_sigmas * variance.sqrt();
            margins[lane] = if margins[lane].is_finite() { margin } else { margins[lane] };
        }
    }

    /// Per axis: the share of a point's weight that each voxel near `voxel` gets because of the
    /// pose error, for a point in the middle of `voxel`.
    fn shares(&self, lattice: &Lattice, voxel: Voxel) -> [Shares; 3] {
        self.variance(lattice.center(voxel)).map(|variance| {
            let scale = lattice.voxel_size() / (2.0 * variance).sqrt();
            // Half of what lies beyond the walls at 1/2, 3/2 and so on.
            // `erfc` keeps the relative precision of small tails. Without variance the scale is infinite:
            // all tails are 0, and the voxel of the point has the whole share.
            let beyond = |wall: i32| 0.5 * libm::erfc((f64::from(wall) - 0.5) * scale);
            std::array::from_fn(|index| match (index as i32 - REACH).abs() {
                0 => 1.0 - 2.0 * beyond(1),
                away => beyond(away) - beyond(away + 1),
            })
        })
    }
}

/// Mark the points of a scan, each given with its voxel. The rays must have been marked before.
pub(super) fn mark_points(
    map: &VoxelMap,
    accumulator: &mut Accumulator,
    points: impl Iterator<Item = (Voxel, Content)>,
    error: Option<&PoseError>,
) {
    let points = points.filter(|&(voxel, _)| map.admits(voxel));
    let Some(error) = error.filter(|error| error.weighs_points()) else {
        return accumulator.mark_all(points);
    };
    let (background, others): (Vec<_>, Vec<_>) =
        points.partition(|(_, class)| *class == Content::Background);
    // Before the background, since `mark_beside` leaves voxels with other points alone.
    for (voxel, class) in others {
        accumulator.mark_points(voxel, class, POINT_UNITS);
    }
    let background = background.into_iter().map(|(voxel, _)| voxel).collect();
    mark_shares(map, accumulator, error, background);
}

/// Mark background points, given by their voxels, in all voxels in which they may be. The share of a voxel is the
/// weight of the point there. Voxels that contain other points keep the marks of these points.
fn mark_shares(
    map: &VoxelMap,
    accumulator: &mut Accumulator,
    error: &PoseError,
    mut points: Vec<Voxel>,
) {
    // Points of one voxel are counted together, so their shares are rounded once, whatever their order.
    points.sort_unstable();
    for same in points.chunk_by(|a, b| a == b) {
        let shares = error.shares(map.lattice(), same[0]);
        let units = |share: f64| {
            (same.len() as f64 * share * f64::from(POINT_UNITS)).round().max(1.0) as u32
        };
        for (step, share) in steps(&shares) {
            let voxel: Voxel = std::array::from_fn(|axis| same[0][axis] + step[axis]);
            if step == [0; 3] {
                accumulator.mark_points(voxel, Content::Background, units(share));
            } else if map.admits(voxel) {
                accumulator.mark_beside(voxel, units(share));
            }
        }
    }
}

/// Offsets from a point's voxel to the voxels in which it may be, with their shares. Offset 0 is
/// always among them.
fn steps([x, y, z]: &[Shares; 3]) -> impl Iterator<Item = ([i32; 3], f64)> {
    let step = |index: usize| index as i32 - REACH;
    let planes = z
        .iter()
        .enumerate()
        .flat_map(move |(k, z)| y.iter().enumerate().map(move |(j, y)| (j, k, y * z)));
    let own = REACH as usize;
    planes
        // Shares are at most 1: below the least share here, no factor along x can lift it.
        .filter(move |&(j, k, share)| share >= LEAST_SHARE || (j, k) == (own, own))
        .flat_map(move |(j, k, share)| {
            x.iter().enumerate().map(move |(i, x)| ([step(i), step(j), step(k)], x * share))
        })
        .filter(|&(step, share)| share >= LEAST_SHARE || step == [0; 3])
}

/// Standard deviations of poses without a covariance, and how the map uses the uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseParameters {
    /// Standard deviations of the translation [m], for scans that come without a covariance.
    pub position_std: [f64; 3],
    /// Standard deviations of the angles about x, y, z [rad], for scans that come without a covariance.
    pub angle_std: [f64; 3],
    /// How the update of the map uses the uncertainty. None: the update ignores the uncertainty.
    pub weighting: Option<PoseWeighting>,
    /// Number of standard deviations by which rays with a return end earlier, if `weighting` is
    /// set.
    pub end_sigmas: f64,
}

/// Poses without a covariance count as certain. With a covariance, rays end earlier.
impl Default for PoseParameters {
    fn default() -> Self {
        Self {
            position_std: [0.0; 3],
            angle_std: [0.0; 3],
            weighting: Some(PoseWeighting::Ends),
            end_sigmas: 3.0,
        }
    }
}

impl PoseParameters {
    /// Parameters for a map update that treats all poses as certain, as in the paper.
    #[must_use]
    pub fn paper() -> Self {
        Self { weighting: None, ..Self::default() }
    }
}

/// Uncertainty that the points of a scan have because of its pose.
pub(crate) struct PoseNoise {
    /// Errors of the pose, for detections and tracks. None if they are unknown.
    pub(crate) spread: Option<PoseSpread>,
    /// Errors of the pose, for the update of the map. None if the map ignores them.
    pub(crate) error: Option<PoseError>,
}

impl PoseParameters {
    /// Uncertainty of the points because of the pose: from the scan's covariance, or else from the
    /// standard deviations of the parameters. `range_std` [m].
    pub(crate) fn noise(
        &self,
        covariance: Option<[[f64; 6]; 6]>,
        map_from_lidar: &Transform,
        map_from_world: Transform,
        range_std: f64,
    ) -> PoseNoise {
        let world_from_lidar = map_from_world.inverse().after(map_from_lidar);
        let spread = self.spread(covariance, world_from_lidar, map_from_world);
        PoseNoise { error: self.error(spread.as_ref(), range_std), spread }
    }

    /// Errors of the pose: from the scan's covariance, or else from the standard deviations of the
    /// parameters. None if neither is known.
    fn spread(
        &self,
        covariance: Option<[[f64; 6]; 6]>,
        world_from_lidar: Transform,
        map_from_world: Transform,
    ) -> Option<PoseSpread> {
        let ([x, y, z], [a, b, c]) = (self.position_std, self.angle_std);
        let std = [x, y, z, a, b, c];
        let diagonal = |i: usize, j: usize| if i == j { std[i] * std[i] } else { 0.0 };
        let constant = || std::array::from_fn(|i| std::array::from_fn(|j| diagonal(i, j)));
        let is_known = std.iter().any(|&std| std > 0.0);
        let covariance = covariance.or_else(|| is_known.then(constant))?;
        Some(PoseSpread { world_from_lidar, map_from_world, covariance })
    }

    /// Errors that the update of the map uses. None if the update ignores them, or if `spread` is unknown.
    fn error(&self, spread: Option<&PoseSpread>, range_std: f64) -> Option<PoseError> {
        let &PoseSpread { world_from_lidar, map_from_world, covariance } = spread?;
        Some(PoseError {
            weighting: self.weighting?,
            world_from_lidar,
            map_from_world,
            covariance,
            range_std,
            end_sigmas: self.end_sigmas,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;

    fn error(position_std: f64, angle_std: f64) -> PoseError {
        let std = [position_std, position_std, position_std, angle_std, angle_std, angle_std];
        PoseError {
            weighting: PoseWeighting::Spread,
            world_from_lidar: Transform::IDENTITY,
            map_from_world: Transform::IDENTITY,
            covariance: std::array::from_fn(|i| {
                std::array::from_fn(|j| if i == j { std[i] * std[i] } else { 0.0 })
            }),
            range_std: 0.04,
            end_sigmas: 2.0,
        }
    }

    #[test]
    fn shares_are_those_of_the_normal_distribution() -> Result<(), Error> {
        let lattice = Lattice::new(0.25, [-0.125; 3])?;
        // 10 m ahead: 0.1 m along x with the range, 0.2 m and turned by 0.01 rad across.
        let [x, y, _] = error(0.03, 0.012).shares(&lattice, [40, 0, 0]);
        assert!((x[2] - 0.987_580_669_348_448).abs() < 1e-12); // +- 2.5 sigma of 0.05 m
        let sigma = (0.03f64 * 0.03 + 0.12 * 0.12).sqrt();
        let inside = libm::erf(0.125 / sigma / 2f64.sqrt());
        assert!((y[2] - inside).abs() < 1e-12);
        assert!((y[1] - y[3]).abs() < 1e-15 && (y.iter().sum::<f64>() - 1.0).abs() < 1e-5);
        Ok(())
    }

    #[test]
    fn the_own_voxel_has_its_share_however_small() {
        let thin = [0.001, 0.2, 0.598, 0.2, 0.001];
        let all: Vec<_> = steps(&[thin; 3]).collect();
        assert!(all.iter().all(|&(_, share)| share >= LEAST_SHARE));
        assert_eq!(all.len(), 19); // own, 6 faces, 12 edges; corners have 0.008
        let none = [0.01; 5];
        assert_eq!(steps(&[none; 3]).map(|(step, _)| step).collect::<Vec<_>>(), [[0; 3]]);
    }

    #[test]
    fn rays_end_earlier_by_position_and_range_not_by_angles() {
        let margin = |angle_std| {
            let mut margins = [0.0, 1.0, f64::NEG_INFINITY];
            error(0.03, angle_std).add_to_margins(&[[3.0; 3], [4.0; 3], [0.0; 3]], &mut margins);
            assert_eq!(margins[1..], [1.0 + margins[0], f64::NEG_INFINITY]);
            margins[0]
        };
        assert!((margin(0.0) - 0.1).abs() < 1e-12);
        assert_eq!(margin(0.0), margin(0.5));
    }
}
