//! Which cells of direction are sky, and up to which distance the rays into them clear.

use super::super::free_path::FreePath;
use super::super::grid::{CELLS, GRID, PARTS};
use super::super::{NEVER, Sky};
use super::{BEFORE_SURFACE, ScanToObserve, SkyObservation};
use crate::geometry::lattice::wide;
use std::f64::consts::PI;

/// Number of rays into a cell and its neighbours, without a return, from which on it is empty. With
/// a surface that returns most of its light, one scan in a thousand would look like this (e^-7).
const ENOUGH_RAYS: f32 = 7.0;
/// Height above the lowest returns at which rays into the sky end [m]. Ground without returns is
/// not higher than that.
const ABOVE_GROUND: f64 = 1.0;
/// Numbers of returns in a cell and its neighbours (from this to below `MOST_AROUND`) with which a
/// sensor leaves gaps.
const LEAST_AROUND: u32 = 7;
/// Number of returns in a cell and its neighbours from which on a sensor leaves no gaps.
const MOST_AROUND: u32 = 400;
/// Largest angle by which a ray may be below the middle of its cell [rad]: 1.4 degrees.
const CELL_TILT: f64 = 1.4 * PI / 180.0;
/// Shortest ray into the sky that is used [m].
const LEAST_REACH: f64 = 2.0;
/// Time for which a direction must have been empty before its rays also clear voxels that returns
/// have shown [ns].
const TRUSTED_NS: i64 = 2_000_000_000;
/// Longest pause between scans after which the time of a sky goes on [ns].
const LONGEST_PAUSE_NS: i64 = 1_000_000_000;
/// Time between the scans of a usual sensor, less some jitter [ns].
const USUAL_STEP_NS: i64 = 90_000_000;

impl SkyObservation {
    /// Find the sky and the rays into it. Every scan uses a third of each cell's rays, each time
    /// another one; more of them after a longer pause.
    pub(super) fn cast(&mut self, sky: &Sky, scan: &ScanToObserve<'_>, visible: f64) {
        // Longer than other functions: one pass over the cells, since the share of sky and the rays
        // come from the same numbers.
        let visible = visible.min(scan.map.parameters().max_range);
        let pause = sky.last_ns.map_or(0, |last| self.stamp_ns.saturating_sub(last));
        let is_same_place = sky.sees_the_same_from(self.place) && pause <= LONGEST_PAUSE_NS;
        let mut path = FreePath::through(scan.map, self.place);
        let lidar_from_map = scan.map_from_lidar.inverse();
        let thirds = (pause / USUAL_STEP_NS).clamp(1, PARTS as i64) as usize;
        self.limit_holes();
        let (mut into_sky, mut all) = (0.0, 0.0);
        for cell in 0..CELLS {
            all += f64::from(self.expected[cell]);
            if self.is_lost[cell] {
                if is_same_place {
                    self.since_ns[cell] = sky.since_ns[cell];
                }
                continue;
            }
            let is_sky = self.is_empty[cell] && self.reach_of(cell, visible) >= LEAST_REACH;
            let before = || self.reach_before(cell).min(scan.map.parameters().max_range);
            let reach = if is_sky { self.reach_of(cell, visible) } else { before() };
            if reach < LEAST_REACH {
                continue;
            }
            let mut is_trusted = false;
            if is_sky {
                into_sky += f64::from(self.expected[cell]);
                let known_ns = if is_same_place { sky.since_ns[cell] } else { NEVER };
                is_trusted = self.note_sky(cell, reach, known_ns);
            }
            for part in 0..PARTS * PARTS {
                let turn = part / PARTS + part % PARTS + sky.scans as usize;
                if turn % PARTS >= thirds {
                    continue;
                }
                let direction = GRID.parts[cell * PARTS * PARTS + part];
                let towards = lidar_from_map.rotate(wide(direction));
                if (scan.is_masked)(towards) || !sky.emission.reaches(towards) {
                    continue; // the robot hides it, or no ray goes there
                }
                let free = if is_trusted { reach } else { path.length(wide(direction), reach) };
                if free >= LEAST_REACH {
                    self.directions.push(direction);
                    self.reach.push(free as f32);
                }
            }
        }
        (self.share, self.rays) = (if all > 0.0 { into_sky / all } else { 0.0 }, all);
    }

    /// Mark a cell as sky. `known_ns`: time since when it is sky, or [`NEVER`]. Returns true if it
    /// has been sky for long.
    fn note_sky(&mut self, cell: usize, reach: f64, known_ns: i64) -> bool {
        let since = if known_ns == NEVER { self.stamp_ns } else { known_ns };
        (self.since_ns[cell], self.is_sky[cell]) = (since, true);
        self.sky_reach[cell] = reach as f32;
        self.stamp_ns.saturating_sub(since) >= TRUSTED_NS
    }

    pub(super) fn seems_empty(&self, cell: usize) -> bool {
        let beside = || GRID.beside(cell).iter().map(|&other| usize::from(other));
        beside().all(|other| self.hits[other] == 0)
            && beside().map(|other| self.evidence[other]).sum::<f32>() >= ENOUGH_RAYS
            && beside().any(|other| self.expected[other] > 0.0)
    }

    /// Length that is free between the rays of a sparse sensor, in a cell that is not sky [m]:
    /// something nearer than all returns around would have been hit. 0 for dense sensors, which
    /// leave no gaps.
    ///
    /// Rows never move, so the gaps between them around a target are never seen. If the target
    /// limited the cells around it, it would never be in free space. Patterns that do not repeat do
    /// not need this.
    fn reach_before(&self, cell: usize) -> f64 {
        let beside = || GRID.beside(cell).iter().map(|&other| usize::from(other));
        let rays: u32 = beside().map(|other| self.hits[other]).sum();
        if !(LEAST_AROUND..MOST_AROUND).contains(&rays) {
            return 0.0;
        }
        let limits = |other: &usize| *other == cell || !self.is_alone[*other];
        let nearest = beside().filter(limits).map(|other| self.nearest[other]);
        let nearest = nearest.fold(f32::INFINITY, f32::min);
        (f64::from(nearest) - BEFORE_SURFACE).min(self.reach_above_ground(cell))
    }

    /// Length that the rays of an empty cell clear [m]. `visible`: distance up to which surfaces
    /// return at all [m].
    fn reach_of(&self, cell: usize, visible: f64) -> f64 {
        let before_surface = f64::from(self.limit[cell]) - BEFORE_SURFACE;
        visible.min(before_surface).min(self.reach_above_ground(cell))
    }

    /// Length up to which the rays of a cell stay above the ground [m].
    fn reach_above_ground(&self, cell: usize) -> f64 {
        let tilt = libm::asin(GRID.centers[cell][2].clamp(-1.0, 1.0)) - CELL_TILT;
        let fall = -libm::sin(tilt.max(-PI / 2.0));
        let ground = self.floor.map_or(self.lowest, |floor| floor.max(self.lowest));
        let height = -ground - ABOVE_GROUND;
        if fall > 0.0 { height / fall } else { f64::INFINITY }
    }
}
