//! One scan into the map in two steps, of which the first needs no classes: cast the rays, then
//! mark the points and update the voxels.
//!
//! Source: Vrba et al., eqs 8-12 and 16-22.

use super::accumulator::{Accumulator, Content};
use super::integrator::{ClassifiedScan, IntegrateStats, check_classes};
use super::plan::Plan;
use super::pose_weights::PoseError;
use super::ray_segments::Source;
use super::walk::{cast_all, merge_ends};
use super::window::Window;
use crate::Error;
use crate::flying::map::voxel_map::{Rays, VoxelMap};
use crate::geometry::lattice::Voxel;

/// Blocks that a scan may touch whatever the budget of the map: those outside its operating volume
/// are not stored. 256 MiB.
const LEAST_SCRATCH: usize = 1 << 17;

/// A scan whose rays have been cast, and memory for the next one.
#[derive(Default)]
pub(crate) struct Casting {
    plan: Plan,
    accumulators: Vec<Accumulator>,
    /// True while the accumulators hold marks.
    is_open: bool,
}

impl Casting {
    pub(crate) fn new(threads: usize) -> Self {
        let accumulators = (0..threads).map(|_| Accumulator::default()).collect();
        Self { accumulators, ..Self::default() }
    }
}

impl VoxelMap {
    /// Update the map with one classified scan.
    ///
    /// A voxel that holds points is pulled once per point towards the value of its strongest
    /// class (background before flying before unknown; flying sets it outright, eq. 17); any
    /// other voxel is pulled towards free by the length of the rays inside it (eq. 22).
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Value`], [`Error::PointOutOfRange`], [`Error::Limit`]; the map
    /// is unchanged then.
    pub fn integrate(&mut self, scan: &ClassifiedScan<'_>) -> Result<IntegrateStats, Error> {
        let mut casting = std::mem::take(&mut self.casting);
        let cast = self.cast(&mut casting, scan);
        let outcome = cast.and_then(|()| self.apply(&mut casting, scan.class, scan.pose_error));
        self.casting = casting; // its memory is used again
        outcome
    }

    /// Cast the rays of a scan. Of the classes only [`INVALID`](super::integrator::INVALID) matters.
    ///
    /// # Errors
    /// As [`VoxelMap::integrate`].
    pub(crate) fn cast(
        &self,
        casting: &mut Casting,
        scan: &ClassifiedScan<'_>,
    ) -> Result<(), Error> {
        let Casting { plan, accumulators, is_open } = casting;
        if std::mem::replace(is_open, true) {
            accumulators.fill_with(Accumulator::default); // a scan that was given up
        }
        let source = Source { scan, parameters: self.parameters(), lattice: self.lattice() };
        plan.fill(self.pool.as_ref(), &source)?;
        let Some([low, high]) = plan.bounds() else { return Ok(()) };
        let window = Window::spanning(low, high)?;
        let most = self.blocks.max_blocks().max(LEAST_SCRATCH);
        if self.parameters().rays == Rays::OnePerEnd {
            merge_ends(&mut accumulators[0], window, &source, &mut plan.rays, most)?;
        }
        cast_all(self.pool.as_ref(), accumulators, window, &source, &plan.rays, most);
        accumulators[0].check()
    }

    /// Mark the points of the scan that was cast last, by their class, and update the map.
    ///
    /// # Errors
    /// As [`VoxelMap::integrate`].
    pub(crate) fn apply(
        &mut self,
        casting: &mut Casting,
        class: &[u8],
        pose_error: Option<&PoseError>,
    ) -> Result<IntegrateStats, Error> {
        let Casting { plan, accumulators, is_open } = casting;
        check_classes(class, plan.rows)?;
        let sums = &mut accumulators[0];
        let mut stats = plan.stats;
        let count = |&(_, content): &(Voxel, Content)| stats.count(content);
        self.mark(sums, plan.classified(class).inspect(count), pose_error);
        sums.check()?;
        stats.visits = sums.visits();
        // On an error `is_open` stays set: the next scan starts with new accumulators.
        stats.voxels = self.update(sums, pose_error.is_some_and(PoseError::weighs_points))?;
        sums.clear(self.pool.as_ref());
        *is_open = false;
        Ok(stats)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::integrate::integrator::tests::{parameters, scan};
    use crate::flying::integrate::integrator::{BACKGROUND, FLYING, INVALID, UNKNOWN};

    #[test]
    fn classes_may_come_after_the_rays() -> Result<(), Error> {
        let points = [[1.1, 0.1, 0.1], [-2.0, 5.0, 0.3], [f32::NAN; 3]];
        let class = [BACKGROUND, FLYING, INVALID];
        for threads in [1, 2] {
            let mut map = VoxelMap::new(parameters(), threads)?;
            let mut casting = std::mem::take(&mut map.casting);
            map.cast(&mut casting, &scan(&[[9.0, 3.0, 2.0]], &[UNKNOWN]))?; // given up
            map.cast(&mut casting, &scan(&points, &[UNKNOWN, UNKNOWN, INVALID]))?;
            assert_eq!(map.stored_voxels(), 0);
            let stats = map.apply(&mut casting, &class, None)?;
            let mut other = VoxelMap::new(parameters(), 1)?;
            assert_eq!(stats, other.integrate(&scan(&points, &class))?);
            assert_eq!(map.to_bytes(), other.to_bytes());
            assert!(map.apply(&mut casting, &class[..1], None).is_err());
        }
        Ok(())
    }
}
