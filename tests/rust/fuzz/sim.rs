//! The simulator: shapes, scenes, trajectories, sensors.

use super::input::{Input, one_thread};
use lidar_core::Error;
use lidar_core::geometry::transform::{Transform, direction_of};
use lidar_sim::air::Particles;
use lidar_sim::circle_beams::Beams;
use lidar_sim::circle_samples::{Disturbance, Source, lattice, make};
use lidar_sim::mesh::Mesh;
use lidar_sim::motion::RandomMotion;
use lidar_sim::random::{Purpose, Stream, normal, place, uniform, words};
use lidar_sim::ray_patterns::{Beam, Lidar, Pattern};
use lidar_sim::scene::{BoundingBox, CastRay, Mover, Scene, SceneObject, Sway};
use lidar_sim::scenes::performance;
use lidar_sim::shape::Shape;
use lidar_sim::simulate::{Task, scan};
use lidar_sim::surface::{Surface, is_seen, signal};
use lidar_sim::trajectory::Trajectory;

fn shape(input: &mut Input<'_>) -> Result<Shape, Error> {
    match input.below(6) {
        0 => Shape::plane([input.positive(), input.positive()]),
        1 => Shape::cuboid([input.positive(), input.positive(), input.positive()]),
        2 => Shape::cylinder(input.positive(), input.positive()),
        3 => Shape::elliptic_cylinder([input.positive(), input.positive()], input.positive()),
        4 => Shape::sphere(input.positive()),
        _ => {
            let mesh = if input.is_set() {
                let vertices = input.many(9, |input| input.f64s());
                let count = vertices.len();
                let faces =
                    input.many(9, |input| std::array::from_fn(|_| input.index(count) as u32));
                Mesh::new(vertices, faces)?
            } else {
                let columns = 1 + input.below(4);
                Mesh::height_field(&input.many(16, Input::f64), columns, input.positive())?
            };
            let _ = (mesh.vertices().len(), mesh.faces().len());
            Ok(Shape::Mesh(mesh.into()))
        }
    }
}

fn surface(input: &mut Input<'_>) -> Option<Surface> {
    input.maybe(|input| Surface {
        reflectivity: input.share(),
        mirror: input.share(),
        clear: input.share(),
    })
}

fn trajectory(input: &mut Input<'_>) -> Result<Trajectory, Error> {
    let mut last = 0;
    let stamps = input.many(4, |input| {
        last = input.stamp(last);
        last
    });
    let poses = input.beside(stamps.len(), |input| Transform::from_matrix(&input.pose()));
    Trajectory::new(stamps, poses)
}

fn scene(input: &mut Input<'_>) -> Result<Scene, Error> {
    let bodies = |input: &mut Input<'_>, most| {
        let mut found = Vec::new();
        for label in 0..input.below(most) {
            let Ok(shape) = shape(input) else { continue };
            let sway = input.rarely().then(|| Sway {
                reach: input.f64s(),
                rate: input.f64(),
                phase: input.f64(),
            });
            let world_from_shape = Transform::from_matrix(&input.pose());
            let surface = surface(input);
            found.push(SceneObject { shape, world_from_shape, sway, surface, label: label as i32 });
        }
        found
    };
    let movers = if input.rarely() {
        let (shape, trajectory) = (shape(input)?, trajectory(input)?);
        vec![Mover { shape, trajectory, surface: surface(input), label: 77 }]
    } else {
        Vec::new()
    };
    let air = if input.rarely() {
        vec![Particles::Rain { density: input.positive(), size: input.positive() * 0.01 }]
    } else {
        Vec::new()
    };
    for one in &air {
        let _ = (one.check(), one.extinction());
    }
    let bodies_at_rest = bodies(input, 6);
    Scene::new(bodies_at_rest, movers)?.with_air(air)?.with_carried(bodies(input, 2))
}

pub fn scenes(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let _ = seen(&mut input);
}

fn seen(input: &mut Input<'_>) -> Result<(), Error> {
    let scene = scene(input)?;
    let _ = (scene.movers().len(), scene.objects(), scene.air(), scene.extinction());
    for _ in 0..4 {
        let origin = input.f64s();
        let Some(direction) = direction_of(input.f64s()) else { continue };
        let _ = scene.meet(&CastRay { origin, direction }, 100.0, input.f64());
        let _ = scene.meet_carried(direction, 100.0);
        let _ = scene.clearance(origin, input.positive());
    }
    let pattern = match input.below(3) {
        0 => Pattern::Spinning {
            elevations: input.many(4, Input::f64),
            columns: input.below(20),
            azimuth_start: input.f64(),
            azimuth_per_scan: input.f64(),
        },
        1 => Pattern::Rosette {
            rays: input.below(60),
            elevation: input.f64s(),
            azimuth_half: input.maybe(Input::f64),
        },
        _ => Pattern::Planar {
            rays: input.below(60),
            angle_min: input.f64(),
            angle_increment: input.f64(),
            time_increment_ns: i64::from(input.byte()) << 12,
        },
    };
    let lidar = Lidar {
        pattern,
        period_ns: if input.rarely() { input.i64() } else { 100_000_000 },
        snapshot: input.is_set(),
        range_min: input.share(),
        range_max: 50.0,
        range_std: input.share() * 0.1,
        dropout: input.share(),
        beam: input.maybe(|input| Beam {
            half_width: input.share() * 0.01,
            lines: input.below(4),
            echo_length: input.share(),
        }),
    };
    lidar.check()?;
    let scan_number = u64::from(input.byte());
    assert_eq!(lidar.sweep(scan_number).directions.len(), lidar.rays());
    let _ = lidar.measured(input.positive(), 1, scan_number, 0);
    if let Some(beam) = &lidar.beam {
        beam.check()?;
        let _ = beam.turns();
    }
    let sensor = trajectory(input)?;
    let start_ns = input.stamp(0);
    let task = Task {
        scene: &scene,
        lidar: &lidar,
        sensor: &sensor,
        start_ns,
        scan: scan_number,
        seed: 7,
    };
    scan(one_thread()?, &task)?;
    let motion = RandomMotion {
        bounds: BoundingBox { min: [-5.0; 3], max: [5.0; 3] },
        speed_max: input.positive(),
        acceleration_max: input.positive(),
        clearance: input.positive(),
        apart: Vec::new(),
        near: None,
        span_ns: (0, 1_000_000_000),
        seed: (1, 2),
    };
    motion.trajectory(&scene)?;
    Ok(())
}

pub fn functions(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    if input.rarely() {
        let _ = performance(u32::from(input.byte()));
    }
    let _ = shapes(&mut input);
    let _ = samples(&mut input);
}

fn shapes(input: &mut Input<'_>) -> Result<(), Error> {
    let one = shape(input)?;
    let pose = Transform::from_matrix(&input.pose());
    let _ = (one.radius(), one.bounds(&pose), one.clearance(input.f64s(), input.positive()));
    if let Some(direction) = direction_of(input.f64s()) {
        let ray = CastRay { origin: input.f64s(), direction };
        if let Some(distance) = one.meet(&ray, input.positive() * 10.0) {
            let normal = one.normal(&ray, distance);
            if let Some(surface) = surface(input) {
                surface.check()?;
                let _ = (
                    surface.mirrored(input.share()),
                    surface.interaction(direction, normal, [input.share(), input.share()]),
                );
            }
        }
    }
    let _ =
        is_seen(signal(input.share(), input.share(), input.positive(), 50.0, 0.0), input.share());
    let path = trajectory(input)?;
    let stamp_ns = input.stamp(0);
    let _ = (path.pose_at(stamp_ns), path.velocity_at(stamp_ns), path.span_ns());
    let _ = Trajectory::at_rest(pose).pose_at(stamp_ns);
    let [first, second, ..] = words(input.i64() as u64, place(Purpose::Ray, 1, 2));
    let _ = (uniform(first), normal(first, second));
    let mut stream = Stream::new(3, Purpose::Motion, 4);
    let _ = (stream.uniforms(), stream.direction());
    Ok(())
}

fn samples(input: &mut Input<'_>) -> Result<(), Error> {
    let beams = Beams {
        angle_min: input.f64(),
        angle_increment: input.share() * 0.1,
        n_beams: u32::from(input.byte()),
        range_limits: [input.share(), 5.0],
    };
    let least = u32::from(input.byte() % 8);
    let spacing = 0.5 + input.positive();
    let circles = lattice(&beams, 3.0, spacing, least..=least + 2, input.positive())?;
    let disturbance = Disturbance {
        range_std: [0.0, input.share()],
        beam_half_width: [0.0, input.share() * 0.01],
        occluded_share: input.share(),
        mixed_share: input.share(),
        cut_margins: [0.05, 0.1],
    };
    let pool = one_thread()?;
    make(pool, &beams, Source::Given(&circles, 1), &disturbance, 5, 0..3)?;
    let radius = [input.positive(), input.positive()];
    make(pool, &beams, Source::Drawn { reach: 3.0, radius }, &disturbance, 5, 0..3)?;
    Ok(())
}
