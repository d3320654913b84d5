//! Shape of a segment of a scan: circle, ellipse, rectangle or line, with its parameters.
//!
//! The paper treats every object as a circle and leaves other shapes to future work (sec. VII). Here every shape is
//! fitted to the ranges, and Schwarz's criterion chooses: misfit in variances plus the number of parameters times the
//! logarithm of the number of rays. Circles and ellipses also have to end where the object ends; ends of lines and
//! faces are parameters.

mod ellipse;
mod line;
mod place;
mod solve;

#[cfg(test)]
mod tests;

use self::ellipse::Ellipse;
use super::fit::arc::Arc;
use super::fit::circle::{Circle, CircleEstimate};
use super::fit::likelihood::Likelihood;
use super::fit::posterior::Posterior;
use super::fit::whole::{whole, width};
use super::fit::{FitMethod, FitParameters, estimate};
use super::preprocess::polar_scan::PolarScan;
use super::segment::segments::{Segments, Side};
use crate::Error;
use crate::util::cancel;
use serde::{Deserialize, Serialize};

/// Kind of a shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ShapeKind {
    /// Parameters: centre x, y, radius [m].
    Circle,
    /// Centre x, y, longer and shorter semi-axis [m], bearing of the longer one [rad].
    Ellipse,
    /// Centre x, y, longer and shorter side [m], bearing of the longer one [rad]. Two sides were
    /// seen.
    Rectangle,
    /// Bearing of its normal [rad], distance from the origin [m], and its two ends as positions
    /// along it, counted counter-clockwise from the foot of the normal [m].
    Line,
}

impl ShapeKind {
    /// Factor from lengths to half lengths; None for shapes without lengths.
    #[must_use]
    pub fn half_length(self) -> Option<f64> {
        match self {
            Self::Ellipse => Some(1.0),
            Self::Rectangle => Some(0.5),
            Self::Circle | Self::Line => None,
        }
    }
}

/// The shape of one segment, in the frame of the scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeEstimate {
    /// Kind of the shape.
    pub kind: ShapeKind,
    /// Parameters in the order stated at [`ShapeKind`]; unused ones are 0.
    pub parameters: [f64; 5],
    /// Covariance of the parameters, in their units.
    pub covariance: [[f64; 5]; 5],
    /// Sum of squared residuals of the ranges over their variance.
    pub misfit: f64,
    /// Number of rays that ended on the shape.
    pub n_hits: usize,
}

impl ShapeEstimate {
    /// The circle, if the shape is one; else None.
    #[must_use]
    pub fn circle(&self) -> Option<Circle> {
        let [x, y, radius, ..] = self.parameters;
        (self.kind == ShapeKind::Circle).then_some(Circle { center: [x, y], radius })
    }

    /// Both ends of the line [m], if the shape is one; else None.
    #[must_use]
    pub fn ends(&self) -> Option<[[f64; 2]; 2]> {
        let [angle, distance, start, end, _] = self.parameters;
        let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
        let at = |along: f64| [distance * cosine - along * sine, distance * sine + along * cosine];
        (self.kind == ShapeKind::Line).then_some([at(start), at(end)])
    }
}

/// Fits one shape to each segment of a scan. It reuses its buffers for every scan.
#[derive(Debug)]
pub struct ShapeFitter {
    parameters: FitParameters,
    arc: Arc,
    posterior: Posterior,
}

/// Least number of rays for a shape other than a circle.
const LEAST_HITS: usize = 6;
/// Decrease of the misfit from the circle, to first order, above which an ellipse is fitted, in logarithms of the
/// number of rays: its two additional parameters cost 2 in the criterion.
const LEAST_GAIN: f64 = 1.8;

impl ShapeFitter {
    /// Make a fitter with these parameters; circles are always fitted with [`FitMethod::Expected`].
    ///
    /// # Errors
    /// [`Error::Parameter`] for a parameter outside its range.
    pub fn new(parameters: FitParameters) -> Result<Self, Error> {
        parameters.check()?;
        let parameters = FitParameters { method: FitMethod::Expected, ..parameters };
        Ok(Self { parameters, arc: Arc::default(), posterior: Posterior::default() })
    }

    /// Set the standard deviation of the ranges [m] for the next fits.
    ///
    /// # Errors
    /// [`Error::Parameter`] if it is not positive.
    pub fn set_range_std(&mut self, range_std: f64) -> Result<(), Error> {
        let parameters = FitParameters { range_std, ..self.parameters };
        parameters.check()?;
        self.parameters = parameters;
        Ok(())
    }

    /// Write one shape per segment of a scan to `shapes`, in their order and in the frame of the scan
    /// [m, rad]; earlier contents are removed.
    ///
    /// # Errors
    /// [`Error::Value`] if a segment is empty, or contains a ray without a hit; [`Error::Length`] if ranges and
    /// bearings differ in number.
    pub fn fit(
        &mut self,
        scan: &PolarScan,
        segments: &Segments,
        shapes: &mut Vec<ShapeEstimate>,
    ) -> Result<(), Error> {
        self.fit_both(scan, segments, &mut Vec::new(), shapes)
    }

    /// Write one shape per segment to `shapes`, and the best fitting circle of each segment to
    /// `circles`, also of segments with another shape. Both are in the frame of the scan [m, rad], in
    /// the order of the segments; earlier contents are removed.
    ///
    /// # Errors
    /// [`Error::Value`] if a segment is empty, or contains a ray without a hit; [`Error::Length`] if ranges and
    /// bearings differ in number.
    pub fn fit_both(
        &mut self,
        scan: &PolarScan,
        segments: &Segments,
        circles: &mut Vec<CircleEstimate>,
        shapes: &mut Vec<ShapeEstimate>,
    ) -> Result<(), Error> {
        circles.clear();
        shapes.clear();
        scan.check_lengths()?;
        let wraps = scan.is_full_circle();
        for number in 0..segments.len() {
            cancel::check()?;
            self.arc.read((scan, wraps), segments, number, &self.parameters)?;
            let larger = self.larger((scan, wraps), segments, number)?;
            let (circle, shape) = self.shape_of_arc(larger);
            circles.push(circle);
            shapes.push(shape);
        }
        Ok(())
    }

    /// Circle of the arc and its misfit, if it is larger than usual and free space begins beside
    /// it; else None.
    fn larger(
        &mut self,
        scan: (&PolarScan, bool),
        segments: &Segments,
        number: usize,
    ) -> Result<Option<(CircleEstimate, f64)>, Error> {
        let is_seen = segments.sides.get(number).is_some_and(|sides| sides.contains(&Side::Free));
        if !is_seen || self.arc.n_hits < LEAST_HITS || !self.parameters.is_exceeded(&self.arc) {
            return Ok(None);
        }
        let wide = self.parameters.of_whole();
        // A hidden side may be farther away.
        self.arc.read(scan, segments, number, &wide)?;
        let found = whole(&self.arc, &wide, &mut self.posterior);
        if found.is_none() {
            self.arc.read(scan, segments, number, &self.parameters)?;
        }
        Ok(found)
    }

    /// Circle and shape of the arc; `larger` is its circle, if that is larger than usual, and its
    /// misfit.
    fn shape_of_arc(
        &mut self,
        larger: Option<(CircleEstimate, f64)>,
    ) -> (CircleEstimate, ShapeEstimate) {
        let (arc, std) = (&self.arc, self.parameters.range_std);
        let (circle, misfit) = larger.unwrap_or_else(|| {
            let estimated = self.posterior.of(&Likelihood { arc, parameters: &self.parameters });
            let log_likelihood = self.posterior.log_likelihood().filter(|_| estimated.is_some());
            let misfit = log_likelihood.map_or(f64::INFINITY, |log| -2.0 * log);
            (estimate(arc, &self.parameters, estimated), misfit)
        });
        let round = place::circle(arc, circle, misfit);
        if arc.n_hits < LEAST_HITS {
            return (circle, round);
        }
        let price = libm::log(arc.n_hits as f64);
        let mut best = (misfit + 3.0 * price, None);
        if let Some(line) = line::fit_line(arc, std, best.0 - 4.0 * price) {
            best = (line.misfit + 4.0 * price, Some(place::line(arc, &line)));
        }
        if let Some(corner) = line::fit_corner(arc, std, best.0 - 5.0 * price)
            && let Some(found) = place::rectangle(arc, &corner)
        {
            best = (corner.misfit + 5.0 * price, Some(found));
        }
        let ellipse = Ellipse { arc };
        if width(arc) <= 2.0 * self.parameters.radius[1]
            && (best.1.is_some() || ellipse.gain(&circle.circle, std) > LEAST_GAIN * price)
            && let Some(found) =
                ellipse::fit_ellipse(&ellipse, std, self.parameters.radius[1], best.0 - 5.0 * price)
        {
            best = (found.misfit + 5.0 * price, Some(place::ellipse(&ellipse, &found)));
        }
        (circle, best.1.unwrap_or(round))
    }
}
