//! Classes of points: what the detector says of a point, and what the map takes it for.

/// Class of a point that is ignored.
pub const INVALID: u8 = 0;
/// Class of a point on something that belongs to the environment.
pub const BACKGROUND: u8 = 1;
/// Class of a point on a flying object.
pub const FLYING: u8 = 2;
/// Class of a point that is neither background nor known to fly.
pub const UNKNOWN: u8 = 3;

/// Replace one class by another.
pub(crate) fn replace(classes: &mut [u8], old: u8, new: u8) {
    classes.iter_mut().filter(|class| **class == old).for_each(|class| *class = new);
}
