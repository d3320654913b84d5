//! Space that scans have shown to be free.

use crate::flying::map::blocks::Cursor;
use crate::flying::map::voxel_map::VoxelMap;
use crate::geometry::lattice::Voxel;

/// Length of rays in a voxel, in voxel edges, from which on the voxel is certainly free.
const SURE_EDGES: f32 = 8.0;

/// Free voxels of a map.
pub(super) struct FreeSpace<'a> {
    map: &'a VoxelMap,
    cursor: Cursor<'a>,
    /// Voxels with values up to this one are certainly free.
    sure: f32,
}

impl<'a> FreeSpace<'a> {
    pub(super) fn of(map: &'a VoxelMap) -> Self {
        let parameters = map.parameters();
        let (free, initial) = (parameters.g_free, parameters.initial);
        let sure = free + (initial - free) * libm::exp2f(-SURE_EDGES);
        Self { map, cursor: Cursor::new(&map.blocks), sure }
    }

    pub(super) fn is_free(&mut self, voxel: Voxel) -> bool {
        self.map.known(self.cursor.stored(voxel)) < self.map.uncertain_from()
    }

    /// True if many rays have passed through a voxel since its last return.
    pub(super) fn is_certain(&mut self, voxel: Voxel) -> bool {
        self.map.known(self.cursor.stored(voxel)) <= self.sure
    }

    /// True if a voxel is certainly free and all its neighbours are free, or `also` is true for
    /// them. Such a voxel is not beside a surface, which rays along the surface may have made free.
    /// Uncertain neighbours for which `hides` is true do not count: the thing in the voxel hides
    /// them, so no ray can make them free while it is there.
    pub(super) fn is_open(
        &mut self,
        voxel: Voxel,
        also: impl Fn(Voxel) -> bool,
        hides: impl Fn(Voxel) -> bool,
    ) -> bool {
        (self.is_certain(voxel) || also(voxel))
            && around(voxel).all(|voxel| {
                also(voxel)
                    || self.is_free(voxel)
                    || !self.cursor.is_tentative(voxel) && hides(voxel)
            })
    }
}

/// The 26 neighbours of a voxel, which share a face, an edge or a corner with it.
pub(super) fn around([x, y, z]: Voxel) -> impl Iterator<Item = Voxel> {
    let offset = |place: i32| [place % 3 - 1, place / 3 % 3 - 1, place / 9 - 1];
    let beside = move |[dx, dy, dz]: Voxel| {
        [x.saturating_add(dx), y.saturating_add(dy), z.saturating_add(dz)]
    };
    (0..27).filter(|&place| place != 13).map(offset).map(beside)
}

/// For each of the voxels `of` (ascending): whether it belongs to a connected part of at least
/// `fewest` voxels that are `open`, or is beside such a part.
///
/// Only direct neighbours count as beside, since free space along the ground is connected
/// everywhere.
pub(super) fn with_beside(of: &[Voxel], open: &[bool], fewest: usize) -> Vec<bool> {
    let core: Vec<Voxel> =
        of.iter().zip(open).filter(|(_, open)| **open).map(|(v, _)| *v).collect();
    let mut is_chosen = vec![false; of.len()];
    for part in parts(&core).into_iter().filter(|part| part.len() >= fewest) {
        for voxel in part.into_iter().map(|at| core[at]) {
            for beside in around(voxel).chain([voxel]) {
                if let Ok(at) = of.binary_search(&beside) {
                    is_chosen[at] = true;
                }
            }
        }
    }
    is_chosen
}

/// Connected parts of the voxels `of` (ascending). Each part is a list of indices into `of`.
pub(super) fn parts(of: &[Voxel]) -> Vec<Vec<usize>> {
    let mut is_met = vec![false; of.len()];
    let mut parts = Vec::new();
    for start in 0..of.len() {
        if std::mem::replace(&mut is_met[start], true) {
            continue;
        }
        let mut part = vec![start];
        let mut looked = 0;
        while looked < part.len() {
            for voxel in around(of[part[looked]]) {
                if let Ok(other) = of.binary_search(&voxel)
                    && !std::mem::replace(&mut is_met[other], true)
                {
                    part.push(other);
                }
            }
            looked += 1;
        }
        part.sort_unstable();
        parts.push(part);
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::flying::map::parameters::tests::parameters;

    #[test]
    fn space_is_open_where_nothing_is_beside() -> Result<(), Error> {
        let mut map = VoxelMap::new(parameters())?;
        let center = |voxel| map.lattice().center(voxel).map(|value: f64| value as f32);
        let block: Vec<[f32; 3]> =
            (0..343).map(|at| center([at % 7 - 3, at / 7 % 7 - 3, at / 49 - 3])).collect();
        let wall = [center([-3, 0, 0])];
        map.pull(&block, -1000.0, 20.0)?;
        map.set_occupied(&wall)?;
        let mut space = FreeSpace::of(&map);
        let nowhere = |_| false;
        let mut is_open = |voxel| space.is_open(voxel, nowhere, nowhere);
        assert!(is_open([0, 0, 0]) && is_open([2, 2, 2]));
        assert!(!is_open([-2, 0, 0])); // beside the wall
        assert!(!is_open([3, 0, 0])); // and beside the unseen
        assert!(space.is_free([-2, 0, 0]) && space.is_free([3, 0, 0]));
        assert!(space.is_open([-2, 0, 0], |voxel| voxel == [-3, 0, 0], nowhere));
        // What hides the unseen keeps it from being free, but the wall is known.
        assert!(space.is_open([3, 0, 0], nowhere, |voxel| voxel[0] == 4));
        assert!(!space.is_open([3, 0, 0], nowhere, |voxel| voxel == [4, 0, 0]));
        assert!(!space.is_open([-2, 0, 0], nowhere, |_| true));
        let mut map = VoxelMap::new(parameters())?;
        map.pull(&block, -1000.0, 6.0)?; // a few rays
        let mut space = FreeSpace::of(&map);
        assert!(space.is_free([0, 0, 0]) && !space.is_open([0, 0, 0], nowhere, |_| true));
        Ok(())
    }

    #[test]
    fn only_what_is_beside_open_parts_is_chosen() {
        let row: Vec<Voxel> = (0..8).map(|x| [x, 0, 0]).collect();
        let open = [false, true, true, false, false, false, true, false];
        let chosen = |fewest| with_beside(&row, &open, fewest);
        assert_eq!(chosen(2), [true, true, true, true, false, false, false, false]);
        assert_eq!(chosen(1), [true, true, true, true, false, true, true, true]);
        assert_eq!(chosen(3), [false; 8]);
    }

    #[test]
    fn parts_hang_together_by_corners() {
        let voxels = [[-1, 0, 0], [0, 1, 1], [0, 3, 1], [5, 0, 0]];
        assert_eq!(parts(&voxels), [vec![0, 1], vec![2], vec![3]]);
        assert!(parts(&[]).is_empty());
    }
}
