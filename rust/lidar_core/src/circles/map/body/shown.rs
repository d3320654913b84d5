//! Reported form of a body: its circle, or a box around a body that is not round.

use super::body_box::BodyBox;
use super::places::moves_by;
use super::{BodyMeasurement, RoundBody};
use crate::Error;
use crate::circles::map::element_motion::ElementStep;
use crate::circles::map::modes::halted;
use crate::circles::map::rules::Rules;
use crate::estimation::kalman::Gaussian;

impl RoundBody {
    /// State as it is reported: a standing body has no velocity. The centre of a body that is not
    /// round is that of its box, or its covariance contains the invisible depth.
    pub(in crate::circles::map) fn reported(&self) -> Gaussian<5> {
        let mut state = self.circle();
        self.looks.widen(&mut state);
        let mut block = state.covariance.fixed_view_mut::<2, 2>(0, 0);
        block += self.outline.unseen(state.mean[4], self.sight);
        if let Some(extent) = &self.extent {
            state = extent.mixed(state, self.boxiness(extent));
        }
        if self.stands { halted(state) } else { state }
    }

    /// Weight of the box as outline of the body, 0 to 1. The box is used for a body that is not
    /// round and has moved, or that shows only a bent face. The shape of a standing body is known
    /// from its fits.
    pub(super) fn boxiness(&self, extent: &BodyBox) -> f64 {
        let is_box = if extent.has_moved() { 1.0 } else { self.outline.is_bent(self.sight) };
        self.outline.doubt() * is_box
    }

    /// Probability that the body stands, and its squared velocity, normalised by its covariance.
    pub(super) fn motion(&self, rules: &Rules) -> (f64, f64) {
        match self.extent.as_ref().filter(|_| self.outline.doubt() > 0.5) {
            Some(extent) => (extent.standing(rules.motion()), moves_by(&extent.circle())),
            None => (self.circle.standing(rules.motion()), moves_by(&self.circle())),
        }
    }

    /// Update the box around a body that may not be round. A body that is certainly round, or was
    /// seen on two legs, has no box.
    pub(super) fn surround(&mut self, seen: &BodyMeasurement, rules: &Rules) -> Result<(), Error> {
        let is_boxy = self.outline.doubt() > 0.0 && !self.person.has_legs();
        let Some((hull, look)) = seen.hull.as_ref().zip(seen.look.as_ref()).filter(|_| is_boxy)
        else {
            self.extent = self.extent.take().filter(|_| is_boxy);
            return Ok(());
        };
        let (seen, is_in_free) = ((look, seen.circle.delay), seen.is_in_free());
        match &mut self.extent {
            Some(extent) => extent.correct(hull, seen, is_in_free)?,
            None if hull.is_covered() => {}
            None => self.extent = Some(BodyBox::new(hull, seen, rules)),
        }
        self.extent = self.extent.take().filter(BodyBox::is_sound);
        Ok(())
    }

    /// Reported state after a time without scans; a standing body does not move.
    pub(in crate::circles::map) fn coasted(&self, step: &ElementStep) -> Gaussian<5> {
        if step.seconds == 0.0 {
            return self.reported();
        }
        let mut later = self.clone();
        later.circle.predict(&step.circles);
        if let Some(extent) = &mut later.extent {
            extent.predict(step);
        }
        let mut state = later.reported();
        if self.stands {
            state.mean = self.reported().mean;
        }
        state
    }
}
