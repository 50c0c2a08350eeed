//! The pyramid: a frame in several sizes, so that corners are found whatever their size.

use super::OrbOptions;
use crate::kernel::Resizer;
use crate::raster::GreyImage;

/// The levels of the frame that was built last, from the finest on.
#[derive(Debug, Default)]
pub(super) struct Pyramid {
    levels: Vec<GreyImage>,
    /// Makes each level from the one before.
    resizers: Vec<Resizer>,
}

impl Pyramid {
    /// Builds the levels of `frame`, the finest of which is the frame, enlarged by a whole factor where it is narrow.
    pub(super) fn build(&mut self, frame: &GreyImage, options: &OrbOptions) {
        let enlargement = enlargement(frame, options);
        let (width, height) = (frame.width() * enlargement, frame.height() * enlargement);
        self.levels.resize_with(options.levels, || GreyImage::new(0, 0));
        self.resizers.resize_with(options.levels, Resizer::default);
        for octave in 0..options.levels {
            let shrink = options.scale_factor.powi(octave as i32);
            let size = |pixels: usize| (pixels as f32 / shrink).round() as usize;
            let (finer, level) = self.levels.split_at_mut(octave);
            let (finer, level) = (finer.last().unwrap_or(frame), &mut level[0]);
            level.resize(size(width), size(height));
            self.resizers[octave].resize_bilinear(finer, level);
        }
    }

    /// Every level, from the finest on, with the pixels of the frame that one of its pixels covers.
    pub(super) fn levels(
        &self,
        frame: &GreyImage,
        options: &OrbOptions,
    ) -> impl Iterator<Item = (&GreyImage, f32)> {
        let (enlargement, factor) = (enlargement(frame, options) as f32, options.scale_factor);
        self.levels.iter().zip(0..).map(move |(level, octave)| (level, factor.powi(octave) / enlargement))
    }
}

fn enlargement(frame: &GreyImage, options: &OrbOptions) -> usize {
    options.min_width_px.div_ceil(frame.width().max(1)).max(1)
}
