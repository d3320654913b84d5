//! Stopwatch for the stages of a pipeline.

use std::time::Instant;

/// Stopwatch that measures the time since the last lap.
pub(crate) struct Clock(Instant);

impl Clock {
    pub(crate) fn start() -> Self {
        Self(Instant::now())
    }

    /// Milliseconds since the last lap, or since the start. Begins a new lap.
    pub(crate) fn lap(&mut self) -> f64 {
        let now = Instant::now();
        let passed = now.duration_since(std::mem::replace(&mut self.0, now));
        passed.as_secs_f64() * 1e3
    }
}
