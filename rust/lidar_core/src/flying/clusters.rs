//! Clusters of a labelled cloud and their shape.

use crate::geometry::lattice::wide;
use crate::geometry::transform::{minus, norm};

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
