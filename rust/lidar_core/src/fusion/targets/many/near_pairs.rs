//! Search for the measurements of a scan that may be in the gate of a track, with a spatial index.

use crate::fusion::filter::engine::Innovation;
use crate::fusion::models::turn::{direction, wrapped};
use crate::fusion::sensors::measurement::{Measurement, PolarValues, Sensor};
use crate::fusion::sensors::observation::Observation;
use crate::fusion::sensors::sensing::Sensing;
use crate::fusion::targets::any_filter::Filter;
use crate::tracking::near::{NearIndex, Rectangle};
use crate::tracking::standing_clutter::{PlaceLog, StandingClutter};
use std::f64::consts::{PI, TAU};

/// Slack of a window, relative and in metres or radians: rounding must not cut off a measurement at
/// the edge of a gate.
const SLACK: f64 = 1e-9;

/// Position of a measurement in the world [m], and its standard deviation as the geometric mean of
/// both axes [m]; None for measurements that give no position.
pub(super) type Placed = Option<([f64; 2], f64)>;

/// Positions of measurements in the world. `unseen`: a filter without a target that holds the
/// motion of the platform.
pub(super) fn places_of(
    unseen: &Filter,
    sensing: &Sensing,
    measurements: &[Measurement],
) -> Vec<Placed> {
    let place = |m: &Measurement| {
        let observed = sensing.observation(m, 0.0)?;
        let Observation::Position { R, .. } = observed else { return None };
        let output = unseen.clone().step(m).output?;
        let half = libm::sqrt(libm::sqrt(R.determinant().max(0.0)));
        let place = [output.mean[0], output.mean[1]];
        place.iter().all(|value| value.is_finite()).then_some((place, half))
    };
    measurements.iter().map(place).collect()
}

/// Density of static clutter at each measurement [1/m^2]; zero for measurements that give no
/// position, and for range, bearing and range rate of a radar, whose density has other units.
pub(super) fn clutter_at(
    (standing, log): (&StandingClutter, &PlaceLog),
    stamp_ns: i64,
    measurements: &[Measurement],
    places: &[Placed],
) -> Vec<f64> {
    let known: Vec<([f64; 2], f64)> = places.iter().flatten().copied().collect();
    let mut densities = standing.densities(log, stamp_ns, &known).into_iter();
    let of = |(m, place): (&Measurement, &Placed)| {
        let density = place.and_then(|_| densities.next()).unwrap_or(0.0);
        if m.sensor() == Sensor::Lidar { density } else { 0.0 }
    };
    measurements.iter().zip(places).map(of).collect()
}

/// Measurements of targets in a scan, by place.
pub struct ScanIndex {
    sensors: Vec<SensorIndex>,
}

/// Measurements of one sensor.
struct SensorIndex {
    /// A measurement with the largest variances of all: a search window for it contains the window
    /// of every other one.
    probe: Measurement,
    numbers: Vec<usize>,
    /// False for sensors without an index: all their measurements are compared.
    is_indexed: bool,
    /// x and y of the LiDAR, range and bearing of the radar.
    native: NearIndex,
    /// Positions of the radar's ranges and bearings.
    converted: NearIndex,
    /// Largest variances of the converted positions, per axis [m^2].
    widest: [f64; 2],
}

impl ScanIndex {
    /// Index of the usable measurements of targets.
    #[must_use]
    pub fn new(measurements: &[Measurement], sensing: &Sensing) -> Self {
        // What is compared with each other has the same values.
        let mut kinds: Vec<(Sensor, PolarValues, usize)> = Vec::new();
        let kind = |m: &Measurement| (m.sensor(), m.measures(), m.noisy());
        for m in measurements.iter().filter(|m| !m.is_of_platform() && m.is_usable()) {
            if !kinds.contains(&kind(m)) {
                kinds.push(kind(m));
            }
        }
        let of = |wanted| {
            let own = measurements.iter().enumerate();
            let own = own.filter(|(_, m)| kind(m) == wanted && m.is_usable());
            SensorIndex::new(own.collect(), sensing)
        };
        Self { sensors: kinds.into_iter().filter_map(of).collect() }
    }

    /// Replace `found` by the indices of all measurements that may be within one of `gates` of a
    /// filter, in ascending order. The filter must have been predicted to the time of the scan.
    pub fn near(&self, filter: &mut Filter, gates: &[f64; 5], found: &mut Vec<usize>) {
        found.clear();
        for sensor in &self.sensors {
            let mut is_bounded = true;
            let is_defined = filter.innovations(&sensor.probe, &mut |_, innovation| {
                is_bounded &= sensor.collect(innovation, gates, found);
            });
            if !(is_defined && is_bounded) {
                found.extend(&sensor.numbers);
            }
        }
        found.sort_unstable();
        found.dedup(); // the parts of a filter see the same measurements
    }
}

impl SensorIndex {
    fn new(own: Vec<(usize, &Measurement)>, sensing: &Sensing) -> Option<Self> {
        let (_, first) = own.first()?;
        let (mut largest, mut widest) = ([0.0; 4], [0.0; 2]);
        let (mut native, mut converted) = (Vec::new(), Vec::new());
        for (number, m) in &own {
            let v = m.values();
            for (sum, variance) in largest.iter_mut().zip(sensing.variances(m)) {
                *sum = variance.max(*sum);
            }
            if m.sensor() == Sensor::Lidar {
                native.push(([v[0], v[1]], *number));
            } else if let Some(Observation::Position { z, R }) = sensing.observation(m, 0.0) {
                native.push(([v[0], wrapped(v[1])], *number));
                converted.push(([z.x, z.y], *number));
                widest = [0, 1].map(|k| R[(k, k)].max(widest[k]));
            }
        }
        let probe = first.with_variances(&largest[..first.noisy()]);
        let numbers = own.iter().map(|(number, _)| *number).collect();
        let (native, converted) = (NearIndex::new(native), NearIndex::new(converted));
        let is_indexed = first.sensor() == Sensor::Lidar || first.measures() == PolarValues::FLAT;
        Some(Self { probe, numbers, is_indexed, native, converted, widest })
    }

    /// Append the measurements near the prediction that the innovation of the probe contains; false
    /// if the innovation gives no bounds.
    fn collect(&self, innovation: &Innovation, gates: &[f64; 5], found: &mut Vec<usize>) -> bool {
        let gate = gates[innovation.count - 1];
        let (y, v) = (innovation.values, self.probe.values());
        // A normalised distance within the gate keeps every entry within its own deviation times
        // the root of the gate.
        let reach = |center: f64, variance: f64| {
            libm::sqrt(gate * variance) * (1.0 + SLACK) + SLACK * (1.0 + center.abs())
        };
        let around = |center: [f64; 2], more: [f64; 2]| {
            let half = [0, 1].map(|k| reach(center[k], innovation.variances[k] + more[k]));
            (center, half)
        };
        let (center, half) = match (self.probe.sensor(), innovation.count) {
            _ if !gate.is_finite() || !self.is_indexed => return false,
            (Sensor::Lidar, 2 | 3) => around([v[0] - y[0], v[1] - y[1]], [0.0; 2]),
            (Sensor::Radar, 3) => around([v[0] - y[0], wrapped(v[1] - y[1])], [0.0; 2]),
            (Sensor::Radar, 2) => {
                let [cosine, sine] = direction(v[1]);
                around([v[0] * cosine - y[0], v[0] * sine - y[1]], self.widest)
            }
            _ => return false,
        };
        if !half.iter().all(|half| half.is_finite()) {
            return false;
        }
        match (self.probe.sensor(), innovation.count) {
            (Sensor::Lidar, _) => self.native.collect(&Rectangle::around(center, half), found),
            (_, 2) => self.converted.collect(&Rectangle::around(center, half), found),
            _ => {
                let window = Rectangle::around(center, [half[0], half[1].min(PI)]);
                for turn in [-TAU, 0.0, TAU] {
                    self.native.collect(&window.shifted(turn), found);
                }
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::fusion::model_list::{MIXABLE, Model};
    use crate::fusion::parameters::{FusionParameters, Method};
    use crate::fusion::targets::lifecycle::{LifecycleRules, Outcome};

    const STEP_NS: i64 = 100_000_000;

    /// Numbers of a sequence of low discrepancy, evenly between 0 and 1.
    fn spread(k: usize) -> [f64; 3] {
        [0.819_172_513, 0.671_043_606, 0.549_700_477].map(|step| (0.5 + k as f64 * step) % 1.0)
    }

    /// LiDAR and radar measurements all around the sensor, some with a covariance of their own.
    fn scan(stamp_ns: i64, count: usize) -> Result<Vec<Measurement>, Error> {
        let one = |k: usize| {
            let [u, v, w] = spread(k);
            match k % 4 {
                0 => Measurement::new(
                    stamp_ns,
                    Sensor::Lidar,
                    &[60.0 * u - 30.0, 60.0 * v - 30.0],
                    None,
                ),
                1 => {
                    let own = [0.2 + w, 0.05, 0.05, 0.1];
                    let at = [60.0 * u - 30.0, 60.0 * v - 30.0];
                    Measurement::new(stamp_ns, Sensor::Lidar, &at, Some(&own))
                }
                // bearings beyond pi, as some files have them
                _ => {
                    let polar = [30.0 * u, 6.6 * v - 3.3, 4.0 * w - 2.0];
                    Measurement::new(stamp_ns, Sensor::Radar, &polar, None)
                }
            }
        };
        (0..count).map(one).collect()
    }

    /// Filters after three looks at targets, some beside the sensor and some behind it.
    fn filters(parameters: &FusionParameters) -> Result<Vec<Filter>, Error> {
        let mut made = Vec::new();
        for k in 0..60 {
            let [u, v, w] = spread(1_000 + k);
            let mut filter = Filter::new(parameters)?;
            let near = if k % 6 == 0 { 0.01 } else { 1.0 };
            for step in 0..3 {
                let x = near * (60.0 * u - 30.0) + 0.1 * step as f64;
                let y = near * (60.0 * v - 30.0) - 0.2 * step as f64;
                let m = if k % 2 == 0 {
                    Measurement::new(step * STEP_NS, Sensor::Lidar, &[x, y], None)?
                } else {
                    let polar = [libm::hypot(x, y), libm::atan2(y, x), w];
                    Measurement::new(step * STEP_NS, Sensor::Radar, &polar, None)?
                };
                filter.step(&m);
            }
            made.push(filter);
        }
        Ok(made)
    }

    /// Every pair within a gate is found, and its innovation has the bits that a copy of the filter
    /// gives; few others are looked at.
    #[test]
    fn near_pairs_are_those_of_comparing_all() -> Result<(), Error> {
        let sigma = Method::Sigma { spread: None, carries: false };
        let models = MIXABLE.map(|model| !model.is_in_space());
        let mixed = Method::Interacting { models, sojourn: 1.0, quiet: Some(0.1) };
        for (model, method) in [
            (Model::ConstantVelocity, Method::Linear),
            (Model::ConstantVelocity, Method::Extended),
            (Model::Ctrv, Method::Extended),
            (Model::CoordinatedTurn, sigma),
            (Model::Ctra, Method::Cubature),
            (Model::Ctrv, mixed),
        ] {
            let base = FusionParameters { model, method, ..FusionParameters::default() };
            let gate = LifecycleRules::gates(Some(0.99))?;
            let life =
                LifecycleRules { start_rows: 2, memory: None, loss_ratio: None, gate, ..base.life };
            let mut sensing = base.sensing;
            sensing.convert_radar = method == Method::Linear;
            let parameters = FusionParameters { life, sensing, ..base }.without_buffer();
            let measurements = scan(3 * STEP_NS, 800)?;
            let index = ScanIndex::new(&measurements, &sensing);
            let (mut near, mut looked, mut inside) = (Vec::new(), 0, 0);
            for mut filter in filters(&parameters)? {
                filter.foresee(3 * STEP_NS);
                index.near(&mut filter, &gate, &mut near);
                looked += near.len();
                for (number, m) in measurements.iter().enumerate() {
                    let (outcome, innovation) = filter.clone().take(m);
                    let expected = innovation.filter(|_| outcome == Outcome::Updated);
                    let found = filter.score(m).filter(|_| near.contains(&number));
                    assert_eq!(found, expected, "{method:?} {m:?}");
                    inside += usize::from(found.is_some());
                }
            }
            assert!(inside > 20, "{method:?}: the scan tests nothing");
            assert!(looked < 60 * 800 / 5, "{method:?}: {looked} looks for {inside} pairs");
        }
        Ok(())
    }
}
