"""The update of the map under an uncertain pose, one voxel at a time: eqs 41-46 in eqs 9-22."""

from itertools import product

import numpy as np
from scipy.stats import norm

from reference.analysis import jacobian, rotation
from reference.voxel_map import BACKGROUND, STRONGEST_FIRST, VoxelMap

REACH, LEAST_SHARE, POINT_UNITS = 2, 0.02, 1024


class UncertainMap(VoxelMap):
    """A map whose frame is the world's, shifted to the first position of the sensor."""

    def __init__(self, config, pose, noisy, covariance, range_std):
        super().__init__(config)
        self.pose, self.noisy = pose, np.asarray(noisy, float)
        self.covariance, self.range_std = covariance, range_std

    def ray_end(self, origin, point):
        span = point - origin
        distance = float(np.linalg.norm(span))
        along = span / distance
        variance = along @ self.covariance[:3, :3] @ along + self.range_std**2
        margin = self.config.end_margin + self.pose.end_sigmas * float(np.sqrt(variance))
        reach = min(max(distance - margin, 0.0), self.config.max_range)
        return point if reach >= distance else origin + (reach / distance) * span

    def shares(self, voxel):
        """Shares of the voxels that a point in the middle of `voxel` may lie in."""
        place = (np.array(voxel) + 0.5) * self.config.voxel_size  # the sensor is at 0
        in_lidar = rotation(*self.noisy[3:]).T @ place
        distance = float(np.linalg.norm(in_lidar))
        j = jacobian(np.array([0, 0, 0, *self.noisy[3:], distance]), in_lidar / distance)
        whole = np.zeros((7, 7))
        whole[:6, :6], whole[6, 6] = self.covariance, self.range_std**2
        std = np.sqrt(np.diag(j @ whole @ j.T))
        walls = (np.arange(-REACH, REACH + 2) - 0.5) * self.config.voxel_size
        axes = [np.diff(norm.cdf(walls / one)) for one in std]
        steps = range(-REACH, REACH + 1)
        for step in product(steps, steps, steps):
            share = float(np.prod([axes[a][step[a] + REACH] for a in range(3)]))
            if share >= LEAST_SHARE or step == (0, 0, 0):
                yield tuple(np.add(voxel, step).tolist()), share

    def _update(self, contents, units):
        if self.pose.weighting != "spread":
            super()._update(contents, units)
            return
        weights = {}
        for voxel, found in contents.items():
            strongest = next(kind for kind in STRONGEST_FIRST if kind in found)
            if strongest != BACKGROUND:
                continue
            for other, share in self.shares(voxel):
                if BACKGROUND in contents.get(other, [BACKGROUND]):
                    more = max(1, round(found.count(BACKGROUND) * share * POINT_UNITS))
                    weights[other] = weights.get(other, 0) + more
        others = {voxel: found for voxel, found in contents.items() if BACKGROUND not in found}
        rays = {voxel: length for voxel, length in units.items() if voxel not in weights}
        super()._update(others, rays)
        for voxel, weight in weights.items():
            self.pull(voxel, self.config.g_occ, weight / POINT_UNITS)
