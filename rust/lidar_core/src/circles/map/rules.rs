//! Rules of the map with a filter per element: parameters, motion, gates.

use super::element_motion::ElementMotion;
use super::parameters::{Independent, LineRules, VisibilityTest};
use super::view::visibility::SortedView;
use crate::Error;
use crate::estimation::chi2;

/// Span of usual radii [m].
const RADII: f64 = 0.5;

/// Parameters of the map, with the model of motion and the gates that follow from them.
pub(super) struct Rules {
    parameters: Independent,
    motion: ElementMotion,
    gate: f64,
    line_gate: f64,
    outline_gate: f64,
    speed: f64,
}

impl Rules {
    /// Derive the rules from parameters, a gate probability and a speed [m/s].
    ///
    /// # Errors
    /// [`Error::Parameter`] for a probability outside 0 to 1.
    pub(super) fn new(
        parameters: Independent,
        probability: f64,
        speed: f64,
    ) -> Result<Self, Error> {
        let Independent { radius_density, turn_density, lines, .. } = parameters;
        let motion = ElementMotion::new(
            &parameters.modes,
            &parameters.standing,
            [radius_density, turn_density, lines.density],
        );
        // One probability for all kinds; each kind has its own number of measured values.
        let gate = |freedom| chi2::quantile(probability, freedom);
        let (gate, line_gate, outline_gate) = (gate(3)?, gate(2)?, gate(5)?);
        Ok(Self { parameters, motion, gate, line_gate, outline_gate, speed })
    }

    pub(super) fn parameters(&self) -> &Independent {
        &self.parameters
    }

    pub(super) fn lines(&self) -> &LineRules {
        &self.parameters.lines
    }

    pub(super) fn visibility_test(&self) -> &VisibilityTest {
        &self.parameters.visibility_test
    }

    pub(super) fn motion(&self) -> &ElementMotion {
        &self.motion
    }

    /// Density of circles without an element, per area and radius [1/m^3]: at least that of all
    /// `count` circles of a scan in the area that its `view` shows.
    pub(super) fn density(&self, count: usize, view: Option<&SortedView>) -> f64 {
        let least = self.parameters.birth_density;
        match view {
            Some(view) if self.has_standing() => {
                least.max(count.max(1) as f64 / ((view.area() + 1.0) * RADII))
            }
            _ => least,
        }
    }

    /// True if elements may stand.
    pub(super) fn has_standing(&self) -> bool {
        self.parameters.standing.share > 0.0
    }

    /// Gate of circles: chi-square, 3 degrees of freedom.
    pub(super) fn gate(&self) -> f64 {
        self.gate
    }

    /// Gate of lines: chi-square, 2 degrees of freedom.
    pub(super) fn line_gate(&self) -> f64 {
        self.line_gate
    }

    /// Gate of ellipses and rectangles: chi-square, 5 degrees of freedom.
    pub(super) fn outline_gate(&self) -> f64 {
        self.outline_gate
    }

    /// Standard deviation of the velocity of a new body [m/s].
    pub(super) fn speed(&self) -> f64 {
        self.speed
    }
}
