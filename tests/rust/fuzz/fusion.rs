//! Filters of one target and of many: every model and method, late and odd measurements.

use super::input::{Input, one_thread};
use lidar_core::Error;
use lidar_core::estimation::minimise::SimplexSearch;
use lidar_core::fusion::model_list::models;
use lidar_core::fusion::sensors::measurement::PolarValues;
use lidar_core::fusion::targets::noise_search::{fit, log_likelihood, quantities};
use lidar_core::fusion::{
    Filter, FusionParameters, ManyParameters, ManyTargets, Measurement, Method, Sensor,
    TargetAssociation, run, run_batch, smooth,
};

fn parameters(input: &mut Input<'_>) -> FusionParameters {
    let usual = match input.below(4) {
        0 => FusionParameters::paper(),
        1 => ManyParameters::default().filter,
        _ => FusionParameters::default(),
    };
    let models = models();
    let mut chosen = FusionParameters {
        model: models[input.below(models.len())].model,
        method: match input.below(6) {
            0 => Method::Linear,
            1 => Method::Extended,
            2 => Method::Sigma { spread: input.maybe(Input::share), carries: input.is_set() },
            3 => Method::Cubature,
            4 => Method::Interacting {
                models: std::array::from_fn(|_| input.is_set()),
                sojourn: input.positive(),
                quiet: input.maybe(Input::share),
            },
            _ => usual.method,
        },
        ..usual
    };
    if input.rarely() {
        chosen.lever = input.f64s();
        chosen.strengths.acceleration = input.f64();
        chosen.prior.speed = input.f64();
        chosen.sensing.lidar = input.f64s();
    }
    chosen
}

/// A measurement some time after the last one.
fn measurement(input: &mut Input<'_>, last_ns: &mut i64) -> Result<Measurement, Error> {
    let stamp_ns = input.stamp(*last_ns);
    let made = measurement_at(input, stamp_ns)?;
    *last_ns = stamp_ns;
    Ok(made)
}

fn measurement_at(input: &mut Input<'_>, stamp_ns: i64) -> Result<Measurement, Error> {
    const SENSORS: [Sensor; 8] = [
        Sensor::Lidar,
        Sensor::Lidar,
        Sensor::Lidar,
        Sensor::Radar,
        Sensor::Radar,
        Sensor::Gyro,
        Sensor::Pose,
        Sensor::SpacePose,
    ];
    let sensor = input.one_of(&SENSORS);
    let count = match sensor {
        Sensor::Lidar => 2 + input.below(2),
        Sensor::Radar | Sensor::Pose => 3 + input.below(2),
        Sensor::Gyro => 1,
        Sensor::SpacePose => 6 + input.below(2),
    };
    let values = input.beside(count, Input::f64);
    let covariance = if input.rarely() {
        Some(input.covariance::<3>().into_iter().flatten().collect::<Vec<f64>>())
    } else {
        None
    };
    let made = if sensor == Sensor::Radar && input.rarely() {
        let given = std::array::from_fn(|_| input.is_set());
        Measurement::polar(stamp_ns, PolarValues::new(given)?, &values, covariance.as_deref())?
    } else {
        Measurement::new(stamp_ns, sensor, &values, covariance.as_deref())?
    };
    let _ = (made.sensor(), made.values(), made.measures().count(), made.measures().places());
    let _ = (made.measures().has(PolarValues::RANGE), made.has_covariance(), made.noisy());
    let _ = (made.variance(0), made.is_of_platform(), made.is_usable());
    if stamp_ns % 3 == 0 {
        let radar = made.with_seen_from([1.0 - values[0], 2.0]).unwrap_or(made);
        let _ = radar.seen_from();
        return Ok(radar);
    }
    Ok(made)
}

pub fn filter(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let parameters = parameters(&mut input);
    let Ok(mut filter) = Filter::new(&parameters) else { return };
    let _ = (parameters.model.noises(), parameters.model.is_in_space(), parameters.is_in_space());
    let _ = parameters.without_buffer();
    let mut stamp_ns = 0;
    for _ in 0..40 {
        if input.is_empty() {
            break;
        }
        let Ok(m) = measurement(&mut input, &mut stamp_ns) else { continue };
        match input.below(8) {
            0 => {
                filter.take(&m);
                filter.take(&m); // a message may come twice
            }
            1 => filter.absorb(m.stamp_ns(), &[(input.share(), m)]),
            _ => {
                filter.step(&m);
            }
        }
    }
    let _ = (filter.stamp_ns(), filter.errors(), filter.output(), filter.output_at(stamp_ns));
    let state = filter.to_state(&parameters).ok();
    let again = state.as_ref().map(|state| Filter::from_state(&parameters, state));
    let again = again.and_then(|made| made.ok());
    let again = again.and_then(|filter| filter.to_state(&parameters).ok());
    assert_eq!(again, state);
}

pub fn many(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let mut parameters = ManyParameters::default();
    if input.rarely() {
        parameters.filter = self::parameters(&mut input);
    }
    match input.below(4) {
        0 => parameters.association = TargetAssociation::Nearest,
        1 => {
            parameters.association =
                TargetAssociation::Joint { detection: input.share(), clutter: [1e-3, 1e-3] };
        }
        _ => {}
    }
    parameters.birth_distance = if input.rarely() { input.positive() } else { 0.0 };
    parameters.report_speed = if input.rarely() { input.positive() } else { 0.0 };
    let Ok(mut many) = ManyTargets::new(&parameters) else { return };
    let _ = many.parameters();
    let mut stamp_ns = 0;
    for _ in 0..20 {
        if input.is_empty() {
            break;
        }
        stamp_ns = input.stamp(stamp_ns);
        // Measurements of another time than their scan are refused.
        let scan: Vec<Measurement> = input
            .many(8, |input| {
                let at = if input.rarely() { input.stamp(stamp_ns) } else { stamp_ns };
                measurement_at(input, at)
            })
            .into_iter()
            .flatten()
            .collect();
        let source = input.byte() % 3;
        let before = many.to_state().ok();
        match many.process(stamp_ns, source, &scan) {
            Err(_) => assert_eq!(before, many.to_state().ok()), // a refused call changes nothing
            Ok(_) if input.is_set() => {
                let _ = many.process(stamp_ns, source, &scan); // a message may come twice
            }
            Ok(_) => {}
        }
    }
    let _ = (many.tracks_at(stamp_ns), many.work());
    let state = many.to_state().ok();
    let again = state.as_ref().map(|state| ManyTargets::from_state(&parameters, state));
    let again = again.and_then(|made| made.ok()).and_then(|many| many.to_state().ok());
    assert_eq!(again, state);
}

pub fn runs(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let parameters = parameters(&mut input);
    let mut stamp_ns = 0;
    let rows = input.many(30, |input| measurement(input, &mut stamp_ns));
    let rows: Vec<Measurement> = rows.into_iter().flatten().collect();
    let _ = run(&parameters, &rows);
    let lag_ns = input.maybe(|input| i64::from(input.byte()) << 24);
    let _ = smooth(&parameters, &rows, lag_ns);
    if let Ok(pool) = one_thread() {
        let _ = run_batch(pool, &parameters, &[&rows, &[]]);
    }
    if input.rarely() {
        let targets = [rows];
        let _ = log_likelihood(&parameters, &targets);
        let fitted = quantities(&parameters, &targets, input.is_set());
        let search = SimplexSearch { step: 0.5, tolerance: 1e-2, evaluations: 12 };
        let _ = fit(&parameters, &targets, &fitted, input.share(), &search);
    }
}
