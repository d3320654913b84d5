//! Classification of the clusters of a scan as background, flying or unknown. Source: Vrba et al.,
//! sec. III-B.

use super::clusters::{Cluster, Clusters};
use super::flood::{self, Flood, check_steps, neighbours, search_radius};
use super::grouping::Grouper;
use super::occupied_nearby::OccupiedNearby;
use super::parameters::ClassifyParameters;
use super::shadow::Shadow;
use crate::Error;
use crate::flying::map::blocks::Cursor;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::PointClass;
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};
use crate::geometry::transform::{minus, norm};
use crate::util::budget::check_scan_memory;
use crate::util::cancel;
use crate::util::object_pool::{ObjectPool, PooledObject};
use crate::util::threads::Workers;
use rayon::ThreadPool;
use rayon::prelude::*;

/// Class of one cluster and the evidence for it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Classification {
    pub(crate) class: PointClass,
    /// Uncertain voxels that the searches of a flying cluster have explored. Empty unless pockets
    /// are to be made free.
    pub(crate) explored: Vec<Voxel>,
    /// Share of free voxels among those neighbours of a flying cluster's voxels that the sensor can
    /// see.
    pub(crate) clearance: f64,
    /// Whether it flies because a track predicts it near structure.
    pub(crate) is_expected: bool,
    /// Whether it has moved into free space above space that was never observed: it may stand on
    /// something.
    pub(crate) is_over_unseen: bool,
}

impl Classification {
    /// A classification with only a class, without evidence.
    pub(crate) fn of(class: PointClass) -> Self {
        Self { class, ..Self::default() }
    }
}

/// Class of every cluster of a labelled cloud: background, flying or unknown. `points` and `origin`
/// (position of the sensor) are in the frame of the map [m]. The map is not changed.
///
/// # Errors
/// [`Error::Length`], [`Error::Parameter`], [`Error::Memory`], [`Error::Interrupted`].
pub fn classify_clusters(
    map: &VoxelMap,
    points: &[[f32; 3]],
    labels: &[i32],
    origin: [f64; 3],
    parameters: &ClassifyParameters,
    workers: &Workers,
) -> Result<Vec<PointClass>, Error> {
    if labels.len() != points.len() {
        let (expected, got) = (points.len(), labels.len());
        return Err(Error::Length { name: "labels", expected, got });
    }
    let highest = points.len() as i64;
    if let Some(index) = labels.iter().position(|&label| i64::from(label) >= highest || label < -1)
    {
        return Err(Error::Value {
            name: "labels",
            expected: "-1, or the number of a cluster below the number of points",
            index,
            got: labels[index].to_string(),
        });
    }
    check_scan_memory(points.len())?;
    let (mut clusters, mut classifications) = (Clusters::default(), Vec::new());
    clusters.fill(points, labels);
    let rules = ClusterRules { map, points, origin, parameters };
    Classifier::default().classify(&rules, &clusters, workers.pool(), &mut classifications)?;
    Ok(classifications.into_iter().map(|classification| classification.class).collect())
}

/// Classifies the clusters of one scan after another, and keeps its memory.
#[derive(Default)]
pub(crate) struct Classifier {
    background: Vec<bool>,
    grouper: Grouper,
    scratch: ObjectPool<Scratch>,
}

impl Classifier {
    /// Diagonal of the group of cluster `index` in the last call [m].
    pub(super) fn group_extent(&self, index: usize) -> f64 {
        self.grouper.extent(index)
    }

    /// Classify every cluster on the present map. The results replace `classifications`.
    pub(crate) fn classify(
        &mut self,
        rules: &ClusterRules<'_>,
        clusters: &Clusters,
        pool: Option<&ThreadPool>,
        classifications: &mut Vec<Classification>,
    ) -> Result<(), Error> {
        let ClusterRules { map, points, parameters, .. } = *rules;
        let radius = search_radius(parameters.search_distance, map.lattice().voxel_size())?;
        check_steps("close_distance", parameters.close_distance, map.lattice().voxel_size())?;
        let Self { background, grouper, scratch } = self;
        let near =
            |index: usize| clusters.is_joined(index) || rules.is_background(&clusters.get(index));
        each(pool, clusters.len(), || (), |(), index| near(index), background)?;
        let groups = grouper.groups(points, clusters, background, parameters.group_distance)?;
        let classification = |scratch: &mut PooledObject<'_, Scratch>, index: usize| {
            if background[index] || groups[index].with_background {
                return Classification {
                    class: PointClass::Background,
                    ..Classification::default()
                };
            }
            let cluster = clusters.get(index);
            rules.flying_or_unknown(scratch, &cluster, groups[index].extent, radius)
        };
        each(pool, clusters.len(), || scratch.acquire(), classification, classifications)
    }
}

/// True if a box is at least `height` [m] high, and its horizontal diagonal at most two fifths of
/// its height.
fn is_upright([x, y, z]: [f64; 3], height: f64) -> bool {
    z >= height && libm::hypot(x, y) <= 0.4 * z
}

/// Put the result of `work` for every index below `count` into `found`, on the threads of the pool.
/// Every thread has a value made by `own`.
///
/// # Errors
/// [`Error::Interrupted`].
fn each<T: Default + Send, S>(
    pool: Option<&ThreadPool>,
    count: usize,
    own: impl Fn() -> S + Sync + Send,
    work: impl Fn(&mut S, usize) -> T + Sync + Send,
    found: &mut Vec<T>,
) -> Result<(), Error> {
    let watch = cancel::watch();
    let work = |own: &mut S, index: usize| {
        if watch.is_asked() { T::default() } else { watch.run(|| work(own, index)) }
    };
    match pool {
        Some(pool) => {
            let all = (0..count).into_par_iter().map_init(own, work);
            pool.install(|| all.collect_into_vec(found));
        }
        None => {
            let mut own = own();
            found.clear();
            found.extend((0..count).map(|index| work(&mut own, index)));
        }
    }
    watch.check()
}

/// Replace classifications by those of rule B on a later map. Clusters that are background by rule
/// A stay so.
pub(crate) fn reclassify(classifications: &mut [Classification], later: &mut [Classification]) {
    for (classification, later) in classifications
        .iter_mut()
        .zip(later)
        .filter(|(before, _)| before.class != PointClass::Background)
    {
        let class = if later.class == PointClass::Flying {
            PointClass::Flying
        } else {
            PointClass::Unknown
        };
        *classification = Classification { class, ..std::mem::take(later) };
    }
}

/// Working memory for the classification of one cluster, used again for the next one.
#[derive(Default)]
struct Scratch {
    flood: flood::Memory,
    /// Points of a cluster, its voxels, and the neighbours of these.
    points: Vec<[f64; 3]>,
    voxels: Vec<Voxel>,
    shell: Vec<Voxel>,
}

impl Scratch {
    fn take(&mut self, points: impl Iterator<Item = [f64; 3]>, lattice: &Lattice) {
        self.points.clear();
        self.points.extend(points);
        self.voxels.clear();
        self.voxels.extend(self.points.iter().filter_map(|&at| floor(lattice.scaled(at))));
        self.voxels.sort_unstable();
        self.voxels.dedup();
    }
}

/// Rules A to C for the clusters of one scan, with the map, points and parameters that they use.
#[derive(Clone, Copy)]
pub(crate) struct ClusterRules<'a> {
    pub(crate) map: &'a VoxelMap,
    pub(crate) points: &'a [[f32; 3]],
    /// Position of the sensor [m, frame of the map].
    pub(crate) origin: [f64; 3],
    pub(crate) parameters: &'a ClassifyParameters,
}

impl ClusterRules<'_> {
    /// True if a cluster is background by rule A, or too large to be a target.
    fn is_background(&self, cluster: &Cluster<'_>) -> bool {
        let too_large =
            self.parameters.background_extent.is_some_and(|extent| cluster.diagonal() > extent);
        let mut near = OccupiedNearby::new(self.map, self.parameters.close_distance);
        too_large
            || cluster.members.iter().any(|&row| near.is_close(wide(self.points[row as usize])))
    }

    /// Class of a cluster by rules B and C, after the limits on size, number of points and
    /// distance.
    fn flying_or_unknown(
        &self,
        scratch: &mut Scratch,
        cluster: &Cluster<'_>,
        group_extent: f64,
        radius: i32,
    ) -> Classification {
        let unknown = || Classification::of(PointClass::Unknown);
        if cluster.members.len() < self.parameters.min_points
            || self.is_gated(cluster, group_extent)
        {
            return unknown();
        }
        self.in_free_space(scratch, cluster, radius).unwrap_or_else(unknown)
    }

    /// True if free voxels surround a cluster as they surround a flying object. The number of its
    /// points does not matter.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a distance that cannot be searched.
    pub(crate) fn is_in_free_space(&self, cluster: &Cluster<'_>) -> Result<bool, Error> {
        let voxel_size = self.map.lattice().voxel_size();
        let radius = search_radius(self.parameters.search_distance, voxel_size)?;
        let found = || self.in_free_space(&mut Scratch::default(), cluster, radius);
        Ok(!self.is_gated(cluster, cluster.diagonal()) && found().is_some())
    }

    /// True if a cluster does not have the size and shape of a flying object, or is too far away.
    pub(crate) fn is_gated(&self, cluster: &Cluster<'_>, group_extent: f64) -> bool {
        let p = self.parameters;
        p.max_extent.is_some_and(|extent| group_extent > extent)
            || p.upright_height.is_some_and(|height| is_upright(cluster.extent(), height))
            || p.max_distance.is_some_and(|far| norm(minus(cluster.centroid, self.origin)) > far)
    }

    /// Rule B: the classification of a cluster as flying. None if it does not fly by this rule.
    fn in_free_space(
        &self,
        scratch: &mut Scratch,
        cluster: &Cluster<'_>,
        radius: i32,
    ) -> Option<Classification> {
        let (p, lattice) = (self.parameters, self.map.lattice());
        let points = cluster.members.iter().map(|&row| wide(self.points[row as usize]));
        scratch.take(points, lattice);
        let Scratch { flood, points, voxels, shell } = scratch;
        if !voxels.iter().all(|&voxel| self.map.admits(voxel)) {
            return None; // nothing is known outside the operating volume
        }
        let shadow = p.own_shadow.then(|| Shadow::of(points, self.origin, lattice));
        // What is uncertain within the cluster itself, or where it has just been, is no way out: that leads
        // away from it. Steps are counted from each voxel of it, those across it too.
        let across: f64 = cluster.extent().iter().sum();
        let away = if p.own_shadow { across + 0.5 * p.search_distance } else { 0.0 };
        let explored = if p.search_adds_extent || away > p.search_distance {
            let added = if p.search_adds_extent { cluster.diagonal() } else { 0.0 };
            let distance = (p.search_distance + added).max(away);
            let mut memory = flood::Memory::default(); // too much to keep
            let flood = Flood::wider(self.map, distance, p.open_border, p.expand_own, &mut memory);
            self.explored(flood, voxels, shadow.as_ref())
        } else {
            let flood = Flood::new(self.map, radius, p.open_border, p.expand_own, flood);
            self.explored(flood, voxels, shadow.as_ref())
        }?;
        let is_clear = self.clearance(voxels, shell, |_| true) >= p.min_clearance;
        is_clear.then(|| Classification {
            class: PointClass::Flying,
            explored,
            clearance: self.seen_clearance(voxels, shell, shadow.as_ref()),
            ..Classification::default()
        })
    }

    /// The classification of a cluster as flying if it has the right size and free voxels around
    /// it. Paths of uncertain voxels do not matter. None otherwise.
    pub(crate) fn in_free_shell(&self, cluster: &Cluster<'_>) -> Option<Classification> {
        let p = self.parameters;
        if cluster.members.len() < p.min_points || self.is_gated(cluster, cluster.diagonal()) {
            return None;
        }
        let mut scratch = Scratch::default();
        let points = cluster.members.iter().map(|&row| wide(self.points[row as usize]));
        scratch.take(points, self.map.lattice());
        let Scratch { points, voxels, shell, .. } = &mut scratch;
        let is_inside = voxels.iter().all(|&voxel| self.map.admits(voxel));
        let is_clear = is_inside && self.clearance(voxels, shell, |_| true) >= p.min_clearance;
        let shadow = p.own_shadow.then(|| Shadow::of(points, self.origin, self.map.lattice()));
        is_clear.then(|| Classification {
            class: PointClass::Flying,
            clearance: self.seen_clearance(voxels, shell, shadow.as_ref()),
            ..Classification::default()
        })
    }

    /// Uncertain voxels that the searches from `starts` have explored (empty unless pockets are to
    /// be made free). None if there is a way out.
    fn explored(
        &self,
        mut flood: Flood<'_>,
        starts: &[Voxel],
        shadow: Option<&Shadow<'_>>,
    ) -> Option<Vec<Voxel>> {
        let is_enclosed = flood.is_enclosed(starts, shadow);
        let is_wanted = self.parameters.fill_pockets;
        is_enclosed.then(|| if is_wanted { flood.take_explored() } else { Vec::new() })
    }

    /// Share of free voxels among those neighbours of a cluster's voxels that can be seen.
    /// Uncertain voxels in the cluster's own shadow do not count: no ray can show that they are
    /// free.
    fn seen_clearance(
        &self,
        voxels: &[Voxel],
        shell: &mut Vec<Voxel>,
        shadow: Option<&Shadow<'_>>,
    ) -> f64 {
        let mut cursor = Cursor::new(&self.map.blocks);
        let bound = self.map.uncertain_from();
        let mut can_be_seen = |voxel: Voxel| {
            let mut is_uncertain =
                || self.map.known(cursor.stored(voxel)) >= bound && !cursor.is_tentative(voxel);
            !is_uncertain() || !shadow.is_some_and(|shadow| shadow.hides(voxel))
        };
        self.clearance(voxels, shell, &mut can_be_seen)
    }

    /// Share of free voxels among those neighbours of a cluster's voxels for which `counts` is
    /// true.
    fn clearance(
        &self,
        voxels: &[Voxel],
        shell: &mut Vec<Voxel>,
        mut counts: impl FnMut(Voxel) -> bool,
    ) -> f64 {
        shell.clear();
        shell.extend(voxels.iter().flat_map(|&voxel| neighbours(voxel)));
        shell.sort_unstable();
        shell.dedup();
        shell.retain(|&voxel| voxels.binary_search(&voxel).is_err() && counts(voxel));
        let mut cursor = Cursor::new(&self.map.blocks);
        let bound = self.map.uncertain_from();
        let free =
            shell.iter().filter(|&&voxel| self.map.known(cursor.stored(voxel)) < bound).count();
        free as f64 / shell.len().max(1) as f64
    }
}
