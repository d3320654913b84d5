//! Search for neighbouring positions without a comparison of all pairs.

use nalgebra::Vector3;

/// Relative margin for rounding errors.
const MARGIN: f64 = 1e-9;

/// Positions sorted along x. Each is stored with its index in the input.
pub(in crate::flying::track) struct AlongX {
    sorted: Vec<(f64, usize)>,
}

impl AlongX {
    pub(in crate::flying::track) fn of(places: impl Iterator<Item = Vector3<f64>>) -> Self {
        let mut sorted: Vec<(f64, usize)> = places.map(|place| place.x).zip(0..).collect();
        sorted.sort_unstable_by(|one, other| one.0.total_cmp(&other.0));
        Self { sorted }
    }

    /// Indices of the positions whose x lies between `low - reach` and `high + reach` [m].
    pub(in crate::flying::track) fn near(
        &self,
        low: f64,
        high: f64,
        reach: f64,
    ) -> impl Iterator<Item = usize> {
        let reach = reach + MARGIN * (reach + low.abs().max(high.abs()));
        let start = self.sorted.partition_point(|&(x, _)| x < low - reach);
        let beyond = move |&&(x, _): &&(f64, usize)| x <= high + reach;
        self.sorted[start..].iter().take_while(beyond).map(|&(_, number)| number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_out_of_reach_is_left_out() {
        let places = [3.0, 0.0, 1.0, f64::NAN].map(|x| Vector3::new(x, 9.0, -x));
        let sorted = AlongX::of(places.into_iter());
        let near = |x: f64, reach| sorted.near(x, x, reach).collect::<Vec<_>>();
        assert_eq!(near(0.0, 1.0), [1, 2]);
        assert_eq!(near(3.0, 1.0), [0]);
        assert_eq!(near(0.0, f64::INFINITY), [1, 2, 0]);
        assert!(near(f64::NAN, 1.0).is_empty());
    }
}
