//! Algebraic circle fits of Kasa, Pratt and Taubin, with a bounded radius.
//!
//! # Source
//! Chernov, "Circular and linear regression", 2010, sections 5 and 8: the three minimise the same
//! algebraic distances under different constraints, so each is a root of a polynomial in the
//! moments of the points.

use super::arc::{Arc, Hit};
use super::posterior::Estimate;
use super::{FitMethod, FitParameters};
use nalgebra::{Matrix3, Vector3};

/// Largest number of Newton's steps to the root of the characteristic polynomial.
const MOST_STEPS: usize = 60;
/// Determinant of points scaled to unit size, below which they lie on a line.
const FLAT: f64 = 1e-12;
/// Least number of hits for a radius.
const FEW: usize = 3;
/// Share of the largest radius above which a circle may be limited by that bound.
const HELD: f64 = 0.95;

/// Algebraic circle fit to the hits of an arc: x, y and radius [m] with an approximate covariance
/// [m^2], in the frame of the arc. If the hits do not determine a circle, it lies behind their
/// middle.
pub(super) fn fit(arc: &Arc, parameters: &FitParameters) -> Estimate {
    let bounds = parameters.radius;
    let free = free(arc, parameters.method);
    let circle = match free {
        Some(circle) => bounded(arc, circle, bounds),
        None => behind(arc, bounds),
    };
    let mut covariance = covariance(arc, circle, parameters);
    if arc.hits.len() >= FEW {
        add_square(&mut covariance, beyond(arc, free, circle, bounds));
    }
    (circle, covariance)
}

/// The estimate with a larger covariance if the largest radius may limit the circle: the squared
/// difference from the circle fitted without bounds is added. Other estimates are returned
/// unchanged.
pub(super) fn held(
    arc: &Arc,
    parameters: &FitParameters,
    (circle, mut covariance): Estimate,
) -> Estimate {
    if circle[2] > HELD * parameters.radius[1] && arc.hits.len() >= FEW {
        let free = free(arc, FitMethod::Taubin);
        add_square(&mut covariance, beyond(arc, free, circle, parameters.radius));
    }
    (circle, covariance)
}

/// Circle (x, y, radius) [m] fitted to the hits without bounds of the radius; None if there are
/// fewer than three hits, or if they lie on a line.
fn free(arc: &Arc, method: FitMethod) -> Option<[f64; 3]> {
    Moments::of(&arc.hits).and_then(|moments| moments.circle(method))
}

fn add_square(covariance: &mut [[f64; 3]; 3], by: [f64; 3]) {
    for (row, left) in covariance.iter_mut().zip(by) {
        for (entry, right) in row.iter_mut().zip(by) {
            *entry += left * right;
        }
    }
}

/// Difference in x, y and radius [m] from the bounded `circle` to `free`, the one fitted without
/// bounds. It is zero if `free` is within the bounds. The radii differ by no more than the largest
/// radius.
fn beyond(arc: &Arc, free: Option<[f64; 3]>, circle: [f64; 3], bounds: [f64; 2]) -> [f64; 3] {
    let [least, most] = bounds;
    let ahead = away(arc, circle);
    let farthest = [most * ahead[0], most * ahead[1], most];
    let Some(free) = free else { return farthest };
    let bent = bends_inwards(arc, free);
    if !bent && (least..=most).contains(&free[2]) {
        return [0.0; 3];
    }
    let apart: [f64; 3] = std::array::from_fn(|k| free[k] - circle[k]);
    if bent || !free[2].is_finite() {
        return farthest;
    }
    // The free circle of a nearly straight arc is arbitrarily far away; only its direction is
    // known.
    let scale = (most / apart[2].abs()).min(1.0);
    apart.map(|entry| scale * entry)
}

/// Direction from the middle of the hits to the centre, which moves along it as the radius grows.
fn away(arc: &Arc, [x, y, _]: [f64; 3]) -> [f64; 2] {
    let middle = centroid(&arc.hits);
    let (dx, dy) = (x - middle[0], y - middle[1]);
    let length = libm::hypot(dx, dy).max(1e-9);
    [dx / length, dy / length]
}

/// True if the centre lies between the sensor and the hits.
fn bends_inwards(arc: &Arc, circle: [f64; 3]) -> bool {
    let (middle, ahead) = (centroid(&arc.hits), away(arc, circle));
    ahead[0] * middle[0] + ahead[1] * middle[1] < 0.0
}

/// Variance of a uniform distribution.
fn variance_within([least, most]: [f64; 2]) -> f64 {
    (most - least) * (most - least) / 12.0
}

fn point(hit: &Hit) -> [f64; 2] {
    [hit.range * hit.cosine, hit.range * hit.sine]
}

/// Centroid of the hits.
fn centroid(hits: &[Hit]) -> [f64; 2] {
    let total: f64 = hits.iter().map(|hit| hit.weight).sum();
    let sum = |axis: usize| hits.iter().map(|hit| hit.weight * point(hit)[axis]).sum::<f64>();
    [sum(0) / total, sum(1) / total]
}

/// Moments of points about their centroid, scaled so that the mean of z = x^2 + y^2 is 1.
struct Moments {
    origin: [f64; 2],
    scale: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    xz: f64,
    yz: f64,
    zz: f64,
}

impl Moments {
    fn of(hits: &[Hit]) -> Option<Self> {
        let origin = centroid(hits);
        let total: f64 = hits.iter().map(|hit| hit.weight).sum();
        let centred = hits.iter().map(|hit| {
            let [x, y] = point(hit);
            (x - origin[0], y - origin[1], hit.weight / total)
        });
        let square: f64 = centred.clone().map(|(x, y, w)| w * (x * x + y * y)).sum();
        // At unit size one threshold decides for all distances and sizes what is a line.
        let scale = square.sqrt();
        if hits.len() < FEW || scale <= 0.0 {
            return None;
        }
        let mut found =
            Self { origin, scale, xx: 0.0, xy: 0.0, yy: 0.0, xz: 0.0, yz: 0.0, zz: 0.0 };
        for (x, y, w) in centred {
            let (x, y) = (x / scale, y / scale);
            let z = x * x + y * y;
            found.xx += w * x * x;
            found.xy += w * x * y;
            found.yy += w * y * y;
            found.xz += w * x * z;
            found.yz += w * y * z;
            found.zz += w * z * z;
        }
        Some(found)
    }

    /// Centre x, y and radius [m]; None if the points lie on a line.
    fn circle(&self, method: FitMethod) -> Option<[f64; 3]> {
        let root = match method {
            // Each fit is a generalised eigenvalue problem. Kasa's has the eigenvalue 0 and a bias
            // towards small circles on short arcs, which the other two correct.
            FitMethod::Kasa => 0.0,
            FitMethod::Pratt => self.root([4.0, 0.0], 1.0)?,
            _ => self.root([0.0, 4.0], 0.0)?,
        };
        let determinant = root * root - root + self.area();
        if determinant.abs() < FLAT {
            return None;
        }
        let x = 0.5 * (self.xz * (self.yy - root) - self.yz * self.xy) / determinant;
        let y = 0.5 * (self.yz * (self.xx - root) - self.xz * self.xy) / determinant;
        let pratt = if method == FitMethod::Pratt { 2.0 * root } else { 0.0 };
        let radius = (x * x + y * y + 1.0 + pratt).sqrt();
        let [x0, y0] = self.origin;
        Some([x0 + self.scale * x, y0 + self.scale * y, self.scale * radius])
    }

    fn area(&self) -> f64 {
        self.xx * self.yy - self.xy * self.xy
    }

    /// Smallest root >= 0 of the characteristic polynomial, by Newton's steps from zero, which
    /// never pass it.
    fn root(&self, [fourth, third]: [f64; 2], pratt: f64) -> Option<f64> {
        let (area, spread) = (self.area(), self.zz - 1.0);
        let (xz, yz) = (self.xz, self.yz);
        let constant =
            xz * (xz * self.yy - yz * self.xy) + yz * (yz * self.xx - xz * self.xy) - spread * area;
        let first = spread + 4.0 * area - xz * xz - yz * yz;
        let second = -3.0 - self.zz + 4.0 * pratt * area;
        let mut root = 0.0;
        let mut value = f64::INFINITY;
        for _ in 0..MOST_STEPS {
            let next = constant + root * (first + root * (second + root * (third + root * fourth)));
            let slope = first + root * (2.0 * second + root * (3.0 * third + root * 4.0 * fourth));
            // At the root only rounding is left: a value that no longer falls ends the search.
            if next.abs() >= value.abs() || slope == 0.0 {
                break;
            }
            value = next;
            root -= next / slope;
        }
        root.is_finite().then_some(root.max(0.0))
    }
}

/// The circle with its radius limited to `least`..`most` and its centre behind the hits as seen
/// from the sensor. Its point nearest to the middle of the hits stays in place.
fn bounded(arc: &Arc, [x, y, radius]: [f64; 3], [least, most]: [f64; 2]) -> [f64; 3] {
    let middle = centroid(&arc.hits);
    let (ahead, aside) = (middle[0] - x, middle[1] - y);
    // The middle of the hits is the centre: no direction to move along.
    let length = libm::hypot(ahead, aside);
    if length <= 0.0 || !radius.is_finite() {
        return behind(arc, [least, most]);
    }
    let outward = [ahead / length, aside / length];
    let nearest = [x + radius * outward[0], y + radius * outward[1]];
    if outward[0] * middle[0] + outward[1] * middle[1] > 0.0 {
        // Bent towards the sensor: as flat as allowed, away from it.
        return [nearest[0] + most * outward[0], nearest[1] + most * outward[1], most];
    }
    let radius = radius.clamp(least, most);
    [nearest[0] - radius * outward[0], nearest[1] - radius * outward[1], radius]
}

/// Circle whose diameter is the chord of the hits, behind their middle.
fn behind(arc: &Arc, [least, most]: [f64; 2]) -> [f64; 3] {
    let middle = centroid(&arc.hits);
    let ends = [arc.hits.first(), arc.hits.last()].map(|hit| hit.map_or(middle, point));
    let chord = libm::hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]);
    let radius = (0.5 * chord).clamp(least, most);
    let range = libm::hypot(middle[0], middle[1]);
    let factor = 1.0 + radius / range;
    [factor * middle[0], factor * middle[1], radius]
}

/// Covariance of x, y and radius [m^2] to first order: that of a geometric fit to ranges with equal
/// noise, combined with the information in the bounds of the radius.
fn covariance(arc: &Arc, [x, y, radius]: [f64; 3], parameters: &FitParameters) -> [[f64; 3]; 3] {
    let variance = parameters.range_std * parameters.range_std;
    let wide = variance_within(parameters.radius);
    // The bounds count as one measurement of the radius, and one of the centre about the hits.
    let mut information = Matrix3::from_diagonal(&Vector3::repeat(1.0 / wide));
    for hit in &arc.hits {
        let [px, py] = point(hit);
        let (dx, dy) = (px - x, py - y);
        let length = libm::hypot(dx, dy).max(1e-9);
        let row = Vector3::new(dx / length, dy / length, 1.0);
        information += row * row.transpose() * (hit.weight / variance);
    }
    let floor = 1e-12 * radius * radius;
    let inverse = information.try_inverse().unwrap_or_else(|| Matrix3::identity() * wide);
    let spread = inverse + Matrix3::identity() * floor;
    std::array::from_fn(|i| std::array::from_fn(|j| spread[(i, j)]))
}
