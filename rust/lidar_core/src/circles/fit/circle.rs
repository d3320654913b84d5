//! Circles, and circles estimated from a scan.

/// A circle, eq. 3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// Centre [m].
    pub center: [f64; 2],
    /// Radius [m].
    pub radius: f64,
}

/// A circle estimated from one segment of one scan, in the scan's frame, eq. 11.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircleEstimate {
    /// Most likely or expected circle, depending on the method.
    pub circle: Circle,
    /// Covariance of centre x, centre y and radius [m^2].
    pub covariance: [[f64; 3]; 3],
    /// Number of rays that ended on the circle.
    pub n_hits: usize,
    /// True if no circle within the bounds of the radius explains the rays. The circle is then the
    /// algebraic fit, with an approximate covariance.
    pub is_fallback: bool,
}
