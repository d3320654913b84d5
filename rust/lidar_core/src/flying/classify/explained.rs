//! Points that are background by rule A ("explained" by the map), whichever cluster they belong to.

use crate::flying::map::block_shape::EDGE;
use crate::flying::map::blocks::{Cursor, Place, offset_of};
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::parameters::FlyingParameters;
use crate::geometry::lattice::{Voxel, floor, wide};
use crate::util::vector_unit::dispatch;
use pulp::{Simd, WithSimd};
use rayon::ThreadPool;
use rayon::prelude::*;

/// Number of points that are looked up at a time.
const LANES: usize = 16;
/// Number of points that a thread takes at a time.
const POINTS_AT_A_TIME: usize = 4096;
/// Margin for rounding errors [voxels].
const MARGIN: f64 = 1e-3;

/// Points that the map explains: an occupied voxel is near, so the cluster of each is background.
///
/// Only the class of such clusters is used. So all explained points can be one cluster. The other
/// clusters, their order and their classes do not change.
#[derive(Default)]
pub(crate) struct Explained {
    is_explained: Vec<bool>,
}

impl Explained {
    /// For each point of a scan, whether the map before the scan explains it. Points `expected`
    /// (indices), which may belong to targets, count as not explained. None if clusters must be
    /// found as a whole: if the class of a cluster depends on its number of points, on its voxels
    /// or on a later map, if voxels are too large for rule A, or if the map explains at most half
    /// of the points.
    pub(crate) fn find(
        &mut self,
        points: &[[f32; 3]],
        map: &VoxelMap,
        parameters: &FlyingParameters,
        pool: Option<&ThreadPool>,
        expected: &[usize],
    ) -> Option<&[bool]> {
        let FlyingParameters { clustering, classify, cluster_voxels, .. } = parameters;
        let counts = clustering.min_points > 1 || clustering.max_points.is_some();
        let reach = voxels_in_reach(map.lattice().voxel_size(), classify.close_distance)?;
        if !classify.skips_explained || counts || *cluster_voxels || classify.after_update {
            return None;
        }
        let find = |(points, found): (&[[f32; 3]], &mut [bool])| -> [usize; 2] {
            dispatch(Find { map, reach, points, found })
        };
        let both = |a: [usize; 2], b: [usize; 2]| [a[0] + b[0], a[1] + b[1]];
        self.is_explained.clear();
        self.is_explained.resize(points.len(), false);
        let found = &mut self.is_explained;
        let [n_points, n_explained] = match pool {
            Some(pool) => pool.install(|| {
                let points = points.par_chunks(POINTS_AT_A_TIME);
                let parts = points.zip(found.par_chunks_mut(POINTS_AT_A_TIME)).map(find);
                parts.reduce(|| [0; 2], both)
            }),
            None => find((points, found)),
        };
        expected.iter().for_each(|&row| self.is_explained[row] = false);
        (2 * n_explained > n_points).then_some(self.is_explained.as_slice())
    }
}

/// Number of voxels along an axis, 0 or 1, within which an occupied voxel is always close to a
/// point in the sense of rule A. None if even the voxel that contains the point is not always
/// close.
fn voxels_in_reach(voxel_size: f64, close_distance: f64) -> Option<i32> {
    // To the centre of a voxel that is so many away: half a diagonal more.
    let is_close = |steps: f64| (steps + 0.5) * 3f64.sqrt() + MARGIN < close_distance / voxel_size;
    if is_close(1.0) { Some(1) } else { is_close(0.0).then_some(0) }
}

/// Look-up of points, many at a time on the vector unit of the machine. Returns the number of
/// finite points, and of explained points.
struct Find<'a> {
    map: &'a VoxelMap,
    reach: i32,
    points: &'a [[f32; 3]],
    found: &'a mut [bool],
}

impl WithSimd for Find<'_> {
    type Output = [usize; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [usize; 2] {
        let Self { map, reach, points, found } = self;
        let mut cursor = Cursor::new(&map.blocks);
        let (mut n_points, mut n_explained) = (0, 0);
        for (points, found) in points.chunks(LANES).zip(found.chunks_mut(LANES)) {
            let mut numbers = [[f64::NAN; LANES]; 3];
            for (lane, point) in points.iter().enumerate() {
                for axis in 0..3 {
                    numbers[axis][lane] = f64::from(point[axis]);
                }
            }
            let (voxels, sure) = map.lattice().voxels_at(&numbers);
            for (lane, (found, &point)) in found.iter_mut().zip(points).enumerate() {
                let mut home = Some([voxels[0][lane], voxels[1][lane], voxels[2][lane]]);
                if sure[lane] <= 0.0 {
                    // On a wall: any of its voxels serves, since its centre is no further away.
                    home = floor(map.lattice().scaled(wide(point)));
                }
                n_points += usize::from(point[0].is_finite());
                *found = home.is_some_and(|home| {
                    cursor.is_tentative(home) || reach > 0 && any_beside(&mut cursor, home)
                });
                n_explained += usize::from(*found);
            }
        }
        [n_points, n_explained]
    }
}

/// True if the map explains a point [m, frame of the map], in the sense of [`Explained::find`].
pub(crate) fn is_explained(map: &VoxelMap, close_distance: f64, point: [f64; 3]) -> bool {
    let Some(reach) = voxels_in_reach(map.lattice().voxel_size(), close_distance) else {
        return false;
    };
    let mut cursor = Cursor::new(&map.blocks);
    floor(map.lattice().scaled(point))
        .is_some_and(|home| cursor.is_tentative(home) || reach > 0 && any_beside(&mut cursor, home))
}

/// True if `home` or one of its 26 neighbours is tentatively occupied.
fn any_beside(cursor: &mut Cursor<'_>, home: Voxel) -> bool {
    const LAST: i32 = EDGE - 1;
    let inside = home[0] & LAST;
    (0..9).any(|row| {
        let [x, y, z] = [home[0], home[1] + row % 3 - 1, home[2] + row / 3 - 1];
        if inside == 0 || inside == LAST {
            return (-1..=1).any(|step| cursor.is_tentative([x + step, y, z]));
        }
        let bits = cursor.block(Place::of([x, y, z])).map_or(0, |block| {
            let offset = offset_of([x - 1, y, z]);
            block.tentative[offset >> 6] >> (offset & 63)
        });
        bits & 0b111 != 0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::flying::classify::classifier::{Classifier, ClusterRules};
    use crate::flying::classify::clusters::Clusters;
    use crate::flying::classify::occupied_nearby::OccupiedNearby;
    use crate::flying::point_class::PointClass;
    use crate::geometry::cluster::angular_gap::AngularGap;
    use crate::geometry::cluster::joined::JoinedLabeller;

    #[test]
    fn what_is_explained_is_close_by_rule_a() -> Result<(), Error> {
        let share = |index: u32| {
            let mixed =
                index.wrapping_mul(2_654_435_769).rotate_left(9).wrapping_mul(2_246_822_519);
            (mixed >> 8) as f32 / (1 << 24) as f32
        };
        let at = |seed: u32| [0, 1, 2].map(|axis| 8.0 * share(8 * seed + axis) - 4.0);
        for (close_distance, reach) in [(0.7, 1), (0.3, 0)] {
            let mut parameters = FlyingParameters::default();
            parameters.classify.close_distance = close_distance;
            let mut map = VoxelMap::new(parameters.map.clone())?;
            map.set_occupied(&(0..600).map(at).collect::<Vec<_>>())?;
            assert_eq!(voxels_in_reach(map.lattice().voxel_size(), close_distance), Some(reach));
            let points: Vec<[f32; 3]> = (900..9000).map(at).collect();
            let mut found = vec![false; points.len()];
            let [all, n_explained] =
                dispatch(Find { map: &map, reach, points: &points, found: &mut found });
            let mut near = OccupiedNearby::new(&map, close_distance);
            let mut n_close = 0;
            for (point, &is_explained) in points.iter().zip(&found) {
                let is_close = near.is_close(wide(*point));
                n_close += usize::from(is_close);
                assert!(is_close || !is_explained, "{point:?}");
            }
            assert_eq!(all, points.len());
            assert!(n_explained > 100 && n_explained < n_close, "{n_explained} of {n_close}");
        }
        Ok(())
    }

    /// Class of every point, and a number of points. `is_joined`: which points are joined from the
    /// start.
    fn classes(
        points: &[[f32; 3]],
        map: &VoxelMap,
        is_joined: Option<&[bool]>,
    ) -> Result<(Vec<PointClass>, usize), Error> {
        let FlyingParameters { classify, clustering, cluster_angle, .. } =
            FlyingParameters::default();
        let gap = AngularGap { origin: [0.1; 3], max_angle: cluster_angle };
        let (mut labeller, mut clusters) = (JoinedLabeller::default(), Clusters::default());
        match is_joined {
            Some(is_joined) => labeller.label_joined(points, is_joined, &gap, 0.25, 0.7, None)?,
            None => labeller.label(points, &gap, &clustering, None)?,
        }
        match labeller.searched() {
            Some((joined, rows)) => clusters.fill_some(points, labeller.labels(), joined, rows),
            None => clusters.fill(points, labeller.labels()),
        }
        let rules = ClusterRules { map, points, origin: [0.1; 3], parameters: &classify };
        let mut found = Vec::new();
        Classifier::default().classify(&rules, &clusters, None, &mut found)?;
        let class = labeller.labels().iter().map(|&label| found[label as usize].class).collect();
        Ok((class, labeller.searched().map_or(points.len(), |(_, rows)| rows.len())))
    }

    #[test]
    fn classes_are_those_of_a_whole_search_and_only_explained_points_may_be_joined()
    -> Result<(), Error> {
        // A wall that the map holds in part, fragments before it, a ball in free air and one at the wall.
        let parameters = FlyingParameters::default();
        let mut map = VoxelMap::new(parameters.map.clone())?;
        let grid = |step: u32| [step % 60, step / 60].map(|at| 0.1 * at as f32 - 3.0);
        let wall: Vec<[f32; 3]> = (0..3600)
            .map(|step| [6.05 + 0.03 * (step % 7) as f32, grid(step)[0], grid(step)[1]])
            .collect();
        let known: Vec<_> =
            wall.iter().copied().filter(|point| point[1] < 0.0 || point[2] < 1.5).collect();
        map.set_occupied(&known)?;
        let ball = |x: f32, z: f32| {
            (0..40).map(move |step| {
                let (sin, cos) = libm::sincosf(0.7 * step as f32);
                [x, 0.3 * sin, z + 0.3 * cos]
            })
        };
        let air = |step: u32| [step % 40, step / 40 % 40, step / 1600].map(|at| 0.2 * at as f32);
        let air: Vec<_> =
            (0..48_000).map(air).map(|[y, z, x]| [x - 0.5, y - 4.0, z - 4.0]).collect();
        map.set_free(&air.into_iter().filter(|point| point[0] < 5.2).collect::<Vec<_>>())?;
        let fragments = (0..5).map(|step| [5.5, -2.0 + step as f32, 2.05]);
        let points: Vec<_> =
            ball(3.05, 0.55).chain(wall).chain(fragments).chain(ball(5.85, 1.05)).collect();

        let (expected, all) = classes(&points, &map, None)?;
        assert_eq!(expected[..40], [PointClass::Flying; 40]);
        assert_eq!(all, points.len());
        let mut explained = Explained::default();
        let found = explained.find(&points, &map, &parameters, None, &[]).map(<[bool]>::to_vec);
        let found = found.unwrap_or_default();
        let (class, searched) = classes(&points, &map, Some(&found))?;
        assert_eq!(class, expected);
        assert!(searched < points.len() / 4 * 3, "{searched} of {}", points.len());
        // The opposite: points in the air are not explained, and joining them would change classes.
        let wrong: Vec<bool> = (0..points.len()).map(|row| found[row] || row < 40).collect();
        assert_eq!(classes(&points, &map, Some(&wrong))?.0[..40], [PointClass::Background; 40]);
        Ok(())
    }

    #[test]
    fn clusters_are_found_as_a_whole_where_their_points_count() -> Result<(), Error> {
        let usual = FlyingParameters::default();
        let mut map = VoxelMap::new(usual.map.clone())?;
        let points = [[1.05, 2.05, 3.05], [1.1, 2.1, 3.1], [9.1, 2.1, 3.1]];
        let mut explained = Explained::default();
        assert_eq!(explained.find(&points, &map, &usual, None, &[]), None);
        map.set_occupied(&points[..1])?;
        let found = Some([true, true, false].as_slice());
        assert_eq!(explained.find(&points, &map, &usual, None, &[]), found);
        let changes: [fn(&mut FlyingParameters); 6] = [
            |changed| changed.clustering.min_points = 2,
            |changed| changed.clustering.max_points = Some(9),
            |changed| changed.cluster_voxels = true,
            |changed| changed.classify.after_update = true,
            |changed| changed.classify.skips_explained = false,
            |changed| changed.classify.close_distance = 0.2,
        ];
        for change in changes {
            let mut changed = usual.clone();
            change(&mut changed);
            assert_eq!(explained.find(&points, &map, &changed, None, &[]), None);
        }
        Ok(())
    }
}
