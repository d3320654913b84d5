//! Thread pools with a stated number of threads. There is no global pool.

use crate::Error;
use crate::error::require;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Largest number of threads a pool may have.
pub const MAX_THREADS: usize = 256;

/// A pool of `threads` threads, 1 to [`MAX_THREADS`].
///
/// # Errors
/// [`Error::Parameter`] if `threads` is outside that range, [`Error::Io`] if the system refuses.
pub fn pool(threads: usize) -> Result<ThreadPool, Error> {
    require((1..=MAX_THREADS).contains(&threads), "threads", "1 to 256", threads)?;
    ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(|index| format!("lidar_core-{index}"))
        .build()
        .map_err(|error| Error::Io(std::io::Error::other(error)))
}
