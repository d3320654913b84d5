//! Observation of the sky by one scan: which directions are sky, and up to which distance they are free.

mod haze;
mod lost;
mod reach;
mod surfaces;
#[cfg(test)]
mod tests;

use super::floor::FloorFinder;
use super::grid::{CELLS, GRID, SECTORS};
use super::{NEVER, Sky};
use crate::flying::map::voxel_map::VoxelMap;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{Transform, dot, norm};
pub(super) use haze::RecentReturns;
use haze::{Air, Haze};

/// Time constant with which the weight of older rays falls [s].
const EVIDENCE_TIME: f64 = 1.0;
/// Largest number of rays that count as evidence in a cell.
const MOST_RAYS: f32 = 50.0;
/// Smallest range of a return [m]. Drivers that move rays without return, given as zeros, with the sensor give
/// vectors of up to 3 cm.
const LEAST_RANGE: f64 = 0.1;
/// Distance in front of a surface beside them at which rays into the sky end [m].
const BEFORE_SURFACE: f64 = 0.5;
/// Height above the lowest returns up to which things count as standing on the ground [m].
pub(crate) const ON_GROUND: f64 = 0.35;
/// Largest difference of heights within the ground [m]. `GROUND_RATIO`: smallest ratio of the distances of its far and
/// near parts.
const FLAT: f64 = 0.2;
const GROUND_RATIO: f64 = 1.8;
/// Smallest number of samples of the ground. Fewer may be of one thing.
const ENOUGH_LOW: usize = 50;
/// Directions within 12 degrees count as around a target. This is the cosine of the angle.
const AROUND_COSINE: f64 = 0.978;
/// Length of rays into the sky, as a share of the distance that one return in fifty exceeds. In fog and dust surfaces
/// fade, and beyond that distance a missing return shows nothing.
const VISIBLE_SHARE: f64 = 0.8;
/// Share of the returns of a usual scan below which the sensor counts as covered, or its data as cut.
const COVERED_SHARE: f64 = 0.5;
/// Weight of the newest scan in the usual number of returns; `NEWEST_COVERED`: its weight if it shows far fewer. The
/// small weight keeps the average from adapting to a cover.
const NEWEST: f64 = 0.1;
const NEWEST_COVERED: f64 = 0.002;
/// Number of points whose ranges and heights are ranked.
const SAMPLES: usize = 4096;

/// A scan, as input of the observation of the sky.
#[derive(Clone, Copy)]
pub(crate) struct ScanToObserve<'a> {
    pub(crate) points: &'a [[f32; 3]],
    /// For each row, whether it has no return. None: not known.
    pub(crate) no_return: Option<&'a [bool]>,
    pub(crate) map_from_lidar: &'a Transform,
    pub(crate) stamp_ns: i64,
    /// Whether the robot itself hides a direction, given in the frame of the sensor.
    pub(crate) is_masked: &'a dyn Fn([f64; 3]) -> bool,
    /// The map before this scan changes it.
    pub(crate) map: &'a VoxelMap,
}

impl ScanToObserve<'_> {
    /// Position in the frame of the sensor, and range [m], of the return in a row. None if the row has no return.
    #[inline]
    fn return_at(&self, row: usize) -> Option<([f64; 3], f64)> {
        let point = wide(self.points[row]);
        let range = norm(point);
        let is_return = range.is_finite() && range > LEAST_RANGE;
        (is_return && !self.no_return.is_some_and(|flags| flags[row])).then_some((point, range))
    }
}

/// Every return of a scan: its row, its range [m], and its cell of direction in the frame of the map.
fn returns_of<'a>(scan: &'a ScanToObserve<'_>) -> impl Iterator<Item = (usize, f64, usize)> + 'a {
    let of_row = |row| {
        let (point, range) = scan.return_at(row)?;
        Some((row, range, GRID.cell(scan.map_from_lidar.rotate(point))))
    };
    (0..scan.points.len()).filter_map(of_row)
}

/// Observation of the sky by one scan. It changes [`Sky`] only when the scan is accepted.
#[derive(Default)]
pub(crate) struct SkyObservation {
    /// Directions of rays without return in the frame of the map; `reach`: length that each clears [m].
    pub(crate) directions: Vec<[f32; 3]>,
    pub(crate) reach: Vec<f32>,
    /// Share of the sensor's rays that go into the sky.
    pub(crate) share: f64,
    /// Number of rays in a scan of this sensor. 0 while it is not known.
    pub(crate) rays: f64,
    /// Whether the scan has any return.
    has_returns: bool,
    /// Number of returns per cell, with directions in the frame of the sensor; `hits`: in the frame of the map.
    of_sensor: Vec<u32>,
    hits: Vec<u32>,
    /// Number of droplets per cell, with directions in the frame of the sensor. They do not count as hits.
    drops: Vec<u32>,
    haze: Haze,
    /// Range of the nearest return in every cell [m].
    nearest: Vec<f32>,
    /// Number of rays that are expected in every cell.
    expected: Vec<f32>,
    /// Cells into which possibly no ray was cast, because data were lost.
    is_lost: Vec<bool>,
    /// Largest length that a ray of each cell clears [m]; `wider`: memory for widening these limits.
    limit: Vec<f32>,
    wider: Vec<f32>,
    is_sky: Vec<bool>,
    /// Distance up to which the sky of each cell is known to be free [m].
    sky_reach: Vec<f32>,
    /// Whether the rays of the sensor are in rows.
    has_rows: bool,
    /// Sine of the elevation of the lowest return in the frame of the sensor.
    lowest_of_sensor: f64,
    /// Range and height relative to the sensor of some returns [m].
    samples: Vec<[f64; 2]>,
    /// Memory for values that are ranked.
    ranks: Vec<f64>,
    /// Cells without returns into which enough rays were cast.
    is_empty: Vec<bool>,
    /// Cells of the thing or hole that is being inspected.
    thing: Vec<u16>,
    is_taken: Vec<bool>,
    /// Cells of things that are as small as a target and have nothing beside them, for a sensor with rows.
    is_alone: Vec<bool>,
    // The next values of `Sky`.
    evidence: Vec<f32>,
    surface: Vec<f32>,
    surface_ns: Vec<i64>,
    since_ns: Vec<i64>,
    place: [f64; 3],
    lowest: f64,
    /// Whether the lowest returns are on the ground.
    has_ground: bool,
    /// Number of samples at the height of the lowest returns.
    n_low: usize,
    /// Height of flat ground relative to the sensor [m]. None if no flat ground is seen.
    floor: Option<f64>,
    finder: FloorFinder,
    usual: f64,
    stamp_ns: i64,
}

impl SkyObservation {
    /// Evaluate a scan: directions, lengths and share of the rays into the sky.
    pub(crate) fn fill(&mut self, sky: &Sky, scan: &ScanToObserve<'_>) {
        let ground = sky.last_ns.map_or(f64::NEG_INFINITY, |_| sky.lowest + ON_GROUND);
        self.count(scan, ground, &sky.recent);
        self.stamp_ns = scan.stamp_ns;
        self.has_returns = !self.samples.is_empty();
        (self.place, self.share, self.rays) = (scan.map_from_lidar.translation, 0.0, 0.0);
        self.directions.clear();
        self.reach.clear();
        self.since_ns.clear();
        self.since_ns.resize(CELLS, NEVER);
        self.is_sky.clear();
        self.is_sky.resize(CELLS, false);
        self.sky_reach.clear();
        self.sky_reach.resize(CELLS, 0.0);
        self.has_rows = sky.has_rows();
        if !self.has_returns {
            return; // tells nothing, not even of open sky
        }
        self.expect(sky, scan.map_from_lidar);
        self.find_lost(sky, scan.map_from_lidar);
        self.remember_surfaces(sky);
        self.widen(sky);
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
        if !is_covered && sky.is_known_at(scan.stamp_ns) {
            self.cast(sky, scan, visible);
        }
    }

    /// Among the directions around a target that are known to be free beyond it: the share that only the sky
    /// supports. `target`: position relative to the sensor, in the axes of the map [m].
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

    /// Distance up to which the sky in a direction is free [m]; 0 if it is not sky. Holes in surfaces, and directions
    /// beside surfaces, are free only up to the surfaces.
    pub(crate) fn reach_at(&self, direction: [f64; 3]) -> f64 {
        f64::from(self.sky_reach[GRID.cell(direction)])
    }

    /// Mean number of rays per steradian that a scan casts in a direction.
    pub(crate) fn density_at(&self, direction: [f64; 3]) -> f64 {
        let cell = GRID.cell(direction);
        f64::from(self.expected[cell]) / GRID.solid_angles[cell]
    }

    /// Mean number of rays per steradian in the field of view of a scan. 0 while it is not known.
    pub(crate) fn mean_density(&self) -> f64 {
        let cast = self.expected.iter().zip(&GRID.solid_angles).filter(|(rays, _)| **rays > 0.0);
        let (rays, angle) = cast
            .fold((0.0, 0.0), |(rays, angle), (ray, cell)| (rays + f64::from(*ray), angle + cell));
        if angle > 0.0 { rays / angle } else { 0.0 }
    }

    /// Whether the rays are in rows, so that there are none between the rows.
    pub(crate) fn has_rows(&self) -> bool {
        self.has_rows
    }

    /// Height relative to the sensor below which things count as standing on the ground [m].
    pub(crate) fn ground(&self) -> f64 {
        if self.has_ground { self.low() } else { f64::NEG_INFINITY }
    }

    /// Height relative to the sensor up to which returns are among the lowest [m]. Minus infinity if there are few,
    /// such as those of a target below the sensor.
    pub(crate) fn low(&self) -> f64 {
        if self.n_low >= ENOUGH_LOW { self.lowest + ON_GROUND } else { f64::NEG_INFINITY }
    }

    /// Height of flat ground relative to the sensor [m]; mirror images in it are below. None if no flat ground is
    /// seen.
    pub(crate) fn floor(&self) -> Option<f64> {
        self.floor
    }

    /// Whether the scan has any return.
    pub(crate) fn has_returns(&self) -> bool {
        self.has_returns
    }

    /// For each row of the scan, whether it is a droplet or flake in the air. Empty in clear air.
    pub(crate) fn is_droplet(&self) -> &[bool] {
        self.haze.is_droplet()
    }

    /// Number of returns per cell in the frame of the sensor, number of droplets among them, and sine of the
    /// elevation of the lowest return.
    pub(super) fn seen_by_sensor(&self) -> ([&[u32]; 2], f64) {
        ([&self.of_sensor, &self.drops], self.lowest_of_sensor)
    }

    /// Move the observation into `sky`. Returns false if the scan has no return.
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
        self.haze.leave(&mut sky.recent, self.stamp_ns);
        (sky.lowest, sky.usual, sky.last_ns) = (self.lowest, self.usual, Some(self.stamp_ns));
        true
    }

    fn count(&mut self, scan: &ScanToObserve<'_>, ground: f64, recent: &RecentReturns) {
        for counts in [&mut self.of_sensor, &mut self.hits, &mut self.drops] {
            counts.clear();
            counts.resize(CELLS, 0);
        }
        self.nearest.clear();
        self.nearest.resize(CELLS, f32::INFINITY);
        self.haze.clear();
        let (mut returns, mut sectors) = (0, [false; SECTORS]);
        for (row, range, cell) in returns_of(scan) {
            self.hits[cell] += 1;
            self.nearest[cell] = self.nearest[cell].min(range as f32);
            self.haze.add(row, cell, range);
            returns += 1;
            sectors[usize::from(GRID.bands[cell].1)] = true;
        }
        let air = Air {
            points: scan.points,
            map_from_lidar: scan.map_from_lidar,
            stamp_ns: scan.stamp_ns,
            ground,
            map: scan.map,
            recent,
            returns,
            sectors_seen: sectors.iter().filter(|&&is_seen| is_seen).count(),
            cells_seen: self.hits.iter().filter(|&&hits| hits > 0).count(),
        };
        if self.haze.find(&air) {
            self.hits.fill(0);
            self.nearest.fill(f32::INFINITY);
            for (row, range, cell) in returns_of(scan) {
                if !self.haze.is_droplet()[row] {
                    self.hits[cell] += 1;
                    self.nearest[cell] = self.nearest[cell].min(range as f32);
                }
            }
        }
        self.count_for_sensor(scan);
    }

    /// Count the returns by direction in the frame of the sensor, and take samples of ranges and heights.
    fn count_for_sensor(&mut self, scan: &ScanToObserve<'_>) {
        self.samples.clear();
        self.lowest_of_sensor = f64::INFINITY;
        let step = (scan.points.len() / SAMPLES).max(1);
        let is_droplet = self.haze.is_droplet();
        for row in 0..scan.points.len() {
            let Some((point, range)) = scan.return_at(row) else { continue };
            let cell = GRID.cell(point);
            self.of_sensor[cell] += 1;
            self.lowest_of_sensor = self.lowest_of_sensor.min(point[2] / range);
            if is_droplet.get(row) == Some(&true) {
                self.drops[cell] += 1;
            } else if row % step == 0 || self.samples.is_empty() {
                self.samples.push([range, scan.map_from_lidar.rotate(point)[2]]);
            }
        }
    }

    /// Compute how many rays the sensor casts into every cell, and how many since its last return.
    fn expect(&mut self, sky: &Sky, map_from_lidar: &Transform) {
        let lidar_from_map = map_from_lidar.inverse();
        let is_known = sky.is_known_at(self.stamp_ns);
        let age =
            sky.last_ns.map_or(0.0, |last| (self.stamp_ns.saturating_sub(last)) as f64 * 1e-9);
        let keep = libm::exp(-age.max(0.0) / EVIDENCE_TIME) as f32;
        self.expected.clear();
        self.evidence.clear();
        for cell in 0..CELLS {
            let towards = lidar_from_map.rotate(GRID.centers[cell]);
            let density = if is_known { sky.emission.towards(towards) } else { 0.0 };
            let rays = (density * GRID.solid_angles[cell]) as f32;
            self.expected.push(rays);
            let since = (keep * sky.evidence[cell] + rays).min(MOST_RAYS);
            self.evidence.push(if self.hits[cell] > 0 { 0.0 } else { since });
        }
    }

    /// Whether the lowest returns come from near and far, as returns of the ground do. The lower edge of a field of
    /// view is lower, the further away it is.
    fn sees_ground(&mut self, low: f64) -> bool {
        let on_ground = |[range, height]: [f64; 2]| ((height - low).abs() < FLAT).then_some(range);
        let near = self.ranked(0.1, on_ground);
        let far = self.ranked(0.9, on_ground);
        self.n_low = self.ranks.len();
        20 * self.n_low >= self.samples.len() && far >= GROUND_RATIO * near
    }

    /// Among the values of the samples, the one with the given share of values below it. 0 without values.
    fn ranked(&mut self, share: f64, value: impl Fn([f64; 2]) -> Option<f64>) -> f64 {
        self.ranks.clear();
        self.ranks.extend(self.samples.iter().filter_map(|&sample| value(sample)));
        ranked(&mut self.ranks, share)
    }
}

/// The value with the given share of all values below it. 0 without values.
pub(super) fn ranked(values: &mut [f64], share: f64) -> f64 {
    let rank = (share * values.len() as f64) as usize;
    let rank = rank.min(values.len().saturating_sub(1));
    if values.is_empty() {
        return 0.0;
    }
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}
