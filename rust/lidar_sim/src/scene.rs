//! Scenes: bodies at rest, movers, and particles in the air.

use crate::air::{MAX_VOLUMES, Particles};
use crate::parry::Tree;
use crate::refused;
use crate::shape::Shape;
use crate::surface::Surface;
use crate::trajectory::Trajectory;
use lidar_core::Error;
use lidar_core::geometry::transform::{Transform, dot, minus, norm};
use std::f64::consts::TAU;

pub use crate::parry::{BoundingBox, CastRay};

/// Largest number of wide bodies that are kept out of the tree.
const MOST_WIDE: usize = 8;

/// Swing of a body around its place, as leaves in the wind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sway {
    /// Greatest offset [m].
    pub reach: [f64; 3],
    /// Swings per second [Hz].
    pub rate: f64,
    /// Phase at time 0 [rad].
    pub phase: f64,
}

/// A shape at rest, or swaying.
#[derive(Clone, Debug)]
pub struct SceneObject {
    /// Shape of the object, in its own frame.
    pub shape: Shape,
    /// Pose of the body.
    pub world_from_shape: Transform,
    /// Sway of the body; None: at rest.
    pub sway: Option<Sway>,
    /// Optical properties; None: every ray that hits it returns.
    pub surface: Option<Surface>,
    /// Label in the ground truth; several bodies may share one.
    pub label: i32,
}

/// A moving shape.
#[derive(Clone, Debug)]
pub struct Mover {
    /// Shape of the object, in its own frame.
    pub shape: Shape,
    /// Trajectory of the shape.
    pub trajectory: Trajectory,
    /// Optical properties; None: every ray that hits it returns.
    pub surface: Option<Surface>,
    /// Label in the ground truth; successive movers with the same label are one object.
    pub label: i32,
}

/// End of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayHit {
    /// Length of the ray [m].
    pub distance: f64,
    /// Label of the body.
    pub label: i32,
    /// Optical properties of the body and its unit normal at the hit; None if no properties are
    /// given.
    pub surface: Option<(Surface, [f64; 3])>,
}

/// Bodies at rest in a tree, movers, and particles.
#[derive(Clone, Debug)]
pub struct Scene {
    bodies: Vec<SceneObject>,
    /// Inverse poses of `bodies`.
    shape_from_world: Vec<Transform>,
    /// True for bodies without rotation.
    upright: Vec<bool>,
    /// Indices of infinite bodies and of bodies as wide as the scene. Every ray tests them before
    /// the tree.
    wide: Vec<u32>,
    /// Indices of the bodies of the tree, in the order of its leaves.
    bounded: Vec<u32>,
    tree: Tree,
    movers: Vec<Mover>,
    /// Index of the object of each mover.
    objects: Vec<usize>,
    air: Vec<Particles>,
    /// Bodies fixed to the sensor, in its frame, and their inverse poses.
    carried: Vec<(SceneObject, Transform)>,
}

impl Sway {
    /// Offset `seconds` after time 0 [m].
    fn at(&self, seconds: f64) -> [f64; 3] {
        let swing = libm::sin(TAU * (self.rate * seconds).fract() + self.phase);
        self.reach.map(|reach| reach * swing)
    }

    fn is_finite(&self) -> bool {
        self.reach.iter().chain([&self.rate, &self.phase]).all(|value| value.is_finite())
    }
}

impl SceneObject {
    fn is_finite(&self) -> bool {
        let pose = &self.world_from_shape;
        let mut values = pose.rotation.iter().flatten().chain(&pose.translation);
        values.all(|value| value.is_finite()) && self.sway.is_none_or(|sway| sway.is_finite())
    }

    /// Box around all positions of a swaying body; None for an infinite one.
    fn bounds(&self) -> Option<BoundingBox> {
        let mut bounds = self.shape.bounds(&self.world_from_shape)?;
        let reach = self.sway.map_or([0.0; 3], |sway| sway.reach.map(f64::abs));
        for (axis, reach) in reach.into_iter().enumerate() {
            bounds.min[axis] -= reach;
            bounds.max[axis] += reach;
        }
        Some(bounds)
    }
}

impl Scene {
    /// Make a scene of static bodies and moving objects.
    ///
    /// # Errors
    /// [`Error::Value`] if a pose or a sway is not finite, or a body reaches beyond 1e15 m.
    pub fn new(bodies: Vec<SceneObject>, movers: Vec<Mover>) -> Result<Self, Error> {
        let (mut wide, mut bounded, mut boxes) = (Vec::new(), Vec::new(), Vec::new());
        for (index, body) in bodies.iter().enumerate() {
            if !body.is_finite() {
                let got = format!("{:?}", body.world_from_shape);
                return Err(Error::Value { name: "bodies", expected: "finite", index, got });
            }
            body.surface.as_ref().map_or(Ok(()), Surface::check)?;
            match body.bounds() {
                Some(bounds) if !bounds.is_near() => {
                    let (expected, got) = ("within 1e15 m of the origin", format!("{bounds:?}"));
                    return Err(Error::Value { name: "bodies", expected, index, got });
                }
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
            |body: &SceneObject| body.world_from_shape.rotation == Transform::IDENTITY.rotation;
        let upright = bodies.iter().map(is_upright).collect();
        let tree = Tree::new(&boxes);
        Ok(Self {
            objects: objects_of(&movers),
            air: Vec::new(),
            carried: Vec::new(),
            tree,
            bodies,
            shape_from_world,
            upright,
            wide,
            bounded,
            movers,
        })
    }

    /// This scene with particles in the air.
    ///
    /// # Errors
    /// [`Error::Parameter`] as of [`Particles::check`], or above [`MAX_VOLUMES`].
    pub fn with_air(self, air: Vec<Particles>) -> Result<Self, Error> {
        if air.len() > MAX_VOLUMES {
            return Err(refused("air", "at most 256 volumes", &air.len()));
        }
        air.iter().try_for_each(Particles::check)?;
        Ok(Self { air, ..self })
    }

    /// This scene with bodies fixed to the sensor: the robot or car that carries it.
    ///
    /// # Errors
    /// [`Error::Value`] if a pose is not finite.
    pub fn with_carried(self, bodies: Vec<SceneObject>) -> Result<Self, Error> {
        if let Some(index) = bodies.iter().position(|body| !body.is_finite()) {
            let got = format!("{:?}", bodies[index].world_from_shape);
            return Err(Error::Value { name: "carried", expected: "finite", index, got });
        }
        let of = |body: SceneObject| {
            let shape_from_lidar = inverse(&body.world_from_shape);
            (body, shape_from_lidar)
        };
        Ok(Self { carried: bodies.into_iter().map(of).collect(), ..self })
    }

    /// First hit, before `limit` [m], of a ray in `direction` of the sensor's frame on its carrier;
    /// None without one.
    #[must_use]
    pub fn meet_carried(&self, direction: [f64; 3], limit: f64) -> Option<RayHit> {
        let ray = CastRay { origin: [0.0; 3], direction };
        let mut nearest = None;
        let mut limit = limit;
        for (body, shape_from_lidar) in &self.carried {
            if let Some(distance) = body.shape.meet(&within(shape_from_lidar, &ray), limit) {
                nearest = Some(RayHit { distance, label: body.label, surface: None });
                limit = distance;
            }
        }
        nearest
    }

    /// Particles in the air.
    #[must_use]
    pub fn air(&self) -> &[Particles] {
        &self.air
    }

    /// Extinction of light per metre of air [1/m].
    #[must_use]
    pub fn extinction(&self) -> f64 {
        self.air.iter().map(Particles::extinction).sum()
    }

    /// Moving shapes.
    #[must_use]
    pub fn movers(&self) -> &[Mover] {
        &self.movers
    }

    /// Index of the object of each mover, from 0: successive movers with one label are one object.
    #[must_use]
    pub fn objects(&self) -> &[usize] {
        &self.objects
    }

    /// First hit of `ray` on a body before `limit` [m], `seconds` after time 0; None without one.
    #[must_use]
    pub fn meet(&self, ray: &CastRay, limit: f64, seconds: f64) -> Option<RayHit> {
        let test = |index: u32, limit: f64| {
            let index = index as usize;
            let body = &self.bodies[index];
            let swayed = body.sway.map(|sway| CastRay {
                origin: minus(ray.origin, sway.at(seconds)),
                direction: ray.direction,
            });
            let ray = swayed.as_ref().unwrap_or(ray);
            if self.upright[index] {
                let origin = minus(ray.origin, body.world_from_shape.translation);
                return body.shape.meet(&CastRay { origin, direction: ray.direction }, limit);
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
        nearest.map(|index| self.hit(index as usize, ray, limit, seconds))
    }

    fn hit(&self, index: usize, ray: &CastRay, distance: f64, seconds: f64) -> RayHit {
        let body = &self.bodies[index];
        let surface = body.surface.map(|surface| {
            let swayed = body.sway.map_or([0.0; 3], |sway| sway.at(seconds));
            let origin = minus(ray.origin, swayed);
            let local = within(&self.shape_from_world[index], &CastRay { origin, ..*ray });
            (surface, body.world_from_shape.rotate(body.shape.normal(&local, distance)))
        });
        RayHit { distance, label: body.label, surface }
    }

    /// Distance [m] of `point` from the nearest body at its current place, or `limit` if none is
    /// nearer.
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

fn objects_of(movers: &[Mover]) -> Vec<usize> {
    let mut objects: Vec<usize> = Vec::with_capacity(movers.len());
    for (index, mover) in movers.iter().enumerate() {
        let next = objects
            .last()
            .map_or(0, |&last| last + usize::from(movers[index - 1].label != mover.label));
        objects.push(next);
    }
    objects
}

/// Move a few bodies at most to `wide`: those that are at least half as wide as all bodies
/// together. In the tree, nearly every ray would meet them, but late.
fn take_wide(wide: &mut Vec<u32>, bounded: &mut Vec<u32>, boxes: &mut Vec<BoundingBox>) {
    let size = |bounds: &BoundingBox| norm(minus(bounds.max, bounds.min));
    let all = size(&BoundingBox::around(boxes.iter().flat_map(|bounds| [bounds.min, bounds.max])));
    for place in (0..boxes.len()).rev() {
        if wide.len() < MOST_WIDE && size(&boxes[place]) >= 0.5 * all {
            wide.push(bounded.remove(place));
            boxes.remove(place);
        }
    }
}

/// Inverse of `pose`.
#[must_use]
pub fn inverse(pose: &Transform) -> Transform {
    let rotation: [[f64; 3]; 3] =
        std::array::from_fn(|row| std::array::from_fn(|column| pose.rotation[column][row]));
    let translation = rotation.map(|row| -dot(row, pose.translation));
    Transform { rotation, translation }
}

/// `ray` in the frame of a shape.
pub(crate) fn within(shape_from_world: &Transform, ray: &CastRay) -> CastRay {
    CastRay {
        origin: shape_from_world.apply(ray.origin),
        direction: shape_from_world.rotate(ray.direction),
    }
}

/// True if `ray` passes the sphere of `radius` around `center`.
pub(crate) fn passes(ray: &CastRay, center: [f64; 3], radius: f64) -> bool {
    let to_center = minus(center, ray.origin);
    let along = dot(to_center, ray.direction).max(0.0);
    let miss: [f64; 3] = std::array::from_fn(|axis| to_center[axis] - along * ray.direction[axis]);
    dot(miss, miss) <= radius * radius
}
