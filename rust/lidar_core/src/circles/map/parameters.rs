//! Parameters of the map.

use crate::Error;
use crate::error::{require, require_positive};
use crate::estimation::chi2;
use std::ops::RangeInclusive;

/// Largest number of modes of motion.
pub const MAX_MODES: usize = 4;
/// Largest number of elements, and of circles in one scan.
pub const MAX_ELEMENTS: usize = 2_000;

/// Mode of motion: nearly constant velocity, driven by white acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionMode {
    /// Density of the acceleration [m^2/s^3].
    pub density: f64,
    /// Share of new elements, and of those that leave another mode, with this mode.
    pub weight: f64,
    /// Mean duration of the mode [s].
    pub duration: f64,
}

/// Standing still, as a mode of motion beside the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// Share of new elements at rest, below 1; 0 switches the mode off.
    pub share: f64,
    /// Mean time that an element stays at rest [s].
    pub duration: f64,
    /// Mean time that an element moves before it comes to rest [s].
    pub moving: f64,
    /// Density of the random walk of the centre [m^2/s], because the visible part of an object
    /// changes.
    pub density: f64,
    /// Standard deviation of the velocity with which an element starts to move, per axis [m/s].
    pub start_speed: f64,
    /// Probabilities of standing at which an element begins and ends to be reported as standing.
    pub hysteresis: [f64; 2],
}

/// Largest standard deviations of a visible element.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Limit for the centre, in its worst direction [m].
    pub position: f64,
    /// Limit for the velocity, in its worst direction [m/s].
    pub velocity: f64,
    /// Limit for the radius [m].
    pub radius: f64,
}

/// Test of the visibility of an element by the rays around its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibilityTest {
    /// Largest difference from the expected range for a ray on the element [m].
    pub margin: f64,
    /// Least number of rays for a decision.
    pub min_rays: usize,
}

/// Rules for wall lines of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineRules {
    /// Density of the random walk of the ends of a line, across the line [m^2/s].
    pub density: f64,
    /// Standard deviation of a surface from a straight line [m].
    pub std: f64,
    /// Gap in a surface above which there are two lines [m].
    pub gap: f64,
    /// Least length of a new line [m].
    pub length: f64,
    /// Largest root mean square distance of rays on a line, in standard deviations.
    pub reach: f64,
    /// Time for which lines stay while hidden or out of view [s]; None: for ever.
    pub coast: Option<f64>,
}

/// Line rules of the best mode.
impl Default for LineRules {
    fn default() -> Self {
        Self { density: 1e-6, std: 0.01, gap: 0.5, length: 0.5, reach: 3.0, coast: Some(60.0) }
    }
}

/// Parameters of the map with a filter per element.
#[derive(Clone, Debug, PartialEq)]
pub struct Independent {
    /// Modes of motion, 1 to [`MAX_MODES`].
    pub modes: Vec<MotionMode>,
    /// Mode of elements at rest.
    pub standing: Standing,
    /// Additional standard deviation of a centre beyond its fit, before the scans determine it [m].
    pub center_noise: f64,
    /// Density of the radius' random walk [m^2/s].
    pub radius_density: f64,
    /// Density of the random walk of the headings of ellipses and rectangles [rad^2/s].
    pub turn_density: f64,
    /// Density of circles without an element, per area and radius [1/m^3].
    pub birth_density: f64,
    /// Gap between two surfaces below which they count as one element [m].
    pub merge_gap: f64,
    /// Probability of existence from which on an element is reported. The report stops below half
    /// of this value.
    pub report_existence: f64,
    /// Largest standard deviations of a visible element; one above them is removed.
    pub limits: Limits,
    /// Time for which an element stays while hidden or out of view [s]; None: for ever.
    pub coast: Option<f64>,
    /// Test whether a scan should have measured an element.
    pub visibility_test: VisibilityTest,
    /// Largest time by which a scan may be older than the newest one [s].
    pub buffer_time: f64,
    /// Rules for wall lines of the map.
    pub lines: LineRules,
}

/// Modes of motion: density of the acceleration [m^2/s^3], weight, mean time [s].
const MODES: [MotionMode; 3] = [
    MotionMode { density: 0.1, weight: 0.4, duration: 2.0 },
    MotionMode { density: 0.5, weight: 0.599, duration: 2.0 },
    MotionMode { density: 200.0, weight: 0.001, duration: 0.1 },
];

/// One filter per element, as in the best mode.
impl Default for Independent {
    fn default() -> Self {
        Self {
            modes: MODES.to_vec(),
            standing: Standing {
                share: 0.5,
                duration: 10.0,
                moving: 5.0,
                density: 1e-4,
                start_speed: 1.0,
                hysteresis: [0.8, 0.4],
            },
            center_noise: 0.002,
            radius_density: 1e-6,
            turn_density: 0.01,
            birth_density: 1e-4,
            merge_gap: 0.15,
            report_existence: 0.9,
            limits: Limits { position: 1.0, velocity: 3.0, radius: 0.3 },
            coast: Some(5.0),
            visibility_test: VisibilityTest { margin: 0.15, min_rays: 4 },
            buffer_time: 0.25,
            lines: LineRules::default(),
        }
    }
}

/// The joint filter of eqs 8-33.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Standard deviation of the velocity's noise per step, n_fv of eq. 14 [m/s].
    pub velocity_step: f64,
    /// Eigenvalue of the covariance above which an element is removed, eq. 33; units are mixed.
    pub max_eigenvalue: f64,
}

/// Joint filter with the values of eqs 14 and 33.
impl Default for Joint {
    fn default() -> Self {
        Self { velocity_step: 0.1, max_eigenvalue: 3.0 }
    }
}

/// Filter of the elements.
#[allow(clippy::large_enum_variant)] // one value per map, made once
#[derive(Clone, Debug, PartialEq)]
pub enum ElementFilter {
    /// One filter for all elements and the robot, as published.
    Paper(Joint),
    /// A filter per element.
    Independent(Independent),
}

/// All parameters of the map.
#[derive(Clone, Debug, PartialEq)]
pub struct CircleMapParameters {
    /// Filter of the elements.
    pub filter: ElementFilter,
    /// Probability that a measurement of an element passes its gate.
    pub gate_probability: f64,
    /// Standard deviation of a new element's velocity, per axis [m/s].
    pub initial_speed: f64,
}

/// Map of the best mode: one filter per element.
impl Default for CircleMapParameters {
    fn default() -> Self {
        Self {
            filter: ElementFilter::Independent(Independent::default()),
            gate_probability: 0.9999,
            initial_speed: 1.5,
        }
    }
}

impl CircleMapParameters {
    /// Map with the joint filter as published.
    #[must_use]
    pub fn paper() -> Self {
        Self { filter: ElementFilter::Paper(Joint::default()), ..Self::default() }
    }
}

impl CircleMapParameters {
    /// Gate of circles, after a check of all values for memory safety, termination and meaningful
    /// covariances.
    ///
    /// # Errors
    /// [`Error::Parameter`] for the first value outside its range.
    pub(super) fn gate(&self) -> Result<f64, Error> {
        within("initial_speed", self.initial_speed, 1e-6..=1e6, "1e-6 to 1e6")?;
        match &self.filter {
            ElementFilter::Paper(joint) => {
                within("velocity_step", joint.velocity_step, 0.0..=1e3, "0 to 1000")?;
                require_positive("max_eigenvalue", joint.max_eigenvalue)?;
            }
            ElementFilter::Independent(independent) => independent.check()?,
        }
        chi2::quantile(self.gate_probability, 3)
    }
}

impl Independent {
    fn check(&self) -> Result<(), Error> {
        let count = self.modes.len();
        require((1..=MAX_MODES).contains(&count), "modes", "1 to 4 modes", count)?;
        // Wide limits, within which squares, ratios and matrix powers of the values stay finite.
        for mode in &self.modes {
            within("process_noise", mode.density, 0.0..=1e6, "0 to 1e6")?;
            within("mode_weight", mode.weight, 1e-6..=1e6, "1e-6 to 1e6")?;
            within("mode_time", mode.duration, 1e-3..=1e6, "0.001 to 1e6")?;
        }
        self.standing.check()?;
        not_negative("center_noise", self.center_noise)?;
        within("radius_noise", self.radius_density, 0.0..=1e3, "0 to 1000")?;
        within("turn_noise", self.turn_density, 0.0..=1e3, "0 to 1000")?;
        require_positive("birth_density", self.birth_density)?;
        not_negative("merge_gap", self.merge_gap)?;
        let report = self.report_existence;
        require(report > 0.0 && report < 1.0, "report_existence", "above 0 and below 1", report)?;
        require_positive("max_position_std", self.limits.position)?;
        require_positive("max_velocity_std", self.limits.velocity)?;
        require_positive("max_radius_std", self.limits.radius)?;
        not_negative("max_coast", self.coast.unwrap_or(0.0))?;
        not_negative("see_margin", self.visibility_test.margin)?;
        not_negative("buffer_time", self.buffer_time)?;
        self.lines.check()
    }
}

impl Standing {
    fn check(&self) -> Result<(), Error> {
        within("standing_share", self.share, 0.0..=0.999, "0 to 0.999")?;
        within("moving_time", self.moving, 1e-3..=1e6, "0.001 to 1e6")?;
        within("standing_time", self.duration, 1e-3..=1e6, "0.001 to 1e6")?;
        within("standing_noise", self.density, 0.0..=1e3, "0 to 1000")?;
        within("start_speed", self.start_speed, 1e-6..=1e6, "1e-6 to 1e6")?;
        let [begin, end] = self.hysteresis;
        require(
            0.0 <= end && end <= begin && begin <= 1.0,
            "standing_probability",
            "two probabilities, the second not above the first",
            format_args!("{begin} and {end}"),
        )
    }
}

impl LineRules {
    fn check(&self) -> Result<(), Error> {
        not_negative("line_noise", self.density)?;
        not_negative("line_std", self.std)?;
        not_negative("line_gap", self.gap)?;
        not_negative("line_length", self.length)?;
        not_negative("line_reach", self.reach)?;
        not_negative("line_coast", self.coast.unwrap_or(0.0))
    }
}

fn not_negative(name: &'static str, value: f64) -> Result<(), Error> {
    require(value.is_finite() && value >= 0.0, name, "finite and >= 0", value)
}

fn within(
    name: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
    expected: &'static str,
) -> Result<(), Error> {
    require(range.contains(&value), name, expected, value)
}
