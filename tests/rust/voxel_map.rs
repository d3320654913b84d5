//! Properties of the voxel map: order and threads do not matter, values stay between the levels,
//! removal with a history equals removal without.

use lidar_core::Error;
use lidar_core::flying::integrate::classified_scan::{ClassifiedScan, Origins};
use lidar_core::flying::integrate::integrator::Integrator;
use lidar_core::flying::map::parameters::{MapParameters, Separation};
use lidar_core::flying::map::voxel_map::VoxelMap;
use lidar_core::flying::point_class::PointClass::{self, Background, Flying, Invalid, Unknown};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// The same cases on every run.
fn seeded() -> ProptestConfig {
    ProptestConfig {
        cases: 100,
        rng_seed: RngSeed::Fixed(0),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

fn parameters() -> MapParameters {
    MapParameters { max_range: 5.0, ray_gain: 0.1, max_voxels: 1 << 22, ..MapParameters::default() }
}

type Entry = ([f32; 3], PointClass, [f64; 3], [f32; 3], bool); // point, class, origin, direction, no return

fn entry() -> impl Strategy<Value = Entry> {
    let point = prop_oneof![
        5 => prop::array::uniform3(-4.0..4.0_f32),
        20 => prop::array::uniform3(-3..3_i16).prop_map(|place| place.map(|v| f32::from(v) / 4.0)),
        1 => Just([f32::NAN, 0.0, 0.0]),
    ];
    let origin = prop::array::uniform3(-1.0..1.0_f64);
    let direction = prop::array::uniform3(-1.0..1.0_f32);
    (
        point,
        prop::sample::select(vec![Invalid, Background, Background, Background, Flying, Unknown]),
        origin,
        direction,
        prop::bool::weighted(0.1),
    )
}

fn scan() -> impl Strategy<Value = Vec<Entry>> {
    prop::collection::vec(entry(), 0..120)
}

fn integrate(
    map: &mut VoxelMap,
    integrator: &mut Integrator,
    entries: &[Entry],
) -> Result<(), Error> {
    let points: Vec<_> = entries.iter().map(|entry| entry.0).collect();
    let class: Vec<_> = entries.iter().map(|entry| entry.1).collect();
    let origins: Vec<_> = entries.iter().map(|entry| entry.2).collect();
    let directions: Vec<_> = entries.iter().map(|entry| entry.3).collect();
    let no_return: Vec<_> = entries.iter().map(|entry| entry.4).collect();
    let scan = ClassifiedScan {
        points: &points,
        class: &class,
        origins: Origins::Each(&origins),
        directions: Some(&directions),
        no_return: Some(&no_return),
        no_ray: None,
        reach: None,
        pose_error: None,
    };
    integrator.integrate(map, &scan).map(|_| ())
}

fn fail(error: Error) -> TestCaseError {
    TestCaseError::fail(error.to_string())
}

/// A voxel of a plane of 6 x 6 across the border of four blocks.
fn place() -> impl Strategy<Value = [f32; 3]> {
    prop::array::uniform2(-3..3_i16)
        .prop_map(|[x, y]| [f32::from(x) / 4.0, f32::from(y) / 4.0, 0.0])
}

/// Confidently occupied, tentatively so, or free.
fn level() -> impl Strategy<Value = f32> {
    prop::sample::select(vec![0.0, 0.0, 0.0, -100.0, -100.0, -1000.0])
}

/// Found by `make fuzz`: it had no accumulator, and panicked.
#[test]
fn the_default_integrator_integrates() -> Result<(), Error> {
    let entry = ([2.0, 0.1, 0.1], Background, [0.1; 3], [1.0, 0.0, 0.0], false);
    let (mut one, mut other) = (VoxelMap::new(parameters())?, VoxelMap::new(parameters())?);
    integrate(&mut one, &mut Integrator::default(), &[entry])?;
    integrate(&mut other, &mut Integrator::new(1)?, &[entry])?;
    assert!(one.observed_voxels() > 1);
    assert_eq!(one.to_bytes(), other.to_bytes());
    Ok(())
}

proptest! {
    #![proptest_config(seeded())]

    #[test]
    fn order_and_threads_do_not_change_a_bit(
        scans in prop::collection::vec(scan(), 1..4), threads in prop::sample::select(vec![2, 4, 7])
    ) {
        let mut one = VoxelMap::new(parameters()).map_err(fail)?;
        let mut many = VoxelMap::new(parameters()).map_err(fail)?;
        let mut alone = Integrator::new(1).map_err(fail)?;
        let mut shared = Integrator::new(threads).map_err(fail)?;
        for entries in scans {
            integrate(&mut one, &mut alone, &entries).map_err(fail)?;
            let reversed: Vec<Entry> = entries.into_iter().rev().collect();
            integrate(&mut many, &mut shared, &reversed).map_err(fail)?;
        }
        prop_assert_eq!(one.to_bytes(), many.to_bytes());
    }

    #[test]
    fn values_stay_between_the_levels(scans in prop::collection::vec(scan(), 1..4)) {
        let mut map = VoxelMap::new(parameters()).map_err(fail)?;
        let mut integrator = Integrator::new(1).map_err(fail)?;
        for entries in &scans {
            integrate(&mut map, &mut integrator, entries).map_err(fail)?;
        }
        let points: Vec<[f32; 3]> = (0..8000_i16)
            .map(|place| [place % 20, place / 20 % 20, place / 400].map(|v| f32::from(v) / 4.0 - 2.4))
            .collect();
        let values = map.values_at(&points);
        prop_assert!(values.iter().all(|value| (-1000.0..=0.0).contains(value)));
        let states = map.states_at(&points);
        let expected: Vec<u8> = values
            .iter()
            .map(|&v| u8::from(v >= -750.0) + u8::from(v >= -300.0) + u8::from(v >= -0.1))
            .collect();
        prop_assert_eq!(states, expected);
    }

    #[test]
    fn removal_with_a_history_equals_removal_without(
        steps in prop::collection::vec((scan(), 0..5_u8, 0..4_usize), 1..8)
    ) {
        let mut map = VoxelMap::new(parameters()).map_err(fail)?;
        let mut integrator = Integrator::new(1).map_err(fail)?;
        for (entries, gap, min_confident) in steps {
            integrate(&mut map, &mut integrator, &entries).map_err(fail)?;
            // Now and then the parameters change, which makes all groups candidates.
            let max_gap = if gap == 0 { 0.3 } else { 0.8 };
            let separation = Separation { max_gap, min_confident: 1 + min_confident / 3, dilate: false };
            let mut fresh = VoxelMap::from_bytes(&map.to_bytes()).map_err(fail)?;
            let changed = map.remove_separate(separation).map_err(fail)?;
            prop_assert_eq!(fresh.remove_separate(separation).map_err(fail)?, changed);
            prop_assert_eq!(map.has_background(), fresh.has_background());
            prop_assert_eq!(map.to_bytes(), fresh.to_bytes());
        }
    }
    #[test]
    fn groups_that_grow_and_fall_apart_are_removed_as_without_a_history(
        steps in prop::collection::vec(prop::collection::vec((place(), level()), 1..20), 1..30),
        min_confident in 1..6_usize,
        dilate in any::<bool>(),
    ) {
        let mut map = VoxelMap::new(parameters()).map_err(fail)?;
        let separation = Separation { max_gap: 0.3, min_confident, dilate };
        for changes in steps {
            for (place, level) in changes {
                map.pull(&[place], level, 30.0).map_err(fail)?;
            }
            let mut fresh = VoxelMap::from_bytes(&map.to_bytes()).map_err(fail)?;
            let changed = map.remove_separate(separation).map_err(fail)?;
            prop_assert_eq!(fresh.remove_separate(separation).map_err(fail)?, changed);
            prop_assert_eq!(map.has_background(), fresh.has_background());
            prop_assert_eq!(map.to_bytes(), fresh.to_bytes());
        }
    }
}
