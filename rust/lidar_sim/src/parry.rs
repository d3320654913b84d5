//! Adapter to the crate parry: only this file uses parry or glam.
//!
//! parry's tree is single precision. It only chooses candidates, with boxes grown by more than
//! its rounding error; every hit and distance is computed by the caller in double precision.

use lidar_core::geometry::transform::{dot, minus, norm};
use parry3d::bounding_volume::Aabb;
use parry3d::math::Vector;
use parry3d::partitioning::{Bvh, BvhBuildStrategy, BvhNode};
use parry3d::query::Ray as TreeRay;
use std::cell::Cell;

/// A half-line; `direction` has length 1.
#[derive(Clone, Copy, Debug)]
pub struct CastRay {
    /// Start [m].
    pub origin: [f64; 3],
    /// Unit direction.
    pub direction: [f64; 3],
}

/// Axis-aligned box: least and greatest corner [m].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundingBox {
    /// Least coordinates.
    pub min: [f64; 3],
    /// Greatest coordinates.
    pub max: [f64; 3],
}

impl BoundingBox {
    /// True if the tree's arithmetic, squares in f32, can hold the box.
    pub(crate) fn is_near(&self) -> bool {
        self.min.iter().chain(&self.max).all(|value| value.abs() <= FARTHEST)
    }

    /// The smallest box around `points`; inverted (min > max) around none.
    #[must_use]
    pub fn around(points: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let mut bounds = Self { min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };
        for point in points {
            for (axis, value) in point.into_iter().enumerate() {
                bounds.min[axis] = bounds.min[axis].min(value);
                bounds.max[axis] = bounds.max[axis].max(value);
            }
        }
        bounds
    }
}

/// Bounding-volume tree over boxes with indices.
#[derive(Clone, Debug)]
pub(crate) struct Tree {
    bvh: Bvh,
    /// Centre of all boxes: coordinates are relative to it before they are rounded.
    center: [f64; 3],
    /// Radius of the sphere around all boxes [m].
    radius: f64,
}

/// Largest coordinate of a body [m].
pub(crate) const FARTHEST: f64 = 1e15;

/// Growth of the boxes, as a share of the tree's radius: about 30 roundings of a coordinate.
const MARGIN: f64 = 4e-6;

impl Tree {
    pub(crate) fn new(boxes: &[BoundingBox]) -> Self {
        let all = BoundingBox::around(boxes.iter().flat_map(|bounds| [bounds.min, bounds.max]));
        let center: [f64; 3] = if boxes.is_empty() {
            [0.0; 3]
        } else {
            std::array::from_fn(|axis| 0.5 * (all.min[axis] + all.max[axis]))
        };
        let radius = if boxes.is_empty() { 0.0 } else { norm(minus(all.max, center)) };
        let margin = (MARGIN * radius) as f32;
        let leaves: Vec<Aabb> = boxes
            .iter()
            .map(|bounds| Aabb {
                mins: vector(minus(bounds.min, center)) - Vector::splat(margin),
                maxs: vector(minus(bounds.max, center)) + Vector::splat(margin),
            })
            .collect();
        let bvh = Bvh::from_leaves(BvhBuildStrategy::Ploc, &leaves);
        Self { bvh, center, radius }
    }

    /// Nearest hit closer than `limit` [m]: index of its box, and distance; None without a hit.
    /// `hit(index, limit)` tests one candidate. For equal distances, the result is always the same
    /// box.
    pub(crate) fn nearest(
        &self,
        ray: &CastRay,
        limit: f64,
        hit: impl Fn(u32, f64) -> Option<f64>,
    ) -> Option<(u32, f64)> {
        // The walk starts where the ray comes near, so that f32 sees only lengths of the tree's size.
        let offset = minus(ray.origin, self.center);
        let along = -dot(offset, ray.direction);
        let reach = self.radius * (1.0 + MARGIN);
        let start = (along - reach).max(0.0);
        if along + reach < 0.0 || start > limit {
            return None;
        }
        let entry: [f64; 3] =
            std::array::from_fn(|axis| offset[axis] + start * ray.direction[axis]);
        let best = Cell::new((u32::MAX, limit));
        let tree_ray = TreeRay::new(vector(entry), vector(ray.direction));
        let slack = MARGIN * self.radius;
        self.bvh.cast_ray(&tree_ray, (limit - start + slack) as f32, |number, _| {
            let (_, distance) = best.get();
            let found = hit(number, distance)?;
            if found < distance {
                best.set((number, found));
            }
            Some((found - start + slack) as f32)
        });
        (best.get().0 != u32::MAX).then(|| best.get())
    }

    /// Smallest of `distance(index)` [m] from `point`, or `limit` if no distance is smaller.
    pub(crate) fn clearance(
        &self,
        point: [f64; 3],
        limit: f64,
        distance: impl Fn(u32) -> f64,
    ) -> f64 {
        let best = Cell::new(limit);
        let local = vector(minus(point, self.center));
        let slack = (MARGIN * (self.radius + norm(minus(point, self.center)))) as f32;
        self.bvh.find_best(
            limit as f32 + slack,
            |node: &BvhNode, _| outside(node, local),
            |number, _| {
                best.set(best.get().min(distance(number)));
                Some(best.get() as f32 + slack)
            },
        );
        best.get()
    }
}

/// Distance [m] of `point` from the box of `node`; 0 inside.
fn outside(node: &BvhNode, point: Vector) -> f32 {
    let nearest = point.clamp(node.mins(), node.maxs());
    point.distance(nearest)
}

fn vector(point: [f64; 3]) -> Vector {
    Vector::new(point[0] as f32, point[1] as f32, point[2] as f32)
}
