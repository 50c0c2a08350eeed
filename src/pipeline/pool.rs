//! Values that are shared between threads, in memory that is used again once nobody shares it any more.

use std::mem;
use std::sync::Arc;

/// Shared memory for at most so many values; further ones get memory of their own.
pub(super) struct Pool<T> {
    kept: Vec<Arc<T>>,
    most: usize,
}

impl<T> Pool<T> {
    pub(super) fn new(most: usize) -> Self {
        Self { kept: Vec::with_capacity(most), most }
    }

    /// The value, to be shared, and the one that lay in its place before, if there was one.
    pub(super) fn share(&mut self, value: T) -> (Arc<T>, Option<T>) {
        for kept in &mut self.kept {
            if let Some(place) = Arc::get_mut(kept) {
                let before = mem::replace(place, value);
                return (Arc::clone(kept), Some(before));
            }
        }
        let value = Arc::new(value);
        if self.kept.len() < self.most {
            self.kept.push(Arc::clone(&value));
        }
        (value, None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_used_again_once_nobody_shares_it() {
        let mut pool = Pool::new(2);
        let (one, before) = pool.share(1);
        let (two, _) = pool.share(2);
        let (three, none) = pool.share(3);
        assert_eq!((before, none, *one, *two, *three), (None, None, 1, 2, 3));
        drop(two);
        let (four, before) = pool.share(4);
        assert_eq!((*four, before, *one), (4, Some(2), 1));
        drop(three);
        assert_eq!(pool.share(5).1, None, "what was beyond the pool is gone");
    }
}
