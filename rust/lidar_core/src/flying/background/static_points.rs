//! Points that do not move during the burn-in. They become background, even if the objects are
//! small.

use super::burn_in::BurnIn;
use super::parameters::SeedParameters;
use crate::Error;
use crate::flying::classify::classifier::Classification;
use crate::flying::classify::clusters::{Cluster, Clusters};
use crate::flying::map::blocks::{Cursor, Place};
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::PointClass;
use crate::flying::reporting_gate::ReportingGate;
use crate::flying::track::PointCloudTracker;
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};
use crate::geometry::transform::{minus, norm};
use crate::util::full_state::impossible;
use crate::util::key_hasher::KeyHasher;
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet};
use std::hash::BuildHasherDefault;

/// Number of units per metre in sums of coordinates. These are integers, so the order of the points
/// does not matter.
const UNITS_PER_METRE: f64 = 65_536.0;

/// Smallest probability that chance explains all scans without points before the first and after
/// the last points of a voxel. If the probability is smaller, an object has moved into or out of
/// the voxel.
const NOT_BY_CHANCE: f64 = 0.01;
/// Smallest share of the voxels of a moving cluster that it has entered during the burn-in. In a
/// large cluster, some voxels always hide others, so a few of them seem entered even if the cluster
/// is static.
const COME_SHARE: f64 = 0.3;

/// Search for static points during the burn-in. It stores a summary of the points of every voxel so
/// far.
#[derive(Clone, Default)]
pub(crate) struct StaticPoints {
    voxels: HashMap<Place, PointsOfVoxel, BuildHasherDefault<KeyHasher>>,
    /// Free voxels in which the newest scan is the first with points, ascending.
    entered: Vec<Voxel>,
}

/// Summary of the points in one voxel.
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct PointsOfVoxel {
    /// Whether rays had shown the voxel free before the first scan with points in it.
    was_free: bool,
    first_scan: u32,
    scans: u32,
    last_scan: u32,
    /// For each half of the burn-in: sum of coordinates relative to the voxel's centre, and number
    /// of points.
    halves: [([i64; 3], i64); 2],
}

impl StaticPoints {
    /// Find the free voxels in which this scan of the burn-in is the first with points. Call it
    /// before the map update.
    pub(crate) fn look(
        &mut self,
        points: &[[f32; 3]],
        gate: ReportingGate,
        seed: &SeedParameters,
        map: &VoxelMap,
    ) {
        self.entered.clear();
        if !matches!(gate, ReportingGate::BurnIn { .. }) || seed.standing_scans == 0 {
            return;
        }
        let mut cursor = Cursor::new(&map.blocks);
        let mut is_free = |voxel: &Voxel| map.known(cursor.stored(*voxel)) < map.uncertain_from();
        let all = points.iter().filter_map(|&point| floor(map.lattice().scaled(wide(point))));
        let new = all.filter(|voxel| !self.voxels.contains_key(&Place(*voxel)));
        self.entered.extend(new.filter(|voxel| is_free(voxel)));
        self.entered.sort_unstable();
        self.entered.dedup();
    }

    /// Add a scan of the burn-in and its clusters. After the last scan, all voxels of static points
    /// become background in `map`, except within `distance` [m] of the boxes of tracks that moved.
    /// Returns these voxels, ascending. For earlier scans the result is empty; scans after the
    /// burn-in change nothing.
    pub(crate) fn take(
        &mut self,
        (points, clusters, classifications): (&[[f32; 3]], &Clusters, &[Classification]),
        gate: ReportingGate,
        seed: &SeedParameters,
        distance: f64,
        map: &mut VoxelMap,
        tracker: &mut PointCloudTracker,
    ) -> Vec<Voxel> {
        let ReportingGate::BurnIn { scans, of } = gate else { return Vec::new() };
        if seed.standing_scans == 0 {
            return Vec::new();
        }
        let lattice = *map.lattice();
        self.add(&lattice, points, scans, of);
        if scans < of {
            return Vec::new();
        }
        let moving = tracker.moved_by(seed.standing_track_distance);
        let mut standing = self.voxels(BurnIn::standing(seed, of), seed.standing_shift, of, map);
        // What the background explains is joined in one search and not in another: it says nothing here.
        let apart = classifications.iter().map(|found| found.class != PointClass::Background);
        let apart = apart.enumerate().filter(|&(_, is_apart)| is_apart);
        let moved = self.of_moving(points, apart.map(|(index, _)| clusters.get(index)), of, map);
        standing.retain(|voxel| moved.binary_search(voxel).is_err());
        standing.retain(|&voxel| {
            let center = lattice.center(voxel);
            moving.iter().all(|&(position, half)| norm(minus(position, center)) > distance + half)
        });
        map.keep(&standing);
        self.clear();
        tracker.drop_near(map, distance); // tracks of such things, still unseen
        standing
    }

    /// Add the points of the scan with the number `scan` (first: 1) of a burn-in of `of` scans.
    fn add(&mut self, lattice: &Lattice, points: &[[f32; 3]], scan: u32, of: u32) {
        let half = usize::from(2 * scan > of);
        for &point in points {
            let point = wide(point);
            let Some(voxel) = floor(lattice.scaled(point)) else { continue };
            let of_voxel = self.voxels.entry(Place(voxel)).or_default();
            if of_voxel.last_scan != scan {
                if of_voxel.scans == 0 {
                    of_voxel.first_scan = scan;
                    of_voxel.was_free = self.entered.binary_search(&voxel).is_ok();
                }
                of_voxel.scans += 1;
                of_voxel.last_scan = scan;
            }
            let (sums, count) = &mut of_voxel.halves[half];
            let center = lattice.center(voxel);
            for axis in 0..3 {
                let offset = ((point[axis] - center[axis]) * UNITS_PER_METRE).round() as i64;
                sums[axis] = sums[axis].saturating_add(offset);
            }
            *count += 1;
        }
    }

    /// Voxels, ascending, that had points in at least `scans` scans of a burn-in of `of` scans,
    /// whose points moved by at most `shift` [m] between its halves, and which no object has
    /// entered or left.
    fn voxels(&self, scans: u32, shift: f64, of: u32, map: &VoxelMap) -> Vec<Voxel> {
        let mut cursor = Cursor::new(&map.blocks);
        let mut stands = |place: &Place, points: &PointsOfVoxel| {
            let is_free = map.known(cursor.stored(place.0)) < map.uncertain_from();
            points.scans >= scans && points.shift() <= shift && !points.has_moved(of, is_free)
        };
        let all = self.voxels.iter().filter(|(place, points)| stands(place, points));
        let mut voxels: Vec<Voxel> = all.map(|(place, _)| place.0).collect();
        voxels.sort_unstable();
        voxels
    }

    /// Voxels, ascending, of the moving clusters of the last scan, and voxels that these have left
    /// behind. A cluster moves if it has entered many of its voxels.
    fn of_moving<'a>(
        &self,
        points: &[[f32; 3]],
        clusters: impl Iterator<Item = Cluster<'a>>,
        of: u32,
        map: &VoxelMap,
    ) -> Vec<Voxel> {
        let mut found = Vec::new();
        for cluster in clusters {
            let voxel =
                |row: &u32| floor(map.lattice().scaled(wide(points[*row as usize]))).map(Place);
            let mut own: Vec<Place> = cluster.members.iter().filter_map(voxel).collect();
            own.sort_unstable();
            own.dedup();
            let has_come = |place: &&Place| {
                self.voxels.get(place).is_some_and(|points| points.has_moved(of, false))
            };
            let n_come = own.iter().filter(has_come).count();
            if n_come > 1 && n_come as f64 >= COME_SHARE * own.len() as f64 {
                found.extend(self.trail(&own, of));
            }
        }
        found.sort_unstable();
        found.dedup();
        found
    }

    /// The voxels `own` of a moving object in scan `of`, and the connected voxels that it has left
    /// behind: the further back, the earlier it left them. Rays may not have passed through these
    /// since then, as in front of the sky, so only the motion of the object shows that they are
    /// empty.
    fn trail(&self, own: &[Place], of: u32) -> Vec<Voxel> {
        let mut trail: Vec<(Voxel, u32)> = own.iter().map(|place| (place.0, of)).collect();
        let mut met: HashSet<Place, BuildHasherDefault<KeyHasher>> = own.iter().copied().collect();
        let mut at = 0;
        while let Some(&([x, y, z], left)) = trail.get(at) {
            at += 1;
            for step in 0..27 {
                let beside = [x + step % 3 - 1, y + step / 3 % 3 - 1, z + step / 9 - 1];
                let Some(points) = self.voxels.get(&Place(beside)) else { continue };
                if points.last_scan < of && points.last_scan <= left && met.insert(Place(beside)) {
                    trail.push((beside, points.last_scan));
                }
            }
        }
        trail.into_iter().map(|(voxel, _)| voxel).collect()
    }

    /// The state to save, in ascending order of voxels. A stage restored from it gives the same
    /// results, bit by bit.
    pub(crate) fn saved(&self) -> Vec<(Place, PointsOfVoxel)> {
        let mut saved: Vec<_> =
            self.voxels.iter().map(|(&place, &points)| (place, points)).collect();
        saved.sort_unstable_by_key(|(place, _)| *place);
        saved
    }

    /// The stage of a saved state.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no detector has.
    pub(crate) fn restored(saved: Vec<(Place, PointsOfVoxel)>) -> Result<Self, Error> {
        if !saved.iter().all(|(place, points)| place.has_neighbours() && points.is_possible()) {
            return Err(impossible("points of scans in another order than that of time"));
        }
        Ok(Self { voxels: saved.into_iter().collect(), entered: Vec::new() })
    }

    /// Forget all scans.
    pub(crate) fn clear(&mut self) {
        self.voxels = HashMap::default();
    }
}

impl PointsOfVoxel {
    /// True if scans can have given these numbers, so that no sum or difference of them overflows.
    fn is_possible(&self) -> bool {
        // Far more scans than a burn-in has, and points than its scans have.
        const MOST: u32 = 1 << 30;
        let Self { first_scan, scans, last_scan, halves, .. } = *self;
        let is_in_order = 1 <= first_scan && first_scan <= last_scan && last_scan <= MOST;
        is_in_order
            && (1..=last_scan - first_scan + 1).contains(&scans)
            && halves.iter().all(|(_, count)| (0..=i64::from(MOST) << 30).contains(count))
    }

    /// Whether an object has moved into or out of the voxel in a burn-in of `of` scans. Scans
    /// without points, before the first scan with points and after the last, count as evidence if
    /// rays have shown the voxel free (`is_free`: at the end). An object has moved if chance hardly
    /// explains so many scans without points.
    fn has_moved(&self, of: u32, is_free: bool) -> bool {
        let span = self.last_scan - self.first_scan + 1;
        let before = if self.was_free { self.first_scan - 1 } else { 0 };
        let after = if is_free { of.saturating_sub(self.last_scan) } else { 0 };
        let misses = 1.0 - f64::from(self.scans + 1) / f64::from(span + 2);
        misses.powi((before + after).cast_signed()) < NOT_BY_CHANCE
    }

    /// Distance between the mean points of the two halves [m]. Infinite if a half has no points.
    fn shift(&self) -> f64 {
        let [(early, n_early), (late, n_late)] = self.halves;
        let mean = |sums: [i64; 3], count: i64, axis: usize| sums[axis] as f64 / count as f64;
        let square: f64 = (0..3)
            .map(|axis| (mean(late, n_late, axis) - mean(early, n_early, axis)).powi(2))
            .sum();
        if square.is_finite() { square.sqrt() / UNITS_PER_METRE } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::map::parameters::tests::parameters;

    #[test]
    fn what_comes_or_goes_where_space_is_free_has_moved() {
        let seen = |first_scan, last_scan, scans, was_free| PointsOfVoxel {
            was_free,
            first_scan,
            last_scan,
            scans,
            halves: Default::default(),
        };
        assert!(seen(5, 10, 6, true).has_moved(10, false));
        assert!(seen(1, 6, 6, false).has_moved(10, true));
        assert!(seen(3, 8, 6, true).has_moved(10, true));
        // It was hidden at first, or is now; it is hit now and then; it is there all the time.
        assert!(!seen(5, 10, 6, false).has_moved(10, false));
        assert!(!seen(1, 6, 6, false).has_moved(10, false));
        assert!(!seen(3, 9, 5, true).has_moved(10, true));
        assert!(!seen(1, 10, 10, true).has_moved(10, true));
    }

    #[test]
    fn points_that_no_scan_left_are_refused() {
        let restored = |x, [first_scan, scans, last_scan]: [u32; 3], count| {
            let halves = [([0; 3], count), ([0; 3], 0)];
            let points = PointsOfVoxel { was_free: true, first_scan, scans, last_scan, halves };
            StaticPoints::restored(vec![(Place([x, 0, 0]), points)]).is_ok()
        };
        assert!(restored(3, [2, 4, 5], 9) && restored(i32::MAX - 1, [1, 1, 1], 0));
        for scans in [[0, 1, 1], [5, 1, 2], [2, 5, 5], [2, 0, 5], [1, 1, u32::MAX]] {
            assert!(!restored(3, scans, 9), "{scans:?}");
        }
        assert!(!restored(i32::MAX, [2, 4, 5], 9) && !restored(i32::MIN, [2, 4, 5], 9));
        assert!(!restored(3, [2, 4, 5], -1) && !restored(3, [2, 4, 5], i64::MAX));
    }

    #[test]
    fn what_has_left_a_trail_moves_and_what_is_beside_it_stands() -> Result<(), Error> {
        let lattice = Lattice::new(0.25, [0.0; 3])?;
        let middle = |x: i32, y: i32| lattice.center([x, y, 0]).map(|value| value as f32);
        let mut standing = StaticPoints::default();
        for scan in 1..=10_i32 {
            // Six voxels that go on by one in every second scan, beside a post and before something far away
            // that is not hit at the end.
            let mut points: Vec<[f32; 3]> = (0..6).map(|step| middle(scan / 2 + step, 0)).collect();
            points.push(middle(3, 1));
            points.extend((scan < 9).then(|| middle(-3, 0)));
            standing.add(&lattice, &points, scan as u32, 10);
        }
        let own: Vec<Place> = (5..11).map(|x| Place([x, 0, 0])).collect();
        let mut trail = standing.trail(&own, 10);
        trail.sort_unstable();
        assert_eq!(trail, (0..11).map(|x| [x, 0, 0]).collect::<Vec<Voxel>>());
        Ok(())
    }

    #[test]
    fn what_moves_through_a_voxel_does_not_stand() -> Result<(), Error> {
        let lattice = Lattice::new(0.25, [0.0; 3])?;
        let mut standing = StaticPoints::default();
        for scan in 1..=10 {
            let along = 0.02 * scan as f32;
            let rare = if scan % 3 == 0 { 2.1 } else { 9.0 + scan as f32 };
            standing.add(
                &lattice,
                &[[0.1, 0.1, 0.1], [along, 1.1, 0.1], [rare, 0.1, 0.1]],
                scan,
                10,
            );
        }
        let map = VoxelMap::new(parameters())?; // nothing is free
        assert_eq!(standing.voxels(6, 0.04, 10, &map), [[0, 0, 0]]);
        assert_eq!(standing.voxels(3, 0.04, 10, &map), [[0, 0, 0], [8, 0, 0]]);
        assert_eq!(standing.voxels(6, 0.25, 10, &map), [[0, 0, 0], [0, 4, 0]]);
        Ok(())
    }
}
