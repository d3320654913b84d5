//! Clusters of a labelled cloud and their shape.

use crate::geometry::lattice::wide;
use crate::geometry::transform::{minus, norm};

/// A cluster: rows of its points, and what is known of its shape.
pub(crate) struct Cluster<'a> {
    pub(crate) members: &'a [u32],
    pub(crate) low: [f64; 3],
    pub(crate) high: [f64; 3],
    pub(crate) centroid: [f64; 3],
}

impl<'a> Cluster<'a> {
    /// Clusters of a labelled cloud, in the order of their labels; points that are not finite
    /// belong to none. All their rows are put into `rows`.
    pub(crate) fn all(points: &[[f32; 3]], labels: &[i32], rows: &'a mut Vec<u32>) -> Vec<Self> {
        let count = labels.iter().max().map_or(0, |&last| (last + 1).max(0) as usize);
        let labelled = || (0..).zip(points.iter().zip(labels)).filter_map(label_of);
        let mut ends = vec![0usize; count + 1];
        labelled().for_each(|(_, label)| ends[label + 1] += 1);
        for label in 0..count {
            ends[label + 1] += ends[label];
        }
        rows.clear();
        rows.resize(ends[count], 0);
        for (row, label) in labelled() {
            rows[ends[label]] = row; // where the cluster begins, at first
            ends[label] += 1;
        }
        let rows: &'a [u32] = rows;
        let start = |label: usize| label.checked_sub(1).map_or(0, |before| ends[before]);
        (0..count).map(|label| Self::of(points, &rows[start(label)..ends[label]])).collect()
    }

    fn of(points: &[[f32; 3]], members: &'a [u32]) -> Self {
        if members.is_empty() {
            return Self { members, low: [0.0; 3], high: [0.0; 3], centroid: [0.0; 3] };
        }
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        let mut sum = [0.0; 3];
        for &row in members {
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

/// Row and cluster of a point that belongs to one.
fn label_of((row, (point, &label)): (u32, (&[f32; 3], &i32))) -> Option<(u32, usize)> {
    let label = usize::try_from(label).ok()?;
    point.iter().all(|value| value.is_finite()).then_some((row, label))
}
