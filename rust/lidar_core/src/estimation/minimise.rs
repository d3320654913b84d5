//! Minimum of a function by the simplex method of Nelder and Mead, without derivatives.

/// First step and stopping rule of the simplex search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimplexSearch {
    /// Length of the edges of the first simplex.
    pub step: f64,
    /// The search ends when the values at the corners differ by less.
    pub tolerance: f64,
    /// Largest number of evaluations of the cost, after which the search ends.
    pub evaluations: usize,
}

/// Place and value of a minimum of `cost` near `start`. NaN counts as the largest value.
///
/// # Errors
/// The first error of `cost`.
///
/// # Source
/// Nelder & Mead, "A simplex method for function minimization", 1965.
pub fn minimise<E>(
    start: &[f64],
    search: &SimplexSearch,
    mut cost: impl FnMut(&[f64]) -> Result<f64, E>,
) -> Result<(Vec<f64>, f64), E> {
    let mut simplex = Simplex { cost: |place: &[f64]| cost(place), corners: Vec::new(), calls: 0 };
    simplex.add(start.to_vec())?;
    for axis in 0..start.len() {
        let mut place = start.to_vec();
        place[axis] += search.step;
        simplex.add(place)?;
    }
    loop {
        // The sort is stable: corners of equal value keep their order, so the search is
        // reproducible.
        simplex.corners.sort_by(|a, b| a.0.total_cmp(&b.0));
        let last = simplex.corners.len() - 1;
        // The difference of two infinities is NaN and not below the tolerance: while all corners
        // lie where the function is not defined, the search goes on.
        let spread = simplex.corners[last].0 - simplex.corners[0].0;
        if last == 0 || spread < search.tolerance || simplex.calls >= search.evaluations {
            break;
        }
        simplex.improve(last)?;
    }
    let (least, place) = simplex.corners.swap_remove(0);
    Ok((place, least))
}

struct Simplex<F> {
    cost: F,
    /// Values and places, the best first.
    corners: Vec<(f64, Vec<f64>)>,
    calls: usize,
}

impl<E, F: FnMut(&[f64]) -> Result<f64, E>> Simplex<F> {
    fn valued(&mut self, place: Vec<f64>) -> Result<(f64, Vec<f64>), E> {
        self.calls += 1;
        let value = (self.cost)(&place)?;
        Ok((if value.is_nan() { f64::INFINITY } else { value }, place))
    }

    fn add(&mut self, place: Vec<f64>) -> Result<(), E> {
        let corner = self.valued(place)?;
        self.corners.push(corner);
        Ok(())
    }

    /// Replace the worst corner `last`, or contract all corners towards the best.
    fn improve(&mut self, last: usize) -> Result<(), E> {
        let center = center(&self.corners[..last]);
        let (best, worst) = (self.corners[0].0, self.corners[last].0);
        let far = self.corners[last].1.clone();
        let mirrored = self.valued(between(&center, &far, -1.0))?;
        let reflected = mirrored.0;
        if reflected < best {
            let expanded = self.valued(between(&center, &far, -2.0))?;
            self.corners[last] = if expanded.0 < reflected { expanded } else { mirrored };
        } else if reflected < self.corners[last - 1].0 {
            self.corners[last] = mirrored;
        } else {
            // Contract towards the better of the reflected and the old corner.
            let factor = if reflected < worst { -0.5 } else { 0.5 };
            let contracted = self.valued(between(&center, &far, factor))?;
            if contracted.0 < worst.min(reflected) {
                self.corners[last] = contracted;
            } else {
                self.shrink()?;
            }
        }
        Ok(())
    }

    fn shrink(&mut self) -> Result<(), E> {
        // Neither reflection nor contraction helped: the simplex is larger than its valley.
        let lowest = self.corners[0].1.clone();
        for index in 1..self.corners.len() {
            self.corners[index] = self.valued(between(&lowest, &self.corners[index].1, 0.5))?;
        }
        Ok(())
    }
}

fn center(corners: &[(f64, Vec<f64>)]) -> Vec<f64> {
    let count = corners.len() as f64;
    let mean = |axis: usize| corners.iter().map(|(_, place)| place[axis]).sum::<f64>() / count;
    (0..corners[0].1.len()).map(mean).collect()
}

/// `center` moved by `factor` of the way to `corner`.
fn between(center: &[f64], corner: &[f64], factor: f64) -> Vec<f64> {
    center.iter().zip(corner).map(|(from, to)| from + factor * (to - from)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::convert::Infallible;

    const SEARCH: SimplexSearch = SimplexSearch { step: 0.5, tolerance: 1e-14, evaluations: 2000 };

    #[test]
    fn a_curved_valley_is_followed_to_its_end() -> Result<(), Infallible> {
        let valley = |place: &[f64]| -> Result<f64, Infallible> {
            let (x, y) = (place[0], place[1]);
            Ok(100.0 * (y - x * x).powi(2) + (1.0 - x).powi(2))
        };
        let (place, least) = minimise(&[-1.2, 1.0], &SEARCH, valley)?;
        assert!((place[0] - 1.0).abs() < 1e-5 && (place[1] - 1.0).abs() < 1e-5 && least < 1e-10);
        Ok(())
    }

    #[test]
    fn errors_and_limits_end_the_search() {
        assert_eq!(minimise(&[0.0], &SEARCH, |_| Err("no")), Err("no"));
        let few = SimplexSearch { evaluations: 5, ..SEARCH };
        let mut calls = 0;
        let counted = |place: &[f64]| -> Result<f64, Infallible> {
            calls += 1;
            Ok(place.iter().map(|value| value * value).sum())
        };
        assert!(minimise(&[3.0, 3.0], &few, counted).is_ok());
        assert!(calls <= 8, "{calls}");
    }
}
