//! What stands and what moves.

use crate::parry::Tree;
use crate::shape::Shape;
use crate::trajectory::Trajectory;
use lidar_core::Error;
use lidar_core::geometry::transform::{Transform, dot, minus, norm};

pub use crate::parry::{Bounds, Ray};

/// Wide bodies that are kept out of the tree.
const MOST_WIDE: usize = 8;

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
    /// True for bodies that are not turned.
    upright: Vec<bool>,
    /// Bodies without an end or as wide as the scene, tested by every ray before the tree.
    wide: Vec<u32>,
    /// Bodies of the tree, in the order of its leaves.
    bounded: Vec<u32>,
    tree: Tree,
    movers: Vec<Mover>,
}

impl Scene {
    /// # Errors
    /// [`Error::Value`] if a pose is not finite.
    pub fn new(bodies: Vec<Body>, movers: Vec<Mover>) -> Result<Self, Error> {
        let (mut wide, mut bounded, mut boxes) = (Vec::new(), Vec::new(), Vec::new());
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
                None => wide.push(index as u32),
            }
        }
        take_wide(&mut wide, &mut bounded, &mut boxes);
        let shape_from_world = bodies.iter().map(|body| inverse(&body.world_from_shape)).collect();
        let is_upright =
            |body: &Body| body.world_from_shape.rotation == Transform::IDENTITY.rotation;
        let upright = bodies.iter().map(is_upright).collect();
        let tree = Tree::new(&boxes);
        Ok(Self { tree, bodies, shape_from_world, upright, wide, bounded, movers })
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
            let body = &self.bodies[index];
            if self.upright[index] {
                let origin = minus(ray.origin, body.world_from_shape.translation);
                return body.shape.meet(&Ray { origin, direction: ray.direction }, limit);
            }
            body.shape.meet(&within(&self.shape_from_world[index], ray), limit)
        };
        let mut nearest = None;
        let mut limit = limit;
        for &index in &self.wide {
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
        let wide = self.wide.iter().map(|&index| of(index)).fold(limit, f64::min);
        self.tree.clearance(point, wide, |leaf| of(self.bounded[leaf as usize]))
    }
}

/// Move bodies that are at least half as wide as all together to `wide`, a few at most: in the tree
/// they would be met by nearly every ray, but late.
fn take_wide(wide: &mut Vec<u32>, bounded: &mut Vec<u32>, boxes: &mut Vec<Bounds>) {
    let size = |bounds: &Bounds| norm(minus(bounds.max, bounds.min));
    let all = size(&Bounds::around(boxes.iter().flat_map(|bounds| [bounds.min, bounds.max])));
    for place in (0..boxes.len()).rev() {
        if wide.len() < MOST_WIDE && size(&boxes[place]) >= 0.5 * all {
            wide.push(bounded.remove(place));
            boxes.remove(place);
        }
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
