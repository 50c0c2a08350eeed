//! The ORB extractor: a pyramid, corners on every level, an orientation and a descriptor for each.

use super::brief::TurnedPattern;
use super::detection::{Corner, CornerDetector};
use super::orientation::IntensityCentroid;
use super::pyramid::Pyramid;
use super::{Features, Keypoint};
use crate::geometry::Point;
use crate::kernel::Blur;
use crate::raster::GreyImage;

/// Settings of the extractor; the defaults are those of the ORB paper and of ORB-SLAM.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrbOptions {
    /// Most features a frame; default 1,000.
    pub max_features: usize,
    /// Levels of the pyramid; default 8.
    pub levels: usize,
    /// Ratio of the sizes of neighbouring levels; default 1.2.
    pub scale_factor: f32,
    /// FAST threshold in grey values; default 20.
    pub threshold: u8,
    /// FAST threshold in grey values for cells that the first leaves empty; default 7.
    pub fallback_threshold: u8,
    /// Frames narrower than this many pixels are enlarged by a whole factor first, to 4 megapixels at most;
    /// default 320.
    pub min_width_px: usize,
}

impl Default for OrbOptions {
    fn default() -> Self {
        Self {
            max_features: 1000,
            levels: 8,
            scale_factor: 1.2,
            threshold: 20,
            fallback_threshold: 7,
            min_width_px: 320,
        }
    }
}

/// Finds and describes ORB features, in memory that it keeps from frame to frame: as much as the largest one took.
#[derive(Debug)]
pub struct OrbExtractor {
    options: OrbOptions,
    /// Most features of each level.
    budgets: Vec<usize>,
    pyramid: Pyramid,
    detector: CornerDetector,
    centroid: IntensityCentroid,
    pattern: TurnedPattern,
    blur: Blur,
    corners: Vec<Corner>,
    angles_radians: Vec<f32>,
    blurred: GreyImage,
}

impl OrbExtractor {
    /// An extractor with these settings.
    #[must_use]
    pub fn new(options: OrbOptions) -> Self {
        Self {
            options,
            budgets: budgets(&options),
            pyramid: Pyramid::default(),
            detector: CornerDetector::default(),
            centroid: IntensityCentroid::new(),
            pattern: TurnedPattern::new(),
            blur: Blur::default(),
            corners: Vec::new(),
            angles_radians: Vec::new(),
            blurred: GreyImage::new(0, 0),
        }
    }

    /// Its settings.
    #[must_use]
    pub fn options(&self) -> &OrbOptions {
        &self.options
    }

    /// The features of `frame`, at most [`OrbOptions::max_features`]: on every level of the pyramid half of them spread
    /// over it, half the strongest of the rest.
    #[must_use]
    pub fn extract(&mut self, frame: &GreyImage) -> Features {
        let mut features = Features::default();
        self.extract_into(frame, &mut features);
        features
    }

    /// Replaces `features` by those of `frame`, in the memory that they have.
    pub fn extract_into(&mut self, frame: &GreyImage, features: &mut Features) {
        let most = self.options.max_features.min(frame.pixels().len());
        features.clear();
        features.keypoints.reserve(most);
        features.descriptors.reserve(most);
        (features.width_px, features.height_px) = (frame.width() as u32, frame.height() as u32);
        self.pyramid.build(frame, &self.options);
        for ((level, scale), &budget) in self.pyramid.levels(frame, &self.options).zip(&self.budgets) {
            self.detector.detect(level, &self.options, budget, &mut self.corners);
            if self.corners.is_empty() {
                continue;
            }
            self.centroid.measure(level, &self.corners, &mut self.angles_radians);
            self.blur.blur_7x7(level, &mut self.blurred);
            let descriptors = &mut features.descriptors;
            self.pattern.describe(&self.blurred, &self.corners, &self.angles_radians, descriptors);
            let found = self.corners.iter().zip(&self.angles_radians);
            features.keypoints.extend(found.map(|(corner, &angle_radians)| Keypoint {
                point: Point { x: in_frame(corner.x, scale), y: in_frame(corner.y, scale) },
                scale,
                angle_radians,
                response: corner.response,
            }));
        }
    }
}

/// Features a level, in proportion to the levels' side lengths, as in ORB-SLAM.
fn budgets(options: &OrbOptions) -> Vec<usize> {
    let shares: Vec<f32> =
        (0..options.levels).map(|level| options.scale_factor.powi(-(level as i32))).collect();
    let total: f32 = shares.iter().sum();
    let mut left = options.max_features;
    let mut budgets = Vec::with_capacity(shares.len());
    for (level, share) in shares.iter().enumerate() {
        let rounded = (options.max_features as f32 * share / total).round() as usize;
        let budget = if level + 1 == shares.len() { left } else { rounded.min(left) };
        left -= budget;
        budgets.push(budget);
    }
    budgets
}

/// A level's pixel coordinate in the frame; pixel centres lie half a pixel in.
fn in_frame(coordinate: usize, scale: f32) -> f32 {
    (coordinate as f32 + 0.5) * scale - 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    fn textured(width: usize, height: usize) -> GreyImage {
        let mut image = GreyImage::new(width, height);
        for y in 0..height {
            for (x, pixel) in image.row_mut(y).iter_mut().enumerate() {
                let block = (x / 9 * 7919 + y / 11 * 104_729) % 251;
                *pixel = block as u8;
            }
        }
        image
    }

    #[test]
    fn a_textured_frame_fills_its_budget_on_all_levels() {
        let features = OrbExtractor::new(OrbOptions::default()).extract(&textured(640, 480));
        assert_eq!(features.len(), 1000);
        assert_eq!(features.descriptors.len(), 1000);
        let coarsest = features.keypoints.iter().map(|keypoint| keypoint.scale).fold(0.0, f32::max);
        assert!((coarsest - 1.2_f32.powi(7)).abs() < 1e-3);
    }

    #[test]
    fn descriptors_are_those_of_the_blurred_level_where_its_corners_are() {
        let frame = textured(640, 480);
        let options = OrbOptions { levels: 1, ..OrbOptions::default() };
        let features = OrbExtractor::new(options).extract(&frame);
        let mut blurred = GreyImage::new(0, 0);
        Blur::default().blur_7x7(&frame, &mut blurred);
        let corner = |keypoint: &Keypoint| Corner {
            x: keypoint.point.x as usize,
            y: keypoint.point.y as usize,
            response: keypoint.response,
        };
        let corners: Vec<Corner> = features.keypoints.iter().map(corner).collect();
        let angles_radians: Vec<f32> =
            features.keypoints.iter().map(|keypoint| keypoint.angle_radians).collect();
        let mut expected = Vec::new();
        TurnedPattern::new().describe(&blurred, &corners, &angles_radians, &mut expected);
        assert_eq!(features.descriptors, expected);
    }

    #[test]
    fn points_of_coarser_levels_lie_at_the_centres_of_their_pixels() {
        let features = OrbExtractor::new(OrbOptions::default()).extract(&textured(640, 480));
        for keypoint in features.keypoints {
            let in_level = (keypoint.point.x + 0.5) / keypoint.scale - 0.5;
            assert!(in_level > 18.9 && (in_level - in_level.round()).abs() < 0.01, "{keypoint:?}");
        }
    }

    #[test]
    fn what_one_frame_left_behind_does_not_show_in_the_next() {
        let mut extractor = OrbExtractor::new(OrbOptions::default());
        for (width, height) in
            [(640, 480), (160, 120), (33, 200), (640, 480), (200, 33), (0, 0), (1, 1), (320, 240)]
        {
            let frame = textured(width, height);
            let fresh = OrbExtractor::new(OrbOptions::default()).extract(&frame);
            assert_eq!(extractor.extract(&frame), fresh, "{width}×{height}");
        }
    }

    #[test]
    fn small_frames_are_enlarged_and_keep_their_own_coordinates() {
        let features = OrbExtractor::new(OrbOptions::default()).extract(&textured(160, 120));
        assert!(features.len() > 100, "{}", features.len());
        assert!(
            features.keypoints.iter().all(|keypoint| keypoint.point.x < 160.0 && keypoint.point.y < 120.0)
        );
        assert!(features.keypoints.iter().any(|keypoint| keypoint.scale == 0.5));
    }

    #[test]
    fn flat_and_tiny_frames_have_no_features() {
        let mut extractor = OrbExtractor::new(OrbOptions::default());
        assert!(extractor.extract(&GreyImage::new(640, 480)).is_empty());
        assert!(extractor.extract(&GreyImage::new(1, 1)).is_empty());
    }

    #[test]
    fn a_shifted_frame_keeps_the_descriptors_of_its_finest_level() {
        let options = OrbOptions { max_features: 100_000, levels: 1, ..OrbOptions::default() };
        let (wide, mut extractor) = (textured(440, 320), OrbExtractor::new(options));
        let crop = |left: usize| {
            let rows = (0..320).flat_map(|y| wide.row(y)[left..left + 400].to_vec()).collect();
            GreyImage::from_pixels(400, 320, rows).unwrap()
        };
        // A shift by one detection cell, so that every cell keeps its own threshold.
        let (one, other) = (extractor.extract(&crop(0)), extractor.extract(&crop(35)));
        let inside = one
            .keypoints
            .iter()
            .zip(&one.descriptors)
            .filter(|(keypoint, _)| (70.0..350.0).contains(&keypoint.point.x));
        let found = |keypoint: &Keypoint, descriptor: &crate::feature::Descriptor| {
            let shifted = Point { x: keypoint.point.x - 35.0, y: keypoint.point.y };
            other.keypoints.iter().zip(&other.descriptors).any(|(candidate, other_descriptor)| {
                shifted.distance_squared(candidate.point) < 0.01 && descriptor == other_descriptor
            })
        };
        let (total, kept) = inside.fold((0, 0), |(total, kept), (keypoint, descriptor)| {
            (total + 1, kept + usize::from(found(keypoint, descriptor)))
        });
        assert!(total > 100 && kept == total, "{kept} of {total}");
    }
}
