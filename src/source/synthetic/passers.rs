//! Passers-by: others every lap, each walking along the pavement while the lap lasts.

use super::noise::{Dice, folded, mix};
use super::parse::SyntheticSpec;
use super::plan::Vector;
use super::world::{Billboard, World};

/// Where everybody is, `seconds` into `lap`.
pub(super) fn passers(world: &World, spec: &SyntheticSpec, lap: u32, seconds: f32) -> Vec<Billboard> {
    let seed = mix(mix(folded(spec.seed), 0xBA), lap);
    let (near, far) = world.measures.walkway;
    (0..spec.passers)
        .map(|i| {
            let mut dice = Dice::new(seed, i);
            let start = dice.between(0.0, world.circuit.length());
            let pace = dice.between(0.7, 1.6) * dice.pick(&[-1.0, 1.0]);
            let across = dice.between(near, far) * dice.pick(&[-1.0, 1.0]);
            let way = world.circuit.at(start + pace * seconds);
            let at = way.position + Vector::from_heading(way.heading_radians).left() * across;
            Billboard { at, sprite: world.walkers.start + dice.below(world.walkers.len()) }
        })
        .collect()
}
