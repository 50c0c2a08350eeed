//! What was seen in a frame.

use crate::cnn;
use crate::feature::Features;
use crate::vocabulary::{Light, Quantised, VocabularySet};

/// What was seen in a frame.
#[derive(Clone, Debug, Default)]
pub struct Look {
    /// ORB features; of a frame of no size where nobody looked for any.
    pub features: Features,
    /// Under which light.
    pub light: Light,
    /// What the vocabulary of that light says of each feature.
    pub quantised: Vec<Quantised>,
    /// CNN descriptor, if a CNN is running.
    pub appearance: Option<cnn::Descriptor>,
}

impl Look {
    /// The words and nodes of `features` seen in `light`, with the CNN's descriptor of the same frame.
    #[must_use]
    pub fn new(
        features: Features,
        (vocabularies, light): (&VocabularySet, Light),
        appearance: Option<cnn::Descriptor>,
    ) -> Self {
        let quantised = vocabularies.vocabulary(light.condition).quantise_all(&features.descriptors);
        Self { features, light, quantised, appearance }
    }

    /// Whether features were looked for, and fewer found than a keyframe keeps: the frame is blurred, dark or covered,
    /// or there is little to be seen.
    #[must_use]
    pub fn is_poor(&self, keyframe_features: usize) -> bool {
        self.features.width_px > 0 && self.features.len() < keyframe_features
    }

    /// The node under which each feature is compared.
    pub(super) fn groups(&self) -> impl Iterator<Item = u32> {
        self.quantised.iter().map(|quantised| quantised.node.0)
    }
}
