//! What recognises in maps that are compared, all of whose places are searched. The CNN itself is not needed: maps hold
//! its descriptors.

use std::path::Path;
use std::sync::Arc;

use loci::cnn::{CARD_FILE, ModelCard};
use loci::place_map::PlaceMap;
use loci::recognition::{Recogniser, RecognitionOptions};
use loci::vocabulary::VocabularySet;

use crate::cli::settings::StreamSettings;
use crate::cli::{assets, stream};

/// The vocabularies and, unless geometry decides alone, the card of the CNN.
pub(in crate::cli) struct Eyes {
    vocabularies: Arc<VocabularySet>,
    card: Option<ModelCard>,
}

impl Eyes {
    /// Those that `settings` name, or those that ship.
    pub(in crate::cli) fn new(settings: &StreamSettings) -> anyhow::Result<Self> {
        let vocabularies = Arc::new(VocabularySet::open(&assets::find_vocabularies(&settings.vocab)?)?);
        let card = if settings.is_without_cnn() { None } else { card(settings.model.as_deref())? };
        Ok(Self { vocabularies, card })
    }

    /// What recognises in the map in `folder`.
    pub(in crate::cli) fn open(&self, folder: &Path) -> anyhow::Result<Recogniser> {
        let options =
            RecognitionOptions { read_only: true, memory_bytes: usize::MAX, ..RecognitionOptions::default() };
        let map = PlaceMap::open_read_only(folder)?;
        Ok(Recogniser::new(self.vocabularies.clone(), map, self.card.clone(), options)?)
    }

    /// Says how many keyframes have descriptors of another CNN, which count for nothing.
    pub(in crate::cli) fn report_foreign(&self, opened: &[&Recogniser]) {
        let foreign = opened.iter().map(|recogniser| recogniser.foreign_descriptors()).sum();
        stream::report_foreign_descriptors(foreign, self.card.as_ref(), "");
    }
}

/// The card of the model `named`, or of the shipped one; where that is missing, geometry goes on without it.
fn card(named: Option<&Path>) -> anyhow::Result<Option<ModelCard>> {
    let Some(model) = named.map(Path::to_owned).or_else(|| assets::find_shipped(assets::MODEL)) else {
        let model = assets::MODEL;
        eprintln!(
            "loci: NO CNN, going on with geometry alone: {model} not found here nor beside the program; name it \
             with --model"
        );
        return Ok(None);
    };
    Ok(Some(ModelCard::read(&model.join(CARD_FILE))?))
}
