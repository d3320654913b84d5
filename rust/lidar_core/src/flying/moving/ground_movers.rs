//! Points of objects that move on the ground, such as people and cars ("movers").
//!
//! The search for flying objects classifies them as background or unknown. But they are at places that were free
//! before, with something close below. These places are remembered, so that an object remains a mover while it stops
//! for a moment. The places must be open: free space is around them, or what came there before. Otherwise surfaces
//! that rays along them made free would move. What stands and is thin, such as a fence, is not a mover: it had returns
//! from the same places before. A mover comes from beside, voxel by voxel or from the voxels that it has left. What has
//! only come into view, such as a post that rays meet now and then, is a mover until it comes back to the same place
//! after a break, or is forgotten. Flat ground is not a mover either: on a dark or wet road, returns come only once the
//! sensor is close, and rays along the road have made its place free before.
//!
//! A moving object with nothing close below is in the air. A large target that was once background, as in the
//! burn-in, would stay background for ever: each scan would add its points to the background, and the next scan would
//! find its points near those. So the space that it enters counts as not explained by the map, and its points are
//! unknown.

use super::arrivals::{ArrivedVoxels, SavedArrivals};
use super::entered::{EnteredVoxels, MovingPart};
use super::free_space::{FreeSpace, parts, with_beside};
use super::stay::Stay;
use super::things::{PointsByVoxel, ScanOfMovers, Things};
use crate::Error;
use crate::flying::map::blocks::{Cursor, Place};
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::PointClass;
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};
use crate::util::cancel;
use serde::{Deserialize, Serialize};

/// Smallest number of points of a mover; `FEWEST_OPEN`: of its voxels that are not beside anything else.
const FEWEST_POINTS: usize = 8;
const FEWEST_OPEN: usize = 2;
/// Largest distance of a mover on the ground above something occupied [m].
const ABOVE_GROUND: f64 = 0.75;
/// Points that are closer to the height of flat ground are on it [m]. No mover consists of them alone.
const FLOOR: f64 = 0.2;

/// State of the space below a voxel.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Below {
    /// Something below is occupied.
    Occupied,
    /// Nothing below was ever seen, as where the field of view ends.
    Unseen,
    Free,
}

impl Below {
    /// State of the `steps` voxels straight below a voxel and their neighbours, except the object's `own` voxels.
    fn of(
        cursor: &mut Cursor<'_>,
        [x, y, z]: Voxel,
        steps: i32,
        own: impl Fn(Voxel) -> bool,
    ) -> Self {
        let below =
            |down: i32, place: i32| [x + place % 3 - 1, y + place / 3 - 1, z.saturating_sub(down)];
        let mut is_occupied = |down: i32| {
            (0..9).any(|place| {
                let voxel = below(down, place);
                cursor.is_tentative(voxel) && !own(voxel)
            })
        };
        if (1..=steps).any(&mut is_occupied) {
            Self::Occupied
        } else if (1..=steps).all(|down| cursor.stored(below(down, 4)).is_nan()) {
            Self::Unseen
        } else {
            Self::Free
        }
    }
}

/// Voxels with returns in open space, and those beside them, by their indices.
struct OpenVoxels {
    /// Voxels where nothing stood before: movers are in them.
    moving: Vec<usize>,
    /// Voxels that were free, also where something stood before. In the air this is enough: a target may have hovered
    /// there in the burn-in, as background.
    free: Vec<usize>,
}

/// Search for the points of movers in one scan after another.
#[derive(Default)]
pub(crate) struct GroundMovers {
    /// Voxels that movers are in, or were in a short time ago.
    entered: EnteredVoxels,
    /// Other voxels that something came into.
    arrivals: ArrivedVoxels,
    /// Indices of the points of movers on the ground in the newest scan.
    rows: Vec<u32>,
    /// Indices of the points of objects that move in the air.
    in_air: Vec<u32>,
    /// Indices of those points of movers for which it is not known whether they stand on anything.
    over_unseen: Vec<u32>,
}

impl GroundMovers {
    /// Find the movers among the points that are not known to fly, on the map before the scan.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(crate) fn find(
        &mut self,
        scan: &ScanOfMovers<'_>,
        map: &VoxelMap,
        stamp_ns: i64,
    ) -> Result<(), Error> {
        // Longer than other functions: its loop fills four lists from the same parts.
        self.skip();
        self.arrivals.begin(stamp_ns);
        self.entered.begin(stamp_ns, &mut self.arrivals);
        let mut space = FreeSpace::of(map);
        let mut cursor = Cursor::new(&map.blocks);
        let steps = (ABOVE_GROUND / map.lattice().voxel_size()).ceil() as i32;
        let found = self.in_free_space(scan, map, &mut space);
        self.entered.look(&found.voxels);
        self.sort_voxels(scan, &found, &mut space);
        let open = self.in_open_space(scan, map, &found.voxels, &mut space)?;
        let is_entered = |voxel: Voxel| self.entered.contains(voxel);
        let mut moving = Vec::new();
        for (movers, is_ground_searched) in [(&open.moving, true), (&open.free, false)] {
            let places: Vec<Voxel> = movers.iter().map(|&at| found.voxels[at]).collect();
            for part in parts(&places) {
                let n_points: usize = part.iter().map(|&at| found.rows(movers[at]).len()).sum();
                if n_points < FEWEST_POINTS {
                    continue;
                }
                let mut below = |&at: &usize| Below::of(&mut cursor, places[at], steps, is_entered);
                let below: Vec<Below> = part.iter().map(&mut below).collect();
                let is_in_air = below.iter().all(|&one| one == Below::Free);
                let is_over_unseen = !is_in_air && !below.contains(&Below::Occupied);
                let rows = || part.iter().flat_map(|&at| found.rows(movers[at]));
                if is_in_air {
                    self.in_air.extend(rows());
                } else if is_ground_searched {
                    self.rows.extend(rows());
                }
                if is_over_unseen {
                    self.over_unseen.extend(rows());
                }
                if is_in_air || is_over_unseen || is_ground_searched {
                    let voxels = part.iter().map(|&at| places[at]).collect();
                    moving.push(MovingPart { voxels, is_in_air });
                }
            }
        }
        self.entered.enter(&moving, &mut self.arrivals, map.lattice().voxel_size());
        for points in [&mut self.in_air, &mut self.over_unseen] {
            points.sort_unstable();
            points.dedup();
        }
        Ok(())
    }

    /// Store what the newest scan has shown. Without it, the scan has no effect on later ones.
    pub(crate) fn accept(&mut self) {
        self.entered.accept();
        self.arrivals.accept();
    }

    /// Indices of the points beside objects that moved in the air in the newest scan with such objects.
    pub(crate) fn beside_air(&self, points: &[[f32; 3]], lattice: &Lattice) -> Vec<usize> {
        let places = self.entered.newest_in_air();
        if places.is_empty() {
            return Vec::new();
        }
        let boxes: Vec<[[f64; 3]; 2]> = parts(&places)
            .into_iter()
            .map(|part| {
                let end = |axis: usize, side: f64| {
                    let all = part.iter().map(|&at| lattice.center(places[at])[axis]);
                    let reach = 1.5 * lattice.voxel_size();
                    all.fold(f64::NEG_INFINITY, |most, at| most.max(side * at + reach)) * side
                };
                [-1.0, 1.0].map(|side| [0, 1, 2].map(|axis| end(axis, side)))
            })
            .collect();
        let is_inside = |index: &usize| {
            let point = wide(points[*index]);
            boxes.iter().any(|[low, high]| {
                (0..3).all(|axis| point[axis] >= low[axis] && point[axis] <= high[axis])
            })
        };
        (0..points.len()).filter(is_inside).collect()
    }

    /// Indices of the points of objects that move in the air in the newest scan, ascending.
    pub(crate) fn in_air(&self) -> &[u32] {
        &self.in_air
    }

    /// Indices of the points of movers with nothing occupied close below, where part of the space below was never seen
    /// (such as behind a table): they may fly or stand on something. Ascending.
    pub(crate) fn over_unseen(&self) -> &[u32] {
        &self.over_unseen
    }

    /// Tell voxels that something came into from those where something stands, or that only the ground is in.
    fn sort_voxels(
        &mut self,
        scan: &ScanOfMovers<'_>,
        found: &PointsByVoxel,
        space: &mut FreeSpace<'_>,
    ) {
        let height = |row: u32| f64::from(scan.points[row as usize][2]);
        let is_floor =
            |&row: &u32| scan.floor.is_some_and(|floor| (height(row) - floor).abs() < FLOOR);
        for (at, &voxel) in found.voxels.iter().enumerate() {
            if found.rows(at).iter().all(is_floor) {
                self.arrivals.add_doubtful(voxel);
            } else if !self.entered.contains(voxel) {
                self.arrivals.take(voxel, space);
            } else if self.entered.has_come_back(voxel) && space.is_certain(voxel) {
                self.entered.remove(voxel);
                self.arrivals.add_doubtful(voxel);
            }
        }
    }

    /// The voxels that are in open space, and those beside them.
    fn in_open_space(
        &self,
        scan: &ScanOfMovers<'_>,
        map: &VoxelMap,
        voxels: &[Voxel],
        space: &mut FreeSpace<'_>,
    ) -> Result<OpenVoxels, Error> {
        let things = Things::of(scan, map.lattice());
        let watch = cancel::watch();
        let free = self.are_free(voxels, &things, space);
        // Beside a mover is also what stands. That may not count as free, or surfaces would become movers bit by bit.
        let is_entered =
            |voxel: Voxel| self.entered.contains(voxel) && !self.arrivals.has_standing(voxel);
        let has_come = |voxel: Voxel| is_entered(voxel) || self.arrivals.came_lately(voxel);
        let mut is_open = |voxel: Voxel, also: &dyn Fn(Voxel) -> bool| {
            let hides = |beside| things.hide(voxel, beside);
            !self.arrivals.has_standing(voxel) && space.is_open(voxel, also, hides)
        };
        let mut open: Vec<bool> =
            voxels.iter().map(|&voxel| !watch.is_asked() && is_open(voxel, &has_come)).collect();
        watch.check()?;
        let rows: Vec<usize> = (0..voxels.len()).filter(|&at| open[at]).collect();
        let places: Vec<Voxel> = rows.iter().map(|&at| voxels[at]).collect();
        for part in parts(&places) {
            let own = || part.iter().map(|&at| places[at]);
            if !own().any(is_entered) && !self.arrivals.came_in_turn(own()) {
                for &at in &part {
                    open[rows[at]] = is_open(places[at], &is_entered);
                }
            }
        }
        let chosen = |open: &[bool]| {
            let is_chosen = with_beside(voxels, open, FEWEST_OPEN);
            (0..voxels.len()).filter(|&at| is_chosen[at]).collect()
        };
        Ok(OpenVoxels { moving: chosen(&open), free: chosen(&free) })
    }

    /// For each voxel, whether it is in open space, also where something stood before.
    fn are_free(
        &self,
        voxels: &[Voxel],
        things: &Things<'_>,
        space: &mut FreeSpace<'_>,
    ) -> Vec<bool> {
        let watch = cancel::watch();
        let mut is_free = |voxel: Voxel| {
            space.is_open(
                voxel,
                |one| self.entered.contains(one),
                |beside| things.hide(voxel, beside),
            )
        };
        voxels.iter().map(|&voxel| !watch.is_asked() && is_free(voxel)).collect()
    }

    /// Points that are not known to fly, in voxels that are free, or were free before something entered them.
    fn in_free_space(
        &mut self,
        scan: &ScanOfMovers<'_>,
        map: &VoxelMap,
        space: &mut FreeSpace<'_>,
    ) -> PointsByVoxel {
        let (ScanOfMovers { points, class, maybe_own, .. }, lattice) = (*scan, map.lattice());
        let is_own = |point: u32| maybe_own.get(point as usize).copied().unwrap_or(false);
        let mut found: Vec<(Voxel, u32)> = Vec::new();
        // Points beside each other in a scan are mostly in one voxel.
        let mut last: Option<(Voxel, bool)> = None;
        for (index, (&point, _)) in (0..)
            .zip(points.iter().zip(class))
            .filter(|(_, (_, class))| matches!(class, PointClass::Background | PointClass::Unknown))
            .filter(|(index, _)| !is_own(*index))
        {
            let Some(voxel) = floor(lattice.scaled(wide(point))) else { continue };
            let is_chosen = match last {
                Some((known, is_chosen)) if known == voxel => is_chosen,
                _ => {
                    let has_come = self.entered.contains(voxel) || self.arrivals.contains(voxel);
                    let is_chosen = has_come || space.is_free(voxel);
                    if !is_chosen {
                        self.arrivals.add_standing(voxel);
                    }
                    is_chosen
                }
            };
            last = Some((voxel, is_chosen));
            if is_chosen {
                found.push((voxel, index));
            }
        }
        found.sort_unstable();
        PointsByVoxel::of(&found)
    }

    /// Remove the points whose class is now `FLYING`.
    pub(crate) fn leave_flying(&mut self, class: &[PointClass]) {
        self.rows.retain(|&point| class.get(point as usize) != Some(&PointClass::Flying));
    }

    /// Add the points of an object that a track of kind `GROUND` follows, by their indices.
    pub(crate) fn add(&mut self, points: &[u32]) {
        self.rows.extend(points);
    }

    /// Indices of the points of ground movers in the newest scan.
    pub(crate) fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// Find nothing in the newest scan, which is not used.
    pub(crate) fn skip(&mut self) {
        self.rows.clear();
        self.in_air.clear();
        self.over_unseen.clear();
        self.entered.skip();
        self.arrivals.skip();
    }

    /// Forget everything.
    pub(crate) fn clear(&mut self) {
        self.skip();
        self.entered.clear();
        self.arrivals.clear();
    }

    /// The state to save. A stage restored from it gives the same results, bit by bit.
    pub(crate) fn saved(&self) -> SavedMovers {
        SavedMovers { entered: self.entered.saved(), arrivals: self.arrivals.saved() }
    }

    /// The stage of a saved state.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no detector has.
    pub(crate) fn restored(saved: SavedMovers) -> Result<Self, Error> {
        let entered = EnteredVoxels::restored(saved.entered)?;
        Ok(Self { entered, arrivals: ArrivedVoxels::restored(saved.arrivals)?, ..Self::default() })
    }
}

/// [`GroundMovers`] in a saved state.
#[derive(Serialize, Deserialize)]
pub(crate) struct SavedMovers {
    entered: Vec<(Place, Stay)>,
    arrivals: SavedArrivals,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::map::parameters::tests::parameters;

    /// Points of a target of 3 x 3 x 2 voxels, whose lowest voxels have the index `up` along z.
    fn target(lattice: &Lattice, up: i32) -> Vec<[f32; 3]> {
        let voxel = |at: i32| [at % 3, at / 3 % 3, up + at / 9];
        (0..18).map(|at| lattice.center(voxel(at)).map(|value| value as f32)).collect()
    }

    /// Map of free space with some occupied voxels.
    fn map(occupied: &[Voxel]) -> Result<VoxelMap, Error> {
        map_above(-6, occupied)
    }

    /// Map of free space with some occupied voxels. Nothing below the index `low` along z was ever seen.
    fn map_above(low: i32, occupied: &[Voxel]) -> Result<VoxelMap, Error> {
        let mut map = VoxelMap::new(parameters())?;
        let lattice = *map.lattice();
        let center = |voxel| lattice.center(voxel).map(|value: f64| value as f32);
        let (from, n) = (-6, 13);
        let voxel = |at: i32| [from + at % n, from + at / n % n, from + at / (n * n)];
        let seen = (0..n * n * n).map(voxel).filter(|voxel| voxel[2] >= low);
        map.pull(&seen.map(center).collect::<Vec<_>>(), -1000.0, 20.0)?;
        map.set_occupied(&occupied.iter().map(|&voxel| center(voxel)).collect::<Vec<_>>())?;
        Ok(map)
    }

    /// Numbers of points in the air, and of points of ground movers.
    fn found(movers: &mut GroundMovers, map: &VoxelMap, up: i32) -> [usize; 2] {
        found_above(None, movers, map, up)
    }

    fn found_above(
        floor: Option<f64>,
        movers: &mut GroundMovers,
        map: &VoxelMap,
        up: i32,
    ) -> [usize; 2] {
        let points = target(map.lattice(), up);
        let class = &[PointClass::Background; 18];
        let scan = ScanOfMovers {
            points: &points,
            class,
            maybe_own: &[],
            origin: [0.0; 3],
            floor,
            things: &[],
        };
        assert!(movers.find(&scan, map, 0).is_ok());
        movers.accept();
        [movers.in_air().len(), movers.rows().len()]
    }

    #[test]
    fn what_has_nothing_below_is_in_the_air() -> Result<(), Error> {
        let steps = (ABOVE_GROUND / map(&[])?.lattice().voxel_size()).ceil() as i32;
        let mut movers = GroundMovers::default();
        assert_eq!(found(&mut movers, &map(&[])?, 0), [18, 0]);
        assert_eq!(found(&mut GroundMovers::default(), &map(&[[1, 1, -steps]])?, 0), [0, 18]);
        assert_eq!(found(&mut GroundMovers::default(), &map(&[[1, 1, -steps - 1]])?, 0), [18, 0]);
        // What it has left behind itself, as background, is nothing that it stands on; other things are.
        let left = map(&[[1, 1, 0]])?;
        assert_eq!(found(&mut movers, &left, 2), [18, 0]);
        assert_eq!(found(&mut GroundMovers::default(), &left, 2), [0, 18]);
        Ok(())
    }

    #[test]
    fn flat_ground_is_no_mover() -> Result<(), Error> {
        let map = map(&[[1, 1, -2]])?; // the target is above something
        let size = map.lattice().voxel_size();
        let movers =
            |floor: f64| found_above(Some(floor * size), &mut GroundMovers::default(), &map, 0);
        assert_eq!(found(&mut GroundMovers::default(), &map, 0), [0, 18]);
        assert_eq!(movers(1.0), [0, 0], "points are half a voxel below and above");
        assert_eq!(movers(0.0), [0, 18], "on the ground");
        assert_eq!(movers(-1.0), [0, 18]);
        assert_eq!(movers(9.0), [0, 18], "below the ground, as in a pit");
        Ok(())
    }

    /// Numbers of points of ground movers, for a target at the given places along x in scans of 10 Hz. None: no points.
    fn found_at(places: &[Option<i32>]) -> Result<Vec<usize>, Error> {
        found_every(100_000_000, places)
    }

    fn found_every(period_ns: i64, places: &[Option<i32>]) -> Result<Vec<usize>, Error> {
        let ground: Vec<Voxel> = (-6..7).map(|x| [x, 1, -2]).collect();
        let (map, mut movers) = (map(&ground)?, GroundMovers::default());
        let size = map.lattice().voxel_size() as f32;
        let mut found = Vec::new();
        for (place, scan) in places.iter().zip(0..) {
            let shifted = |at: i32| {
                let points = target(map.lattice(), 0).into_iter();
                points.map(|[x, y, z]| [x + at as f32 * size, y, z]).collect()
            };
            let points: Vec<[f32; 3]> = place.map_or(Vec::new(), shifted);
            let class = vec![PointClass::Background; points.len()];
            let scan_of = ScanOfMovers {
                points: &points,
                class: &class,
                maybe_own: &[],
                origin: [0.0; 3],
                floor: None,
                things: &[],
            };
            movers.find(&scan_of, &map, scan * period_ns)?;
            movers.accept();
            found.push(movers.rows().len());
        }
        Ok(found)
    }

    #[test]
    fn what_comes_back_to_its_place_stands() -> Result<(), Error> {
        let (seen, gone) = (Some(0), None);
        assert_eq!(found_at(&[seen, gone, seen, seen, gone, seen])?, [18, 0, 0, 0, 0, 0]);
        assert_eq!(found_at(&[seen, seen, seen])?, [18; 3], "no break");
        // It is forgotten in between, but not that it was there.
        assert_eq!(found_every(3_000_000_000, &[seen, gone, seen])?, [18, 0, 0]);
        assert_eq!(found_every(30_000_000_000, &[seen, gone, seen])?, [18, 0, 18]);
        Ok(())
    }

    #[test]
    fn what_moves_may_come_back() -> Result<(), Error> {
        assert_eq!(found_at(&[0, 1, 2, 3, 4, 3, 2, 3].map(Some))?, [18; 8]);
        // Nothing shows before the third scan that it moves. The voxels that it was in until then count as well.
        assert_eq!(found_at(&[0, 1, 2, 3, 2, 1, 0].map(Some))?, [18; 7]);
        // Between two scans, it leaves all of its voxels.
        assert_eq!(found_at(&[-4, 0, -4].map(Some))?, [18; 3]);
        assert_eq!(found_at(&[-3, 0, 3, 0, 3].map(Some))?, [18; 5]);
        Ok(())
    }

    #[test]
    fn what_is_over_unseen_space_may_fly() -> Result<(), Error> {
        let over_unseen = |map: &VoxelMap| {
            let mut movers = GroundMovers::default();
            let all = found(&mut movers, map, 0);
            (all, movers.over_unseen().len())
        };
        assert_eq!(over_unseen(&map_above(0, &[])?), ([0, 18], 18));
        assert_eq!(over_unseen(&map_above(0, &[[1, 1, -1]])?), ([0, 18], 0));
        assert_eq!(over_unseen(&map(&[])?), ([18, 0], 0));
        Ok(())
    }

    #[test]
    fn points_beside_what_is_in_the_air_are_looked_at() -> Result<(), Error> {
        let (mut movers, map) = (GroundMovers::default(), map(&[])?);
        let far = map.lattice().center([9, 9, 9]).map(|value| value as f32);
        let points = [target(map.lattice(), 1), vec![far]].concat();
        assert_eq!(movers.beside_air(&points, map.lattice()), Vec::<usize>::new());
        found(&mut movers, &map, 0);
        assert_eq!(movers.beside_air(&points, map.lattice()), (0..18).collect::<Vec<_>>());
        movers.clear();
        assert_eq!(movers.beside_air(&points, map.lattice()), Vec::<usize>::new());
        Ok(())
    }
}
