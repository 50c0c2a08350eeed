//! How a model stands on images that it never saw.

use rayon::prelude::*;

use super::calibration::Calibration;
use super::gathering::Gathered;
use super::labelled::Labelled;
use crate::cnn::dot;
use crate::proportion::Proportion;

/// How a model does on what was held out, when a threshold decides that lets one in two hundred images of other places
/// pass among those that training only looked at and those of no class.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// Images that were held out.
    pub asked: usize,
    /// Those whose nearest known image is of their own class, and near enough.
    pub recognised: usize,
    /// Those whose nearest known image is of another class that is not next to theirs, and near enough.
    pub mistaken: usize,
    /// Those whose nearest known image is of their own class, however far.
    pub nearest: usize,
    /// What a cosine means; nothing if there was too little to fit it on.
    pub calibration: Option<Calibration>,
}

/// How those stand that a trained model must do as well as.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rivals {
    /// The model that it is to take the place of.
    pub current: Standing,
    /// The class means of the backbone or, where there is none, of that model: what is recognised without any training.
    pub prototypes: Standing,
}

impl Standing {
    /// How the model stands that says `gathered` of the images. Classes that are `near` each other may show the same,
    /// so neither is right or wrong for the other.
    #[must_use]
    pub fn of(gathered: &Gathered, is_near: impl Fn(usize, usize) -> bool + Sync) -> Self {
        let Gathered { learnt, checked, held_out, strangers } = gathered;
        let known: Vec<(f32, f32)> = best_cosines(&checked.and(strangers), learnt, &is_near);
        let is_there = |cosine: &f32| *cosine > f32::MIN;
        let same: Vec<f32> = known.iter().map(|&(own, _)| own).filter(is_there).collect();
        let other: Vec<f32> = known.iter().map(|&(_, other)| other).filter(is_there).collect();
        let calibration = Calibration::fit(&same, &other);
        let asked = best_cosines(held_out, learnt, is_near);
        let threshold = calibration.map_or(f64::INFINITY, |calibration| calibration.threshold);
        let is_near_enough = |cosine: f32| f64::from(cosine) > threshold;
        let count =
            |is: &dyn Fn(f32, f32) -> bool| asked.iter().filter(|&&(own, other)| is(own, other)).count();
        Self {
            asked: asked.len(),
            recognised: count(&|own, other| own > other && is_near_enough(own)),
            mistaken: count(&|own, other| own <= other && is_near_enough(other)),
            nearest: count(&|own, other| own > other),
            calibration,
        }
    }

    /// Whether a model that stands like this does as well as one that stands like `other`: it recognises as much, what
    /// it mistakes taken off, and more than it mistakes.
    #[must_use]
    pub fn is_as_good_as(&self, other: &Self) -> bool {
        let balance = |standing: &Self| standing.recognised as i64 - standing.mistaken as i64;
        let (own, others) = (balance(self), balance(other));
        own > 0 && own >= others && self.recognised >= other.recognised
    }

    /// Share of what was held out that is recognised; 0 of nothing.
    #[must_use]
    pub fn recall(&self) -> f64 {
        self.share(self.recognised)
    }

    /// Share of what was held out whose nearest known image is of its own class: recall@1.
    #[must_use]
    pub fn recall_at_one(&self) -> f64 {
        self.share(self.nearest)
    }

    /// Share of what is recognised that is so rightly; nothing where nothing is recognised.
    #[must_use]
    pub fn precision(&self) -> Option<f64> {
        let said = self.recognised + self.mistaken;
        (said > 0).then(|| self.recognised as f64 / said as f64)
    }

    /// Between what the recall lies with 95 % confidence, by Wilson's score.
    #[must_use]
    pub fn recall_interval(&self) -> (f64, f64) {
        let recall = Proportion::new(self.recognised as u64, self.asked as u64);
        recall.map_or((0.0, 1.0), |recall| (recall.low, recall.high))
    }

    fn share(&self, count: usize) -> f64 {
        count as f64 / self.asked.max(1) as f64
    }
}

/// A figure for people: a dash where there is none.
#[must_use]
pub fn figure(value: Option<f64>) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.3}"))
}

/// Of every vector that is asked about, the greatest cosine to one of its own class, and to one of any other that is
/// not near to it; [`f32::MIN`] where there is none.
fn best_cosines(
    asked: &Labelled,
    known: &Labelled,
    is_near: impl Fn(usize, usize) -> bool + Sync,
) -> Vec<(f32, f32)> {
    let best = |index: usize| {
        let (vector, class) = (asked.vector(index), asked.classes()[index]);
        let (mut own, mut other) = (f32::MIN, f32::MIN);
        for (number, &known_class) in known.classes().iter().enumerate() {
            let cosine = dot(known.vector(number), vector);
            if known_class == class {
                own = own.max(cosine);
            } else if cosine > other && !is_near(class, known_class) {
                other = cosine;
            }
        }
        (own, other)
    };
    (0..asked.len()).into_par_iter().map(best).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Unit vectors at so many degrees, with their classes.
    fn labelled(vectors: &[(f32, usize)]) -> Labelled {
        let mut labelled = Labelled::new(2);
        for &(degrees, class) in vectors {
            let radians = degrees.to_radians();
            labelled.push(&[radians.cos(), radians.sin()], class);
        }
        labelled
    }

    fn gathered() -> Gathered {
        Gathered {
            learnt: labelled(&[(0.0, 0), (90.0, 1), (100.0, 2)]),
            // The nearest of any other class lies 80° off, so does the threshold.
            checked: labelled(&[(10.0, 0)]),
            held_out: labelled(&[(20.0, 0), (179.0, 0), (70.0, 0), (92.0, 1), (91.0, 2)]),
            strangers: Labelled::new(2),
        }
    }

    #[test]
    fn what_lies_nearest_to_its_own_and_near_enough_is_recognised() {
        let standing = Standing::of(&gathered(), |_, _| false);
        let threshold = standing.calibration.unwrap().threshold;
        assert!((threshold - 80.0_f64.to_radians().cos()).abs() < 1e-6);
        let Standing { asked, recognised, mistaken, nearest, .. } = standing;
        // 20° and 92° are; 70° and 91° are taken for others; so is 179°, of which 100° is 79° away.
        assert_eq!((asked, recognised, mistaken, nearest), (5, 2, 3, 2));
        assert_eq!(
            (standing.recall(), standing.recall_at_one(), standing.precision()),
            (0.4, 0.4, Some(0.4))
        );
    }

    #[test]
    fn neighbours_are_neither_right_nor_wrong_for_each_other() {
        let near = |one: usize, other: usize| one + other == 3;
        let standing = Standing::of(&gathered(), near);
        // 91° is of class 2 and lies nearer to class 1, next to it.
        assert_eq!((standing.recognised, standing.mistaken), (3, 2));
    }

    #[test]
    fn what_is_of_no_class_raises_the_threshold_unless_it_is_near_to_the_one_it_is_like() {
        // 60° off class 0 and 30° off class 1.
        let strangers = labelled(&[(60.0, 3)]);
        let gathered = Gathered { strangers, ..gathered() };
        let cosine = |degrees: f64| degrees.to_radians().cos();
        let threshold = |is_near: fn(usize, usize) -> bool| {
            Standing::of(&gathered, is_near).calibration.unwrap().threshold
        };
        assert!((threshold(|_, _| false) - cosine(30.0)).abs() < 1e-6);
        assert!((threshold(|one, other| one + other == 4) - cosine(40.0)).abs() < 1e-6);
    }

    #[test]
    fn as_good_is_who_recognises_as_much_with_the_mistakes_taken_off() {
        let standing = |recognised, mistaken| Standing {
            asked: 9,
            recognised,
            mistaken,
            nearest: recognised,
            calibration: None,
        };
        assert!(standing(5, 1).is_as_good_as(&standing(5, 1)));
        assert!(standing(6, 2).is_as_good_as(&standing(5, 1)));
        assert!(!standing(6, 3).is_as_good_as(&standing(5, 1)), "more mistakes than it recognises more");
        assert!(!standing(4, 0).is_as_good_as(&standing(5, 1)), "less is recognised");
        assert!(!standing(3, 3).is_as_good_as(&standing(0, 0)), "nothing to rely on");
    }

    #[test]
    fn with_too_little_to_fit_a_threshold_on_nothing_is_recognised() {
        let standing = Standing::of(&Gathered { checked: Labelled::new(2), ..gathered() }, |_, _| false);
        assert_eq!((standing.calibration, standing.recognised, standing.nearest), (None, 0, 2));
        assert_eq!((standing.precision(), figure(standing.precision()).as_str()), (None, "–"));
    }
}
