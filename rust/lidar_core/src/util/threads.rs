//! Thread pools with a stated number of threads. There is no global pool.

use crate::Error;
use crate::error::require;
use crate::util::vector_unit;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::Arc;

/// Largest number of threads of a pool.
pub const MAX_THREADS: usize = 256;

/// A pool of `threads` threads (1 to [`MAX_THREADS`]).
///
/// # Errors
/// [`Error::Parameter`] if `threads` is outside that range, [`Error::Io`] if the system refuses.
pub fn pool(threads: usize) -> Result<ThreadPool, Error> {
    check_threads(threads)?;
    ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(|index| format!("lidar_core-{index}"))
        .build()
        .map_err(|error| Error::Io(std::io::Error::other(error)))
}

fn check_threads(threads: usize) -> Result<(), Error> {
    require((1..=MAX_THREADS).contains(&threads), "threads", "1 to 256", threads)
}

/// Threads that several stages share. If there is only one, the calling thread does all the work.
#[derive(Clone, Debug, Default)]
pub struct Workers(Option<Arc<ThreadPool>>);

impl Workers {
    /// `threads` threads (1 to [`MAX_THREADS`]). Also checks the choice of the vector unit.
    ///
    /// # Errors
    /// As [`pool`] and [`vector_unit::used`].
    pub fn new(threads: usize) -> Result<Self, Error> {
        vector_unit::used()?;
        check_threads(threads)?;
        let pool = if threads > 1 { Some(Arc::new(pool(threads)?)) } else { None };
        Ok(Self(pool))
    }

    /// The pool of threads. None if there is only one thread.
    #[must_use]
    pub fn pool(&self) -> Option<&ThreadPool> {
        self.0.as_deref()
    }

    /// Number of threads, at least 1.
    #[must_use]
    pub fn count(&self) -> usize {
        self.pool().map_or(1, ThreadPool::current_num_threads)
    }
}
