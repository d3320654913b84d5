//! Mark of a voxel: contribution of one scan to it.

/// Content of one voxel in one scan, in 32 bits. The highest two are the class of the points
/// inside. The others are the number of points or, without points, the length of rays in 1/16384
/// voxel edges.
pub(crate) type Mark = u32;
/// Number of bits for the count in a mark: number of points (in a weighted scan their weight in
/// units of 1 / `POINT_UNITS`) or length of rays.
const COUNT_BITS: u32 = 30;
/// Largest count of a mark.
pub(crate) const MAX_COUNT: u32 = (1 << COUNT_BITS) - 1;
/// Number of units per point in scans whose points have weights.
pub(crate) const POINT_UNITS: u32 = 1024;
/// Number of length units per voxel edge.
// 2^14: scaling by a power of two is exact, and 30 bits still hold 65,536 edges per voxel and scan.
pub(crate) const UNITS_PER_EDGE: f64 = 16_384.0;
/// Upper limit of what one ray can add to a mark: the length of the voxel's diagonal.
// sqrt(3) = 1.732 edges; the rest is room for rounded positions.
const MOST_UNITS: u32 = (1.75 * UNITS_PER_EDGE) as u32;
/// Largest number of rays that can be added to an empty mark without an overflow of its 32 bits.
pub(in crate::flying::integrate) const RAYS_FROM_EMPTY: usize = (u32::MAX / MOST_UNITS) as usize;
/// Largest number of rays that can be added to a mark of `MAX_COUNT` without an overflow of its 32
/// bits.
pub(in crate::flying::integrate) const RAYS_FROM_FULL: usize =
    ((u32::MAX - MAX_COUNT) / MOST_UNITS) as usize;

/// Content of a voxel in one scan, weakest first. If a scan gives several contents, the strongest
/// one counts (first matching case of eq. 9: background, then flying or unknown, then rays).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    Rays,
    Unknown,
    Flying,
    Background,
}

/// Content of a mark as a number, and its count (points, units, or length units).
#[inline(always)]
pub(crate) fn tag_and_count(mark: Mark) -> (u32, u32) {
    (mark >> COUNT_BITS, mark & MAX_COUNT)
}

/// The mark after points of class `content` were added: `units` points, or units of weight. A
/// stronger content replaces a weaker one. The count is limited to `MAX_COUNT`. The code has no
/// branches, because their outcomes would not be predictable.
#[inline(always)]
pub(in crate::flying::integrate) fn with_points(mark: Mark, content: Content, units: u32) -> Mark {
    // A weaker mark lies below `none`, so the maximum drops its count. A stronger one lies above
    // `none | MAX_COUNT`, so the last maximum keeps it. The minimum stops a full count before it
    // carries into the class.
    let none = (content as u32) << COUNT_BITS;
    let known = mark.max(none);
    known.max(known.saturating_add(units).min(none | MAX_COUNT))
}
