//! Voxel map, detector, tracker and functions of flying objects: sequences of calls.

use super::formats::paths;
use super::input::Input;
use lidar_core::Error;
use lidar_core::flying::analysis::{detection_probability, hit_probability, point_covariance};
use lidar_core::flying::background::parameters::SeedParameters;
use lidar_core::flying::classify::classifier::classify_clusters;
use lidar_core::flying::classify::parameters::ClassifyParameters;
use lidar_core::flying::detect::center::target_center;
use lidar_core::flying::detect::detection::Teammate;
use lidar_core::flying::detector::FlyingObjectDetector;
use lidar_core::flying::integrate::classified_scan::{ClassifiedScan, Origins};
use lidar_core::flying::integrate::integrator::Integrator;
use lidar_core::flying::map::filter::{filtered, two_to_minus};
use lidar_core::flying::map::parameters::{MapParameters, RayUnit, Rays, Separation, Skip};
use lidar_core::flying::map::voxel_map::VoxelMap;
use lidar_core::flying::parameters::FlyingParameters;
use lidar_core::flying::point_class::{classes_from_numbers, numbers_from_classes};
use lidar_core::flying::scan::prepared::RawScan;
use lidar_core::flying::scan::sensor::SensorParameters;
use lidar_core::flying::scan::untimed::SweepTimes;
use lidar_core::flying::sky::Beams;
use lidar_core::flying::track::{
    Confirmation, Detections, OccupiedPoints, PointCloudTracker, TrackerParameters,
};
use lidar_core::geometry::cluster::Clustering;
use lidar_core::geometry::lattice::Lattice;
use lidar_core::geometry::transform::Transform;
use lidar_core::util::threads::Workers;

const STEP_NS: i64 = 100_000_000;
const UNMOVED: [f64; 16] = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];

/// A small map, a short burn-in: a state is reached within a few scans.
pub fn flying_parameters() -> FlyingParameters {
    FlyingParameters {
        map: map_parameters(),
        clustering: Clustering { max_distance: 0.5, ..Clustering::default() },
        classify: ClassifyParameters {
            search_distance: 2.0,
            max_extent: Some(1.5),
            min_points: 2,
            ..ClassifyParameters::default()
        },
        separation: Separation { min_confident: 4, ..Separation::default() },
        seed: SeedParameters {
            burn_in_scans: 2,
            burn_in_period: None,
            burn_in_extent: 1.0,
            ..SeedParameters::default()
        },
        default_sensor: SensorParameters { beams: Beams::Given, ..SensorParameters::default() },
        tracker: TrackerParameters {
            confirmation: Confirmation::Counts { hits: 2, window: 3 },
            ..TrackerParameters::default()
        },
        forget_distance: None,
        ..FlyingParameters::default()
    }
}

fn map_parameters() -> MapParameters {
    MapParameters { max_range: 8.0, max_voxels: 1 << 18, ..MapParameters::default() }
}

fn any_map_parameters(input: &mut Input<'_>) -> MapParameters {
    let usual = map_parameters();
    MapParameters {
        voxel_size: if input.rarely() { input.positive() } else { 0.25 },
        origin: if input.rarely() { input.f64s() } else { [0.0; 3] },
        g_free: if input.rarely() { input.f64() as f32 } else { usual.g_free },
        initial: if input.rarely() { input.f64() as f32 } else { usual.initial },
        ray_gain: input.positive(),
        end_margin: input.positive(),
        rays: input.one_of(&[Rays::All, Rays::OnePerEnd]),
        skip: input.one_of(&[Skip::Nothing, Skip::Saturated]),
        ray_unit: input.one_of(&[RayUnit::Edges, RayUnit::Metres, RayUnit::Diagonals]),
        settles: input.is_set(),
        bounds: match input.below(4) {
            0 => Some([[-9.0; 3], [9.0; 3]]),
            1 => Some([input.f64s(), input.f64s()]),
            _ => None,
        },
        extra_thresholds: (0..input.below(5)).map(|more| -500.0 - more as f32).collect(),
        max_voxels: input.one_of(&[1 << 18, 1 << 12, 1 << 9, 1, 0]),
        max_range: input.one_of(&[8.0, 3.0, 1.0]),
        ..usual
    }
}

pub fn small_scan(detector: &mut FlyingObjectDetector, stamp_ns: i64) -> Result<(), Error> {
    let mut points: Vec<[f32; 3]> =
        (0..36).map(|i| [(i % 6) as f32 * 0.25, (i / 6) as f32 * 0.25, -1.4]).collect();
    points.extend([[2.0, 2.0, 2.0], [2.0, 2.1, 2.0], [2.1, 2.0, 2.0]]);
    detector.process(&RawScan {
        sensor: "lidar",
        stamp_ns,
        organised: false,
        points: &points,
        no_return: None,
        directions: None,
        point_time_ns: None,
        poses: &[UNMOVED],
        pose_stamps_ns: None,
        pose_covariance: None,
    })?;
    Ok(())
}

pub fn voxel_map(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let parameters = any_map_parameters(&mut input);
    let _ = parameters.relative_to(input.f64s());
    let (Ok(mut map), Ok(workers)) = (VoxelMap::new(parameters), Workers::new(1)) else { return };
    let mut integrator =
        if input.is_set() { Integrator::default() } else { Integrator::on(workers) };
    let _ = Integrator::new(input.below(3));
    for _ in 0..40 {
        if input.is_empty() {
            break;
        }
        let _ = change_map(&mut input, &mut map, &mut integrator);
    }
    let bytes = map.to_bytes();
    assert_eq!(VoxelMap::from_bytes(&bytes).map(|map| map.to_bytes()).ok(), Some(bytes));
    let state = map.to_state().ok();
    let again = state.as_ref().and_then(|state| VoxelMap::from_state(state).ok());
    assert_eq!(again.and_then(|map| map.to_state().ok()), state);
}

fn change_map(
    input: &mut Input<'_>,
    map: &mut VoxelMap,
    integrator: &mut Integrator,
) -> Result<(), Error> {
    match input.below(12) {
        0..=3 => integrate(input, map, integrator)?,
        4 => map.set_occupied(&input.points(20))?,
        5 => map.set_free(&input.points(20))?,
        6 => map.pull(&input.points(20), input.f64() as f32, input.positive())?,
        7 => map.forget(input.f64s(), input.positive()),
        8 => {
            let separation = Separation {
                max_gap: input.positive(),
                min_confident: input.below(9),
                dilate: input.is_set(),
            };
            map.remove_separate(separation)?;
            map.remove_separate_from_background(separation)?;
            let _ = map.has_background();
        }
        9 => {
            map.is_floating(&input.points(5), input.positive())?;
        }
        10 => {
            let points = input.points(20);
            let labels = input.beside(points.len(), |input| i32::from(input.byte()) % 8 - 1);
            let rules = ClassifyParameters {
                search_distance: input.positive(),
                min_points: 1 + input.below(3),
                group_distance: input.maybe(Input::positive),
                max_extent: input.maybe(Input::positive),
                own_shadow: input.is_set(),
                ..ClassifyParameters::default()
            };
            let workers = Workers::new(1)?;
            classify_clusters(map, &points, &labels, input.f64s(), &rules, &workers)?;
        }
        _ => {
            let points = input.points(8);
            let _ =
                (map.values_at(&points), map.states_at(&points), map.state(points.len() as f32));
            let _ = (map.observed_voxels(), map.stored_voxels(), map.memory_bytes());
            let _ = map.occupied_voxels();
            map.set_skip(input.one_of(&[Skip::Nothing, Skip::Saturated]));
            if input.rarely() {
                map.clear();
            }
        }
    }
    Ok(())
}

fn integrate(
    input: &mut Input<'_>,
    map: &mut VoxelMap,
    integrator: &mut Integrator,
) -> Result<(), Error> {
    let points = input.points(60);
    let count = points.len();
    let numbers = input.beside(count, |input| input.one_of(&[1, 1, 2, 3, 0, 4]));
    let class = classes_from_numbers(&numbers)?;
    let origins = input.maybe(|input| input.beside(count, |input| input.f64s()));
    let directions = input.maybe(|input| input.beside(count, |input| input.f32s()));
    let no_return = input.maybe(|input| input.beside(count, Input::rarely));
    let no_ray = input.maybe(|input| input.beside(count, Input::rarely));
    let reach = input.maybe(|input| input.beside(count, |input| input.positive() as f32));
    let one = input.f64s();
    let scan = ClassifiedScan {
        points: &points,
        class: &class,
        origins: origins.as_deref().map_or(Origins::One(one), Origins::Each),
        directions: directions.as_deref(),
        no_return: no_return.as_deref(),
        no_ray: no_ray.as_deref(),
        reach: reach.as_deref(),
        pose_error: None,
    };
    integrator.integrate(map, &scan)?;
    Ok(())
}

pub fn detector(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let mut parameters =
        if input.rarely() { FlyingParameters::paper() } else { flying_parameters() };
    if input.is_set() {
        parameters.default_sensor = SensorParameters::default();
    }
    parameters.map = any_map_parameters(&mut input);
    parameters.forget_distance = input.maybe(Input::positive);
    parameters.few_returns_distance = input.maybe(Input::positive);
    parameters.cluster_voxels = input.is_set();
    parameters.mismatch_share = input.maybe(Input::share);
    let Ok(mut detector) = FlyingObjectDetector::new(parameters.clone(), 1) else { return };
    let mut stamp_ns = 0;
    for _ in 0..12 {
        if input.is_empty() {
            break;
        }
        stamp_ns = input.stamp(stamp_ns);
        // A state takes longer than a scan.
        let before = input.rarely().then(|| detector.to_state().ok());
        match (before, fly(&mut input, &mut detector, stamp_ns)) {
            (None, _) | (_, Err(Error::Interrupted) | Ok(())) => {}
            // A refused call changes nothing.
            (Some(before), Err(_)) => assert_eq!(before, detector.to_state().ok()),
        }
    }
    let state = detector.to_state().ok();
    let again = state.as_ref().map(|state| FlyingObjectDetector::from_state(parameters, 1, state));
    let again = again.and_then(|made| made.ok()).and_then(|detector| detector.to_state().ok());
    assert_eq!(again, state);
}

/// Scans of rooms, from poses that may jump: enough returns to decide whether a pose is right.
pub fn rooms(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let mut parameters = flying_parameters();
    parameters.mismatch_share = Some(input.share());
    let Ok(mut detector) = FlyingObjectDetector::new(parameters, 1) else { return };
    let mut stamp_ns = 0;
    for _ in 0..12 {
        if input.is_empty() {
            break;
        }
        stamp_ns = input.stamp(stamp_ns);
        let pose = if input.rarely() { input.pose() } else { UNMOVED };
        let points = room(&mut input);
        let _ = detector.process(&RawScan {
            sensor: input.one_of(&["lidar", "lidar", "lidar", "second"]),
            stamp_ns,
            organised: false,
            points: &points,
            no_return: None,
            directions: None,
            point_time_ns: None,
            poses: &[pose],
            pose_stamps_ns: None,
            pose_covariance: None,
        });
        if input.rarely() {
            detector.reanchor();
        }
    }
}

/// Walls, floor and ceiling around the sensor, a return in every voxel: as many as decide about a
/// pose, and close enough together to be background.
fn room(input: &mut Input<'_>) -> Vec<[f32; 3]> {
    let cells = input.one_of(&[4_u8, 4, 9]);
    let half = f32::from(cells) / 4.0;
    let place = move |cell: u8| (f32::from(cell) + 0.5) / 4.0 - half;
    let across = 0..2 * cells;
    let both = across.clone().flat_map(|u| across.clone().map(move |v| (place(u), place(v))));
    let faces = both.flat_map(|(u, v)| {
        let sides = [[half, u, v], [-half, u, v], [u, half, v]];
        sides.into_iter().chain([[u, -half, v], [u, v, half], [u, v, -half]])
    });
    faces.collect()
}

fn fly(
    input: &mut Input<'_>,
    detector: &mut FlyingObjectDetector,
    stamp_ns: i64,
) -> Result<(), Error> {
    match input.below(12) {
        0..=7 => {
            let points = if input.is_set() { room(input) } else { input.points(60) };
            let count = points.len();
            let no_return = input.maybe(|input| input.beside(count, Input::rarely));
            let directions = input.maybe(|input| input.beside(count, |input| input.f32s()));
            let times = input.maybe(|input| {
                input.beside(count, |input| stamp_ns.saturating_add(i64::from(input.byte()) << 18))
            });
            let poses = if input.rarely() { input.many(4, Input::pose) } else { vec![UNMOVED] };
            let mut pose_ns = stamp_ns;
            let stamps = (poses.len() > 1).then(|| {
                input.beside(poses.len(), |input| {
                    pose_ns = input.stamp(pose_ns);
                    pose_ns
                })
            });
            detector.process(&RawScan {
                sensor: input.one_of(&["lidar", "lidar", "second", ""]),
                stamp_ns,
                organised: input.rarely(),
                points: &points,
                no_return: no_return.as_deref(),
                directions: directions.as_deref(),
                point_time_ns: times.as_deref(),
                poses: &poses,
                pose_stamps_ns: stamps.as_deref(),
                pose_covariance: input.maybe(Input::covariance),
            })?;
        }
        8 => detector.set_known(&input.many(9, |input| input.f64s()), input.is_set())?,
        9 => {
            let teammates = input.many(3, |input| Teammate {
                id: i64::from(input.byte()),
                position: input.f64s(),
                radius: input.positive(),
            });
            detector.set_teammates(teammates);
        }
        10 => {
            detector.reanchor();
            detector.make_static_map();
            let _ = (detector.sky_rays(), detector.static_points());
            let _ = (detector.tracks_at(stamp_ns), detector.hypotheses_at(stamp_ns));
            let _ = (detector.in_map(&[[0.0; 3]]), detector.world_from_map());
        }
        _ => {
            if input.rarely() {
                detector.reset()?;
            }
            paths(detector);
        }
    }
    Ok(())
}

pub fn tracker(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let mut parameters =
        if input.is_set() { TrackerParameters::paper() } else { TrackerParameters::default() };
    parameters.buffer_size = 1 + input.below(12);
    parameters.max_extent = input.maybe(Input::positive);
    parameters.split_distance = input.maybe(Input::positive);
    parameters.occupied_distance = input.positive();
    let Ok(mut tracker) = PointCloudTracker::new(parameters, 1) else { return };
    let mut stamp_ns = 0;
    for _ in 0..24 {
        if input.is_empty() {
            break;
        }
        stamp_ns = input.stamp(stamp_ns);
        let before = tracker.to_state().ok();
        if track(&mut input, &mut tracker, stamp_ns).is_err() {
            assert_eq!(before, tracker.to_state().ok()); // a refused call changes nothing
        }
    }
    let _ = tracker.parameters();
    let state = tracker.to_state().ok();
    let again = state.as_ref().map(|state| PointCloudTracker::from_state(parameters, 1, state));
    let refused = again.as_ref().and_then(|made| made.as_ref().err().map(Error::to_string));
    assert_eq!(refused, None);
    let again = again.and_then(|made| made.ok()).and_then(|tracker| tracker.to_state().ok());
    assert_eq!(again, state);
}

fn track(
    input: &mut Input<'_>,
    tracker: &mut PointCloudTracker,
    stamp_ns: i64,
) -> Result<(), Error> {
    let occupied = OccupiedPoints::new(&input.points(4), input.positive());
    match input.below(8) {
        0..=3 => {
            let points = input.points(40);
            let delays =
                input.maybe(|input| input.beside(points.len(), |input| input.share() as f32));
            tracker.new_point_cloud(&points, delays.as_deref(), &occupied, None, stamp_ns)?;
        }
        4..=6 => {
            let late_ns = stamp_ns.saturating_sub(i64::from(input.below(3) as u8) * STEP_NS);
            let positions = input.many(6, |input| input.f64s());
            let count = positions.len();
            let covariance = input.maybe(|input| input.beside(count, Input::covariance));
            let extent = input.maybe(|input| input.beside(count, |input| input.f64s()));
            let delay = input.maybe(|input| input.beside(count, Input::share));
            let confidence = input.maybe(|input| input.beside(count, Input::share));
            let joined = input.maybe(|input| input.beside(count, Input::rarely));
            let among = input.maybe(|input| input.beside(count, Input::rarely));
            let detections = Detections {
                stamp_ns: late_ns,
                positions: &positions,
                covariance: covariance.as_deref(),
                extent: extent.as_deref(),
                delay: delay.as_deref(),
                confidence: confidence.as_deref(),
                is_joined: joined.as_deref(),
                is_among_surfaces: among.as_deref(),
                shape: None,
            };
            tracker.new_detections(&detections, &occupied)?;
        }
        _ => {
            tracker.check_stamp(stamp_ns)?;
            let _ = (tracker.tracks_at(stamp_ns), tracker.moved_by(input.positive()));
            tracker.drop_near(&occupied, input.positive());
            if input.rarely() {
                tracker.reset();
            }
        }
    }
    Ok(())
}

pub fn functions(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let points = input.points(12);
    let pose = Transform::from_matrix(&input.pose());
    let covariance = input.covariance();
    if let (Ok(found), Ok(lattice)) = (
        point_covariance(&points, &pose, &covariance, input.positive()),
        Lattice::new(input.positive(), input.f64s()),
    ) {
        let world: Vec<_> = points.iter().map(|point| point.map(f64::from)).collect();
        let _ = hit_probability(&world, &found, &lattice, 1);
    }
    let directions = input.many(20, |input| input.f64s());
    let view = [input.f64(), input.f64()];
    let _ = detection_probability(
        &directions,
        input.positive(),
        &input.many(4, Input::positive),
        view,
        1,
    );
    let targets = input.many(12, |input| input.f64s());
    let _ = target_center(&targets, input.f64s(), &directions, input.positive());
    let _ = (
        filtered(input.f64() as f32, input.f64() as f32, input.share()),
        two_to_minus(input.f64()),
    );
    let (turn, reach) = (input.f64() % 20.0, input.f64() as f32);
    let ring: Vec<[f32; 3]> = (0..1280)
        .map(|at| {
            let azimuth = turn * f64::from(at) / 1280.0;
            [reach * azimuth.cos() as f32, reach * azimuth.sin() as f32, (at % 16) as f32 - 8.0]
        })
        .collect();
    let mut times = SweepTimes::default();
    for cloud in [&ring, &points, &ring] {
        let _ = times.parts(cloud, &pose);
    }
    let numbers = input.many(20, Input::byte);
    if let Ok(classes) = classes_from_numbers(&numbers) {
        assert_eq!(numbers_from_classes(classes), numbers);
    }
}
