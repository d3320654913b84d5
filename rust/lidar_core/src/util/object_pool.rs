//! Working memory for tasks of which some run at the same time.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};

/// Pool of working memory: it holds as many pieces as were ever lent at the same time.
#[derive(Default)]
pub(crate) struct Shelf<T>(Mutex<Vec<T>>);

/// A borrowed piece of memory, returned to its pool when dropped.
pub(crate) struct Lent<'a, T: Default> {
    shelf: &'a Shelf<T>,
    piece: T,
}

impl<T: Default> Shelf<T> {
    /// A piece of memory, with whatever the last task left in it.
    pub(crate) fn lend(&self) -> Lent<'_, T> {
        let mut pieces = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Lent { shelf: self, piece: pieces.pop().unwrap_or_default() }
    }
}

impl<T: Default> Deref for Lent<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.piece
    }
}

impl<T: Default> DerefMut for Lent<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.piece
    }
}

impl<T: Default> Drop for Lent<'_, T> {
    fn drop(&mut self) {
        let mut pieces = self.shelf.0.lock().unwrap_or_else(PoisonError::into_inner);
        // A default `T` is left behind, since `drop` cannot move the piece out of itself.
        pieces.push(std::mem::take(&mut self.piece));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_given_back_is_lent_again() {
        let shelf = Shelf::<Vec<u8>>::default();
        let (mut one, two) = (shelf.lend(), shelf.lend());
        one.push(7);
        drop((two, one));
        assert_eq!(*shelf.lend(), [7]);
        assert_eq!(shelf.0.lock().map_or(0, |pieces| pieces.len()), 2);
    }
}
