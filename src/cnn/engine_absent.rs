//! Stands in for `engine` in a build without the feature `cnn`: nothing can be loaded, so nothing else is reached.

use std::path::Path;

use super::error::CnnError;
use super::signature::Port;

/// Never exists in this build.
#[derive(Clone, Debug)]
pub(super) struct Library(());

/// This build has no CNN.
pub(super) fn built() -> Result<(), CnnError> {
    Err(CnnError::NotBuilt)
}

pub(super) fn load(_: &Path) -> Result<Library, CnnError> {
    Err(CnnError::NotBuilt)
}

pub(super) fn sha256_hex(_: &[u8]) -> String {
    String::new()
}

/// Never exists in this build.
#[derive(Debug)]
pub(super) struct Network(());

impl Network {
    pub(super) fn from_onnx(_: &Library, _: &[u8], _: usize) -> Result<Self, String> {
        Err(CnnError::NotBuilt.to_string())
    }

    pub(super) fn inputs(&self) -> Vec<Port> {
        Vec::new()
    }

    pub(super) fn outputs(&self) -> Vec<Port> {
        Vec::new()
    }

    pub(super) fn prepared(self, _: [usize; 4], _: (&str, [usize; 2])) -> Result<PreparedNetwork, String> {
        Err(CnnError::NotBuilt.to_string())
    }
}

/// Never exists in this build.
#[derive(Debug)]
pub(super) struct PreparedNetwork(());

impl PreparedNetwork {
    pub(super) fn input(&mut self) -> &mut [f32] {
        &mut []
    }

    pub(super) fn run(&mut self, _: &mut Vec<f32>) -> Result<(), String> {
        Err(CnnError::NotBuilt.to_string())
    }
}
