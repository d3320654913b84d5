//! Likelihood of a circle, given the ranges of an arc and the rays that passed beside it.
//!
//! A circle is given by the bearings of its two tangents from the sensor. With its centre at
//! bearing b and distance d, and half the angle between the tangents a, the range of a ray is
//! d g, g = cos e - sqrt(sin^2 a - sin^2 e), e its bearing from b: linear in d, so the best d has
//! a closed form and only the tangents are searched. The rays that passed bound the tangents.

use super::FitParameters;
use super::arc::{Arc, Hit};
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_2_SQRT_PI};

/// Coordinates of the search: square roots of how far each tangent lies beyond its outermost hit
/// [rad^(1/2)], in which the likelihood is smooth up to a tangent that is a hit.
pub(super) type Roots = [f64; 2];

/// Misfit of the ranges, with its gradient and second derivatives (00, 01, 11) by the two roots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MisfitDerivatives {
    pub(super) misfit: f64,
    pub(super) gradient: [f64; 2],
    pub(super) hessian: [f64; 3],
}

/// Half width of the interval of likely distances of the centre, in standard deviations.
const SPREAD: f64 = 4.0;
/// Exponent of the prior of a circle above the usual radius: (usual radius / radius)^`RARITY`.
const RARITY: i32 = 8;
/// Largest number of Newton steps to the best distance.
const MOST_STEPS: usize = 4;
/// Squared Newton step, over the variance of the distance, below which the steps end.
const ENOUGH: f64 = 0.01;
/// Probability that a ray on an object within the range limits returns nothing.
const DROPPED: f64 = 1e-3;
/// Lower limit of a probability whose logarithm is taken.
const SMALLEST: f64 = 1e-300;
/// Density of the standard normal distribution at zero.
const DENSITY: f64 = FRAC_2_SQRT_PI * 0.5 * FRAC_1_SQRT_2;

/// Best circle with given tangents, and its likelihood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TangentCircle {
    /// Centre x, y, radius [m].
    pub(super) circle: [f64; 3],
    /// Derivative of centre x, centre y and radius by the distance of the centre, for given
    /// tangents.
    pub(super) direction: [f64; 3],
    /// Variance of the distance of the centre [m^2].
    pub(super) variance: f64,
    /// Logarithm of the likelihood at the best distance.
    pub(super) log_likelihood: f64,
    /// Logarithm of the likelihood integrated over the distance, times the prior (uniform in centre
    /// and radius) and the measure of the roots.
    pub(super) log_weight: f64,
}

/// Likelihood of circles for one arc.
#[derive(Clone, Copy, Debug)]
pub(in crate::circles) struct Likelihood<'a> {
    pub(in crate::circles) arc: &'a Arc,
    pub(in crate::circles) parameters: &'a FitParameters,
}

/// Middle of the angle between two tangents, and half of that angle, as cosines and sines.
#[derive(Clone, Copy)]
struct TangentView {
    cosine: f64,
    sine: f64,
    half: [f64; 2], // sine, cosine
}

/// Intersection of a ray with a circle whose centre is at distance 1.
struct Intersection {
    /// Range of the ray: distance from the sensor to the near side of the circle.
    g: f64,
    /// Sine and cosine of the angle to the centre.
    angle: [f64; 2],
    /// Square root in g; 0 for rays beside the circle.
    root: f64,
}

impl TangentView {
    fn met(&self, cosine: f64, sine: f64) -> Intersection {
        let across = sine * self.cosine - cosine * self.sine;
        let along = cosine * self.cosine + sine * self.sine;
        // A beam has a width: rays just beside the tangent return as well, from the flank.
        let root = (self.half[0] * self.half[0] - across * across).max(0.0).sqrt();
        Intersection { g: along - root, angle: [across, along], root }
    }
}

impl Likelihood<'_> {
    /// Lower and upper bearing of the tangents, from the middle of the arc [rad].
    fn tangents(&self, roots: Roots) -> [f64; 2] {
        let [low, high] = &self.arc.edges;
        let width = self.parameters.beam_half_width;
        let ends = [low.bearing + width, high.bearing - width];
        [ends[0] - roots[0] * roots[0], ends[1] + roots[1] * roots[1]]
    }

    fn view(&self, roots: Roots) -> TangentView {
        let [low, high] = self.tangents(roots);
        // The sensor is outside: the tangents are less than half a turn apart.
        let (middle, half) = (0.5 * (low + high), (0.5 * (high - low)).clamp(1e-9, 1.57));
        TangentView {
            cosine: libm::cos(middle),
            sine: libm::sin(middle),
            half: [libm::sin(half), libm::cos(half)],
        }
    }

    /// Best distance of the centre [m] from the hits alone, without bounds of the radius; and the
    /// weighted sums over the hits of g^2 and g z, with z the range of a hit [m].
    fn distance(&self, view: &TangentView) -> (f64, [f64; 2]) {
        let mut sums = [0.0; 2];
        for hit in &self.arc.hits {
            let g = view.met(hit.cosine, hit.sine).g;
            sums[0] += hit.weight * g * g;
            sums[1] += hit.weight * g * hit.range;
        }
        (sums[1] / sums[0], sums)
    }

    /// Smallest and largest likely radius with these tangents, allowed or not [m].
    pub(super) fn radius(&self, roots: Roots) -> [f64; 2] {
        let view = self.view(roots);
        let (distance, [gg, _]) = self.distance(&view);
        let spread = SPREAD * self.parameters.range_std / gg.sqrt();
        [distance - spread, distance + spread].map(|distance| distance * view.half[0])
    }

    /// Approximate radius from the tangents and the nearest range, without a loop over the hits.
    pub(super) fn rough_radius(&self, roots: Roots) -> f64 {
        let [low, high] = self.tangents(roots);
        let sine = libm::sin((0.5 * (high - low)).clamp(0.0, 1.5));
        self.arc.nearest * sine / (1.0 - sine)
    }

    /// Most likely circle with these tangents; it has no weight in averages. None if its radius is
    /// outside the bounds.
    pub(super) fn peak(&self, roots: Roots) -> Option<TangentCircle> {
        let found = self.at(roots, 0.0);
        let [smallest, largest] = self.radius(roots);
        let [least, most] = self.parameters.radius;
        (smallest <= most && largest >= least).then_some(found)
    }

    /// Most likely circle with these tangents, its radius limited to the bounds. `weight` is its
    /// weight as a node of the integral over the roots.
    pub(super) fn at(&self, roots: Roots, weight: f64) -> TangentCircle {
        let view = self.view(roots);
        let (free, [gg, gz]) = self.distance(&view);
        let [least, most] = self.parameters.radius.map(|radius| radius / view.half[0]);
        let noise = self.parameters.range_std * self.parameters.range_std;
        let (known, variance, missed) = self.with_misses(roots, &view, [free, noise / gg]);
        let distance = known.clamp(least, most);
        let misfit = self.arc.square - distance * (2.0 * gz - distance * gg);
        let log_likelihood = missed - 0.5 * misfit / noise;
        // Jacobian from (middle, half angle, distance) to (x, y, radius): d for the bearing times d
        // cos(a) for the radius. The deviation comes from the integral over the distance.
        let prior = distance * distance * view.half[1] * variance.sqrt();
        let usual = self.parameters.usual_radius;
        let rarity = (usual / (distance * view.half[0])).min(1.0).powi(RARITY);
        // d(root^2) = 2 root d(root): the integral goes over roots, the prior over bearings.
        let measure = weight * rarity * prior * roots[0] * roots[1];
        let direction = [view.cosine, view.sine, view.half[0]];
        TangentCircle {
            circle: direction.map(|entry| distance * entry),
            direction,
            variance,
            log_likelihood,
            log_weight: log_likelihood + libm::log(measure),
        }
    }

    /// Best distance, its variance, and the logarithm of the likelihood of the rays that returned
    /// nothing, given distance and variance from the hits.
    ///
    /// That likelihood is log-concave: Newton's steps lead to the best distance, and the curvature
    /// there gives the variance (Laplace's method).
    fn with_misses(
        &self,
        roots: Roots,
        view: &TangentView,
        [free, variance]: [f64; 2],
    ) -> (f64, f64, f64) {
        let mut distance = free;
        let mut missed = self.missed(roots, view, distance);
        for _ in 0..MOST_STEPS {
            // The misses only add information: their second derivative is never positive.
            let information = 1.0 / variance - missed[2];
            let step = (missed[1] - (distance - free) / variance) / information;
            if step * step * information < ENOUGH {
                break;
            }
            distance += step;
            missed = self.missed(roots, view, distance);
        }
        (distance, 1.0 / (1.0 / variance - missed[2]), missed[0])
    }

    /// Logarithm of the probability that rays which returned nothing cross the circle outside the
    /// range limits, and its two derivatives by the distance.
    fn missed(&self, roots: Roots, view: &TangentView, distance: f64) -> [f64; 3] {
        let mut sums = [0.0; 3];
        let mut add = |bearing: f64, least: f64| {
            let g = view.met(libm::cos(bearing), libm::sin(bearing)).g;
            for (sum, term) in sums.iter_mut().zip(self.miss(g, distance, least)) {
                *sum += term;
            }
        };
        for (side, edge) in self.arc.edges.iter().enumerate() {
            // Only the range limits explain a miss beyond the hits. Between the hits a few rays are
            // lost for other reasons.
            let sign = if side == 0 { -1.0 } else { 1.0 };
            let reach = roots[side] * roots[side];
            for beyond in edge.missed.iter().take_while(|&&beyond| beyond < reach) {
                add(edge.bearing + sign * beyond, 0.0);
            }
        }
        for &bearing in &self.arc.missed {
            add(bearing, DROPPED);
        }
        sums
    }

    /// Logarithm of the probability that one ray returns nothing, and its two derivatives by the
    /// distance. `least` is the probability that it returns nothing for other reasons: where the
    /// range limits make it less probable than that, the ray has no influence.
    fn miss(&self, g: f64, distance: f64, least: f64) -> [f64; 3] {
        let ([near, far], std) = (self.parameters.range_limits, self.parameters.range_std);
        let over = [(distance * g - far) / std, (near - distance * g) / std];
        let [above, below] = over.map(|z| 0.5 * libm::erfc(-z * FRAC_1_SQRT_2));
        let chance = above + below;
        if chance <= least.max(SMALLEST) {
            return [libm::log(least.max(SMALLEST)), 0.0, 0.0];
        }
        let [high, low] = over.map(|z| DENSITY * libm::exp(-0.5 * z * z));
        let slope = (high - low) / chance;
        let bend = -(over[0] * high + over[1] * low) / chance - slope * slope;
        let scale = g / std;
        [libm::log(chance), scale * slope, scale * scale * bend.min(0.0)]
    }

    /// Half the squared misfit of the ranges over their variance, and its derivatives by the roots
    /// at the best distance (second derivatives by Kaufman's approximation).
    pub(super) fn normal(&self, roots: Roots) -> MisfitDerivatives {
        let view = self.view(roots);
        let mut sums = HitSums::default();
        for hit in &self.arc.hits {
            sums.add(hit, &view, roots);
        }
        let distance = sums.gz / sums.gg;
        let slope = sums.ga.map(|ga| -distance * ga / sums.gg);
        sums.normal(distance, slope, self.arc.square, self.parameters.range_std)
    }
}

/// Weighted sums over the hits of products of g (range for a centre at distance 1), a (derivatives
/// of g by the two roots) and z (measured range).
#[derive(Default)]
struct HitSums {
    gg: f64,
    gz: f64,
    ga: [f64; 2],
    za: [f64; 2],
    aa: [f64; 3],
}

impl HitSums {
    fn add(&mut self, hit: &Hit, view: &TangentView, roots: Roots) {
        let Intersection { g, angle: [across, along], root } = view.met(hit.cosine, hit.sine);
        // At a tangent the derivative by the bearing is infinite. By the square root it is finite,
        // since the factor that it brings vanishes there.
        let (by_middle, by_half) = if root > 0.0 {
            (across - across * along / root, -view.half[0] * view.half[1] / root)
        } else {
            (across, 0.0)
        };
        let a = [roots[0] * (by_half - by_middle), roots[1] * (by_half + by_middle)];
        let (w, z) = (hit.weight, hit.range);
        self.gg += w * g * g;
        self.gz += w * g * z;
        for (side, a) in a.iter().enumerate() {
            self.ga[side] += w * g * a;
            self.za[side] += w * z * a;
        }
        self.aa[0] += w * a[0] * a[0];
        self.aa[1] += w * a[0] * a[1];
        self.aa[2] += w * a[1] * a[1];
    }

    /// Normal equations; the residual of a hit is z - d g, its derivatives are -d a - d' g.
    fn normal(&self, distance: f64, slope: [f64; 2], square: f64, std: f64) -> MisfitDerivatives {
        let weight = 1.0 / (std * std);
        let misfit = square - distance * (2.0 * self.gz - distance * self.gg);
        let gradient = |k: usize| -distance * (self.za[k] - distance * self.ga[k]);
        let second = |k: usize, l: usize| {
            let mixed = slope[k] * self.ga[l] + slope[l] * self.ga[k];
            distance * distance * self.aa[k + l] + distance * mixed + slope[k] * slope[l] * self.gg
        };
        MisfitDerivatives {
            misfit: 0.5 * weight * misfit,
            gradient: [weight * gradient(0), weight * gradient(1)],
            hessian: [weight * second(0, 0), weight * second(0, 1), weight * second(1, 1)],
        }
    }
}
