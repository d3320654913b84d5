//! Circles from the segments of a scan, eq. 3, each with a covariance.

mod algebraic;
pub(super) mod arc;
pub mod circle;
pub(super) mod likelihood;
mod mode;
pub mod network_window;
pub(super) mod posterior;
mod row;
pub(super) mod whole;

#[cfg(test)]
mod tests;

use super::preprocess::polar_scan::PolarScan;
use super::segment::parameters::RANGE_LIMITS;
use super::segment::segments::Segments;
use crate::Error;
use crate::util::cancel;
use arc::Arc;
use circle::{Circle, CircleEstimate};
use likelihood::Likelihood;
use posterior::Posterior;

/// Method of the circle fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FitMethod {
    /// Least squares of x^2 + y^2 + a x + b y + c.
    Kasa,
    /// Least squares of Kasa's expression over the squared diameter.
    Pratt,
    /// Least squares of Kasa's expression over the mean squared gradient.
    Taubin,
    /// Expected circle, given the ranges and the rays that passed beside it: the mean of all possible circles, weighted
    /// by their probability.
    Expected,
    /// Most likely circle, given the ranges and the rays that passed beside it.
    MostLikely,
}

impl FitMethod {
    /// True for the algebraic methods, which use only the points and not the rays beside them.
    pub(super) fn is_algebraic(self) -> bool {
        matches!(self, Self::Kasa | Self::Pratt | Self::Taubin)
    }
}

/// Parameters of the circle fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitParameters {
    /// Fit method.
    pub method: FitMethod,
    /// Standard deviation of a range [m].
    pub range_std: f64,
    /// Half the width of a beam [rad]: a circle returns the beam if it reaches into this width.
    pub beam_half_width: f64,
    /// Smallest and largest radius [m]. With `Expected`, a circle beside which free space begins may be three
    /// times as large.
    pub radius: [f64; 2],
    /// Radius [m] up to which the prior probability of all radii is equal. Above it, the probability falls with the
    /// radius.
    pub usual_radius: f64,
    /// Smallest and largest range of the scan [m]; surfaces outside look like rays without return.
    pub range_limits: [f64; 2],
}

/// Fit of the expected circle, the method of the best mode.
impl Default for FitParameters {
    fn default() -> Self {
        Self {
            method: FitMethod::Expected,
            range_std: 0.01,
            beam_half_width: 0.0,
            radius: [0.02, 1.0],
            usual_radius: 0.5,
            range_limits: RANGE_LIMITS,
        }
    }
}

impl FitParameters {
    pub(super) fn check(&self) -> Result<(), Error> {
        let ([least, most], [near, far]) = (self.radius, self.range_limits);
        let refuse = |name, expected, got: String| Err(Error::Parameter { name, expected, got });
        if !(self.range_std > 0.0 && self.range_std.is_finite()) {
            return refuse("range_std", "a number > 0", self.range_std.to_string());
        }
        if !(0.0..0.1).contains(&self.beam_half_width) {
            return refuse("beam_half_width", "0 to 0.1", self.beam_half_width.to_string());
        }
        if !(least > 0.0 && least < most && most.is_finite()) {
            return refuse("radius", "0 < smallest < largest", format!("{:?}", self.radius));
        }
        if !(self.usual_radius > 0.0 && self.usual_radius.is_finite()) {
            return refuse("usual_radius", "a number > 0", self.usual_radius.to_string());
        }
        if !(near >= 0.0 && near < far) {
            return refuse("range_limits", "0 <= near < far", format!("{:?}", self.range_limits));
        }
        Ok(())
    }
}

/// Fits one circle to each segment of a scan. It reuses its buffers for every scan.
#[derive(Debug)]
pub struct Fitter {
    parameters: FitParameters,
    arc: Arc,
    posterior: Posterior,
    row: Segments,
}

impl Fitter {
    /// Make a fitter with these parameters.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a parameter outside its range.
    pub fn new(parameters: FitParameters) -> Result<Self, Error> {
        parameters.check()?;
        Ok(Self {
            parameters,
            arc: Arc::default(),
            posterior: Posterior::default(),
            row: Segments::default(),
        })
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

    /// Write one circle per segment of a scan to `circles`, in the order of the segments and in the
    /// frame of the scan.
    ///
    /// # Errors
    /// [`Error::Value`] if a segment is empty, or contains a ray without a hit; [`Error::Length`] if ranges and
    /// bearings differ in number.
    pub fn fit(
        &mut self,
        scan: &PolarScan,
        segments: &Segments,
        circles: &mut Vec<CircleEstimate>,
    ) -> Result<(), Error> {
        circles.clear();
        scan.check_lengths()?;
        // Neighbours across the seam of the scan exist only where it covers a full turn.
        let wraps = scan.is_full_circle();
        for number in 0..segments.len() {
            cancel::check()?;
            self.arc.read((scan, wraps), segments, number, &self.parameters)?;
            circles.push(self.circle_of_arc());
        }
        Ok(())
    }

    /// One circle fitted to all hits of a scan, in the frame of the scan; None if it has no hit.
    ///
    /// # Errors
    /// [`Error::Value`] for a range <= 0; [`Error::Length`] if ranges and bearings differ in
    /// number.
    pub fn fit_row(&mut self, scan: &PolarScan) -> Result<Option<CircleEstimate>, Error> {
        scan.check_lengths()?;
        let wraps = scan.is_full_circle();
        row::one_segment((scan, wraps), &self.parameters, &mut self.row);
        if self.row.is_empty() {
            return Ok(None);
        }
        self.arc.read((scan, wraps), &self.row, 0, &self.parameters)?;
        Ok(Some(self.circle_of_arc()))
    }

    fn circle_of_arc(&mut self) -> CircleEstimate {
        let parameters = &self.parameters;
        // Both likelihood methods share the integral and differ in the circle that they report.
        if !parameters.method.is_algebraic() {
            let found = self.posterior.of(&Likelihood { arc: &self.arc, parameters });
            return estimate(&self.arc, parameters, found);
        }
        // The order matters: the algebraic fit needs every hit, the integral is much faster on
        // averages.
        let (circle, roughly) = algebraic::fit(&self.arc, parameters);
        self.arc.join_hits();
        let arc = &self.arc;
        // The algebraic fits have no error model of their own; the integral measures how far the
        // circles lie that explain the rays equally well.
        match self.posterior.error_of(circle, &Likelihood { arc, parameters }) {
            Some(error) => placed(arc, algebraic::held(arc, parameters, (circle, error)), false),
            None => placed(arc, (circle, roughly), true),
        }
    }
}

/// Convert `found`, an estimate in the frame of an arc, to the frame of the scan. If it is None,
/// the algebraic fit takes its place. The covariance grows if the largest radius limits the circle.
pub(super) fn estimate(
    arc: &Arc,
    parameters: &FitParameters,
    found: Option<posterior::Estimate>,
) -> CircleEstimate {
    match found {
        Some(found) => placed(arc, algebraic::held(arc, parameters, found), false),
        None => placed(arc, algebraic::fit(arc, parameters), true),
    }
}

/// Transform a circle from the frame of the arc to the frame of the scan.
fn placed(
    arc: &Arc,
    ([x, y, radius], covariance): posterior::Estimate,
    is_fallback: bool,
) -> CircleEstimate {
    // Only the centre turns; the radius is the same in every frame.
    let (sine, cosine) = (libm::sin(arc.bearing), libm::cos(arc.bearing));
    let turn = [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]];
    let half = product(&turn, &covariance);
    let back: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| turn[j][i]));
    let center = [cosine * x - sine * y, sine * x + cosine * y];
    CircleEstimate {
        circle: Circle { center, radius },
        covariance: symmetric(&product(&half, &back)),
        n_hits: arc.n_hits,
        is_fallback,
    }
}

fn product(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    a.map(|row| std::array::from_fn(|j| (0..3).map(|k| row[k] * b[k][j]).sum()))
}

fn symmetric(a: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (a[i][j] + a[j][i])))
}
