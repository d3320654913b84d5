//! Bindings of `lidar_core::estimation`.

use crate::arrays;
use crate::errors::BorderError;
use crate::guard::{detached, stoppable};
use lidar_core::Error;
use lidar_core::estimation::assignment::{Pair, assign};
use lidar_core::estimation::chi2;
use lidar_core::util::budget::check_memory;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Cost matrices with at most this many entries are solved within a millisecond.
const BRIEF: usize = 4096;

/// Assigned column for every row of a cost matrix, -1 for none; pairs with a cost above `gate` are
/// forbidden.
#[pyfunction]
#[pyo3(signature = (cost, *, gate, unassigned))]
pub(crate) fn assign_columns<'py>(
    py: Python<'py>,
    cost: PyReadonlyArray2<'py, f64>,
    gate: f64,
    unassigned: f64,
) -> Result<Bound<'py, PyArray1<i64>>, BorderError> {
    let [rows, columns] = [cost.shape()[0], cost.shape()[1]];
    let costs = arrays::flat("cost", &cost)?;
    let work = || {
        check_memory("a table of costs", costs.len(), size_of::<Pair>())?;
        let near = costs.iter().enumerate().filter(|(_, cost)| **cost <= gate);
        let pairs: Vec<Pair> = near
            .map(|(at, &cost)| Pair { row: at / columns, column: at % columns, cost })
            .collect();
        assign(rows, columns, &pairs, unassigned)
    };
    // A thread that watches for signals takes longer than a small table.
    let found = if costs.len() <= BRIEF { detached(py, work)? } else { stoppable(py, work)? };
    let found = found.into_iter().map(|column| column.map_or(-1, |column| column as i64));
    Ok(found.collect::<Vec<i64>>().into_pyarray(py))
}

#[pyfunction]
#[pyo3(signature = (probability, *, degrees))]
pub(crate) fn chi2_quantile(
    py: Python<'_>,
    probability: f64,
    degrees: i64,
) -> Result<f64, BorderError> {
    let degrees = u32::try_from(degrees).map_err(|_| Error::Parameter {
        name: "degrees",
        expected: "from 1 to 4294967295",
        got: degrees.to_string(),
    })?;
    detached(py, || chi2::quantile(probability, degrees))
}
