//! Known surfaces, which limit the rays beside them, and holes in surfaces.

use super::super::Sky;
use super::super::grid::{CELLS, GRID};
use super::{SkyObservation, ranked};
use crate::geometry::transform::{minus, norm};

/// Time for which a surface is remembered after its last return [ns].
const SURFACE_NS: i64 = 500_000_000;
/// Longest time for which a surface is remembered, if the scans of its sensor are further apart
/// [ns].
const LONGEST_SURFACE_NS: i64 = 2_000_000_000;
/// Number of cells by which surfaces may continue beside their visible part: 6 degrees.
const SURFACE_CELLS: usize = 3;
/// Neighbouring cells whose ranges differ by less than this belong to one thing [m].
const SAME_RANGE: f32 = 1.0;
/// Things are surfaces if the diagonal of their box is longer than this [m]. Smaller ones may be
/// targets.
const SURFACE_SIZE: f64 = 2.0;
/// A thing with something else within this distance is a part of it, such as a leaf of a tree [m].
const BESIDE: f64 = 1.5;
/// Holes in surfaces have fewer cells than this: 40 by 40 degrees.
const MOST_OF_HOLE: usize = 400;

impl SkyObservation {
    /// Remember the ranges of what this scan has seen. Things as small as a target do not count as
    /// surfaces.
    pub(super) fn remember_surfaces(&mut self, sky: &Sky) {
        self.surface.clone_from(&sky.surface);
        self.surface_ns.clone_from(&sky.surface_ns);
        for flags in [&mut self.is_taken, &mut self.is_alone] {
            flags.clear();
            flags.resize(CELLS, false);
        }
        for first in 0..CELLS {
            if self.hits[first] == 0 || self.is_taken[first] {
                continue;
            }
            let [low, high] = self.take_thing(first);
            let is_surface = norm(minus(high, low)) > SURFACE_SIZE;
            let is_alone = self.has_rows && !is_surface && self.is_alone_in(low, high);
            for &cell in &self.thing {
                let cell = usize::from(cell);
                self.surface[cell] = self.nearest[cell];
                self.surface_ns[cell] = if is_surface { self.stamp_ns } else { i64::MIN };
                self.is_alone[cell] = is_alone;
            }
        }
    }

    /// True if nothing but the thing that was gathered last is inside its box or near it. The box
    /// is relative to the sensor [m].
    fn is_alone_in(&self, low: [f64; 3], high: [f64; 3]) -> bool {
        let off = |place: f64, axis: usize| (low[axis] - place).max(place - high[axis]).max(0.0);
        let is_beside = |cell: usize| {
            let range = f64::from(self.nearest[cell]);
            let place = |axis: usize| off(range * GRID.centers[cell][axis], axis);
            self.hits[cell] > 0 && norm([place(0), place(1), place(2)]) < BESIDE
        };
        !(0..CELLS).any(|cell| is_beside(cell) && !self.thing.contains(&(cell as u16)))
    }

    /// Gather the cells of the thing seen in the cell `first`. Returns its box, relative to the
    /// sensor [m].
    fn take_thing(&mut self, first: usize) -> [[f64; 3]; 2] {
        self.thing.clear();
        self.thing.push(first as u16);
        self.is_taken[first] = true;
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        let mut next = 0;
        while let Some(&cell) = self.thing.get(next) {
            next += 1;
            let range = self.nearest[usize::from(cell)];
            for axis in 0..3 {
                let place = f64::from(range) * GRID.centers[usize::from(cell)][axis];
                low[axis] = low[axis].min(place);
                high[axis] = high[axis].max(place);
            }
            for &other in GRID.beside(usize::from(cell)) {
                let (at, gap) = (usize::from(other), self.nearest[usize::from(other)] - range);
                if self.hits[at] > 0 && !self.is_taken[at] && gap.abs() < SAME_RANGE {
                    self.is_taken[at] = true;
                    self.thing.push(other);
                }
            }
        }
        [low, high]
    }

    /// Set the limits of rays: known surfaces limit the cells around them.
    pub(super) fn widen(&mut self, sky: &Sky) {
        // A slow sensor has not looked again after the usual time.
        let step = sky.last_ns.map_or(0, |last| self.stamp_ns.saturating_sub(last));
        let longest = step.clamp(SURFACE_NS, LONGEST_SURFACE_NS);
        let is_known = |ns: &i64| self.stamp_ns.saturating_sub(*ns) <= longest;
        let known = self.surface.iter().zip(&self.surface_ns);
        self.limit.clear();
        self.limit
            .extend(known.map(|(range, ns)| if is_known(ns) { *range } else { f32::INFINITY }));
        for _ in 0..SURFACE_CELLS {
            let limit = &self.limit;
            let least = |cell: usize| {
                let beside = GRID.beside(cell).iter().map(|&other| limit[usize::from(other)]);
                beside.fold(f32::INFINITY, f32::min)
            };
            self.wider.clear();
            self.wider.extend((0..CELLS).map(least));
            std::mem::swap(&mut self.limit, &mut self.wider);
        }
    }

    /// Find holes: empty directions that surfaces enclose on all sides, within the field of view.
    /// They are dark or wet surfaces, or glass, and are limited as if they were part of the
    /// surfaces.
    pub(super) fn limit_holes(&mut self) {
        let empty: Vec<bool> = (0..CELLS).map(|cell| self.seems_empty(cell)).collect();
        self.is_empty = empty;
        self.is_taken.fill(false);
        for first in 0..CELLS {
            if !self.is_empty[first] || self.is_taken[first] {
                continue;
            }
            let Some(limit) = self.take_hole(first) else { continue };
            for &cell in &self.thing {
                let limited = &mut self.limit[usize::from(cell)];
                *limited = limited.min(limit);
            }
        }
    }

    /// Gather the empty cells around `first`. Returns the median range of the surfaces that enclose
    /// them [m]. None if they are not a hole.
    fn take_hole(&mut self, first: usize) -> Option<f32> {
        self.thing.clear();
        self.thing.push(first as u16);
        self.is_taken[first] = true;
        self.ranks.clear();
        let (mut next, mut is_open) = (0, false);
        while let Some(&cell) = self.thing.get(next) {
            next += 1;
            for &other in GRID.beside(usize::from(cell)) {
                let at = usize::from(other);
                if self.is_empty[at] {
                    if !std::mem::replace(&mut self.is_taken[at], true) {
                        self.thing.push(other);
                    }
                } else if self.limit[at].is_finite() {
                    self.ranks.push(f64::from(self.limit[at]));
                } else {
                    is_open |= self.expected[at] == 0.0; // the edge of the field of view
                }
            }
        }
        let is_hole = !is_open && self.thing.len() < MOST_OF_HOLE && !self.ranks.is_empty();
        is_hole.then(|| ranked(&mut self.ranks, 0.5) as f32)
    }
}
