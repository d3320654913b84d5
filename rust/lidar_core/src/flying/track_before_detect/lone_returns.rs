//! Lone returns: small clusters of a scan that are alone in the air.

use super::ScanOfFew;
use super::seen_ranges::{SeenRanges, SeenScan};
use crate::flying::classify::clusters::Cluster;
use crate::flying::classify::may_fly::may_fly;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{dot, minus, norm};

/// Largest number of returns of a lone target.
const MOST_POINTS: usize = 12;
/// Largest distance of a lone target's returns from their middle [m]; `OWN_GAPS`: alternatively, in
/// distances between rays.
const OWN: f64 = 0.75;
/// The same distance as [`OWN`], in distances between rays. The larger one counts.
const OWN_GAPS: f64 = 1.2;
/// Distance within which no other returns may be [m].
const ALONE: f64 = 2.0;
/// The same distance as [`ALONE`], in distances between rays. The larger one counts.
const ALONE_GAPS: f64 = 2.5;
/// Distance between rays below which targets give enough returns for a detection [m]. With 0.25 m, small drones 8 to
/// 11 m from a Mid-360 had no track: ADR 0011.
const DENSE: f64 = 0.1;
/// Standard deviation of a lone return around the centre of its target, in distances between
/// rays: targets of one or two returns are about as large as these.
const SPREAD: f64 = 0.3;
/// Standard deviation of a range [m], in addition to [`SPREAD`].
const RANGE_STD: f64 = 0.05;

/// A lone return, or a few returns of the same target.
#[derive(Clone, Copy, Debug)]
pub(super) struct LoneReturn {
    /// Centroid of its points [m, frame of the map].
    pub(super) place: [f64; 3],
    /// Mean time of its points after the stamp of the scan [s].
    pub(super) delay: f64,
    /// Standard deviation of the position around the centre of the target [m].
    pub(super) std: f64,
    /// Distance between neighbouring rays at its range [m].
    pub(super) gap: f64,
    /// Angle above the level plane of the sensor [rad].
    pub(super) elevation: f64,
}

/// Lone returns of one scan. It keeps its memory for the next scan.
#[derive(Default)]
pub(super) struct LoneReturns {
    pub(super) found: Vec<LoneReturn>,
    /// Indices of their points, ascending.
    rows: Vec<u32>,
    /// Indices of the clusters with few points, sorted along x.
    small: Vec<u32>,
    is_small: Vec<bool>,
}

impl LoneReturns {
    /// Whether the point `row` belongs to a lone return.
    pub(super) fn holds(&self, row: u32) -> bool {
        self.rows.binary_search(&row).is_ok()
    }

    /// Find the lone returns of a scan. Returns the ranges that its other returns show.
    pub(super) fn find(&mut self, input: &ScanOfFew<'_>, seen: &SeenRanges) -> SeenScan {
        let origin = input.scan.pose.translation;
        self.find_small(input);
        let mut scan = SeenScan::new(origin);
        let mut n_returns = 0_usize;
        let observation = input.scan.sky_observation.as_ref();
        let is_droplet = observation.map_or(&[][..], |observation| observation.is_droplet());
        for (row, &point) in input.scan.points.iter().enumerate().take(input.scan.rows) {
            let is_droplet = is_droplet.get(row).is_some_and(|&is_droplet| is_droplet);
            if point[0].is_finite() && !input.scan.no_return[row] && !is_droplet {
                n_returns += 1;
                if !self.is_small[row] {
                    scan.add(wide(point));
                }
            }
        }
        let density = n_returns as f64 / scan.solid_angle().max(1e-3);
        let gap = 1.0 / density.max(1.0).sqrt();
        let alone: Vec<u32> = self.take_alone(input, &mut scan, gap);
        self.found.clear();
        self.rows.clear();
        for index in alone {
            let cluster = input.clusters.get(index as usize);
            let range = norm(minus(cluster.centroid, origin));
            if !is_sought(input, &cluster, range, gap * range)
                || !may_fly(input.map, input.scan, &cluster)
                || !scan.is_clear(cluster.centroid)
                || !seen.was_clear(cluster.centroid, input.stamp_ns)
            {
                continue;
            }
            self.rows.extend(cluster.members);
            self.found.push(lone(input, &cluster, gap * range));
        }
        self.rows.sort_unstable();
        scan
    }

    /// Find the clusters with few points, and sort them along x.
    fn find_small(&mut self, input: &ScanOfFew<'_>) {
        let Self { small, is_small, .. } = self;
        small.clear();
        is_small.clear();
        is_small.resize(input.scan.points.len(), false);
        for (index, cluster) in input.clusters.iter().enumerate() {
            let is_few = (1..=MOST_POINTS).contains(&cluster.members.len());
            if is_few && !input.clusters.is_joined(index) {
                small.push(index as u32);
                cluster.members.iter().for_each(|&row| is_small[row as usize] = true);
            }
        }
        let first = |index: u32| input.clusters.get(index as usize).centroid[0];
        small.sort_by(|&one, &other| first(one).total_cmp(&first(other)).then(one.cmp(&other)));
    }

    /// Indices of the small clusters that have no others beside them. The returns of the other small clusters are added
    /// to the ranges of `scan`.
    fn take_alone(&self, input: &ScanOfFew<'_>, scan: &mut SeenScan, gap: f64) -> Vec<u32> {
        let mut alone = Vec::new();
        for at in 0..self.small.len() {
            match self.place_among(input, at, gap) {
                Among::Alone => alone.push(self.small[at]),
                Among::Represented => {}
                Among::Others => {
                    let members = input.clusters.get(self.small[at] as usize).members;
                    members.iter().for_each(|&row| scan.add(wide(input.scan.points[row as usize])));
                }
            }
        }
        alone
    }

    /// Surroundings of the small cluster at index `at` of the sorted list. `gap`: angle between rays [rad].
    fn place_among(&self, input: &ScanOfFew<'_>, at: usize, gap: f64) -> Among {
        let cluster = |at: usize| input.clusters.get(self.small[at] as usize);
        let own_cluster = cluster(at);
        let centroid = own_cluster.centroid;
        let gap = gap * norm(minus(centroid, input.scan.pose.translation));
        let (own, around) = (OWN.max(OWN_GAPS * gap), ALONE.max(ALONE_GAPS * gap));
        if own_cluster.diagonal() > 2.0 * own {
            return Among::Others;
        }
        let is_within = |other: &usize| (cluster(*other).centroid[0] - centroid[0]).abs() <= around;
        let away = |other: usize| norm(minus(cluster(other).centroid, centroid));
        let before = || (0..at).rev().take_while(is_within);
        let after = || (at + 1..self.small.len()).take_while(is_within);
        if before().chain(after()).map(away).any(|away| away > own && away <= around) {
            return Among::Others;
        }
        // One of the same target stands for all.
        if before().any(|other| away(other) <= own) { Among::Represented } else { Among::Alone }
    }
}

/// Surroundings of a small cluster.
enum Among {
    /// Nothing is beside it.
    Alone,
    /// Another cluster of the same target, which is used in its place.
    Represented,
    /// More returns are near it than one target gives.
    Others,
}

/// Whether a target at this range is one that the detection in single scans does not find. `gap`:
/// distance between rays [m].
fn is_sought(input: &ScanOfFew<'_>, cluster: &Cluster<'_>, range: f64, gap: f64) -> bool {
    let p = input.parameters;
    let is_beyond = p.max_distance.is_some_and(|far| range > far);
    let is_sparse = gap >= DENSE && cluster.members.len() < p.min_points;
    range <= input.max_distance
        && (is_beyond || is_sparse)
        && p.max_extent.is_none_or(|extent| cluster.diagonal() <= extent)
}

fn lone(input: &ScanOfFew<'_>, cluster: &Cluster<'_>, gap: f64) -> LoneReturn {
    let delays = input.scan.delays.as_ref();
    let delay = |&row: &u32| delays.map_or(0.0, |delays| f64::from(delays[row as usize]));
    let count = cluster.members.len() as f64;
    let span = minus(cluster.centroid, input.scan.pose.translation);
    let up = [0, 1, 2].map(|axis| input.scan.pose.rotation[axis][2]);
    LoneReturn {
        place: cluster.centroid,
        delay: cluster.members.iter().map(delay).sum::<f64>() / count,
        std: (SPREAD * gap).hypot(RANGE_STD),
        gap,
        elevation: libm::asin((dot(up, span) / norm(span).max(f64::MIN_POSITIVE)).clamp(-1.0, 1.0)),
    }
}
