//! Update of the map by one scan: rays, points, then one exponential update per voxel.
//!
//! There are two steps: cast the rays, which needs no classes, then mark the points and update the
//! voxels.
//!
//! Source: Vrba et al., eqs 8-12 and 16-22.

use super::accumulate::accumulator::Accumulator;
use super::accumulate::live_cells::LiveCells;
use super::accumulate::mark::Content;
use super::accumulate::window::Window;
use super::block_update::{MarkedBlock, update_blocks};
use super::classified_scan::{ClassifiedScan, IntegrateStats, check_classes};
use super::cube_map::CubeMap;
use super::plan::Plan;
use super::pose_weights::{PoseError, mark_points};
use super::ray_lanes::CastTask;
use super::ray_segments::Source;
use super::walk::{cast_all, merge_ends};
use crate::Error;
use crate::flying::map::parameters::{Rays, Skip};
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::PointClass;
use crate::geometry::lattice::Voxel;
use crate::util::budget::{check_memory, check_scan_memory};
use crate::util::cancel;
use crate::util::threads::Workers;

/// Number of blocks that a scan may always touch, even if the budget of the map is smaller: blocks
/// outside the operating volume are not stored. The marks of these blocks take 256 MiB.
const LEAST_SCRATCH: usize = 1 << 17;
/// Memory of a block of the window, without the memory of the threads [bytes].
const ROOM_OF_BLOCK: usize = 16;

/// Updates a voxel map with scans. It keeps its memory for the next scan.
pub struct Integrator {
    workers: Workers,
    plan: Plan,
    cells: LiveCells,
    live: CubeMap,
    /// One accumulator per thread. The sums of the others are added to the first one.
    accumulators: Vec<Accumulator>,
    blocks: Vec<MarkedBlock>,
    /// True while the accumulators hold marks of a scan.
    is_open: bool,
    /// True if rays skip voxels even where the search for these voxels may take longer than
    /// visiting them.
    passes_always: bool,
}

/// An integrator that works on the calling thread.
impl Default for Integrator {
    fn default() -> Self {
        Self::on(Workers::default())
    }
}

impl Integrator {
    /// An integrator with `threads` threads of its own.
    ///
    /// # Errors
    /// [`Error::Parameter`] if `threads` is outside 1 to 256, [`Error::Io`] if the system refuses.
    pub fn new(threads: usize) -> Result<Self, Error> {
        Workers::new(threads).map(Self::on)
    }

    /// An integrator that shares `workers` with other stages.
    #[must_use]
    pub fn on(workers: Workers) -> Self {
        let accumulators = (0..workers.count()).map(|_| Accumulator::default()).collect();
        Self {
            workers,
            plan: Plan::default(),
            cells: LiveCells::default(),
            live: CubeMap::default(),
            accumulators,
            blocks: Vec::new(),
            is_open: false,
            passes_always: false,
        }
    }

    /// An integrator whose rays skip voxels also in scans that are too small to gain from it.
    #[cfg(test)]
    pub(super) fn that_always_passes(threads: usize) -> Result<Self, Error> {
        Ok(Self { passes_always: true, ..Self::new(threads)? })
    }

    /// Update `map` with one classified scan.
    ///
    /// A voxel with points is pulled once per point towards the value of its strongest class:
    /// background, then flying, then unknown (flying sets the value, eq. 17). Every other voxel is
    /// pulled towards free by the length of the rays inside it (eq. 22).
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Value`], [`Error::PointOutOfRange`], [`Error::Limit`],
    /// [`Error::Interrupted`]; the map is unchanged then.
    pub fn integrate(
        &mut self,
        map: &mut VoxelMap,
        scan: &ClassifiedScan<'_>,
    ) -> Result<IntegrateStats, Error> {
        check_scan_memory(scan.points.len())?;
        self.cast(map, scan)?;
        self.apply(map, scan.class, scan.pose_error)
    }

    /// Cast the rays of a scan. Of the classes, only [`PointClass::Invalid`] matters here.
    ///
    /// # Errors
    /// As [`Integrator::integrate`].
    pub(crate) fn cast(&mut self, map: &VoxelMap, scan: &ClassifiedScan<'_>) -> Result<(), Error> {
        let Self { workers, plan, cells, live, accumulators, is_open, passes_always, .. } = self;
        if std::mem::replace(is_open, true) {
            // The scan before was given up: its lengths must not count in this one.
            accumulators.fill_with(Accumulator::default);
        }
        let source = Source { scan, parameters: map.parameters(), lattice: map.lattice() };
        plan.fill(workers.pool(), &source)?;
        cancel::check()?;
        let Some([low, high]) = plan.bounds() else { return Ok(()) };
        let window = Window::spanning(low, high)?;
        let most = map.blocks.max_blocks().max(LEAST_SCRATCH);
        // A few rays may reach far: then the window takes more than the points.
        let of_threads: usize = accumulators.iter().map(|one| one.room(&window)).sum();
        check_memory("the window of a scan", of_threads + window.len() * ROOM_OF_BLOCK, 1)?;
        if map.parameters().rays == Rays::OnePerEnd {
            merge_ends(&mut accumulators[0], window, &source, &mut plan.rays, most)?;
        }
        cancel::check()?;
        let mut skips = map.parameters().skip == Skip::Saturated;
        if skips {
            cells.fill(&window, map);
            let reach = source.parameters.max_range / source.lattice.voxel_size();
            let visits = plan.rays.len() as f64 * reach;
            skips = (*passes_always || cells.is_worth_it(visits))
                && live.fill(workers.pool(), &window, cells, &source, &plan.rays);
        }
        cancel::check()?;
        let task = CastTask { window: &window, source: &source, live: skips.then_some(live) };
        cast_all(workers.pool(), accumulators, &task, &plan.rays, most);
        cancel::check()?;
        accumulators[0].check()
    }

    /// Mark the points of the scan whose rays were cast last, by their class, and update the map.
    ///
    /// # Errors
    /// As [`Integrator::integrate`].
    pub(crate) fn apply(
        &mut self,
        map: &mut VoxelMap,
        class: &[PointClass],
        pose_error: Option<&PoseError>,
    ) -> Result<IntegrateStats, Error> {
        let Self { workers, plan, accumulators, blocks, is_open, .. } = self;
        check_classes(class, plan.rows)?;
        let sums = &mut accumulators[0];
        let mut stats = plan.stats;
        let count = |&(_, content): &(Voxel, Content)| stats.count(content);
        mark_points(map, sums, plan.classified(class).inspect(count), pose_error);
        sums.check()?;
        cancel::begin_to_write()?;
        (stats.visits, stats.visits_skipped) = (sums.visits(), sums.visits() - sums.walked());
        let weighted = pose_error.is_some_and(PoseError::weighs_points);
        // On an error `is_open` stays set: the next scan starts with new accumulators.
        [stats.voxels, stats.voxels_changed, stats.voxels_forgotten] =
            update_blocks(map, blocks, sums, weighted, workers.pool())?;
        sums.clear(workers.pool());
        *is_open = false;
        Ok(stats)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::flying::integrate::classified_scan::Origins;
    use crate::flying::map::parameters::MapParameters;
    use crate::flying::map::parameters::tests::parameters;
    use crate::flying::point_class::PointClass;

    pub(crate) fn scan<'a>(points: &'a [[f32; 3]], class: &'a [PointClass]) -> ClassifiedScan<'a> {
        ClassifiedScan {
            points,
            class,
            origins: Origins::One([0.1; 3]),
            directions: None,
            no_return: None,
            no_ray: None,
            reach: None,
            pose_error: None,
        }
    }

    #[test]
    fn a_ray_clears_up_to_the_voxel_of_its_point() -> Result<(), Error> {
        let mut map = VoxelMap::new(parameters())?;
        let scan = scan(&[[1.1, 0.1, 0.1]], &[PointClass::Background]);
        let stats = Integrator::new(1)?.integrate(&mut map, &scan)?;
        assert_eq!((stats.rays, stats.visits, stats.voxels), (1, 5, 5));
        let at = map.values_at(&[[0.3, 0.1, 0.1], [1.1, 0.1, 0.1], [1.3, 0.1, 0.1]]);
        assert_eq!(at, [-870.0, -370.0, -740.0]); // one edge, one point, nothing
        Ok(())
    }

    #[test]
    fn a_ray_without_return_needs_a_direction() -> Result<(), Error> {
        let mut map = VoxelMap::new(parameters())?;
        let points = [[f32::NAN; 3]];
        let empty =
            ClassifiedScan { no_return: Some(&[true]), ..scan(&points, &[PointClass::Invalid]) };
        let mut integrator = Integrator::new(1)?;
        let refused = integrator.integrate(&mut map, &empty);
        assert!(matches!(refused, Err(Error::Value { name: "ray_directions", .. })));
        let directions = [[0.0, 0.0, 2.0]];
        let aimed = ClassifiedScan { directions: Some(&directions), ..empty };
        let stats = integrator.integrate(&mut map, &aimed)?;
        assert_eq!((stats.rays, stats.no_return_rays, stats.visits), (1, 1, 81));
        Ok(())
    }

    #[test]
    fn a_refused_scan_changes_nothing() -> Result<(), Error> {
        let mut map = VoxelMap::new(MapParameters { max_voxels: 1024, ..parameters() })?;
        let mut integrator = Integrator::new(2)?;
        let mut integrate = |scan| integrator.integrate(&mut map, &scan);
        assert!(matches!(
            integrate(scan(&[[15.0, 9.0, 3.0]], &[PointClass::Unknown])),
            Err(Error::Limit { .. })
        ));
        assert!(matches!(
            integrate(scan(&[[1e30, 0.0, 0.0]], &[PointClass::Background])),
            Err(Error::PointOutOfRange { .. })
        ));
        assert!(matches!(integrate(scan(&[[1.0; 3]], &[])), Err(Error::Length { .. })));
        assert_eq!(map.stored_voxels(), 0);
        Ok(())
    }

    #[test]
    fn nothing_is_left_of_a_scan_in_the_next_one() -> Result<(), Error> {
        let far = [[15.0, 9.0, 3.0], [-40.0, 60.0, 5.0]];
        let near = [[1.1, 0.1, 0.1], [60.0, -3.0, 1.0]];
        for (threads, max_voxels) in [(1, 3072), (2, 3072), (1, 1 << 20), (3, 1 << 20)] {
            let parameters = MapParameters { max_voxels, max_range: 5.0, ..parameters() };
            let mut map = VoxelMap::new(parameters.clone())?;
            let (mut integrator, mut fresh) = (Integrator::new(threads)?, Integrator::new(1)?);
            let class = [PointClass::Unknown, PointClass::Background];
            let refused = integrator.integrate(&mut map, &scan(&far, &class)).is_err();
            assert_eq!(refused, max_voxels == 3072);
            map.clear();
            let mut other = VoxelMap::new(parameters)?;
            integrator
                .integrate(&mut map, &scan(&near, &[PointClass::Background, PointClass::Flying]))?;
            fresh.integrate(
                &mut other,
                &scan(&near, &[PointClass::Background, PointClass::Flying]),
            )?;
            assert_eq!(map.to_bytes(), other.to_bytes());
        }
        Ok(())
    }

    #[test]
    fn a_window_in_pieces_gives_what_a_whole_one_gives() -> Result<(), Error> {
        // The blocks that bound both rays are far too many to lie in memory as a whole.
        let ends = [[300.1, 0.2, 0.3], [0.1, 290.1, 250.3]];
        let class = [PointClass::Background; 2];
        let long = MapParameters { max_range: 400.0, ..parameters() };
        for threads in [1, 2] {
            let mut map = VoxelMap::new(long.clone())?;
            Integrator::new(threads)?.integrate(&mut map, &scan(&ends, &class))?;
            for end in ends {
                let mut alone = VoxelMap::new(long.clone())?;
                Integrator::new(1)?.integrate(&mut alone, &scan(&[end], &class[..1]))?;
                let along: Vec<[f32; 3]> = (1_u8..=200)
                    .map(|step| end.map(|value| value * f32::from(step) / 200.0))
                    .collect();
                assert_eq!(map.values_at(&along[5..]), alone.values_at(&along[5..]));
            }
        }
        Ok(())
    }

    #[test]
    fn a_scan_without_anything_fits_any_lattice() -> Result<(), Error> {
        let mut map = VoxelMap::new(MapParameters { voxel_size: 1e100, ..parameters() })?;
        let scan = scan(&[[f32::NAN; 3]; 3], &[PointClass::Background; 3]);
        let stats = Integrator::new(1)?.integrate(&mut map, &scan)?;
        assert_eq!((stats.skipped, stats.rays, stats.voxels), (3, 0, 0));
        Ok(())
    }

    #[test]
    fn of_several_errors_the_first_in_the_order_of_the_input_is_told() -> Result<(), Error> {
        let mut map = VoxelMap::new(parameters())?;
        let (far, wrong, near) = ([1e30, 0.0, 0.0], [0.0, 1e30, 0.0], [1.0; 3]);
        let points = [near, far, near].map(|point| point.map(|value| value as f32));
        let class = [PointClass::Background; 3];
        for (origins, first) in [([[0.0; 3], [0.0; 3], wrong], far), ([wrong, near, near], wrong)] {
            let scan = ClassifiedScan {
                points: &points,
                origins: Origins::Each(&origins),
                ..scan(&[], &class)
            };
            let error = Integrator::new(1)?.integrate(&mut map, &scan);
            let told =
                |point: [f64; 3]| (0..3).all(|axis| (point[axis] - first[axis]).abs() < 1e24);
            assert!(
                matches!(error, Err(Error::PointOutOfRange { point }) if told(point)),
                "{error:?}"
            );
        }
        Ok(())
    }

    #[test]
    fn nothing_outside_the_operating_volume_is_mapped() -> Result<(), Error> {
        let bounds = Some([[0.0; 3], [0.5, 1.0, 1.0]]);
        let mut map = VoxelMap::new(MapParameters { bounds, ..parameters() })?;
        Integrator::new(1)?
            .integrate(&mut map, &scan(&[[5.1, 0.1, 0.1]], &[PointClass::Background]))?;
        assert_eq!(
            map.values_at(&[[0.3, 0.1, 0.1], [1.3, 0.1, 0.1], [5.1, 0.1, 0.1]]),
            [-870.0, -740.0, -740.0]
        );
        Ok(())
    }

    #[test]
    fn classes_may_come_after_the_rays() -> Result<(), Error> {
        let points = [[1.1, 0.1, 0.1], [-2.0, 5.0, 0.3], [f32::NAN; 3]];
        let class = [PointClass::Background, PointClass::Flying, PointClass::Invalid];
        for threads in [1, 2] {
            let mut map = VoxelMap::new(parameters())?;
            let mut integrator = Integrator::new(threads)?;
            integrator.cast(&map, &scan(&[[9.0, 3.0, 2.0]], &[PointClass::Unknown]))?; // given up
            integrator.cast(
                &map,
                &scan(&points, &[PointClass::Unknown, PointClass::Unknown, PointClass::Invalid]),
            )?;
            assert_eq!(map.stored_voxels(), 0);
            let stats = integrator.apply(&mut map, &class, None)?;
            let mut other = VoxelMap::new(parameters())?;
            let at_once = Integrator::new(1)?.integrate(&mut other, &scan(&points, &class))?;
            assert_eq!(stats, at_once);
            assert_eq!(map.to_bytes(), other.to_bytes());
            assert!(integrator.apply(&mut map, &class[..1], None).is_err());
        }
        Ok(())
    }
}
