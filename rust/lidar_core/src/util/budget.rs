//! Limits: every allocation whose size comes from input asks here first.

use crate::Error;

/// Largest number of points in one scan.
pub const MAX_POINTS: usize = 4_000_000;
/// Largest number of LiDARs of one detector: it remembers sky and robot of each, some megabytes.
pub const MAX_SENSORS: usize = 64;
/// Largest number of voxels that one ray may cross.
pub const MAX_VOXELS_PER_RAY: usize = 100_000;

/// An empty vector with room for `len` values, or a typed error instead of an abort.
///
/// # Errors
/// [`Error::Limit`] if `len` exceeds `limit` or the memory cannot be had.
pub fn vec_with_capacity<T>(
    what: &'static str,
    len: usize,
    limit: usize,
    key: &'static str,
) -> Result<Vec<T>, Error> {
    let refused =
        || Error::Limit { what: format!("{what} of {len} entries"), limit: limit as u64, key };
    if len > limit {
        return Err(refused());
    }
    let mut values = Vec::new();
    // `Vec::with_capacity` would end the process if the memory cannot be had.
    values.try_reserve_exact(len).map_err(|_| refused())?;
    Ok(values)
}

/// Memory that a call may take beside that of its rows [bytes]. More than the largest block that
/// allocators keep for themselves, so that what is asked for here goes back to the system.
const ROOM: usize = 48 << 20;
/// Memory that a call may take for one row of its input, all stages together [bytes].
const ROOM_OF_ROW: usize = 640;

/// Ask for the memory that a call with so many rows may take, and give it back.
///
/// Most allocations are small and cannot fail by themselves: without memory they end the process.
/// A call that may need many asks here before it changes anything.
///
/// # Errors
/// [`Error::Limit`] if the memory cannot be had.
pub(crate) fn check_memory(what: &'static str, rows: usize) -> Result<(), Error> {
    let bytes = rows.saturating_mul(ROOM_OF_ROW).saturating_add(ROOM);
    let mut room = Vec::<u8>::new();
    let is_there = room.try_reserve_exact(bytes).is_ok();
    std::hint::black_box(&room); // else the compiler may leave the allocation out
    if is_there {
        return Ok(());
    }
    let what = format!("{what} of {rows} rows may take {} MiB of memory", bytes >> 20);
    Err(Error::Memory { what })
}

/// Check the number of points in a scan.
///
/// # Errors
/// [`Error::Limit`] above [`MAX_POINTS`].
pub fn check_points(len: usize) -> Result<(), Error> {
    if len > MAX_POINTS {
        return Err(Error::Limit {
            what: format!("a scan of {len} points"),
            limit: MAX_POINTS as u64,
            key: "split the scan",
        });
    }
    Ok(())
}
