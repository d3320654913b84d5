//! Limits on sizes. Every allocation whose size comes from the input is checked here first.

use crate::Error;

/// Largest number of points in one scan.
pub const MAX_POINTS: usize = 4_000_000;
/// Largest number of LiDARs of one detector. It stores the sky and the robot for each of them: some
/// megabytes.
pub const MAX_SENSORS: usize = 64;
/// Largest number of voxels that one ray may cross.
pub const MAX_VOXELS_PER_RAY: usize = 100_000;

/// An empty vector with capacity for `len` values. A typed error instead of an abort if there is
/// not enough memory.
///
/// # Errors
/// [`Error::Limit`] if `len` exceeds `limit`, or if there is not enough memory.
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

/// Memory that a call may need in addition to that of its rows [bytes]. It exceeds the largest
/// block that allocators keep for themselves, so that the memory requested here goes back to the
/// system.
const ROOM: usize = 48 << 20;
/// Memory that all stages of a scan together may need for one point [bytes].
const ROOM_OF_POINT: usize = 640;
/// Size of the rows [bytes] below which their memory is not checked, as for any small allocation.
const BRIEF: usize = 1 << 20;

/// Check that there is memory for a scan of this size, including growth of the map, which a few
/// rays may cause.
///
/// # Errors
/// [`Error::Memory`] if there is not enough memory.
pub(crate) fn check_scan_memory(points: usize) -> Result<(), Error> {
    ask("a scan", points.saturating_mul(ROOM_OF_POINT))
}

/// Check that there is memory for a call with `rows` rows of `bytes_of_row` bytes.
///
/// # Errors
/// [`Error::Memory`] if there is not enough memory.
pub fn check_memory(what: &'static str, rows: usize, bytes_of_row: usize) -> Result<(), Error> {
    let bytes = rows.saturating_mul(bytes_of_row);
    if bytes < BRIEF { Ok(()) } else { ask(what, bytes) }
}

/// Check that memory is available by allocating and freeing it.
///
/// Most allocations are small and cannot report a failure: without memory they end the process. A
/// call that may need many of them checks here before it changes anything.
fn ask(what: &'static str, bytes: usize) -> Result<(), Error> {
    let bytes = bytes.saturating_add(ROOM);
    let mut room = Vec::<u8>::new();
    let is_there = room.try_reserve_exact(bytes).is_ok();
    std::hint::black_box(&room); // else the compiler may leave the allocation out
    if is_there {
        return Ok(());
    }
    let what = format!("{what} may take {} MiB of memory", bytes >> 20);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_that_cannot_be_had_is_refused_and_little_is_not_asked_for() {
        let told = check_memory("a table", usize::MAX / 8, 64).map_err(|error| error.to_string());
        assert!(told.is_err_and(|text| text.starts_with("a table may take ")));
        assert!(matches!(check_scan_memory(usize::MAX / 1024), Err(Error::Memory { .. })));
        assert!(check_memory("a table", BRIEF - 1, 1).is_ok());
        assert!(check_memory("a table", 1000, 4096).is_ok());
    }
}
