//! Properties of the assignment: optimal against all permutations, sparse or dense.

use lidar_core::estimation::assignment::{Pair, assign};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Sums of the same numbers in another order.
const SUM_TOLERANCE: f64 = 1e-9;

fn total(costs: &[Vec<Option<f64>>], column_of: &[Option<usize>], unassigned: f64) -> Option<f64> {
    column_of
        .iter()
        .enumerate()
        .map(|(row, column)| column.map_or(Some(unassigned), |column| costs[row][column]))
        .sum()
}

/// Smallest total over every way to assign the rows from `row` on.
fn best(costs: &[Vec<Option<f64>>], row: usize, taken: &mut Vec<bool>, unassigned: f64) -> f64 {
    if row == costs.len() {
        return 0.0;
    }
    let mut least = unassigned + best(costs, row + 1, taken, unassigned);
    for column in 0..taken.len() {
        if let (false, Some(cost)) = (taken[column], costs[row][column]) {
            taken[column] = true;
            least = least.min(cost + best(costs, row + 1, taken, unassigned));
            taken[column] = false;
        }
    }
    least
}

fn table() -> impl Strategy<Value = Vec<Vec<Option<f64>>>> {
    (1..6_usize, 0..6_usize).prop_flat_map(|(rows, columns)| {
        let cell =
            prop::option::weighted(0.7, (-20..20_i32).prop_map(|cost| f64::from(cost) / 3.0));
        prop::collection::vec(prop::collection::vec(cell, columns), rows)
    })
}

/// The same cases on every run.
fn seeded() -> ProptestConfig {
    ProptestConfig {
        cases: 1000,
        rng_seed: RngSeed::Fixed(0),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(seeded())]

    #[test]
    fn no_other_assignment_is_cheaper(costs in table(), unassigned in -5.0..10.0_f64) {
        let columns = costs[0].len();
        let pairs: Vec<Pair> = costs
            .iter()
            .enumerate()
            .flat_map(|(row, cells)| {
                cells.iter().enumerate().filter_map(move |(column, cost)| {
                    cost.map(|cost| Pair { row, column, cost })
                })
            })
            .collect();
        let column_of = assign(costs.len(), columns, &pairs, unassigned)
            .map_err(|e| TestCaseError::fail(e.to_string()))?;
        let mut used: Vec<usize> = column_of.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        prop_assert_eq!(used.len(), column_of.iter().flatten().count());
        let got = total(&costs, &column_of, unassigned)
            .ok_or_else(|| TestCaseError::fail("a forbidden pair was used"))?;
        let expected = best(&costs, 0, &mut vec![false; columns], unassigned);
        prop_assert!((got - expected).abs() < SUM_TOLERANCE, "{} instead of {}", got, expected);
    }
}
