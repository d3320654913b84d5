//! Tests: rays that skip saturated space leave the same map as rays that visit every voxel.

use super::classified_scan::{ClassifiedScan, IntegrateStats, Origins};
use super::integrator::Integrator;
use super::pose_weights::{PoseError, PoseWeighting};
use crate::Error;
use crate::flying::map::parameters::{MapParameters, RayUnit, Rays, Separation, Skip};
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::PointClass;
use crate::geometry::transform::Transform;

/// Half the sides of the room with the sensor in it [m].
const ROOM: [f64; 3] = [6.0, 4.5, 2.5];
/// Number of rays of a scan. Each scan turns them a little.
const RAYS: u32 = 2500;

/// A scan that owns its arrays.
struct OwnedScan {
    points: Vec<[f32; 3]>,
    class: Vec<PointClass>,
    directions: Vec<[f32; 3]>,
    no_return: Vec<bool>,
    origins: Vec<[f64; 3]>,
    error: Option<PoseError>,
}

impl OwnedScan {
    /// Scan `step` of a sensor that moves through a room with a window, in which a ball flies.
    fn of(case: &Case, step: u32) -> Self {
        let time = f64::from(step);
        let sensor = if step.is_multiple_of(2) { 0.0 } else { case.second_sensor };
        let start = [0.03 * time - 1.0 + sensor, 0.4 * (0.11 * time).sin() + sensor, 0.0];
        let ball = [1.5 + 0.02 * time, 2.0 * (0.07 * time).cos(), 0.5];
        let mut made = Self {
            points: Vec::new(),
            class: Vec::new(),
            directions: Vec::new(),
            no_return: Vec::new(),
            origins: Vec::new(),
            error: case.weighting.map(|weighting| error(weighting, start)),
        };
        for ray in 0..case.rays {
            let turn = f64::from(ray) * 2.399_963 + 0.37 * time;
            let z = 1.0 - 2.0 * (f64::from(ray) + 0.5) / f64::from(case.rays);
            let (sin, cos) = libm::sincos(turn);
            let flat = (1.0 - z * z).sqrt();
            made.add(case, start, [flat * cos, flat * sin, z], ball, (ray * 31 + step) % 997);
        }
        made
    }

    fn add(&mut self, case: &Case, start: [f64; 3], way: [f64; 3], ball: [f64; 3], noise: u32) {
        let mut range = f64::INFINITY;
        for axis in 0..3 {
            let wall = case.stretch * ROOM[axis].copysign(way[axis]);
            range = range.min((wall - start[axis]) / way[axis]);
        }
        range += 0.04 * (f64::from(noise) / 997.0 - 0.5);
        let to_ball: [f64; 3] = std::array::from_fn(|axis| ball[axis] - start[axis]);
        let along: f64 = (0..3).map(|axis| to_ball[axis] * way[axis]).sum();
        let square: f64 = to_ball.iter().map(|value| value * value).sum::<f64>() - along * along;
        let hits_ball = along > 0.0 && square < 0.1 && along < range;
        range = if hits_ball { along - (0.1 - square).sqrt() } else { range };
        let is_away = !hits_ball && way[0] > 0.8 && way[2] > -0.2;
        let end = std::array::from_fn(|axis| (start[axis] + range * way[axis]) as f32);
        self.points.push(if is_away { [f32::NAN; 3] } else { end });
        self.class.push(match (is_away, hits_ball, noise % 50) {
            (true, ..) => PointClass::Invalid,
            (_, true, _) => {
                if noise.is_multiple_of(2) {
                    PointClass::Flying
                } else {
                    PointClass::Unknown
                }
            }
            (.., 0) => PointClass::Unknown,
            _ => PointClass::Background,
        });
        self.directions.push(way.map(|value| value as f32));
        self.no_return.push(is_away);
        let jitter = case.way_during_scan * f64::from(noise % 7) / 6.0;
        self.origins.push(start.map(|value| value + jitter));
    }

    fn scan(&self, case: &Case) -> ClassifiedScan<'_> {
        ClassifiedScan {
            points: &self.points,
            class: &self.class,
            origins: if case.way_during_scan > 0.0 {
                Origins::Each(&self.origins)
            } else {
                Origins::One(self.origins[0])
            },
            directions: Some(&self.directions),
            no_return: Some(&self.no_return),
            no_ray: None,
            reach: None,
            pose_error: self.error.as_ref(),
        }
    }
}

fn error(weighting: PoseWeighting, translation: [f64; 3]) -> PoseError {
    PoseError {
        weighting,
        world_from_lidar: Transform { translation, ..Transform::IDENTITY },
        map_from_world: Transform::IDENTITY,
        covariance: std::array::from_fn(|i| {
            std::array::from_fn(|j| if i == j { 0.0004 } else { 0.0 })
        }),
        range_std: 0.02,
        end_sigmas: 2.0,
    }
}

/// One case of the comparison: map, sensor and edits of a sequence of scans.
#[derive(Clone)]
struct Case {
    map: MapParameters,
    rays: u32,
    /// Size of the room, relative to the usual one.
    stretch: f64,
    second_sensor: f64,
    /// Distance that the sensor moves during a scan [m].
    way_during_scan: f64,
    weighting: Option<PoseWeighting>,
    /// Edits of the map by a user, called before each scan with its number.
    between: fn(&mut VoxelMap, u32) -> Result<(), Error>,
    scans: u32,
    /// Smallest share of visits that must have been skipped, so that the case tests the skipping.
    passed: f64,
}

impl Default for Case {
    fn default() -> Self {
        Self {
            map: MapParameters { ray_gain: 60.0, ..MapParameters::default() },
            rays: RAYS,
            stretch: 1.0,
            second_sensor: 0.0,
            way_during_scan: 0.0,
            weighting: None,
            between: |_, _| Ok(()),
            scans: 40,
            passed: 0.1,
        }
    }
}

const SEPARATION: Separation = Separation { max_gap: 0.75, min_confident: 20, dilate: true };

/// Edits of a map between scans: known walls and free space, forgetting, and a reload from bytes.
fn edit(map: &mut VoxelMap, step: u32) -> Result<(), Error> {
    let at = |x: f32| [[x, 0.3, 0.1], [x, 1.1, -0.6]];
    match step % 40 {
        0 => map.set_occupied(&at(2.1))?,
        7 => map.set_free(&at(-1.4))?,
        13 => map.pull(&at(0.6), 0.0, 1.5)?,
        19 => *map = again(map)?,
        26 => map.pull(&at(-0.4), -1000.0, 900.0)?,
        32 => map.forget([0.0; 3], 2.0),
        _ => {
            map.remove_separate_from_background(SEPARATION)?;
        }
    }
    Ok(())
}

/// The map after it was written to a file and read back. The file does not contain which voxels
/// rays may skip.
fn again(map: &VoxelMap) -> Result<VoxelMap, Error> {
    let mut again = VoxelMap::from_bytes(&map.to_bytes())?;
    again.set_skip(map.parameters().skip);
    Ok(again)
}

fn cases() -> Vec<(&'static str, Case)> {
    let usual = Case::default;
    let map = || usual().map;
    let with = |map: MapParameters| Case { map, ..usual() };
    vec![
        ("usual", usual()),
        ("moving during the scan", Case { way_during_scan: 0.024, ..usual() }),
        ("moving fast", Case { way_during_scan: 0.7, ..usual() }),
        ("moving too fast", Case { way_during_scan: 3.0, passed: 0.0, ..usual() }),
        ("two sensors", Case { second_sensor: 0.8, ..usual() }),
        ("ends weighted", Case { weighting: Some(PoseWeighting::Ends), ..usual() }),
        ("points weighted", Case { weighting: Some(PoseWeighting::Spread), ..usual() }),
        ("edited", Case { between: edit, passed: 0.01, ..usual() }),
        (
            "bounded",
            with(MapParameters { bounds: Some([[-3.1, -2.0, -0.9], [2.2, 9.0, 1.3]]), ..map() }),
        ),
        ("one ray per end", with(MapParameters { rays: Rays::OnePerEnd, ..map() })),
        (
            "diagonals",
            with(MapParameters { ray_unit: RayUnit::Diagonals, end_margin: 0.3, ..map() }),
        ),
        (
            "free is 0",
            with(MapParameters {
                g_free: 0.0,
                g_occ: 1000.0,
                g_unk: 300.0,
                initial: 300.0,
                thresholds: [250.0, 700.0, 999.0],
                ..map()
            }),
        ),
        ("unseen is free", with(MapParameters { initial: -1000.0, ..map() })),
        ("sparse", Case { rays: 300, passed: 0.0, ..usual() }),
        ("fine", Case { map: MapParameters { voxel_size: 0.1, ..map() }, passed: 0.0, ..usual() }),
        ("odd size", with(MapParameters { voxel_size: 0.3, ..map() })),
        (
            "window in pieces",
            Case {
                map: MapParameters { ray_gain: 400.0, max_range: 150.0, voxel_size: 1.0, ..map() },
                stretch: 27.0,
                scans: 9,
                rays: 10_000,
                passed: 0.01,
                ..usual()
            },
        ),
        (
            "far too many blocks",
            Case {
                map: MapParameters { ray_gain: 40.0, max_range: 400.0, voxel_size: 1.0, ..map() },
                stretch: 60.0,
                scans: 9,
                rays: 1000,
                passed: 0.0,
                ..usual()
            },
        ),
    ]
}

/// Run a case with and without skipping, and compare the maps. Returns an error if a scan fails.
fn compare(name: &str, case: &Case, threads: usize) -> Result<(), Error> {
    let make = |skip| VoxelMap::new(MapParameters { skip, ..case.map.clone() });
    let (mut plain, mut passing) = (make(Skip::Nothing)?, make(Skip::Saturated)?);
    let (mut one, mut other) = (Integrator::new(1)?, Integrator::that_always_passes(threads)?);
    let mut sums = [0, 0];
    for step in 0..case.scans {
        let made = OwnedScan::of(case, step);
        let expected = one.integrate(&mut plain, &made.scan(case))?;
        let stats = other.integrate(&mut passing, &made.scan(case))?;
        let all = IntegrateStats { visits_skipped: 0, voxels: expected.voxels, ..stats };
        assert_eq!(all, expected, "{name}, scan {step}");
        sums = [sums[0] + stats.visits_skipped, sums[1] + stats.visits];
        (case.between)(&mut plain, step)?;
        (case.between)(&mut passing, step)?;
        if step % 8 == 7 || step + 1 == case.scans {
            assert!(
                plain.to_bytes() == passing.to_bytes(),
                "{name}, scan {step}, {threads} threads"
            );
            assert_eq!(plain.memory_bytes(), passing.memory_bytes());
            assert_eq!(plain.occupied_voxels(), passing.occupied_voxels());
        }
    }
    let passed = sums[0] as f64 / sums[1] as f64;
    assert!(passed >= case.passed, "{name}: only {passed} of the visits were passed");
    Ok(())
}

#[test]
fn maps_are_the_same_to_the_bit_with_saturated_space_passed() -> Result<(), Error> {
    for (name, case) in cases() {
        compare(name, &case, 2)?;
    }
    compare("usual", &Case { scans: 80, passed: 0.5, ..Case::default() }, 1)
}

/// Long test. Run it with `cargo test --release -p lidar_core -- --ignored over_a_thousand_scans`.
#[test]
#[ignore = "minutes"]
fn maps_are_the_same_to_the_bit_over_a_thousand_scans_of_every_kind() -> Result<(), Error> {
    for (name, case) in cases() {
        // Where nothing is passed in the short test, the map takes longer to saturate.
        let scans = if case.scans < 40 { 60 } else { 1000 };
        let made = Case { scans, rays: case.rays.min(RAYS), ..case };
        compare(name, &made, 2)?;
    }
    Ok(())
}

#[test]
fn small_scans_visit_every_voxel_where_the_search_takes_longer() -> Result<(), Error> {
    let case = Case { rays: 200, ..Case::default() };
    let mut map = VoxelMap::new(case.map.clone())?;
    let mut integrator = Integrator::new(1)?;
    for step in 0..40 {
        let many = Case { rays: 12_000, ..case.clone() };
        let stats = integrator.integrate(&mut map, &OwnedScan::of(&many, step).scan(&many))?;
        assert!(step < 30 || stats.visits_skipped > stats.visits / 4, "scan {step}");
    }
    let few = integrator.integrate(&mut map, &OwnedScan::of(&case, 40).scan(&case))?;
    assert_eq!(few.visits_skipped, 0);
    Ok(())
}

#[test]
fn voxels_that_are_wrongly_held_inert_are_noticed() -> Result<(), Error> {
    let case = Case { map: MapParameters::default(), ..Case::default() };
    let make = |skip| VoxelMap::new(MapParameters { skip, ..case.map.clone() });
    let (mut plain, mut passing) = (make(Skip::Nothing)?, make(Skip::Saturated)?);
    let mut integrator = Integrator::that_always_passes(1)?;
    for step in 0..3 {
        let made = OwnedScan::of(&case, step);
        for map in [&mut plain, &mut passing] {
            integrator.integrate(map, &made.scan(&case))?;
        }
        assert_eq!(plain.to_bytes() == passing.to_bytes(), step < 2);
        if step == 1 {
            // Values are far from saturated after two scans.
            for slot in 0..passing.blocks.len() as u32 {
                if let Some(block) = passing.blocks.at_mut(slot) {
                    (0..64).for_each(|row| block.inert.note(row, &[f32::INFINITY; 8], 0.0));
                }
            }
        }
    }
    Ok(())
}
