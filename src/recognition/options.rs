//! Settings of the decision.

use crate::verification::VerificationOptions;

/// Settings of the decision.
#[derive(Clone, Debug, PartialEq)]
pub struct RecognitionOptions {
    /// δ_ep: sampled frames that join a place unasked after its founding; default 5.
    pub place_interval: u32,
    /// Fewest effective inliers of two keyframes that may show one place; default 8.
    pub min_inliers: u32,
    /// Least probability at which a place is taken for the right one; default 0.5.
    pub accept_above: f32,
    /// Whether what was seen before counts; default true.
    pub sequence: bool,
    /// Most features that a keyframe keeps, so that it stays below 12 KiB; default 256. A frame that has fewer is poor:
    /// it founds no place unless the one before was, too.
    pub keyframe_features: usize,
    /// Most bytes of memory for the map and the keyframes that are searched; default 256 MiB.
    pub memory_bytes: usize,
    /// Never change the map; frames that match nothing are `unknown`. Default false.
    pub read_only: bool,
    /// Learn words online where the vocabulary covers the keyframes badly; default false.
    pub grow_vocabulary: bool,
    /// Tolerances of the verification.
    pub verification: VerificationOptions,
}

impl Default for RecognitionOptions {
    fn default() -> Self {
        Self {
            place_interval: 5,
            min_inliers: 8,
            accept_above: 0.5,
            sequence: true,
            keyframe_features: 256,
            memory_bytes: 256 << 20,
            read_only: false,
            grow_vocabulary: false,
            verification: VerificationOptions::default(),
        }
    }
}
