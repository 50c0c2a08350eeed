//! What comes of frames in a row: a robot that stands still, one that is carried away, and places that look alike.

use super::world_for_tests::{Robot, appearance, card, in_memory, no_interval};
use super::{Candidate, Decision, Evidence, Look, Recognition, RecognitionOptions, Rejection};
use crate::place_map::{ExperienceId, PlaceId};
use crate::verification::Verification;

/// A robot that knows places 0 to 5, one after the other along a way, each by features and looks of its own.
fn robot_on_its_way() -> Robot {
    let mut robot = Robot::new(Some(card()), no_interval(), in_memory());
    for place in 0..6 {
        assert_eq!(robot.see(place, place as usize).decision, Decision::NewPlace);
    }
    robot
}

fn places(robot: &Robot) -> usize {
    robot.recogniser.map().summary().places
}

#[test]
fn a_robot_that_stands_still_stays_in_its_place_and_learns_no_keyframe() {
    let mut robot = robot_on_its_way();
    robot.see(2, 2);
    let before = robot.keyframes();
    for _ in 0..500 {
        let answer = robot.see(2, 2);
        assert_eq!(answer.place, Some(PlaceId(2)));
        assert!(answer.confidence > 0.99, "{}", answer.confidence);
    }
    assert_eq!((places(&robot), robot.keyframes()), (6, before));
}

#[test]
fn a_robot_that_is_carried_to_a_place_it_knows_says_so_at_once_and_founds_nothing() {
    let mut robot = robot_on_its_way();
    (0..20).for_each(|_| drop(robot.see(0, 0)));
    let answer = robot.see(4, 4);
    assert_eq!((answer.decision, answer.place), (Decision::Recognised, Some(PlaceId(4))));
    assert_eq!(robot.see(4, 4).place, Some(PlaceId(4)));
    assert_eq!(places(&robot), 6);
}

#[test]
fn a_robot_that_is_carried_where_no_map_is_says_unknown_once_and_founds_a_place() {
    let mut robot = robot_on_its_way();
    (0..20).for_each(|_| drop(robot.see(0, 0)));
    assert_eq!(robot.see(40, 12).decision, Decision::Unknown);
    assert_eq!(robot.see(40, 12).decision, Decision::NewPlace);
    assert_eq!(places(&robot), 7);
}

#[test]
fn a_blurred_frame_founds_no_place_while_the_robot_explores() {
    let mut robot = robot_on_its_way();
    assert_eq!(robot.see_blurred(40, 12).decision, Decision::Unknown);
    assert_eq!(robot.see(6, 6).decision, Decision::NewPlace, "a clear one does after it");
    assert_eq!(robot.see_blurred(40, 12).decision, Decision::Unknown);
    assert_eq!(robot.see(2, 2).place, Some(PlaceId(2)), "and what is known is recognised after it");
    assert_eq!(places(&robot), 7);
}

#[test]
fn a_blurred_frame_after_a_clear_one_that_shows_no_known_place_founds_none_either() {
    let mut robot = robot_on_its_way();
    robot.see(2, 2);
    assert_eq!(robot.see(40, 12).decision, Decision::Unknown, "the first one after a known place");
    assert_eq!(robot.see_blurred(41, 13).decision, Decision::Unknown, "the first blurred one");
    assert_eq!(robot.see_blurred(41, 13).decision, Decision::NewPlace);
}

#[test]
fn a_stream_that_begins_anew_begins_with_no_blurred_frame() {
    let mut robot = robot_on_its_way();
    robot.see_blurred(40, 12);
    robot.recogniser.begin_anew();
    assert_eq!(robot.see_blurred(40, 12).decision, Decision::Unknown);
}

#[test]
fn where_little_is_to_be_seen_the_second_frame_founds_a_place() {
    let mut robot = Robot::new(Some(card()), no_interval(), in_memory());
    assert_eq!(robot.see_blurred(0, 0).decision, Decision::Unknown, "not even the first of all");
    assert_eq!(robot.see_blurred(0, 0).decision, Decision::NewPlace);
    assert_eq!(robot.see_blurred(0, 0).place, Some(PlaceId(0)));
    let options = RecognitionOptions { sequence: false, ..no_interval() };
    let mut robot = Robot::new(Some(card()), options, in_memory());
    assert_eq!(robot.see_blurred(0, 0).decision, Decision::NewPlace, "each frame by itself");
}

#[test]
fn a_robot_that_reads_only_and_is_carried_away_does_not_go_on_believing_where_it_was() {
    let mut robot = robot_on_its_way();
    (0..20).for_each(|_| drop(robot.see(0, 0)));
    let options = RecognitionOptions { read_only: true, ..no_interval() };
    let mut reader = Robot::new(Some(card()), options, robot.recogniser.into_map());
    (0..20).for_each(|_| drop(reader.see(0, 0)));
    for _ in 0..5 {
        assert_eq!(reader.see(40, 12).decision, Decision::Unknown);
    }
    assert_eq!(reader.see(3, 3).place, Some(PlaceId(3)));
}

/// What is decided of a frame of which the CNN knows nothing, and geometry finds so many inliers of places.
fn seen(robot: &mut Robot, found: &[(u32, u32)]) -> Recognition {
    let of = |place, by, score, inliers| {
        let (place, keyframe) = (PlaceId(place), ExperienceId(place));
        Candidate { place, keyframe, by, score, votes: None, inliers, probability: 0.0, rejected: None }
    };
    let by_cnn = (0..6).map(|place| of(place, Evidence::Cnn, 0.6 - 0.01 * place as f32, None));
    let by_words = found.iter().map(|&(place, inliers)| of(place, Evidence::BowHv, 0.1, Some(inliers)));
    let look = Look { appearance: Some(appearance(12)), ..Look::default() };
    let frame = robot.frame();
    let geometry = found.iter().map(|_| Verification::default()).collect();
    robot.recogniser.decide(&frame, &look, (by_cnn.chain(by_words).collect(), geometry), Vec::new)
}

fn experiences(robot: &Robot, place: u32) -> usize {
    robot.recogniser.map().place(PlaceId(place)).unwrap().experiences.len()
}

#[test]
fn places_that_share_a_few_features_stay_apart_even_where_the_robot_is_believed_in_the_other_one() {
    let mut robot = robot_on_its_way();
    (0..10).for_each(|_| drop(robot.see(3, 3)));
    let before = experiences(&robot, 3);
    seen(&mut robot, &[(3, 6)]);
    let second = seen(&mut robot, &[(3, 6)]);
    assert_eq!((second.decision, places(&robot)), (Decision::NewPlace, 7));
    assert_eq!(experiences(&robot, 3), before, "none joined it");
}

#[test]
fn a_frame_that_shows_two_places_that_look_alike_is_of_the_one_where_the_robot_is() {
    for (here, there) in [(1, 5), (5, 1)] {
        let mut robot = robot_on_its_way();
        (0..10).for_each(|_| drop(robot.see(u64::from(here), here as usize)));
        let answer = seen(&mut robot, &[(there, 24), (here, 22)]);
        assert_eq!((answer.decision, answer.place), (Decision::Revisited, Some(PlaceId(here))));
        assert_eq!(places(&robot), 6, "and founds no third");
    }
}

#[test]
fn a_place_next_to_a_likelier_one_is_not_accepted_because_geometry_verifies_both() {
    let mut robot = robot_on_its_way();
    (0..10).for_each(|_| drop(robot.see(2, 2)));
    let answer = seen(&mut robot, &[(3, 24), (2, 30)]);
    assert_eq!(answer.place, Some(PlaceId(2)));
    let next = answer.candidates.iter().find(|c| c.place == PlaceId(3) && c.by == Evidence::BowHv).unwrap();
    assert_eq!(next.rejected, Some(Rejection::NextIsLikelier));
    assert_eq!(answer.grounds.of(PlaceId(3)).unwrap().twins, 0.0);
}
