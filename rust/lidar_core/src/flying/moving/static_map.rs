//! A map of all static points: the points of all scans, except those at places through which rays
//! have passed before or after.

use super::ray_view::RayView;
use crate::Error;
use crate::flying::map::blocks::Place;
use crate::flying::map::parameters::{MapParameters, Rays};
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::{floor, wide};
use crate::util::cancel;
use crate::util::full_state::impossible;
use crate::util::key_hasher::KeyHasher;
use rayon::ThreadPool;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Edge of the cells that keep one point each [m]. No point is further than 5 cm from a point that
/// is kept.
const CELL: f64 = 0.028;
/// Edge of the voxels in which the scans with returns are counted [m]. Saved maps have such voxels.
const VOXEL: f64 = 0.1;
/// Length of rays in a map that is read as a map of the detector [m].
const MAX_RANGE: f64 = 20.0;
/// Number of scans with points at a place, per scan that sees through the place, above which the
/// place counts as static. Thin static objects, such as wires, are hit in most scans, and seen
/// through in some scans.
const HITS_PER_VIEW: u32 = 10;
/// Number of updates after which a voxel is certainly occupied.
const SURE_UPDATES: f64 = 30.0;
/// Largest memory of the views [bytes]. Above it, every second view is removed.
const MOST_BYTES: usize = 256 << 20;
/// Number of cells that a thread takes at a time.
const CELLS_PER_TASK: usize = 4096;

type Keys = BuildHasherDefault<KeyHasher>;

/// Number of scans that had points in a voxel.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct VoxelHits {
    count: u32,
    /// Count of the last such scan; the first scan has the count 1.
    last: u64,
}

/// Collects scans and finds the static points.
#[derive(Default)]
pub(crate) struct StaticMapper {
    views: Vec<RayView>,
    n_scans: u64,
    /// Base-2 logarithm of the number of scans of which one is used for views and counts.
    spacing_log2: u32,
    /// The first point in every cell [m, frame of the map].
    points: HashMap<Place, [f32; 3], Keys>,
    hits: HashMap<Place, VoxelHits, Keys>,
}

/// State of a [`StaticMapper`], for writing, with entries in ascending order.
#[derive(Serialize)]
pub(crate) struct StaticMapperState<'a> {
    views: &'a [RayView],
    n_scans: u64,
    spacing_log2: u32,
    points: Vec<(Place, [f32; 3])>,
    hits: Vec<(Place, VoxelHits)>,
}

/// [`StaticMapperState`], for reading.
#[derive(Deserialize)]
pub(crate) struct SavedStaticMapper {
    views: Vec<RayView>,
    n_scans: u64,
    spacing_log2: u32,
    points: Vec<(Place, [f32; 3])>,
    hits: Vec<(Place, VoxelHits)>,
}

fn place(point: [f32; 3], edge: f64) -> Option<Place> {
    floor(wide(point).map(|value| value / edge)).map(Place)
}

/// The entries of a table in ascending order of their places.
fn sorted<T: Copy>(of: &HashMap<Place, T, Keys>) -> Vec<(Place, T)> {
    let mut sorted: Vec<_> = of.iter().map(|(&place, &value)| (place, value)).collect();
    sorted.sort_unstable_by_key(|(place, _)| *place);
    sorted
}

impl StaticMapper {
    /// Add a scan, which must have been accepted.
    pub(crate) fn take(&mut self, scan: &Prepared) {
        let is_viewed = self.n_scans.trailing_zeros() >= self.spacing_log2;
        self.n_scans += 1;
        for &point in &scan.points {
            let Some(cell) = place(point, CELL) else { continue }; // not finite
            self.points.entry(cell).or_insert(point);
            if let Some(voxel) = place(point, VOXEL).filter(|_| is_viewed) {
                let hits = self.hits.entry(voxel).or_default();
                hits.count += u32::from(hits.last != self.n_scans);
                hits.last = self.n_scans;
            }
        }
        self.views.extend(is_viewed.then(|| RayView::of(scan)).flatten());
        if self.views.iter().map(RayView::size).sum::<usize>() > MOST_BYTES {
            self.thin_out();
        }
    }

    /// Remove every second view, and use half as many scans from now on.
    fn thin_out(&mut self) {
        let mut is_kept = [true, false].into_iter().cycle();
        self.views.retain(|_| is_kept.next().unwrap_or(true));
        self.hits.values_mut().for_each(|hits| hits.count = hits.count.div_ceil(2));
        self.spacing_log2 += 1;
    }

    /// The static points [m, frame of the map], in ascending order of their cells.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(crate) fn points(&self, pool: Option<&ThreadPool>) -> Result<Vec<[f32; 3]>, Error> {
        let cells = sorted(&self.points);
        let watch = cancel::watch();
        let standing = |cells: &[(Place, [f32; 3])]| -> Vec<[f32; 3]> {
            if watch.is_asked() { Vec::new() } else { self.standing(cells) }
        };
        let parts: Vec<Vec<[f32; 3]>> = match pool {
            Some(pool) => pool.install(|| cells.par_chunks(CELLS_PER_TASK).map(standing).collect()),
            None => cells.chunks(CELLS_PER_TASK).map(standing).collect(),
        };
        watch.check()?;
        Ok(parts.concat())
    }

    /// The static points among those of some cells.
    fn standing(&self, cells: &[(Place, [f32; 3])]) -> Vec<[f32; 3]> {
        let hits = |point| place(point, VOXEL).and_then(|voxel| self.hits.get(&voxel));
        let most = |point| hits(point).map_or(0, |hits| hits.count) / HITS_PER_VIEW;
        // View by view, so that one is in the cache for many points.
        let mut open: Vec<(usize, u32)> =
            cells.iter().enumerate().map(|(at, &(_, point))| (at, 1 + most(point))).collect();
        for view in &self.views {
            for (at, left) in &mut open {
                *left -= u32::from(view.sees_through(wide(cells[*at].1)));
            }
            open.retain(|(_, left)| *left > 0);
        }
        open.into_iter().map(|(at, _)| cells[at].1).collect()
    }

    /// A map in the frame of `of` whose occupied voxels are those with static points.
    ///
    /// # Errors
    /// [`Error::Interrupted`]; [`Error::Limit`] if the map would exceed its budget.
    pub(crate) fn cleaned(
        &self,
        of: &MapParameters,
        pool: Option<&ThreadPool>,
    ) -> Result<VoxelMap, Error> {
        let (voxel_size, max_range, rays) = (VOXEL, MAX_RANGE, Rays::OnePerEnd);
        let mut map = VoxelMap::new(MapParameters { voxel_size, max_range, rays, ..of.clone() })?;
        let occupied = map.parameters().g_occ;
        map.pull(&self.points(pool)?, occupied, SURE_UPDATES)?;
        Ok(map)
    }

    pub(crate) fn state(&self) -> StaticMapperState<'_> {
        let Self { views, n_scans, spacing_log2, points, hits } = self;
        let (points, hits) = (sorted(points), sorted(hits));
        StaticMapperState { views, n_scans: *n_scans, spacing_log2: *spacing_log2, points, hits }
    }

    /// The mapper of a saved state.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no mapper has.
    pub(crate) fn restored(saved: SavedStaticMapper) -> Result<Self, Error> {
        // More scans than any sensor takes: counts go on without an overflow.
        const MOST_SCANS: u64 = 1 << 62;
        let SavedStaticMapper { views, n_scans, spacing_log2, points, hits } = saved;
        let is_counted = |hits: &VoxelHits| {
            hits.last <= n_scans && u64::from(hits.count) <= n_scans && hits.count <= u32::MAX / 2
        };
        if n_scans > MOST_SCANS
            || spacing_log2 >= u64::BITS
            || !hits.iter().all(|(_, hits)| is_counted(hits))
            || !views.iter().all(RayView::is_whole)
        {
            return Err(impossible("impossible views or counts of scans"));
        }
        let (points, hits) = (points.into_iter().collect(), hits.into_iter().collect());
        Ok(Self { views, n_scans, spacing_log2, points, hits })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::transform::Transform;

    /// A scan of a wall 10 m ahead, with rays 0.3 degrees apart. Where |y| < 0.5 m, rays end at the
    /// range `nearest` [m].
    fn scan(nearest: Option<f32>) -> Prepared {
        let mut scan = Prepared::default();
        for (y, z) in (-40..=40).flat_map(|y| (-40..=40).map(move |z| (y, z))) {
            let [y, z] = [y, z].map(|index: i16| 0.05 * f32::from(index));
            let ahead = [10.0, y, z];
            let share = nearest.filter(|_| y.abs() < 0.5).map_or(1.0, |nearest| nearest / 10.0);
            scan.points.push(ahead.map(|value| share * value));
        }
        scan.no_return = vec![false; scan.points.len()];
        scan.pose = Transform::IDENTITY;
        scan
    }

    fn kept(scans: &[Option<f32>]) -> Result<[usize; 2], Error> {
        let mut mapper = StaticMapper::default();
        scans.iter().for_each(|&nearest| mapper.take(&scan(nearest)));
        let points = mapper.points(None)?;
        let far = points.iter().filter(|point| point[0] > 9.0).count();
        Ok([points.len() - far, far])
    }

    #[test]
    fn what_is_gone_later_or_was_not_there_before_moved() -> Result<(), Error> {
        let [standing, wall] = kept(&[Some(5.0); 3])?;
        assert!(standing > 300 && wall > 1000, "{standing} {wall}");
        let (before, after) = (kept(&[None, Some(5.0)])?, kept(&[Some(5.0), None])?);
        assert_eq!(before, after);
        assert!(20 * before[0] < standing, "{before:?} {standing}"); // at the border of the view
        assert!(before[1] > wall);
        // What is seen through in one of many scans, such as a fence, stands.
        let fence: Vec<Option<f32>> =
            (0..45).map(|at| Some(5.0).filter(|_| at % 23 != 9)).collect();
        assert!(kept(&fence)?[0] >= standing / 2);
        Ok(())
    }

    #[test]
    fn every_second_view_goes_where_there_are_too_many() -> Result<(), Error> {
        let mut mapper = StaticMapper::default();
        (0..6).for_each(|_| mapper.take(&scan(None)));
        mapper.thin_out();
        assert_eq!((mapper.views.len(), mapper.spacing_log2), (3, 1));
        (0..3).for_each(|_| mapper.take(&scan(Some(5.0)))); // the numbers 6, 7, and 8 of them
        assert_eq!(mapper.views.len(), 5);
        assert!(mapper.hits.values().all(|hits| hits.count <= 5));
        let bytes = crate::util::full_state::sealed("map", &(), &mapper.state())?;
        let saved: SavedStaticMapper = crate::util::full_state::opened("map", &(), &bytes)?;
        assert_eq!(StaticMapper::restored(saved)?.points(None)?, mapper.points(None)?);
        Ok(())
    }

    /// The bytes of a file may contain anything. Their content must not stop the detector later.
    #[test]
    fn states_that_no_scan_left_are_refused() -> Result<(), Error> {
        let restored = |change: &dyn Fn(&mut SavedStaticMapper)| {
            let mut mapper = StaticMapper::default();
            mapper.take(&scan(None));
            let bytes = crate::util::full_state::sealed("map", &(), &mapper.state())?;
            let mut saved: SavedStaticMapper = crate::util::full_state::opened("map", &(), &bytes)?;
            change(&mut saved);
            StaticMapper::restored(saved).map(drop)
        };
        restored(&|_| ())?;
        restored(&|saved| saved.spacing_log2 = 63)?;
        let wrong: [&dyn Fn(&mut SavedStaticMapper); 5] = [
            &|saved| saved.n_scans = u64::MAX,
            &|saved| saved.n_scans = 0,
            &|saved| saved.spacing_log2 = 64,
            &|saved| saved.hits[0].1.count = u32::MAX,
            &|saved| saved.hits[0].1.last = 2,
        ];
        for change in wrong {
            assert!(matches!(restored(change), Err(Error::Format { .. })));
        }
        Ok(())
    }
}
