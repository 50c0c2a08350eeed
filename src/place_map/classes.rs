//! Which places of a map the classes of a model are.
//!
//! A place's number says little: the map may be another robot's, merged, or founded anew. What its frames looked like
//! stays with its experiences, wherever they go.

use std::collections::{BTreeMap, HashMap};

use super::{PlaceId, PlaceMap};
use crate::cnn::ClassCard;

impl PlaceMap {
    /// The place that each class is in this map by now: the one that holds most of the class's views, and half of those
    /// that are there at least; of equals the one of the class's number. Where none of them is there any more, the one
    /// place of its name.
    #[must_use]
    pub fn places_of(&self, classes: &[ClassCard]) -> Vec<Option<PlaceId>> {
        let mut by_view: HashMap<u64, Vec<PlaceId>> = HashMap::new();
        for experience in self.experiences().filter(|experience| experience.view != 0) {
            let place = self.place(experience.learnt_as).map(|place| place.id);
            by_view.entry(experience.view).or_default().extend(place);
        }
        classes.iter().map(|class| self.place_of(class, &by_view)).collect()
    }

    fn place_of(&self, class: &ClassCard, by_view: &HashMap<u64, Vec<PlaceId>>) -> Option<PlaceId> {
        let mut votes: BTreeMap<PlaceId, usize> = BTreeMap::new();
        let mut found = 0;
        for view in class.views.iter().filter_map(|view| u64::from_str_radix(view, 16).ok()) {
            let mut places = by_view.get(&view).cloned().unwrap_or_default();
            places.sort_unstable();
            places.dedup();
            found += usize::from(!places.is_empty());
            places.into_iter().for_each(|place| *votes.entry(place).or_default() += 1);
        }
        let own = self.place(PlaceId(class.place)).map(|place| place.id);
        match votes.into_iter().max_by_key(|&(place, count)| (count, own == Some(place))) {
            Some((place, count)) => (2 * count >= found).then_some(place),
            None => self.only_place_named(class.name.as_deref()?),
        }
    }

    fn only_place_named(&self, name: &str) -> Option<PlaceId> {
        let is_named =
            |place: &&super::Place| place.merged_into.is_none() && place.name.as_deref() == Some(name);
        let mut named = self.places().filter(is_named).map(|place| place.id);
        named.next().filter(|_| named.next().is_none())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place_map::MapOptions;
    use crate::place_map::tests::{found, learn};

    /// A class as a card has it, of what was learnt as these.
    fn class(place: u32, learnt: &[u64]) -> ClassCard {
        let view = |index: &u64| format!("{:016x}", index.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        ClassCard { place, name: None, views: learnt.iter().map(view).collect() }
    }

    /// Two places: what was learnt as 1, 3 and 5, and as 2, 4 and 6.
    fn two_places(map: &mut PlaceMap) -> [PlaceId; 2] {
        let places = [found(map, 1), found(map, 2)];
        for index in 3..7 {
            learn(map, Some(places[(index as usize + 1) % 2]), index, false).unwrap();
        }
        places
    }

    fn classes() -> [ClassCard; 2] {
        [class(0, &[1, 3, 5]), class(1, &[2, 4, 6])]
    }

    #[test]
    fn classes_are_found_whatever_number_and_name_their_places_have_now() {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        // Of another map, in which other places were founded before.
        for index in 10..13 {
            found(&mut map, index);
        }
        let [one, other] = two_places(&mut map);
        map.name_place(one, "hall").unwrap();
        assert_eq!(map.places_of(&classes()), [Some(one), Some(other)]);
        map.merge_places(other, one).unwrap();
        let merged = map.place(one).unwrap().id;
        assert_eq!(map.places_of(&classes()), [Some(merged); 2]);
    }

    #[test]
    fn a_class_whose_views_are_gone_goes_by_its_name_if_one_place_alone_has_it() {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        let [one, other] = two_places(&mut map);
        let named = ClassCard { name: Some("hall".to_owned()), ..class(1, &[20]) };
        assert_eq!(map.places_of(std::slice::from_ref(&named)), [None]);
        map.name_place(one, "hall").unwrap();
        assert_eq!(map.places_of(std::slice::from_ref(&named)), [Some(one)]);
        map.name_place(other, "hall").unwrap();
        assert_eq!(map.places_of(&[named]), [None]);
    }

    #[test]
    fn a_class_that_is_all_over_the_map_is_no_place_of_it_and_of_equals_its_number_counts() {
        let mut map = PlaceMap::in_memory(MapOptions::default()).unwrap();
        let [one, other] = two_places(&mut map);
        let third = found(&mut map, 7);
        assert_eq!(map.places_of(&[class(0, &[1, 2, 7])]), [None]);
        assert_eq!(map.places_of(&[class(1, &[1, 2]), class(0, &[1, 2])]), [Some(other), Some(one)]);
        assert_eq!(map.places_of(&[class(0, &[7]), class(0, &[])]), [Some(third), None]);
        let odd = ClassCard { views: vec!["no number".to_owned()], ..class(0, &[]) };
        assert_eq!(map.places_of(&[odd]), [None]);
    }
}
