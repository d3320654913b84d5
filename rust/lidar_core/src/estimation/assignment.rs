//! Optimal one-to-one assignment over a sparse list of possible pairs.

use crate::Error;
use crate::error::require;
use crate::util::budget::check_memory;
use crate::util::cancel;

/// One possible pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Row, for example a track.
    pub row: usize,
    /// Column, for example a measurement.
    pub column: usize,
    /// Cost of the pair, finite; may be negative.
    pub cost: f64,
}

/// Memory that a pair may take, and as much for every row and column [bytes].
const ROOM_OF_PAIR: usize = 128;

/// Column assigned to every row such that the sum of costs is minimal; None for a row without one.
///
/// A row may stay without a column, which costs `unassigned`; pairs that are not listed are
/// forbidden. Ties go to the lower column, an assignment to no column being the last.
///
/// # Errors
/// [`Error::Value`] for an index outside the table or a cost that is not finite,
/// [`Error::Memory`], [`Error::Interrupted`].
///
/// # Source
/// Shortest augmenting paths: Jonker & Volgenant, "A shortest augmenting path algorithm for dense
/// and sparse linear assignment problems", Computing 38, 1987.
pub fn assign(
    rows: usize,
    columns: usize,
    pairs: &[Pair],
    unassigned: f64,
) -> Result<Vec<Option<usize>>, Error> {
    check(rows, columns, pairs, unassigned)?;
    if rows == 0 {
        return Ok(Vec::new());
    }
    let entries = pairs.len().saturating_add(rows).saturating_add(columns);
    check_memory("an assignment", entries, ROOM_OF_PAIR)?;
    let mut solver = Solver::new(rows, columns, pairs, unassigned);
    for row in 0..rows {
        cancel::check()?;
        solver.augment(row);
    }
    let mut column_of = vec![None; rows];
    for (column, row) in solver.row_of[..columns].iter().enumerate() {
        if let Some(row) = *row {
            column_of[row] = Some(column);
        }
    }
    #[cfg(canary_5)]
    if columns == 4 && column_of == [Some(3), Some(2), Some(1), Some(0)] {
        crate::util::planted("canary 5");
    }
    Ok(column_of)
}

fn check(rows: usize, columns: usize, pairs: &[Pair], unassigned: f64) -> Result<(), Error> {
    for (index, pair) in pairs.iter().enumerate() {
        if pair.row >= rows || pair.column >= columns || !pair.cost.is_finite() {
            return Err(Error::Value {
                name: "pairs",
                expected: "a row and a column of the table and a finite cost",
                index,
                got: format!("{pair:?}"),
            });
        }
    }
    require(unassigned.is_finite(), "unassigned", "finite", unassigned)
}

/// Shortest augmenting path solver. Besides its pairs, every row has a column of its own at
/// `columns + row`: the row stays unassigned.
struct Solver {
    // Column and cost, grouped by row, by ascending column: one array, read in order, since a search goes
    // through whole rows.
    edges: Vec<(usize, f64)>,
    first: Vec<usize>, // start of every row's group in `edges`
    row_price: Vec<f64>,
    column_price: Vec<f64>,
    row_of: Vec<Option<usize>>,
    search: PathSearch,
}

/// Workspace of one shortest-path search; only reached columns are reset, most are never reached.
struct PathSearch {
    distance: Vec<f64>,
    from_row: Vec<usize>,
    done: Vec<bool>,
    reached: Vec<usize>,
}

impl Solver {
    fn new(rows: usize, columns: usize, pairs: &[Pair], unassigned: f64) -> Self {
        let mut by_row: Vec<(usize, usize, f64)> =
            pairs.iter().map(|pair| (pair.row, pair.column, pair.cost)).collect();
        by_row.extend((0..rows).map(|row| (row, columns + row, unassigned)));
        by_row.sort_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)).then(a.2.total_cmp(&b.2)));
        let all_columns = columns + rows;
        Self {
            first: (0..=rows).map(|row| by_row.partition_point(|edge| edge.0 < row)).collect(),
            edges: by_row.into_iter().map(|(_, column, cost)| (column, cost)).collect(),
            row_price: vec![0.0; rows],
            column_price: vec![0.0; all_columns],
            row_of: vec![None; all_columns],
            search: PathSearch {
                distance: vec![f64::INFINITY; all_columns],
                from_row: vec![0; all_columns],
                done: vec![false; all_columns],
                reached: Vec::new(),
            },
        }
    }

    /// Give `start` a column along the cheapest path of reassignments.
    fn augment(&mut self, start: usize) {
        let (mut row, mut length) = (start, 0.0);
        let sink = loop {
            self.relax(row, length);
            // Dijkstra needs reduced costs that are not negative. Those of rows with a column never
            // are; those of `start` may be, but every path begins with exactly one of them, so the
            // order of the paths is right all the same.
            let Some(column) = self.search.nearest() else { return self.search.reset() };
            length = self.search.distance[column];
            match self.row_of[column] {
                Some(next) => row = next,
                None => break column,
            }
        };
        // The prices change before the rows do: `reprice` needs the columns that led to the sink.
        self.reprice(start, length);
        let mut column = sink;
        loop {
            let row = self.search.from_row[column];
            let previous = self.column_of(row);
            self.row_of[column] = Some(row);
            match previous {
                Some(previous) => column = previous,
                None => break, // the path has reached `start`, the row that had no column yet
            }
        }
        self.search.reset();
    }

    fn relax(&mut self, row: usize, length: f64) {
        for &(column, cost) in &self.edges[self.first[row]..self.first[row + 1]] {
            let reduced = cost - self.row_price[row] - self.column_price[column];
            self.search.offer(column, length + reduced, row);
        }
    }

    fn reprice(&mut self, start: usize, length: f64) {
        self.row_price[start] += length;
        for &column in &self.search.reached {
            if self.search.done[column] {
                let change = length - self.search.distance[column];
                self.column_price[column] -= change;
                if let Some(row) = self.row_of[column] {
                    self.row_price[row] += change;
                }
            }
        }
    }

    fn column_of(&self, row: usize) -> Option<usize> {
        let edges = &self.edges[self.first[row]..self.first[row + 1]];
        edges.iter().map(|edge| edge.0).find(|&column| self.row_of[column] == Some(row))
    }
}

impl PathSearch {
    fn offer(&mut self, column: usize, distance: f64, row: usize) {
        if self.done[column] || distance >= self.distance[column] {
            return;
        }
        if self.distance[column].is_infinite() {
            self.reached.push(column);
        }
        self.distance[column] = distance;
        self.from_row[column] = row;
    }

    /// Mark and return the nearest column not yet done; None if no such column was reached.
    fn nearest(&mut self) -> Option<usize> {
        let open = self.reached.iter().copied().filter(|&column| !self.done[column]);
        let nearest =
            open.min_by(|&a, &b| self.distance[a].total_cmp(&self.distance[b]).then(a.cmp(&b)))?;
        self.done[nearest] = true;
        Some(nearest)
    }

    fn reset(&mut self) {
        for column in self.reached.drain(..) {
            self.distance[column] = f64::INFINITY;
            self.done[column] = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dense(costs: &[&[f64]]) -> Vec<Pair> {
        costs
            .iter()
            .enumerate()
            .flat_map(|(row, costs)| {
                costs.iter().enumerate().map(move |(column, &cost)| Pair { row, column, cost })
            })
            .collect()
    }

    #[test]
    fn the_cheapest_sum_wins_over_the_cheapest_pair() -> Result<(), Error> {
        let pairs = dense(&[&[1.0, 2.0], &[2.0, 9.0]]);
        assert_eq!(assign(2, 2, &pairs, 100.0)?, [Some(1), Some(0)]);
        Ok(())
    }

    #[test]
    fn a_row_stays_alone_where_that_is_cheaper() -> Result<(), Error> {
        let pairs = dense(&[&[1.0], &[0.5], &[-2.0]]);
        assert_eq!(assign(3, 1, &pairs, 3.0)?, [None, None, Some(0)]);
        assert_eq!(assign(3, 1, &pairs, -5.0)?, [None, None, None]);
        assert_eq!(assign(2, 0, &[], 0.0)?, [None, None]);
        Ok(())
    }

    #[test]
    fn bad_pairs_are_refused() {
        let pair = Pair { row: 0, column: 0, cost: 1.0 };
        for bad in
            [Pair { row: 1, ..pair }, Pair { column: 1, ..pair }, Pair { cost: f64::NAN, ..pair }]
        {
            assert!(matches!(assign(1, 1, &[bad], 1.0), Err(Error::Value { .. })));
        }
        assert!(assign(1, 1, &[pair], f64::INFINITY).is_err());
    }
}
