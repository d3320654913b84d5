//! How surfaces answer light: what returns, what is mirrored, what passes, what is lost.

use crate::shape::refused;
use lidar_core::Error;
use lidar_core::geometry::transform::dot;

/// Reflectivity of the surfaces that the range of a LiDAR is stated for.
pub const RATED_REFLECTIVITY: f64 = 0.1;
/// Reflectivity of surfaces that state none, in fog.
pub const USUAL_REFLECTIVITY: f64 = 0.3;
/// Scatter of the returned power about its mean: standard deviation of its logarithm.
const FADING: f64 = 0.4;

/// Shares of the light that meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Scattered back at normal incidence; it falls with the cosine (Lambert).
    pub reflectivity: f64,
    /// Mirrored at normal incidence, all of it at grazing incidence; 0 for none at any.
    pub mirror: f64,
    /// Passed on straight ahead, of what is not mirrored.
    pub clear: f64,
}

/// What becomes of a ray at a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fate {
    /// It scatters: what comes back may be seen.
    Scattered,
    /// It goes on in this direction.
    Mirrored([f64; 3]),
    /// It goes on straight ahead.
    Passed,
}

impl Surface {
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

    /// Share that is mirrored at the `cosine` of incidence.
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

    /// What becomes of a ray in `direction` that meets the surface with `normal`; the two draws
    /// are uniform in (0, 1).
    #[must_use]
    pub fn fate(&self, direction: [f64; 3], normal: [f64; 3], draws: [f64; 2]) -> Fate {
        let along = dot(direction, normal);
        if draws[0] < self.mirrored(along.abs()) {
            return Fate::Mirrored(std::array::from_fn(|axis| {
                direction[axis] - 2.0 * along * normal[axis]
            }));
        }
        if draws[1] < self.clear {
            return Fate::Passed;
        }
        Fate::Scattered
    }
}

/// Power that comes back over the least that is seen.
///
/// The least is what a surface of [`RATED_REFLECTIVITY`] gives, met head-on at `range_max` in
/// clear air. `extinction` [1/m] is that of the air, passed twice.
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

/// True if a return of mean `signal` is seen; `fading` is a draw of the standard normal
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
        assert_eq!(GLASS.fate(ahead, normal, [share - 1e-9, 0.0]), Fate::Mirrored([0.6, 0.0, 0.8]));
        assert_eq!(GLASS.fate(ahead, normal, [share + 1e-9, 0.89]), Fate::Passed);
        assert_eq!(GLASS.fate(ahead, normal, [share + 1e-9, 0.91]), Fate::Scattered);
        let matt = Surface { reflectivity: 0.3, mirror: 0.0, clear: 0.0 };
        assert_eq!(matt.fate([1.0, 0.0, 0.0], normal, [1e-9, 1e-9]), Fate::Scattered);
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
