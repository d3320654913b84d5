//! Droplets and flakes in the air: near returns that fill a volume and are not on surfaces.
//!
//! Fog, rain and snow return a few rays from their first metres, in all directions, at random ranges. So a return
//! counts as a droplet if the returns beside it, in direction and range, are no more than chance explains: as dense
//! as those in front of it, since droplets become fewer with range. This applies only if the air is full of droplets.
//!
//! Droplets are at other places in every scan. Real objects stay near their place for some scans.
//! If the returns of one scan are too few for a decision, those of the last half second are used.

use super::super::grid::{CELLS, GRID, SECTORS};
use crate::flying::map::blocks::Cursor;
use crate::flying::map::voxel_map::VoxelMap;
use crate::geometry::lattice::{floor, wide};
use crate::geometry::transform::Transform;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::sync::LazyLock;

/// Largest range at which droplets return rays [m].
const FARTHEST: f64 = 10.0;
/// Depth of a bin of range [m]. `BINS`: number of bins up to [`FARTHEST`].
const BIN: f64 = 0.25;
const BINS: usize = 40;
/// Number of bins to either side that count as beside a return. `BEFORE`: number of bins in front of these, whose
/// returns show what chance gives.
const BESIDE: usize = 1;
const BEFORE: usize = 7;
/// Limits of the probability that randomly distributed droplets give the counted returns beside a
/// return. Below the second limit, the return is on a surface. Below the first limit, it is on a
/// surface if a return beside it is. At least `LEAST_BESIDE` returns must be beside it.
const CHANCES: [f64; 2] = [0.05, 1e-3];
const LEAST_BESIDE: u32 = 2;
/// Number of scans whose returns are used together; they may be at most `WINDOW_NS` old [ns].
const WINDOW: usize = 5;
const WINDOW_NS: i64 = 500_000_000;
/// One near return in this many may be nearer than the blind range of the sensor.
const BLIND_SHARE: usize = 100;
/// Number of counts in the table [`LIMITS`]. For larger counts, the limit grows in proportion.
const TABLE: usize = 256;
/// The air is full if at least this share of all returns are of droplets, in at least the share `FULL_SECTORS` of the
/// sectors with returns.
const FULL_SHARE: f64 = 0.03;
const FULL_SECTORS: f64 = 0.75;
/// Range from which on droplets are compared with the map [m]. Droplets do not stay, so at least the share
/// `LEAST_FREE` of them must be in free space of the map.
const JUDGED_FROM: f64 = 2.0;
const LEAST_FREE: f64 = 0.5;
/// Largest number of returns that are inspected to decide whether the air is full.
const SAMPLES: usize = 1024;
/// Smallest number of cells with droplets in air that is full: returns of one place alone show nothing about the air.
const FEWEST: usize = 20;

/// Smallest numbers of returns beside a return for both [`CHANCES`]. Index: number of returns in front of it.
static LIMITS: LazyLock<[[u32; 2]; TABLE]> = LazyLock::new(|| {
    std::array::from_fn(|before| {
        let mean = (before * (2 * BESIDE + 1)) as f64 / BEFORE as f64;
        CHANCES.map(|chance| limit(mean, chance).max(LEAST_BESIDE))
    })
});

/// Probable cause of a return, from the number of returns beside it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seems {
    Droplet,
    Either,
    Surface,
}

/// Near returns of the last scans in air that was full of droplets, by cell of direction and bin of range.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(in super::super) struct RecentReturns {
    scans: Vec<(i64, Vec<u32>)>,
}

impl RecentReturns {
    /// Remove all returns.
    pub(in super::super) fn clear(&mut self) {
        self.scans.clear();
    }

    /// True if all indices are in range. Checks a saved state.
    pub(in super::super) fn is_whole(&self) -> bool {
        self.scans.iter().flat_map(|(_, places)| places).all(|&at| (at as usize) < CELLS * BINS)
    }
}

/// Near returns of one scan, and which of them are droplets.
#[derive(Default)]
pub(super) struct Haze {
    /// Number of returns for each cell of direction and bin of range.
    counts: Vec<u8>,
    /// For every near return, the index of its point and its index in `counts`.
    near: Vec<(u32, u32)>,
    /// The counts of the last scans and this one together. Empty if there is no recent scan.
    window: Vec<u16>,
    /// Cells and bins that contain a return of a surface.
    is_solid: Vec<bool>,
    /// For each point of the scan, whether it is a droplet. Empty in clear air.
    is_droplet: Vec<bool>,
    /// Number of droplets in each sector.
    sectors: Vec<u32>,
    /// Cells that contain droplets.
    filled: Vec<u32>,
    /// Number of cells with returns at any range; `of_bins`: near returns of all cells by bin.
    cells_seen: usize,
    of_bins: Vec<usize>,
    /// First bin from which the sensor returns anything. It is blind in nearer ones.
    first: usize,
}

/// Scan in which droplets are searched for, with its properties.
#[derive(Clone, Copy)]
pub(super) struct Air<'a> {
    pub(super) points: &'a [[f32; 3]],
    pub(super) map_from_lidar: &'a Transform,
    pub(super) stamp_ns: i64,
    /// Height relative to the sensor below which nothing counts as a droplet [m].
    pub(super) ground: f64,
    /// The map before this scan changes it.
    pub(super) map: &'a VoxelMap,
    pub(super) recent: &'a RecentReturns,
    /// Number of returns of the scan; numbers of sectors and cells with returns.
    pub(super) returns: usize,
    pub(super) sectors_seen: usize,
    pub(super) cells_seen: usize,
}

impl Haze {
    pub(super) fn clear(&mut self) {
        self.counts.clear();
        self.counts.resize(CELLS * BINS, 0);
        self.window.clear();
        self.near.clear();
        self.is_droplet.clear();
        self.of_bins.clear();
        self.of_bins.resize(BINS, 0);
    }

    /// Add the return of the point at index `point`, in `cell`, at `range` [m].
    #[inline]
    pub(super) fn add(&mut self, point: usize, cell: usize, range: f64) {
        if range < FARTHEST {
            let bin = ((range / BIN) as usize).min(BINS - 1);
            let at = cell * BINS + bin;
            self.counts[at] = self.counts[at].saturating_add(1);
            self.of_bins[bin] += 1;
            self.near.push((point as u32, at as u32));
        }
    }

    /// For each point of the scan, whether it is a droplet. Empty in clear air.
    pub(super) fn is_droplet(&self) -> &[bool] {
        &self.is_droplet
    }

    /// Find the droplets of a scan. Returns true if the air is full of them.
    pub(super) fn find(&mut self, air: &Air<'_>) -> bool {
        let step = (self.near.len() / SAMPLES).max(1);
        let mut cursor = Cursor::new(&air.map.blocks);
        let (mut droplets, mut judged, mut free) = (0usize, 0usize, 0usize);
        self.cells_seen = air.cells_seen;
        self.first = self.first_bin();
        self.sectors.clear();
        self.sectors.resize(SECTORS, 0);
        self.filled.clear();
        for &(point, at) in self.near.iter().step_by(step) {
            let turned = air.map_from_lidar.rotate(wide(air.points[point as usize]));
            if turned[2] < air.ground || self.seems(at as usize) != Seems::Droplet {
                continue;
            }
            droplets += 1;
            self.filled.push(at / BINS as u32);
            self.sectors[usize::from(GRID.bands[at as usize / BINS].1)] += 1;
            if (at as usize % BINS) as f64 * BIN < JUDGED_FROM {
                continue;
            }
            let place = air.map_from_lidar.apply(wide(air.points[point as usize]));
            let Some(voxel) = floor(air.map.lattice().scaled(place)) else { continue };
            judged += 1;
            free += usize::from(air.map.known(cursor.stored(voxel)) < air.map.uncertain_from());
        }
        let filled = self.sectors.iter().filter(|&&count| count > 0).count();
        self.filled.sort_unstable();
        self.filled.dedup();
        let is_full = self.filled.len() >= FEWEST
            && (droplets * step) as f64 >= FULL_SHARE * air.returns as f64
            && filled as f64 >= FULL_SECTORS * air.sectors_seen as f64
            && judged > 0
            && free as f64 >= LEAST_FREE * judged as f64;
        if is_full {
            self.look_back(air);
            self.mark(air);
        }
        is_full
    }

    /// Store the near returns for the next scans if the air is full of droplets, else remove all stored ones.
    pub(super) fn leave(&self, recent: &mut RecentReturns, stamp_ns: i64) {
        if self.is_droplet.is_empty() {
            recent.clear();
            return;
        }
        let places = self.near.iter().map(|&(_, at)| at).collect();
        recent.scans.push((stamp_ns, places));
        if recent.scans.len() >= WINDOW {
            recent.scans.remove(0);
        }
    }

    /// Add the returns of the last scans to those of this one.
    fn look_back(&mut self, air: &Air<'_>) {
        let is_recent = |stamp: i64| air.stamp_ns.saturating_sub(stamp) <= WINDOW_NS;
        let mut before = air.recent.scans.iter().filter(|(stamp, _)| is_recent(*stamp)).peekable();
        if before.peek().is_none() {
            return;
        }
        self.window.extend(self.counts.iter().map(|&count| u16::from(count)));
        for &at in before.flat_map(|(_, places)| places) {
            let count = &mut self.window[at as usize];
            *count = count.saturating_add(1);
        }
    }

    /// Mark the points that are droplets.
    fn mark(&mut self, air: &Air<'_>) {
        self.is_solid.clear();
        self.is_solid.resize(CELLS * BINS, false);
        self.is_droplet.resize(air.points.len(), false);
        for &(point, at) in &self.near {
            let turned = air.map_from_lidar.rotate(wide(air.points[point as usize]));
            let at = at as usize;
            let is_surface =
                turned[2] < air.ground || self.seems(at) == Seems::Surface || self.stays(at);
            self.is_solid[at] |= is_surface;
            self.is_droplet[point as usize] = !is_surface;
        }
        for &(point, at) in &self.near {
            if self.is_droplet[point as usize] && self.seems(at as usize) == Seems::Either {
                self.is_droplet[point as usize] = !self.is_beside_surface(at as usize);
            }
        }
    }

    fn is_beside_surface(&self, at: usize) -> bool {
        let (cell, bin) = (at / BINS, at % BINS);
        GRID.beside(cell)
            .iter()
            .any(|&other| self.is_solid[usize::from(other) * BINS..][beside(bin)].contains(&true))
    }

    /// First bin that the sensor sees: one near return in a hundred is in this or a nearer bin.
    fn first_bin(&self) -> usize {
        let mut sum = 0;
        let is_reached = |count: &usize| {
            sum += count;
            BLIND_SHARE * sum >= self.near.len()
        };
        self.of_bins.iter().position(is_reached).unwrap_or(0)
    }

    /// Probable cause of a return with the index `at` in the counts.
    fn seems(&self, at: usize) -> Seems {
        let (others, nearer) = around(&self.counts, at, self.first);
        let nearer = nearer.unwrap_or_else(|| self.usual_before(at));
        let [either, surface] = limits(nearer);
        match f64::from(others) {
            others if others >= surface => Seems::Surface,
            others if others >= either => Seems::Either,
            _ => Seems::Droplet,
        }
    }

    /// True if the returns of the last scans show that a return with the index `at` is on a surface. One return more
    /// is assumed in front of it than was counted, since a count of zero does not mean a density of zero.
    fn stays(&self, at: usize) -> bool {
        if self.window.is_empty() {
            return false;
        }
        let (others, Some(nearer)) = around(&self.window, at, self.first) else { return false };
        f64::from(others) >= limits(nearer + 1)[1]
    }

    /// Expected number of returns in front of a bin that has no bins before it, if all directions were alike. Such a
    /// bin is so near that only the robot itself can be there.
    fn usual_before(&self, at: usize) -> usize {
        let (cell, bin) = (at / BINS, at % BINS);
        let beside = beside(bin);
        let (depth, all) = (beside.len(), self.of_bins[beside].iter().sum::<usize>());
        all * GRID.beside(cell).len() * BEFORE / (self.cells_seen.max(1) * depth)
    }
}

/// Number of returns beside the one with the index `at`, and number in front of these from the bin `first` on, scaled
/// to the whole depth. None if no bin is in front of them.
fn around<T: Copy + Into<u32>>(counts: &[T], at: usize, first: usize) -> (u32, Option<usize>) {
    let (cell, bin) = (at / BINS, at % BINS);
    let beside = beside(bin);
    let before = beside.start.saturating_sub(BEFORE).max(first).min(beside.start)..beside.start;
    let (mut count, mut nearer) = (0u32, 0u32);
    for &other in GRID.beside(cell) {
        let of_cell = &counts[usize::from(other) * BINS..][..BINS];
        let sum = |counts: &[T]| counts.iter().map(|&count| count.into()).sum::<u32>();
        count += sum(&of_cell[beside.clone()]);
        nearer += sum(&of_cell[before.clone()]);
    }
    let depth = before.len();
    (count.saturating_sub(1), (depth > 0).then(|| nearer as usize * BEFORE / depth))
}

/// Smallest numbers of returns beside a return for both values of [`CHANCES`], given the number of returns in front
/// of it.
fn limits(nearer: usize) -> [f64; 2] {
    let beyond = (nearer as f64 / (TABLE - 1) as f64).max(1.0);
    LIMITS[nearer.min(TABLE - 1)].map(|limit| f64::from(limit) * beyond)
}

/// The bins that count as beside a bin, and the bin itself.
fn beside(bin: usize) -> Range<usize> {
    bin.saturating_sub(BESIDE)..(bin + BESIDE + 1).min(BINS)
}

/// Smallest count that has less probability than `chance` if `mean` are expected (Poisson).
fn limit(mean: f64, chance: f64) -> u32 {
    let mut term = libm::exp(-mean);
    let (mut below, mut count) = (term, 1);
    while 1.0 - below > chance {
        term *= mean / f64::from(count);
        below += term;
        count += 1;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::flying::map::parameters::tests::parameters;
    use crate::flying::sky::grid::PARTS;

    /// Pseudo-random numbers in [0, 1), always the same.
    fn numbers() -> impl FnMut() -> f64 {
        let mut state = 12_345_u64;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        }
    }

    /// A scan with rays everywhere above the horizon, of which a share ends in the air at up to 6 m; with a wall of
    /// 30 degrees at 4 m and a ball at 5 m. Also the numbers of returns of the wall and of the ball.
    fn scan(share: f64) -> (Vec<[f32; 3]>, usize, usize) {
        let (mut random, mut points, mut solid) = (numbers(), Vec::new(), Vec::new());
        let mut n_wall = 0;
        for part in 0..CELLS * PARTS * PARTS {
            let direction = wide(GRID.parts[part]);
            let end = |range: f64| direction.map(|value| (range * value) as f32);
            if direction[2] < 0.0 {
                continue;
            }
            if random() < share {
                points.push(end(0.3 + 5.7 * random()));
            } else if direction[0] > 0.9 && direction[1].abs() < 0.26 && direction[2] < 0.4 {
                solid.push(end(4.0 / direction[0]));
                n_wall += 1;
            } else if direction[1] > 0.9985 {
                solid.push(end(5.0));
            }
        }
        let n_drops = points.len();
        points.extend(solid);
        (points, n_drops, n_wall)
    }

    /// A map in which everything within 6 m is free space.
    fn free_map() -> Result<VoxelMap, Error> {
        let mut map = VoxelMap::new(parameters())?;
        let middle = |index: usize| (index as f32 - 25.0) * 0.25 + 0.1;
        let grid = |index: usize| [index / 2601, index / 51 % 51, index % 51].map(middle);
        map.set_free(&(0..51 * 51 * 51).map(grid).collect::<Vec<_>>())?;
        Ok(map)
    }

    fn air<'a>(points: &'a [[f32; 3]], map: &'a VoxelMap, recent: &'a RecentReturns) -> Air<'a> {
        Air {
            points,
            map_from_lidar: &Transform::IDENTITY,
            stamp_ns: 0,
            ground: f64::NEG_INFINITY,
            map,
            recent,
            returns: points.len(),
            sectors_seen: SECTORS,
            cells_seen: CELLS / 2,
        }
    }

    fn found(points: &[[f32; 3]], map: &VoxelMap) -> (Haze, bool) {
        let mut haze = Haze::default();
        haze.clear();
        for (index, &point) in points.iter().enumerate() {
            let place = wide(point);
            haze.add(index, GRID.cell(place), crate::geometry::transform::norm(place));
        }
        let is_full = haze.find(&air(points, map, &RecentReturns::default()));
        (haze, is_full)
    }

    #[test]
    fn droplets_everywhere_are_found_and_a_wall_and_a_ball_among_them_are_not() -> Result<(), Error>
    {
        let map = free_map()?;
        for share in [0.03, 0.06, 0.15] {
            let (points, n_drops, n_wall) = scan(share);
            let (haze, is_full) = found(&points, &map);
            assert!(is_full, "{share}");
            let kept = |part: Range<usize>| part.filter(|&at| !haze.is_droplet()[at]).count();
            assert!(10 * kept(0..n_drops) < n_drops, "{share}: {} of {n_drops}", kept(0..n_drops));
            let (wall, ball) = (n_drops..n_drops + n_wall, n_drops + n_wall..points.len());
            assert!(wall.len() > 500 && ball.len() >= 10);
            assert!(100 * kept(wall.clone()) > 98 * wall.len(), "{share}");
            assert_eq!(kept(ball.clone()), ball.len(), "{share}");
        }
        Ok(())
    }

    #[test]
    fn stray_returns_in_one_direction_and_few_ones_do_not_fill_the_air() -> Result<(), Error> {
        let map = free_map()?;
        let (points, n_drops, _) = scan(0.06);
        let keeps =
            |index: usize, point: &[f32; 3]| index >= n_drops || point[1] > 0.8 * point[0].abs();
        let of_a_bush = points.iter().enumerate().filter(|&(index, point)| keeps(index, point));
        let bush: Vec<[f32; 3]> = of_a_bush.map(|(_, &point)| point).collect();
        assert!(bush.len() > points.len() / 10);
        assert!(!found(&bush, &map).1 && found(&bush, &map).0.is_droplet().is_empty());
        let (few, ..) = scan(0.0005);
        assert!(!found(&few, &map).1);
        Ok(())
    }

    #[test]
    fn twigs_that_stay_do_not_fill_the_air() -> Result<(), Error> {
        let mut map = free_map()?;
        let (points, n_drops, _) = scan(0.06);
        assert!(found(&points, &map).1);
        map.set_occupied(&points[..n_drops])?;
        assert!(!found(&points, &map).1);
        assert!(!found(&points, &VoxelMap::new(parameters())?).1, "nothing is known yet");
        Ok(())
    }

    #[test]
    fn ground_seen_at_a_grazing_angle_does_not_fill_the_air() -> Result<(), Error> {
        let mut map = free_map()?;
        let ground = |part: usize| {
            let direction = wide(GRID.parts[part]);
            let range = 1.5 / -direction[2];
            (0.0..10.0).contains(&range).then(|| direction.map(|value| (range * value) as f32))
        };
        let points: Vec<[f32; 3]> = (0..CELLS * PARTS * PARTS).filter_map(ground).collect();
        map.set_occupied(&points)?;
        assert!(points.len() > 10_000 && !found(&points, &map).1);
        Ok(())
    }

    #[test]
    fn limits_are_quantiles_of_poisson_counts() {
        for mean in [0.0, 0.3, 2.0, 20.0, 55.0] {
            for chance in CHANCES {
                let count = limit(mean, chance);
                let at_least = |from: u32| {
                    let below = (0..from).map(|k| {
                        let log: f64 = (1..=k).map(|i| (mean / f64::from(i)).ln()).sum();
                        (log - mean).exp()
                    });
                    1.0 - below.sum::<f64>()
                };
                assert!(at_least(count) <= chance + 1e-12, "{mean} {chance}");
                assert!(count == 1 || at_least(count - 1) > chance - 1e-12, "{mean} {chance}");
            }
        }
    }
}
