//! One scan, held against what is known of its sensor: which directions are sky, and how far.

use super::floor::FloorFinder;
use super::grid::{CELLS, GRID, PARTS};
use super::way::Way;
use super::{NEVER, Sky};
use crate::flying::map::voxel_map::VoxelMap;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{Transform, dot, minus, norm};
use std::f64::consts::PI;

/// So many rays into a cell and its neighbours, and no return: were there a surface that returns
/// most of its light, one scan in a thousand would look like this (e^-7).
const ENOUGH_RAYS: f32 = 7.0;
/// What was cast longer ago counts less: time constant [s].
const EVIDENCE_TIME: f64 = 1.0;
/// More rays tell no more.
const MOST_RAYS: f32 = 50.0;
/// Returns nearer than this are none: drivers that move their zeros with the sensor give vectors of
/// up to 3 cm [m].
const LEAST_RANGE: f64 = 0.1;
/// A surface is remembered so long after its last return [ns].
const SURFACE_NS: i64 = 500_000_000;
/// Surfaces may go on beside what is seen of them for so many cells: 6 degrees.
const SURFACE_CELLS: usize = 3;
/// Cells beside each other whose ranges differ by less belong to one thing [m].
const SAME_RANGE: f32 = 1.0;
/// Things with a larger diagonal of their box are surfaces; smaller ones may be targets [m].
const SURFACE_SIZE: f64 = 2.0;
/// Rays of sky end this much before a surface beside them [m].
const BEFORE_SURFACE: f64 = 0.5;
/// They end this much above the lowest returns [m]: ground that gives none is no lower than that.
const ABOVE_GROUND: f64 = 1.0;
/// Things that reach down to this height above the lowest returns are on the ground [m].
pub(crate) const ON_GROUND: f64 = 0.35;
/// The ground is this flat [m], and its far part this many times further away than its near one.
const FLAT: f64 = 0.2;
const GROUND_RATIO: f64 = 1.8;
/// Fewer samples may be of one thing.
const ENOUGH_LOW: usize = 50;
/// Holes in surfaces have fewer cells than this: 40 degrees by 40.
const MOST_OF_HOLE: usize = 400;
/// Returns in a cell and around it between which a sensor leaves gaps.
const LEAST_AROUND: u32 = 7;
const MOST_AROUND: u32 = 400;
/// Directions within this angle are around a target: cosine of 12 degrees.
const AROUND_COSINE: f64 = 0.978;
/// A ray may lie this much below the middle of its cell [rad]: 1.4 degrees.
const CELL_TILT: f64 = 1.4 * PI / 180.0;
/// Rays of sky go as far as this share of the distance that one return in fifty exceeds: in fog
/// and dust surfaces fade, and beyond that distance no return tells nothing.
const VISIBLE_SHARE: f64 = 0.8;
/// Rays of sky that are shorter than this tell nothing [m].
const LEAST_REACH: f64 = 2.0;
/// With fewer returns than this share of a usual scan the sensor is covered, or its data cut.
const COVERED_SHARE: f64 = 0.5;
/// Weight of the newest scan in what is usual, and of one that shows far less: a cover stays longer
/// than it takes to get used to it.
const NEWEST: f64 = 0.1;
const NEWEST_COVERED: f64 = 0.002;
/// A direction that was empty for so long clears what returns have shown [ns].
const TRUSTED_NS: i64 = 2_000_000_000;
/// After a longer pause between scans the sky is seen anew [ns].
const LONGEST_PAUSE_NS: i64 = 1_000_000_000;
/// Points of which ranges and heights are ranked.
const SAMPLES: usize = 4096;

/// Where and when a scan was taken.
#[derive(Clone, Copy)]
pub(crate) struct Moment<'a> {
    pub(crate) points: &'a [[f32; 3]],
    /// Rows without a return.
    pub(crate) no_return: Option<&'a [bool]>,
    pub(crate) map_from_lidar: &'a Transform,
    pub(crate) stamp_ns: i64,
    /// Whether the robot hides a direction in the frame of the sensor.
    pub(crate) is_masked: &'a dyn Fn([f64; 3]) -> bool,
    /// The map before the scan.
    pub(crate) map: &'a VoxelMap,
}

/// What one scan shows; what it changes in [`Sky`] is kept apart until the scan is accepted.
#[derive(Default)]
pub(crate) struct Look {
    /// Directions of rays that met nothing, frame of the map, and how far they clear [m].
    pub(crate) directions: Vec<[f32; 3]>,
    pub(crate) reach: Vec<f32>,
    /// Share of the rays of the sensor that go into the sky.
    pub(crate) share: f64,
    /// Rays that a scan of this sensor has; 0 while it is not known.
    pub(crate) rays: f64,
    /// Whether the scan holds any return.
    has_returns: bool,
    /// Returns per cell, as the sensor sees them and in the frame of the map.
    of_sensor: Vec<u32>,
    hits: Vec<u32>,
    /// Range of the nearest return in every cell [m].
    nearest: Vec<f32>,
    /// Rays expected in every cell.
    expected: Vec<f32>,
    /// Ranges beyond which no ray of a cell clears [m], and memory for widening them.
    limit: Vec<f32>,
    wider: Vec<f32>,
    is_sky: Vec<bool>,
    /// Range and height above the sensor of some returns [m].
    samples: Vec<[f64; 2]>,
    /// Values that are ranked.
    ranks: Vec<f64>,
    /// Cells without returns into which enough rays were cast.
    is_empty: Vec<bool>,
    /// Cells of a thing, while it is looked at.
    thing: Vec<u16>,
    is_taken: Vec<bool>,
    // What becomes of `Sky`.
    evidence: Vec<f32>,
    surface: Vec<f32>,
    surface_ns: Vec<i64>,
    since_ns: Vec<i64>,
    place: [f64; 3],
    lowest: f64,
    /// Whether the lowest returns are those of the ground.
    has_ground: bool,
    /// Samples at the height of the lowest returns.
    n_low: usize,
    /// Height of flat ground above the sensor, if it is seen [m].
    floor: Option<f64>,
    finder: FloorFinder,
    usual: f64,
    stamp_ns: i64,
}

impl Look {
    /// Look at a scan: directions, reach and share tell what it shows of the sky.
    pub(crate) fn fill(&mut self, sky: &Sky, moment: &Moment<'_>) {
        self.count(moment);
        self.stamp_ns = moment.stamp_ns;
        self.has_returns = !self.samples.is_empty();
        (self.place, self.share, self.rays) = (moment.map_from_lidar.translation, 0.0, 0.0);
        self.directions.clear();
        self.reach.clear();
        self.since_ns.clear();
        self.since_ns.resize(CELLS, NEVER);
        self.is_sky.clear();
        self.is_sky.resize(CELLS, false);
        if !self.has_returns {
            return; // tells nothing, not even of open sky
        }
        self.expect(sky, moment.map_from_lidar);
        self.remember_surfaces(sky);
        self.widen();
        let visible = VISIBLE_SHARE * self.ranked(0.98, |[range, _]| Some(range));
        let low = self.ranked(0.05, |[_, height]| Some(height));
        let last = if sky.last_ns.is_some() { sky.lowest } else { low };
        self.lowest = (last + NEWEST * (low - last)).min(low + BEFORE_SURFACE);
        self.has_ground = self.sees_ground(low);
        self.floor = self.finder.find(&self.samples);
        let returns = self.hits.iter().map(|&hits| f64::from(hits)).sum::<f64>();
        let usual = if sky.last_ns.is_some() { sky.usual } else { returns };
        let is_covered = returns < COVERED_SHARE * usual;
        let newest = if is_covered { NEWEST_COVERED } else { NEWEST };
        self.usual = usual + newest * (returns - usual);
        if !is_covered && sky.is_known() {
            self.cast(sky, moment, visible);
        }
    }

    /// Of the directions around a target that are known to be free beyond it, the share that only
    /// the sky supports; `target` is relative to the sensor, frame of the map [m].
    pub(crate) fn share_around(&self, target: [f64; 3]) -> f64 {
        let range = norm(target);
        let is_near = |cell: &usize| dot(GRID.centers[*cell], target) > AROUND_COSINE * range;
        let (mut sky, mut all) = (0usize, 0usize);
        for cell in (0..CELLS).filter(is_near) {
            let is_behind = f64::from(self.nearest[cell]) > range + BEFORE_SURFACE;
            let is_seen = self.hits[cell] > 0 && is_behind;
            sky += usize::from(self.is_sky[cell]);
            all += usize::from(self.is_sky[cell] || is_seen);
        }
        sky as f64 / all.max(1) as f64
    }

    /// Height below which things are on the ground, relative to the sensor [m].
    pub(crate) fn ground(&self) -> f64 {
        if self.has_ground { self.low() } else { f64::NEG_INFINITY }
    }

    /// Height up to which returns are among the lowest, relative to the sensor [m]; none if these
    /// are few, such as those of a target below the sensor.
    pub(crate) fn low(&self) -> f64 {
        if self.n_low >= ENOUGH_LOW { self.lowest + ON_GROUND } else { f64::NEG_INFINITY }
    }

    /// Height of flat ground, relative to the sensor [m]. What is mirrored in it lies below.
    pub(crate) fn floor(&self) -> Option<f64> {
        self.floor
    }

    /// Whether the scan holds any return.
    pub(crate) fn has_returns(&self) -> bool {
        self.has_returns
    }

    /// Returns per cell, as the sensor sees them.
    pub(super) fn seen_by_sensor(&self) -> &[u32] {
        &self.of_sensor
    }

    /// Leave what has been seen in `sky`; false if nothing was.
    pub(super) fn leave(&mut self, sky: &mut Sky) -> bool {
        if !self.has_returns {
            return false;
        }
        std::mem::swap(&mut self.evidence, &mut sky.evidence);
        std::mem::swap(&mut self.surface, &mut sky.surface);
        std::mem::swap(&mut self.surface_ns, &mut sky.surface_ns);
        std::mem::swap(&mut self.since_ns, &mut sky.since_ns);
        if !sky.sees_the_same_from(self.place) {
            sky.place = self.place;
        }
        (sky.lowest, sky.usual, sky.last_ns) = (self.lowest, self.usual, Some(self.stamp_ns));
        true
    }

    fn count(&mut self, moment: &Moment<'_>) {
        for counts in [&mut self.of_sensor, &mut self.hits] {
            counts.clear();
            counts.resize(CELLS, 0);
        }
        self.nearest.clear();
        self.nearest.resize(CELLS, f32::INFINITY);
        self.samples.clear();
        let grid = &*GRID;
        let step = (moment.points.len() / SAMPLES).max(1);
        for (row, &point) in moment.points.iter().enumerate() {
            let point = wide(point);
            let range = norm(point);
            if !(range.is_finite() && range > LEAST_RANGE)
                || moment.no_return.is_some_and(|flags| flags[row])
            {
                continue;
            }
            let turned = moment.map_from_lidar.rotate(point);
            self.of_sensor[grid.cell(point)] += 1;
            let cell = grid.cell(turned);
            self.hits[cell] += 1;
            self.nearest[cell] = self.nearest[cell].min(range as f32);
            if row % step == 0 || self.samples.is_empty() {
                self.samples.push([range, turned[2]]);
            }
        }
    }

    /// Rays that the sensor casts into every cell, and those since its last return.
    fn expect(&mut self, sky: &Sky, map_from_lidar: &Transform) {
        let lidar_from_map = map_from_lidar.inverse();
        let age =
            sky.last_ns.map_or(0.0, |last| (self.stamp_ns.saturating_sub(last)) as f64 * 1e-9);
        let keep = libm::exp(-age.max(0.0) / EVIDENCE_TIME) as f32;
        self.expected.clear();
        self.evidence.clear();
        for cell in 0..CELLS {
            let density = sky.emission.towards(lidar_from_map.rotate(GRID.centers[cell]));
            let rays = (density * GRID.solid_angles[cell]) as f32;
            self.expected.push(rays);
            let since = (keep * sky.evidence[cell] + rays).min(MOST_RAYS);
            self.evidence.push(if self.hits[cell] > 0 { 0.0 } else { since });
        }
    }

    /// Note the ranges of what was seen, unless it is as small as a target.
    fn remember_surfaces(&mut self, sky: &Sky) {
        self.surface.clone_from(&sky.surface);
        self.surface_ns.clone_from(&sky.surface_ns);
        self.is_taken.clear();
        self.is_taken.resize(CELLS, false);
        for first in 0..CELLS {
            if self.hits[first] == 0 || self.is_taken[first] {
                continue;
            }
            let is_surface = self.take_thing(first) > SURFACE_SIZE;
            for &cell in &self.thing {
                let cell = usize::from(cell);
                self.surface[cell] = self.nearest[cell];
                self.surface_ns[cell] = if is_surface { self.stamp_ns } else { i64::MIN };
            }
        }
    }

    /// Gather the cells of the thing seen in the cell `first`; the diagonal of its box [m].
    fn take_thing(&mut self, first: usize) -> f64 {
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
        norm(minus(high, low))
    }

    /// Let surfaces that are known limit the cells around them.
    fn widen(&mut self) {
        let is_known = |ns: &i64| self.stamp_ns.saturating_sub(*ns) <= SURFACE_NS;
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

    /// Find the sky, and the rays into it: of each cell every third part, others in the next scan.
    fn cast(&mut self, sky: &Sky, moment: &Moment<'_>, visible: f64) {
        let visible = visible.min(moment.map.parameters().max_range);
        let pause = sky.last_ns.map_or(0, |last| self.stamp_ns.saturating_sub(last));
        let is_same_place = sky.sees_the_same_from(self.place) && pause <= LONGEST_PAUSE_NS;
        let mut way = Way::through(moment.map, self.place);
        let lidar_from_map = moment.map_from_lidar.inverse();
        self.limit_holes();
        let (mut into_sky, mut all) = (0.0, 0.0);
        for cell in 0..CELLS {
            all += f64::from(self.expected[cell]);
            let is_sky = self.is_empty[cell] && self.reach_of(cell, visible) >= LEAST_REACH;
            let before = || self.reach_before(cell).min(moment.map.parameters().max_range);
            let reach = if is_sky { self.reach_of(cell, visible) } else { before() };
            if reach < LEAST_REACH {
                continue;
            }
            let mut is_trusted = false;
            if is_sky {
                into_sky += f64::from(self.expected[cell]);
                let was_sky = is_same_place && sky.since_ns[cell] != NEVER;
                let since = if was_sky { sky.since_ns[cell] } else { self.stamp_ns };
                (self.since_ns[cell], self.is_sky[cell]) = (since, true);
                is_trusted = self.stamp_ns.saturating_sub(since) >= TRUSTED_NS;
            }
            for part in 0..PARTS * PARTS {
                let turn = part / PARTS + part % PARTS + sky.scans as usize;
                if !turn.is_multiple_of(PARTS) {
                    continue;
                }
                let direction = GRID.parts[cell * PARTS * PARTS + part];
                if (moment.is_masked)(lidar_from_map.rotate(wide(direction))) {
                    continue; // the robot hides it
                }
                let free = if is_trusted { reach } else { way.free(wide(direction), reach) };
                if free >= LEAST_REACH {
                    self.directions.push(direction);
                    self.reach.push(free as f32);
                }
            }
        }
        (self.share, self.rays) = (if all > 0.0 { into_sky / all } else { 0.0 }, all);
    }

    fn seems_empty(&self, cell: usize) -> bool {
        let beside = || GRID.beside(cell).iter().map(|&other| usize::from(other));
        beside().all(|other| self.hits[other] == 0)
            && beside().map(|other| self.evidence[other]).sum::<f32>() >= ENOUGH_RAYS
            && beside().any(|other| self.expected[other] > 0.0)
    }

    /// Empty directions that surfaces enclose on all sides, within the field of view, are a hole in
    /// these: something dark or wet, or glass. They are limited as if they were part of them.
    fn limit_holes(&mut self) {
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

    /// Gather the empty cells around `first`; the middle range of what encloses them, if all of it
    /// has been seen [m].
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

    /// Whether the lowest returns come from near and far, as those of the ground do: what a field of
    /// view cuts off lies the deeper, the further away it is.
    fn sees_ground(&mut self, low: f64) -> bool {
        let on_ground = |[range, height]: [f64; 2]| ((height - low).abs() < FLAT).then_some(range);
        let near = self.ranked(0.1, on_ground);
        let far = self.ranked(0.9, on_ground);
        self.n_low = self.ranks.len();
        20 * self.n_low >= self.samples.len() && far >= GROUND_RATIO * near
    }

    /// The value that has a share of all values below it; 0 without any.
    fn ranked(&mut self, share: f64, value: impl Fn([f64; 2]) -> Option<f64>) -> f64 {
        self.ranks.clear();
        self.ranks.extend(self.samples.iter().filter_map(|&sample| value(sample)));
        ranked(&mut self.ranks, share)
    }

    /// How far it is free between the rays of a sparse sensor, in a cell that is no sky [m]: what is
    /// nearer than all returns around would have been met. 0 for dense sensors, which leave no gaps.
    fn reach_before(&self, cell: usize) -> f64 {
        let beside = || GRID.beside(cell).iter().map(|&other| usize::from(other));
        let rays: u32 = beside().map(|other| self.hits[other]).sum();
        if !(LEAST_AROUND..MOST_AROUND).contains(&rays) {
            return 0.0;
        }
        let nearest = beside().map(|other| self.nearest[other]).fold(f32::INFINITY, f32::min);
        (f64::from(nearest) - BEFORE_SURFACE).min(self.reach_above_ground(cell))
    }

    /// How far the rays of an empty cell clear [m].
    fn reach_of(&self, cell: usize, visible: f64) -> f64 {
        let before_surface = f64::from(self.limit[cell]) - BEFORE_SURFACE;
        visible.min(before_surface).min(self.reach_above_ground(cell))
    }

    /// How far the rays of a cell stay above the ground [m].
    fn reach_above_ground(&self, cell: usize) -> f64 {
        let tilt = libm::asin(GRID.centers[cell][2].clamp(-1.0, 1.0)) - CELL_TILT;
        let fall = -libm::sin(tilt.max(-PI / 2.0));
        let ground = self.floor.map_or(self.lowest, |floor| floor.max(self.lowest));
        let height = -ground - ABOVE_GROUND;
        if fall > 0.0 { height / fall } else { f64::INFINITY }
    }
}

/// The value that has a share of all values below it; 0 without any.
pub(super) fn ranked(values: &mut [f64], share: f64) -> f64 {
    let rank = (share * values.len() as f64) as usize;
    let rank = rank.min(values.len().saturating_sub(1));
    if values.is_empty() {
        return 0.0;
    }
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::super::{Beams, Sky};
    use super::*;
    use crate::Error;
    use crate::flying::integrate::integrator::tests::parameters;

    /// Returns on a ring wall from -0.3 to `top` in height, all around, with a gap of 60 degrees.
    fn wall(range: f64, top: f64) -> Vec<[f32; 3]> {
        let mut points = Vec::new();
        for cell in 0..CELLS {
            for part in 0..PARTS * PARTS {
                let direction = wide(GRID.parts[cell * PARTS * PARTS + part]);
                let is_gap = direction[1].abs() < 0.577 * direction[0];
                if (-0.3..top).contains(&direction[2]) && !is_gap {
                    points.push(direction.map(|value| (range * value) as f32));
                }
            }
        }
        points
    }

    fn looks(sky: &mut Sky, map: &VoxelMap, scans: &[Vec<[f32; 3]>]) -> Look {
        let mut look = Look::default();
        for (number, points) in scans.iter().enumerate() {
            let moment = Moment {
                points,
                no_return: None,
                map_from_lidar: &Transform::IDENTITY,
                stamp_ns: number as i64 * 100_000_000,
                is_masked: &|_| false,
                map,
            };
            look.fill(sky, &moment);
            if number + 1 < scans.len() {
                sky.take(&mut look, points);
            }
        }
        look
    }

    fn gap_is_sky(look: &Look) -> bool {
        look.directions.iter().any(|direction| direction[0] > 0.99 && direction[2] > 0.0)
    }

    #[test]
    fn the_gap_in_a_wall_is_sky_and_what_was_never_looked_at_is_not() -> Result<(), Error> {
        let map = VoxelMap::new(parameters(), 1)?;
        let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
        let look = looks(&mut sky, &map, &vec![wall(30.0, 0.5); 5]);
        assert!(gap_is_sky(&look) && look.share > 0.05 && look.share < 0.2, "{}", look.share);
        for cell in (0..CELLS).filter(|&cell| look.is_sky[cell]) {
            let direction = GRID.centers[cell];
            assert!(direction[2] < 0.58, "{direction:?}"); // a cell beside the highest returns
            assert!(direction[0] > 0.8 * direction[1].abs() || direction[2] > 0.4, "{direction:?}");
        }
        Ok(())
    }

    #[test]
    fn a_scan_that_is_not_accepted_changes_nothing() -> Result<(), Error> {
        let map = VoxelMap::new(parameters(), 1)?;
        let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
        let first = looks(&mut sky, &map, &vec![wall(30.0, 0.5); 5]).reach;
        let before = format!("{sky:?}");
        let mut look = Look::default();
        let points = wall(5.0, 0.1);
        let moment = Moment {
            points: &points,
            no_return: None,
            map_from_lidar: &Transform::IDENTITY,
            stamp_ns: 700_000_000,
            is_masked: &|_| false,
            map: &map,
        };
        look.fill(&sky, &moment);
        assert_eq!(before, format!("{sky:?}"));
        assert!(!first.is_empty());
        Ok(())
    }

    #[test]
    fn a_sensor_that_is_covered_sees_no_sky() -> Result<(), Error> {
        let map = VoxelMap::new(parameters(), 1)?;
        let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
        let mut scans = vec![wall(30.0, 0.5); 6];
        let few = scans[0].iter().copied().filter(|point| point[1] < -15.0).collect();
        scans.push(few);
        let look = looks(&mut sky, &map, &scans);
        assert!(look.directions.is_empty() && look.share == 0.0);
        Ok(())
    }

    #[test]
    fn nobody_gets_used_to_a_covered_sensor() -> Result<(), Error> {
        let map = VoxelMap::new(parameters(), 1)?;
        let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
        let mut scans = vec![wall(30.0, 0.5); 6];
        let few: Vec<[f32; 3]> =
            scans[0].iter().copied().filter(|point| point[1] < -15.0).collect();
        scans.extend(vec![few; 60]);
        assert!(looks(&mut sky, &map, &scans).directions.is_empty());
        Ok(())
    }

    #[test]
    fn far_returns_do_not_make_rays_longer_than_those_of_the_map() -> Result<(), Error> {
        let map = VoxelMap::new(parameters(), 1)?;
        let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
        let look = looks(&mut sky, &map, &vec![wall(1e6, 0.5); 5]);
        assert!(!look.reach.is_empty());
        assert!(look.reach.iter().all(|&reach| reach <= 20.0));
        Ok(())
    }

    #[test]
    fn rays_of_sky_end_before_what_returns_have_shown_until_they_are_trusted() -> Result<(), Error>
    {
        let mut map = VoxelMap::new(parameters(), 1)?;
        let screen: Vec<[f32; 3]> = (0..400)
            .map(|index| [10.0, (index % 20) as f32 * 0.25 - 2.5, (index / 20) as f32 * 0.25 - 2.5])
            .collect();
        map.set_occupied(&screen)?;
        let ahead = |look: &Look| {
            let ray = look.directions.iter().position(|direction| direction[0] > 0.995);
            ray.map(|ray| f64::from(look.reach[ray]))
        };
        for (scans, expected) in [(5, 9.75), (30, 20.0)] {
            let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
            let look = looks(&mut sky, &map, &vec![wall(30.0, 0.5); scans]);
            let reach = ahead(&look).ok_or(Error::Interrupted)?;
            assert!((reach - expected).abs() < 0.3, "{reach} after {scans} scans");
        }
        Ok(())
    }

    #[test]
    fn near_surfaces_limit_the_rays_beside_them_and_small_things_do_not() -> Result<(), Error> {
        let map = VoxelMap::new(parameters(), 1)?;
        let reach_ahead = |thing: f32| -> Result<f64, Error> {
            let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
            let mut points = wall(30.0, 0.5);
            for cell in 0..CELLS {
                let [x, y, z] = GRID.centers[cell].map(|value| value as f32);
                if x > 0.9 && (z - 0.2).abs() < 0.02 && (0.0..thing).contains(&y) {
                    points.push([8.0 * x, 8.0 * y, 8.0 * z]);
                }
            }
            let look = looks(&mut sky, &map, &vec![points; 5]);
            let near = |direction: &[f32; 3]| {
                direction[1].abs() < 0.1 && (direction[2] - 0.2).abs() < 0.1 && direction[0] > 0.0
            };
            let rays = look.directions.iter().zip(&look.reach).filter(|(ray, _)| near(ray));
            Ok(rays.map(|(_, &reach)| f64::from(reach)).fold(f64::INFINITY, f64::min))
        };
        assert!(reach_ahead(0.06)? > 15.0);
        assert!(reach_ahead(0.4)? < 8.0);
        Ok(())
    }

    #[test]
    fn rays_stay_above_the_lowest_returns() -> Result<(), Error> {
        let map = VoxelMap::new(parameters(), 1)?;
        let mut sky = Sky::of(&Beams::Learnt).ok_or(Error::Interrupted)?;
        let look = looks(&mut sky, &map, &vec![wall(15.0, 0.5); 5]); // down to -4.5 m
        for (direction, &reach) in look.directions.iter().zip(&look.reach) {
            assert!(dot(wide(*direction), [0.0, 0.0, 1.0]) * f64::from(reach) > -3.5);
        }
        assert!(look.directions.iter().any(|direction| direction[2] < -0.1));
        Ok(())
    }
}
