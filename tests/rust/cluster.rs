//! Clustering against all pairs and a union-find without any grid.

use lidar_core::geometry::cluster::angular_gap::{AngularGap, label_seen};
use lidar_core::geometry::cluster::{Clustering, NOISE, label};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// The same cases on every run.
fn seeded() -> ProptestConfig {
    ProptestConfig {
        cases: 1500,
        rng_seed: RngSeed::Fixed(0),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

/// Multiples of an eighth make exact distances and duplicates common.
fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        40 => (-8..8_i16).prop_map(|eighths| f32::from(eighths) / 8.0),
        10 => -1.0..1.0_f32,
        1 => prop::sample::select(vec![f32::NAN, f32::INFINITY, 1e4, -1e4, 1e7]),
    ]
}

fn cloud() -> impl Strategy<Value = Vec<[f32; 3]>> {
    prop::collection::vec(prop::array::uniform3(coordinate()), 0..60)
}

fn clustering() -> impl Strategy<Value = Clustering> {
    let distances = vec![0.125, 0.25, 0.125 * 3f64.sqrt(), 0.3, 0.5, 1.0];
    (prop::sample::select(distances), 1..4_usize, prop::option::of(1..30_usize)).prop_map(
        |(max_distance, min_points, max_points)| Clustering {
            max_distance,
            min_points,
            max_points,
        },
    )
}

fn gap() -> impl Strategy<Value = AngularGap> {
    let angles = vec![0.0, 0.01, 0.125, 0.25, 0.5];
    let place = prop::array::uniform3((-40..40_i16).prop_map(|eighths| f64::from(eighths) / 8.0));
    (place, prop::sample::select(angles))
        .prop_map(|(origin, max_angle)| AngularGap { origin, max_angle })
}

/// Every point takes the smallest root among those it is linked to, until nothing changes.
fn slow(points: &[[f32; 3]], gap: &AngularGap, clustering: &Clustering) -> Vec<i32> {
    let finite = |p: &[f32; 3]| p.iter().all(|value| value.is_finite());
    let linked = |p: &[f32; 3], q: &[f32; 3]| {
        let square: f64 =
            (0..3).map(|axis| (f64::from(p[axis]) - f64::from(q[axis])).powi(2)).sum();
        let range = |point: &[f32; 3]| -> f64 {
            (0..3).map(|axis| (f64::from(point[axis]) - gap.origin[axis]).powi(2)).sum()
        };
        let seen = gap.max_angle * gap.max_angle * range(p).min(range(q));
        let reach = (clustering.max_distance * clustering.max_distance).max(seen);
        finite(p) && finite(q) && square <= reach
    };
    let mut roots: Vec<usize> = (0..points.len()).collect();
    let mut changed = true;
    while changed {
        changed = false;
        for a in 0..points.len() {
            for b in 0..a {
                let least = roots[a].min(roots[b]);
                if linked(&points[a], &points[b]) && roots[a] != roots[b] {
                    (roots[a], roots[b], changed) = (least, least, true);
                }
            }
        }
    }
    let largest = clustering.max_points.unwrap_or(usize::MAX);
    let mut numbers = std::collections::HashMap::new();
    roots
        .iter()
        .enumerate()
        .map(|(row, root)| {
            let size = roots.iter().filter(|other| *other == root).count();
            if !finite(&points[row]) || !(clustering.min_points..=largest).contains(&size) {
                return NOISE;
            }
            let next = numbers.len() as i32;
            *numbers.entry(*root).or_insert(next)
        })
        .collect()
}

const NOWHERE: AngularGap = AngularGap { origin: [0.0; 3], max_angle: 0.0 };

proptest! {
    #![proptest_config(seeded())]

    #[test]
    fn labels_equal_those_of_all_pairs(points in cloud(), clustering in clustering()) {
        let labels = label(&points, &clustering)
            .map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert_eq!(labels, slow(&points, &NOWHERE, &clustering));
    }

    #[test]
    fn labels_by_angle_equal_those_of_all_pairs(
        points in cloud(),
        gap in gap(),
        clustering in clustering(),
    ) {
        let labels = label_seen(&points, &gap, &clustering, None)
            .map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert_eq!(labels, slow(&points, &gap, &clustering));
    }

    #[test]
    fn crowded_octants_are_no_exception(
        jitter in prop::collection::vec(prop::array::uniform3(0..40_i16), 60..120),
        gap in 200..330_i16,
    ) {
        // Two crowds, apart by about the largest distance: more pairs than are looked at blindly.
        let points: Vec<[f32; 3]> = jitter
            .iter()
            .enumerate()
            .map(|(row, place)| {
                let [x, y, z] = place.map(f32::from);
                let shift = if row % 2 == 0 { 0.0 } else { f32::from(gap) };
                [(x + shift) / 1024.0, y / 1024.0, z / 1024.0]
            })
            .collect();
        let clustering = Clustering { max_distance: 0.25, min_points: 1, max_points: None };
        let labels = label(&points, &clustering)
            .map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert_eq!(labels, slow(&points, &NOWHERE, &clustering));
    }
}
