//! A network that answers with numbers about itself, such as how large its activations become.

use std::path::Path;

use super::card::{InputCard, ModelCard};
use super::engine::Network;
use super::error::CnnError;
use super::model::MODEL_FILE;
use super::preprocess::Preprocessor;
use super::runtime::OnnxRuntime;
use super::signature;
use crate::raster::RgbImage;

/// Runs a network all of whose outputs are f32 scalars.
#[derive(Debug)]
pub struct Observer {
    model: String,
    input: InputCard,
    network: Network,
    preprocessor: Preprocessor,
}

impl Observer {
    /// Opens the network of these bytes of an ONNX file, which takes what `card` says, and tries it once. It runs on
    /// one thread.
    ///
    /// # Errors
    /// [`CnnError::UnfitNetwork`] if it takes something else, or gives something else than scalars.
    pub fn open(card: &ModelCard, network: &[u8], runtime: &OnnxRuntime) -> Result<Self, CnnError> {
        let unfit = |reason| CnnError::UnfitNetwork { path: Path::new(MODEL_FILE).to_path_buf(), reason };
        let network = Network::from_onnx(&runtime.library, network, 1).map_err(unfit)?;
        signature::check_input(&network.inputs(), card).map_err(unfit)?;
        let preprocessor = Preprocessor::new(&card.input);
        let mut observer =
            Self { model: card.name.clone(), input: card.input.clone(), network, preprocessor };
        observer.observe(&RgbImage::new(1, 1)).map_err(|error| match error {
            CnnError::Inference { reason, .. } => unfit(reason),
            other => other,
        })?;
        Ok(observer)
    }

    /// The value of every output for one image, of any size, in the order in which the graph has them.
    ///
    /// # Errors
    /// [`CnnError::EmptyImage`] or [`CnnError::Inference`].
    pub fn observe(&mut self, image: &RgbImage) -> Result<Vec<f32>, CnnError> {
        let tensor = self.preprocessor.tensor(image)?;
        let shape = [1, 3, self.input.height_px, self.input.width_px];
        let fail = |reason| CnnError::Inference { model: self.model.clone(), reason };
        let outputs = self.network.run_all((&self.input.name, shape, tensor)).map_err(fail)?;
        let scalar = |values: Vec<f32>| match values.as_slice() {
            &[value] => Ok(value),
            _ => Err(fail(format!("{} values came out, expected one", values.len()))),
        };
        outputs.into_iter().map(scalar).collect()
    }
}
