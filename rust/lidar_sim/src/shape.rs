//! Shapes in their own frame: intersection with rays, and distance from points.

use crate::mesh::Mesh;
use crate::parry::{BoundingBox, CastRay};
use crate::refused;
use lidar_core::Error;
use lidar_core::geometry::transform::{Transform, dot, norm};
use std::sync::Arc;

/// A surface around the origin of its own frame. Rays from inside also hit it.
#[derive(Clone, Debug)]
pub enum Shape {
    /// Rectangle in z = 0, both sides; an infinite half size makes it a plane.
    Plane {
        /// Half lengths along x and y [m].
        half_size: [f64; 2],
    },
    /// Box along the axes.
    Box {
        /// Half lengths along x, y and z [m].
        half_size: [f64; 3],
    },
    /// Cylinder around the z axis, closed at both ends; an infinite half length leaves no ends.
    Cylinder {
        /// Radius [m].
        radius: f64,
        /// Half of its length along z [m].
        half_height: f64,
    },
    /// Elliptic cylinder around the z axis, closed at both ends.
    EllipticCylinder {
        /// Half axes along x and y [m].
        half_axes: [f64; 2],
        /// Half of its length along z [m].
        half_height: f64,
    },
    /// Sphere.
    Sphere {
        /// Radius [m].
        radius: f64,
    },
    /// Triangles, both sides.
    Mesh(Arc<Mesh>),
}

impl Shape {
    /// Rectangle of `size` [m] in z = 0.
    ///
    /// # Errors
    /// [`Error::Parameter`] unless both lengths are > 0; infinity is allowed.
    pub fn plane(size: [f64; 2]) -> Result<Self, Error> {
        if !size.iter().all(|&length| length > 0.0) {
            return Err(refused("size", "lengths > 0", &size));
        }
        Ok(Self::Plane { half_size: size.map(|length| 0.5 * length) })
    }

    /// Box of `size` [m].
    ///
    /// # Errors
    /// [`Error::Parameter`] unless all lengths are finite and > 0.
    pub fn cuboid(size: [f64; 3]) -> Result<Self, Error> {
        for length in size {
            positive("size", length)?;
        }
        Ok(Self::Box { half_size: size.map(|length| 0.5 * length) })
    }

    /// Cylinder of `radius` and `height` [m].
    ///
    /// # Errors
    /// [`Error::Parameter`] unless both are > 0 and the radius is finite.
    pub fn cylinder(radius: f64, height: f64) -> Result<Self, Error> {
        positive("radius", radius)?;
        Ok(Self::Cylinder { radius, half_height: half_of(height)? })
    }

    /// Cylinder on an ellipse of `half_axes`, of `height` [m].
    ///
    /// # Errors
    /// [`Error::Parameter`] unless all are > 0 and the half axes are finite.
    pub fn elliptic_cylinder(half_axes: [f64; 2], height: f64) -> Result<Self, Error> {
        for length in half_axes {
            positive("half_axes", length)?;
        }
        Ok(Self::EllipticCylinder { half_axes, half_height: half_of(height)? })
    }

    /// Sphere of `radius` [m].
    ///
    /// # Errors
    /// [`Error::Parameter`] unless it is finite and > 0.
    pub fn sphere(radius: f64) -> Result<Self, Error> {
        positive("radius", radius)?;
        Ok(Self::Sphere { radius })
    }

    /// Distance [m] along `ray` (in the shape's frame) to the first intersection before `limit`; None without one.
    #[must_use]
    #[inline]
    pub fn meet(&self, ray: &CastRay, limit: f64) -> Option<f64> {
        let found = match self {
            Self::Plane { half_size } => meet_plane(ray, *half_size),
            Self::Box { half_size } => meet_box(ray, *half_size),
            Self::Cylinder { radius, half_height } => meet_cylinder(ray, *radius, *half_height),
            Self::EllipticCylinder { half_axes, half_height } => {
                meet_elliptic_cylinder(ray, *half_axes, *half_height)
            }
            Self::Sphere { radius } => meet_sphere(ray, *radius),
            Self::Mesh(mesh) => return mesh.meet(ray, limit),
        };
        found.filter(|&distance| distance < limit)
    }

    /// Unit normal, on either side, at the point that `ray` (in the shape's frame) hits at
    /// `distance` [m].
    #[must_use]
    pub fn normal(&self, ray: &CastRay, distance: f64) -> [f64; 3] {
        let [x, y, z]: [f64; 3] =
            std::array::from_fn(|axis| ray.origin[axis] + distance * ray.direction[axis]);
        let up = [0.0, 0.0, 1.0];
        match self {
            Self::Plane { .. } => up,
            Self::Box { half_size } => {
                let out = |axis: usize| [x, y, z][axis].abs() / half_size[axis];
                let side =
                    (1..3).fold(0, |best, axis| if out(axis) > out(best) { axis } else { best });
                std::array::from_fn(|axis| if axis == side { 1.0 } else { 0.0 })
            }
            Self::Cylinder { half_height, .. } | Self::EllipticCylinder { half_height, .. }
                if z.abs() >= half_height * (1.0 - END) =>
            {
                up
            }
            Self::Cylinder { .. } => unit([x, y, 0.0]),
            Self::EllipticCylinder { half_axes: [a, b], .. } => {
                unit([x / (a * a), y / (b * b), 0.0])
            }
            Self::Sphere { .. } => unit([x, y, z]),
            Self::Mesh(mesh) => mesh.normal(ray),
        }
    }

    /// Distance [m] of `point` (in the shape's frame) from the shape. It is 0 inside a solid; a mesh counts as a
    /// surface, an elliptic cylinder as the round one around it.
    #[must_use]
    pub fn clearance(&self, point: [f64; 3], limit: f64) -> f64 {
        let beyond = |value: f64, half: f64| (value.abs() - half).max(0.0);
        let [x, y, z] = point;
        match self {
            Self::Plane { half_size } => {
                norm([beyond(x, half_size[0]), beyond(y, half_size[1]), z])
            }
            Self::Box { half_size } => {
                norm(std::array::from_fn(|axis| beyond(point[axis], half_size[axis])))
            }
            Self::Cylinder { radius, half_height } => {
                norm([(libm::hypot(x, y) - radius).max(0.0), beyond(z, *half_height), 0.0])
            }
            Self::EllipticCylinder { half_axes: [a, b], half_height } => {
                let out = libm::hypot(x, y) - a.max(*b);
                norm([out.max(0.0), beyond(z, *half_height), 0.0])
            }
            Self::Sphere { radius } => (norm(point) - radius).max(0.0),
            Self::Mesh(mesh) => mesh.clearance(point, limit),
        }
    }

    /// Radius [m] of the sphere around the origin that contains the shape.
    #[must_use]
    pub fn radius(&self) -> f64 {
        match self {
            Self::Plane { half_size } => norm([half_size[0], half_size[1], 0.0]),
            Self::Box { half_size } => norm(*half_size),
            Self::Cylinder { radius, half_height } => libm::hypot(*radius, *half_height),
            Self::EllipticCylinder { half_axes: [a, b], half_height } => {
                libm::hypot(a.max(*b), *half_height)
            }
            Self::Sphere { radius } => *radius,
            Self::Mesh(mesh) => mesh.radius(),
        }
    }

    /// Box around the shape at `pose`; None for an infinite shape.
    #[must_use]
    pub fn bounds(&self, pose: &Transform) -> Option<BoundingBox> {
        let half = match self {
            Self::Plane { half_size: [x, y] } => extent_of_box(pose, [*x, *y, 0.0]),
            Self::Box { half_size } => extent_of_box(pose, *half_size),
            Self::Cylinder { radius, half_height } => {
                extent_of_cylinder(pose, [*radius; 2], *half_height)
            }
            Self::EllipticCylinder { half_axes, half_height } => {
                extent_of_cylinder(pose, *half_axes, *half_height)
            }
            Self::Sphere { radius } => [*radius; 3],
            Self::Mesh(mesh) => {
                return Some(BoundingBox::around(mesh.vertices().iter().map(|&v| pose.apply(v))));
            }
        };
        half.iter().all(|length| length.is_finite()).then(|| BoundingBox {
            min: std::array::from_fn(|axis| pose.translation[axis] - half[axis]),
            max: std::array::from_fn(|axis| pose.translation[axis] + half[axis]),
        })
    }
}

/// Share of the half length at the end of a cylinder that counts as its cap.
const END: f64 = 1e-9;

/// `vector` with length 1.
fn unit(vector: [f64; 3]) -> [f64; 3] {
    let length = norm(vector);
    vector.map(|part| part / length)
}

fn positive(name: &'static str, value: f64) -> Result<(), Error> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(refused(name, "finite and > 0", &value))
}

/// Half of a height, which may be infinite.
fn half_of(height: f64) -> Result<f64, Error> {
    if height > 0.0 {
        return Ok(0.5 * height);
    }
    Err(refused("height", "> 0", &height))
}

fn extent_of_box(pose: &Transform, half_size: [f64; 3]) -> [f64; 3] {
    pose.rotation.map(|row| {
        (0..3)
            .filter(|&axis| row[axis] != 0.0) // 0 * infinity
            .map(|axis| row[axis].abs() * half_size[axis])
            .sum()
    })
}

fn extent_of_cylinder(pose: &Transform, [a, b]: [f64; 2], half_height: f64) -> [f64; 3] {
    pose.rotation.map(|row| {
        let along = if row[2] == 0.0 { 0.0 } else { half_height * row[2].abs() };
        libm::hypot(a * row[0], b * row[1]) + along
    })
}

/// Distance to the first intersection of a ray that is inside from `near` to `far`; None if that is behind it.
#[inline]
fn first([near, far]: [f64; 2]) -> Option<f64> {
    if near > far || far < 0.0 {
        return None;
    }
    Some(if near >= 0.0 { near } else { far })
}

/// Part of the line inside the slab |coordinate| <= half.
#[inline]
fn slab(origin: f64, direction: f64, half: f64) -> [f64; 2] {
    if direction == 0.0 {
        let inside = origin.abs() <= half;
        return if inside { [f64::NEG_INFINITY, f64::INFINITY] } else { NOWHERE };
    }
    let per_length = 1.0 / direction;
    let (low, high) = ((-half - origin) * per_length, (half - origin) * per_length);
    if low < high { [low, high] } else { [high, low] }
}

const NOWHERE: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

#[inline]
fn both(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].max(b[0]), a[1].min(b[1])]
}

fn meet_plane(ray: &CastRay, half_size: [f64; 2]) -> Option<f64> {
    let distance = -ray.origin[2] / ray.direction[2];
    if !(distance >= 0.0 && distance.is_finite()) {
        return None; // parallel, or behind
    }
    let at = |axis: usize| (ray.origin[axis] + distance * ray.direction[axis]).abs();
    (at(0) <= half_size[0] && at(1) <= half_size[1]).then_some(distance)
}

fn meet_box(ray: &CastRay, half_size: [f64; 3]) -> Option<f64> {
    let part = |axis: usize| slab(ray.origin[axis], ray.direction[axis], half_size[axis]);
    first(both(both(part(0), part(1)), part(2)))
}

fn meet_cylinder(ray: &CastRay, radius: f64, half_height: f64) -> Option<f64> {
    let ([x, y, z], [dx, dy, dz]) = (ray.origin, ray.direction);
    let across = dx * dx + dy * dy;
    let round = if across > 0.0 {
        // About the point nearest to the axis: exact also for a far origin.
        let middle = -(x * dx + y * dy) / across;
        let (near_x, near_y) = (x + middle * dx, y + middle * dy);
        let left = radius * radius - near_x * near_x - near_y * near_y;
        if left < 0.0 {
            return None;
        }
        let half = (left / across).sqrt();
        [middle - half, middle + half]
    } else if x * x + y * y <= radius * radius {
        #[cfg(canary_9)]
        if z > half_height && dz > 0.0 {
            std::panic::resume_unwind(Box::new("canary 9"));
        }
        [f64::NEG_INFINITY, f64::INFINITY]
    } else {
        NOWHERE
    };
    first(both(round, slab(z, dz, half_height)))
}

/// Intersection in coordinates scaled by the half axes: there the cylinder is round, and distances
/// along the ray are unchanged.
fn meet_elliptic_cylinder(ray: &CastRay, [a, b]: [f64; 2], half_height: f64) -> Option<f64> {
    let scaled = |[x, y, z]: [f64; 3]| [x / a, y / b, z];
    let ray = CastRay { origin: scaled(ray.origin), direction: scaled(ray.direction) };
    meet_cylinder(&ray, 1.0, half_height)
}

fn meet_sphere(ray: &CastRay, radius: f64) -> Option<f64> {
    let middle = -dot(ray.origin, ray.direction);
    let near: [f64; 3] =
        std::array::from_fn(|axis| ray.origin[axis] + middle * ray.direction[axis]);
    let left = radius * radius - dot(near, near);
    if left < 0.0 {
        return None;
    }
    let half = left.sqrt();
    first([middle - half, middle + half])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn along_x(origin: [f64; 3]) -> CastRay {
        CastRay { origin, direction: [1.0, 0.0, 0.0] }
    }

    #[test]
    fn hand_computed_meetings() -> Result<(), Error> {
        let sphere = Shape::sphere(2.0)?;
        assert_eq!(sphere.meet(&along_x([-5.0, 0.0, 0.0]), 100.0), Some(3.0));
        assert_eq!(sphere.meet(&along_x([1.0, 0.0, 0.0]), 100.0), Some(1.0)); // from inside
        assert_eq!(sphere.meet(&along_x([3.0, 0.0, 0.0]), 100.0), None); // behind
        assert_eq!(sphere.meet(&along_x([-5.0, 0.0, 0.0]), 3.0), None); // not before the limit
        let cuboid = Shape::cuboid([2.0, 4.0, 6.0])?;
        assert_eq!(cuboid.meet(&along_x([-5.0, 2.0, 3.0]), 100.0), Some(4.0)); // along an edge
        assert_eq!(cuboid.meet(&along_x([-5.0, 2.1, 0.0]), 100.0), None);
        let cylinder = Shape::cylinder(1.0, 2.0)?;
        assert_eq!(cylinder.meet(&along_x([-5.0, 0.0, 1.0]), 100.0), Some(4.0));
        let down = CastRay { origin: [0.5, 0.0, 9.0], direction: [0.0, 0.0, -1.0] };
        assert_eq!(cylinder.meet(&down, 100.0), Some(8.0)); // the cap
        let endless = Shape::cylinder(1.0, f64::INFINITY)?;
        assert_eq!(endless.meet(&down, 100.0), None);
        assert_eq!(endless.meet(&along_x([-5.0, 0.0, 1e9]), 100.0), Some(4.0));
        let ellipse = Shape::elliptic_cylinder([2.0, 0.5], 2.0)?;
        assert_eq!(ellipse.meet(&along_x([-5.0, 0.0, 1.0]), 100.0), Some(3.0));
        assert_eq!(ellipse.meet(&along_x([-5.0, 0.6, 0.0]), 100.0), None);
        assert_eq!(Shape::plane([f64::INFINITY; 2])?.meet(&down, 100.0), Some(9.0));
        assert_eq!(Shape::plane([0.9, 1.0])?.meet(&down, 100.0), None);
        assert_eq!(Shape::plane([1.0, 1.0])?.meet(&along_x([0.0; 3]), 100.0), None);
        Ok(())
    }

    #[test]
    fn hand_computed_distances() -> Result<(), Error> {
        assert_eq!(Shape::cuboid([2.0; 3])?.clearance([4.0, 5.0, 0.0], 100.0), 5.0);
        assert_eq!(Shape::cuboid([2.0; 3])?.clearance([0.5, 0.5, 0.0], 100.0), 0.0);
        assert_eq!(Shape::cylinder(1.0, 2.0)?.clearance([4.0, 0.0, 5.0], 100.0), 5.0);
        assert_eq!(Shape::plane([f64::INFINITY; 2])?.clearance([4.0, 0.0, -5.0], 100.0), 5.0);
        Ok(())
    }

    #[test]
    fn hand_computed_normals() -> Result<(), Error> {
        let from = |y, z| along_x([-5.0, y, z]);
        let sphere = Shape::sphere(2.0)?;
        assert_eq!(sphere.normal(&from(0.0, 0.0), 3.0), [-1.0, 0.0, 0.0]);
        let cuboid = Shape::cuboid([2.0, 4.0, 6.0])?;
        assert_eq!(cuboid.normal(&from(1.0, 1.0), 4.0), [1.0, 0.0, 0.0]);
        let down = CastRay { origin: [0.5, 0.0, 9.0], direction: [0.0, 0.0, -1.0] };
        let cylinder = Shape::cylinder(1.0, 2.0)?;
        assert_eq!(cylinder.normal(&down, 8.0), [0.0, 0.0, 1.0]);
        assert_eq!(cylinder.normal(&from(0.0, 0.5), 4.0), [-1.0, 0.0, 0.0]);
        let ellipse = Shape::elliptic_cylinder([2.0, 1.0], 4.0)?;
        let met = ellipse.normal(&from(0.6, 0.0), 5.0 - 1.6);
        assert!((met[1] / met[0] + 0.6 / 0.4).abs() < 1e-12); // gradient: x / 4, y / 1
        let slope = Shape::Mesh(Arc::new(Mesh::height_field(&[0.0, 0.0, 2.0, 2.0], 2, 2.0)?));
        let met = slope.normal(&CastRay { origin: [0.1, 0.1, 9.0], ..down }, 8.0);
        assert!((met[0].abs() - 0.5f64.sqrt()).abs() < 1e-12 && met[0] * met[2] < 0.0);
        Ok(())
    }

    #[test]
    fn sizes_that_are_none_are_refused() {
        for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Shape::sphere(value).is_err());
            assert!(Shape::cuboid([1.0, value, 1.0]).is_err());
            assert!(Shape::cylinder(value, 1.0).is_err());
            assert!(Shape::elliptic_cylinder([1.0, value], 1.0).is_err());
            assert!(Shape::cylinder(1.0, value).is_err() || value.is_infinite());
        }
        assert!(Shape::plane([f64::INFINITY, f64::NAN]).is_err());
    }
}
