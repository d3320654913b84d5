//! What stands and what moves.

use crate::parry::Tree;
use crate::shape::Shape;
use crate::trajectory::Trajectory;
use lidar_core::Error;
use lidar_core::geometry::transform::{Transform, dot, minus};

pub use crate::parry::{Bounds, Ray};

/// A shape at rest.
#[derive(Clone, Debug)]
pub struct Body {
    /// Its surface.
    pub shape: Shape,
    /// Where it stands.
    pub world_from_shape: Transform,
    /// Name in the truth labels; several bodies may share one.
    pub label: i32,
}

/// A shape on its way.
#[derive(Clone, Debug)]
pub struct Mover {
    /// Its surface.
    pub shape: Shape,
    /// Where it is at which time.
    pub trajectory: Trajectory,
    /// Name in the truth labels.
    pub label: i32,
}

/// Where a ray ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Length of the ray [m].
    pub distance: f64,
    /// Label of what it met.
    pub label: i32,
}

/// Bodies at rest under a tree, and movers.
#[derive(Clone, Debug)]
pub struct Scene {
    bodies: Vec<Body>,
    /// Inverse poses of `bodies`.
    shape_from_world: Vec<Transform>,
    /// Bodies without an end, tested by every ray.
    endless: Vec<u32>,
    /// Bodies of the tree, in the order of its leaves.
    bounded: Vec<u32>,
    tree: Tree,
    movers: Vec<Mover>,
}

impl Scene {
    /// # Errors
    /// [`Error::Value`] if a pose is not finite.
    pub fn new(bodies: Vec<Body>, movers: Vec<Mover>) -> Result<Self, Error> {
        let (mut endless, mut bounded, mut boxes) = (Vec::new(), Vec::new(), Vec::new());
        for (index, body) in bodies.iter().enumerate() {
            let pose = &body.world_from_shape;
            let mut values = pose.rotation.iter().flatten().chain(&pose.translation);
            if !values.all(|value| value.is_finite()) {
                let got = format!("{pose:?}");
                return Err(Error::Value { name: "bodies", expected: "a finite pose", index, got });
            }
            match body.shape.bounds(pose) {
                Some(bounds) => {
                    bounded.push(index as u32);
                    boxes.push(bounds);
                }
                None => endless.push(index as u32),
            }
        }
        let shape_from_world = bodies.iter().map(|body| inverse(&body.world_from_shape)).collect();
        Ok(Self { tree: Tree::new(&boxes), bodies, shape_from_world, endless, bounded, movers })
    }

    /// What moves.
    #[must_use]
    pub fn movers(&self) -> &[Mover] {
        &self.movers
    }

    /// First body at rest that `ray` meets before `limit` [m].
    #[must_use]
    pub fn meet(&self, ray: &Ray, limit: f64) -> Option<Hit> {
        let test = |index: u32, limit: f64| {
            let index = index as usize;
            self.bodies[index].shape.meet(&within(&self.shape_from_world[index], ray), limit)
        };
        let mut nearest = None;
        let mut limit = limit;
        for &index in &self.endless {
            if let Some(distance) = test(index, limit) {
                nearest = Some(index);
                limit = distance;
            }
        }
        let leaf = |leaf: u32, limit: f64| test(self.bounded[leaf as usize], limit);
        if let Some((leaf, distance)) = self.tree.nearest(ray, limit, leaf) {
            nearest = Some(self.bounded[leaf as usize]);
            limit = distance;
        }
        nearest.map(|index| Hit { distance: limit, label: self.bodies[index as usize].label })
    }

    /// Distance [m] of `point` from the nearest body at rest, or `limit` if none is nearer.
    #[must_use]
    pub fn clearance(&self, point: [f64; 3], limit: f64) -> f64 {
        let of = |index: u32| {
            let local = self.shape_from_world[index as usize].apply(point);
            self.bodies[index as usize].shape.clearance(local, limit)
        };
        let endless = self.endless.iter().map(|&index| of(index)).fold(limit, f64::min);
        self.tree.clearance(point, endless, |leaf| of(self.bounded[leaf as usize]))
    }
}

/// The transform that undoes `pose`.
#[must_use]
pub fn inverse(pose: &Transform) -> Transform {
    let rotation: [[f64; 3]; 3] =
        std::array::from_fn(|row| std::array::from_fn(|column| pose.rotation[column][row]));
    let translation = rotation.map(|row| -dot(row, pose.translation));
    Transform { rotation, translation }
}

/// `ray` in the frame of a shape.
pub(crate) fn within(shape_from_world: &Transform, ray: &Ray) -> Ray {
    Ray {
        origin: shape_from_world.apply(ray.origin),
        direction: shape_from_world.rotate(ray.direction),
    }
}

/// True if `ray` passes the sphere of `radius` around `center`.
pub(crate) fn passes(ray: &Ray, center: [f64; 3], radius: f64) -> bool {
    let to_center = minus(center, ray.origin);
    let along = dot(to_center, ray.direction).max(0.0);
    let miss: [f64; 3] = std::array::from_fn(|axis| to_center[axis] - along * ray.direction[axis]);
    dot(miss, miss) <= radius * radius
}
