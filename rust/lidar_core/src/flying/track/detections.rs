//! Sets of detections: checks, and one hypothesis for each detection (newDetections of Algorithm
//! 2).

use super::belief::existence::SURE;
use super::belief::kinds::TargetShape;
use super::measurement::{Evidence, Measurement};
use super::parameters::{MAX_TRACKS, MeasurementForm, TrackerParameters};
use super::state::PointTrack;
use crate::Error;
use nalgebra::{Matrix3, Vector3};

/// Largest absolute coordinate of a position, and largest side of an object, that is accepted [m].
/// Every place on Earth is within it.
const LARGEST: f64 = 1e9;
/// Largest time of a measurement after the stamp of its scan that is accepted [s].
const MAX_DELAY: f64 = 10.0;

/// One set of detections: all of one stamp, in the frame of the tracker. Every list has one entry
/// per detection.
#[derive(Clone, Copy, Debug, Default)]
pub struct Detections<'a> {
    /// Stamp of the set [ns].
    pub stamp_ns: i64,
    /// Positions [m].
    pub positions: &'a [[f64; 3]],
    /// Covariance of every position [m^2]. None: all have the initial standard deviation of the
    /// parameters.
    pub covariance: Option<&'a [[[f64; 3]; 3]]>,
    /// Sides of the bounding box of every detection [m]. None: zero.
    pub extent: Option<&'a [[f64; 3]]>,
    /// Time at which each position was measured, after the stamp [s]. None: at the stamp.
    pub delay: Option<&'a [f64]>,
    /// Confidence of each detection, 0 to 1. None: no detection is certain.
    pub confidence: Option<&'a [f64]>,
    /// Whether each detection may be a part of a surface beside it. None: no detection is.
    pub is_joined: Option<&'a [bool]>,
    /// Whether a detection has more returns of surfaces around it than returns of its own; None: no
    /// detection has.
    pub is_among_surfaces: Option<&'a [bool]>,
    /// Size, fill and surroundings of each detection. None: unknown.
    pub shape: Option<&'a [TargetShape]>,
}

impl Detections<'_> {
    /// One hypothesis (a track with a single detection) per detection, in the order of the set.
    ///
    /// # Errors
    /// [`Error::Limit`], [`Error::Length`], or [`Error::Value`] for the first bad entry.
    pub(super) fn hypotheses(
        &self,
        parameters: &TrackerParameters,
    ) -> Result<Vec<PointTrack>, Error> {
        let count = self.positions.len();
        if count > MAX_TRACKS {
            return Err(too_many(count));
        }
        let lengths = [
            ("covariance", self.covariance.map(<[_]>::len)),
            ("extent", self.extent.map(<[_]>::len)),
            ("delay", self.delay.map(<[_]>::len)),
            ("confidence", self.confidence.map(<[_]>::len)),
            ("is_joined", self.is_joined.map(<[_]>::len)),
            ("is_among_surfaces", self.is_among_surfaces.map(<[_]>::len)),
            ("shape", self.shape.map(<[_]>::len)),
        ];
        for (name, length) in lengths {
            if let Some(got) = length.filter(|&length| length != count) {
                return Err(Error::Length { name, expected: count, got });
            }
        }
        (0..count)
            .map(|index| {
                let detection = self.measurement(index, parameters)?;
                let mut fresh = PointTrack::new(&detection, self.stamp_ns, parameters);
                fresh.first = Evidence {
                    is_sure: self.confidence.is_some_and(|confidence| confidence[index] >= SURE),
                    is_led: self.confidence.is_some_and(|confidence| confidence[index] <= 0.0),
                    is_among_surfaces: self.is_among_surfaces.is_some_and(|among| among[index]),
                    is_joined: self.is_joined.is_some_and(|joined| joined[index]),
                    shape: self.shape.map(|shape| shape[index]),
                };
                Ok(fresh)
            })
            .collect()
    }

    fn measurement(
        &self,
        index: usize,
        parameters: &TrackerParameters,
    ) -> Result<Measurement, Error> {
        let position = self.positions[index];
        let extent = self.extent.map_or([0.0; 3], |extent| extent[index]);
        let covariance = match self.covariance {
            Some(covariance) => known_covariance(&covariance[index], parameters),
            None => Matrix3::identity() * (parameters.initial_std[0] * parameters.initial_std[0]),
        };
        let is_length = |values: [f64; 3]| values.iter().all(|value| value.abs() <= LARGEST);
        let bad = |name, expected, got| Err(Error::Value { name, expected, index, got });
        if !is_length(position) {
            return bad("positions", "finite coordinates, up to 1e9 m", format!("{position:?}"));
        }
        let delay = match parameters.measurement {
            MeasurementForm::Paper => 0.0,
            MeasurementForm::Cluster | MeasurementForm::Center => {
                self.delay.map_or(0.0, |delay| delay[index])
            }
        };
        if !(-MAX_DELAY..=MAX_DELAY).contains(&delay) {
            return bad("delay", "at most 10 s", delay.to_string());
        }
        if !is_length(extent) || extent.iter().any(|&side| side < 0.0) {
            return bad("extent", "finite sides >= 0, up to 1e9 m", format!("{extent:?}"));
        }
        let is_narrow = covariance.iter().all(|value| value.abs() <= LARGEST * LARGEST);
        if !is_narrow || covariance.cholesky().is_none() || covariance != covariance.transpose() {
            let got = format!("{:?}", self.covariance.map_or([[0.0; 3]; 3], |all| all[index]));
            return bad("covariance", "a symmetric positive definite matrix, up to 1e18 m^2", got);
        }
        let position = Vector3::from(position);
        let (n_points, is_cut, row) = (0, false, None);
        Ok(Measurement { position, covariance, delay, extent, n_points, is_cut, row })
    }
}

pub(super) fn too_many(count: usize) -> Error {
    Error::Limit {
        what: format!("a set of {count} detections or tracks"),
        limit: MAX_TRACKS as u64,
        key: "split the set",
    }
}

/// Covariance of a detected position [m^2]. The paper (sec. III-F3) takes it as given, and the
/// covariance of a centre is complete. That of a centroid lacks the measurement noise
/// `measurement_std`, which is added.
fn known_covariance(rows: &[[f64; 3]; 3], parameters: &TrackerParameters) -> Matrix3<f64> {
    let given = Matrix3::from_fn(|row, column| rows[row][column]);
    match parameters.measurement {
        MeasurementForm::Paper | MeasurementForm::Center => given,
        MeasurementForm::Cluster => {
            given + Matrix3::identity() * (parameters.measurement_std * parameters.measurement_std)
        }
    }
}
