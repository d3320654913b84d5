//! Algorithm 1: whether free voxels surround a cluster.

use super::shadow::Shadow;
use crate::Error;
use crate::error::require;
use crate::flying::map::blocks::Cursor;
use crate::flying::map::voxel_map::VoxelMap;
use crate::geometry::lattice::{Voxel, wide};
use crate::util::cancel::{self, Watch};

impl VoxelMap {
    /// True if free voxels surround a cluster of points [m, frame of the map] (Algorithm 1): no
    /// path of uncertain voxels leads from one of its points to a tentatively occupied voxel, or to
    /// a distance of `search_distance` [m] (L1). False without points.
    ///
    /// # Errors
    /// [`Error::PointOutOfRange`] for a point without a voxel, [`Error::Parameter`],
    /// [`Error::Interrupted`].
    pub fn is_floating(&self, points: &[[f32; 3]], search_distance: f64) -> Result<bool, Error> {
        let radius = search_radius(search_distance, self.lattice().voxel_size())?;
        let mut starts = Vec::new();
        for &point in points {
            starts.push(self.lattice().voxel_at(wide(point))?);
        }
        let mut memory = Memory::default();
        let mut flood = Flood::new(self, radius, true, false, &mut memory);
        let is_enclosed = flood.is_enclosed(&distinct(starts), None);
        cancel::check()?;
        Ok(is_enclosed)
    }
}

/// Number of steps (L1 distance in voxels) at which a search has found a way out, from
/// `search_distance` [m] (A1:21, `>= d_search`).
pub(crate) fn search_radius(search_distance: f64, voxel_size: f64) -> Result<i32, Error> {
    let steps = check_steps("search_distance", search_distance, voxel_size)?;
    Ok((steps - 1e-9).ceil() as i32)
}

/// Largest search distance [voxels].
const MOST_STEPS: f64 = 128.0;

/// Convert a search distance [m] to voxels and check it. The cost of a search grows with its cube.
pub(crate) fn check_steps(
    name: &'static str,
    distance: f64,
    voxel_size: f64,
) -> Result<f64, Error> {
    let steps = distance / voxel_size;
    let is_reachable = steps > 0.0 && steps <= MOST_STEPS;
    require(is_reachable, name, "0 to 128 voxels", format_args!("{distance} m"))?;
    Ok(steps)
}

/// Search of Algorithm 1 over uncertain voxels. Nodes are marked when they are pushed. The order of
/// the search does not change the result. A search that goes outward first finds a way out sooner
/// than a breadth-first search.
pub(crate) struct Flood<'a> {
    map: &'a VoxelMap,
    cursor: Cursor<'a>,
    /// Number of steps at which a path is a way out.
    radius: i32,
    open_border: bool,
    expand_own: bool,
    memory: &'a mut Memory,
    watch: Watch,
}

/// Working memory of searches.
#[derive(Default)]
pub(crate) struct Memory {
    /// For each voxel of the cube around the start, the number of the last search that has met it.
    met: Vec<u16>,
    search: u16,
    /// Voxels that this search has met but not yet inspected.
    pending: Vec<Voxel>,
    explored: Vec<Voxel>,
}

impl<'a> Flood<'a> {
    pub(crate) fn new(
        map: &'a VoxelMap,
        radius: i32,
        open_border: bool,
        expand_own: bool,
        memory: &'a mut Memory,
    ) -> Self {
        let edge = 2 * radius as usize + 1;
        memory.met.resize(memory.met.len().max(edge * edge * edge), 0);
        let watch = cancel::watch();
        let cursor = Cursor::new(&map.blocks);
        Self { map, cursor, radius, open_border, expand_own, memory, watch }
    }

    /// A search with another distance [m]. The distance is limited to 128 voxels, because the cost
    /// grows with its cube.
    pub(crate) fn wider(
        map: &'a VoxelMap,
        distance: f64,
        open_border: bool,
        expand_own: bool,
        memory: &'a mut Memory,
    ) -> Self {
        let steps = (distance / map.lattice().voxel_size()).min(MOST_STEPS);
        Self::new(map, (steps - 1e-9).ceil() as i32, open_border, expand_own, memory)
    }

    /// True if no search from one of `starts` finds a way out. Voxels in `shadow` are not followed.
    /// The result must not be used if the call was asked to stop.
    pub(crate) fn is_enclosed(&mut self, starts: &[Voxel], shadow: Option<&Shadow<'_>>) -> bool {
        self.memory.explored.clear();
        let mut leads_out =
            |&start: &Voxel| self.watch.is_asked() || self.finds_a_way_out(start, shadow);
        !starts.is_empty() && !starts.iter().any(&mut leads_out)
    }

    /// Remove and return the uncertain voxels that the searches have explored.
    pub(crate) fn take_explored(&mut self) -> Vec<Voxel> {
        distinct(std::mem::take(&mut self.memory.explored))
    }

    fn finds_a_way_out(&mut self, start: Voxel, shadow: Option<&Shadow<'_>>) -> bool {
        self.begin();
        self.push(start, start);
        while let Some(voxel) = self.memory.pending.pop() {
            let stored = self.cursor.stored(voxel);
            let value = self.map.known(stored);
            if value >= self.map.tentative_from() {
                return true; // A1:15
            }
            if value < self.map.uncertain_from() && !(self.expand_own && voxel == start) {
                continue; // free voxels are not expanded, A1:31
            }
            if shadow.is_some_and(|shadow| shadow.hides(voxel)) {
                if !stored.is_nan() {
                    self.memory.explored.push(voxel); // met, though not followed
                }
                continue;
            }
            if steps(voxel, start) >= self.radius {
                return true; // A1:21
            }
            self.memory.explored.push(voxel);
            for beside in outward_last(voxel, start) {
                if self.map.admits(beside) {
                    self.push(beside, start);
                } else if self.open_border {
                    return true;
                }
            }
        }
        false
    }

    fn begin(&mut self) {
        let Memory { met, search, pending, .. } = &mut *self.memory;
        pending.clear();
        *search = search.wrapping_add(1);
        if *search == 0 {
            met.fill(0);
            *search = 1;
        }
    }

    /// Queue a voxel unless this search has met it. It must be at most `radius` steps away from
    /// `start`.
    fn push(&mut self, voxel: Voxel, start: Voxel) {
        let Memory { met, search, pending, .. } = &mut *self.memory;
        let edge = 2 * self.radius + 1;
        let [x, y, z]: [i32; 3] =
            std::array::from_fn(|axis| voxel[axis] - start[axis] + self.radius);
        let met = &mut met[((z * edge + y) * edge + x) as usize];
        if *met != *search {
            *met = *search;
            pending.push(voxel);
        }
    }
}

fn steps(a: Voxel, b: Voxel) -> i32 {
    (0..3).map(|axis| (a[axis] - b[axis]).abs()).sum()
}

pub(crate) fn neighbours([x, y, z]: Voxel) -> [Voxel; 6] {
    [[x - 1, y, z], [x + 1, y, z], [x, y - 1, z], [x, y + 1, z], [x, y, z - 1], [x, y, z + 1]]
}

/// Neighbours of a voxel; those further away from `start` come last.
fn outward_last(voxel: Voxel, start: Voxel) -> [Voxel; 6] {
    let mut ordered = neighbours(voxel);
    for axis in 0..3 {
        if voxel[axis] < start[axis] {
            ordered.swap(2 * axis, 2 * axis + 1); // the last one is further away
        }
    }
    let [a, b, c, d, e, f] = ordered;
    [a, c, e, b, d, f]
}

pub(crate) fn distinct(mut voxels: Vec<Voxel>) -> Vec<Voxel> {
    voxels.sort_unstable();
    voxels.dedup();
    voxels
}
