//! Assignment, distributions, filters, search.

use super::input::Input;
use lidar_core::Error;
use lidar_core::estimation::assignment::{Pair, assign};
use lidar_core::estimation::chi2::{cdf, quantile};
use lidar_core::estimation::jitter::Jitter;
use lidar_core::estimation::kalman::{
    Gaussian, Linearised, carry, correct, mahalanobis, predict, symmetrise, symmetrised, update,
};
use lidar_core::estimation::minimise::{SimplexSearch, minimise};
use lidar_core::estimation::probability::box_probability;
use lidar_core::estimation::unscented::{Rooted, SigmaRule, transformed};
use nalgebra::{SMatrix, SVector};

pub fn functions(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let _ = distributions(&mut input);
    let _ = filtered(&mut input);
}

pub fn assignment(bytes: &[u8]) {
    let _ = assigned(&mut Input::new(bytes));
}

/// A table with few entries that may be wrong, or a full one.
fn assigned(input: &mut Input<'_>) -> Result<(), Error> {
    let (rows, columns) = (input.below(9), input.below(9));
    let pairs = if input.is_set() {
        let cell = |cell| Pair { row: cell / columns, column: cell % columns, cost: input.share() };
        (0..rows * columns).map(cell).collect()
    } else {
        input.many(30, |input| Pair {
            row: input.index(rows),
            column: input.index(columns),
            cost: input.f64(),
        })
    };
    let found = assign(rows, columns, &pairs, input.f64())?;
    assert_eq!(found.len(), rows);
    let mut used: Vec<_> = found.iter().flatten().collect();
    used.sort_unstable();
    used.dedup();
    assert_eq!(used.len(), found.iter().flatten().count());
    Ok(())
}

fn distributions(input: &mut Input<'_>) -> Result<(), Error> {
    let degrees = u32::from(input.byte());
    let _ = cdf(input.f64(), degrees);
    let _ = quantile(input.share(), degrees);
    let _ = box_probability(&input.covariance(), input.f64s(), input.f64s());
    let mut jitter = Jitter::new(input.positive(), input.positive());
    let mut stamp_ns = 0;
    for _ in 0..input.below(12) {
        stamp_ns = input.stamp(stamp_ns);
        jitter.add(stamp_ns, input.f64s(), input.positive());
    }
    let _ = (jitter.variance(), jitter.mean());
    let search =
        SimplexSearch { step: input.positive(), tolerance: input.share(), evaluations: 50 };
    let start = input.many(3, Input::f64);
    let (scale, centre) = (input.f64(), input.f64());
    let cost = |at: &[f64]| Ok(at.iter().map(|x| scale * (x - centre).powi(2)).sum());
    minimise::<Error>(&start, &search, cost)?;
    Ok(())
}

fn matrix<const R: usize, const C: usize>(input: &mut Input<'_>) -> SMatrix<f64, R, C> {
    SMatrix::from_fn(|_, _| input.f64())
}

fn filtered(input: &mut Input<'_>) -> Result<(), Error> {
    let covariance = SMatrix::<f64, 3, 3>::from_fn({
        let entries: [[f64; 3]; 3] = input.covariance();
        move |row, column| entries[row][column]
    });
    let prior = Gaussian { mean: SVector::from(input.f64s::<3>()), covariance };
    let (f, mut moved) = (matrix::<3, 3>(input), covariance);
    carry(&mut moved, &f);
    symmetrise(&mut moved);
    let ahead = predict(&prior, &f, &symmetrised(moved));
    let numbers = ahead.numbers();
    let _ = Gaussian::<3>::from_numbers(&numbers);
    let _ = Gaussian::<3>::from_numbers(&input.many(14, Input::f64));
    let seen = Linearised {
        y: SVector::from(input.f64s::<2>()),
        H: matrix::<2, 3>(input),
        R: SMatrix::<f64, 2, 2>::from_fn({
            let entries: [[f64; 2]; 2] = input.covariance();
            move |row, column| entries[row][column]
        }),
    };
    let _ = update(&ahead, &seen);
    let mut state = ahead.clone();
    let _ = correct(&mut state, &seen, |far| far.squared < 9.0);
    let _ = mahalanobis(&seen.y, &seen.R);
    let rooted = Rooted::new(prior.mean, &prior.covariance);
    let _ = rooted.covariance();
    let rule = SigmaRule::new(3, input.positive());
    let (_, triangle, _) = transformed(&rooted, &rule, |x| f * x);
    let _ = (triangle.at(0, 0), triangle.corner::<2>(0));
    Ok(())
}
