//! Properties of the detector: threads do not matter, refused scans leave no trace, several LiDARs
//! may share a time.

use lidar_core::Error;
use lidar_core::flying::background::parameters::SeedParameters;
use lidar_core::flying::classify::parameters::ClassifyParameters;
use lidar_core::flying::detector::FlyingObjectDetector;
use lidar_core::flying::integrate::pose_weights::PoseParameters;
use lidar_core::flying::map::parameters::{MapParameters, Separation};
use lidar_core::flying::parameters::FlyingParameters;
use lidar_core::flying::reporting_gate::ReportingGate;
use lidar_core::flying::scan::prepared::RawScan;
use lidar_core::flying::scan::sensor::SensorParameters;
use lidar_core::flying::sky::Beams;
use lidar_core::flying::track::{Confirmation, TrackerParameters};
use lidar_core::geometry::cluster::Clustering;
use lidar_core::util::cancel::Cancel;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const STEP_NS: i64 = 100_000_000;

/// The same cases on every run.
fn seeded() -> ProptestConfig {
    ProptestConfig {
        cases: 24,
        rng_seed: RngSeed::Fixed(0),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

/// Best mode for short scenes: a small map, a short burn-in, and nothing that is found by itself.
fn parameters() -> FlyingParameters {
    FlyingParameters {
        map: map(),
        clustering: Clustering { max_distance: 0.5, ..Clustering::default() },
        cluster_angle: 0.0,
        classify: ClassifyParameters {
            search_distance: 2.0,
            expand_own: false,
            max_extent: Some(1.5),
            min_points: 2,
            min_clearance: 0.0,
            upright_height: None,
            max_distance: None,
            fill_pockets: true,
            ..ClassifyParameters::default()
        },
        separation: Separation { min_confident: 4, ..Separation::default() },
        seed: SeedParameters {
            burn_in_scans: 3,
            burn_in_period: None,
            burn_in_extent: 1.0,
            standing_scans: 0,
            ground_height: Some(-1.4),
            ..SeedParameters::default()
        },
        default_sensor: SensorParameters {
            learn_mask_scans: 0,
            beams: Beams::Given,
            find_body: false,
            ..SensorParameters::default()
        },
        tracker: TrackerParameters {
            max_extent: Some(1.5),
            confirmation: Confirmation::Counts { hits: 2, window: 10 },
            ..TrackerParameters::default()
        },
        pose: PoseParameters::paper(),
        ..FlyingParameters::default()
    }
}

fn map() -> MapParameters {
    MapParameters { max_range: 10.0, max_voxels: 1 << 22, ..MapParameters::default() }
}

fn pose(x: f64, y: f64) -> [f64; 16] {
    [1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, y, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
}

/// Floor 1.5 m below, a ball of points at `target`, both seen from the origin.
fn points(target: [f32; 3]) -> Vec<[f32; 3]> {
    let floor = (0..3600).map(|k| [(k / 60) as f32 * 0.2 - 6.0, (k % 60) as f32 * 0.2 - 6.0, -1.5]);
    let ball = (0..27).map(|k| {
        let step = |n: i32| (n % 3 - 1) as f32 * 0.15;
        [target[0] + step(k), target[1] + step(k / 3), target[2] + step(k / 9)]
    });
    floor.chain(ball).collect()
}

fn scan<'a>(points: &'a [[f32; 3]], poses: &'a [[f64; 16]], stamp_ns: i64) -> RawScan<'a> {
    RawScan {
        organised: true,
        sensor: "lidar",
        stamp_ns,
        points,
        no_return: None,
        directions: None,
        point_time_ns: None,
        poses,
        pose_stamps_ns: None,
        pose_covariance: None,
    }
}

/// Everything that can be seen of a detector.
fn state(detector: &FlyingObjectDetector) -> (Vec<u8>, String) {
    (detector.map().to_bytes(), format!("{:?}", detector.tracks_at(10 * STEP_NS)))
}

fn fail(error: Error) -> TestCaseError {
    TestCaseError::fail(error.to_string())
}

type Flight = Vec<([f32; 3], f64)>; // place of the target, seen from the sensor; x of the sensor

fn flight() -> impl Strategy<Value = Flight> {
    let target = (1.5..2.5_f32, -2.0..2.0_f32, -0.3..1.0_f32).prop_map(|(x, y, z)| [x, y, z]);
    prop::collection::vec((target, -0.5..0.5_f64), 4..9)
}

/// Scans that must be refused, whatever came before.
fn refused(detector: &mut FlyingObjectDetector, stamp_ns: i64) -> Vec<bool> {
    let all = points([2.0, 0.0, 0.0]);
    let (here, far) = ([pose(0.0, 0.0)], [pose(1e12, 0.0)]);
    let broken = [pose(f64::NAN, 0.0)];
    let (stray, flags) = ([[1e30, 0.0, 0.0]], [true; 3]);
    let scans = [
        scan(&all, &broken, stamp_ns),
        scan(&all, &[], stamp_ns),
        scan(&stray, &here, stamp_ns),
        RawScan { no_return: Some(&flags), ..scan(&all, &here, stamp_ns) },
        RawScan { directions: Some(&stray), ..scan(&all, &here, stamp_ns) },
        RawScan { point_time_ns: Some(&[0]), ..scan(&all, &here, stamp_ns) },
        RawScan { pose_stamps_ns: Some(&[0, 1]), ..scan(&all, &here, stamp_ns) },
    ];
    let mut outcome: Vec<bool> = scans.iter().map(|raw| detector.process(raw).is_err()).collect();
    if stamp_ns > 0 {
        outcome.push(detector.process(&scan(&all, &far, stamp_ns)).is_err());
        outcome.push(detector.process(&scan(&all, &here, stamp_ns - STEP_NS)).is_err());
        let cancel = Cancel::default();
        assert!(cancel.ask_if(|| true));
        outcome.push(cancel.run(|| detector.process(&scan(&all, &here, stamp_ns))).is_err());
    }
    outcome
}

proptest! {
    #![proptest_config(seeded())]

    #[test]
    fn any_number_of_threads_gives_the_same_bits(flight in flight()) {
        let mut all = Vec::new();
        for threads in [1, 2, 4] {
            let mut detector = FlyingObjectDetector::new(parameters(), threads).map_err(fail)?;
            let mut frames = String::new();
            for (number, &(target, x)) in flight.iter().enumerate() {
                let (points, poses) = (points(target), [pose(x, 0.0)]);
                let raw = scan(&points, &poses, number as i64 * STEP_NS);
                let frame = detector.process(&raw).map_err(fail)?;
                frames += &format!("{:?}", (frame.detections, frame.tracks, frame.point_class));
            }
            all.push((state(&detector), frames));
        }
        prop_assert!(all[0] == all[1] && all[0] == all[2]);
    }

    #[test]
    fn refused_scans_leave_no_trace(flight in flight()) {
        let mut detector = FlyingObjectDetector::new(parameters(), 1).map_err(fail)?;
        let mut twin = FlyingObjectDetector::new(parameters(), 1).map_err(fail)?;
        for (number, &(target, x)) in flight.iter().enumerate() {
            let stamp_ns = number as i64 * STEP_NS;
            let before = state(&detector);
            let outcome = refused(&mut detector, stamp_ns);
            prop_assert!(outcome.iter().all(|&refused| refused), "{outcome:?}");
            prop_assert!(state(&detector) == before);
            let (points, poses) = (points(target), [pose(x, 0.0)]);
            for detector in [&mut detector, &mut twin] {
                detector.process(&scan(&points, &poses, stamp_ns)).map_err(fail)?;
            }
            prop_assert!(state(&detector) == state(&twin));
        }
    }
}

#[test]
fn four_lidars_may_share_a_time_and_one_may_lag() -> Result<(), Error> {
    let mut detector = FlyingObjectDetector::new(parameters(), 1)?;
    let (points, poses) = (points([2.0, 0.0, 0.5]), [pose(0.0, 0.0)]);
    let at = |sensor, number| RawScan { sensor, ..scan(&points, &poses, number * STEP_NS) };
    for number in 0..3 {
        for sensor in ["a", "b", "c", "d"] {
            detector.process(&at(sensor, number))?;
        }
    }
    for number in 4..7 {
        detector.process(&at("a", number))?;
        detector.process(&at("b", number - 1))?;
    }
    assert!(matches!(detector.process(&at("b", 5)), Err(Error::Time { .. })));
    Ok(())
}

#[test]
fn a_scan_that_does_not_fit_leaves_not_even_the_seed() -> Result<(), Error> {
    let (points, poses) = (points([2.0, 0.0, 0.5]), [pose(0.0, 0.0)]);
    let mut free = FlyingObjectDetector::new(parameters(), 1)?;
    free.process(&scan(&points, &poses, 0))?;
    let budget = free.map().stored_voxels() as u64;
    let seed = SeedParameters { take_off_height: Some(50.0), ..parameters().seed };
    let map = MapParameters { max_voxels: budget, ..map() };
    let tight = FlyingParameters { seed, map, ..parameters() };
    let mut detector = FlyingObjectDetector::new(tight, 1)?;
    let before = state(&detector);
    assert!(matches!(detector.process(&scan(&points, &poses, 0)), Err(Error::Limit { .. })));
    assert!(state(&detector) == before);
    Ok(())
}

#[test]
fn a_jump_is_held_and_undone_by_its_own_lidar() -> Result<(), Error> {
    let mut detector = FlyingObjectDetector::new(parameters(), 1)?;
    let points = points([2.0, 0.0, 0.5]);
    let at_height = |z: f64| {
        let mut pose = pose(0.0, 0.0);
        pose[11] = z;
        [pose]
    };
    // 1 m higher the floor lies where rays passed.
    let (still, up, higher) = (at_height(0.0), at_height(1.0), at_height(2.0));
    for number in 0..6 {
        detector.process(&scan(&points, &still, number * STEP_NS))?;
    }
    let before = state(&detector);
    let frame = detector.process(&scan(&points, &up, 6 * STEP_NS))?;
    assert!(
        matches!(frame.gate, ReportingGate::PoseMismatch { .. }) && frame.detections.is_empty()
    );
    assert!(state(&detector) == before);
    assert!(detector.reanchor() && !detector.reanchor());
    let frame = detector.process(&scan(&points, &up, 7 * STEP_NS))?;
    assert_eq!(frame.gate, ReportingGate::Open);
    assert_eq!(detector.world_from_map().translation, [0.0, 0.0, 1.0]);
    let stranger = RawScan { sensor: "other", ..scan(&points, &higher, 8 * STEP_NS) };
    assert!(matches!(detector.process(&stranger)?.gate, ReportingGate::PoseMismatch { .. }));
    assert!(!detector.reanchor()); // it had no scan before
    Ok(())
}
