//! Removal of occupied voxels that are separate from confidently occupied ones.
//!
//! Source: Vrba et al., sec. III-D, eq. 23. Incremental: a component is looked at only if one of
//! its voxels changed its state, or one beside it ceased to be occupied; the look ends as soon
//! as enough confident voxels are found. Cost follows the changes, not the size of the map.

use super::blocks::{Block, Cursor, EDGE, EDGE_BITS, Place, has, offset_of};
use super::voxel_map::{VoxelMap, filtered, two_to_minus};
use crate::Error;
use crate::geometry::lattice::Voxel;
use std::collections::{HashMap, HashSet};

/// Changes that are kept; above it, as when removal has been given up, all is looked at again.
const MOST_CHANGES: usize = 1 << 22;

/// Voxels whose occupied state changed since the last removal.
#[derive(Clone, Default)]
pub(crate) struct Changes {
    voxels: Vec<Voxel>,
    /// The parameters of the last removal; with others every component is looked at.
    settled_with: Option<Separation>,
    /// A voxel of a component that had enough confident voxels.
    anchor: Option<Voxel>,
}

impl Changes {
    #[inline]
    pub(crate) fn note(&mut self, voxel: Voxel) {
        if self.settled_with.is_none() {
            return; // the next removal looks at everything
        }
        if self.voxels.len() == MOST_CHANGES {
            self.voxels = Vec::new();
            self.settled_with = None;
            return;
        }
        self.voxels.push(voxel);
    }

    /// Forget the history: the next removal looks at every component.
    pub(crate) fn restart(&mut self) {
        *self = Self::default();
    }
}

/// When a group of occupied voxels is separate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separation {
    /// Largest distance between the centres of neighbours in a group, d_sep [m].
    pub max_gap: f64,
    /// A group with fewer confidently occupied voxels is removed, n_conf,min.
    pub min_confident: usize,
}

impl VoxelMap {
    /// Pull every voxel of a group of at least tentatively occupied voxels that holds fewer
    /// than `min_confident` confident ones once towards free. Returns the voxels changed.
    ///
    /// # Errors
    /// [`Error::Parameter`] if `max_gap` is not a distance of 0 to 64 voxels.
    ///
    /// # Source
    /// Vrba et al., sec. III-D, eq. 23.
    pub fn remove_separate(&mut self, separation: Separation) -> Result<usize, Error> {
        let neighbours = Neighbours::within(separation.max_gap / self.lattice().voxel_size())?;
        let candidates = self.candidates(separation, &neighbours);
        let mut search = Search {
            cursor: Cursor::new(&self.blocks),
            neighbours: &neighbours,
            min_confident: separation.min_confident,
            seen: HashMap::new(),
        };
        let mut separate = Vec::new();
        let mut anchor = None;
        for &voxel in &candidates {
            if let Some(members) = search.component(voxel) {
                separate.extend(members);
            } else if anchor.is_none() {
                anchor = Some(voxel);
            }
        }
        // Only now: a group that ceased to be anchored is found, and returned, from a candidate.
        let known = self.changes.anchor.filter(|&voxel| search.is_anchored(voxel));
        anchor = known.or(anchor);
        self.changes = Changes { voxels: Vec::new(), settled_with: Some(separation), anchor };
        let (g_free, keep) = (self.parameters().g_free, two_to_minus(1.0));
        let removable: Vec<Voxel> = {
            let mut cursor = Cursor::new(&self.blocks);
            separate.retain(|&voxel| cursor.stored(voxel).is_finite()); // permanent ones stay
            separate
        };
        for &voxel in &removable {
            self.rewrite(voxel, |value| filtered(value, g_free, keep));
            self.changes.note(voxel); // what is left of the group is looked at again
        }
        Ok(removable.len())
    }

    /// Whether some group of occupied voxels holds enough confident ones, as of the last
    /// removal: without that, "separate" has no meaning.
    #[must_use]
    pub fn has_background(&self) -> bool {
        self.changes.anchor.is_some()
    }

    /// Occupied voxels from which every component that may have changed can be reached.
    fn candidates(&self, separation: Separation, neighbours: &Neighbours) -> Vec<Voxel> {
        if self.changes.settled_with != Some(separation) {
            return self.occupied_voxels();
        }
        let mut cursor = Cursor::new(&self.blocks);
        let mut changed = self.changes.voxels.clone();
        changed.sort_unstable();
        changed.dedup();
        let mut candidates = Vec::new();
        for voxel in changed {
            if cursor.is_tentative(voxel) {
                candidates.push(voxel);
            } else {
                neighbours.each_tentative(&mut cursor, voxel, |beside| candidates.push(beside));
            }
        }
        candidates.sort_unstable();
        candidates.dedup();
        candidates
    }

    /// Every voxel that is at least tentatively occupied, in a fixed order.
    #[must_use]
    pub fn occupied_voxels(&self) -> Vec<Voxel> {
        let mut voxels = Vec::new();
        for block in self.blocks.iter().filter(|block| block.tentative != [0; 8]) {
            for offset in (0..super::blocks::VOLUME).filter(|&offset| has(&block.tentative, offset))
            {
                voxels.push(block.place.voxel(offset));
            }
        }
        voxels.sort_unstable();
        voxels
    }
}

/// Rows of neighbours: for every (dy, dz) how far the reach goes along x, in voxels.
pub(crate) struct Neighbours {
    rows: Vec<(i32, i32, i32)>,
}

impl Neighbours {
    /// Neighbours whose centre is at most `reach` voxels away; exactly this distance counts.
    ///
    /// # Errors
    /// [`Error::Parameter`] unless 0 <= reach <= 64.
    pub(crate) fn within(reach: f64) -> Result<Self, Error> {
        const MOST: f64 = 64.0;
        if !(0.0..=MOST).contains(&reach) {
            return Err(Error::Parameter {
                name: "max_gap",
                expected: "a distance of 0 to 64 voxels",
                got: format!("{reach} voxels"),
            });
        }
        let square = (reach * (1.0 + 1e-12)).powi(2); // 0.75 / 0.25 and the like stay inside
        let most = reach.ceil() as i32;
        let mut rows = Vec::new();
        for dz in -most..=most {
            for dy in -most..=most {
                let rest = square - f64::from(dy * dy + dz * dz);
                if rest >= 0.0 {
                    rows.push((dy, dz, rest.sqrt().floor() as i32));
                }
            }
        }
        Ok(Self { rows })
    }

    /// Visit every tentatively occupied voxel around `voxel` (and `voxel` itself).
    fn each_tentative(&self, cursor: &mut Cursor<'_>, voxel: Voxel, mut visit: impl FnMut(Voxel)) {
        for &(dy, dz, reach) in &self.rows {
            let (y, z) = (voxel[1] + dy, voxel[2] + dz);
            let (mut x, end) = (voxel[0] - reach, voxel[0] + reach);
            while x <= end {
                let wall = ((x >> EDGE_BITS) + 1) * EDGE;
                if let Some(block) = cursor.block(Place::of([x, y, z])) {
                    let row = row_bits(block, [x, y, z]);
                    for beside in
                        (x..wall.min(end + 1)).filter(|beside| row >> (beside & 7) & 1 == 1)
                    {
                        visit([beside, y, z]);
                    }
                }
                x = wall;
            }
        }
    }
}

/// Tentative bits of the row of x that holds `voxel`.
pub(crate) fn row_bits(block: &Block, voxel: Voxel) -> u8 {
    let offset = offset_of(voxel);
    (block.tentative[offset >> 6] >> (offset & 0b11_1000)) as u8
}

#[derive(Clone, Copy, PartialEq)]
enum Verdict {
    Anchored,
    Separate,
}

/// Breadth-first searches of one removal; what one search learns, the others use.
struct Search<'a> {
    cursor: Cursor<'a>,
    neighbours: &'a Neighbours,
    min_confident: usize,
    seen: HashMap<Voxel, Verdict>,
}

impl Search<'_> {
    fn is_anchored(&mut self, voxel: Voxel) -> bool {
        self.cursor.is_tentative(voxel) && self.component(voxel).is_none()
    }

    /// All members of the separate component of `voxel`; None if it is anchored or was
    /// returned before.
    fn component(&mut self, start: Voxel) -> Option<Vec<Voxel>> {
        if let Some(verdict) = self.seen.get(&start) {
            return (*verdict == Verdict::Separate).then(Vec::new);
        }
        let mut members = vec![start];
        let mut inside = HashSet::from([start]);
        let mut confident = 0;
        let mut next = 0;
        let mut verdict = Verdict::Separate;
        let (seen, neighbours) = (&self.seen, self.neighbours);
        while next < members.len() && verdict == Verdict::Separate {
            let voxel = members[next];
            next += 1;
            let block = self.cursor.block(Place::of(voxel));
            confident +=
                usize::from(block.is_some_and(|block| has(&block.confident, offset_of(voxel))));
            if confident >= self.min_confident {
                verdict = Verdict::Anchored;
            }
            neighbours.each_tentative(&mut self.cursor, voxel, |beside| {
                if seen.get(&beside) == Some(&Verdict::Anchored) {
                    verdict = Verdict::Anchored;
                } else if inside.insert(beside) {
                    members.push(beside);
                }
            });
        }
        self.seen.extend(members.iter().map(|&member| (member, verdict)));
        (verdict == Verdict::Separate).then_some(members)
    }
}
