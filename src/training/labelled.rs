//! Feature vectors of images whose classes are known, and how often the nearest class is the right one.

use crate::cnn::dot;

/// Feature vectors with their classes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Labelled {
    /// Values of a vector.
    width: usize,
    /// Vectors of unit length, one after the other.
    values: Vec<f32>,
    classes: Vec<usize>,
}

/// How vectors lie to classes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Glance {
    /// Share of those whose own class is the nearest.
    pub(super) recall: f64,
    /// Mean cross-entropy of a softmax over the scaled cosines.
    pub(super) loss: f64,
}

impl Glance {
    /// Of `asked` vectors, of which the others have no direction any more: those are not recognised, and of none of
    /// them is sure what they are.
    pub(super) fn of_all(self, (seen, asked): (usize, usize)) -> Self {
        if seen >= asked {
            return self;
        }
        Self { recall: self.recall * seen as f64 / asked as f64, loss: f64::INFINITY }
    }

    /// Whether more is recognised; where it is as much, whether more surely.
    pub(super) fn is_better_than(&self, other: &Self) -> bool {
        self.recall > other.recall || self.recall == other.recall && self.loss < other.loss
    }
}

impl Labelled {
    /// No vectors of `width` values each.
    #[must_use]
    pub fn new(width: usize) -> Self {
        Self { width, ..Self::default() }
    }

    /// Adds a vector, in whatever length, of `class`; one without a direction is left out.
    ///
    /// # Panics
    /// If the vector has another width.
    pub fn push(&mut self, vector: &[f32], class: usize) {
        assert_eq!(vector.len(), self.width, "width of the vector");
        let length = norm(vector);
        if length > 0.0 && length.is_finite() {
            self.values.extend(vector.iter().map(|value| value / length));
            self.classes.push(class);
        }
    }

    /// Number of vectors.
    #[must_use]
    pub fn len(&self) -> usize {
        self.classes.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.classes.is_empty()
    }

    /// Values of a vector.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// One more than the largest class.
    #[must_use]
    pub fn class_count(&self) -> usize {
        self.classes.iter().max().map_or(0, |&class| class + 1)
    }

    /// Class of every vector.
    #[must_use]
    pub fn classes(&self) -> &[usize] {
        &self.classes
    }

    /// The vector numbered `index`.
    #[must_use]
    pub fn vector(&self, index: usize) -> &[f32] {
        &self.values[index * self.width..][..self.width]
    }

    /// Mean direction of every class: what the class looks like without any training. `[classes, width]`; zeros of a
    /// class without vectors.
    #[must_use]
    pub fn prototypes(&self) -> Vec<f32> {
        let mut prototypes = vec![0.0; self.class_count() * self.width];
        for (index, &class) in self.classes.iter().enumerate() {
            let prototype = &mut prototypes[class * self.width..][..self.width];
            prototype.iter_mut().zip(self.vector(index)).for_each(|(sum, value)| *sum += value);
        }
        for prototype in prototypes.chunks_exact_mut(self.width) {
            let length = norm(prototype).max(f32::MIN_POSITIVE);
            prototype.iter_mut().for_each(|value| *value /= length);
        }
        prototypes
    }

    /// These and those of `other`, which are as wide.
    #[must_use]
    pub fn and(&self, other: &Self) -> Self {
        let mut all = self.clone();
        (0..other.len()).for_each(|index| all.push(other.vector(index), other.classes[index]));
        all
    }

    /// The vectors times `matrix`, `[width, columns]`.
    #[must_use]
    pub fn projected(&self, matrix: &[f32]) -> Self {
        let columns = matrix.len() / self.width.max(1);
        let mut projected = Self::new(columns);
        let mut product = vec![0.0; columns];
        for (index, &class) in self.classes.iter().enumerate() {
            product.fill(0.0);
            for (value, row) in self.vector(index).iter().zip(matrix.chunks_exact(columns)) {
                product.iter_mut().zip(row).for_each(|(sum, weight)| *sum += value * weight);
            }
            projected.push(&product, class);
        }
        projected
    }

    /// How the vectors lie to the classes of `prototypes`, `[classes, width]`: see [`Glance`]; all of it 0 of none.
    #[must_use]
    pub(super) fn glance(&self, prototypes: &[f32], scale: f32) -> Glance {
        let mut loss = 0.0;
        for (index, &class) in self.classes.iter().enumerate() {
            let cosines =
                prototypes.chunks_exact(self.width).map(|prototype| dot(prototype, self.vector(index)));
            let scores: Vec<f64> = cosines.map(|cosine| f64::from(scale * cosine)).collect();
            let greatest = scores.iter().copied().fold(f64::MIN, f64::max);
            let sum: f64 = scores.iter().map(|score| (score - greatest).exp()).sum();
            loss += greatest + sum.ln() - scores.get(class).copied().unwrap_or_default();
        }
        Glance { recall: self.recall(prototypes), loss: loss / self.len().max(1) as f64 }
    }

    /// Share of the vectors whose own class is the nearest of `prototypes` by cosine, `[classes, width]`; 0 of none.
    #[must_use]
    pub fn recall(&self, prototypes: &[f32]) -> f64 {
        let right = (0..self.len()).filter(|&index| {
            nearest(prototypes, self.vector(index)).is_some_and(|class| class == self.classes[index])
        });
        right.count() as f64 / self.len().max(1) as f64
    }
}

/// The class nearest to `vector`; the first of equally near ones.
fn nearest(prototypes: &[f32], vector: &[f32]) -> Option<usize> {
    let cosines = prototypes.chunks_exact(vector.len()).map(|prototype| dot(prototype, vector)).enumerate();
    cosines.reduce(|best, next| if next.1 > best.1 { next } else { best }).map(|(class, _)| class)
}

fn norm(vector: &[f32]) -> f32 {
    vector.iter().map(|value| value * value).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_glances_the_one_that_recognises_more_is_better_and_then_the_surer() {
        let glance = |recall, loss| Glance { recall, loss };
        assert!(glance(0.9, 5.0).is_better_than(&glance(0.8, 1.0)));
        assert!(glance(0.9, 1.0).is_better_than(&glance(0.9, 5.0)));
        assert!(!glance(0.9, 1.0).is_better_than(&glance(0.9, 1.0)));
        assert!(!glance(0.9, f64::NAN).is_better_than(&glance(0.9, 1.0)));
        let asked = labelled(&[([1.0, 0.0], 0), ([1.0, 0.0], 1)]);
        let seen = asked.glance(&[1.0, 0.0, 0.0, 1.0], 2.0);
        // One is right with odds of e² to 1, the other wrong with the same.
        let (right, wrong) = ((1.0 + (-2.0_f64).exp()).ln(), (1.0 + 2.0_f64.exp()).ln());
        assert_eq!(seen.recall, 0.5);
        assert!((seen.loss - f64::midpoint(right, wrong)).abs() < 1e-6, "{seen:?}");
    }

    fn labelled(vectors: &[([f32; 2], usize)]) -> Labelled {
        let mut labelled = Labelled::new(2);
        vectors.iter().for_each(|(vector, class)| labelled.push(vector, *class));
        labelled
    }

    #[test]
    fn vectors_are_kept_in_unit_length_and_those_without_direction_not_at_all() {
        let labelled = labelled(&[([3.0, 4.0], 0), ([0.0, 0.0], 1), ([f32::NAN, 1.0], 2), ([0.0, -2.0], 1)]);
        assert_eq!((labelled.len(), labelled.class_count(), labelled.classes()), (2, 2, &[0, 1][..]));
        assert_eq!((labelled.vector(0), labelled.vector(1)), (&[0.6, 0.8][..], &[0.0, -1.0][..]));
    }

    #[test]
    fn the_nearest_prototype_is_right_where_a_vector_lies_among_its_own() {
        let known = labelled(&[([1.0, 0.1], 0), ([1.0, -0.1], 0), ([0.0, 1.0], 1)]);
        let prototypes = known.prototypes();
        assert!((prototypes[0] - 1.0).abs() < 1e-6 && prototypes[1].abs() < 1e-6);
        let asked = labelled(&[([2.0, 1.0], 0), ([1.0, 2.0], 1), ([1.0, 2.0], 0), ([-1.0, 0.5], 1)]);
        assert_eq!(asked.recall(&prototypes), 0.75);
        assert_eq!(Labelled::new(2).recall(&prototypes), 0.0);
    }

    #[test]
    fn a_projection_is_the_product_with_the_matrix() {
        let projected = labelled(&[([0.6, 0.8], 3)]).projected(&[1.0, 0.0, 2.0, 0.0, 1.0, 1.0]);
        let length = (0.6_f32.powi(2) + 0.8_f32.powi(2) + 2.0_f32.powi(2)).sqrt();
        let expected = [0.6 / length, 0.8 / length, 2.0 / length];
        assert!(
            projected.vector(0).iter().zip(expected).all(|(got, expected)| (got - expected).abs() < 1e-6)
        );
        assert_eq!((projected.width(), projected.classes()), (3, &[3][..]));
    }
}
