//! Tests of the observation of the sky.

use super::super::grid::PARTS;
use super::super::{Beams, Sky};
use super::*;
use crate::Error;
use crate::flying::map::parameters::tests::parameters;

/// Returns of a ring-shaped wall all around, from -0.3 m to `top` [m] in height, with a gap of 60
/// degrees.
fn wall(range: f64, top: f64) -> Vec<[f32; 3]> {
    let mut points = Vec::new();
    for cell in 0..CELLS {
        for part in 0..PARTS * PARTS {
            let direction = wide(GRID.parts[cell * PARTS * PARTS + part]);
            let is_gap = direction[1].abs() < 0.577 * direction[0];
            if (-0.3..top).contains(&direction[2]) && !is_gap {
                points.push(direction.map(|value| (range * value) as f32));
            }
        }
    }
    points
}

fn observe(sky: &mut Sky, map: &VoxelMap, scans: &[Vec<[f32; 3]>]) -> SkyObservation {
    let mut observation = SkyObservation::default();
    for (number, points) in scans.iter().enumerate() {
        let scan = ScanToObserve {
            points,
            no_return: None,
            map_from_lidar: &Transform::IDENTITY,
            stamp_ns: number as i64 * 100_000_000,
            is_masked: &|_| false,
            map,
        };
        observation.fill(sky, &scan);
        if number + 1 < scans.len() {
            sky.take(&mut observation, points);
        }
    }
    observation
}

fn gap_is_sky(observation: &SkyObservation) -> bool {
    observation.directions.iter().any(|direction| direction[0] > 0.99 && direction[2] > 0.0)
}

#[test]
fn the_gap_in_a_wall_is_sky_and_what_was_never_looked_at_is_not() -> Result<(), Error> {
    let map = VoxelMap::new(parameters())?;
    let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
    let observation = observe(&mut sky, &map, &vec![wall(30.0, 0.5); 5]);
    assert!(
        gap_is_sky(&observation) && observation.share > 0.05 && observation.share < 0.2,
        "{}",
        observation.share
    );
    for cell in (0..CELLS).filter(|&cell| observation.is_sky[cell]) {
        let direction = GRID.centers[cell];
        assert!(direction[2] < 0.58, "{direction:?}"); // a cell beside the highest returns
        assert!(direction[0] > 0.8 * direction[1].abs() || direction[2] > 0.4, "{direction:?}");
    }
    Ok(())
}

#[test]
fn a_scan_that_is_not_accepted_changes_nothing() -> Result<(), Error> {
    let map = VoxelMap::new(parameters())?;
    let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
    let first = observe(&mut sky, &map, &vec![wall(30.0, 0.5); 5]).reach;
    let before = format!("{sky:?}");
    let mut observation = SkyObservation::default();
    let points = wall(5.0, 0.1);
    let scan = ScanToObserve {
        points: &points,
        no_return: None,
        map_from_lidar: &Transform::IDENTITY,
        stamp_ns: 700_000_000,
        is_masked: &|_| false,
        map: &map,
    };
    observation.fill(&sky, &scan);
    assert_eq!(before, format!("{sky:?}"));
    assert!(!first.is_empty());
    Ok(())
}

#[test]
fn a_sensor_that_is_covered_sees_no_sky() -> Result<(), Error> {
    let map = VoxelMap::new(parameters())?;
    let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
    let mut scans = vec![wall(30.0, 0.5); 6];
    let few = scans[0].iter().copied().filter(|point| point[1] < -15.0).collect();
    scans.push(few);
    let observation = observe(&mut sky, &map, &scans);
    assert!(observation.directions.is_empty() && observation.share == 0.0);
    Ok(())
}

#[test]
fn nobody_gets_used_to_a_covered_sensor() -> Result<(), Error> {
    let map = VoxelMap::new(parameters())?;
    let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
    let mut scans = vec![wall(30.0, 0.5); 6];
    let few: Vec<[f32; 3]> = scans[0].iter().copied().filter(|point| point[1] < -15.0).collect();
    scans.extend(vec![few; 60]);
    assert!(observe(&mut sky, &map, &scans).directions.is_empty());
    Ok(())
}

#[test]
fn far_returns_do_not_make_rays_longer_than_those_of_the_map() -> Result<(), Error> {
    let map = VoxelMap::new(parameters())?;
    let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
    let observation = observe(&mut sky, &map, &vec![wall(1e6, 0.5); 5]);
    assert!(!observation.reach.is_empty());
    assert!(observation.reach.iter().all(|&reach| reach <= 20.0));
    Ok(())
}

#[test]
fn rays_of_sky_end_before_what_returns_have_shown_until_they_are_trusted() -> Result<(), Error> {
    let mut map = VoxelMap::new(parameters())?;
    let screen: Vec<[f32; 3]> = (0..400)
        .map(|index| [10.0, (index % 20) as f32 * 0.25 - 2.5, (index / 20) as f32 * 0.25 - 2.5])
        .collect();
    map.set_occupied(&screen)?;
    let ahead = |observation: &SkyObservation| {
        let ray = observation.directions.iter().position(|direction| direction[0] > 0.995);
        ray.map(|ray| f64::from(observation.reach[ray]))
    };
    for (scans, expected) in [(5, 9.75), (30, 20.0)] {
        let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
        let observation = observe(&mut sky, &map, &vec![wall(30.0, 0.5); scans]);
        let reach = ahead(&observation).ok_or(Error::Interrupted)?;
        assert!((reach - expected).abs() < 0.3, "{reach} after {scans} scans");
    }
    Ok(())
}

#[test]
fn near_surfaces_limit_the_rays_beside_them_and_small_things_do_not() -> Result<(), Error> {
    let map = VoxelMap::new(parameters())?;
    let reach_ahead = |thing: f32| -> Result<f64, Error> {
        let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
        let mut points = wall(30.0, 0.5);
        for cell in 0..CELLS {
            let [x, y, z] = GRID.centers[cell].map(|value| value as f32);
            if x > 0.9 && (z - 0.2).abs() < 0.02 && (0.0..thing).contains(&y) {
                points.push([8.0 * x, 8.0 * y, 8.0 * z]);
            }
        }
        let observation = observe(&mut sky, &map, &vec![points; 5]);
        let near = |direction: &[f32; 3]| {
            direction[1].abs() < 0.1 && (direction[2] - 0.2).abs() < 0.1 && direction[0] > 0.0
        };
        let rays =
            observation.directions.iter().zip(&observation.reach).filter(|(ray, _)| near(ray));
        Ok(rays.map(|(_, &reach)| f64::from(reach)).fold(f64::INFINITY, f64::min))
    };
    assert!(reach_ahead(0.06)? > 15.0);
    assert!(reach_ahead(0.4)? < 8.0);
    Ok(())
}

#[test]
fn rays_stay_above_the_lowest_returns() -> Result<(), Error> {
    let map = VoxelMap::new(parameters())?;
    let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
    let observation = observe(&mut sky, &map, &vec![wall(15.0, 0.5); 5]); // down to -4.5 m
    for (direction, &reach) in observation.directions.iter().zip(&observation.reach) {
        assert!(dot(wide(*direction), [0.0, 0.0, 1.0]) * f64::from(reach) > -3.5);
    }
    assert!(observation.directions.iter().any(|direction| direction[2] < -0.1));
    Ok(())
}

/// Returns of 21 rows, 2 degrees apart, on a sphere of 15 m. `shift`: angle by which a row is
/// shifted, from its number and the azimuth. `is_near`: whether a return is at 5 m, from azimuth
/// and elevation [degrees].
fn rows(shift: fn(i32, i32) -> f64, is_near: fn(f64, f64) -> bool) -> Vec<[f32; 3]> {
    let mut points = Vec::new();
    for row in -10..=10 {
        for column in -450..450 {
            let (azimuth, elevation) =
                (0.4 * f64::from(column), 2.0 * f64::from(row) + shift(row, column));
            let range = if is_near(azimuth, elevation) { 5.0 } else { 15.0 };
            let ((sin, cos), (up, flat)) =
                (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
            points.push([flat * cos, flat * sin, up].map(|value| (range * value) as f32));
        }
    }
    points
}

#[test]
fn gaps_of_rows_are_free_beside_what_is_small_and_not_beside_surfaces() -> Result<(), Error> {
    let map = VoxelMap::new(parameters())?;
    let least_beside = |points: Vec<[f32; 3]>| -> Result<f64, Error> {
        let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
        let observation = observe(&mut sky, &map, &vec![points; 5]);
        let beside = |direction: &[f32; 3]| {
            let [azimuth, elevation] = [direction[1].atan2(direction[0]), direction[2].asin()];
            (5.2..5.8).contains(&azimuth.to_degrees()) && elevation.to_degrees().abs() < 1.0
        };
        let rays = observation.directions.iter().zip(&observation.reach);
        let reach: Vec<f64> =
            rays.filter(|(ray, _)| beside(ray)).map(|(_, &reach)| f64::from(reach)).collect();
        assert!(!reach.is_empty());
        Ok(reach.into_iter().fold(f64::INFINITY, f64::min))
    };
    let ball = |azimuth: f64, elevation: f64| azimuth.abs() < 3.5 && elevation.abs() < 3.5;
    let still = |_: i32, _: i32| 0.0;
    let reach = least_beside(rows(still, ball))?;
    assert!(reach > 14.0, "{reach}");
    // The opposites: a surface may go on beside what is seen of it; without rows later scans look there.
    assert!(least_beside(rows(still, |azimuth, _| azimuth.abs() < 3.5))? < 5.0);
    let scattered =
        |row: i32, column: i32| f64::from((7 * row + 13 * column).rem_euclid(20)) * 0.1 - 1.0;
    assert!(least_beside(rows(scattered, ball))? < 5.0);
    Ok(())
}
