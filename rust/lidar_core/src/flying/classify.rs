//! Clusters of one scan -> background, flying or unknown. Source: Vrba et al., sec. III-B.

use super::blocks::{Cursor, Place, offset_of};
use super::group::groups;
use super::integrate::{BACKGROUND, FLYING, UNKNOWN};
use super::separate::row_bits;
use super::shadow::Shadow;
use super::track::Occupancy;
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
    /// A search that leaves a fixed operating volume: true finds a way out, false a wall.
    pub open_border: bool,
    /// Never-observed voxels in a cluster's own shadow do not connect it.
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
    /// Enclosed uncertain voxels around a flying cluster are made free.
    pub fill_pockets: bool,
}

/// A cluster: rows of its points, and what is known of its shape.
pub(crate) struct Cluster {
    pub(crate) members: Vec<u32>,
    pub(crate) low: [f64; 3],
    pub(crate) high: [f64; 3],
    pub(crate) centroid: [f64; 3],
}

impl Cluster {
    /// Clusters of a labelled cloud, in the order of their labels; points that are not finite
    /// belong to none.
    pub(crate) fn all(points: &[[f32; 3]], labels: &[i32]) -> Vec<Self> {
        let count = labels.iter().max().map_or(0, |&last| (last + 1).max(0) as usize);
        let mut members = vec![Vec::new(); count];
        for (row, &label) in labels.iter().enumerate() {
            let Ok(cluster) = usize::try_from(label) else { continue };
            if points[row].iter().all(|value| value.is_finite()) {
                members[cluster].push(row as u32);
            }
        }
        members.into_iter().map(|members| Self::of(points, members)).collect()
    }

    fn of(points: &[[f32; 3]], members: Vec<u32>) -> Self {
        if members.is_empty() {
            return Self { members, low: [0.0; 3], high: [0.0; 3], centroid: [0.0; 3] };
        }
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        let mut sum = [0.0; 3];
        for &row in &members {
            let point = wide(points[row as usize]);
            for axis in 0..3 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
                sum[axis] += point[axis];
            }
        }
        let count = members.len() as f64;
        Self { members, low, high, centroid: sum.map(|value| value / count) }
    }

    /// Edges of its box [m].
    pub(crate) fn extent(&self) -> [f64; 3] {
        minus(self.high, self.low)
    }

    /// Diagonal of its box [m].
    pub(crate) fn diagonal(&self) -> f64 {
        norm(self.extent())
    }
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

impl VoxelMap {
    /// Whether one cluster of points is surrounded by free voxels (Algorithm 1): no path of
    /// uncertain voxels leads from any of its points to a tentatively occupied voxel, or
    /// `search_distance` [m] away (L1). An empty cluster is not floating.
    ///
    /// # Errors
    /// [`Error::PointOutOfRange`] for a point that cannot be indexed, [`Error::Parameter`].
    pub fn is_floating(&self, points: &[[f32; 3]], search_distance: f64) -> Result<bool, Error> {
        let radius = search_radius(search_distance, self.lattice().voxel_size())?;
        let mut starts = Vec::new();
        for &point in points {
            starts.push(self.lattice().voxel_at(wide(point))?);
        }
        let mut flood = Flood::new(self, radius, true, false);
        Ok(flood.is_enclosed(&distinct(starts), None))
    }
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
    let clusters = Cluster::all(points, labels);
    let verdicts = classify(map, points, &clusters, origin, parameters)?;
    Ok(verdicts.into_iter().map(|verdict| verdict.class).collect())
}

/// Largest L1 distance that a search may still expand, in voxels; it has found a way out one
/// step further (A1:21, `>= d_search`).
fn search_radius(search_distance: f64, voxel_size: f64) -> Result<i32, Error> {
    let steps = check_steps("search_distance", search_distance, voxel_size)?;
    Ok((steps - 1e-9).ceil() as i32)
}

/// A distance in voxels: searches grow with its cube.
fn check_steps(name: &'static str, distance: f64, voxel_size: f64) -> Result<f64, Error> {
    let steps = distance / voxel_size;
    if !(steps > 0.0 && steps <= 128.0) {
        let got = format!("{distance} m");
        return Err(Error::Parameter { name, expected: "0 to 128 voxels", got });
    }
    Ok(steps)
}

/// Classify the clusters of a scan on the map as it is before this scan's update.
pub(crate) fn classify(
    map: &VoxelMap,
    points: &[[f32; 3]],
    clusters: &[Cluster],
    origin: [f64; 3],
    parameters: &ClassifyParameters,
) -> Result<Vec<Verdict>, Error> {
    let radius = search_radius(parameters.search_distance, map.lattice().voxel_size())?;
    check_steps("close_distance", parameters.close_distance, map.lattice().voxel_size())?;
    let judge = Judge { map, points, origin, parameters };
    let near = |cluster: &Cluster| judge.is_background(cluster);
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

struct Judge<'a> {
    map: &'a VoxelMap,
    points: &'a [[f32; 3]],
    origin: [f64; 3],
    parameters: &'a ClassifyParameters,
}

impl Judge<'_> {
    /// Rule A, or too large to be a target.
    fn is_background(&self, cluster: &Cluster) -> bool {
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
        cluster: &Cluster,
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
        let shadow = p.own_shadow.then(|| Shadow::of(&points, self.origin, lattice));
        if !flood.is_enclosed(&starts, shadow.as_ref()) {
            return unknown;
        }
        let clearance = self.clearance(&starts);
        Verdict { class: FLYING, explored: flood.take_explored(), clearance }
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

/// Rule A for single points: is a tentatively occupied voxel's centre closer than `distance`?
pub(crate) struct Near<'a> {
    cursor: Cursor<'a>,
    map: &'a VoxelMap,
    /// Squared distances below this are close [m^2].
    limit: f64,
    half: i32,
}

impl<'a> Near<'a> {
    pub(crate) fn new(map: &'a VoxelMap, distance: f64) -> Self {
        // A centre that close lies at most this many voxels from the point's own.
        let half = (distance / map.lattice().voxel_size() + 0.5).floor() as i32;
        Self { cursor: Cursor::new(&map.blocks), map, limit: distance * distance, half }
    }

    /// The same, but exactly `distance` is close too.
    fn up_to(map: &'a VoxelMap, distance: f64) -> Self {
        let near = Self::new(map, distance);
        Self { limit: near.limit.next_up(), ..near }
    }

    pub(crate) fn is_close(&mut self, point: [f64; 3]) -> bool {
        let lattice = self.map.lattice();
        let Some(home) = floor(lattice.scaled(point)) else { return false };
        let limit = self.limit;
        let near = |voxel: Voxel| {
            let [x, y, z] = minus(lattice.center(voxel), point);
            x * x + y * y + z * z < limit
        };
        if self.cursor.is_tentative(home) && near(home) {
            return true; // the usual case on known background
        }
        for z in home[2] - self.half..=home[2] + self.half {
            for y in home[1] - self.half..=home[1] + self.half {
                let (mut x, end) = (home[0] - self.half, home[0] + self.half);
                while x <= end {
                    let wall = (x & !7) + 8;
                    if let Some(block) = self.cursor.block(Place::of([x, y, z])) {
                        let mut row = row_bits(block, [x, y, z]) >> (x & 7);
                        let mut at = x;
                        while row != 0 && at <= end {
                            if row & 1 == 1 && near([at, y, z]) {
                                return true;
                            }
                            row >>= 1;
                            at += 1;
                        }
                    }
                    x = wall;
                }
            }
        }
        false
    }
}

impl Occupancy for VoxelMap {
    fn any_within(&self, point: [f64; 3], distance: f64) -> bool {
        Near::up_to(self, distance).is_close(point)
    }
}

/// Algorithm 1: breadth-first search over uncertain voxels, nodes marked when pushed.
struct Flood<'a> {
    map: &'a VoxelMap,
    cursor: Cursor<'a>,
    /// Steps that end the search.
    radius: i32,
    open_border: bool,
    expand_own: bool,
    /// Number of the search that last met a voxel of the cube around the start.
    met: Vec<u16>,
    search: u16,
    queue: Vec<Voxel>,
    explored: Vec<Voxel>,
}

impl<'a> Flood<'a> {
    fn new(map: &'a VoxelMap, radius: i32, open_border: bool, expand_own: bool) -> Self {
        let edge = 2 * radius as usize + 1;
        Self {
            map,
            cursor: Cursor::new(&map.blocks),
            radius,
            open_border,
            expand_own,
            met: vec![0; edge * edge * edge],
            search: 0,
            queue: Vec::new(),
            explored: Vec::new(),
        }
    }

    /// Whether no search from any of `starts` finds a way out.
    fn is_enclosed(&mut self, starts: &[Voxel], shadow: Option<&Shadow>) -> bool {
        self.explored.clear();
        !starts.is_empty() && starts.iter().all(|&start| !self.finds_a_way_out(start, shadow))
    }

    /// Uncertain voxels that the searches explored.
    fn take_explored(&mut self) -> Vec<Voxel> {
        distinct(std::mem::take(&mut self.explored))
    }

    fn finds_a_way_out(&mut self, start: Voxel, shadow: Option<&Shadow>) -> bool {
        self.begin();
        self.push(start, start);
        let mut next = 0;
        while let Some(&voxel) = self.queue.get(next) {
            next += 1;
            let stored = self.cursor.stored(voxel);
            let value = self.map.known(stored);
            if value >= self.map.tentative_from() {
                return true; // A1:15
            }
            if value < self.map.uncertain_from() && !(self.expand_own && voxel == start) {
                continue; // free voxels are not expanded, A1:31
            }
            if stored.is_nan() && shadow.is_some_and(|shadow| shadow.hides(voxel)) {
                continue;
            }
            if steps(voxel, start) >= self.radius {
                return true; // A1:21
            }
            self.explored.push(voxel);
            for beside in neighbours(voxel) {
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
        self.queue.clear();
        self.search = self.search.wrapping_add(1);
        if self.search == 0 {
            self.met.fill(0);
            self.search = 1;
        }
    }

    /// Queue a voxel unless this search has met it. Voxels are at most `radius` steps away.
    fn push(&mut self, voxel: Voxel, start: Voxel) {
        let edge = 2 * self.radius + 1;
        let [x, y, z]: [i32; 3] =
            std::array::from_fn(|axis| voxel[axis] - start[axis] + self.radius);
        let met = &mut self.met[((z * edge + y) * edge + x) as usize];
        if *met != self.search {
            *met = self.search;
            self.queue.push(voxel);
        }
    }
}

fn steps(a: Voxel, b: Voxel) -> i32 {
    (0..3).map(|axis| (a[axis] - b[axis]).abs()).sum()
}

fn neighbours([x, y, z]: Voxel) -> [Voxel; 6] {
    [[x - 1, y, z], [x + 1, y, z], [x, y - 1, z], [x, y + 1, z], [x, y, z - 1], [x, y, z + 1]]
}

fn distinct(mut voxels: Vec<Voxel>) -> Vec<Voxel> {
    voxels.sort_unstable();
    voxels.dedup();
    voxels
}

/// Whether the map holds `voxel` as free; used by the pipeline's checks of a pose.
pub(crate) fn is_observed_free(map: &VoxelMap, cursor: &mut Cursor<'_>, voxel: Voxel) -> bool {
    cursor
        .block(Place::of(voxel))
        .is_some_and(|block| block.values[offset_of(voxel)] < map.uncertain_from())
}
