//! Lattice, rays, transforms, motion, spherical caps, clusters.

use super::input::{Input, one_thread};
use lidar_core::Error;
use lidar_core::geometry::caps::{Cap, Directions};
use lidar_core::geometry::cluster::angular_gap::{AngularGap, SeenLabeller, label_seen};
use lidar_core::geometry::cluster::{Clustering, Labeller, label};
use lidar_core::geometry::lattice::{Lattice, floor, wide};
use lidar_core::geometry::motion::{PointPoses, ScanPoses};
use lidar_core::geometry::transform::{
    Transform, cross, direction_of, dot, minus, norm, quaternion_from_rotation,
    rotation_from_quaternion,
};
use lidar_core::geometry::traverse::{traverse, voxel_count};
use std::ops::ControlFlow;

pub fn functions(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let _ = rays(&mut input);
    let _ = moved(&mut input);
    let _ = caps(&mut input);
}

fn rays(input: &mut Input<'_>) -> Result<(), Error> {
    let lattice = Lattice::new(input.positive(), input.f64s())?;
    let (start, end): ([f64; 3], [f64; 3]) = (input.f64s(), input.f64s());
    let _ = (lattice.voxel_size(), lattice.origin(), floor(lattice.scaled(start)));
    let _ = wide(input.f32s());
    let (first, last) = (lattice.voxel_at(start)?, lattice.voxel_at(end)?);
    let _ = (lattice.center(first), voxel_count(first, last));
    let (mut met, mut length) = (Vec::new(), 0.0);
    traverse(&lattice, start, end, |voxel, inside| {
        length += inside;
        met.push(voxel);
        if met.len() > 5_000 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    let whole = norm(minus(end, start));
    if met.len() <= 5_000 {
        assert!((length - whole).abs() <= 1e-6 * whole.max(1.0), "{length} of {whole}");
    }
    Ok(())
}

fn moved(input: &mut Input<'_>) -> Result<(), Error> {
    let poses = input.many(4, Input::pose);
    let mut last = 0;
    let stamps = input.beside(poses.len(), |input| {
        last = input.stamp(last);
        last
    });
    let stamps = input.is_set().then_some(stamps);
    let motion = ScanPoses::new(&poses, stamps.as_deref())?;
    let _ = (motion.is_stream(), motion.at(input.stamp(0)));
    let times = input.many(12, |input| input.stamp(0));
    let mut known = PointPoses::default();
    known.fill(&motion, "times", &times, |point| point % 3 != 1)?;
    let [one, other] = [input.pose(), input.pose()].map(|matrix| Transform::from_matrix(&matrix));
    known.move_to(&one);
    for point in 0..known.points() {
        let _ = known.at(point).apply(input.f64s());
    }
    known.fill_blocks([one, other].into_iter(), times.len(), |point| point % 2);
    let _ = (!times.is_empty()).then(|| known.at(times.len() - 1).apply(input.f64s()));
    let both = one.after(&other).interpolate(&one.inverse(), input.share());
    let _ = (both.rotate(input.f64s()), both.turn_covariance(&input.covariance()));
    let (a, b): ([f64; 3], [f64; 3]) = (input.f64s(), input.f64s());
    let _ = (dot(a, b), cross(a, b), norm(a), direction_of(b));
    let _ = rotation_from_quaternion(quaternion_from_rotation(&both.rotation));
    Ok(())
}

fn caps(input: &mut Input<'_>) -> Result<(), Error> {
    let units = input.many(30, |input| direction_of(input.f64s()));
    let directions = Directions::new(units.into_iter().flatten().collect(), input.share());
    let caps = input.many(6, |input| Cap {
        center: direction_of(input.f64s()).unwrap_or([1.0, 0.0, 0.0]),
        radius: input.share(),
    });
    for cap in &caps {
        let _ = cap.area();
    }
    let _ = directions.is_empty();
    let _ = directions.covered(one_thread()?, input.share(), &caps);
    Ok(())
}

pub fn clusters(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let _ = labelled(&mut input);
}

fn labelled(input: &mut Input<'_>) -> Result<(), Error> {
    let clustering = Clustering {
        max_distance: input.positive(),
        min_points: input.below(6),
        max_points: input.maybe(|input| input.below(30)),
    };
    let gap = AngularGap { origin: input.f64s(), max_angle: input.share() };
    let points = input.points(120);
    let found = label(&points, &clustering)?;
    assert_eq!(found.len(), points.len());
    let mut labeller = Labeller::default();
    assert_eq!(labeller.label(&points, &clustering)?, found);
    assert_eq!(labeller.labels(), found);
    let seen = label_seen(&points, &gap, &clustering, None)?;
    let mut labeller = SeenLabeller::default();
    assert_eq!(labeller.label(&points, &gap, &clustering, Some(one_thread()?))?, seen);
    assert_eq!(labeller.labels(), seen);
    Ok(())
}
