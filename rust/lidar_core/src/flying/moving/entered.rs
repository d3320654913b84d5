//! Voxels that movers are in, or were in a short time ago.

use super::arrivals::ArrivedVoxels;
use super::free_space::around;
use super::stay::{Stay, Stays, came_from_beside, restored_stays, saved_stays};
use crate::Error;
use crate::flying::map::blocks::Place;
use crate::geometry::lattice::Voxel;

/// Largest speed of what moves on the ground [m/s], and its size [m]. Between two scans, something fast may leave all of
/// its voxels.
const FASTEST: f64 = 15.0;
const SIZE: f64 = 1.0;

/// A connected part of a scan that moves.
pub(super) struct MovingPart {
    pub(super) voxels: Vec<Voxel>,
    /// Whether nothing was close below it.
    pub(super) is_in_air: bool,
}

/// Voxels that movers are in, or were in a short time ago.
///
/// A scan changes nothing before it is accepted: it may be refused or stopped after this search.
#[derive(Default)]
pub(super) struct EnteredVoxels {
    stays: Stays,
    /// What follows the stays after the scan.
    next: Stays,
    /// Voxels that movers were in one scan before, and are not in any more.
    left: Vec<Voxel>,
    /// Stamps of the scan and of the scan before [ns].
    now_ns: i64,
    newest_ns: Option<i64>,
}

impl EnteredVoxels {
    /// Begin a scan at a time [ns]. What is forgotten and is not known to move goes to `arrivals`: it came into view,
    /// and may stand there.
    pub(super) fn begin(&mut self, stamp_ns: i64, arrivals: &mut ArrivedVoxels) {
        self.skip();
        (self.now_ns, self.newest_ns) = (stamp_ns, arrivals.newest_ns());
        for (&place, &stay) in &self.stays {
            if stay.is_remembered(stamp_ns) {
                self.next.insert(place, stay);
            } else if !stay.moves && !stay.is_in_air {
                arrivals.add_doubtful(place.0);
            }
        }
    }

    /// Find the voxels that movers have left, given the voxels with returns (ascending). Those beside a mover that is
    /// still there do not count: what appears near it does not come from there.
    pub(super) fn look(&mut self, voxels: &[Voxel]) {
        let is_hit = |voxel: Voxel| voxels.binary_search(&voxel).is_ok();
        let were_there = self.next.iter().filter(|(_, stay)| Some(stay.last_ns) == self.newest_ns);
        let is_left = |&voxel: &Voxel| {
            !is_hit(voxel) && !around(voxel).any(|beside| self.contains(beside) && is_hit(beside))
        };
        let left: Vec<Voxel> = were_there.map(|(place, _)| place.0).filter(is_left).collect();
        self.left = left;
    }

    /// True if a mover is in the voxel, or was in it a short time ago.
    pub(super) fn contains(&self, voxel: Voxel) -> bool {
        self.next.contains_key(&Place(voxel))
    }

    /// True if something that is not known to move had no return from the voxel in the scan before.
    pub(super) fn has_come_back(&self, voxel: Voxel) -> bool {
        let is_back = |stay: &Stay| Some(stay.last_ns) < self.newest_ns;
        let stay = self.next.get(&Place(voxel));
        stay.is_some_and(|stay| !stay.moves && !stay.is_in_air && is_back(stay))
    }

    /// Forget a voxel because what is in it stands.
    pub(super) fn remove(&mut self, voxel: Voxel) {
        self.next.remove(&Place(voxel));
    }

    /// Take the moving parts of the scan. `arrivals`: what has come, from which their voxels are removed. `size`: edge
    /// of a voxel [m].
    pub(super) fn enter(&mut self, parts: &[MovingPart], arrivals: &mut ArrivedVoxels, size: f64) {
        let come_from = |part: &MovingPart| self.come_from(&part.voxels, arrivals, size);
        let from: Vec<Option<Vec<Voxel>>> = parts.iter().map(come_from).collect();
        for part in parts {
            for place in part.voxels.iter().map(|&voxel| Place(voxel)) {
                arrivals.remove(place);
                let stay = self.next.entry(place).or_insert_with(|| Stay::new(self.now_ns));
                (stay.last_ns, stay.is_in_air) = (self.now_ns, part.is_in_air);
            }
        }
        for (part, from) in parts.iter().zip(from) {
            let Some(from) = from else { continue };
            // Beside it are also voxels that it was in before it was known to move.
            let beside = part.voxels.iter().flat_map(|&own| around(own).chain([own]));
            for voxel in beside.chain(from) {
                if let Some(stay) = self.next.get_mut(&Place(voxel)) {
                    stay.moves = true;
                }
            }
        }
    }

    /// The voxels that what is in the voxels `own` has left, if it came from beside. They are empty if it came voxel by
    /// voxel. None if it did not come from beside.
    fn come_from(&self, own: &[Voxel], arrivals: &ArrivedVoxels, size: f64) -> Option<Vec<Voxel>> {
        let first_ns = |voxel: Voxel| {
            let entered = self.next.get(&Place(voxel)).map(|stay| stay.first_ns);
            entered.or_else(|| arrivals.first_ns(voxel)).unwrap_or(self.now_ns)
        };
        let firsts: Vec<(Voxel, i64)> = own.iter().map(|&voxel| (voxel, first_ns(voxel))).collect();
        if firsts.iter().any(|(_, first)| *first < self.now_ns) {
            return came_from_beside(&firsts).then(Vec::new);
        }
        let since = self.newest_ns.map_or(0, |newest| self.now_ns.saturating_sub(newest));
        let reach = (FASTEST * since as f64 * 1e-9 + SIZE) / size;
        // Its box, because pairs of voxels would take long in scans where much moves.
        let spans = [0, 1].map(|axis: usize| {
            let ends = own.iter().map(|voxel| f64::from(voxel[axis]));
            ends.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| {
                [low.min(at), high.max(at)]
            })
        });
        let is_near = |one: &&Voxel| {
            spans
                .iter()
                .zip(*one)
                .all(|([low, high], &at)| (low - reach..=high + reach).contains(&f64::from(at)))
        };
        let near: Vec<Voxel> = self.left.iter().filter(is_near).copied().collect();
        (!near.is_empty()).then_some(near)
    }

    /// Voxels, ascending, of objects that moved in the air in the newest accepted scan with such objects.
    pub(super) fn newest_in_air(&self) -> Vec<Voxel> {
        let in_air = self.stays.iter().filter(|(_, stay)| stay.is_in_air);
        let newest = in_air.clone().map(|(_, stay)| stay.last_ns).max();
        let newest = in_air.filter(|(_, stay)| Some(stay.last_ns) == newest);
        let mut voxels: Vec<Voxel> = newest.map(|(place, _)| place.0).collect();
        voxels.sort_unstable();
        voxels
    }

    /// Store what the scan has shown. Without it, the scan has no effect.
    pub(super) fn accept(&mut self) {
        std::mem::swap(&mut self.stays, &mut self.next);
    }

    /// Leave the scan without effect.
    pub(super) fn skip(&mut self) {
        self.next.clear();
        self.left.clear();
    }

    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// The stays to save, in ascending order of voxels.
    pub(super) fn saved(&self) -> Vec<(Place, Stay)> {
        saved_stays(&self.stays)
    }

    /// The entered voxels of a saved state.
    ///
    /// # Errors
    /// [`Error::Format`] for stays in voxels that do not exist.
    pub(super) fn restored(saved: Vec<(Place, Stay)>) -> Result<Self, Error> {
        Ok(Self { stays: restored_stays(saved)?, ..Self::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCAN: i64 = 100_000_000;
    const POST: Voxel = [-5, 0, 0];

    /// Search for what moves in scans, each given by its connected parts. Returns the state after them.
    fn after(scans: &[&[Voxel]]) -> EnteredVoxels {
        let (mut entered, mut arrivals) = (EnteredVoxels::default(), ArrivedVoxels::default());
        for (scan, number) in scans.iter().zip(0..) {
            arrivals.begin(number * SCAN);
            entered.begin(number * SCAN, &mut arrivals);
            let mut voxels = scan.to_vec();
            voxels.sort_unstable();
            entered.look(&voxels);
            let part = |&voxel: &Voxel| MovingPart { voxels: vec![voxel], is_in_air: false };
            let parts: Vec<MovingPart> = scan.iter().map(part).collect();
            entered.enter(&parts, &mut arrivals, 0.25);
            entered.accept();
            arrivals.accept();
        }
        entered
    }

    fn moves(entered: &EnteredVoxels, voxel: Voxel) -> Option<bool> {
        entered.stays.get(&Place(voxel)).map(|stay| stay.moves)
    }

    #[test]
    fn what_leaves_all_its_voxels_came_from_them() {
        let jumps = after(&[&[[0, 0, 0]], &[[4, 0, 0]]]);
        assert_eq!([[0, 0, 0], [4, 0, 0]].map(|at| moves(&jumps, at)), [Some(true); 2]);
        let far = after(&[&[[0, 0, 0]], &[[11, 0, 0]]]); // 2.75 m; 1.5 m a scan and its size are 2.5 m
        assert_eq!([[0, 0, 0], [11, 0, 0]].map(|at| moves(&far, at)), [Some(false); 2]);
    }

    #[test]
    fn what_appears_beside_a_mover_that_is_still_there_did_not_come_from_it() {
        let (one, two, three) = ([0, 0, 0], [1, 0, 0], [2, 0, 0]);
        let near = after(&[&[one], &[one, two], &[two, three, POST]]);
        assert_eq!(moves(&near, POST), Some(false));
        let gone = after(&[&[one], &[one, two], &[POST]]);
        assert_eq!(moves(&gone, POST), Some(true));
    }
}
