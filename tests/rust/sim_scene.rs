//! The tree of a scene only chooses candidates: it never loses or changes a hit.

use lidar_core::Error;
use lidar_core::geometry::transform::{Transform, minus, norm, rotation_from_quaternion};
use lidar_sim::mesh::Mesh;
use lidar_sim::scene::{CastRay, Scene, SceneObject};
use lidar_sim::shape::Shape;
use proptest::prelude::*;

const RANGE_MAX: f64 = 500.0;

fn unit<const N: usize>() -> impl Strategy<Value = [f64; N]> {
    prop::array::uniform::<_, N>(-1.0..1.0)
        .prop_filter("length", |vector| vector.iter().map(|v| v * v).sum::<f64>() > 1e-3)
        .prop_map(|vector: [f64; N]| {
            let length = vector.iter().map(|v| v * v).sum::<f64>().sqrt();
            vector.map(|value| value / length)
        })
}

fn shape() -> impl Strategy<Value = Shape> {
    let length = || 1e-3..10.0;
    prop_oneof![
        length().prop_map(|radius| Shape::Sphere { radius }),
        prop::array::uniform3(length()).prop_map(|half_size| Shape::Box { half_size }),
        (length(), length())
            .prop_map(|(radius, half_height)| Shape::Cylinder { radius, half_height }),
        prop::array::uniform2(length()).prop_map(|half_size| Shape::Plane { half_size }),
    ]
}

/// Bodies within `reach` of a place that may be far from the origin.
fn bodies() -> impl Strategy<Value = (Vec<SceneObject>, [f64; 3])> {
    (0.01..300.0, prop::array::uniform3(-1e6..1e6), any::<bool>()).prop_flat_map(
        |(reach, place, far)| {
            let center = if far { place } else { [0.0; 3] };
            let body = (shape(), prop::array::uniform3(-1.0..1.0), unit::<4>()).prop_map(
                move |(shape, offset, quaternion)| {
                    let translation = std::array::from_fn(|i| center[i] + reach * offset[i]);
                    let rotation = rotation_from_quaternion(quaternion);
                    SceneObject {
                        shape,
                        world_from_shape: Transform { rotation, translation },
                        sway: None,
                        surface: None,
                        label: 0,
                    }
                },
            );
            (prop::collection::vec(body, 0..60), Just(center))
        },
    )
}

fn numbered(mut bodies: Vec<SceneObject>) -> Vec<SceneObject> {
    for (label, body) in bodies.iter_mut().enumerate() {
        body.label = label as i32;
    }
    bodies
}

/// Found by `make fuzz`: the tree squares extents in f32, and panicked beyond its range.
#[test]
fn bodies_beyond_the_range_of_the_tree_are_refused() -> Result<(), Error> {
    let at = |x: f64, shape: Shape| SceneObject {
        shape,
        world_from_shape: Transform { translation: [x, 0.0, 0.0], ..Transform::IDENTITY },
        sway: None,
        surface: None,
        label: 0,
    };
    let spheres = |x| [-1.0, 0.5, 1.0, x].map(|x| at(x, Shape::Sphere { radius: 1.0 })).to_vec();
    assert!(matches!(Scene::new(spheres(1e300), vec![]), Err(Error::Value { .. })));
    let far = Scene::new(spheres(1e14), vec![])?;
    let ray = CastRay { origin: [1e14, 0.0, 5.0], direction: [0.0, 0.0, -1.0] };
    assert!(far.meet(&ray, RANGE_MAX, 0.0).is_some());
    let vertices = vec![[1e300, 0.0, 0.0], [0.0; 3], [0.0, 1.0, 0.0]];
    assert!(matches!(Mesh::new(vertices, vec![[0, 1, 2]; 4]), Err(Error::Value { .. })));
    Ok(())
}

proptest! {
    #[test]
    fn the_tree_gives_the_nearest_of_all_to_the_bit(
        (bodies, center) in bodies(),
        rays in prop::collection::vec((prop::array::uniform3(-100.0..100.0), unit::<3>()), 40),
    ) {
        let bodies = numbered(bodies);
        let check = || -> Result<(), Error> {
            let alone: Vec<Scene> = bodies
                .iter()
                .map(|body| Scene::new(vec![body.clone()], vec![]))
                .collect::<Result<_, _>>()?;
            let scene = Scene::new(bodies.clone(), vec![])?;
            for (offset, direction) in rays {
                let origin = std::array::from_fn(|i| center[i] + offset[i]);
                let ray = CastRay { origin, direction };
                let every = alone.iter().filter_map(|scene| scene.meet(&ray, RANGE_MAX, 0.0));
                let best = every.min_by(|a, b| {
                    a.distance.total_cmp(&b.distance).then(a.label.cmp(&b.label))
                });
                assert_eq!(scene.meet(&ray, RANGE_MAX, 0.0), best);
            }
            Ok(())
        };
        prop_assert!(check().is_ok());
    }

    #[test]
    fn a_hit_lies_on_its_surface_and_clearance_is_no_longer_than_any_ray(
        (bodies, center) in bodies(),
        offset in prop::array::uniform3(-100.0..100.0),
        direction in unit::<3>(),
    ) {
        let origin: [f64; 3] = std::array::from_fn(|i| center[i] + offset[i]);
        let check = || -> Result<(), Error> {
            let scene = Scene::new(bodies, vec![])?;
            if let Some(hit) = scene.meet(&CastRay { origin, direction }, RANGE_MAX, 0.0) {
                let end = std::array::from_fn(|i| origin[i] + hit.distance * direction[i]);
                assert!(scene.clearance(end, 1.0) < 1e-6); // roundings of 1e6 m
                assert!((norm(minus(end, origin)) - hit.distance).abs() < 1e-6);
                assert!(scene.clearance(origin, RANGE_MAX) <= hit.distance + 1e-6);
            }
            Ok(())
        };
        prop_assert!(check().is_ok());
    }
}
