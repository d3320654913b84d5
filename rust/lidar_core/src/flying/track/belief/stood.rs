//! Places that gave returns again and again before a track began there.
//!
//! The crown of a tree, through which most rays pass, is free space in the map at times. Its next
//! returns then look like a new target. But earlier scans had returns at the same places, while a
//! flying target gives none at one place for seconds before it is seen. So every track knows the
//! places around its start that gave returns before. While it is at these, its target may be
//! something that stands there.

use crate::geometry::lattice::wide;
use crate::geometry::transform::{minus, norm};
use crate::util::key_hasher::KeyHasher;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Side of the cells into which returns are sorted [m]. The neighbours of a cell count with it.
const CELL: f64 = 0.3;
/// Returns are remembered for this time [ns], in up to `STEPS` time steps.
const WINDOW_NS: i64 = 4_000_000_000;
/// Largest number of time steps: one bit each.
const STEPS: usize = 64;
/// Returns less than this time [ns] before a track began may be of its own target and do not count.
const FRESH_NS: i64 = 300_000_000;
/// Smallest number of time steps before a track. With fewer, nothing is said about its places.
const FEWEST: u32 = 5;
/// A track knows the places within this distance of its start, along every axis [m].
const AROUND: f64 = 2.5;
/// Something that stood further than this from a track's start is not its own target [m].
const OTHER: f64 = 0.8;
/// Shortest time of observation for statements about what stood beside a target [ns]. In less time,
/// the path of a slow target looks the same.
const LONG_NS: i64 = 1_500_000_000;
/// Largest number of cells. Returns in further cells are ignored.
const MOST: usize = 100_000;
/// Share of time steps with returns: up to the first value nothing stood at a place, from the
/// second on something did. Targets on small circles, or at 0.5 m/s, reach 0.5 at their start.
const SHARES: [f64; 2] = [0.35, 0.6];

type PlaceCell = [i32; 3];

fn cell_of(place: [f64; 3]) -> PlaceCell {
    place.map(|value| (value / CELL).floor() as i32) // far beyond all places it saturates
}

/// Places of the returns of the last seconds that belong to no known object.
#[derive(Clone, Debug, Default)]
pub(in crate::flying::track) struct EarlierReturns {
    /// Time at which each step began [ns]. The index of the newest step is `newest`.
    began: Vec<i64>,
    newest: usize,
    /// For every cell, the time steps in which it gave returns: one bit per step.
    cells: HashMap<PlaceCell, u64, BuildHasherDefault<KeyHasher>>,
}

impl EarlierReturns {
    /// Add the positions [m] of the returns of a scan.
    pub(in crate::flying::track) fn add(
        &mut self,
        stamp_ns: i64,
        places: impl Iterator<Item = [f32; 3]>,
    ) {
        let step = WINDOW_NS / (STEPS as i64 - 4);
        let since = |began: &i64| stamp_ns.saturating_sub(*began);
        if self.began.get(self.newest).is_none_or(|began| since(began) >= step) {
            self.begin(stamp_ns);
        }
        let bit = 1 << self.newest;
        for place in places {
            let cell = cell_of(wide(place));
            if let Some(steps) = self.cells.get_mut(&cell) {
                *steps |= bit;
            } else if self.cells.len() < MOST {
                self.cells.insert(cell, bit);
            }
        }
    }

    /// Begin a new time step, which replaces the oldest one.
    fn begin(&mut self, stamp_ns: i64) {
        if self.began.len() < STEPS {
            self.newest = self.began.len();
            self.began.push(stamp_ns);
            return;
        }
        self.newest = (self.newest + 1) % STEPS;
        self.began[self.newest] = stamp_ns;
        let others = !(1 << self.newest);
        self.cells.retain(|_, steps| {
            *steps &= others;
            *steps != 0
        });
    }

    /// The places around the start of a track at `place` [m] that gave returns before it began at
    /// `born_ns`. Empty if too little was seen before.
    pub(in crate::flying::track) fn around(&self, place: [f64; 3], born_ns: i64) -> StoodPlaces {
        let [last, first] = [FRESH_NS, WINDOW_NS].map(|before| born_ns.saturating_sub(before));
        let counts = |index: usize| (first..=last).contains(&self.began[index]);
        let steps = || (0..self.began.len()).filter(|&index| counts(index));
        let window = steps().fold(0_u64, |steps, index| steps | 1 << index);
        let oldest = steps().map(|index| self.began[index]).min().unwrap_or(born_ns);
        let is_long = born_ns.saturating_sub(oldest) >= LONG_NS;
        if window.count_ones() < FEWEST {
            return StoodPlaces::default();
        }
        let [low, high] = [-AROUND, AROUND].map(|off| cell_of(place.map(|value| value + off)));
        let is_near =
            |cell: &PlaceCell| (0..3).all(|at| low[at] <= cell[at] && cell[at] <= high[at]);
        let near = self.cells.iter().filter(|(cell, steps)| **steps & window != 0 && is_near(cell));
        let mut cells: Vec<(PlaceCell, u64)> =
            near.map(|(cell, steps)| (*cell, steps & window)).collect();
        cells.sort_unstable();
        let mut places = StoodPlaces { steps: window.count_ones(), is_beside: false, cells };
        let middle = |cell: PlaceCell| cell.map(|index| (f64::from(index) + 0.5) * CELL);
        let is_other = |at: [f64; 3]| norm(minus(at, place)) > OTHER && places.at(at) >= 1.0;
        places.is_beside = is_long && places.cells.iter().any(|(cell, _)| is_other(middle(*cell)));
        places
    }

    /// The state to save. A tracker restored from it gives the same results, bit by bit.
    pub(in crate::flying::track) fn saved(&self) -> SavedReturns {
        let mut cells: Vec<_> = self.cells.iter().map(|(&cell, &steps)| (cell, steps)).collect();
        cells.sort_unstable();
        SavedReturns { began: self.began.clone(), newest: self.newest as u64, cells }
    }

    /// Returns from a saved state. None if scans cannot have left such a state.
    pub(in crate::flying::track) fn restored(saved: SavedReturns) -> Option<Self> {
        let SavedReturns { began, newest, cells } = saved;
        let newest = usize::try_from(newest).ok()?;
        let is_possible = began.len() <= STEPS
            && cells.len() <= MOST
            && (newest < began.len() || began.is_empty() && newest == 0);
        is_possible.then(|| Self { began, newest, cells: cells.into_iter().collect() })
    }

    pub(in crate::flying::track) fn clear(&mut self) {
        *self = Self::default();
    }
}

/// [`EarlierReturns`] in a saved state: the cells in ascending order.
#[derive(Serialize, Deserialize)]
pub(in crate::flying::track) struct SavedReturns {
    began: Vec<i64>,
    newest: u64,
    cells: Vec<(PlaceCell, u64)>,
}

/// The places around the start of a track that gave returns before it began. Without time steps:
/// not known.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(in crate::flying::track) struct StoodPlaces {
    /// Number of time steps that were observed before the track began.
    steps: u32,
    /// Whether something other than the track's own target stood at any of these places.
    is_beside: bool,
    /// Cells in ascending order, each with one bit for every step in which it gave returns.
    cells: Vec<(PlaceCell, u64)>,
}

impl StoodPlaces {
    /// The place of an object that stood at `place` [m] all the time; `is_beside`: something else stood beside it.
    pub(in crate::flying::track) fn of_object(place: [f64; 3], is_beside: bool) -> Self {
        Self { steps: 1, is_beside, cells: vec![(cell_of(place), 1)] }
    }

    /// Whether enough was observed before the track began.
    pub(in crate::flying::track) fn is_known(&self) -> bool {
        self.steps > 0
    }

    /// Whether something other than the track's own target stood around its start.
    pub(in crate::flying::track) fn is_beside(&self) -> bool {
        self.is_beside
    }

    /// Whether something stood at `place` [m] before the track began: 0 (no) to 1 (yes). 0 also if
    /// too little was observed.
    pub(in crate::flying::track) fn at(&self, place: [f64; 3]) -> f64 {
        let [x, y, z] = cell_of(place);
        let mut steps = 0_u64;
        for (east, north) in (-1..=1).flat_map(|east| (-1..=1).map(move |north| (east, north))) {
            let first = [x.saturating_add(east), y.saturating_add(north), z.saturating_sub(1)];
            let from = self.cells.partition_point(|(cell, _)| *cell < first);
            let beside = |(cell, _): &&(PlaceCell, u64)| {
                cell[..2] == first[..2] && cell[2] <= z.saturating_add(1)
            };
            let column = self.cells[from..].iter().take_while(beside);
            steps |= column.fold(0, |all, (_, steps)| all | steps);
        }
        let share = f64::from(steps.count_ones()) / f64::from(self.steps.max(1));
        let [none, all] = SHARES;
        ((share - none) / (all - none)).clamp(0.0, 1.0)
    }

    /// Whether a saved state may contain these places.
    pub(in crate::flying::track) fn is_possible(&self) -> bool {
        self.steps as usize <= STEPS && self.cells.len() <= MOST && self.cells.is_sorted()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCAN_NS: i64 = 100_000_000;

    /// Returns of `scans` scans at ten per second; `place` gives the return of each, or None.
    fn seen(scans: i64, place: impl Fn(i64) -> Option<[f32; 3]>) -> EarlierReturns {
        let mut seen = EarlierReturns::default();
        (0..scans).for_each(|scan| seen.add(scan * SCAN_NS, place(scan).into_iter()));
        seen
    }

    #[test]
    fn what_gave_returns_for_seconds_stood_and_what_has_come_did_not() {
        let crown = [5.0, 1.0, 4.0];
        for scans in [10, 60, 200] {
            let near = |at: [f64; 3], place: [f32; 3]| {
                let seen = seen(scans, |scan| (scan % 4 != 0).then_some(place));
                seen.around(at, scans * SCAN_NS).at(at)
            };
            assert_eq!(near(crown, [5.1, 1.1, 3.9]), 1.0, "{scans}");
            assert_eq!(near(crown, [5.0, 1.8, 4.0]), 0.0, "{scans}");
            assert_eq!(near([-0.1, -0.2, 0.1], [0.1, 0.1, -0.1]), 1.0, "{scans}");
        }
        let once = seen(60, |scan| (scan % 4 == 0).then_some([5.0, 1.0, 4.0]));
        assert_eq!(once.around(crown, 60 * SCAN_NS).at(crown), 0.0);
        // What flies past is at one place for a moment, and what has stood and gone is long past.
        let passing = seen(60, |scan| Some([0.1 * scan as f32 - 1.0, 1.0, 4.0]));
        assert_eq!(passing.around(crown, 60 * SCAN_NS).at(crown), 0.0);
        let gone = seen(160, |scan| (scan < 110).then_some([5.0, 1.0, 4.0]));
        assert_eq!(gone.around(crown, 160 * SCAN_NS).at(crown), 0.0);
    }

    #[test]
    fn a_track_that_leaves_is_where_nothing_stood() {
        let stood = seen(40, |_| Some([5.0, 1.0, 4.0])).around([5.0, 1.0, 4.0], 40 * SCAN_NS);
        assert_eq!(stood.at([5.0, 1.0, 4.0]), 1.0);
        assert_eq!(stood.at([5.8, 1.0, 4.0]), 0.0);
        assert_eq!(stood.at([f64::MAX, f64::MIN, 4.0]), 0.0);
        assert!(stood.is_possible());
    }

    #[test]
    fn nothing_is_said_before_enough_is_seen() {
        let place = [5.0, 1.0, 4.0];
        let seen = seen(6, |_| Some([5.0, 1.0, 4.0]));
        assert_eq!(seen.around(place, 6 * SCAN_NS).at(place), 0.0);
        assert_eq!(seen.around(place, i64::MIN).at(place), 0.0);
        assert_eq!(EarlierReturns::default().around(place, 0).at(place), 0.0);
    }

    #[test]
    fn many_scans_per_second_and_many_returns_are_bounded() {
        let mut seen = EarlierReturns::default();
        for scan in 0..1000_i64 {
            let places = (0..500).map(|at| [(at * 7) as f32, (scan % 500) as f32, 0.0]);
            seen.add(scan * 10_000_000, places);
        }
        let saved = seen.saved();
        assert!(saved.began.len() == STEPS && saved.cells.len() <= MOST);
        let again = EarlierReturns::restored(saved).map(|seen| seen.saved().cells);
        assert_eq!(again, Some(seen.saved().cells));
        let none = || SavedReturns { began: vec![0], newest: 1, cells: Vec::new() };
        assert!(EarlierReturns::restored(none()).is_none());
    }
}
