//! Clusters of one scan -> background, flying or unknown. Source: Vrba et al., sec. III-B.

use super::blocks::Cursor;
use super::clusters::Cluster;
use super::flood::{Flood, check_steps, distinct, neighbours, search_radius};
use super::group::groups;
use super::integrate::{BACKGROUND, FLYING, UNKNOWN};
use super::near::Near;
use super::shadow::Shadow;
use super::voxel_map::VoxelMap;
use crate::Error;
use crate::geometry::lattice::{Voxel, floor, wide};
use crate::geometry::transform::{minus, norm};
use rayon::prelude::*;

/// How clusters are told apart.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassifyParameters {
    /// Rule A: closer than this to an occupied voxel is background, d_close [m].
    pub close_distance: f64,
    /// Rule B: a path of uncertain voxels this long (L1) ends the search, d_search [m].
    pub search_distance: f64,
    /// The diagonal of a cluster's box is added to its search distance.
    pub search_adds_extent: bool,
    /// Rule B is judged on the map after this scan's update, not before.
    pub after_update: bool,
    /// A search that leaves a fixed operating volume: true finds a way out, false a wall.
    pub open_border: bool,
    /// Uncertain voxels in a cluster's own shadow do not connect it.
    pub own_shadow: bool,
    /// The search goes on from the voxels of a cluster even where they are free, so that one that
    /// touches what has never been observed is connected. A wall seen at a grazing angle lies in
    /// voxels that the rays along it have freed.
    pub expand_own: bool,
    /// Larger clusters are no flying object [m].
    pub max_extent: Option<f64>,
    /// Larger clusters are background [m].
    pub background_extent: Option<f64>,
    /// Smaller clusters are no flying object.
    pub min_points: usize,
    /// Clusters further from the sensor are no flying object [m].
    pub max_distance: Option<f64>,
    /// Clusters with gaps up to this are judged together: by their common extent, and as
    /// background if background of this scan is among them [m].
    pub group_distance: Option<f64>,
    /// A flying object has at least this share of free voxels among the neighbours of its own.
    pub min_clearance: f64,
    /// Unknown clusters that a confirmed track follows are flying objects, however little is known
    /// of what is around them.
    pub follow_tracks: bool,
    /// Enclosed uncertain voxels around a flying cluster are made free.
    pub fill_pockets: bool,
}

/// What classification found for one cluster.
#[derive(Clone, Debug, Default)]
pub(crate) struct Verdict {
    pub(crate) class: u8,
    /// Uncertain voxels that a flying cluster's searches explored.
    pub(crate) explored: Vec<Voxel>,
    /// Share of free voxels in the shell around a flying cluster.
    pub(crate) clearance: f64,
}

/// Class of every cluster of a labelled cloud in the frame of the map, seen from `origin`: 1
/// background, 2 flying, 3 unknown. The map stays as it is.
///
/// # Errors
/// [`Error::Length`], [`Error::Parameter`].
pub fn classify_clusters(
    map: &VoxelMap,
    points: &[[f32; 3]],
    labels: &[i32],
    origin: [f64; 3],
    parameters: &ClassifyParameters,
) -> Result<Vec<u8>, Error> {
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
    let mut rows = Vec::new();
    let clusters = Cluster::all(points, labels, &mut rows);
    let verdicts = classify(map, points, &clusters, origin, parameters)?;
    Ok(verdicts.into_iter().map(|verdict| verdict.class).collect())
}

/// Classify the clusters of a scan on the map as it is before this scan's update.
pub(crate) fn classify(
    map: &VoxelMap,
    points: &[[f32; 3]],
    clusters: &[Cluster<'_>],
    origin: [f64; 3],
    parameters: &ClassifyParameters,
) -> Result<Vec<Verdict>, Error> {
    let radius = search_radius(parameters.search_distance, map.lattice().voxel_size())?;
    check_steps("close_distance", parameters.close_distance, map.lattice().voxel_size())?;
    let judge = Judge { map, points, origin, parameters };
    let near = |cluster: &Cluster<'_>| judge.is_background(cluster);
    let background: Vec<bool> = match &map.pool {
        Some(pool) => pool.install(|| clusters.par_iter().map(near).collect()),
        None => clusters.iter().map(near).collect(),
    };
    let groups = groups(points, clusters, &background, parameters.group_distance)?;
    let flood = || Flood::new(map, radius, parameters.open_border, parameters.expand_own);
    let verdict = |flood: &mut Flood<'_>, (index, cluster): (usize, &Cluster)| {
        if background[index] || groups[index].with_background {
            return Verdict { class: BACKGROUND, ..Verdict::default() };
        }
        judge.flying_or_unknown(flood, cluster, groups[index].extent)
    };
    Ok(match &map.pool {
        Some(pool) => {
            pool.install(|| clusters.par_iter().enumerate().map_init(flood, verdict).collect())
        }
        None => {
            let mut flood = flood();
            clusters.iter().enumerate().map(|entry| verdict(&mut flood, entry)).collect()
        }
    })
}

/// Rule B judged on a later map; what rule A said stays.
pub(crate) fn judge_again(verdicts: &mut [Verdict], later: Vec<Verdict>) {
    for (verdict, later) in verdicts.iter_mut().zip(later).filter(|(v, _)| v.class != BACKGROUND) {
        let class = if later.class == FLYING { FLYING } else { UNKNOWN };
        *verdict = Verdict { class, ..later };
    }
}

struct Judge<'a> {
    map: &'a VoxelMap,
    points: &'a [[f32; 3]],
    origin: [f64; 3],
    parameters: &'a ClassifyParameters,
}

impl Judge<'_> {
    /// Rule A, or too large to be a target.
    fn is_background(&self, cluster: &Cluster<'_>) -> bool {
        let too_large =
            self.parameters.background_extent.is_some_and(|extent| cluster.diagonal() > extent);
        let mut near = Near::new(self.map, self.parameters.close_distance);
        too_large
            || cluster.members.iter().any(|&row| near.is_close(wide(self.points[row as usize])))
    }

    /// Rules B and C, after the gates on size, number and distance.
    fn flying_or_unknown(
        &self,
        flood: &mut Flood<'_>,
        cluster: &Cluster<'_>,
        group_extent: f64,
    ) -> Verdict {
        let p = self.parameters;
        let unknown = Verdict { class: UNKNOWN, ..Verdict::default() };
        let gated = cluster.members.len() < p.min_points
            || p.max_extent.is_some_and(|extent| group_extent > extent)
            || p.max_distance.is_some_and(|far| norm(minus(cluster.centroid, self.origin)) > far);
        if gated {
            return unknown;
        }
        let points: Vec<[f64; 3]> =
            cluster.members.iter().map(|&row| wide(self.points[row as usize])).collect();
        let lattice = self.map.lattice();
        let starts = distinct(points.iter().filter_map(|&p| floor(lattice.scaled(p))).collect());
        if !starts.iter().all(|&voxel| self.map.admits(voxel)) {
            return unknown; // nothing is known outside the operating volume
        }
        let shadow = p.own_shadow.then(|| Shadow::of(&points, self.origin, lattice));
        let search = |flood: &mut Flood<'_>| {
            (flood.is_enclosed(&starts, shadow.as_ref()), flood.take_explored())
        };
        let (enclosed, explored) = if p.search_adds_extent {
            let distance = p.search_distance + cluster.diagonal();
            search(&mut Flood::wider(self.map, distance, p.open_border, p.expand_own))
        } else {
            search(flood)
        };
        let clearance = if enclosed { self.clearance(&starts) } else { 0.0 };
        if !enclosed || clearance < p.min_clearance {
            return unknown;
        }
        Verdict { class: FLYING, explored, clearance }
    }

    /// Share of free voxels among the neighbours of a cluster's voxels.
    fn clearance(&self, voxels: &[Voxel]) -> f64 {
        let mut shell: Vec<Voxel> = voxels.iter().flat_map(|&voxel| neighbours(voxel)).collect();
        shell.sort_unstable();
        shell.dedup();
        shell.retain(|voxel| voxels.binary_search(voxel).is_err());
        let mut cursor = Cursor::new(&self.map.blocks);
        let bound = self.map.uncertain_from();
        let free =
            shell.iter().filter(|&&voxel| self.map.known(cursor.stored(voxel)) < bound).count();
        free as f64 / shell.len().max(1) as f64
    }
}
