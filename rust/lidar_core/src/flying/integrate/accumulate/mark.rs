//! Mark of a voxel: contribution of one scan to it.

/// Content of one voxel in one scan, in 32 bits: the class of the points inside in the highest
/// two, below them their number, or without points the length of rays in 1/16384 edges.
pub(crate) type Mark = u32;
/// Bits of the count: the number of points, in a weighted scan their weight in units of
/// 1 / `POINT_UNITS`, or the length of rays.
const COUNT_BITS: u32 = 30;
pub(crate) const MAX_COUNT: u32 = (1 << COUNT_BITS) - 1;
/// Weight units per point, in scans whose points have weights.
pub(crate) const POINT_UNITS: u32 = 1024;
/// Length units per voxel edge.
// 2^14: scaling by a power of two is exact, and 30 bits still hold 65,536 edges per voxel and scan.
pub(crate) const UNITS_PER_EDGE: f64 = 16_384.0;
/// More than a ray can add to a mark: a diagonal.
// sqrt(3) = 1.732 edges; the rest is room for rounded positions.
const MOST_UNITS: u32 = (1.75 * UNITS_PER_EDGE) as u32;
/// Number of rays that cannot make an empty mark overflow.
pub(in crate::flying::integrate) const RAYS_FROM_EMPTY: usize = (u32::MAX / MOST_UNITS) as usize;
/// Number of rays that cannot make a mark of `MAX_COUNT` overflow.
pub(in crate::flying::integrate) const RAYS_FROM_FULL: usize =
    ((u32::MAX - MAX_COUNT) / MOST_UNITS) as usize;

/// Classes that a voxel's points can have, weakest first: of several the strongest counts
/// (first matching case of eq. 9: background, then flying or unknown, then rays).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    Rays,
    Unknown,
    Flying,
    Background,
}

/// Number of the content, and how much of it (points, or length units).
#[inline(always)]
pub(crate) fn tag_and_count(mark: Mark) -> (u32, u32) {
    (mark >> COUNT_BITS, mark & MAX_COUNT)
}

/// A mark to which points, or as many units, of class `content` are added. Stronger contents are
/// greater numbers: arithmetic alone, since no branch could be foreseen.
#[inline(always)]
pub(in crate::flying::integrate) fn with_points(mark: Mark, content: Content, units: u32) -> Mark {
    // A weaker mark lies below `none`, so the maximum drops its count. A stronger one lies above
    // `none | MAX_COUNT`, so the last maximum keeps it. The minimum stops a full count before it
    // carries into the class.
    let none = (content as u32) << COUNT_BITS;
    let known = mark.max(none);
    known.max(known.saturating_add(units).min(none | MAX_COUNT))
}
