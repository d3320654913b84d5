//! State of the detector for all its LiDARs.

use super::prepared::Prepared;
use super::raw_scan::RawScan;
use super::sensor::{SavedSensor, Sensor};
use crate::Error;
use crate::flying::map::saved_body::SavedBody;
use crate::flying::parameters::FlyingParameters;
use crate::geometry::lattice::wide;
use crate::util::budget::MAX_SENSORS;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// State of every LiDAR, by name.
#[derive(Clone, Default)]
pub(crate) struct Sensors {
    known: BTreeMap<String, Sensor>,
    /// The robot as an earlier run found it, by name of the sensor.
    recalled: BTreeMap<String, SavedBody>,
}

/// Points of a scan that are on the robot itself.
#[derive(Default)]
pub(crate) struct OwnBody {
    /// Indices of the points, ascending.
    pub(crate) rows: Vec<u32>,
    /// Share of the rays that end on the robot.
    pub(crate) share: f64,
    /// Whether turns have confirmed that the found voxels are the robot itself.
    pub(crate) is_decided: bool,
}

/// [`Sensors`] in a saved state.
#[derive(Serialize, Deserialize)]
pub(crate) struct SavedSensors {
    known: Vec<(String, SavedSensor)>,
    recalled: Vec<SavedBody>,
}

impl Sensors {
    /// The sensor `name`, which is added if it is new.
    ///
    /// # Errors
    /// [`Error::Limit`] if there would be more sensors than the detector can store.
    pub(crate) fn meet(
        &mut self,
        name: &str,
        parameters: &FlyingParameters,
    ) -> Result<&Sensor, Error> {
        if !self.known.contains_key(name) {
            if self.known.len() >= MAX_SENSORS {
                // Names from before the last reset: what was learnt of them helps only if they return.
                let unused = self.known.iter().find(|(_, sensor)| sensor.last_stamp_ns.is_none());
                if let Some(unused) = unused.map(|(name, _)| name.clone()) {
                    self.known.remove(&unused);
                }
            }
            check_count(self.known.len() + 1, name)?;
            let FlyingParameters { sensors, default_sensor, .. } = parameters;
            let mut sensor = Sensor::new(sensors.get(name).unwrap_or(default_sensor).clone());
            if let Some(saved) = self.recalled.get(name) {
                sensor.recall(saved);
            }
            self.known.insert(name.to_owned(), sensor);
        }
        Ok(&self.known[name])
    }

    /// Remove a sensor, because its first scan was refused.
    pub(crate) fn remove(&mut self, name: &str) {
        self.known.remove(name);
    }

    /// True if the sensor `name` is known.
    pub(crate) fn contains(&self, name: &str) -> bool {
        self.known.contains_key(name)
    }

    /// Number of known sensors.
    pub(crate) fn len(&self) -> usize {
        self.known.len()
    }

    /// The sensor `name`. None if it is not known.
    pub(crate) fn get(&self, name: &str) -> Option<&Sensor> {
        self.known.get(name)
    }

    /// The sensor `name`, to be changed. None if it is not known.
    pub(crate) fn get_mut(&mut self, name: &str) -> Option<&mut Sensor> {
        self.known.get_mut(name)
    }

    /// Known voxels of the robot for each sensor, including those of an earlier run.
    pub(crate) fn bodies(&self) -> Vec<SavedBody> {
        let mut bodies = Vec::new();
        for (name, sensor) in &self.known {
            if let Some((voxels, is_decided)) = sensor.body.as_ref().and_then(|body| body.known()) {
                let voxels = voxels.to_vec();
                bodies.push(SavedBody { sensor: name.clone(), is_decided, voxels });
            }
        }
        // A file has room for so many: what an earlier run knew of sensors that are not here comes last.
        let room = MAX_SENSORS.saturating_sub(bodies.len());
        let not_met = self.recalled.iter().filter(|(name, _)| !self.known.contains_key(*name));
        bodies.extend(not_met.take(room).map(|(_, body)| body.clone()));
        bodies.sort_by(|one, other| one.sensor.cmp(&other.sensor));
        bodies
    }

    /// Use the voxels of the robot that an earlier run found, for every sensor that has not found
    /// the robot itself.
    pub(crate) fn recall(&mut self, bodies: Vec<SavedBody>) {
        for body in &bodies {
            if let Some(sensor) = self.known.get_mut(&body.sensor) {
                sensor.recall(body);
            }
        }
        self.recalled = bodies.into_iter().map(|body| (body.sensor.clone(), body)).collect();
    }

    /// The state to save. Sensors restored from it give the same results, bit by bit.
    pub(crate) fn saved(&self) -> SavedSensors {
        let known = self.known.iter();
        SavedSensors {
            known: known.map(|(name, sensor)| (name.clone(), sensor.saved())).collect(),
            recalled: self.recalled.values().cloned().collect(),
        }
    }

    /// Sensors from a saved state.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no detector has, [`Error::Limit`] for too many sensors.
    pub(crate) fn restored(
        saved: SavedSensors,
        parameters: &FlyingParameters,
    ) -> Result<Self, Error> {
        let mut sensors = Self::default();
        for (name, state) in saved.known {
            sensors.meet(&name, parameters)?;
            if let Some(sensor) = sensors.known.get_mut(&name) {
                sensor.restore(state)?;
            }
        }
        let by_name = saved.recalled.into_iter().map(|body| (body.sensor.clone(), body));
        sensors.recalled = by_name.collect();
        Ok(sensors)
    }

    /// Forget everything that depends on the frame of a map that is no longer used.
    pub(crate) fn forget_places(&mut self) {
        for sensor in self.known.values_mut() {
            sensor.last_pose = None;
            sensor.forget_places();
        }
    }

    /// Accept any stamp for the next scan of every sensor.
    pub(crate) fn forget_stamps(&mut self) {
        for sensor in self.known.values_mut() {
            sensor.last_stamp_ns = None;
        }
    }

    /// Points of a scan on the robot itself, as far as the robot was found.
    pub(crate) fn own_body(&self, raw: &RawScan<'_>, scan: &Prepared) -> OwnBody {
        let sensor = self.known.get(raw.sensor);
        let Some((sensor, body)) = sensor.and_then(|one| Some((one, one.body.as_ref()?))) else {
            return OwnBody::default();
        };
        let is_decided = body.is_decided();
        if !body.is_found() {
            return OwnBody { is_decided, ..OwnBody::default() };
        }
        let on_it = |row: usize| {
            raw.no_return.is_none_or(|flags| !flags[row]) && body.holds(wide(raw.points[row]))
        };
        let rows: Vec<u32> =
            (0..raw.points.len()).filter(|&row| on_it(row)).map(|row| row as u32).collect();
        let share = scan.share_of_rays(&rows, sensor.parameters.returns_per_ray);
        OwnBody { rows, share, is_decided }
    }
}

/// Check that `len` sensors are not too many. `name`: the last of them, for the error message.
///
/// # Errors
/// [`Error::Limit`] if there are more sensors than the detector can store.
fn check_count(len: usize, name: &str) -> Result<(), Error> {
    if len <= MAX_SENSORS {
        return Ok(());
    }
    Err(Error::Limit {
        what: format!("sensor {name:?}, the detector's {len}th"),
        limit: MAX_SENSORS as u64,
        key: "give the scans of one LiDAR one name, always the same",
    })
}
