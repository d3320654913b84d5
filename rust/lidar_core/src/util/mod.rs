//! Helpers for every module: limits, cancelling, thread pools, reusable memory, hashing, time per stage.

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

/// A planted bug, which only builds of `make fuzz` have: they must find it. Says nothing on the
/// console.
#[cfg(canary_1)]
pub(crate) fn planted(name: &'static str) -> ! {
    std::panic::resume_unwind(Box::new(name))
}
