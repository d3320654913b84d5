//! Particles in the air: rain, dust and fog, which give returns of their own.

use crate::parry::CastRay;
use crate::refused;
use lidar_core::Error;
use lidar_core::geometry::transform::{dot, minus, norm};
use std::f64::consts::PI;

/// Largest number of volumes of particles in one scene.
pub const MAX_VOLUMES: usize = 256;

/// Diameter of a ray where it leaves the sensor [m], and its growth with the range [rad]: those of
/// an Ouster OS1, from its data sheet.
const BEAM: [f64; 2] = [0.0095, 0.0031];

/// Share of a ray's section that a drop must fill to be seen, a typical value of sensors.
const VISIBLE_SHARE: f64 = 0.01;

/// Largest range at which droplets of fog give returns [m]: from further away too little light
/// comes back.
const SPECKLE_RANGE: f64 = 6.0;

/// A volume of particles. Every ray of every scan hits other particles: they are far smaller than
/// the gaps between rays, and move far between scans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Particles {
    /// Raindrops everywhere.
    Rain {
        /// Density of drops [1/m^3].
        density: f64,
        /// Diameter of a drop [m].
        size: f64,
    },
    /// A ball of dust that drifts.
    Dust {
        /// Centre at time 0 [m].
        center: [f64; 3],
        /// Drift [m/s].
        velocity: [f64; 3],
        /// Radius at time 0 [m].
        radius: f64,
        /// Growth of the radius [m/s].
        growth: f64,
        /// Mean length of a ray in it before it ends on a grain [m].
        free_path: f64,
    },
    /// Fog everywhere: light fades on its path, and droplets near the sensor give returns.
    Fog {
        /// Extinction of light per metre [1/m].
        extinction: f64,
        /// Rate of returns from droplets per metre [1/m].
        speckle: f64,
    },
}

impl Particles {
    /// Check all values.
    ///
    /// # Errors
    /// [`Error::Parameter`] if a value is outside the range that its field states.
    pub fn check(&self) -> Result<(), Error> {
        let positive = |name, value: f64| match value.is_finite() && value > 0.0 {
            true => Ok(()),
            false => Err(refused(name, "finite and > 0", &value)),
        };
        match *self {
            Self::Rain { density, size } => {
                positive("density", density)?;
                positive("size", size)
            }
            Self::Dust { center, velocity, radius, growth, free_path } => {
                if !center.iter().chain(&velocity).all(|value| value.is_finite()) {
                    return Err(refused("center", "finite", &center));
                }
                if !(growth.is_finite() && growth >= 0.0) {
                    return Err(refused("growth", "finite and >= 0", &growth));
                }
                positive("radius", radius)?;
                positive("free_path", free_path)
            }
            Self::Fog { extinction, speckle } => {
                positive("extinction", extinction)?;
                match speckle.is_finite() && speckle >= 0.0 {
                    true => Ok(()),
                    false => Err(refused("speckle", "finite and >= 0", &speckle)),
                }
            }
        }
    }

    /// Extinction of light per metre [1/m].
    #[must_use]
    pub fn extinction(&self) -> f64 {
        match *self {
            Self::Fog { extinction, .. } => extinction,
            Self::Rain { .. } | Self::Dust { .. } => 0.0,
        }
    }

    /// Distance [m] at which `ray` ends on a particle, from `start` [m] on, `seconds` after time 0;
    /// None if it passes all particles. `depth` is a sample of the standard exponential
    /// distribution, the optical depth at which the ray ends.
    pub(crate) fn meet(&self, ray: &CastRay, start: f64, seconds: f64, depth: f64) -> Option<f64> {
        match *self {
            Self::Rain { density, size } => {
                let [first, growth] = BEAM;
                // The rate per metre is density * PI / 4 * (first + growth * l + size)^2.
                let width = |length: f64| first + growth * length + size;
                let cube = width(start).powi(3) + 12.0 * growth * depth / (PI * density);
                let distance = (libm::cbrt(cube) - first - size) / growth;
                let seen_up_to = (size / VISIBLE_SHARE.sqrt() - first) / growth;
                (distance <= seen_up_to).then_some(distance)
            }
            Self::Dust { center, velocity, radius, growth, free_path } => {
                let to_center: [f64; 3] = std::array::from_fn(|axis| {
                    center[axis] + seconds * velocity[axis] - ray.origin[axis]
                });
                let along = dot(to_center, ray.direction);
                let aside = norm(minus(to_center, ray.direction.map(|part| part * along)));
                let radius = radius + growth * seconds.max(0.0);
                let half = (radius * radius - aside * aside).max(0.0).sqrt();
                let distance = (along - half).max(start) + free_path * depth;
                (distance <= along + half).then_some(distance)
            }
            Self::Fog { speckle, .. } => {
                let distance = start + depth / speckle; // infinite without droplets
                (distance <= SPECKLE_RANGE).then_some(distance)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AHEAD: CastRay = CastRay { origin: [0.0; 3], direction: [1.0, 0.0, 0.0] };

    #[test]
    fn a_ray_ends_in_dust_where_its_depth_is_reached() -> Result<(), Error> {
        let dust = Particles::Dust {
            center: [10.0, 0.0, 0.0],
            velocity: [0.0, 1.0, 0.0],
            radius: 2.0,
            growth: 0.5,
            free_path: 3.0,
        };
        dust.check()?;
        assert_eq!(dust.meet(&AHEAD, 0.3, 0.0, 0.5), Some(9.5));
        assert_eq!(dust.meet(&AHEAD, 9.0, 0.0, 0.5), Some(10.5));
        assert_eq!(dust.meet(&AHEAD, 0.3, 0.0, 1.5), None);
        assert_eq!(dust.meet(&AHEAD, 0.3, 1.0, 0.0), Some(10.0 - 5.25f64.sqrt()));
        assert_eq!(dust.meet(&AHEAD, 0.3, 9.0, 0.1), None);
        Ok(())
    }

    #[test]
    fn rain_is_met_at_the_rate_of_its_drops() -> Result<(), Error> {
        let rain = Particles::Rain { density: 100.0, size: 0.003 };
        rain.check()?;
        // Sum of the rate over small steps: the depth that reaches the far end.
        let rate = |l: f64| 100.0 * PI / 4.0 * (0.0095 + 0.0031 * l + 0.003).powi(2);
        let depth = |millimetres: i32| -> f64 {
            (0..millimetres).map(|k| 1e-3 * rate(1.0 + 1e-3 * (f64::from(k) + 0.5))).sum()
        };
        let found = rain.meet(&AHEAD, 1.0, 0.0, depth(4000));
        assert!(found.is_some_and(|distance| (distance - 5.0).abs() < 1e-6));
        assert!(rain.meet(&AHEAD, 1.0, 0.0, depth(5600)).is_some()); // at 6.6 m, seen up to 6.61 m
        assert!(rain.meet(&AHEAD, 1.0, 0.0, depth(5630)).is_none());
        Ok(())
    }

    #[test]
    fn fog_gives_returns_near_the_sensor_only() -> Result<(), Error> {
        let fog = |speckle| Particles::Fog { extinction: 0.02, speckle };
        fog(0.1).check()?;
        assert_eq!(fog(0.1).meet(&AHEAD, 0.5, 0.0, 0.25), Some(3.0));
        assert_eq!(fog(0.1).meet(&AHEAD, 0.5, 0.0, 0.6), None);
        assert_eq!(fog(0.0).meet(&AHEAD, 0.5, 0.0, 0.01), None);
        assert_eq!(fog(0.1).extinction(), 0.02);
        assert!(fog(-0.1).check().is_err());
        Ok(())
    }

    #[test]
    fn impossible_air_is_refused() {
        let rain = Particles::Rain { density: 0.0, size: 0.1 };
        assert!(rain.check().is_err());
    }
}
