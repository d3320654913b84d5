//! What comes into free space.
//!
//! Something that moves by less than a voxel per scan, such as a person on foot, is beside the voxels that it was in
//! just before. These are not free any more. So a search for objects with free space around them would never find it.

use super::free_space::FreeSpace;
use super::past_hits::{PastHits, SavedPastHits};
use super::stay::{Stay, Stays, came_in_turn, restored_stays, saved_stays};
use crate::Error;
use crate::flying::map::blocks::Place;
use crate::geometry::lattice::Voxel;
use crate::util::key_hasher::KeyHasher;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::hash::BuildHasherDefault;

/// Time in which a moving part enters the next voxel, at most [ns]. Where the given poses drift, surfaces enter free
/// space, too, but by less than 0.25 m/s.
const NEXT_NS: i64 = 1_000_000_000;

/// Voxels that were certainly free, and had no returns for a while, until something came into them.
///
/// A scan changes nothing before it is accepted: it may be refused or stopped after this search.
#[derive(Default)]
pub(super) struct ArrivedVoxels {
    stays: Stays,
    /// Voxels with returns from what stands. Rays make such a voxel free too, where it holds something thin.
    past: PastHits,
    /// Stamp of the newest accepted scan [ns].
    newest_ns: Option<i64>,
    /// What follows the stays after the scan.
    next: Stays,
    /// Voxels with returns from what stands in the scan, as they come. One may be there twice.
    standing: Vec<Voxel>,
    /// Those of them that are free, or were free a short time ago.
    doubtful: HashSet<Place, BuildHasherDefault<KeyHasher>>,
    /// Stamp of the scan [ns].
    now_ns: i64,
}

/// [`ArrivedVoxels`] in a saved state.
#[derive(Serialize, Deserialize)]
pub(crate) struct SavedArrivals {
    stays: Vec<(Place, Stay)>,
    past: SavedPastHits,
    newest_ns: Option<i64>,
}

impl ArrivedVoxels {
    /// Begin a scan at a time [ns].
    pub(super) fn begin(&mut self, stamp_ns: i64) {
        self.skip();
        self.now_ns = stamp_ns;
        for (&place, &stay) in &self.stays {
            if stay.is_remembered(stamp_ns) {
                self.next.insert(place, stay);
            } else if stay.is_longer_than_a_scan() {
                // A single return, as from rain, does not show that anything stands there.
                self.doubtful.insert(place);
            }
        }
    }

    /// Store what the scan has shown. Without it, the scan has no effect.
    pub(super) fn accept(&mut self) {
        std::mem::swap(&mut self.stays, &mut self.next);
        self.past.forget(self.now_ns);
        for voxel in self.standing.drain(..).chain(self.doubtful.drain().map(|place| place.0)) {
            self.past.insert(voxel);
        }
        self.newest_ns = Some(self.now_ns);
    }

    /// Leave the scan without effect.
    pub(super) fn skip(&mut self) {
        self.next.clear();
        self.standing.clear();
        self.doubtful.clear();
    }

    /// True if something came into the voxel a short time ago.
    pub(super) fn contains(&self, voxel: Voxel) -> bool {
        self.next.contains_key(&Place(voxel))
    }

    /// True if something came into the voxel less than [`NEXT_NS`] ago.
    pub(super) fn came_lately(&self, voxel: Voxel) -> bool {
        let stay = self.next.get(&Place(voxel));
        stay.is_some_and(|stay| self.now_ns.saturating_sub(stay.first_ns) <= NEXT_NS)
    }

    /// True if something that stands had returns from the voxel, which is or was free.
    pub(super) fn has_standing(&self, voxel: Voxel) -> bool {
        self.doubtful.contains(&Place(voxel)) || self.past.contains(voxel, self.now_ns)
    }

    /// Store that something that stands had a return from the voxel, which is not free.
    pub(super) fn add_standing(&mut self, voxel: Voxel) {
        self.standing.push(voxel);
    }

    /// Forget a voxel because what is in it is known to move.
    pub(super) fn remove(&mut self, place: Place) {
        self.next.remove(&place);
    }

    /// Store that something that stands had a return from the voxel, which is free or was free a short time ago.
    pub(super) fn add_doubtful(&mut self, voxel: Voxel) {
        self.doubtful.insert(Place(voxel));
    }

    /// Take a voxel with returns of the scan that is free, or was free a short time ago. No mover is in it. `space`:
    /// before the scan.
    pub(super) fn take(&mut self, voxel: Voxel, space: &mut FreeSpace<'_>) {
        let (place, is_certain) = (Place(voxel), space.is_certain(voxel));
        if let Some(stay) = self.next.get_mut(&place) {
            // Returns, then free, then returns again: a thin thing that stands, such as a fence.
            if is_certain && self.newest_ns.is_some_and(|newest_ns| stay.last_ns < newest_ns) {
                self.next.remove(&place);
                self.doubtful.insert(place);
            } else {
                stay.last_ns = self.now_ns;
            }
        } else if is_certain && !self.has_standing(voxel) {
            self.next.insert(place, Stay::new(self.now_ns));
        } else if is_certain {
            self.doubtful.insert(place);
        }
    }

    /// Time at which something came into the voxel [ns]. None if nothing came, or if a mover is in it.
    pub(super) fn first_ns(&self, voxel: Voxel) -> Option<i64> {
        self.next.get(&Place(voxel)).map(|stay| stay.first_ns)
    }

    /// True if something came into the voxels of a part one after the other.
    pub(super) fn came_in_turn(&self, part: impl Iterator<Item = Voxel>) -> bool {
        came_in_turn(&part.filter_map(|voxel| self.first_ns(voxel)).collect::<Vec<_>>())
    }

    /// Stamp of the scan before [ns].
    pub(super) fn newest_ns(&self) -> Option<i64> {
        self.newest_ns
    }

    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    pub(super) fn saved(&self) -> SavedArrivals {
        let (stays, past) = (saved_stays(&self.stays), self.past.saved());
        SavedArrivals { stays, past, newest_ns: self.newest_ns }
    }

    /// The arrivals of a saved state.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no detector has.
    pub(super) fn restored(saved: SavedArrivals) -> Result<Self, Error> {
        let (stays, past) = (restored_stays(saved.stays)?, PastHits::restored(saved.past)?);
        Ok(Self { stays, past, newest_ns: saved.newest_ns, ..Self::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::map::parameters::tests::parameters;
    use crate::flying::map::voxel_map::VoxelMap;

    const SCAN: i64 = 100_000_000;
    const ROW: [Voxel; 4] = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]];

    /// Map whose voxels `ROW` are certainly free, except the last one.
    fn map() -> Result<VoxelMap, Error> {
        let mut map = VoxelMap::new(parameters())?;
        let lattice = *map.lattice();
        let center = |voxel: &Voxel| lattice.center(*voxel).map(|value: f64| value as f32);
        map.pull(&ROW[..3].iter().map(center).collect::<Vec<_>>(), -1000.0, 20.0)?;
        map.pull(&[center(&ROW[3])], -1000.0, 6.0)?; // a few rays
        Ok(map)
    }

    fn scan(arrivals: &mut ArrivedVoxels, map: &VoxelMap, number: i64, voxels: &[Voxel]) {
        look(arrivals, map, number, voxels);
        arrivals.accept();
        arrivals.begin(number * SCAN); // shows the new state
    }

    /// A scan that is not accepted.
    fn look(arrivals: &mut ArrivedVoxels, map: &VoxelMap, number: i64, voxels: &[Voxel]) {
        arrivals.begin(number * SCAN);
        let mut space = FreeSpace::of(map);
        for &voxel in voxels {
            arrivals.take(voxel, &mut space);
        }
    }

    #[test]
    fn only_voxels_that_were_certainly_free_are_entered() -> Result<(), Error> {
        let (map, mut arrivals) = (map()?, ArrivedVoxels::default());
        arrivals.begin(0);
        arrivals.add_standing(ROW[1]);
        arrivals.accept();
        scan(&mut arrivals, &map, 0, &ROW);
        assert_eq!(ROW.map(|voxel| arrivals.contains(voxel)), [true, false, true, false]);
        assert_eq!(ROW.map(|voxel| arrivals.has_standing(voxel)), [false, true, false, false]);
        arrivals.remove(Place(ROW[0]));
        assert!(!arrivals.contains(ROW[0]) && !arrivals.has_standing(ROW[0]));
        Ok(())
    }

    #[test]
    fn returns_that_come_back_are_of_what_stands() -> Result<(), Error> {
        let (map, mut arrivals) = (map()?, ArrivedVoxels::default());
        scan(&mut arrivals, &map, 0, &ROW[..1]);
        scan(&mut arrivals, &map, 1, &ROW[..1]);
        assert!(arrivals.contains(ROW[0]), "without a break");
        scan(&mut arrivals, &map, 2, &[]);
        scan(&mut arrivals, &map, 3, &ROW[..1]);
        assert!(!arrivals.contains(ROW[0]) && arrivals.has_standing(ROW[0]));
        Ok(())
    }

    #[test]
    fn what_stayed_for_longer_than_a_scan_is_remembered_as_standing() -> Result<(), Error> {
        let (map, mut arrivals) = (map()?, ArrivedVoxels::default());
        scan(&mut arrivals, &map, 0, &ROW[..2]);
        scan(&mut arrivals, &map, 1, &ROW[..1]); // the other one was a drop of rain
        scan(&mut arrivals, &map, 40, &[]);
        assert_eq!(ROW.map(|voxel| arrivals.contains(voxel)), [false; 4]);
        assert_eq!(ROW.map(|voxel| arrivals.has_standing(voxel)), [true, false, false, false]);
        Ok(())
    }

    #[test]
    fn a_moving_part_enters_one_voxel_after_the_other() -> Result<(), Error> {
        let (map, mut arrivals) = (map()?, ArrivedVoxels::default());
        let in_turn = |arrivals: &ArrivedVoxels| arrivals.came_in_turn(ROW.into_iter());
        assert!(!in_turn(&arrivals), "nothing came");
        scan(&mut arrivals, &map, 0, &ROW[..2]);
        assert!(!in_turn(&arrivals), "all at once, as what was hidden before");
        scan(&mut arrivals, &map, 1, &ROW[..2]);
        assert!(!in_turn(&arrivals));
        scan(&mut arrivals, &map, 2, &ROW[1..3]);
        assert!(!in_turn(&arrivals), "one of three");
        arrivals.remove(Place(ROW[0]));
        assert!(in_turn(&arrivals), "one of two");
        Ok(())
    }

    #[test]
    fn a_scan_that_is_not_accepted_has_no_effect() -> Result<(), Error> {
        let (map, mut arrivals) = (map()?, ArrivedVoxels::default());
        look(&mut arrivals, &map, 0, &ROW);
        arrivals.add_doubtful(ROW[3]);
        arrivals.add_standing([9, 0, 0]);
        assert!(arrivals.has_standing(ROW[3]));
        arrivals.begin(SCAN);
        assert_eq!(ROW.map(|voxel| arrivals.contains(voxel)), [false; 4]);
        assert!(!arrivals.has_standing(ROW[3]) && !arrivals.has_standing([9, 0, 0]));
        Ok(())
    }

    #[test]
    fn what_came_long_ago_did_not_come_lately() -> Result<(), Error> {
        let (map, mut arrivals) = (map()?, ArrivedVoxels::default());
        for (number, is_late) in [(0, false), (10, false), (11, true)] {
            scan(&mut arrivals, &map, number, &ROW[..1]);
            assert!(arrivals.contains(ROW[0]) && !arrivals.came_lately(ROW[1]));
            assert_eq!(arrivals.came_lately(ROW[0]), !is_late, "{number}");
        }
        Ok(())
    }

    #[test]
    fn a_saved_state_goes_on_the_same() -> Result<(), Error> {
        let (map, mut arrivals) = (map()?, ArrivedVoxels::default());
        scan(&mut arrivals, &map, 0, &ROW[..1]);
        scan(&mut arrivals, &map, 1, &[]);
        let mut again = ArrivedVoxels::restored(arrivals.saved())?;
        for one in [&mut arrivals, &mut again] {
            scan(one, &map, 2, &ROW[..1]);
            assert!(one.has_standing(ROW[0]));
        }
        let mut saved = arrivals.saved();
        saved.stays.push((Place([i32::MAX; 3]), Stay::new(0)));
        assert!(ArrivedVoxels::restored(saved).is_err());
        Ok(())
    }
}
