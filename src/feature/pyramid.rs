//! The pyramid: a frame in several sizes, so that corners are found whatever their size.

use super::OrbOptions;
use crate::kernel::Resizer;
use crate::raster::GreyImage;

/// Most pixels that a frame is enlarged to.
const MOST_ENLARGED_PX: usize = 1 << 22;

/// The levels of the frame that was built last.
#[derive(Debug, Default)]
pub(super) struct Pyramid {
    /// From the finest on; where that is the frame itself, nothing lies in its place.
    levels: Vec<GreyImage>,
    /// Makes each level from the one before.
    resizers: Vec<Resizer>,
    /// By what factor the frame was enlarged for the finest one.
    enlargement: usize,
}

impl Pyramid {
    /// Builds the levels of `frame`, the finest of which is the frame, enlarged by a whole factor where it is narrow.
    pub(super) fn build(&mut self, frame: &GreyImage, options: &OrbOptions) {
        self.enlargement = enlargement(frame, options);
        let (width, height) = (frame.width() * self.enlargement, frame.height() * self.enlargement);
        self.levels.resize_with(options.levels, || GreyImage::new(0, 0));
        self.resizers.resize_with(options.levels, Resizer::default);
        let first = usize::from(self.enlargement == 1);
        for octave in first..options.levels {
            let shrink = options.scale_factor.powi(octave as i32);
            let size = |pixels: usize| (pixels as f32 / shrink).round() as usize;
            let (finer, level) = self.levels.split_at_mut(octave);
            let finer = finer[first..].last().unwrap_or(frame);
            level[0].reshape(size(width), size(height));
            self.resizers[octave].resize_bilinear(finer, &mut level[0]);
        }
    }

    /// Every level of `frame`, which was given to [`build`](Self::build) last, from the finest on, with the pixels of
    /// the frame that one of its pixels covers.
    pub(super) fn levels<'a>(
        &'a self,
        frame: &'a GreyImage,
        options: &OrbOptions,
    ) -> impl Iterator<Item = (&'a GreyImage, f32)> {
        let (enlargement, factor) = (self.enlargement, options.scale_factor);
        self.levels.iter().zip(0..).map(move |(level, octave)| {
            let level = if octave == 0 && enlargement == 1 { frame } else { level };
            (level, factor.powi(octave) / enlargement as f32)
        })
    }
}

/// By what factor a frame is enlarged; one that is narrow and high would become too large.
fn enlargement(frame: &GreyImage, options: &OrbOptions) -> usize {
    let wanted = options.min_width_px.div_ceil(frame.width().max(1)).max(1);
    let most = (MOST_ENLARGED_PX / frame.pixels().len().max(1)).isqrt().max(1);
    wanted.min(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn narrow_frames_are_enlarged_by_whole_factors_but_not_beyond_memory() {
        let of = |width, height| enlargement(&GreyImage::new(width, height), &OrbOptions::default());
        assert_eq!([of(640, 480), of(320, 240), of(160, 120), of(107, 80), of(32, 32)], [1, 1, 2, 3, 10]);
        assert_eq!([of(32, 8192), of(1, 8192), of(0, 0)], [4, 22, 320]);
    }

    #[test]
    fn every_level_is_the_one_before_made_smaller_by_the_factor() {
        let (mut pyramid, options) = (Pyramid::default(), OrbOptions { levels: 3, ..OrbOptions::default() });
        for (width, height) in [(160, 120), (640, 480), (160, 100)] {
            let frame = GreyImage::new(width, height);
            pyramid.build(&frame, &options);
            let base = width.max(320) as f32;
            let levels: Vec<_> = pyramid.levels(&frame, &options).collect();
            assert_eq!(levels.len(), 3);
            for (octave, (level, scale)) in (0..).zip(levels) {
                assert_eq!(level.width(), (base / 1.2_f32.powi(octave)).round() as usize);
                assert!((scale * level.width() as f32 / width as f32 - 1.0).abs() < 0.01, "{scale}");
            }
        }
    }
}
