//! Several vocabularies, one a lighting condition, and the switch between them (section III.C.1 of the
//! paper).
//!
//! Features look different by night, so words learnt by day split them badly. Each vocabulary knows the mean
//! luminance of the images it was trained on; a frame is read with the one whose light is nearest to its own.

use std::path::{Path, PathBuf};

use super::{Vocabulary, VocabularyError};

/// How much nearer to the light of another vocabulary a frame must be before that one takes over, in grey
/// levels (of 255): a stream at dusk must not change vocabularies with every cloud.
const HYSTERESIS_LUMINANCE: f32 = 8.0;

/// A lighting condition: which vocabulary of a set, counted from the darkest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConditionId(pub u8);

/// The light of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Light {
    /// Mean luminance of the frame, 0 to 255.
    pub mean_luminance: f32,
    /// The condition that it counts as.
    pub condition: ConditionId,
}

/// Vocabularies from the darkest to the brightest; often only one.
#[derive(Debug)]
pub struct VocabularySet {
    vocabularies: Vec<Vocabulary>,
    names: Vec<String>,
}

impl From<Vocabulary> for VocabularySet {
    fn from(vocabulary: Vocabulary) -> Self {
        Self { vocabularies: vec![vocabulary], names: vec![String::new()] }
    }
}

impl VocabularySet {
    /// Maps the vocabularies at `paths`; each names its condition by its file name.
    ///
    /// # Errors
    /// If one cannot be opened; or if of several one does not say under which light it was trained, or two
    /// were trained under light so alike that none would ever be switched to.
    pub fn open(paths: &[PathBuf]) -> Result<Self, VocabularyError> {
        let mut members = Vec::new();
        for path in paths {
            members.push((path.clone(), Vocabulary::open(path)?));
        }
        Self::new(members)
    }

    /// A set of these vocabularies; a path names its condition and serves messages.
    ///
    /// # Errors
    /// As [`open`](Self::open), but for the opening.
    pub fn new(mut members: Vec<(PathBuf, Vocabulary)>) -> Result<Self, VocabularyError> {
        if members.is_empty() || members.len() > usize::from(u8::MAX) {
            return Err(VocabularyError::BadSet { reason: format!("{} vocabularies", members.len()) });
        }
        if members.len() > 1 {
            check_light(&members)?;
        }
        let luminance = |vocabulary: &Vocabulary| vocabulary.luminance().unwrap_or_default();
        members.sort_by(|a, b| luminance(&a.1).total_cmp(&luminance(&b.1)));
        let name = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let names = members.iter().map(|member| name(&member.0)).collect();
        Ok(Self { vocabularies: members.into_iter().map(|member| member.1).collect(), names })
    }

    /// The vocabulary for `condition`; of a condition that the set does not have, the brightest.
    #[must_use]
    pub fn vocabulary(&self, condition: ConditionId) -> &Vocabulary {
        &self.vocabularies[usize::from(condition.0).min(self.vocabularies.len() - 1)]
    }

    /// All conditions, from the darkest.
    pub fn conditions(&self) -> impl Iterator<Item = ConditionId> + use<> {
        (0..self.vocabularies.len() as u8).map(ConditionId)
    }

    /// What people call a condition: the name of its file.
    #[must_use]
    pub fn name(&self, condition: ConditionId) -> &str {
        &self.names[usize::from(condition.0).min(self.names.len() - 1)]
    }

    /// The condition whose light is nearest to `mean_luminance`.
    #[must_use]
    pub fn nearest(&self, mean_luminance: f32) -> ConditionId {
        let far = |condition: &ConditionId| self.distance(*condition, mean_luminance);
        let nearest = self.conditions().min_by(|a, b| far(a).total_cmp(&far(b)));
        nearest.unwrap_or_default()
    }

    /// Whether a frame of `mean_luminance` may count as `condition`, depending on the frames before it.
    #[must_use]
    pub fn may_count_as(&self, condition: ConditionId, mean_luminance: f32) -> bool {
        let nearest = self.nearest(mean_luminance);
        let margin = self.distance(condition, mean_luminance) - self.distance(nearest, mean_luminance);
        margin <= HYSTERESIS_LUMINANCE
    }

    fn distance(&self, condition: ConditionId, mean_luminance: f32) -> f32 {
        let of_vocabulary = self.vocabulary(condition).luminance().unwrap_or_default();
        (of_vocabulary - mean_luminance).abs()
    }
}

fn check_light(members: &[(PathBuf, Vocabulary)]) -> Result<(), VocabularyError> {
    let bad = |reason: String| Err(VocabularyError::BadSet { reason });
    for (index, (path, vocabulary)) in members.iter().enumerate() {
        let Some(luminance) = vocabulary.luminance() else {
            return bad(format!(
                "{} does not say under which light it was trained: `loci vocab import --weights-from IMAGES` learns it",
                path.display()
            ));
        };
        let is_twin = |other: f32| (other - luminance).abs() <= HYSTERESIS_LUMINANCE;
        if let Some(twin) = members[..index].iter().find(|member| member.1.luminance().is_some_and(is_twin)) {
            return bad(format!(
                "{} and {} were trained under the same light, or nearly so",
                twin.0.display(),
                path.display()
            ));
        }
    }
    Ok(())
}

/// Follows the light of a stream: which condition each frame counts as.
#[derive(Clone, Copy, Debug, Default)]
pub struct LightSwitch {
    current: Option<ConditionId>,
}

impl LightSwitch {
    /// The light of the next frame. The condition changes only where another one fits clearly better.
    pub fn follow(&mut self, set: &VocabularySet, mean_luminance: f32) -> Light {
        let kept = self.current.filter(|&current| set.may_count_as(current, mean_luminance));
        let condition = kept.unwrap_or_else(|| set.nearest(mean_luminance));
        self.current = Some(condition);
        Light { mean_luminance, condition }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::Descriptor;
    use crate::vocabulary::{MemoryCorpus, TrainingOptions, train, train_on};

    fn trained_at(mean_luminance: f32) -> Vocabulary {
        let images = [(0..40).map(|index| Descriptor([index * 6; 32])).collect()];
        let corpus = MemoryCorpus { images: &images, mean_luminance: Some(mean_luminance) };
        let options = TrainingOptions { branching: 3, depth: 2, ..TrainingOptions::default() };
        train_on(&corpus, options, &()).unwrap().vocabulary
    }

    fn set(luminances: &[f32]) -> VocabularySet {
        let member = |&luminance: &f32| (PathBuf::from(format!("{luminance}.lvoc")), trained_at(luminance));
        VocabularySet::new(luminances.iter().map(member).collect()).unwrap()
    }

    #[test]
    fn a_frame_is_read_with_the_vocabulary_of_the_nearest_light() {
        let set = set(&[120.0, 30.0, 70.0]);
        let name = |luminance: f32| set.name(set.nearest(luminance)).to_owned();
        assert_eq!([0.0, 45.0, 55.0, 94.0, 96.0, 255.0].map(name), ["30", "30", "70", "70", "120", "120"]);
    }

    #[test]
    fn a_stream_on_the_border_does_not_flicker() {
        let set = set(&[40.0, 100.0]);
        let mut switch = LightSwitch::default();
        let mut follow = |luminance: f32| switch.follow(&set, luminance).condition.0;
        assert_eq!(
            [68.0, 72.0, 69.0, 73.9, 74.1, 71.0, 66.1, 65.9].map(&mut follow),
            [0, 0, 0, 0, 1, 1, 1, 0]
        );
    }

    #[test]
    fn one_vocabulary_needs_to_know_no_light_and_several_do() {
        let unlit =
            || train(&[vec![Descriptor([1; 32]), Descriptor([9; 32])]], TrainingOptions::default()).unwrap();
        let single = VocabularySet::from(unlit());
        assert_eq!(single.nearest(3.0), ConditionId(0));
        let error = |members| VocabularySet::new(members).unwrap_err().to_string();
        let (old, day) = (PathBuf::from("old.lvoc"), PathBuf::from("day.lvoc"));
        assert!(
            error(vec![(day.clone(), trained_at(90.0)), (old.clone(), unlit())])
                .contains("old.lvoc does not say")
        );
        assert!(error(vec![(day, trained_at(90.0)), (old, trained_at(98.0))]).contains("same light"));
        assert!(error(vec![]).contains("0 vocabularies"));
    }
}
