//! Segments: groups of rays of a scan that belong together.

/// What lies beside a segment, as the next ray shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The next ray passed: no return, or a hit farther away. The object ends before it.
    Free,
    /// The next ray ended on something nearer or on another surface in a corner, or gives no
    /// information: the object may continue behind.
    Occluded,
    /// There is no next ray: the object may continue outside the field of view.
    FieldEdge,
    /// The next ray returned nothing, but the surface there may lie beyond the range limits.
    RangeCut,
}

/// Groups of rays, one per object, eq. 6. Segments count from 0 here, labels from 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Segments {
    /// Label of every ray: 0 for none, else the index of its segment plus 1 (m of eq. 6).
    pub labels: Vec<i32>,
    /// Indices of the rays of all segments, one segment after the other, each in the order of its
    /// sweep. In a full circle a segment may cross the seam, from the last ray to the first.
    pub rays: Vec<u32>,
    /// Start of each segment in `rays`; one more entry at the end.
    pub starts: Vec<usize>,
    /// What lies before the first and after the last ray of each segment.
    pub sides: Vec<[Side; 2]>,
}

impl Segments {
    /// Number of segments.
    #[must_use]
    pub fn len(&self) -> usize {
        self.sides.len()
    }

    /// True if there are no segments.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.sides.is_empty()
    }

    /// Add a segment.
    pub(crate) fn push(&mut self, rays: &[u32], sides: [Side; 2]) {
        self.sides.push(sides);
        let label = self.sides.len() as i32;
        for &ray in rays {
            self.labels[ray as usize] = label;
        }
        self.rays.extend(rays);
        self.starts.push(self.rays.len());
    }

    /// Indices of the rays of the segment with the index `number` that ended on its object; other
    /// rays may lie between them.
    #[must_use]
    pub fn rays_of(&self, number: usize) -> &[u32] {
        let bounds = (self.starts.get(number), self.starts.get(number + 1));
        let (Some(&start), Some(&end)) = bounds else { return &[] };
        self.rays.get(start..end).unwrap_or(&[])
    }
}

#[cfg(test)]
mod tests {
    use super::{Segments, Side};

    #[test]
    fn rays_of_a_segment() {
        let segments = Segments {
            labels: vec![1, 1, 0, 2],
            rays: vec![0, 1, 3],
            starts: vec![0, 2, 3],
            sides: vec![[Side::FieldEdge, Side::Free], [Side::Free, Side::FieldEdge]],
        };
        assert_eq!((segments.rays_of(0), segments.rays_of(1)), (&[0, 1][..], &[3][..]));
        assert!(segments.rays_of(2).is_empty());
    }
}
