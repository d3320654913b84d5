//! Shadow of a cluster as seen from the sensor: voxels behind it that no ray can observe now.

use crate::geometry::lattice::{Lattice, Voxel};
use crate::geometry::transform::{dot, minus, norm};

/// Shadow of the points of one cluster, as seen from the sensor.
///
/// A target that comes straight towards the sensor hides the same voxels in every scan. Some of
/// them were never observed, and the target itself flew through others. No ray clears them.
/// Algorithm 1 as published walks through these voxels and never detects the target. In best mode
/// they do not connect.
pub(crate) struct Shadow<'a> {
    origin: [f64; 3],
    lattice: Lattice,
    points: &'a [[f64; 3]],
}

impl<'a> Shadow<'a> {
    pub(crate) fn of(points: &'a [[f64; 3]], origin: [f64; 3], lattice: &Lattice) -> Self {
        Self { origin, lattice: *lattice, points }
    }

    /// True if `voxel` is behind the cluster: it is at least one voxel further away than a point
    /// close to the ray to its centre.
    pub(crate) fn hides(&self, voxel: Voxel) -> bool {
        SightLine::to(voxel, self.origin, &self.lattice)
            .is_some_and(|line| self.points.iter().any(|&point| line.is_blocked_by(point)))
    }
}

/// The ray from a sensor to the centre of a voxel.
pub(crate) struct SightLine {
    origin: [f64; 3],
    direction: [f64; 3],
    distance: f64,
    voxel_size: f64,
    /// Distance beside the line within which a point blocks it [m]: half the diagonal of a voxel.
    margin: f64,
}

impl SightLine {
    /// The line from `origin` [m] to the centre of `voxel`. None if `origin` is at the centre.
    pub(crate) fn to(voxel: Voxel, origin: [f64; 3], lattice: &Lattice) -> Option<Self> {
        let (center, voxel_size) = (minus(lattice.center(voxel), origin), lattice.voxel_size());
        let (distance, margin) = (norm(center), 0.5 * 3f64.sqrt() * voxel_size);
        let direction = center.map(|value| value / distance);
        (distance != 0.0).then_some(Self { origin, direction, distance, voxel_size, margin })
    }

    /// True if the voxel is at least one voxel further away than `point`, which is close to the
    /// line.
    pub(crate) fn is_blocked_by(&self, point: [f64; 3]) -> bool {
        let (along, aside) = self.along_and_aside(point);
        along > 0.0 && self.distance - along > self.voxel_size && aside <= self.margin * self.margin
    }

    /// False if no point in the voxel around `center` can block the line.
    pub(crate) fn passes_near(&self, center: [f64; 3]) -> bool {
        // No point of a voxel is further from its centre than half the diagonal; the rest is for rounding.
        let (along, aside) = self.along_and_aside(center);
        along > -1.01 * self.margin
            && self.distance - along > self.voxel_size - 1.01 * self.margin
            && aside <= (2.01 * self.margin) * (2.01 * self.margin)
    }

    /// Distance along the line to the place nearest to a point [m], and the squared distance of the
    /// point from it [m^2].
    fn along_and_aside(&self, point: [f64; 3]) -> (f64, f64) {
        let point = minus(point, self.origin);
        let along = dot(point, self.direction);
        let aside = minus(point, self.direction.map(|value| value * along));
        (along, dot(aside, aside))
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
