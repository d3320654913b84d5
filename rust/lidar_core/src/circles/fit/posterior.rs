//! Average of the circles that an arc allows: integrals over the bearings of the two tangents.

use super::FitMethod;
use super::likelihood::{Likelihood, Roots, TangentCircle};
use super::mode::{LEAST_SHARE, MisfitMinimum, RootBounds, is_held, mode};

/// A circle (x, y, radius) [m] and its covariance [m^2], in the frame of the arc.
pub(in crate::circles) type Estimate = ([f64; 3], [[f64; 3]; 3]);

/// Drop of the log-likelihood below its peak at which the integrals end [nepers].
const DROP: f64 = 10.0;
/// Factor on the extent that the second derivatives predict, since the peak is no parabola.
const MARGIN: f64 = 1.2;
/// Least variance along any axis [m^2]. Hits of a wall can press the integral against the largest
/// radius, so that one node has all the weight.
const LEAST_VARIANCE: f64 = 1e-8;
/// Number of bisections to where the radius reaches a bound.
const HALVINGS: usize = 8;
/// Largest factor between approximate and exact radii.
const ROUGH: f64 = 1.5;

/// Nodes and weights of Gauss's rule of 6 points on -1..1, positive half.
const GAUSS_6: [[f64; 2]; 3] = [
    [0.238_619_186_083_196_9, 0.467_913_934_572_691_04],
    [0.661_209_386_466_264_5, 0.360_761_573_048_138_6],
    [0.932_469_514_203_152, 0.171_324_492_379_170_36],
];
/// Nodes and weights of Gauss's rule of 8 points on -1..1, positive half.
const GAUSS_8: [[f64; 2]; 4] = [
    [0.183_434_642_495_649_8, 0.362_683_783_378_362],
    [0.525_532_409_916_329, 0.313_706_645_877_887_27],
    [0.796_666_477_413_626_7, 0.222_381_034_453_374_48],
    [0.960_289_856_497_536_2, 0.101_228_536_290_376_26],
];
/// Nodes and weights of Gauss's rule of 10 points on -1..1, positive half.
const GAUSS_10: [[f64; 2]; 5] = [
    [0.148_874_338_981_631_22, 0.295_524_224_714_752_87],
    [0.433_395_394_129_247_2, 0.269_266_719_309_996_35],
    [0.679_409_568_299_024_4, 0.219_086_362_515_982_04],
    [0.865_063_366_688_984_5, 0.149_451_349_150_580_6],
    [0.973_906_528_517_171_7, 0.066_671_344_308_688_14],
];
/// Lengths of an integral, in standard deviations of the likelihood, below which 6 and below which
/// 8 points suffice; longer ones take 10.
const SHORT: [f64; 2] = [3.0, 7.0];

/// Bounds of an integral, with the curvature of the log-likelihood between them.
#[derive(Clone, Copy, Debug)]
struct Span {
    low: f64,
    high: f64,
    curvature: f64,
}

/// Nodes of Gauss's rule in a span, each with its weight.
fn gauss(span: Span) -> impl Iterator<Item = [f64; 2]> {
    let (middle, half) = (0.5 * (span.low + span.high), 0.5 * (span.high - span.low));
    let length = 2.0 * half * span.curvature.sqrt();
    let rule: &[[f64; 2]] = if length < SHORT[0] {
        &GAUSS_6
    } else if length < SHORT[1] {
        &GAUSS_8
    } else {
        &GAUSS_10
    };
    rule.iter().flat_map(move |[node, weight]| {
        [[middle - half * node, half * weight], [middle + half * node, half * weight]]
    })
}

/// Integrates over the circles that an arc allows. It reuses its buffer for every arc.
#[derive(Debug, Default)]
pub(in crate::circles) struct Posterior {
    nodes: Vec<TangentCircle>,
}

impl Posterior {
    /// Expected circle, or the most likely one, with its mean square error as covariance. None if
    /// no circle within the bounds of the radius explains the arc.
    pub(in crate::circles) fn of(&mut self, likelihood: &Likelihood<'_>) -> Option<Estimate> {
        let mean = self.mean(likelihood)?;
        let about = match likelihood.parameters.method {
            FitMethod::MostLikely => self.most_likely()?,
            _ => mean,
        };
        Some((about, self.mean_square(about)))
    }

    /// Mean square error of a circle found by another method; None as for [`Self::of`].
    pub(super) fn error_of(
        &mut self,
        circle: [f64; 3],
        likelihood: &Likelihood<'_>,
    ) -> Option<[[f64; 3]; 3]> {
        self.mean(likelihood)?;
        Some(self.mean_square(circle))
    }

    /// Add the integration nodes of one part of the plane of the two roots.
    fn integrate(
        &mut self,
        likelihood: &Likelihood<'_>,
        bounds: &RootBounds,
        mode: &MisfitMinimum,
    ) {
        // The outer integral goes over the side that is better known.
        let size = |side: usize| bounds[side][1] - bounds[side][0];
        let outer = usize::from(size(1) < size(0));
        let window = RootWindow { likelihood, bounds, mode, outer };
        // The peak has weight zero: it is no part of the average, but a candidate for the most
        // likely circle.
        self.nodes.extend(likelihood.peak(mode.roots));
        for [place, weight] in window.outer().into_iter().flat_map(gauss) {
            for [inner, inner_weight] in window.inner(place).into_iter().flat_map(gauss) {
                let roots = window.roots(place, inner);
                self.nodes.push(likelihood.at(roots, weight * inner_weight));
            }
        }
    }

    /// Integrate over the circles of an arc: expected circle (x, y, radius) [m]; None if no circle
    /// within the bounds of the radius explains the arc.
    fn mean(&mut self, likelihood: &Likelihood<'_>) -> Option<[f64; 3]> {
        self.nodes.clear();
        let (low, high) = (pieces(likelihood, 0), pieces(likelihood, 1));
        for low in low.into_iter().flatten() {
            for high in high.into_iter().flatten() {
                let bounds = [low, high];
                let mode = mode(likelihood, &bounds);
                self.integrate(likelihood, &bounds, &mode);
            }
        }
        self.average()
    }

    /// Replace the logarithms of the weights by shares of their sum, and return the mean circle;
    /// None if no node has a weight.
    fn average(&mut self) -> Option<[f64; 3]> {
        // Shares relative to the peak: the plain likelihoods of many rays underflow.
        let peak = self.nodes.iter().map(|node| node.log_weight).fold(f64::NEG_INFINITY, f64::max);
        if !peak.is_finite() {
            return None;
        }
        let mut total = 0.0;
        let mut sum = [0.0; 3];
        for node in &mut self.nodes {
            node.log_weight = libm::exp(node.log_weight - peak); // from here on a plain weight
            total += node.log_weight;
            for (sum, entry) in sum.iter_mut().zip(node.circle) {
                *sum += node.log_weight * entry;
            }
        }
        for node in &mut self.nodes {
            node.log_weight /= total;
        }
        Some(sum.map(|entry| entry / total))
    }

    fn most_likely(&self) -> Option<[f64; 3]> {
        self.best().map(|node| node.circle)
    }

    /// Most likely node of the arc that was integrated last.
    fn best(&self) -> Option<&TangentCircle> {
        self.nodes.iter().max_by(|a, b| a.log_likelihood.total_cmp(&b.log_likelihood))
    }

    /// Largest log-likelihood of the arc that was integrated last; None if no circle explains it.
    pub(in crate::circles) fn log_likelihood(&self) -> Option<f64> {
        self.best().map(|node| node.log_likelihood)
    }

    /// Mean square difference of the circles from `about`, as a matrix of x, y and radius [m^2].
    fn mean_square(&self, about: [f64; 3]) -> [[f64; 3]; 3] {
        let mut sum =
            [[LEAST_VARIANCE, 0.0, 0.0], [0.0, LEAST_VARIANCE, 0.0], [0.0, 0.0, LEAST_VARIANCE]];
        for node in &self.nodes {
            let apart: [f64; 3] = std::array::from_fn(|k| node.circle[k] - about[k]);
            for i in 0..3 {
                for j in 0..3 {
                    let spread = node.variance * node.direction[i] * node.direction[j];
                    sum[i][j] += node.log_weight * (apart[i] * apart[j] + spread);
                }
            }
        }
        sum
    }
}

/// Intervals of the root of one side. The likelihood has a step at a ray that returned nothing and
/// may cross the circle: then there are two intervals.
fn pieces(likelihood: &Likelihood<'_>, side: usize) -> [Option<[f64; 2]>; 2] {
    let edge = &likelihood.arc.edges[side];
    let end = edge.reach.sqrt();
    match edge.missed.first() {
        Some(first) if *first < edge.reach => {
            let step = first.sqrt();
            [Some([0.0, step]), Some([step, end])]
        }
        _ => [Some([0.0, end]), None],
    }
}

/// Part of the plane of roots that is integrated.
struct RootWindow<'a> {
    likelihood: &'a Likelihood<'a>,
    bounds: &'a RootBounds,
    mode: &'a MisfitMinimum,
    /// Side of the outer integral.
    outer: usize,
}

impl RootWindow<'_> {
    fn roots(&self, outer: f64, inner: f64) -> Roots {
        if self.outer == 0 { [outer, inner] } else { [inner, outer] }
    }

    /// Bounds of the outer root; None if no radius within its bounds is possible.
    fn outer(&self) -> Option<Span> {
        let (side, other) = (self.outer, 1 - self.outer);
        let [h00, h01, h11] = self.mode.normal.hessian;
        let (own, others) = if side == 0 { (h00, h11) } else { (h11, h00) };
        // Curvature along the outer root while the inner one follows at its best (Schur
        // complement).
        let profile = if others > 0.0 { (own - h01 * h01 / others).max(0.0) } else { own };
        // Inside the bounds the gradient of a minimum is zero; what is left of it is rounding.
        let is_held = is_held(self.mode, side, self.bounds);
        let gradient = if is_held { self.mode.normal.gradient[side] } else { 0.0 };
        let window = around(self.mode.roots[side], gradient, profile, self.bounds[side]);
        let [low, high] = self.bounds[other];
        let least = |root| self.roots(root, low);
        let most = |root| self.roots(root, high);
        self.allowed(window, least, most)
    }

    /// Bounds of the inner root for a value of the outer one; None if no radius within its bounds
    /// is possible.
    fn inner(&self, outer: f64) -> Option<Span> {
        let side = 1 - self.outer;
        let [h00, h01, h11] = self.mode.normal.hessian;
        let own = if side == 0 { h00 } else { h11 };
        let [low, high] = self.bounds[side];
        let pull = self.mode.normal.gradient[side] + h01 * (outer - self.mode.roots[self.outer]);
        let guess = self.mode.roots[side] - if own > 0.0 { pull / own } else { 0.0 };
        // Once more from there: far from the mode the parabola is another one.
        let guess = guess.clamp(low + LEAST_SHARE * (high - low), high);
        let there = self.likelihood.normal(self.roots(outer, guess));
        let own = if side == 0 { there.hessian[0] } else { there.hessian[2] };
        let free = guess - if own > 0.0 { there.gradient[side] / own } else { 0.0 };
        let center = free.clamp(low, high);
        let gradient = own * (center - free);
        let window = around(center, gradient, own, [low, high]);
        self.allowed(window, |root| self.roots(outer, root), |root| self.roots(outer, root))
    }

    /// Part of `window` in which the radius can be within its bounds. The radius grows with both
    /// roots: `least` and `most` give the roots of the smallest and largest radius at a place.
    fn allowed(
        &self,
        Span { low, high, curvature }: Span,
        least: impl Fn(f64) -> Roots,
        most: impl Fn(f64) -> Roots,
    ) -> Option<Span> {
        let [smallest, largest] = self.likelihood.parameters.radius;
        let low_of = |at| self.likelihood.radius(at)[0];
        let high_of = |at| self.likelihood.radius(at)[1];
        let rough = |at| self.likelihood.rough_radius(at);
        let (mut low, mut high) = (low, high);
        // The approximate radius costs no loop over the hits and rules the bound out in most cases.
        if rough(least(high)) * ROUGH > largest && low_of(least(high)) > largest {
            if low_of(least(low)) >= largest {
                return None;
            }
            high = halved([low, high], |root| low_of(least(root)) > largest);
        }
        if rough(most(low)) < smallest * ROUGH && high_of(most(low)) < smallest {
            if high_of(most(high)) <= smallest {
                return None;
            }
            low = halved([low, high], |root| high_of(most(root)) > smallest);
        }
        (low < high).then_some(Span { low, high, curvature })
    }
}

/// Place at which `is_above` becomes true, by bisection.
fn halved([mut low, mut high]: [f64; 2], is_above: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if is_above(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    0.5 * (low + high)
}

/// Interval around `center` in which a parabola stays within the drop, cut to the bounds.
fn around(center: f64, gradient: f64, curvature: f64, [low, high]: [f64; 2]) -> Span {
    let reach = |slope: f64| {
        let slope = slope.max(0.0);
        // Root of slope x + curvature x^2 / 2 = drop in the form that also holds without curvature.
        let root = (slope * slope + 2.0 * DROP * curvature).sqrt();
        MARGIN * 2.0 * DROP / (slope + root).max(1e-12)
    };
    let (low, high) = ((center - reach(-gradient)).max(low), (center + reach(gradient)).min(high));
    Span { low, high, curvature }
}
