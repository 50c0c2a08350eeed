//! Deterministic randomness: integer hashes, dice and value noise.
//!
//! Everything random in a world is a pure function of the seed and of what it is for, so any frame can
//! be drawn without drawing the ones before it. Hash: the two-multiply finaliser `lowbias32` of
//! C. Wellons, *Prospecting for Hash Functions* (2018).

/// A well-mixed 32-bit hash of a seed and a value.
pub(super) fn mix(seed: u32, value: u32) -> u32 {
    let mut hash = seed.wrapping_add(0x9E37_79B9) ^ value.wrapping_mul(0x85EB_CA6B);
    hash = (hash ^ (hash >> 16)).wrapping_mul(0x7FEB_352D);
    hash = (hash ^ (hash >> 15)).wrapping_mul(0x846C_A68B);
    hash ^ (hash >> 16)
}

/// The seed that a person gave, as textures use it.
pub(super) fn folded(seed: u64) -> u32 {
    mix(seed as u32, (seed >> 32) as u32)
}

/// A hash as a number in [0, 1).
pub(super) fn unit(hash: u32) -> f32 {
    (hash >> 8) as f32 / 16_777_216.0
}

/// A row of dice throws that depends on the seed alone.
#[derive(Clone, Debug)]
pub(super) struct Dice {
    seed: u32,
    throws: u32,
}

impl Dice {
    /// Dice for the purpose `salt`.
    pub(super) fn new(seed: u32, salt: u32) -> Self {
        Self { seed: mix(seed, salt), throws: 0 }
    }

    /// 32 random bits.
    pub(super) fn bits(&mut self) -> u32 {
        self.throws = self.throws.wrapping_add(1);
        mix(self.seed, self.throws)
    }

    /// A number in [low, high).
    pub(super) fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * unit(self.bits())
    }

    /// `true` in `probability` of all throws.
    pub(super) fn chance(&mut self, probability: f32) -> bool {
        unit(self.bits()) < probability
    }

    /// A whole number below `count`, which must be positive.
    pub(super) fn below(&mut self, count: usize) -> usize {
        self.bits() as usize % count
    }

    /// One of `choices`, which must not be empty.
    pub(super) fn pick<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len())]
    }
}

fn smooth(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

/// Value noise in one dimension, in [−1, 1]; one independent value per unit of `t`.
pub(super) fn wave(seed: u32, t: f32) -> f32 {
    let cell = t.floor();
    let value = |offset: i32| unit(mix(seed, (cell as i32).wrapping_add(offset) as u32)) * 2.0 - 1.0;
    value(0) + (value(1) - value(0)) * smooth(t - cell)
}

/// Value noise in the plane, in [0, 1]; one independent value per unit square.
pub(super) fn value_noise(seed: u32, x: f32, y: f32) -> f32 {
    let (column, row) = (x.floor(), y.floor());
    let (right, down) = (smooth(x - column), smooth(y - row));
    let corner = |dx: i32, dy: i32| {
        let row_seed = mix(seed, (row as i32).wrapping_add(dy) as u32);
        unit(mix(row_seed, (column as i32).wrapping_add(dx) as u32))
    };
    let upper = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * right;
    let lower = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * right;
    upper + (lower - upper) * down
}

/// Octaves of value noise, each twice as fine and half as strong, in [0, 1].
pub(super) fn fractal_noise(seed: u32, x: f32, y: f32, octaves: u32) -> f32 {
    let (mut sum, mut total, mut weight, mut frequency) = (0.0, 0.0, 1.0, 1.0);
    for octave in 0..octaves {
        sum += weight * value_noise(mix(seed, octave), x * frequency, y * frequency);
        total += weight;
        weight *= 0.5;
        frequency *= 2.0;
    }
    sum / total
}

/// Side of the grain tile in texels.
const GRAIN_PX: usize = 256;

/// A tile of surface grain, computed once and laid over every texture.
#[derive(Clone, Debug)]
pub(super) struct Grain {
    values: Vec<f32>,
}

impl Grain {
    /// The grain of the world `seed`.
    pub(super) fn new(seed: u32) -> Self {
        let value = |i: usize| {
            let (x, y) = ((i % GRAIN_PX) as f32, (i / GRAIN_PX) as f32);
            let cloud = fractal_noise(seed, x / 24.0, y / 24.0, 3);
            let speck = unit(mix(seed ^ 0x51, i as u32));
            (cloud - 0.5) * 1.5 + (speck - 0.5) * 0.7
        };
        Self { values: (0..GRAIN_PX * GRAIN_PX).map(value).collect() }
    }

    /// The grain at a texel, about −1 to 1; the tile repeats.
    #[inline]
    pub(super) fn at(&self, x: usize, y: usize) -> f32 {
        self.values[(y % GRAIN_PX) * GRAIN_PX + x % GRAIN_PX]
    }
}
