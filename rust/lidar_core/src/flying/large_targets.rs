//! Large targets: limits that detection and tracking share.
//!
//! Rays hit several parts of a large target, so it may fall into several clusters. They hit the
//! same parts in every scan, so no number of scans shows its centre.

/// Length of the longest side from which on a target may fall into several clusters, such as a
/// fuselage between wings [m].
pub(crate) const LARGE: f64 = 0.75;
/// Largest distance between parts of a large target, from box to box [m].
pub(crate) const PART_GAP: f64 = 0.5;
/// Lengths between which the weight of the shape for the centre grows from none to full [m].
const SHAPE_LENGTHS: [f64; 2] = [0.9, 1.3];

/// How much the shape of a target decides about its centre, from 0 (small target) to 1.
/// `longest_side` [m].
pub(crate) fn shape_weight(longest_side: f64) -> f64 {
    let [none, full] = SHAPE_LENGTHS;
    ((longest_side - none) / (full - none)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shape_counts_from_0_9_m_on_and_fully_at_1_3_m() {
        let weights = [0.0, 0.9, 1.1, 1.3, 20.0].map(shape_weight);
        assert_eq!([weights[0], weights[1], weights[3], weights[4]], [0.0, 0.0, 1.0, 1.0]);
        assert!((weights[2] - 0.5).abs() < 1e-12);
    }
}
