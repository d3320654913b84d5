//! The shadow that a cluster casts, seen from the sensor: what no ray can observe now.

use crate::geometry::lattice::{Lattice, Voxel};
use crate::geometry::transform::{dot, minus, norm};

/// Points of one cluster as rays from the sensor.
///
/// A target that is approached head-on hides the same voxels in every scan: some were never
/// observed, others it flew through itself, and no ray clears them. Algorithm 1 as published
/// walks through them and never detects it. In best mode such voxels do not connect.
pub(crate) struct Shadow<'a> {
    origin: [f64; 3],
    lattice: Lattice,
    points: &'a [[f64; 3]],
    /// A voxel is hidden if the ray to its centre passes a point this closely [m].
    margin: f64,
}

impl<'a> Shadow<'a> {
    pub(crate) fn of(points: &'a [[f64; 3]], origin: [f64; 3], lattice: &Lattice) -> Self {
        let half_diagonal = 0.5 * 3f64.sqrt() * lattice.voxel_size();
        Self { origin, lattice: *lattice, points, margin: half_diagonal }
    }

    /// True if `voxel` lies behind the cluster: at least one voxel further away than a point
    /// that its centre's ray passes closely.
    pub(crate) fn hides(&self, voxel: Voxel) -> bool {
        let center = minus(self.lattice.center(voxel), self.origin);
        let distance = norm(center);
        if distance == 0.0 {
            return false;
        }
        let direction = center.map(|value| value / distance);
        self.points.iter().any(|&point| {
            let point = minus(point, self.origin);
            let along = dot(point, direction);
            let aside = minus(point, direction.map(|value| value * along));
            along > 0.0
                && distance - along > self.lattice.voxel_size()
                && dot(aside, aside) <= self.margin * self.margin
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;

    #[test]
    fn only_what_lies_behind_is_hidden() -> Result<(), Error> {
        let lattice = Lattice::new(0.25, [0.0; 3])?;
        let shadow = Shadow::of(&[[5.1, 0.1, 0.1]], [0.1; 3], &lattice);
        assert!(shadow.hides([22, 0, 0])); // 0.525 m behind the point
        assert!(shadow.hides([60, 0, 0]));
        assert!(!shadow.hides([20, 0, 0])); // the point's own voxel
        assert!(!shadow.hides([10, 0, 0])); // in front
        assert!(!shadow.hides([22, 2, 0])); // beside
        assert!(!shadow.hides([-20, 0, 0])); // on the other side of the sensor
        Ok(())
    }
}
