//! Pool of working memory for tasks that run at the same time.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};

/// Pool of working memory. It holds as many pieces as were ever in use at the same time.
#[derive(Default)]
pub(crate) struct ObjectPool<T>(Mutex<Vec<T>>);

/// A borrowed piece of memory. It returns to its pool when it is dropped.
pub(crate) struct PooledObject<'a, T: Default> {
    pool: &'a ObjectPool<T>,
    piece: T,
}

impl<T: Default> ObjectPool<T> {
    /// Borrow a piece of memory. It contains whatever the last task left in it.
    pub(crate) fn acquire(&self) -> PooledObject<'_, T> {
        let mut pieces = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        PooledObject { pool: self, piece: pieces.pop().unwrap_or_default() }
    }
}

impl<T: Default> Deref for PooledObject<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.piece
    }
}

impl<T: Default> DerefMut for PooledObject<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.piece
    }
}

impl<T: Default> Drop for PooledObject<'_, T> {
    fn drop(&mut self) {
        let mut pieces = self.pool.0.lock().unwrap_or_else(PoisonError::into_inner);
        // A default `T` is left behind, since `drop` cannot move the piece out of itself.
        pieces.push(std::mem::take(&mut self.piece));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_returned_object_is_acquired_again() {
        let pool = ObjectPool::<Vec<u8>>::default();
        let (mut one, two) = (pool.acquire(), pool.acquire());
        one.push(7);
        drop((two, one));
        assert_eq!(*pool.acquire(), [7]);
        assert_eq!(pool.0.lock().map_or(0, |pieces| pieces.len()), 2);
    }
}
