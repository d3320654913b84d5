//! Fill: share of a target's outline that returns rays. It is small for loose targets such as dust.

use std::f64::consts::PI;

/// Share of the rays inside the ellipse of two standard deviations around the hits that are hits.
/// `hits` and `passing` are in a plane across the line of sight [m]. A disc or a bar fills its
/// ellipse. `ray_gap`: distance between neighbouring rays [m]; it limits the resolution.
pub(super) fn filled_share(hits: &[[f64; 2]], passing: &[[f64; 2]], ray_gap: f64) -> f64 {
    let ellipse = SpreadEllipse::of(hits, ray_gap);
    let count = |rays: &[[f64; 2]]| rays.iter().filter(|&&ray| ellipse.holds(ray)).count() as f64;
    let (hit, missed) = (count(hits), count(passing));
    if hit + missed > 0.0 { hit / (hit + missed) } else { 1.0 }
}

/// Share of the rays expected inside the ellipse around the hits that are hits. `density`: expected
/// rays per square metre. `nearer`: places of rays that end in front of the target; these do not
/// count. NaN if most rays end in front, or none is expected.
pub(in crate::flying::detect) fn of_expected(
    hits: &[[f64; 2]],
    nearer: impl Iterator<Item = [f64; 2]>,
    density: f64,
) -> f64 {
    if !density.is_finite() || density <= 0.0 || hits.is_empty() {
        return f64::NAN;
    }
    let ellipse = SpreadEllipse::of(hits, 1.0 / density.sqrt());
    let hit = hits.iter().filter(|&&hit| ellipse.holds(hit)).count() as f64;
    let stopped = nearer.filter(|&place| ellipse.holds(place)).count() as f64;
    let expected = density * ellipse.area();
    if stopped > 0.5 * expected { f64::NAN } else { (hit / (expected - stopped)).min(1.0) }
}

/// Ellipse of two standard deviations around places in a plane. A disc of places fills it, and so
/// does a bar.
pub(super) struct SpreadEllipse {
    mean: [f64; 2],
    /// Covariance of the places [m^2]: the elements xx, xy and yy.
    xx: f64,
    xy: f64,
    yy: f64,
}

impl SpreadEllipse {
    /// Ellipse around some places [m]. `ray_gap`: distance between neighbouring rays [m], which
    /// limits the smallest ellipse.
    pub(super) fn of(places: &[[f64; 2]], ray_gap: f64) -> Self {
        let count = places.len() as f64;
        let mean: [f64; 2] =
            std::array::from_fn(|axis| places.iter().map(|place| place[axis]).sum::<f64>() / count);
        let least = ray_gap * ray_gap / 12.0;
        let [mut xx, mut xy, mut yy] = [least, 0.0, least];
        for place in places {
            let [x, y] = [place[0] - mean[0], place[1] - mean[1]];
            (xx, xy, yy) = (xx + x * x / count, xy + x * y / count, yy + y * y / count);
        }
        Self { mean, xx, xy, yy }
    }

    fn determinant(&self) -> f64 {
        self.xx * self.yy - self.xy * self.xy
    }

    /// True if `place` is inside the ellipse.
    pub(super) fn holds(&self, place: [f64; 2]) -> bool {
        let Self { mean, xx, xy, yy } = self;
        let [x, y] = [place[0] - mean[0], place[1] - mean[1]];
        yy * x * x - 2.0 * xy * x * y + xx * y * y <= 4.0 * self.determinant()
    }

    /// Area of the ellipse [m^2].
    fn area(&self) -> f64 {
        4.0 * PI * self.determinant().max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_and_a_bar_fill_it() {
        let grid = (0..10_000)
            .map(|at| [0.02 * f64::from(at % 100) - 1.0, 0.02 * f64::from(at / 100) - 1.0]);
        let disc: Vec<[f64; 2]> = grid.filter(|[x, y]| x * x + y * y <= 0.25).collect();
        let ellipse = SpreadEllipse::of(&disc, 0.02);
        assert!((ellipse.area() / (0.25 * PI) - 1.0).abs() < 0.01);
        assert!(ellipse.holds([0.49, 0.0]) && !ellipse.holds([0.36, 0.36]));
        let bar: Vec<[f64; 2]> =
            (0..100).map(|at| [0.01 * f64::from(at), 0.005 * f64::from(at)]).collect();
        let ellipse = SpreadEllipse::of(&bar, 0.02);
        assert!(ellipse.holds([0.9, 0.45]) && !ellipse.holds([0.9, 0.40]));
        assert!(SpreadEllipse::of(&[[1.0, 2.0]], 0.0).area() == 0.0);
    }

    #[test]
    fn what_is_solid_fills_what_is_expected_and_dust_does_not() {
        let places = |gap: f64, keep: usize| -> Vec<[f64; 2]> {
            let row = |at: i32| [gap * f64::from(at % 21 - 10), gap * f64::from(at / 21 - 10)];
            let is_inside = |[x, y]: &[f64; 2]| x * x + y * y <= 0.25;
            (0..441).map(row).filter(is_inside).step_by(keep).collect()
        };
        let (gap, density) = (0.05, 400.0);
        assert!(of_expected(&places(gap, 1), [].into_iter(), density) > 0.95);
        assert!((of_expected(&places(gap, 10), [].into_iter(), density) - 0.1).abs() < 0.03);
        // Sparse rays are no loose target.
        assert!(of_expected(&places(0.25, 1), [].into_iter(), 16.0) > 0.8);
        assert!(of_expected(&places(gap, 1), [].into_iter(), 0.0).is_nan());
        assert!(of_expected(&[], [].into_iter(), density).is_nan());
        assert!(of_expected(&[[0.0, 0.0]], [].into_iter(), density) > 0.9, "one ray");
        // A branch in front of a target hides a third of it, and a wall two thirds.
        let (whole, third) = (places(gap, 1), places(gap, 3));
        let left: Vec<_> = whole.iter().filter(|place| !third.contains(place)).copied().collect();
        assert!(of_expected(&left, third.iter().copied(), density) > 0.95);
        assert!(of_expected(&left, [].into_iter(), density) < 0.75);
        assert!(of_expected(&third, left.iter().copied(), density).is_nan());
    }
}
