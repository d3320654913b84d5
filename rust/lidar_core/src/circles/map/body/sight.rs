//! Evidence from rays for a body that a scan did not measure.

#![allow(non_snake_case)] // textbook letters

use super::RoundBody;
use super::places::axes;
use crate::Error;
use crate::circles::map::circle_measurement::CircleMeasurement;
use crate::circles::map::rules::Rules;
use crate::circles::map::view::viewpoint::Viewpoint;
use crate::circles::map::view::visibility::CircleVisibility;
use nalgebra::{Matrix3, Vector3};

/// Offsets from its centre at which a body is searched for, in standard deviations along each axis.
const LOOK: [f64; 4] = [-2.0, -1.0, 1.0, 2.0];
/// Standard deviation of the radius if the rays on a body are too few to measure it [m].
const ANY: f64 = 1.0;

impl RoundBody {
    /// Visibility of the body. It counts as seen through only if rays pass at every place where it
    /// may be.
    pub(super) fn visibility(&self, from: &Viewpoint, rules: &Rules) -> CircleVisibility {
        let Some(view) = &from.view else { return CircleVisibility::SeenThrough };
        let state = self.circle();
        let ask = |[x, y]: [f64; 2]| {
            let circle = from.pose.level([state.mean[0] + x, state.mean[1] + y], state.mean[4]);
            view.of(&circle, rules.visibility_test())
        };
        let here = ask([0.0, 0.0]);
        if here == CircleVisibility::Returns && self.is_somebody() {
            return CircleVisibility::Occluded; // these rays may end on someone who passes
        }
        if here != CircleVisibility::SeenThrough {
            return here;
        }
        let around = axes(&state)
            // A predicted place may be wrong by its deviation: before the body counts as gone, the
            // places around must be free as well.
            .into_iter()
            .flat_map(|axis| LOOK.map(|reach| axis.map(|value| value * reach)));
        around.map(ask).fold(here, CircleVisibility::max)
    }

    /// Probability that the body is outside the tested places (with its radius around them), for a
    /// normal distribution of its position.
    pub(super) fn share_beyond(&self, visibility: CircleVisibility) -> f64 {
        let state = self.circle();
        let std = (0.5 * (state.covariance[(0, 0)] + state.covariance[(1, 1)])).sqrt();
        let asked = match visibility {
            CircleVisibility::SeenThrough => LOOK[3],
            _ => 0.0,
        };
        let reach = asked + state.mean[4] / std;
        libm::exp(-0.5 * reach * reach)
    }

    /// Use rays that end on a standing body: too few to measure it, but they show that it has not
    /// moved. True if there are such rays.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]; nothing changes then.
    pub(super) fn take_glimpse(&mut self, from: &Viewpoint, rules: &Rules) -> Result<bool, Error> {
        let place = self.place();
        let Some(view) = from.view.as_ref().filter(|_| self.is_fixture()) else { return Ok(false) };
        let circle = from.pose.level([place[0], place[1]], place[2]);
        let Some(center) = view.glimpse(&circle, rules.visibility_test()) else { return Ok(false) };
        let [x, y] = circle.center;
        // The rays may meet any part of it, and it may be beside them by half of their spacing.
        let std = place[2] + 0.5 * view.step().abs() * libm::hypot(x, y);
        let [x, y] = from.pose.world_point(center);
        let seen = CircleMeasurement {
            z: Vector3::new(x, y, place[2]),
            R: Matrix3::from_diagonal(&Vector3::new(std * std, std * std, ANY * ANY)),
            delay: 0.0,
        };
        self.circle.weigh(&seen)?;
        Ok(true)
    }
}
