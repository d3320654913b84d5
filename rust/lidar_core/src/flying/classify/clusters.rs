//! Clusters of a labelled cloud, and their shapes.

use crate::geometry::lattice::wide;
use crate::geometry::transform::{minus, norm};

/// Clusters of a labelled cloud, in the order of their labels.
#[derive(Default)]
pub(crate) struct Clusters {
    /// Indices of the points of all clusters, cluster by cluster.
    rows: Vec<u32>,
    /// End of each cluster in `rows`.
    ends: Vec<u32>,
    shapes: Vec<Shape>,
    /// Index of the cluster of points that are background without regard to the points linked to them.
    joined: Option<usize>,
}

/// Lowest and highest corner of the box around a cluster, and its centroid [m].
#[derive(Clone, Copy)]
struct Shape {
    low: [f32; 3],
    high: [f32; 3],
    centroid: [f64; 3],
}

impl Clusters {
    /// Set the clusters from the labels of a cloud. Points that are not finite belong to no
    /// cluster.
    pub(crate) fn fill(&mut self, points: &[[f32; 3]], labels: &[i32]) {
        self.joined = None;
        self.fill_with(points, labels, || 0..labels.len() as u32);
    }

    /// Set the clusters from the labels of a cloud. Only the points with the indices `rows` become members. The other
    /// points belong to the cluster `joined`, which is background.
    pub(crate) fn fill_some(
        &mut self,
        points: &[[f32; 3]],
        labels: &[i32],
        joined: usize,
        rows: &[u32],
    ) {
        self.joined = Some(joined);
        self.fill_with(points, labels, || rows.iter().copied());
    }

    fn fill_with<I: Iterator<Item = u32>>(
        &mut self,
        points: &[[f32; 3]],
        labels: &[i32],
        all: impl Fn() -> I,
    ) {
        let Self { rows, ends, shapes, .. } = self;
        let count = labels.iter().max().map_or(0, |&last| (last + 1).max(0) as usize);
        let label = |row: u32| label_of((row, (&points[row as usize], &labels[row as usize])));
        let labelled = || all().filter_map(label);
        ends.clear();
        ends.resize(count + 1, 0);
        labelled().for_each(|(_, label)| ends[label + 1] += 1);
        for label in 0..count {
            ends[label + 1] += ends[label];
        }
        rows.clear();
        rows.resize(ends[count] as usize, 0);
        for (row, label) in labelled() {
            rows[ends[label] as usize] = row; // where the cluster begins, at first
            ends[label] += 1;
        }
        ends.truncate(count);
        shapes.clear();
        let mut start = 0;
        shapes.extend(ends.iter().map(|&end| {
            let members = &rows[std::mem::replace(&mut start, end as usize)..end as usize];
            Shape::of(points, members)
        }));
    }

    /// Number of clusters.
    pub(crate) fn len(&self) -> usize {
        self.shapes.len()
    }

    /// True for the cluster of points that are background without regard to the points linked to them.
    pub(crate) fn is_joined(&self, index: usize) -> bool {
        self.joined == Some(index)
    }

    pub(crate) fn get(&self, index: usize) -> Cluster<'_> {
        let start = index.checked_sub(1).map_or(0, |before| self.ends[before] as usize);
        let members = &self.rows[start..self.ends[index] as usize];
        let Shape { low, high, centroid } = self.shapes[index];
        Cluster { members, low: wide(low), high: wide(high), centroid }
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = Cluster<'_>> {
        (0..self.len()).map(|index| self.get(index))
    }
}

/// A cluster: indices of its points, its box, and its centroid [m].
#[derive(Clone, Copy)]
pub(crate) struct Cluster<'a> {
    pub(crate) members: &'a [u32],
    pub(crate) low: [f64; 3],
    pub(crate) high: [f64; 3],
    pub(crate) centroid: [f64; 3],
}

impl Cluster<'_> {
    /// Sides of its bounding box [m].
    pub(crate) fn extent(&self) -> [f64; 3] {
        minus(self.high, self.low)
    }

    /// Diagonal of its bounding box [m].
    pub(crate) fn diagonal(&self) -> f64 {
        norm(self.extent())
    }
}

impl Shape {
    fn of(points: &[[f32; 3]], members: &[u32]) -> Self {
        if members.is_empty() {
            return Self { low: [0.0; 3], high: [0.0; 3], centroid: [0.0; 3] };
        }
        let mut low = [f32::INFINITY; 3];
        let mut high = [f32::NEG_INFINITY; 3];
        let mut sum = [0.0; 3];
        for &row in members {
            let point = points[row as usize];
            for axis in 0..3 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
                sum[axis] += f64::from(point[axis]);
            }
        }
        let count = members.len() as f64;
        Self { low, high, centroid: sum.map(|value| value / count) }
    }
}

/// Index of a point and index of its cluster. None if the point is in no cluster.
fn label_of((row, (point, &label)): (u32, (&[f32; 3], &i32))) -> Option<(u32, usize)> {
    let label = usize::try_from(label).ok()?;
    point.iter().all(|value| value.is_finite()).then_some((row, label))
}
