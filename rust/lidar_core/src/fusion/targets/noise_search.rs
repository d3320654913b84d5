//! Maximum likelihood estimation of process noise and measurement noise.

use super::any_filter::Filter;
use super::lifecycle::{LifecycleRules, Outcome};
use super::record::in_order;
use crate::Error;
use crate::error::require;
use crate::estimation::minimise::{SimplexSearch, minimise};
use crate::fusion::model_list::{MIXABLE, Model};
use crate::fusion::models::motion::Noise;
use crate::fusion::parameters::{FusionParameters, Method};
use crate::fusion::sensors::measurement::{Measurement, PolarValues};
use crate::util::cancel;

/// Number of measurements after which a filter no longer depends on its start.
const SETTLED: usize = 10;
/// Number of steps between two checks whether the search is interrupted.
const STEPS_PER_LOOK: usize = 16_384;
/// Largest factor by which a value may change, up or down.
const WIDEST: f64 = 1e3;
/// Coarse grid on which the search starts: factors on all process noise, and on all standard
/// deviations of sensors.
const COARSE: [f64; 5] = [0.01, 0.1, 1.0, 10.0, 100.0];
/// Number of the best grid points from which the search continues.
const STARTS: usize = 6;
/// Difference of log likelihoods at which each of these searches ends; only the best one continues.
const COARSE_TOLERANCE: f64 = 0.1;

/// Quantities that can be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Strength of a process noise.
    Process(Noise),
    /// Standard deviation of the LiDAR, one factor for both axes.
    Lidar,
    /// Standard deviation of a value of the radar, by its index in [`PolarValues`].
    Radar(usize),
}

/// Log likelihood of all measurements except the first ten of every target. Gates are open and
/// filters do not restart, so that it is a smooth function of the parameters.
///
/// # Errors
/// Errors of [`Filter::new`]; [`Error::Interrupted`] if the call is asked to stop.
pub fn log_likelihood(
    parameters: &FusionParameters,
    targets: &[Vec<Measurement>],
) -> Result<f64, Error> {
    let open = LifecycleRules {
        gate: [f64::INFINITY; 5],
        memory: None,
        loss_ratio: None,
        buffer_ns: 0,
        ..parameters.life
    };
    let parameters = FusionParameters { life: open, ..*parameters };
    let (watch, mut total) = (cancel::watch(), 0.0);
    for target in targets {
        let mut filter = Filter::new(&parameters)?;
        for (number, m) in target.iter().enumerate() {
            if number % STEPS_PER_LOOK == 0 {
                watch.check()?;
            }
            let step = filter.step(m);
            if step.outcome == Outcome::Singular {
                return Ok(f64::NEG_INFINITY);
            }
            if let (true, Some(innovation)) = (number >= SETTLED, step.innovation) {
                let constant = innovation.count as f64 * libm::log(std::f64::consts::TAU);
                total -= 0.5 * (innovation.nis + innovation.log_determinant + constant);
            }
        }
    }
    Ok(total)
}

/// Quantities to fit: the process noise of the model and, if `sensors` is true, the noise of
/// sensors whose measurements have no covariance.
#[must_use]
pub fn quantities(
    parameters: &FusionParameters,
    targets: &[Vec<Measurement>],
    sensors: bool,
) -> Vec<Quantity> {
    use crate::fusion::sensors::measurement::Sensor;
    let all = [Noise::Acceleration, Noise::Jerk, Noise::Turn];
    let used: Vec<Noise> = match parameters.method {
        Method::Interacting { models, .. } => {
            let mixed = MIXABLE.iter().zip(models).filter(|(_, is_used)| *is_used);
            mixed.flat_map(|(model, _)| model.noises()).collect()
        }
        _ => parameters.model.noises(),
    };
    let process = all.iter().filter(|noise| used.contains(noise));
    let mut found: Vec<Quantity> = process.map(|noise| Quantity::Process(*noise)).collect();
    let plain = |sensor| {
        let mut all = targets.iter().flatten();
        sensors && all.any(|m| m.sensor() == sensor && !m.has_covariance())
    };
    if plain(Sensor::Lidar) {
        found.push(Quantity::Lidar);
    }
    if plain(Sensor::Radar) {
        let rate = PolarValues::RANGE_RATE;
        let wanted = |place: &usize| {
            let mut all = targets.iter().flatten();
            let is_measured = |m: &Measurement| {
                m.sensor() == Sensor::Radar && !m.has_covariance() && m.measures().has(*place)
            };
            (*place != rate || !parameters.sensing.convert_radar) && all.any(is_measured)
        };
        found.extend((0..=rate).filter(wanted).map(Quantity::Radar));
    }
    found
}

/// Check that the model has a likelihood, and that there are enough measurements for the values.
fn check_can_fit(
    start: &FusionParameters,
    targets: &[Vec<Measurement>],
    fitted: &[Quantity],
) -> Result<(), Error> {
    let has_likelihood = !matches!(start.model, Model::Paper(_));
    require(has_likelihood, "model", "one with a likelihood", "\"paper\"")?;
    let count = targets.iter().map(|target| target.len().saturating_sub(SETTLED)).sum::<usize>();
    if count < SETTLED * (1 + fitted.len()) {
        let (name, got) = ("measurements", count.to_string());
        let expected = "at least ten per fitted value, after the first ten of every target";
        return Err(Error::Value { name, expected, index: 0, got });
    }
    Ok(())
}

/// Parameters `start` with the `fitted` quantities at their maximum likelihood over the
/// measurements of all targets, and the log likelihood. A fitted deviation of the range rate is at
/// least `least_rate` [m/s].
///
/// The likelihood has several maxima, since a filter with little noise may lose a target that
/// turns. The search therefore begins at the best points of a coarse grid, and continues from the
/// best result.
///
/// # Errors
/// Errors of [`Filter::new`]; [`Error::Value`] if there are too few measurements, or if they are
/// impossible with any noise; [`Error::Interrupted`] if the call is asked to stop.
pub fn fit(
    start: &FusionParameters,
    targets: &[Vec<Measurement>],
    fitted: &[Quantity],
    least_rate: f64,
    search: &SimplexSearch,
) -> Result<(FusionParameters, f64), Error> {
    check_can_fit(start, targets, fitted)?;
    let targets: Vec<Vec<Measurement>> =
        targets.iter().map(|target| in_order(target).into_owned()).collect();
    let scaled = |logs: &[f64]| {
        let mut parameters = *start;
        for (quantity, log) in fitted.iter().zip(logs) {
            let widest = libm::log(WIDEST);
            quantity.scale(&mut parameters, libm::exp(log.clamp(-widest, widest)));
        }
        if fitted.contains(&Quantity::Radar(PolarValues::RANGE_RATE)) {
            let variance = &mut parameters.sensing.radar[PolarValues::RANGE_RATE];
            *variance = variance.max(least_rate * least_rate);
        }
        parameters
    };
    let cost = |logs: &[f64]| log_likelihood(&scaled(logs), &targets).map(|value| -value);
    let evaluations = search.evaluations / 10;
    let coarse = SimplexSearch { tolerance: COARSE_TOLERANCE, evaluations, ..*search };
    let mut best = (f64::INFINITY, vec![0.0; fitted.len()]);
    for start in coarse_starts(fitted, cost)? {
        let (place, value) = minimise(&start, &coarse, cost)?;
        if value < best.0 {
            best = (value, place);
        }
    }
    if !best.0.is_finite() {
        let (name, expected) = ("measurements", "values that are possible with some noise");
        let got = "a likelihood of zero".to_owned();
        return Err(Error::Value { name, expected, index: 0, got });
    }
    let (logs, least) = minimise(&best.1, search, cost)?;
    Ok((scaled(&logs), -least))
}

/// Points of the coarse grid with the least cost, the best first. Among equal costs, the point
/// nearest to the start is first, so that values without influence do not change.
fn coarse_starts(
    fitted: &[Quantity],
    cost: impl Fn(&[f64]) -> Result<f64, Error>,
) -> Result<Vec<Vec<f64>>, Error> {
    let is_process = |quantity: &Quantity| matches!(quantity, Quantity::Process(_));
    let sensors: &[f64] = if fitted.iter().all(is_process) { &[1.0] } else { &COARSE };
    let mut places = Vec::with_capacity(COARSE.len() * sensors.len());
    for process in COARSE {
        for sensor in sensors {
            let factor = |one| if is_process(one) { process } else { *sensor };
            let logs: Vec<f64> = fitted.iter().map(|one| libm::log(factor(one))).collect();
            let value = cost(&logs)?;
            places.push((if value.is_nan() { f64::INFINITY } else { value }, logs));
        }
    }
    let squared = |logs: &[f64]| logs.iter().map(|log| log * log).sum::<f64>();
    places.sort_by(|a, b| a.0.total_cmp(&b.0).then(squared(&a.1).total_cmp(&squared(&b.1))));
    Ok(places.into_iter().take(STARTS).map(|(_, logs)| logs).collect())
}

impl Quantity {
    fn scale(self, parameters: &mut FusionParameters, factor: f64) {
        let (strengths, sensing) = (&mut parameters.strengths, &mut parameters.sensing);
        match self {
            Self::Process(Noise::Acceleration) => strengths.acceleration *= factor,
            Self::Process(Noise::Jerk) => strengths.jerk *= factor,
            Self::Process(Noise::Turn) => strengths.turn *= factor,
            Self::Process(Noise::Platform) => strengths.platform *= factor,
            Self::Process(Noise::Gyro | Noise::Absent) => {}
            Self::Lidar => sensing.lidar.iter_mut().for_each(|value| *value *= factor * factor),
            Self::Radar(index) => sensing.radar[index] *= factor * factor,
        }
    }
}
