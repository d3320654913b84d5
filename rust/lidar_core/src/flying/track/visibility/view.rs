//! Visibility of targets in a plain cloud without information about single rays.

use super::occupancy::Visibility;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{dot, minus, norm};

/// Largest radius around a track's position in which rays are counted [m].
const LOOK_RADIUS: f64 = 0.5;

/// A cloud and the position of the sensor. A target position is hidden if most returns in its
/// direction are nearer. Without any return in its direction it is visible: a target there would
/// have given returns.
#[derive(Clone, Copy, Debug)]
pub struct CloudView<'a> {
    /// Measured points of the cloud [m], in the frame of `origin`.
    pub points: &'a [[f32; 3]],
    /// Start point of all rays: position of the sensor [m].
    pub origin: [f64; 3],
}

impl Visibility for CloudView<'_> {
    fn rays(&self, position: [f64; 3], radius: f64, most: usize) -> usize {
        let radius = radius.min(LOOK_RADIUS);
        let target = minus(position, self.origin);
        let distance = norm(target);
        let (mut nearer, mut farther) = (0_usize, 0_usize);
        for point in self.points {
            let ray = minus(wide(*point), self.origin);
            let (length, along) = (norm(ray), dot(ray, target));
            // distance of the target from the line of the ray, against the radius
            let aside = dot(target, target) * length * length - along * along;
            if along > 0.0 && aside <= radius * radius * length * length {
                if length < distance - radius {
                    nearer += 1;
                } else {
                    farther += 1;
                }
            }
        }
        if nearer <= farther { most } else { 0 } // the rays that met nothing are not known
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_in_front_hides_and_one_behind_does_not() {
        let wall: Vec<[f32; 3]> = (-10..10).map(|step| [5.0, 0.02 * step as f32, 0.0]).collect();
        let view = CloudView { points: &wall, origin: [0.0; 3] };
        assert!(!view.expected([10.0, 0.0, 0.0], 1.5));
        assert!(view.expected([3.0, 0.0, 0.0], 1.5));
        assert!(view.expected([10.0, 8.0, 0.0], 1.5));
        assert!(view.expected([-10.0, 0.0, 0.0], 1.5));
        assert!(CloudView { points: &[], origin: [0.0; 3] }.expected([1.0; 3], 1.5));
    }
}
