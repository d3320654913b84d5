//! Points of what moves on the ground, such as people and cars.
//!
//! The search for flying objects takes it for background or for unknown. But it is where space was free
//! before, and something stands close below it. What it enters is remembered, so that it stays a mover
//! while it stands for a moment.

use super::free_space::{FreeSpace, parts, with_beside};
use crate::flying::map::blocks::{Cursor, Place};
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::PointClass;
use crate::geometry::lattice::{Voxel, floor, wide};
use crate::util::key_hasher::KeyHasher;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// What stands for longer where it has moved to is background [s].
const STANDS: f64 = 10.0;
/// A mover that was not seen for so long may be seen again [s].
const HIDDEN: f64 = 2.0;
/// A mover has so many points, in so many voxels that are not beside anything else.
const FEWEST_POINTS: usize = 8;
const FEWEST_OPEN: usize = 2;
/// Something occupied is at most this far below a mover on the ground [m].
const ABOVE_GROUND: f64 = 0.75;

/// When something was in a voxel that had been free [ns].
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Stay {
    first_ns: i64,
    last_ns: i64,
}

impl Stay {
    fn is_remembered(self, now_ns: i64) -> bool {
        let within = |since_ns: i64, time: f64| {
            (i128::from(now_ns) - i128::from(since_ns)) as f64 * 1e-9 <= time
        };
        within(self.last_ns, HIDDEN) && within(self.first_ns, STANDS)
    }
}

/// True if something at most so many voxels below one is occupied, straight below or beside that, or
/// if nothing of what is below was ever seen, as where the field of view ends.
fn is_close_above(cursor: &mut Cursor<'_>, [x, y, z]: Voxel, steps: i32) -> bool {
    let below =
        |down: i32, place: i32| [x + place % 3 - 1, y + place / 3 - 1, z.saturating_sub(down)];
    let mut is_occupied = |down: i32| (0..9).any(|place| cursor.is_tentative(below(down, place)));
    (1..=steps).any(&mut is_occupied)
        || (1..=steps).all(|down| cursor.stored(below(down, 4)).is_nan())
}

/// Stage that finds the points of movers in one scan after another.
#[derive(Default)]
pub(crate) struct GroundMovers {
    entered: HashMap<Place, Stay, BuildHasherDefault<KeyHasher>>,
    /// Rows of the points of movers in the newest scan.
    rows: Vec<u32>,
}

impl GroundMovers {
    /// Find the movers among the points that are not known to fly, on the map before the scan.
    pub(crate) fn find(
        &mut self,
        points: &[[f32; 3]],
        class: &[PointClass],
        map: &VoxelMap,
        stamp_ns: i64,
    ) {
        self.rows.clear();
        self.entered.retain(|_, stay| stay.is_remembered(stamp_ns));
        let mut space = FreeSpace::of(map);
        let mut cursor = Cursor::new(&map.blocks);
        let steps = (ABOVE_GROUND / map.lattice().voxel_size()).ceil() as i32;
        let (voxels, rows) = self.in_free_space(points, class, map, &mut space);
        let is_entered = |voxel: Voxel| self.entered.contains_key(&Place(voxel));
        let open: Vec<bool> =
            voxels.iter().map(|&voxel| space.is_open(voxel, is_entered)).collect();
        let chosen = with_beside(&voxels, &open, FEWEST_OPEN);
        let movers: Vec<usize> = (0..voxels.len()).filter(|&at| chosen[at]).collect();
        let places: Vec<Voxel> = movers.iter().map(|&at| voxels[at]).collect();
        for part in parts(&places) {
            let n_points: usize = part.iter().map(|&at| rows[movers[at]].len()).sum();
            let mut is_on = |&at: &usize| is_close_above(&mut cursor, places[at], steps);
            if n_points < FEWEST_POINTS || !part.iter().any(&mut is_on) {
                continue;
            }
            for at in part {
                self.rows.extend(&rows[movers[at]]);
                let fresh = Stay { first_ns: stamp_ns, last_ns: stamp_ns };
                let stay = self.entered.entry(Place(places[at])).or_insert(fresh);
                stay.last_ns = stamp_ns;
            }
        }
    }

    /// Voxels with points that are not known to fly and that are free, or were before something entered them, in
    /// ascending order, and the rows of the points in each.
    fn in_free_space(
        &self,
        points: &[[f32; 3]],
        class: &[PointClass],
        map: &VoxelMap,
        space: &mut FreeSpace<'_>,
    ) -> (Vec<Voxel>, Vec<Vec<u32>>) {
        let lattice = map.lattice();
        let mut found: Vec<(Voxel, u32)> = Vec::new();
        // Points beside each other in a scan are mostly in one voxel.
        let mut last: Option<(Voxel, bool)> = None;
        for (row, (&point, _)) in (0..)
            .zip(points.iter().zip(class))
            .filter(|(_, (_, class))| matches!(class, PointClass::Background | PointClass::Unknown))
        {
            let Some(voxel) = floor(lattice.scaled(wide(point))) else { continue };
            let is_chosen = match last {
                Some((known, is_chosen)) if known == voxel => is_chosen,
                _ => space.is_free(voxel) || self.entered.contains_key(&Place(voxel)),
            };
            last = Some((voxel, is_chosen));
            if is_chosen {
                found.push((voxel, row));
            }
        }
        found.sort_unstable();
        let (mut voxels, mut rows): (Vec<Voxel>, Vec<Vec<u32>>) = Default::default();
        for (voxel, row) in found {
            if voxels.last() != Some(&voxel) {
                voxels.push(voxel);
                rows.push(Vec::new());
            }
            rows.last_mut().into_iter().for_each(|rows| rows.push(row));
        }
        (voxels, rows)
    }

    /// Add the points of something that a track of a ground mover follows.
    pub(crate) fn add(&mut self, rows: &[u32]) {
        self.rows.extend(rows);
    }

    /// Rows of the points of movers in the newest scan.
    pub(crate) fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// The newest scan is not used.
    pub(crate) fn skip(&mut self) {
        self.rows.clear();
    }

    /// Forget everything.
    pub(crate) fn clear(&mut self) {
        self.rows.clear();
        self.entered.clear();
    }

    /// State that goes on to the same bits, in ascending order of voxels.
    pub(crate) fn saved(&self) -> Vec<(Place, Stay)> {
        let mut saved: Vec<_> = self.entered.iter().map(|(&place, &stay)| (place, stay)).collect();
        saved.sort_unstable_by_key(|(place, _)| *place);
        saved
    }

    /// From a saved state.
    pub(crate) fn restored(saved: Vec<(Place, Stay)>) -> Self {
        Self { entered: saved.into_iter().collect(), rows: Vec::new() }
    }
}
