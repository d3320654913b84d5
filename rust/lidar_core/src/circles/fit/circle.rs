//! Circles, and what a scan says about one.

/// A circle, eq. 3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// Its centre [m].
    pub center: [f64; 2],
    /// Its radius [m].
    pub radius: f64,
}

/// A circle estimated from one segment of one scan, in the scan's frame, eq. 11.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircleEstimate {
    /// Most likely, or expected, circle.
    pub circle: Circle,
    /// Of centre x, centre y and radius [m^2].
    pub covariance: [[f64; 3]; 3],
    /// Rays that ended on it.
    pub n_hits: usize,
    /// Whether no circle within the bounds of the radius explains the rays: then it is the
    /// algebraic fit, with a rough covariance.
    pub is_fallback: bool,
}
