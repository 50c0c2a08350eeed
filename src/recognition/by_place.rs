//! Values of places, in the order of the places.

use crate::place_map::PlaceId;

/// A value for each of a few places, rising by place: a tree's order, in one piece of memory, which is kept when the
/// values are forgotten.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ByPlace<V>(Vec<(PlaceId, V)>);

impl<V> Default for ByPlace<V> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<V: Copy> ByPlace<V> {
    /// Forgets all values.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    fn find(&self, place: PlaceId) -> Result<usize, usize> {
        self.0.binary_search_by_key(&place, |entry| entry.0)
    }

    /// The value of a place, if it has one.
    pub(super) fn get(&self, place: PlaceId) -> Option<V> {
        self.find(place).ok().map(|at| self.0[at].1)
    }

    /// The value of a place, which is `first` if it has none yet.
    pub(super) fn entry(&mut self, place: PlaceId, first: V) -> &mut V {
        let at = self.find(place).unwrap_or_else(|at| {
            self.0.insert(at, (place, first));
            at
        });
        &mut self.0[at].1
    }

    /// Gives a place a value, whatever it had.
    pub(super) fn set(&mut self, place: PlaceId, value: V) {
        *self.entry(place, value) = value;
    }

    /// Places and their values.
    pub(super) fn iter(&self) -> impl Iterator<Item = (PlaceId, V)> {
        self.0.iter().copied()
    }

    /// The values, to be changed.
    pub(super) fn values_mut(&mut self) -> impl Iterator<Item = &mut V> {
        self.0.iter_mut().map(|entry| &mut entry.1)
    }

    /// The value at a position, to be changed, with its place.
    pub(super) fn at_mut(&mut self, position: usize) -> (PlaceId, &mut V) {
        let (place, value) = &mut self.0[position];
        (*place, value)
    }

    /// How many places have a value.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Keeps the `count` entries that come first by `order`, which no two may tie in, and shows `left_out` the others,
    /// in that order.
    pub(super) fn keep_first(
        &mut self,
        count: usize,
        order: impl FnMut(&(PlaceId, V), &(PlaceId, V)) -> std::cmp::Ordering,
        left_out: impl FnOnce(&[(PlaceId, V)]),
    ) {
        if self.len() <= count {
            return;
        }
        self.0.sort_unstable_by(order);
        left_out(&self.0[count..]);
        self.0.truncate(count);
        self.0.sort_unstable_by_key(|entry| entry.0);
    }
}

impl<V: Copy> FromIterator<(PlaceId, V)> for ByPlace<V> {
    fn from_iter<I: IntoIterator<Item = (PlaceId, V)>>(entries: I) -> Self {
        let mut values = Self::default();
        entries.into_iter().for_each(|(place, value)| values.set(place, value));
        values
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_is_a_tree(entries in prop::collection::vec((0_u32..40, 0_u32..9), 0..60)) {
            let (mut values, mut tree) = (ByPlace::default(), BTreeMap::new());
            for &(place, value) in &entries {
                *values.entry(PlaceId(place), 7) += value;
                *tree.entry(PlaceId(place)).or_insert(7) += value;
            }
            prop_assert!(values.iter().eq(tree.iter().map(|(&place, &value)| (place, value))));
            prop_assert_eq!(values.get(PlaceId(3)), tree.get(&PlaceId(3)).copied());
            let mut rest = 0;
            let order = |a: &(PlaceId, u32), b: &(PlaceId, u32)| b.1.cmp(&a.1).then(a.0.cmp(&b.0));
            values.keep_first(5, order, |left| rest = left.len());
            prop_assert_eq!(values.len() + rest, tree.len());
            prop_assert!(values.len() <= 5 && values.iter().map(|entry| entry.0).is_sorted());
        }
    }
}
