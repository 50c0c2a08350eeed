//! The directions in which features differ most.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::labelled::Labelled;

/// Rounds of orthogonal iteration. The subspace, which is all that counts, settles long before its single directions.
const ROUNDS: usize = 12;

/// The `count` directions, at most as many as a vector has values, that keep most of the vectors' lengths, as the
/// orthonormal columns of `[width, count]`: cosines between vectors change least by this projection.
pub(super) fn principal_directions(labelled: &Labelled, count: usize, seed: u64) -> Vec<f32> {
    let width = labelled.width();
    let mut random = Pcg64::seed_from_u64(seed);
    let mut directions: Vec<Vec<f64>> =
        (0..count).map(|_| (0..width).map(|_| random.random_range(-1.0..1.0)).collect()).collect();
    orthonormalise(&mut directions);
    let moment = second_moment(labelled);
    for _ in 0..ROUNDS {
        for direction in &mut directions {
            *direction = moment
                .chunks_exact(width)
                .map(|row| row.iter().zip(&*direction).map(|(a, b)| a * b).sum())
                .collect();
        }
        orthonormalise(&mut directions);
    }
    let mut columns = vec![0.0; width * count];
    for (column, direction) in directions.iter().enumerate() {
        for (row, value) in direction.iter().enumerate() {
            columns[row * count + column] = *value as f32;
        }
    }
    columns
}

/// Σ v vᵀ over all vectors, and a little of everything, so that no direction vanishes: `[width, width]`.
fn second_moment(labelled: &Labelled) -> Vec<f64> {
    let width = labelled.width();
    let mut moment = vec![0.0; width * width];
    for index in 0..labelled.len() {
        let vector = labelled.vector(index);
        for (row, &value) in moment.chunks_exact_mut(width).zip(vector) {
            row.iter_mut().zip(vector).for_each(|(sum, &other)| *sum += f64::from(value * other));
        }
    }
    let little = 1e-6 * (labelled.len() as f64 + 1.0) / width as f64;
    moment.iter_mut().step_by(width + 1).for_each(|value| *value += little);
    moment
}

/// Gram and Schmidt's way, twice over each, which keeps them orthogonal to the last bit that counts.
fn orthonormalise(directions: &mut [Vec<f64>]) {
    for index in 0..directions.len() {
        let (before, rest) = directions.split_at_mut(index);
        let direction = &mut rest[0];
        for _ in 0..2 {
            for other in &*before {
                let along: f64 = other.iter().zip(&*direction).map(|(a, b)| a * b).sum();
                direction.iter_mut().zip(other).for_each(|(value, part)| *value -= along * part);
            }
        }
        let length = direction.iter().map(|value| value * value).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        direction.iter_mut().for_each(|value| *value /= length);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_of_a_subspace_keep_their_cosines_in_as_many_directions() {
        let mut random = Pcg64::seed_from_u64(1);
        let mut axis = || -> Vec<f32> { (0..20).map(|_| random.random_range(-1.0..1.0)).collect() };
        let axes = [axis(), axis(), axis()];
        let mut labelled = Labelled::new(20);
        for index in 0..60 {
            let shares = [index % 3 + 1, index % 5, index % 7].map(|share| share as f32 - 2.0);
            let vector: Vec<f32> = (0..20)
                .map(|value| axes.iter().zip(shares).map(|(axis, share)| axis[value] * share).sum())
                .collect();
            labelled.push(&vector, 0);
        }
        let projected = labelled.projected(&principal_directions(&labelled, 3, 7));
        let cosine = |labelled: &Labelled, one, other| -> f32 {
            labelled.vector(one).iter().zip(labelled.vector(other)).map(|(a, b)| a * b).sum()
        };
        for (one, other) in [(0, 1), (3, 40), (17, 58)] {
            assert!((cosine(&labelled, one, other) - cosine(&projected, one, other)).abs() < 1e-4);
        }
    }
}
