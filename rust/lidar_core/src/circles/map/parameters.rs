//! Parameters of the map; the joint filter is the paper's.

use super::modes::MAX_MODES;
use crate::Error;
use crate::error::{require, require_positive};
use crate::estimation::chi2;
use std::ops::RangeInclusive;

/// Most elements, and most circles in one scan.
pub const MAX_ELEMENTS: usize = 2_000;
/// Most scans that confirmation looks back on: one bit each.
pub const MAX_WINDOW: u32 = 64;

/// One way in which a centre may move: with nearly constant velocity, driven by white acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Density of the acceleration [m^2/s^3].
    pub density: f64,
    /// Share of new elements, and of those that leave another mode, that move like this.
    pub weight: f64,
    /// Mean time that it lasts [s].
    pub duration: f64,
}

/// Largest standard deviations of an element that should be seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Of the centre, in its worst direction [m].
    pub position: f64,
    /// Of the velocity, in its worst direction [m/s].
    pub velocity: f64,
    /// Of the radius [m].
    pub radius: f64,
}

/// How long an element stays without a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patience {
    /// Scans in a row that must miss it, however long the times between them.
    pub scans: u32,
    /// While rays pass through its place [s].
    pub absent: f64,
    /// While rays end at its place, but no circle is found there [s].
    pub unmatched: f64,
    /// While it is hidden or out of view [s]; None: for ever.
    pub hidden: Option<f64>,
}

/// What it takes to see that an element is not there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Looking {
    /// A range that differs less from the expected one belongs to the element [m].
    pub margin: f64,
    /// Fewer rays tell nothing.
    pub min_rays: usize,
}

/// An element is reported once `hits` of the last `window` scans held it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Confirmation {
    /// Scans that held it, >= 1.
    pub hits: u32,
    /// Scans looked back on, `hits` to [`MAX_WINDOW`].
    pub window: u32,
}

/// What lines are like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineRules {
    /// Density of the random walk of their ends, across them [m^2/s].
    pub density: f64,
    /// Standard deviation of how far they depart from straight [m].
    pub std: f64,
    /// Stretches of one surface with more between them are two lines [m].
    pub gap: f64,
    /// Shorter stretches make no line [m].
    pub length: f64,
    /// Standard deviations that rays on a line may lie off it, root mean square.
    pub reach: f64,
    /// How long they stay hidden or out of view [s]; None: for ever.
    pub coast: Option<f64>,
}

/// A filter per element.
#[derive(Clone, Debug, PartialEq)]
pub struct Independent {
    /// Ways to move, 1 to [`MAX_MODES`].
    pub modes: Vec<Mode>,
    /// Density of the radius' random walk [m^2/s].
    pub radius_density: f64,
    /// Density of the random walk of the headings of ellipses and rectangles [rad^2/s].
    pub turn_density: f64,
    /// Density of circles that belong to no element [1/m^3]: per area and per radius.
    pub birth_density: f64,
    /// Elements with a smaller gap between their surfaces are one [m].
    pub merge_gap: f64,
    /// When elements are reported.
    pub confirmation: Confirmation,
    /// When elements are too uncertain.
    pub limits: Limits,
    /// When elements that are not measured go.
    pub patience: Patience,
    /// When they should have been measured.
    pub looking: Looking,
    /// How late a scan may come [s].
    pub buffer_time: f64,
    /// How lines are treated.
    pub lines: LineRules,
}

/// The joint filter of eqs 8-33.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Standard deviation of the velocity's noise per step, n_fv of eq. 14 [m/s].
    pub velocity_step: f64,
    /// An element goes when an eigenvalue of its covariance is larger, eq. 33; units are mixed.
    pub max_eigenvalue: f64,
}

/// What keeps the elements.
#[derive(Clone, Debug, PartialEq)]
pub enum Filter {
    /// One filter for all elements and the robot, as published.
    Paper(Joint),
    /// A filter per element.
    Independent(Independent),
}

/// Everything the map can be told.
#[derive(Clone, Debug, PartialEq)]
pub struct CircleMapParameters {
    /// What keeps the elements.
    pub filter: Filter,
    /// Probability that a true pair passes the gate.
    pub gate_probability: f64,
    /// Standard deviation of a new element's velocity, per axis [m/s].
    pub initial_speed: f64,
}

impl CircleMapParameters {
    /// Check what memory safety, termination and meaningful covariances need; the gate.
    ///
    /// # Errors
    /// [`Error::Parameter`] for the first value outside its range.
    pub(super) fn gate(&self) -> Result<f64, Error> {
        within("initial_speed", self.initial_speed, 1e-6..=1e6, "1e-6 to 1e6")?;
        match &self.filter {
            Filter::Paper(joint) => {
                within("velocity_step", joint.velocity_step, 0.0..=1e3, "0 to 1000")?;
                require_positive("max_eigenvalue", joint.max_eigenvalue)?;
            }
            Filter::Independent(independent) => independent.check()?,
        }
        chi2::quantile(self.gate_probability, 3)
    }
}

impl Independent {
    fn check(&self) -> Result<(), Error> {
        let count = self.modes.len();
        require((1..=MAX_MODES).contains(&count), "modes", "1 to 4 modes", count)?;
        for mode in &self.modes {
            within("process_noise", mode.density, 0.0..=1e6, "0 to 1e6")?;
            within("mode_weight", mode.weight, 1e-6..=1e6, "1e-6 to 1e6")?;
            within("mode_time", mode.duration, 1e-3..=1e6, "0.001 to 1e6")?;
        }
        within("radius_noise", self.radius_density, 0.0..=1e3, "0 to 1000")?;
        within("turn_noise", self.turn_density, 0.0..=1e3, "0 to 1000")?;
        require_positive("birth_density", self.birth_density)?;
        not_negative("merge_gap", self.merge_gap)?;
        let Confirmation { hits, window } = self.confirmation;
        require(
            (1..=MAX_WINDOW).contains(&window) && (1..=window).contains(&hits),
            "confirm_hits",
            "1 <= confirm_hits <= confirm_window <= 64",
            format_args!("{hits} of {window}"),
        )?;
        require_positive("max_position_std", self.limits.position)?;
        require_positive("max_velocity_std", self.limits.velocity)?;
        require_positive("max_radius_std", self.limits.radius)?;
        not_negative("absent_time", self.patience.absent)?;
        not_negative("unmatched_time", self.patience.unmatched)?;
        not_negative("max_coast", self.patience.hidden.unwrap_or(0.0))?;
        not_negative("see_margin", self.looking.margin)?;
        not_negative("buffer_time", self.buffer_time)?;
        self.lines.check()
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
