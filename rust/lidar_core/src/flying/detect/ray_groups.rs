//! Cones around rays that follow each other in a scan.
//!
//! Such rays mostly point in similar directions. So one test of a cone excludes all of its rays from the search for the
//! rays near a target.

use crate::geometry::transform::{dot, minus, norm};

/// Number of rays of a cone.
pub(super) const GROUP: usize = 32;
/// Smallest half angle of a cone: its sine. It leaves room for rounding.
const LEAST_SINE: f64 = 1e-3;
/// Added to the half angle of every cone, for rounding: the sine.
const ROOM: f64 = 1e-5;

/// A cone that contains the lines of some rays in front of their start points.
#[derive(Clone, Copy, Debug)]
pub(super) struct RayCone {
    /// Middle of the start points, and largest distance of one from it [m].
    origin: [f64; 3],
    spread: f64,
    /// Unit vector along the cone. Zero for rays in very different directions, which no cone contains.
    axis: [f64; 3],
    /// Square of the cosine of the half angle. Infinite without rays.
    cosine_squared: f64,
    /// Inverse of the sine of the half angle.
    inverse_sine: f64,
}

impl RayCone {
    /// The cone of at most [`GROUP`] rays, each given by its start point [m] and a vector along it.
    pub(super) fn of(rays: &[([f64; 3], [f64; 3])]) -> Self {
        let mut cone = Self {
            origin: [0.0; 3],
            spread: 0.0,
            axis: [0.0; 3],
            cosine_squared: f64::INFINITY,
            inverse_sine: 1.0,
        };
        let Some(&(first, _)) = rays.first() else { return cone };
        let mut units = [[0.0; 3]; GROUP];
        let units = &mut units[..rays.len().min(GROUP)];
        let mut sum = [0.0; 3];
        for (unit, (at, way)) in units.iter_mut().zip(rays) {
            *unit = way.map(|part| part / norm(*way));
            sum = [0, 1, 2].map(|axis: usize| sum[axis] + unit[axis]);
            cone.spread = cone.spread.max(norm(minus(*at, first)));
        }
        (cone.origin, cone.cosine_squared) = (first, 0.0);
        let axis = sum.map(|part| part / norm(sum));
        let cosine = units.iter().map(|unit| dot(*unit, axis)).fold(1.0, f64::min);
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt().max(LEAST_SINE) + ROOM;
        // The directions may cancel each other.
        if norm(sum) > 0.0 && cosine > 0.0 && sine < 1.0 {
            (cone.axis, cone.cosine_squared) = (axis, 1.0 - sine * sine);
            cone.inverse_sine = 1.0 / sine;
        }
        cone
    }

    /// False if none of the rays' lines comes near the ball in front of its start point.
    #[inline(always)]
    pub(super) fn may_meet(&self, middle: [f64; 3], radius: f64) -> bool {
        // The ball is in the cone, or meets it, if its middle is in the cone moved back by this length.
        let back = (radius + self.spread) * self.inverse_sine;
        let from_origin = minus(middle, self.origin);
        let span: [f64; 3] = std::array::from_fn(|axis| from_origin[axis] + back * self.axis[axis]);
        let ahead = dot(span, self.axis);
        ahead >= 0.0 && ahead * ahead >= dot(span, span) * self.cosine_squared
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Random(u64);

    impl Random {
        /// A number between -0.5 and 0.5.
        fn next(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        }

        fn vector(&mut self, size: f64) -> [f64; 3] {
            [0; 3].map(|_: i32| size * self.next())
        }
    }

    #[test]
    fn no_ray_near_a_ball_is_left_out() {
        let mut random = Random(3);
        let (mut met, mut left_out) = (0, 0);
        for case in 0..20_000 {
            // From parallel rays to rays in all directions; start points together or apart.
            let width = [0.0, 1e-4, 0.02, 0.3, 3.0][case % 5];
            let apart = [0.0, 0.1, 2.0][case % 3];
            let ahead = random.vector(2.0);
            let rays: Vec<([f64; 3], [f64; 3])> = (0..GROUP)
                .map(|_| {
                    let way = random.vector(width);
                    let way = std::array::from_fn(|axis| 30.0 * (ahead[axis] + way[axis]));
                    (random.vector(apart), way)
                })
                .collect();
            let cone = RayCone::of(&rays);
            let (at, along) = rays[case % GROUP];
            let reach = 1.5 * random.next().abs();
            let off = random.vector(if case % 2 == 0 { 1.0 } else { 30.0 });
            let middle = std::array::from_fn(|axis| at[axis] + reach * along[axis] + off[axis]);
            let radius = 0.5 * (random.next() + 0.5);
            let is_met = |&(at, way): &([f64; 3], [f64; 3])| {
                let span = minus(middle, at);
                let along = dot(span, way);
                along > 0.0 && (dot(span, span) - radius * radius) * dot(way, way) <= along * along
            };
            let is_any_met = rays.iter().any(is_met);
            let may_meet = cone.may_meet(middle, radius);
            assert!(may_meet || !is_any_met, "{case}: {cone:?} {middle:?} {radius}");
            met += usize::from(is_any_met);
            left_out += usize::from(!may_meet);
        }
        assert!(met > 1000 && left_out > 5000, "{met} {left_out}");
    }

    #[test]
    fn rays_without_common_direction_may_meet_anything() {
        let from = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]].map(|way| ([0.0; 3], way));
        assert!(RayCone::of(&from).may_meet([0.0, 0.0, -7.0], 0.1));
        assert!(!RayCone::of(&[]).may_meet([1.0, 0.0, 0.0], 10.0));
    }
}
