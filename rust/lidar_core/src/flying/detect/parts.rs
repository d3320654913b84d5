//! Union of clusters that are parts of one large target.
//!
//! Where rays graze a wing, their ends are further apart than the gap inside a cluster, so the tips
//! of the wing are clusters of their own: from one row of rays to the next they are half a metre
//! further away. All parts together are one detection.

use crate::flying::classify::classifier::Classification;
use crate::flying::classify::clusters::{Cluster, Clusters};
use crate::flying::large_targets::{LARGE, PART_GAP};
use crate::flying::point_class::PointClass;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{dot, minus, norm};

/// Largest angle [rad] at which parts of a large target are seen beside each other, if one of them
/// is at most `BEHIND` [m] further away.
const BESIDE: f64 = 0.02;
/// Largest distance, and largest difference in range, of parts that are seen beside each other [m].
const BEHIND: f64 = 1.0;

/// Classified clusters of a scan, with the clusters of one large target united.
pub(crate) struct UnitedClusters<'c> {
    /// The united clusters. None if no large target has several parts.
    united: Option<Clusters>,
    items: Vec<(usize, &'c Classification)>,
}

impl<'c> UnitedClusters<'c> {
    /// Unite the flying clusters of `points` that are parts of one large target, as seen from
    /// `origin`; clusters of another class stay as they are. `classifications`: indices of
    /// clusters, with their classes. No united cluster is longer than `longest` [m]. None: nothing
    /// is united.
    pub(crate) fn of(
        points: &[[f32; 3]],
        origin: [f64; 3],
        clusters: &Clusters,
        classifications: impl Iterator<Item = (usize, &'c Classification)>,
        longest: Option<f64>,
    ) -> Self {
        let mut items: Vec<(usize, &Classification)> = classifications.collect();
        let flying: Vec<(usize, Cluster<'_>)> = items
            .iter()
            .filter(|(_, one)| one.class == PointClass::Flying)
            .map(|&(index, _)| (index, clusters.get(index)))
            .collect();
        let host = hosts(points, origin, clusters, &flying, longest);
        if host.is_empty() {
            return Self { united: None, items };
        }
        items.retain(|(index, _)| !host.iter().any(|(part, _)| part == index));
        // A part of a part belongs to the largest of them.
        let mut labels = vec![-1; points.len()];
        for (place, (index, _)) in items.iter().enumerate() {
            let parts =
                host.iter().map(|&(part, _)| part).filter(|&part| top_of(&host, part) == *index);
            for row in parts.chain([*index]).flat_map(|own| clusters.get(own).members) {
                labels[*row as usize] = place as i32;
            }
        }
        let mut united = Clusters::default();
        united.fill(points, &labels);
        Self { united: Some(united), items }
    }

    /// Each cluster with its class. `clusters`: those from which this was made.
    pub(crate) fn iter<'a>(
        &'a self,
        clusters: &'a Clusters,
    ) -> impl Iterator<Item = (Cluster<'a>, &'a Classification)> {
        self.items.iter().enumerate().map(move |(place, &(index, classification))| {
            let cluster = match &self.united {
                Some(united) => united.get(place),
                None => clusters.get(index),
            };
            (cluster, classification)
        })
    }
}

/// Each part of a large target among the `flying` clusters, and the cluster to which it belongs, as
/// pairs of cluster indices.
fn hosts(
    points: &[[f32; 3]],
    origin: [f64; 3],
    clusters: &Clusters,
    flying: &[(usize, Cluster<'_>)],
    longest: Option<f64>,
) -> Vec<(usize, usize)> {
    let large: Vec<(usize, Cluster<'_>)> =
        flying.iter().filter(|(_, one)| side(one) >= LARGE).copied().collect();
    let mut host: Vec<(usize, usize)> = Vec::new();
    // Of targets and the parts that they have got already.
    let mut spans: Vec<(usize, TargetSpan)> = Vec::new();
    for &(index, part) in flying.iter().filter(|_| !large.is_empty()) {
        let is_near = |(other, whole): &&(usize, Cluster<'_>)| {
            *other != index
                && (side(whole), *other) > (side(&part), index)
                && (gap(whole, &part) <= PART_GAP || are_beside(points, origin, whole, &part))
        };
        let whole = large
            .iter()
            .filter(is_near)
            .max_by(|(_, one), (_, other)| side(one).total_cmp(&side(other)));
        let Some((&(whole, _), longest)) = whole.zip(longest) else { continue };
        let top = top_of(&host, whole);
        let known = |number: usize| {
            let found = spans.iter().find(|(other, _)| *other == number);
            found.map_or_else(|| TargetSpan::of(points, &clusters.get(number)), |&(_, found)| found)
        };
        let together = known(top).united(&known(index));
        if together.length() <= longest {
            host.push((index, whole));
            spans.retain(|(other, _)| *other != top);
            spans.push((top, together));
        }
    }
    host
}

fn side(cluster: &Cluster<'_>) -> f64 {
    cluster.extent().into_iter().fold(0.0, f64::max)
}

/// Distance between the bounding boxes of two clusters [m].
fn gap(one: &Cluster<'_>, other: &Cluster<'_>) -> f64 {
    let away = |axis: usize| {
        (one.low[axis] - other.high[axis]).max(other.low[axis] - one.high[axis]).max(0.0)
    };
    norm([0, 1, 2].map(away))
}

/// Whether points of two clusters are seen beside each other from `origin`, at nearly the same
/// range.
fn are_beside(
    points: &[[f32; 3]],
    origin: [f64; 3],
    one: &Cluster<'_>,
    other: &Cluster<'_>,
) -> bool {
    if gap(one, other) > BEHIND {
        return false;
    }
    let seen = |row: &u32| {
        let way = minus(wide(points[*row as usize]), origin);
        let range = norm(way).max(f64::MIN_POSITIVE);
        (way.map(|part| part / range), range)
    };
    // Only what is near the other one's box can be: two targets may have ten thousand points each.
    let is_within = |row: &&u32, cluster: &Cluster<'_>| {
        let place = wide(points[**row as usize]);
        let reach = BEHIND + BESIDE * norm(minus(place, origin));
        let (low, high) = (cluster.low, cluster.high);
        (0..3).all(|axis| place[axis] >= low[axis] - reach && place[axis] <= high[axis] + reach)
    };
    let others: Vec<([f64; 3], f64)> =
        other.members.iter().filter(|row| is_within(row, one)).map(seen).collect();
    one.members.iter().filter(|row| is_within(row, other)).map(seen).any(|(way, range)| {
        let is_near = |&(beside, further): &([f64; 3], f64)| {
            (range - further).abs() <= BEHIND && norm(minus(way, beside)) <= BESIDE
        };
        others.iter().any(is_near)
    })
}

/// Directions to the faces, edges and corners of a cube, one of each opposite pair. Every direction
/// is within 28 degrees of one of these lines.
const WAYS: [[i8; 3]; 13] = [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [1, 1, 0],
    [1, -1, 0],
    [1, 0, 1],
    [1, 0, -1],
    [0, 1, 1],
    [0, 1, -1],
    [1, 1, 1],
    [1, 1, -1],
    [1, -1, 1],
    [1, -1, -1],
];

/// Extent of some points along each of [`WAYS`] [m]. The length of an axis-aligned box would change
/// as the target turns.
#[derive(Clone, Copy)]
struct TargetSpan {
    low: [f64; WAYS.len()],
    high: [f64; WAYS.len()],
}

impl TargetSpan {
    fn of(points: &[[f32; 3]], cluster: &Cluster<'_>) -> Self {
        let mut span =
            Self { low: [f64::INFINITY; WAYS.len()], high: [f64::NEG_INFINITY; WAYS.len()] };
        for &row in cluster.members {
            let point = wide(points[row as usize]);
            for (at, way) in WAYS.iter().enumerate() {
                let way = way.map(f64::from);
                let along = dot(point, way) / norm(way);
                span.low[at] = span.low[at].min(along);
                span.high[at] = span.high[at].max(along);
            }
        }
        span
    }

    /// Extent of the points of both spans.
    fn united(&self, other: &Self) -> Self {
        Self {
            low: std::array::from_fn(|at| self.low[at].min(other.low[at])),
            high: std::array::from_fn(|at| self.high[at].max(other.high[at])),
        }
    }

    /// Largest extent [m]. The distance of two points is larger than it by at most 13 %.
    fn length(&self) -> f64 {
        self.low.iter().zip(&self.high).map(|(low, high)| high - low).fold(0.0, f64::max)
    }
}

/// Index of the cluster to which the cluster `index` belongs, directly or through other parts. A
/// cluster that is no part belongs to itself.
fn top_of(host: &[(usize, usize)], mut index: usize) -> usize {
    while let Some(&(_, whole)) = host.iter().find(|(part, _)| *part == index) {
        index = whole;
    }
    index
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of points of the detections of a wing of `width` [m], whose tips are `apart` [m]
    /// from its ends. `is_one`: whether the first detection alone is returned.
    fn detected(width: f32, apart: f32, is_one: bool) -> Vec<usize> {
        let wing = (0..11).map(|step| [5.0, 0.1 * width * step as f32, 2.0]);
        let tip = (0..3).map(|step| [5.0, width + apart + 0.05 * step as f32, 2.0]);
        let other = (0..3).map(|step| [5.0, -apart - 0.05 * step as f32, 2.0]);
        let points: Vec<[f32; 3]> = wing.chain(tip).chain(other).collect();
        let points = if is_one { &points[..14] } else { &points[..] };
        let labels: Vec<i32> =
            (0..points.len()).map(|row| i32::from(row > 10) + i32::from(row > 13)).collect();
        let mut clusters = Clusters::default();
        clusters.fill(points, &labels);
        let flying = Classification { class: PointClass::Flying, ..Classification::default() };
        let all = (0..if is_one { 2 } else { 3 }).map(|index| (index, &flying));
        let united = UnitedClusters::of(points, [0.0; 3], &clusters, all, Some(2.5));
        united.iter(&clusters).map(|(cluster, _)| cluster.members.len()).collect()
    }

    #[test]
    fn a_wing_with_its_tip_is_as_long_however_it_is_turned() {
        // A cross of 2.2 m and 1.2 m, of which a tip is another cluster.
        let is_one = |turn: f32| {
            let (sine, cosine) = turn.to_radians().sin_cos();
            let place = |x: f32, y: f32| [9.0 + cosine * x - sine * y, sine * x + cosine * y, 2.0];
            let wing = (0..18).map(|step| place(0.0, -1.1 + 0.1 * step as f32));
            let body = (0..12).map(|step| place(-0.6 + 0.1 * step as f32, 0.0));
            let tip = (0..2).map(|step| place(0.0, 1.05 + 0.05 * step as f32));
            let points: Vec<[f32; 3]> = wing.chain(body).chain(tip).collect();
            let labels: Vec<i32> = (0..points.len()).map(|row| i32::from(row > 29)).collect();
            let mut clusters = Clusters::default();
            clusters.fill(&points, &labels);
            let flying = Classification { class: PointClass::Flying, ..Classification::default() };
            let all = (0..2).map(|index| (index, &flying));
            UnitedClusters::of(&points, [0.0; 3], &clusters, all, Some(2.3)).iter(&clusters).count()
                == 1
        };
        assert!([0.0, 20.0, 45.0, 70.0, 90.0].into_iter().all(is_one));
    }

    #[test]
    fn the_next_row_on_a_wing_is_a_part_of_it_and_what_is_seen_elsewhere_is_not() {
        // A wing along the line of sight whose far tip is seen one row of rays above the rest.
        let is_one = |aside: f32, along: f32| {
            let wing = (0..11).map(|step| [7.0 + 0.08 * step as f32, 0.0, 1.0]);
            let range = 7.8 + along;
            let tip = (0..3).map(|step| [range, aside + 0.03 * step as f32, range * 1.1 / 7.8]);
            let points: Vec<[f32; 3]> = wing.chain(tip).collect();
            let labels: Vec<i32> = (0..points.len()).map(|row| i32::from(row > 10)).collect();
            let mut clusters = Clusters::default();
            clusters.fill(&points, &labels);
            let flying = Classification { class: PointClass::Flying, ..Classification::default() };
            let all = (0..2).map(|index| (index, &flying));
            let united = UnitedClusters::of(&points, [0.0; 3], &clusters, all, Some(2.5));
            united.iter(&clusters).count() == 1
        };
        assert!(is_one(0.0, 0.7));
        assert!(!is_one(0.6, 0.7), "beside it");
        assert!(!is_one(0.0, 1.3), "far behind it");
    }

    #[test]
    fn tips_of_wings_are_parts_and_targets_beside_each_other_are_not() {
        assert_eq!(detected(1.5, 0.45, true), [14]);
        assert_eq!(detected(1.5, 0.6, true), [11, 3]);
        assert_eq!(detected(0.7, 0.45, true), [11, 3], "two small targets");
        assert_eq!(detected(2.3, 0.45, true), [11, 3], "too long for a target");
        assert_eq!(detected(1.3, 0.35, false), [17]);
        assert_eq!(detected(1.6, 0.45, false), [14, 3], "too long with the second tip");
    }
}
