//! Optical properties of surfaces: scattered, mirrored, transmitted and lost light.

use crate::refused;
use lidar_core::Error;
use lidar_core::geometry::transform::dot;

/// Reflectivity for which the range of a LiDAR is specified.
pub const RATED_REFLECTIVITY: f64 = 0.1;
/// Reflectivity, in fog, of bodies for which none is given.
pub const USUAL_REFLECTIVITY: f64 = 0.3;
/// Standard deviation of the logarithm of the returned power.
const FADING: f64 = 0.4;

/// Optical properties of a surface, as shares of the incident light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Share scattered back at normal incidence. The share is proportional to the cosine of the
    /// angle of incidence (Lambert).
    pub reflectivity: f64,
    /// Share mirrored at normal incidence, rising to 1 at grazing incidence; 0 for none at any
    /// angle.
    pub mirror: f64,
    /// Share of the light that is not mirrored and passes straight on.
    pub clear: f64,
}

/// Result of a ray at a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SurfaceInteraction {
    /// The light is scattered and may return.
    Scattered,
    /// The ray continues in this direction.
    Mirrored([f64; 3]),
    /// The ray continues straight on.
    Passed,
}

impl Surface {
    /// Check the values of the surface.
    ///
    /// # Errors
    /// [`Error::Parameter`] unless the reflectivity is finite and >= 0 and the shares are 0 to 1.
    pub fn check(&self) -> Result<(), Error> {
        if !(self.reflectivity.is_finite() && self.reflectivity >= 0.0) {
            return Err(refused("reflectivity", "finite and >= 0", &self.reflectivity));
        }
        for (name, share) in [("mirror", self.mirror), ("clear", self.clear)] {
            if !(0.0..=1.0).contains(&share) {
                return Err(refused(name, "0 to 1", &share));
            }
        }
        Ok(())
    }

    /// Share mirrored at the `cosine` of incidence.
    ///
    /// # Source
    /// Schlick, "An Inexpensive BRDF Model for Physically-based Rendering", 1994.
    #[must_use]
    pub fn mirrored(&self, cosine: f64) -> f64 {
        if self.mirror == 0.0 {
            return 0.0;
        }
        let grazing = (1.0 - cosine).clamp(0.0, 1.0);
        self.mirror + (1.0 - self.mirror) * grazing * grazing * grazing * grazing * grazing
    }

    /// Result of a ray in `direction` that hits the surface with `normal`; the two samples are
    /// uniform in (0, 1).
    #[must_use]
    pub fn interaction(
        &self,
        direction: [f64; 3],
        normal: [f64; 3],
        draws: [f64; 2],
    ) -> SurfaceInteraction {
        let along = dot(direction, normal);
        if draws[0] < self.mirrored(along.abs()) {
            return SurfaceInteraction::Mirrored(std::array::from_fn(|axis| {
                direction[axis] - 2.0 * along * normal[axis]
            }));
        }
        if draws[1] < self.clear {
            return SurfaceInteraction::Passed;
        }
        SurfaceInteraction::Scattered
    }
}

/// Returned power over the smallest detectable power.
///
/// The smallest detectable power is that of a surface of [`RATED_REFLECTIVITY`] at normal incidence
/// and at `range_max` in clear air. `extinction` [1/m] applies to both ways.
#[must_use]
pub fn signal(
    reflectivity: f64,
    cosine: f64,
    distance: f64,
    range_max: f64,
    extinction: f64,
) -> f64 {
    let nearness = range_max / distance;
    let through_air = libm::exp(-2.0 * extinction * distance);
    reflectivity / RATED_REFLECTIVITY * cosine * nearness * nearness * through_air
}

/// True if a return of mean `signal` is detected; `fading` is a sample of the standard normal
/// distribution.
#[must_use]
pub fn is_seen(signal: f64, fading: f64) -> bool {
    signal * libm::exp(FADING * fading) >= 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const GLASS: Surface = Surface { reflectivity: 0.02, mirror: 0.08, clear: 0.9 };

    #[test]
    fn light_is_mirrored_passed_or_scattered() {
        let (ahead, normal) = ([0.6, 0.0, -0.8], [0.0, 0.0, 1.0]);
        let share = 0.08 + 0.92 * 0.2f64.powi(5);
        assert!((GLASS.mirrored(0.8) - share).abs() < 1e-15);
        assert_eq!(GLASS.mirrored(0.0), 1.0);
        assert_eq!(
            GLASS.interaction(ahead, normal, [share - 1e-9, 0.0]),
            SurfaceInteraction::Mirrored([0.6, 0.0, 0.8])
        );
        assert_eq!(
            GLASS.interaction(ahead, normal, [share + 1e-9, 0.89]),
            SurfaceInteraction::Passed
        );
        assert_eq!(
            GLASS.interaction(ahead, normal, [share + 1e-9, 0.91]),
            SurfaceInteraction::Scattered
        );
        let matt = Surface { reflectivity: 0.3, mirror: 0.0, clear: 0.0 };
        assert_eq!(
            matt.interaction([1.0, 0.0, 0.0], normal, [1e-9, 1e-9]),
            SurfaceInteraction::Scattered
        );
    }

    #[test]
    fn power_falls_with_range_incidence_and_air() {
        assert_eq!(signal(0.1, 1.0, 100.0, 100.0, 0.0), 1.0);
        assert_eq!(signal(0.4, 0.5, 50.0, 100.0, 0.0), 8.0);
        assert!((signal(0.1, 1.0, 100.0, 100.0, 0.01) - libm::exp(-2.0)).abs() < 1e-15);
        assert!(is_seen(1.0, 0.0) && !is_seen(0.99, 0.0));
        assert!(is_seen(0.7, 1.0) && !is_seen(1.4, -1.0));
    }

    #[test]
    fn impossible_surfaces_are_refused() {
        for (reflectivity, mirror, clear) in
            [(-0.1, 0.0, 0.0), (f64::NAN, 0.0, 0.0), (0.1, 1.1, 0.0), (0.1, 0.0, -0.1)]
        {
            assert!(Surface { reflectivity, mirror, clear }.check().is_err());
        }
        assert!(GLASS.check().is_ok());
    }
}
