//! Helpers for all modules: limits, cancelling, thread pools, reusable memory, hashing, time of
//! stages.

pub mod budget;
pub mod cancel;
pub(crate) mod full_state;
pub(crate) mod key_hasher;
#[cfg(test)]
pub(crate) mod layout;
pub(crate) mod object_pool;
pub(crate) mod stopwatch;
pub mod threads;
pub mod vector_unit;

/// A planted bug. Only builds of `make fuzz` contain it, and must find it. It prints nothing.
#[cfg(canary_1)]
pub(crate) fn planted(name: &'static str) -> ! {
    std::panic::resume_unwind(Box::new(name))
}
