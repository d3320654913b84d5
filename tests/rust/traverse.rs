//! Properties of the ray walk on any segment; exact lengths are held against rational numbers in
//! `tests/python/base/test_geometry.py`.

use lidar_core::Error;
use lidar_core::geometry::lattice::{Lattice, Voxel};
use lidar_core::geometry::traverse::{traverse, voxel_count};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::collections::HashSet;
use std::ops::ControlFlow;

/// Of the sum of lengths, relative above 1 m.
const LENGTH_TOLERANCE: f64 = 1e-9;

/// The same cases on every run.
fn seeded() -> ProptestConfig {
    ProptestConfig {
        cases: 2000,
        rng_seed: RngSeed::Fixed(0),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

/// Everyday coordinates, multiples of an eighth, and values around zero that underflow.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        -50.0..50.0_f64,
        (-400..400_i32).prop_map(|eighths| f64::from(eighths) / 8.0),
        prop::sample::select(vec![0.0, -0.0, 5e-324, -5e-324, 1e-310, -1e-310, 1e-160, -1e-160]),
    ]
}

fn point() -> impl Strategy<Value = [f64; 3]> {
    prop::array::uniform3(coordinate())
}

fn size() -> impl Strategy<Value = f64> {
    prop::sample::select(vec![0.05, 0.1, 0.125, 0.25, 0.3, 1.0, 7.5])
}

fn walk(lattice: &Lattice, start: [f64; 3], end: [f64; 3]) -> Result<Vec<(Voxel, f64)>, Error> {
    let mut visits = Vec::new();
    traverse(lattice, start, end, |voxel, length| {
        visits.push((voxel, length));
        ControlFlow::Continue(())
    })?;
    Ok(visits)
}

fn fail(error: Error) -> TestCaseError {
    TestCaseError::fail(error.to_string())
}

proptest! {
    #![proptest_config(seeded())]

    #[test]
    fn a_walk_leads_from_end_to_end_through_faces(
        start in point(), end in point(), origin in point(), size in size()
    ) {
        let lattice = Lattice::new(size, origin).map_err(fail)?;
        let visits = walk(&lattice, start, end).map_err(fail)?;
        let (first, last) = (lattice.voxel_at(start), lattice.voxel_at(end));
        let (first, last) = (first.map_err(fail)?, last.map_err(fail)?);
        prop_assert_eq!(visits.first().map(|visit| visit.0), Some(first));
        prop_assert_eq!(visits.last().map(|visit| visit.0), Some(last));
        prop_assert_eq!(visits.len() as u64, voxel_count(first, last));
        for pair in visits.windows(2) {
            let steps: u32 = (0..3).map(|axis| pair[0].0[axis].abs_diff(pair[1].0[axis])).sum();
            prop_assert_eq!(steps, 1);
        }
        let distinct: HashSet<Voxel> = visits.iter().map(|visit| visit.0).collect();
        prop_assert_eq!(distinct.len(), visits.len());
        let length = (0..3).map(|axis| (end[axis] - start[axis]).powi(2)).sum::<f64>().sqrt();
        let sum: f64 = visits.iter().map(|visit| visit.1).sum();
        prop_assert!((sum - length).abs() <= LENGTH_TOLERANCE * length.max(1.0));
        prop_assert!(visits.iter().all(|visit| visit.1 >= 0.0));
    }

    #[test]
    fn the_way_back_has_the_same_lengths(start in point(), end in point(), size in size()) {
        let lattice = Lattice::new(size, [0.0; 3]).map_err(fail)?;
        let there = walk(&lattice, start, end).map_err(fail)?;
        let back: std::collections::HashMap<_, _> =
            walk(&lattice, end, start).map_err(fail)?.into_iter().collect();
        for (voxel, length) in there {
            let other = back.get(&voxel).copied().unwrap_or(0.0);
            prop_assert!((length - other).abs() <= LENGTH_TOLERANCE);
        }
    }

    #[test]
    fn a_walk_ends_where_its_visitor_says(start in point(), end in point(), most in 1..20_usize) {
        let lattice = Lattice::new(0.25, [0.0; 3]).map_err(fail)?;
        let mut seen = 0;
        let stop_at = |_: Voxel, _: f64| {
            seen += 1;
            if seen == most { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        traverse(&lattice, start, end, stop_at).map_err(fail)?;
        prop_assert_eq!(seen, most.min(walk(&lattice, start, end).map_err(fail)?.len()));
    }
}
