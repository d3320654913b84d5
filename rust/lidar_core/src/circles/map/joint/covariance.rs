//! Covariance of the joint filter: errors of the robot and of every element.

#![allow(non_snake_case)] // textbook letters

use nalgebra::{SMatrix, Vector3};
use serde::{Deserialize, Serialize};

/// Number of errors of the robot: position x and y, angle.
pub(super) const ROBOT: usize = 3;
/// Number of errors of an element, eq. 9: two of the position, two of the velocity, and the radius.
pub(super) const ELEMENT: usize = 5;

/// Covariance of all errors, row after row: the robot's first, then every element's.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Covariance {
    size: usize,
    values: Vec<f64>,
}

impl Covariance {
    /// Covariance of the robot alone, whose pose is exact.
    pub(super) fn empty() -> Self {
        Self { size: ROBOT, values: vec![0.0; ROBOT * ROBOT] }
    }

    /// True if the sizes of a restored state fit the robot and this number of elements.
    pub(super) fn is_of(&self, elements: usize) -> bool {
        let size = elements.checked_mul(ELEMENT).and_then(|size| size.checked_add(ROBOT));
        size == Some(self.size) && self.size.checked_mul(self.size) == Some(self.values.len())
    }

    /// Number of errors.
    pub(super) fn size(&self) -> usize {
        self.size
    }

    pub(super) fn at(&self, row: usize, column: usize) -> f64 {
        self.values[row * self.size + column]
    }

    pub(super) fn block<const R: usize, const C: usize>(
        &self,
        row: usize,
        column: usize,
    ) -> SMatrix<f64, R, C> {
        SMatrix::from_fn(|i, j| self.at(row + i, column + j))
    }

    /// Write a block and its mirror image.
    pub(super) fn set<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        column: usize,
        block: &SMatrix<f64, R, C>,
    ) {
        for i in 0..R {
            for j in 0..C {
                self.values[(row + i) * self.size + column + j] = block[(i, j)];
                self.values[(column + j) * self.size + row + i] = block[(i, j)];
            }
        }
    }

    /// Correct by eq. 30: (I - K H) P = P - K (P H')'.
    pub(super) fn reduce(&mut self, gains: &[Vector3<f64>], PHt: &[Vector3<f64>]) {
        for (row, gain) in gains.iter().enumerate() {
            // Only the lower triangle is computed and copied: K (P H')' is symmetric, but not in
            // its rounding.
            for (column, shared) in PHt.iter().enumerate().take(row + 1) {
                let value = self.at(row, column) - gain.dot(shared);
                self.values[row * self.size + column] = value;
                self.values[column * self.size + row] = value;
            }
        }
    }

    /// Add zeros for one more element.
    pub(super) fn grow(&mut self) {
        let size = self.size + ELEMENT;
        let mut values = vec![0.0; size * size];
        for row in 0..self.size {
            for column in 0..self.size {
                values[row * size + column] = self.at(row, column);
            }
        }
        *self = Self { size, values };
    }

    /// Covariance of the robot and of some of the elements.
    pub(super) fn of(&self, elements: &[usize]) -> Self {
        let kept: Vec<usize> = (0..ROBOT)
            .chain(elements.iter().flat_map(|&index| place(index)..place(index) + ELEMENT))
            .collect();
        let values =
            kept.iter().flat_map(|&row| kept.iter().map(move |&column| self.at(row, column)));
        Self { size: kept.len(), values: values.collect() }
    }
}

/// Index of the first error of an element.
pub(super) fn place(index: usize) -> usize {
    ROBOT + ELEMENT * index
}
