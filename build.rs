//! Compiles the description of the ONNX format for the feature `train`; otherwise nothing is built here.

use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    #[cfg(feature = "train")]
    compile_onnx()?;
    Ok(())
}

/// Compiled in Rust alone: no protoc is needed.
#[cfg(feature = "train")]
fn compile_onnx() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=src/onnx/onnx.proto");
    let descriptors = protox::compile(["src/onnx/onnx.proto"], ["src/onnx"])?;
    prost_build::Config::new().compile_fds(descriptors)?;
    Ok(())
}
