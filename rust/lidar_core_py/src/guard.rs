//! Calls into the core: the GIL is released, a panic becomes a Python error, an object after a
//! panic is not used again, and Ctrl-C stops long calls.

use crate::errors::BorderError;
use lidar_core::Error;
use lidar_core::util::cancel::Cancel;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// Time between two checks for signals such as Ctrl-C.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Result of work, or None after a panic.
type Caught<T> = Option<Result<T, Error>>;

/// Run `work` without the GIL.
pub(crate) fn detached<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T, Error> + Send,
) -> Result<T, BorderError> {
    finished(py.detach(|| caught(|| Some(work()))))
}

/// Run `work`, which may take long, without the GIL. If the handler of a signal raises an
/// exception, `work` is asked to stop.
pub(crate) fn stoppable<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T, Error> + Send,
) -> Result<T, BorderError> {
    finished(watched(py, || caught(|| Some(work())))?)
}

/// A core object behind a lock: calls from several threads take turns.
pub(crate) struct Guarded<T> {
    inner: Mutex<T>,
    process: u32,
}

impl<T: Send> Guarded<T> {
    pub(crate) fn new(inner: T) -> Self {
        Self { inner: Mutex::new(inner), process: std::process::id() }
    }

    /// Run `work` on the object, without the GIL. After a panic, the object cannot be used any
    /// more.
    pub(crate) fn with<R: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut T) -> Result<R, Error> + Send,
    ) -> Result<R, BorderError> {
        self.check_process()?;
        finished(py.detach(|| self.locked(work)))
    }

    /// Like [`Self::with`], for work that may take long. If the handler of a signal raises an
    /// exception, the work is asked to stop. Work that changes the object must first call
    /// [`lidar_core::util::cancel::begin_to_write`].
    pub(crate) fn with_stoppable<R: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut T) -> Result<R, Error> + Send,
    ) -> Result<R, BorderError> {
        self.check_process()?;
        finished(watched(py, || self.locked(work))?)
    }

    fn check_process(&self) -> Result<(), BorderError> {
        if self.process == std::process::id() { Ok(()) } else { Err(BorderError::Forked) }
    }

    fn locked<R>(&self, work: impl FnOnce(&mut T) -> Result<R, Error>) -> Caught<R> {
        caught(|| self.inner.lock().ok().map(|mut object| work(&mut object)))
    }
}

fn caught<T>(work: impl FnOnce() -> Caught<T>) -> Caught<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or(None)
}

fn finished<T>(outcome: Caught<T>) -> Result<T, BorderError> {
    outcome.ok_or(BorderError::Poisoned)?.map_err(BorderError::Core)
}

/// Run `work` on a thread of its own, while this one waits for signals.
///
/// Python handles signals on its main thread only: calls from others run where they are.
fn watched<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Caught<T> + Send,
) -> Result<Caught<T>, BorderError> {
    // Longer than other functions: the closures share the thread, its result and the signal that
    // was raised.
    if !is_main_thread(py)? {
        return Ok(py.detach(work));
    }
    let cancel = Cancel::default();
    // Taken by the thread, or by this one if the system gives none.
    let work = Mutex::new(Some(work));
    let run = || {
        let taken = work.lock().unwrap_or_else(PoisonError::into_inner).take();
        taken.and_then(|work| cancel.run(work))
    };
    py.detach(|| {
        thread::scope(|scope| {
            let (done, result) = sync_channel(1);
            let task = move || drop(done.send(run()));
            let worker = thread::Builder::new().name("lidar_core-call".into());
            let Ok(worker) = worker.spawn_scoped(scope, task) else { return Ok(run()) };
            let mut raised = None;
            let outcome = loop {
                match result.recv_timeout(LOOK_EVERY) {
                    Ok(outcome) => break raised.map_or(Ok(outcome), Err),
                    Err(RecvTimeoutError::Disconnected) => break Ok(None),
                    Err(RecvTimeoutError::Timeout) if raised.is_some() => {}
                    Err(RecvTimeoutError::Timeout) => {
                        cancel.ask_if(|| {
                            let look = Python::attach(|py| py.check_signals());
                            raised = look.err().map(BorderError::Python);
                            raised.is_some()
                        });
                    }
                }
            };
            // The scope waits for the work, but not for the end of the thread. On a busy machine the
            // next call began before it, and its thread got another part of the heap (an arena of
            // malloc): what one call allocates and another frees then stays with the process.
            drop(worker.join());
            outcome
        })
    })
}

fn is_main_thread(py: Python<'_>) -> PyResult<bool> {
    static MAIN_THREAD: PyOnceLock<[Py<PyAny>; 2]> = PyOnceLock::new();
    let [current, main] = MAIN_THREAD.get_or_try_init(py, || {
        let threading = py.import("threading")?;
        let function = |name| threading.getattr(name).map(Bound::unbind);
        Ok::<_, PyErr>([function("current_thread")?, function("main_thread")?])
    })?;
    Ok(current.bind(py).call0()?.is(&main.bind(py).call0()?))
}
