//! ORB features: oriented FAST keypoints with rotated BRIEF descriptors (Rublee et al., *ORB: an
//! efficient alternative to SIFT or SURF*, ICCV 2011).

mod brief;
mod brief_pattern;
mod detection;
mod orb;
mod orientation;
mod pyramid;

pub use orb::{OrbExtractor, OrbOptions};

use crate::geometry::{OrientedPoint, Point};
use crate::kernel;

/// A 256-bit binary descriptor; bit i is bit i mod 8 of byte i / 8, as in OpenCV.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Descriptor(pub [u8; 32]);

impl Descriptor {
    /// Number of differing bits, 0 to 256.
    #[inline]
    #[must_use]
    pub fn distance(&self, other: &Self) -> u32 {
        kernel::hamming(&self.0, &other.0)
    }
}

/// A corner with its size and direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Position in pixels of the frame as it came, before any enlargement.
    pub point: Point,
    /// Pixels of the frame that one pixel of the pyramid level covers.
    pub scale: f32,
    /// Direction of the intensity centroid in radians, from the x axis towards the y axis.
    pub angle_radians: f32,
    /// FAST score: the largest threshold at which this is still a corner.
    pub response: u8,
}

impl Keypoint {
    /// What geometry needs of it.
    #[must_use]
    pub fn oriented_point(&self) -> OrientedPoint {
        OrientedPoint { point: self.point, scale: self.scale, angle_radians: self.angle_radians }
    }
}

/// All features of one frame; `keypoints[i]` and `descriptors[i]` belong together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Width of the frame in pixels.
    pub width_px: u32,
    /// Height of the frame in pixels.
    pub height_px: u32,
    /// Where the features are.
    pub keypoints: Vec<Keypoint>,
    /// What they look like.
    pub descriptors: Vec<Descriptor>,
}

impl Features {
    /// Number of features.
    #[must_use]
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether the frame showed nothing to hold on to.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// Makes them those of a frame of no size, and keeps their memory.
    pub fn clear(&mut self) {
        self.keypoints.clear();
        self.descriptors.clear();
        (self.width_px, self.height_px) = (0, 0);
    }

    /// The `count` features that stand for all of them best, in their order: of every pyramid level the same share,
    /// those first that the extractor chose first.
    #[must_use]
    pub fn foremost(&self, count: usize) -> Self {
        if self.len() <= count {
            return self.clone();
        }
        let mut ranked: Vec<(f32, usize)> = Vec::with_capacity(self.len());
        for level in self.keypoints.chunk_by(|a, b| a.scale == b.scale) {
            let start = ranked.len();
            ranked.extend((0..level.len()).map(|rank| (rank as f32 / level.len() as f32, start + rank)));
        }
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        ranked.truncate(count);
        ranked.sort_by_key(|&(_, index)| index);
        Self {
            width_px: self.width_px,
            height_px: self.height_px,
            keypoints: ranked.iter().map(|&(_, index)| self.keypoints[index]).collect(),
            descriptors: ranked.iter().map(|&(_, index)| self.descriptors[index]).collect(),
        }
    }

    /// Length of the frame's diagonal in pixels, the unit of geometric tolerances.
    #[must_use]
    pub fn diagonal_px(&self) -> f32 {
        (self.width_px as f32).hypot(self.height_px as f32)
    }
}
