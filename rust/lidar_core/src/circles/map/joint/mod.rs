//! The published map: one error-state filter of the robot's pose and all elements.
//!
//! Source: Sanchez-Lopez et al., eqs 8-33. The sensor's level frame is the robot's here, so that
//! `t_S^R` = 0 and `R_S^R` = I. Sums run in fixed loops: the same bits on every platform.

#![allow(non_snake_case)] // textbook letters

mod covariance;
mod measurement;

use super::element::exceeds;
use super::element_motion::{Matrix5, transition};
use super::parameters::{Joint, MAX_ELEMENTS};
use super::place::matrix_of;
use super::scan::{CircleScan, ScanElements, check, too_many};
use super::view::level_pose::LevelPose;
use super::{MapElement, MapOutcome, seconds};
use crate::Error;
use crate::circles::fit::circle::CircleEstimate;
use crate::estimation::kalman::{Gaussian, mahalanobis, symmetrised};
use crate::tracking::kind::TrackKind;
use crate::util::budget::check_memory;
use crate::util::full_state::impossible;
use covariance::{Covariance, ELEMENT, ROBOT, place};
use measurement::{Matrix5x3, MeasurementModel, mapped};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};

/// Element of eq. 9, with the times and the count of its measurements.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Landmark {
    id: i64,
    x: SVector<f64, ELEMENT>,
    born_ns: i64,
    seen_ns: i64,
    n_measurements: u32,
}

/// State of the filter. The robot's pose is an input and not part of it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct JointState {
    stamp_ns: Option<i64>,
    /// Sensors that had a scan with that stamp.
    sensors: Vec<u32>,
    landmarks: Vec<Landmark>,
    P: Covariance,
}

/// Map with one filter for all elements.
pub(super) struct JointMap {
    parameters: Joint,
    gate: f64,
    speed: f64,
    state: JointState,
}

impl JointMap {
    pub(super) fn new(parameters: Joint, gate: f64, speed: f64) -> Self {
        Self { parameters, gate, speed, state: JointState::empty() }
    }

    pub(super) fn state(&self) -> &JointState {
        &self.state
    }

    /// Continue from a restored state.
    ///
    /// # Errors
    /// [`Error::Format`] if its parts do not agree.
    pub(super) fn restore(&mut self, state: JointState) -> Result<(), Error> {
        let is_sorted = state.landmarks.is_sorted_by(|one, next| one.id < next.id);
        if !is_sorted || !state.P.is_of(state.landmarks.len()) {
            return Err(impossible("elements and covariance of the joint filter differ"));
        }
        self.state = state;
        Ok(())
    }

    pub(super) fn reset(&mut self) {
        self.state = JointState::empty();
    }

    pub(super) fn numbers(&self) -> impl Iterator<Item = i64> {
        self.state.landmarks.iter().map(|landmark| landmark.id)
    }

    /// Check that a scan may follow the scans before it.
    ///
    /// # Errors
    /// [`Error::Time`] for a scan that is older than the last one, or the sensor's second of one
    /// stamp.
    pub(super) fn check_stamp(&self, (stamp_ns, sensor): (i64, u32)) -> Result<(), Error> {
        let Some(newest_ns) = self.state.stamp_ns else { return Ok(()) };
        let what = format!("scan of {stamp_ns} ns from sensor {sensor}");
        if stamp_ns < newest_ns {
            return Err(Error::Time {
                what: format!("{what}: expected none before {newest_ns} ns"),
            });
        }
        if stamp_ns == newest_ns && self.state.sensors.contains(&sensor) {
            return Err(Error::Time { what: format!("{what}: it was processed") });
        }
        Ok(())
    }

    /// Update the map with a scan: predict, associate, correct, create and delete elements.
    pub(super) fn update(
        &mut self,
        scan: &CircleScan<'_>,
        next_id: &mut i64,
    ) -> Result<MapOutcome, Error> {
        self.check_stamp((scan.stamp_ns, scan.sensor))?;
        let pose = check(scan)?;
        let elements = self.state.landmarks.len() + scan.estimates.len();
        let entries = (ROBOT + ELEMENT * elements).pow(2);
        check_memory("the covariance of a map", entries, 3 * size_of::<f64>())?;
        let mut state = self.state.clone(); // an error must not leave it half updated
        let mut number = *next_id;
        state.predict(scan, self.parameters.velocity_step);
        let matches = state.associate(&pose, scan.estimates, self.gate)?;
        state.correct(&pose, scan, &matches)?;
        let mut elements = Vec::new();
        for (estimate, found) in scan.estimates.iter().zip(matches) {
            let id = found.map_or(number, |index| state.landmarks[index].id);
            if found.is_none() {
                state.create(&pose, estimate, self.speed, id, scan.stamp_ns);
                number += 1;
            }
            elements.push(id);
        }
        if state.landmarks.len() > MAX_ELEMENTS {
            return Err(too_many(state.landmarks.len()));
        }
        state.delete(self.parameters.max_eigenvalue);
        (self.state, *next_id) = (state, number);
        let found = ScanElements { circles: elements, lines: Vec::new() };
        Ok(MapOutcome { late: false, found, merged: Vec::new() })
    }

    /// All elements, predicted to `stamp_ns` in one step.
    pub(super) fn at(&self, stamp_ns: i64) -> Vec<MapElement> {
        let Some(newest_ns) = self.state.stamp_ns else { return Vec::new() };
        let F = transition(seconds(newest_ns, stamp_ns));
        // The noise of the paper is per step: a prediction is one step, however long it is.
        let step = if stamp_ns == newest_ns { 0.0 } else { self.parameters.velocity_step };
        let landmarks = self.state.landmarks.iter().enumerate();
        landmarks
            .map(|(index, landmark)| {
                let P: Matrix5 = self.state.P.block(place(index), place(index));
                let covariance = symmetrised(F * P * F.transpose() + noise(step));
                MapElement {
                    id: landmark.id,
                    state: Gaussian { mean: F * landmark.x, covariance },
                    age: seconds(landmark.born_ns, stamp_ns),
                    seen_ns: landmark.seen_ns,
                    n_measurements: landmark.n_measurements,
                    visible: landmark.seen_ns == newest_ns,
                    confirmed: true,
                    person: 0.0,
                    existence: 1.0,
                    kinds: [1.0, 0.0, 0.0, 0.0, 0.0],
                    kind: TrackKind::Unknown,
                }
            })
            .collect()
    }
}

impl JointState {
    fn empty() -> Self {
        Self { stamp_ns: None, sensors: Vec::new(), landmarks: Vec::new(), P: Covariance::empty() }
    }

    /// Predict by eqs 12-15 and 21-22. The robot's pose and its covariance are replaced by those of
    /// the input; their correlation with the elements is lost.
    fn predict(&mut self, scan: &CircleScan<'_>, velocity_step: f64) {
        let before = self.stamp_ns.replace(scan.stamp_ns);
        if before != self.stamp_ns {
            self.sensors.clear();
        }
        self.sensors.push(scan.sensor);
        let dt = before.map_or(0.0, |stamp_ns| seconds(stamp_ns, scan.stamp_ns));
        let F = transition(dt);
        for (row, landmark) in self.landmarks.iter_mut().enumerate() {
            landmark.x = F * landmark.x;
            self.P.set::<3, ELEMENT>(0, place(row), &SMatrix::zeros());
            // Blocks on and below the diagonal are computed, `set` mirrors them: P stays exactly
            // symmetric.
            for column in 0..=row {
                let mut block: Matrix5 = self.P.block(place(row), place(column));
                block = F * block * F.transpose();
                if row == column {
                    block = symmetrised(block + noise(velocity_step));
                }
                self.P.set(place(row), place(column), &block);
            }
        }
        self.P.set::<3, 3>(0, 0, &input_covariance(scan));
    }

    /// Associate by eqs 23-26: the nearest element of every circle within the gate. Two circles may
    /// have the same element.
    fn associate(
        &self,
        pose: &LevelPose,
        estimates: &[CircleEstimate],
        gate: f64,
    ) -> Result<Vec<Option<usize>>, Error> {
        let mut matches = Vec::with_capacity(estimates.len());
        for estimate in estimates {
            let mut best = (gate, None);
            for (index, landmark) in self.landmarks.iter().enumerate() {
                let model = MeasurementModel::of(pose, &landmark.x);
                let y = measured(estimate) - model.z;
                let S = model.innovation_covariance(&self.P, index) + matrix_of(estimate);
                let distance = mahalanobis(&y, &symmetrised(S))?.squared;
                if distance < best.0 {
                    best = (distance, Some(index));
                }
            }
            matches.push(best.1);
        }
        Ok(matches)
    }

    /// Correct by eqs 27-30 with all pairs one after the other, which equals all at once. The
    /// robot's pose stays that of the input.
    fn correct(
        &mut self,
        pose: &LevelPose,
        scan: &CircleScan<'_>,
        matches: &[Option<usize>],
    ) -> Result<(), Error> {
        // All pairs are linearised at the predicted state: the result does not depend on their
        // order.
        let predicted: Vec<MeasurementModel> =
            self.landmarks.iter().map(|landmark| MeasurementModel::of(pose, &landmark.x)).collect();
        let mut dx = vec![0.0; self.P.size()];
        for (estimate, index) in scan.estimates.iter().zip(matches) {
            let Some(index) = *index else { continue };
            let model = &predicted[index];
            let PHt = model.cross_covariance(&self.P, index);
            let S = model.innovation_covariance(&self.P, index) + matrix_of(estimate);
            let factor =
                symmetrised(S).cholesky().ok_or(Error::NotPositiveDefinite { matrix: "S" })?;
            // Corrections of the pairs before are in `dx`, not yet in the state that the model was
            // made at.
            let y = measured(estimate) - model.z - model.expected(&dx, index);
            let gains: Vec<Vector3<f64>> = PHt.iter().map(|row| factor.solve(row)).collect();
            for (value, gain) in dx.iter_mut().zip(&gains) {
                *value += gain.dot(&y);
            }
            self.P.reduce(&gains, &PHt);
            let landmark = &mut self.landmarks[index];
            landmark.seen_ns = scan.stamp_ns;
            landmark.n_measurements = landmark.n_measurements.saturating_add(1);
        }
        for (index, landmark) in self.landmarks.iter_mut().enumerate() {
            landmark.x += SVector::from_column_slice(&dx[place(index)..place(index) + ELEMENT]);
        }
        Ok(())
    }

    /// Create an element by eqs 18-20 and 31-32, with its correlations to all others.
    fn create(
        &mut self,
        pose: &LevelPose,
        estimate: &CircleEstimate,
        speed: f64,
        id: i64,
        stamp_ns: i64,
    ) {
        let (x, G_robot, G_z) = mapped(pose, &measured(estimate));
        let mut own: Matrix5 = G_z * matrix_of(estimate) * G_z.transpose();
        // The first measurement has no velocity: it is zero, as uncertain as objects may move.
        own[(2, 2)] += speed * speed;
        own[(3, 3)] += speed * speed;
        let robot: Matrix3<f64> = self.P.block(0, 0);
        own += G_robot * robot * G_robot.transpose();
        let shared_robot: Matrix5x3 = G_robot * robot;
        // The error of the pose is part of the new element, and so of what it shares with all
        // elements that depend on the pose.
        let shared: Vec<Matrix5> = (0..self.landmarks.len())
            .map(|index| G_robot * self.P.block::<3, ELEMENT>(0, place(index)))
            .collect();
        self.P.grow();
        let row = place(self.landmarks.len());
        self.P.set(row, 0, &shared_robot);
        for (index, block) in shared.iter().enumerate() {
            self.P.set(row, place(index), block);
        }
        self.P.set(row, row, &symmetrised(own));
        self.landmarks.push(Landmark {
            id,
            x,
            born_ns: stamp_ns,
            seen_ns: stamp_ns,
            n_measurements: 1,
        });
    }

    /// Remove by eq. 33 elements whose covariance has an eigenvalue above the limit, and elements
    /// whose corrected radius is not positive, a case that the paper does not mention.
    fn delete(&mut self, max_eigenvalue: f64) {
        let stays = |index: usize| {
            let P: Matrix5 = self.P.block(place(index), place(index));
            self.landmarks[index].x[4] > 0.0 && !exceeds(&P, max_eigenvalue)
        };
        let kept: Vec<usize> = (0..self.landmarks.len()).filter(|&index| stays(index)).collect();
        if kept.len() < self.landmarks.len() {
            self.P = self.P.of(&kept);
            self.landmarks = kept.iter().map(|&index| self.landmarks[index].clone()).collect();
        }
    }
}

fn measured(estimate: &CircleEstimate) -> Vector3<f64> {
    let [x, y] = estimate.circle.center;
    Vector3::new(x, y, estimate.circle.radius)
}

/// Process noise Q of eq. 22 with n_fv of eq. 14, equal for all steps.
fn noise(velocity_step: f64) -> Matrix5 {
    let mut Q = Matrix5::zeros();
    Q[(2, 2)] = velocity_step * velocity_step;
    Q[(3, 3)] = velocity_step * velocity_step;
    Q
}

/// Covariance of the input: position and yaw.
fn input_covariance(scan: &CircleScan<'_>) -> Matrix3<f64> {
    const PLANAR: [usize; 3] = [0, 1, 5];
    scan.pose_covariance
        .map_or_else(Matrix3::zeros, |rows| Matrix3::from_fn(|i, j| rows[PLANAR[i]][PLANAR[j]]))
}
