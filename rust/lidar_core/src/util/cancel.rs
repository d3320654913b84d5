//! Cancellation: a running call may be asked to stop. Until the call begins to write, its long
//! loops check this.
//!
//! The flag belongs to the thread that runs the call, so functions need no argument for it. Loops
//! that share work with other threads take a [`Watch`] before.

use crate::Error;
use std::cell::RefCell;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

thread_local! {
    static CURRENT: RefCell<Option<Cancel>> = const { RefCell::new(None) };
}

/// Handle that stops a running call from another thread.
#[derive(Clone, Default)]
pub struct Cancel(Arc<State>);

#[derive(Default)]
struct State {
    is_asked: AtomicBool,
    /// Locked while it is decided whether to stop, so that no write begins meanwhile. True: the
    /// call writes.
    is_writing: Mutex<bool>,
}

impl Cancel {
    /// Run `work` on this thread. Its long loops stop after this handle was asked to stop.
    pub fn run<T>(&self, work: impl FnOnce() -> T) -> T {
        within(Some(self.clone()), work)
    }

    /// Ask the call to stop if `wish` returns true. Returns whether it was asked. Once the call has
    /// begun to write, `wish` is not called, and false is returned.
    pub fn ask_if(&self, wish: impl FnOnce() -> bool) -> bool {
        let is_writing = self.0.is_writing.lock().unwrap_or_else(PoisonError::into_inner);
        let is_asked = !*is_writing && wish();
        if is_asked {
            self.0.is_asked.store(true, Ordering::Relaxed);
        }
        is_asked
    }
}

/// Flag that long loops check. It may be sent to other threads.
#[derive(Clone, Default)]
pub struct Watch(Option<Cancel>);

impl Watch {
    /// True if the call was asked to stop. It costs one load; a loop checks it at least every 50
    /// ms.
    #[inline]
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.0.as_ref().is_some_and(|cancel| cancel.0.is_asked.load(Ordering::Relaxed))
    }

    /// Return an error if the call was asked to stop.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if it was.
    #[inline]
    pub fn check(&self) -> Result<(), Error> {
        if self.is_asked() { Err(Error::Interrupted) } else { Ok(()) }
    }

    /// Run a part of the call, possibly on another thread, so that it is cancelled with the call.
    pub(crate) fn run<T>(&self, work: impl FnOnce() -> T) -> T {
        within(self.0.clone(), work)
    }
}

/// The watch of the call that runs on this thread. Without such a call, a watch that never stops.
#[must_use]
pub fn watch() -> Watch {
    Watch(CURRENT.with_borrow(Clone::clone))
}

/// Return an error if the call on this thread was asked to stop.
///
/// # Errors
/// [`Error::Interrupted`] if it was.
pub fn check() -> Result<(), Error> {
    watch().check()
}

/// Declare that from here on the call on this thread changes its object, and can no longer be
/// stopped.
///
/// # Errors
/// [`Error::Interrupted`] if it was asked to stop before.
pub fn begin_to_write() -> Result<(), Error> {
    let Watch(Some(Cancel(state))) = watch() else { return Ok(()) };
    let mut is_writing = state.is_writing.lock().unwrap_or_else(PoisonError::into_inner);
    if state.is_asked.load(Ordering::Relaxed) {
        return Err(Error::Interrupted);
    }
    *is_writing = true;
    Ok(())
}

fn within<T>(cancel: Option<Cancel>, work: impl FnOnce() -> T) -> T {
    /// Restores the previous watch when it is dropped, also after a panic.
    struct Before(Option<Cancel>);
    impl Drop for Before {
        fn drop(&mut self) {
            CURRENT.set(self.0.take());
        }
    }
    let _before = Before(CURRENT.replace(cancel));
    work()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_that_is_asked_stops_and_the_next_one_does_not() {
        let cancel = Cancel::default();
        assert!(!cancel.ask_if(|| false));
        assert!(cancel.run(check).is_ok());
        assert!(cancel.ask_if(|| true));
        assert!(matches!(cancel.run(check), Err(Error::Interrupted)));
        assert!(matches!(cancel.run(begin_to_write), Err(Error::Interrupted)));
        assert!(check().is_ok());
    }

    #[test]
    fn a_call_that_writes_is_not_asked() {
        let cancel = Cancel::default();
        assert!(cancel.run(begin_to_write).is_ok());
        let mut was_called = false;
        assert!(!cancel.ask_if(|| std::mem::replace(&mut was_called, true)));
        assert!(!was_called && cancel.run(check).is_ok());
    }

    #[test]
    fn a_watch_goes_to_other_threads_and_a_thread_forgets_it() {
        let cancel = Cancel::default();
        let watch = cancel.run(watch);
        assert!(cancel.ask_if(|| true));
        std::thread::scope(|scope| {
            scope.spawn(|| {
                assert!(check().is_ok() && watch.check().is_err());
                assert!(watch.run(check).is_err());
                let planned = || watch.run(|| std::panic::resume_unwind(Box::new("planned")));
                assert!(std::panic::catch_unwind(planned).is_err());
                assert!(check().is_ok());
            });
        });
    }
}
