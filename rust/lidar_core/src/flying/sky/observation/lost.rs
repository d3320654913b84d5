//! Parts of a scan whose data were lost, for example because packets of a network were lost.

use super::super::Sky;
use super::super::grid::{CELLS, COLUMNS, GRID};
use super::SkyObservation;
use crate::geometry::transform::Transform;

/// Smallest number of neighbouring columns, and of cells in them (`FEWEST_CELLS`), that return
/// nothing any more. Targets are smaller.
const FEWEST_COLUMNS: usize = 3;
/// Smallest number of cells in lost columns that returned lately.
const FEWEST_CELLS: usize = 6;
/// A cell has returned lately if fewer than this number of rays went into it since its last return.
const LATELY: f32 = 1.0;
/// Number of rays for which a scan with lost data counts. With this value, four such scans in a row
/// show that nothing is there.
const LOST_RAYS: f32 = 0.25;

impl SkyObservation {
    /// Find neighbouring columns of azimuth without any return, of a sensor with rows, in which
    /// much returned lately. It is not known which rays were cast there, so they are no evidence of
    /// sky.
    pub(super) fn find_lost(&mut self, sky: &Sky, map_from_lidar: &Transform) {
        self.is_lost.clear();
        self.is_lost.resize(CELLS, false);
        if !self.has_rows {
            return; // patterns that never repeat leave out other directions in every scan
        }
        let mut returns = [false; COLUMNS];
        for (&column, &count) in GRID.columns.iter().zip(&self.of_sensor) {
            returns[usize::from(column)] |= count > 0;
        }
        // Runs of empty columns begin after one that is not; a scan without any is none.
        let Some(start) = returns.iter().position(|&returns| returns) else { return };
        if returns.iter().all(|&returns| returns) {
            return;
        }
        let lidar_from_map = map_from_lidar.inverse();
        let column = |cell: usize| {
            usize::from(GRID.columns[GRID.cell(lidar_from_map.rotate(GRID.centers[cell]))])
        };
        let mut returned = [0; COLUMNS];
        for cell in (0..CELLS).filter(|&cell| self.expected[cell] > 0.0) {
            let has_returned = sky.surface[cell].is_finite();
            returned[column(cell)] += usize::from(has_returned && sky.evidence[cell] < LATELY);
        }
        let is_lost = lost_columns(&returns, start, &returned);
        if !is_lost.contains(&true) {
            return;
        }
        for cell in (0..CELLS).filter(|&cell| self.hits[cell] == 0) {
            let column = column(cell);
            // The columns beside it may be lost in part.
            let beside = [column, (column + 1) % COLUMNS, (column + COLUMNS - 1) % COLUMNS];
            if beside.into_iter().any(|column| is_lost[column]) {
                self.is_lost[cell] = true;
                self.evidence[cell] = sky.evidence[cell] + LOST_RAYS;
            }
        }
    }
}

/// Which columns are lost: runs of columns without `returns`, in which enough cells `returned`
/// lately. `start`: a column with returns.
fn lost_columns(
    returns: &[bool; COLUMNS],
    start: usize,
    returned: &[usize; COLUMNS],
) -> [bool; COLUMNS] {
    let mut is_lost = [false; COLUMNS];
    let mut run: Vec<usize> = Vec::new();
    for column in (0..=COLUMNS).map(|step| (start + step) % COLUMNS) {
        if !returns[column] {
            run.push(column);
            continue;
        }
        let seen = || run.iter().map(|&column| returned[column]).filter(|&cells| cells > 0);
        if seen().count() >= FEWEST_COLUMNS && seen().sum::<usize>() >= FEWEST_CELLS {
            run.iter().for_each(|&column| is_lost[column] = true);
        }
        run.clear();
    }
    is_lost
}
