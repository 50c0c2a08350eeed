//! Textures: texels with a chain of halved levels (mip-map), sampled one screen column at a time.
//!
//! Texels lie column by column, each column from the ground upwards, because a wall is drawn in
//! vertical screen columns. Colours are kept with a gamma of 2, so squaring a byte makes it linear light.

use super::canvas::Canvas;

/// Red, green, blue, and a fourth byte: how strongly the texel glows, or, in a sprite, its opacity.
pub(super) type Texel = [u8; 4];

/// Linear light, or a texel with all channels scaled to [0, 1]; the fourth channel as in [`Texel`].
pub(super) type Radiance = [f32; 4];

#[derive(Clone, Debug)]
struct Level {
    width_px: usize,
    height_px: usize,
    texels: Vec<Texel>,
}

impl Level {
    fn column(&self, x: usize) -> &[Texel] {
        &self.texels[x * self.height_px..(x + 1) * self.height_px]
    }

    /// Half the size, every texel the mean of four.
    fn halved(&self) -> Self {
        let (width_px, height_px) = (self.width_px.div_ceil(2), self.height_px.div_ceil(2));
        let mut texels = Vec::with_capacity(width_px * height_px);
        for x in 0..width_px {
            let (left, right) = (self.column(2 * x), self.column((2 * x + 1).min(self.width_px - 1)));
            for y in 0..height_px {
                let (low, high) = (2 * y, (2 * y + 1).min(self.height_px - 1));
                let mean = |c: usize| {
                    let sum = [left[low][c], left[high][c], right[low][c], right[high][c]];
                    (sum.into_iter().map(u16::from).sum::<u16>() / 4) as u8
                };
                texels.push([mean(0), mean(1), mean(2), mean(3)]);
            }
        }
        Self { width_px, height_px, texels }
    }
}

/// A mip-mapped texture that knows its size in the world.
#[derive(Clone, Debug)]
pub(super) struct Texture {
    levels: Vec<Level>,
    px_per_metre: f32,
}

/// Most texture columns averaged for one screen column.
const MAX_TAPS: usize = 8;

impl From<Canvas> for Texture {
    fn from(canvas: Canvas) -> Self {
        let (width_px, height_px) = (canvas.width_px(), canvas.height_px());
        let px_per_metre = canvas.px_per_metre();
        let mut levels = vec![Level { width_px, height_px, texels: canvas.into_texels() }];
        while let Some(last) = levels.last()
            && last.width_px.min(last.height_px) > 4
        {
            let next = last.halved();
            levels.push(next);
        }
        Self { levels, px_per_metre }
    }
}

impl Texture {
    /// Width in metres.
    pub(super) fn width_metres(&self) -> f32 {
        self.levels[0].width_px as f32 / self.px_per_metre
    }

    /// Height in metres.
    pub(super) fn height_metres(&self) -> f32 {
        self.levels[0].height_px as f32 / self.px_per_metre
    }

    /// The level whose texels are about `footprint_metres` large.
    pub(super) fn level_for(&self, footprint_metres: f32) -> usize {
        let texels = footprint_metres * self.px_per_metre;
        (texels.max(1.0).log2().round() as usize).min(self.levels.len() - 1)
    }

    /// Texels per metre at `level`.
    pub(super) fn density(&self, level: usize) -> f32 {
        self.px_per_metre / (1_u32 << level) as f32
    }

    /// Height in texels at `level`.
    pub(super) fn height_px(&self, level: usize) -> usize {
        self.levels[level].height_px
    }

    /// Appends texels `rows` of the vertical line at `across_metres` to `strip`, averaged over
    /// `span_metres` to the left and right together, channels scaled to [0, 1].
    pub(super) fn read_strip(
        &self,
        level: usize,
        (across_metres, span_metres): (f32, f32),
        rows: std::ops::Range<usize>,
        strip: &mut Vec<Radiance>,
    ) {
        let (density, level) = (self.density(level), &self.levels[level]);
        let (centre, span) = (across_metres * density - 0.5, span_metres * density);
        let taps = (span.round() as usize).clamp(1, MAX_TAPS);
        let clamp = |x: f32| (x.max(0.0) as usize).min(level.width_px - 1);
        let first = strip.len();
        strip.resize(first + rows.len(), [0.0; 4]);
        let mut add = |column: usize, weight: f32| {
            let weight = weight / 255.0;
            for (sum, texel) in strip[first..].iter_mut().zip(&level.column(column)[rows.clone()]) {
                for c in 0..4 {
                    sum[c] += weight * f32::from(texel[c]);
                }
            }
        };
        if taps == 1 {
            let fraction = (centre - centre.floor()).clamp(0.0, 1.0);
            add(clamp(centre), 1.0 - fraction);
            add(clamp(centre.floor() + 1.0), fraction);
        } else {
            for tap in 0..taps {
                let offset = ((tap as f32 + 0.5) / taps as f32 - 0.5) * span;
                add(clamp((centre + offset).round()), 1.0 / taps as f32);
            }
        }
    }

    /// The texture at a point, bilinear, channels scaled to [0, 1]; the rim continues outwards
    /// and levels past the last one are the last one.
    #[inline]
    pub(super) fn sample(&self, level: usize, x_metres: f32, y_metres: f32) -> Radiance {
        let level = level.min(self.levels.len() - 1);
        let (density, level) = (self.density(level), &self.levels[level]);
        let x = (x_metres * density - 0.5).clamp(0.0, (level.width_px - 1) as f32);
        let y = (y_metres * density - 0.5).clamp(0.0, (level.height_px - 1) as f32);
        let (column, row) = (x as usize, y as usize);
        let (right, up) = (x - column as f32, y - row as f32);
        let step = usize::from(column + 1 < level.width_px) * level.height_px;
        let rise = usize::from(row + 1 < level.height_px);
        let at = column * level.height_px + row;
        let taps = [at, at + rise, at + step, at + step + rise].map(|i| level.texels[i]);
        let weights = [(1.0 - right) * (1.0 - up), (1.0 - right) * up, right * (1.0 - up), right * up];
        let mut sum = [0.0; 4];
        for (texel, weight) in taps.iter().zip(weights) {
            let weight = weight / 255.0;
            for c in 0..4 {
                sum[c] += weight * f32::from(texel[c]);
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::super::canvas::Area;
    use super::*;

    fn half_white() -> Texture {
        let mut canvas = Canvas::wall((2.0, 1.0), 32.0, [0, 0, 0]);
        canvas.fill(Area::new(1.0, 0.0, 1.0, 1.0), [255, 255, 255]);
        canvas.into()
    }

    #[test]
    fn every_level_is_as_bright_as_the_finest() {
        let texture = half_white();
        for level in &texture.levels {
            let sum: f64 = level.texels.iter().map(|texel| f64::from(texel[0])).sum();
            assert!((sum / level.texels.len() as f64 - 127.5).abs() < 1.0, "{level:?}");
        }
    }

    #[test]
    fn a_strip_and_a_sample_agree() {
        let texture = half_white();
        for level in 0..3 {
            for across in [0.2, 0.97, 1.0, 1.02, 1.9] {
                let mut strip = Vec::new();
                texture.read_strip(level, (across, 0.0), 0..texture.height_px(level), &mut strip);
                let sample = texture.sample(level, across, 0.5);
                assert!((strip[1][0] - sample[0]).abs() < 1e-4, "level {level} at {across}");
            }
        }
    }

    #[test]
    fn a_wide_footprint_averages_what_it_covers() {
        let mut strip = Vec::new();
        half_white().read_strip(0, (1.0, 0.25), 0..1, &mut strip);
        assert!((strip[0][0] - 0.5).abs() < 1e-3, "{strip:?}");
    }
}
