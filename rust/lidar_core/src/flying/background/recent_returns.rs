//! Places that held returns in the last seconds and have not been seen through since.
//!
//! The map says what is free now, not why: rays without return may have cleared a dark car, and the
//! removal of separate voxels clears every small thing. What comes back where something was a moment
//! ago is most likely the same thing, not one that flies there. A place loses its memory when it is
//! seen through: all returns in its direction lie behind it, or nothing but open sky.

use crate::flying::classify::clusters::{Cluster, Clusters};
use crate::flying::classify::flood::neighbours;
use crate::flying::map::blocks::{Place, VOLUME, offset_of};
use crate::flying::scan::prepared::Prepared;
use crate::flying::sky::{CELLS, GRID};
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};
use crate::geometry::transform::{minus, norm};
use crate::util::key_hasher::Spread;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Returns are counted together for this time [ns]; sixteen times that is remembered.
const STEP_NS: i64 = 250_000_000;
/// What arrives leaves returns in the newest steps too, for half a second at least.
const OLD: u16 = !0b111;
/// The newest of the old steps, as many as show that something stays.
const NEWEST_OLD: u16 = 0b11000;
const STAYING: u32 = NEWEST_OLD.count_ones();
/// A place is seen through where all returns in its direction are further away by this [m].
const BEHIND: f64 = 0.5;
/// Rays of a cell of directions that are enough to see through it.
const ENOUGH_RAYS: u32 = 3;
/// Rays of sky that end at this share of the range of rays are limited by nothing.
const UNLIMITED: f32 = 0.95;
/// An object is new if this share of its points is where nothing was.
const NEW_SHARE: f64 = 0.5;

/// What a cluster tells of its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// Something is there that does not fly, or nobody knows.
    Stays,
    /// A flying object where nothing was: it will leave the place again.
    Arrives,
    /// It seems to fly where something was: that is remembered on.
    Returns,
}

/// A voxel and those that share a face with it.
fn around(voxel: Voxel) -> impl Iterator<Item = Voxel> {
    std::iter::once(voxel).chain(neighbours(voxel))
}

/// Stage that remembers where returns were.
#[derive(Clone, Default)]
pub(crate) struct RecentReturns {
    blocks: HashMap<Place, BlockSteps, BuildHasherDefault<Spread>>,
    /// Range of the nearest return in every cell of directions [m], and number of rays in it.
    nearest: Vec<f32>,
    rays: Vec<u32>,
}

/// Steps of time in which the voxels of a block held returns.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct BlockSteps {
    /// The newest step, that of the lowest bit.
    step: i64,
    /// A bit for every step, by voxel.
    steps: Vec<u16>,
}

impl BlockSteps {
    fn new(step: i64) -> Self {
        Self { step, steps: vec![0; VOLUME] }
    }

    /// Make `step` the newest one. Scans of other sensors may come late: they count as new.
    fn advance(&mut self, step: i64) {
        let older = step.saturating_sub(self.step);
        if older <= 0 {
            return;
        }
        self.steps.iter_mut().for_each(|steps| *steps = shifted(*steps, older));
        self.step = step;
    }
}

fn shifted(steps: u16, older: i64) -> u16 {
    u32::try_from(older.max(0)).ok().and_then(|older| steps.checked_shl(older)).unwrap_or(0)
}

/// True if returns came in several old steps: what passes by leaves them in one.
fn stays(steps: u16) -> bool {
    (steps & OLD).count_ones() >= STAYING
}

impl RecentReturns {
    /// True if most points of a cluster are where nothing returned half a second ago and before.
    pub(crate) fn is_new(
        &self,
        cluster: &Cluster<'_>,
        scan: &Prepared,
        lattice: &Lattice,
        stamp_ns: i64,
    ) -> bool {
        let step = stamp_ns.div_euclid(STEP_NS);
        let is_old = |row: &&u32| {
            let voxel = floor(lattice.scaled(wide(scan.points[**row as usize])));
            voxel.is_some_and(|voxel| self.held_around(voxel, step))
        };
        let old = cluster.members.iter().filter(is_old).count();
        (old as f64) <= (1.0 - NEW_SHARE) * cluster.members.len() as f64
    }

    /// True if a voxel or one beside it held returns some time ago.
    fn held_around(&self, voxel: Voxel, step: i64) -> bool {
        around(voxel).any(|voxel| {
            let block = self.blocks.get(&Place::of(voxel));
            block.is_some_and(|block| {
                let older = step.saturating_sub(block.step);
                stays(shifted(block.steps[offset_of(voxel)], older))
            })
        })
    }

    /// Forget what a scan saw through, and remember its returns up to `reach` [m], by the role of the
    /// cluster that they belong to.
    pub(crate) fn take(
        &mut self,
        scan: &Prepared,
        clusters: &Clusters,
        lattice: &Lattice,
        stamp_ns: i64,
        reach: f64,
        role: impl Fn(usize) -> Role,
    ) {
        self.look(scan, reach);
        let (origin, step) = (scan.pose.translation, stamp_ns.div_euclid(STEP_NS));
        let Self { blocks, nearest, rays } = self;
        let is_seen_through = |voxel: Voxel| {
            let offset = minus(lattice.center(voxel), origin);
            let cell = GRID.cell(offset);
            rays[cell] >= ENOUGH_RAYS && f64::from(nearest[cell]) > norm(offset) + BEHIND
        };
        blocks.retain(|place, block| {
            block.advance(step);
            for (offset, steps) in block.steps.iter_mut().enumerate().filter(|(_, held)| **held > 0)
            {
                if is_seen_through(place.voxel(offset)) {
                    *steps = 0;
                }
            }
            block.steps.iter().any(|&steps| steps != 0)
        });
        for (index, cluster) in clusters.iter().enumerate() {
            let role = role(index);
            for &row in cluster.members {
                let point = wide(scan.points[row as usize]);
                let Some(voxel) = floor(lattice.scaled(point)) else { continue };
                if norm(minus(point, origin)) > reach {
                    continue;
                }
                match role {
                    Role::Arrives => {}
                    Role::Stays => {
                        let block = blocks.entry(Place::of(voxel));
                        let block = block.or_insert_with(|| BlockSteps::new(step));
                        block.steps[offset_of(voxel)] |= 1;
                    }
                    Role::Returns => around(voxel).for_each(|voxel| {
                        let held = blocks.get_mut(&Place::of(voxel));
                        let held = held.map(|block| &mut block.steps[offset_of(voxel)]);
                        if let Some(held) = held.filter(|held| stays(**held)) {
                            *held |= NEWEST_OLD;
                        }
                    }),
                }
            }
        }
    }

    /// Find the nearest return in every direction. Rays that met nothing see through all, if they
    /// were given or nothing limits them.
    fn look(&mut self, scan: &Prepared, reach: f64) {
        let Self { nearest, rays, .. } = self;
        nearest.clear();
        nearest.resize(CELLS, f32::INFINITY);
        rays.clear();
        rays.resize(CELLS, 0);
        let origin = scan.pose.translation;
        for &point in &scan.points {
            let offset = minus(wide(point), origin);
            let range = norm(offset) as f32;
            if range.is_finite() {
                let cell = GRID.cell(offset);
                nearest[cell] = nearest[cell].min(range);
                rays[cell] += 1;
            }
        }
        let Some(directions) = &scan.directions else { return };
        let is_unlimited = |row: usize| {
            let free = scan.reach.as_ref().map_or(f32::INFINITY, |reach| reach[row]);
            free >= UNLIMITED * reach as f32
        };
        for (row, &direction) in directions.iter().enumerate() {
            if scan.no_return[row] && is_unlimited(row) {
                rays[GRID.cell(wide(direction))] += 1;
            }
        }
    }

    /// Forget all.
    pub(crate) fn clear(&mut self) {
        self.blocks = HashMap::default();
    }

    /// State that goes on to the same bits, in ascending order of blocks.
    pub(crate) fn saved(&self) -> Vec<(Place, BlockSteps)> {
        let mut saved: Vec<_> =
            self.blocks.iter().map(|(&place, block)| (place, block.clone())).collect();
        saved.sort_unstable_by_key(|(place, _)| *place);
        saved
    }

    /// Memory from a saved state.
    ///
    /// # Errors
    /// [`Error::Format`](crate::Error::Format) for blocks that cannot be.
    pub(crate) fn restored(saved: Vec<(Place, BlockSteps)>) -> Result<Self, crate::Error> {
        if saved.iter().any(|(_, block)| block.steps.len() != VOLUME) {
            return Err(crate::util::full_state::impossible("recent returns of half a block"));
        }
        Ok(Self { blocks: saved.into_iter().collect(), ..Self::default() })
    }
}
