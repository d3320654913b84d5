//! One visible face of a body whose other sides are known from earlier scans.
//!
//! A face shows where one side is, and nothing about the depth behind it. Without other knowledge,
//! its middle is assumed to be half of a half width behind it. If a rectangle showed two sides
//! before, its depth is known: the centre is half of this depth behind the face.

#![allow(non_snake_case)] // textbook letters

use super::measurement::BodyMeasurement;
use super::outline::Outline;
use crate::circles::map::circle_measurement::CircleMeasurement;
use crate::circles::shape::ShapeKind;
use crate::estimation::kalman::Gaussian;
use nalgebra::{Matrix3, Vector2, Vector3};
use std::f64::consts::FRAC_PI_2;

/// Distance of the centre behind a face without other information, in half widths. `selection.rs`
/// uses the same value.
const BEHIND: f64 = 0.5;
/// Ratio of half lengths below which an ellipse may be a face.
const FLAT: f64 = 0.5;
/// Least sine of the angle between the longer axis of such an ellipse and the line of sight.
const BROAD: f64 = 0.8;
/// Standard deviation of a side of a real body from its ideal place [m].
const SIDE: f64 = 0.03;
/// Largest difference between the half width of a face and that of the body, in standard
/// deviations, up to which the face is a side of this body.
const SAME: f64 = 3.0;

/// A face in the world: middle [m] and half width [m].
struct Face {
    middle: Vector2<f64>,
    half: f64,
}

impl BodyMeasurement {
    /// The visible face, if the measurement shows only one face; else None. `normal` is the
    /// direction across the face that points away from the scanner.
    fn face(&self, normal: Vector2<f64>) -> Option<Face> {
        let center = Vector2::new(self.circle.z[0], self.circle.z[1]);
        if self.is_face {
            let half = self.circle.z[2];
            return Some(Face { middle: center - normal * (BEHIND * half), half });
        }
        // Noise bends a face: it looks like the flat side of an ellipse then.
        let outline = self.outline.filter(|outline| outline.kind == ShapeKind::Ellipse)?;
        let (long, short) = (outline.z[3].max(outline.z[4]), outline.z[3].min(outline.z[4]));
        let bearing = outline.z[2] + if outline.z[4] > outline.z[3] { FRAC_PI_2 } else { 0.0 };
        let across = libm::cos(bearing) * self.sight[1] - libm::sin(bearing) * self.sight[0];
        let is_face = short < FLAT * long && across.abs() > BROAD;
        is_face.then(|| Face { middle: center - normal * short, half: long })
    }
}

impl Outline {
    /// Circle of the body from a measurement of one face and from the half lengths known from
    /// earlier scans. None if the measurement shows more than one face or a face of another width,
    /// or if the body is not known as a rectangle.
    pub(super) fn behind(&self, seen: &BodyMeasurement) -> Option<CircleMeasurement> {
        let (kind, Gaussian { mean, covariance: P }) = self.reported()?;
        if kind != ShapeKind::Rectangle || self.is_large() {
            return None;
        }
        let (sine, cosine) = (libm::sin(mean[4]), libm::cos(mean[4]));
        let sight = Vector2::from(seen.sight);
        let axes = [Vector2::new(cosine, sine), Vector2::new(-sine, cosine)];
        // The scanner sees two sides unless it faces one squarely: the better visible one counts.
        let depth = usize::from(axes[1].dot(&sight).abs() > axes[0].dot(&sight).abs());
        let normal = axes[depth] * axes[depth].dot(&sight).signum();
        let face = seen.face(normal)?;
        let (width, variance) = (mean[6 - depth], P[(6 - depth, 6 - depth)]);
        let off = face.half - width;
        if off * off > SAME * SAME * (variance + SIDE * SIDE) {
            return None;
        }
        let center = face.middle + normal * mean[5 + depth];
        let side = SIDE * SIDE;
        let along = normal * normal.transpose() * P[(5 + depth, 5 + depth)];
        let mut R = Matrix3::identity() * side;
        let mut block = R.fixed_view_mut::<2, 2>(0, 0);
        block += along;
        R[(2, 2)] += 0.25 * (P[(5, 5)] + P[(6, 6)]);
        let z = Vector3::new(center[0], center[1], 0.5 * (mean[5] + mean[6]));
        Some(CircleMeasurement { z, R, delay: seen.circle.delay })
    }
}

#[cfg(test)]
mod tests {
    use super::super::measurement::Legs;
    use super::super::outline::OutlineMeasurement;
    use super::*;
    use crate::Error;
    use crate::circles::map::rules::Rules;
    use crate::circles::map::{CircleMapParameters, ElementFilter};
    use nalgebra::{SMatrix, SVector};

    /// A body at (3, 0) with its longer half length of 0.2 m under this bearing, seen from the origin.
    fn known(kind: ShapeKind, heading: f64) -> Result<Outline, Error> {
        let parameters = CircleMapParameters::default();
        let ElementFilter::Independent(independent) = parameters.filter else {
            return Err(Error::NotPositiveDefinite { matrix: "none" });
        };
        let rules = Rules::new(independent, parameters.gate_probability, parameters.initial_speed)?;
        Ok(Outline::new(Some(&outline(kind, heading, [0.2, 0.1])), false, &rules))
    }

    fn outline(kind: ShapeKind, heading: f64, half: [f64; 2]) -> OutlineMeasurement {
        OutlineMeasurement {
            kind,
            z: SVector::from([3.0, 0.0, heading, half[0], half[1]]),
            R: SMatrix::identity() * 1e-4,
            delay: 0.0,
            is_large: false,
        }
    }

    /// A face whose middle is at (x, 0), as the circle behind it.
    fn face(x: f64, half: f64) -> BodyMeasurement {
        BodyMeasurement {
            circle: CircleMeasurement {
                z: Vector3::new(x + BEHIND * half, 0.0, half),
                R: Matrix3::identity() * 1e-3,
                delay: 0.0,
            },
            round: None,
            outline: None,
            is_face: true,
            time_ns: 0,
            sight: [1.0, 0.0],
            look: None,
            hull: None,
            trace: None,
            legs: Legs::None,
        }
    }

    #[test]
    fn the_centre_is_as_far_behind_a_face_as_is_known() -> Result<(), Error> {
        for (heading, depth, half) in [(0.05, 0.2, 0.1), (FRAC_PI_2, 0.1, 0.2)] {
            let known = known(ShapeKind::Rectangle, heading)?;
            let found = known.behind(&face(2.5, half)).map(|found| found.z);
            let off = found.map(|z| (z - Vector3::new(2.5 + depth, 0.0, 0.15)).abs().max());
            assert!(off.is_some_and(|off| off < 0.01), "{found:?}");
            // Bent by noise, it looks like a flat ellipse.
            let mut bent = face(2.5, half);
            bent.circle.z[0] = 2.5 + 0.02;
            bent.is_face = false;
            bent.outline = Some(outline(ShapeKind::Ellipse, FRAC_PI_2, [half, 0.02]));
            let found = known.behind(&bent).map(|found| found.z[0]);
            assert!(found.is_some_and(|x| (x - 2.5 - depth).abs() < 0.01), "{found:?}");
        }
        Ok(())
    }

    #[test]
    fn another_face_and_what_is_no_box_tell_no_depth() -> Result<(), Error> {
        let rectangle = known(ShapeKind::Rectangle, 0.0)?;
        assert!(rectangle.behind(&face(2.5, 0.3)).is_none());
        assert!(known(ShapeKind::Ellipse, 0.0)?.behind(&face(2.5, 0.1)).is_none());
        let mut both = face(2.5, 0.1);
        both.is_face = false;
        for seen in [None, Some(outline(ShapeKind::Rectangle, 0.0, [0.2, 0.1]))] {
            both.outline = seen;
            assert!(rectangle.behind(&both).is_none());
        }
        // An ellipse that is deep, or seen from its end, shows more than a face.
        for (heading, short) in [(FRAC_PI_2, 0.07), (0.0, 0.02)] {
            both.outline = Some(outline(ShapeKind::Ellipse, heading, [0.1, short]));
            assert!(rectangle.behind(&both).is_none());
        }
        Ok(())
    }
}
