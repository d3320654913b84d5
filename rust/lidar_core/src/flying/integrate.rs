//! One scan into the map: rays, points, then one exponential update per voxel.
//!
//! Source: Vrba et al., eqs 8-12 and 16-22.

use super::blocks::{Block, Place, VOLUME, ones};
use super::marks::{Content, Mark};
use super::raycast::{Ray, cast_all, merge_ends};
use super::rule::{BlockUpdate, Rule};
use super::voxel_map::{MapParameters, Rays, VoxelMap};
use super::weighting::PoseError;
use super::window::Window;
use crate::Error;
use crate::budget::check_points;
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};
use crate::geometry::transform::{minus, norm};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Class of a point: not to be used.
pub const INVALID: u8 = 0;
/// Class of a point on something that belongs to the environment.
pub const BACKGROUND: u8 = 1;
/// Class of a point on a flying object.
pub const FLYING: u8 = 2;
/// Class of a point that is neither.
pub const UNKNOWN: u8 = 3;

/// Blocks that a scan may touch whatever the budget of the map: those outside its operating volume
/// are not stored. 256 MiB.
const LEAST_SCRATCH: usize = 1 << 17;

/// Where rays start [m].
#[derive(Clone, Copy, Debug)]
pub enum Origins<'a> {
    /// All rays in one point.
    One([f64; 3]),
    /// Every ray in its own.
    Each(&'a [[f64; 3]]),
}

impl Origins<'_> {
    /// Origin of the ray `index`.
    #[must_use]
    #[inline]
    pub fn at(&self, index: usize) -> [f64; 3] {
        match self {
            Self::One(origin) => *origin,
            Self::Each(origins) => origins[index],
        }
    }
}

/// One scan in the frame of the map.
#[derive(Clone, Copy, Debug)]
pub struct ClassifiedScan<'a> {
    /// End of every ray [m].
    pub points: &'a [[f32; 3]],
    /// [`INVALID`], [`BACKGROUND`], [`FLYING`] or [`UNKNOWN`] per point. Invalid entries cast no ray.
    pub class: &'a [u8],
    /// Where the rays start.
    pub origins: Origins<'a>,
    /// Direction of every ray; needed where `no_return` is set.
    pub directions: Option<&'a [[f32; 3]]>,
    /// Rays that met nothing: they clear up to `max_range`.
    pub no_return: Option<&'a [bool]>,
    /// Points whose ray is not cast, such as the nearer of two returns.
    pub no_ray: Option<&'a [bool]>,
    /// How uncertain the points are, if the update is to heed that.
    pub pose_error: Option<&'a PoseError>,
}

/// What a scan did to the map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IntegrateStats {
    /// Points used, per class background, flying, unknown.
    pub points: [usize; 3],
    /// Entries without information: class invalid, not finite, or without a direction.
    pub skipped: usize,
    /// Rays cast, with and without return, or represented by one that is cast.
    pub rays: usize,
    /// Of these, rays without return.
    pub no_return_rays: usize,
    /// Voxels crossed by rays, each crossing counted.
    pub visits: u64,
    /// Voxels whose value was updated.
    pub voxels: usize,
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
        check_lengths(scan)?;
        let mut plan = std::mem::take(&mut self.plan);
        let planned = plan.fill(scan, self.parameters(), self.lattice());
        let outcome = planned.and_then(|()| self.carry_out(&mut plan, scan.pose_error));
        self.plan = plan; // its memory is used again
        outcome
    }

    fn carry_out(
        &mut self,
        plan: &mut Plan,
        pose_error: Option<&PoseError>,
    ) -> Result<IntegrateStats, Error> {
        let mut stats = plan.stats;
        let first_point = plan.points.first().map(|&(voxel, _)| [voxel; 2]);
        let Some([low, high]) = plan.span.or(first_point) else { return Ok(stats) };
        let most = self.blocks.max_blocks().max(LEAST_SCRATCH);
        let mut accumulators = std::mem::take(&mut self.accumulators);
        let outcome = Window::spanning(low, high).and_then(|window| {
            if self.parameters().rays == Rays::OnePerEnd {
                merge_ends(&mut accumulators[0], window, &mut plan.rays, most)?;
            }
            cast_all(self.pool.as_ref(), &mut accumulators, window, &plan.rays, most);
            self.mark(&mut accumulators[0], &plan.points, pose_error);
            accumulators[0].check()?;
            let weighted = pose_error.is_some_and(PoseError::weighs_points);
            self.update(&accumulators[0].marked(), weighted)
        });
        stats.visits = accumulators[0].visits();
        self.accumulators = accumulators;
        stats.voxels = outcome?;
        Ok(stats)
    }

    /// Apply the marks of one scan: the only place where a scan changes values.
    fn update(
        &mut self,
        marked: &[(Place, &[Mark; VOLUME])],
        weighted: bool,
    ) -> Result<usize, Error> {
        let admitted: Vec<_> =
            marked.iter().filter(|(place, _)| self.admits_some(*place)).copied().collect();
        let places: Vec<Place> = admitted.iter().map(|&(place, _)| place).collect();
        let slots = self.blocks.ensure(&places)?;
        let mut work: Vec<_> = slots
            .iter()
            .zip(&admitted)
            .filter_map(|(&slot, &(_, marks))| Some((slot, self.blocks.take(slot)?, marks)))
            .collect();
        let rule = Rule::of(self, weighted);
        let update =
            |(_, block, marks): &mut (u32, Box<Block>, &[Mark; VOLUME])| rule.apply(block, marks);
        let updates: Vec<BlockUpdate> = match &self.pool {
            Some(pool) => pool.install(|| work.par_iter_mut().map(update).collect()),
            None => work.iter_mut().map(update).collect(),
        };
        for ((slot, block, _), update) in work.into_iter().zip(&updates) {
            ones(&update.changed).for_each(|offset| self.changes.note(block.place.voxel(offset)));
            self.blocks.put(slot, block);
        }
        Ok(updates.iter().map(|update| update.voxels).sum())
    }

    fn admits_some(&self, place: Place) -> bool {
        self.limits.is_none_or(|[low, high]| {
            let (first, last) = (place.voxel(0), place.voxel(VOLUME - 1));
            (0..3).all(|axis| last[axis] >= low[axis] && first[axis] <= high[axis])
        })
    }
}

/// What the scan asks for, checked and in units of voxels, before anything is changed.
#[derive(Default)]
pub(crate) struct Plan {
    rays: Vec<Ray>,
    points: Vec<(Voxel, Content)>,
    span: Option<[Voxel; 2]>,
    /// Where the last ray started [m], and the same in units of voxels: most start in one point.
    start: Option<[[f64; 3]; 2]>,
    stats: IntegrateStats,
}

impl Plan {
    fn fill(
        &mut self,
        scan: &ClassifiedScan<'_>,
        parameters: &MapParameters,
        lattice: &Lattice,
    ) -> Result<(), Error> {
        self.rays.clear();
        self.points.clear();
        (self.span, self.start, self.stats) = (None, None, IntegrateStats::default());
        self.rays.reserve_exact(scan.points.len());
        self.points.reserve_exact(scan.points.len());
        Arch::new().dispatch(Fill { plan: self, scan, parameters, lattice })?;
        self.stats.rays = self.rays.len();
        Ok(())
    }

    #[inline(always)]
    fn add_row(
        &mut self,
        scan: &ClassifiedScan<'_>,
        index: usize,
        parameters: &MapParameters,
        lattice: &Lattice,
    ) -> Result<(), Error> {
        let origin = scan.origins.at(index);
        if scan.no_return.is_some_and(|flags| flags[index]) {
            let direction = scan.directions.and_then(|directions| unit(directions[index]));
            return self.add_no_return(lattice, origin, direction, parameters.max_range);
        }
        let point = wide(scan.points[index]);
        let class = content_of(scan.class[index]);
        let Some(class) = class.filter(|_| point.iter().all(|value| value.is_finite())) else {
            self.stats.skipped += 1;
            return Ok(());
        };
        self.add_point(lattice, point, class)?;
        if scan.no_ray.is_some_and(|flags| flags[index]) {
            return Ok(());
        }
        self.add_ray(lattice, origin, hit_end(origin, point, parameters, scan.pose_error))
    }

    #[inline(always)]
    fn add_no_return(
        &mut self,
        lattice: &Lattice,
        origin: [f64; 3],
        direction: Option<[f64; 3]>,
        range: f64,
    ) -> Result<(), Error> {
        let Some(direction) = direction else {
            self.stats.skipped += 1;
            return Ok(());
        };
        self.stats.no_return_rays += 1;
        self.add_ray(lattice, origin, ahead(origin, direction, range))
    }

    #[inline(always)]
    fn add_point(
        &mut self,
        lattice: &Lattice,
        point: [f64; 3],
        class: Content,
    ) -> Result<(), Error> {
        let voxel = lattice.voxel_at(point)?;
        self.points.push((voxel, class));
        self.stats.points[match class {
            Content::Background => 0,
            Content::Flying => 1,
            _ => 2,
        }] += 1;
        Ok(())
    }

    #[inline(always)]
    fn add_ray(&mut self, lattice: &Lattice, start: [f64; 3], end: [f64; 3]) -> Result<(), Error> {
        let from = match self.start {
            Some([known, scaled]) if known == start => scaled,
            _ => {
                let scaled = lattice.scaled(start);
                self.stretch(floor(scaled).ok_or(Error::PointOutOfRange { point: start })?);
                self.start = Some([start, scaled]);
                scaled
            }
        };
        let to = lattice.scaled(end);
        let last = floor(to).ok_or(Error::PointOutOfRange { point: end })?;
        self.stretch(last);
        self.rays.push(Ray { start: from, end: to, last, count: 1 });
        Ok(())
    }

    #[inline(always)]
    fn stretch(&mut self, voxel: Voxel) {
        let [low, high] = self.span.get_or_insert([voxel; 2]);
        for axis in 0..3 {
            low[axis] = low[axis].min(voxel[axis]);
            high[axis] = high[axis].max(voxel[axis]);
        }
    }
}

struct Fill<'a> {
    plan: &'a mut Plan,
    scan: &'a ClassifiedScan<'a>,
    parameters: &'a MapParameters,
    lattice: &'a Lattice,
}

impl WithSimd for Fill<'_> {
    type Output = Result<(), Error>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Result<(), Error> {
        let Self { plan, scan, parameters, lattice } = self;
        for index in 0..scan.points.len() {
            plan.add_row(scan, index, parameters, lattice)?;
        }
        Ok(())
    }
}

/// End of a ray that hit `point`: at the point, but no further than `max_range` (eq. 20).
#[inline(always)]
fn hit_end(
    origin: [f64; 3],
    point: [f64; 3],
    parameters: &MapParameters,
    error: Option<&PoseError>,
) -> [f64; 3] {
    let span = minus(point, origin);
    let distance = norm(span);
    let margin = parameters.end_margin + error.map_or(0.0, |error| error.end_margin(span));
    let reach = (distance - margin).max(0.0).min(parameters.max_range);
    if reach >= distance {
        return point;
    }
    ahead(origin, span, reach / distance)
}

#[inline(always)]
fn ahead(origin: [f64; 3], direction: [f64; 3], by: f64) -> [f64; 3] {
    std::array::from_fn(|axis| origin[axis] + by * direction[axis])
}

#[inline(always)]
fn unit(direction: [f32; 3]) -> Option<[f64; 3]> {
    let direction = wide(direction);
    let norm = norm(direction);
    (norm.is_finite() && norm > 0.0).then(|| direction.map(|value| value / norm))
}

#[inline(always)]
fn content_of(class: u8) -> Option<Content> {
    match class {
        BACKGROUND => Some(Content::Background),
        FLYING => Some(Content::Flying),
        UNKNOWN => Some(Content::Unknown),
        _ => None,
    }
}

fn check_lengths(scan: &ClassifiedScan<'_>) -> Result<(), Error> {
    let expected = scan.points.len();
    check_points(expected)?;
    let lengths = [
        ("point_class", Some(scan.class.len())),
        ("ray_directions", scan.directions.map(<[_]>::len)),
        ("no_return", scan.no_return.map(<[_]>::len)),
        ("no_ray", scan.no_ray.map(<[_]>::len)),
        (
            "sensor_origin",
            if let Origins::Each(each) = scan.origins { Some(each.len()) } else { None },
        ),
    ];
    for (name, got) in lengths {
        if let Some(got) = got.filter(|&got| got != expected) {
            return Err(Error::Length { name, expected, got });
        }
    }
    if let Some(index) = scan.class.iter().position(|&class| class > UNKNOWN) {
        return Err(Error::Value {
            name: "point_class",
            expected: "0 invalid, 1 background, 2 flying or 3 unknown",
            index,
            got: scan.class[index].to_string(),
        });
    }
    if scan.no_return.is_some_and(|flags| flags.contains(&true)) && scan.directions.is_none() {
        return Err(Error::Value {
            name: "ray_directions",
            expected: "the direction of every ray, since `no_return` is set",
            index: 0,
            got: "none".into(),
        });
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::flying::voxel_map::RayUnit;

    pub(crate) fn parameters() -> MapParameters {
        MapParameters {
            voxel_size: 0.25,
            origin: [0.0; 3],
            g_occ: 0.0,
            g_unk: -740.0,
            g_free: -1000.0,
            initial: -740.0,
            thresholds: [-750.0, -300.0, -0.1],
            extra_thresholds: Vec::new(),
            max_range: 20.0,
            end_margin: 0.0,
            rays: Rays::All,
            ray_unit: RayUnit::Edges,
            ray_gain: 1.0,
            bounds: None,
            max_voxels: 1 << 20,
        }
    }

    fn scan<'a>(points: &'a [[f32; 3]], class: &'a [u8]) -> ClassifiedScan<'a> {
        ClassifiedScan {
            points,
            class,
            origins: Origins::One([0.1; 3]),
            directions: None,
            no_return: None,
            no_ray: None,
            pose_error: None,
        }
    }

    #[test]
    fn a_ray_clears_up_to_the_voxel_of_its_point() -> Result<(), Error> {
        let mut map = VoxelMap::new(parameters(), 1)?;
        let stats = map.integrate(&scan(&[[1.1, 0.1, 0.1]], &[BACKGROUND]))?;
        assert_eq!((stats.rays, stats.visits, stats.voxels), (1, 5, 5));
        let at = map.values_at(&[[0.3, 0.1, 0.1], [1.1, 0.1, 0.1], [1.3, 0.1, 0.1]]);
        assert_eq!(at, [-870.0, -370.0, -740.0]); // one edge, one point, nothing
        Ok(())
    }

    #[test]
    fn a_ray_without_return_needs_a_direction() -> Result<(), Error> {
        let mut map = VoxelMap::new(parameters(), 1)?;
        let points = [[f32::NAN; 3]];
        let empty = ClassifiedScan { no_return: Some(&[true]), ..scan(&points, &[INVALID]) };
        assert!(matches!(map.integrate(&empty), Err(Error::Value { name: "ray_directions", .. })));
        let directions = [[0.0, 0.0, 2.0]];
        let stats = map.integrate(&ClassifiedScan { directions: Some(&directions), ..empty })?;
        assert_eq!((stats.rays, stats.no_return_rays, stats.visits), (1, 1, 81));
        Ok(())
    }

    #[test]
    fn a_refused_scan_changes_nothing() -> Result<(), Error> {
        let mut map = VoxelMap::new(MapParameters { max_voxels: 1024, ..parameters() }, 2)?;
        assert!(matches!(
            map.integrate(&scan(&[[15.0, 9.0, 3.0]], &[UNKNOWN])),
            Err(Error::Limit { .. })
        ));
        assert!(matches!(
            map.integrate(&scan(&[[1e30, 0.0, 0.0]], &[1])),
            Err(Error::PointOutOfRange { .. })
        ));
        assert!(matches!(map.integrate(&scan(&[[1.0; 3]], &[4])), Err(Error::Value { .. })));
        assert!(matches!(map.integrate(&scan(&[[1.0; 3]], &[])), Err(Error::Length { .. })));
        assert_eq!(map.stored_voxels(), 0);
        Ok(())
    }

    #[test]
    fn nothing_outside_the_operating_volume_is_mapped() -> Result<(), Error> {
        let bounds = Some([[0.0; 3], [0.5, 1.0, 1.0]]);
        let mut map = VoxelMap::new(MapParameters { bounds, ..parameters() }, 1)?;
        map.integrate(&scan(&[[5.1, 0.1, 0.1]], &[BACKGROUND]))?;
        assert_eq!(
            map.values_at(&[[0.3, 0.1, 0.1], [1.3, 0.1, 0.1], [5.1, 0.1, 0.1]]),
            [-870.0, -740.0, -740.0]
        );
        Ok(())
    }
}
