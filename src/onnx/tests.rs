//! Models made, grafted and shrunk, and what ONNX Runtime computes with them.

use std::fs;
use std::path::Path;

use proptest::prelude::*;
use prost::Message;
use sha2::{Digest, Sha256};

use super::*;
use crate::cnn::{CARD_FILE, DescriptorModel, MODEL_FILE, installed_runtime};
use crate::onnx::proto::tensor_proto::DataLocation;
use crate::raster::RgbImage;

const SIDE_PX: usize = 16;

/// The direction of the output `descriptor` of `model` for an image of one colour; or why it cannot be run.
fn computed(model: &OnnxModel, dimensions: usize, colour: [u8; 3]) -> Option<Result<Vec<f32>, String>> {
    let runtime = installed_runtime()?;
    let folder = tempfile::tempdir().unwrap();
    let bytes = model.to_bytes();
    let hash: String = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    let card = format!(
        "name = 'toy'\nversion = '1'\ndescription = ''\nlicence = 'MIT'\nsource = ''\nrecipe = ''\nsha256 = '{hash}'\n\
         [input]\nname = 'image'\nwidth_px = {SIDE_PX}\nheight_px = {SIDE_PX}\nmean = 100.0\nscale = 1.0\n\
         [descriptor]\nname = 'descriptor'\ndimensions = {dimensions}\n\
         [decision]\nrecognise_above = 0.5\ncalibration_slope = 1.0\ncalibration_offset = 0.0\n\
         [training]\ndata = ''\n[metrics]\n"
    );
    fs::write(folder.path().join(CARD_FILE), card).unwrap();
    fs::write(folder.path().join(MODEL_FILE), bytes).unwrap();
    let image = RgbImage::from_pixels(2, 2, colour.repeat(4)).unwrap();
    let described = DescriptorModel::open(folder.path(), &runtime, 1)
        .and_then(|mut model| model.describe(&image))
        .map(|descriptor| descriptor.as_slice().to_vec());
    Some(described.map_err(|error| error.to_string()))
}

/// The means of an image's planes, under the name of a descriptor, and beside them an output nobody needs.
fn backbone() -> OnnxModel {
    let mut graph = GraphBuilder::new("backbone");
    let side = Dimension::Fixed(SIDE_PX);
    let image = graph.input("image", &[Dimension::Batch, Dimension::Fixed(3), side, side]);
    let pooled = graph.node("GlobalAveragePool", &[&image], &[]);
    let means = graph.node("Flatten", &[&pooled], &[("axis", Attribute::Int(1))]);
    graph.output("descriptor", &means, &[Dimension::Batch, Dimension::Fixed(3)]).unwrap();
    let unneeded = graph.weight("unneeded", &[1, 3], &[1.0, 2.0, 3.0]);
    let sum = graph.node("Add", &[&means, &unneeded], &[]);
    graph.output("scores", &sum, &[Dimension::Batch, Dimension::Fixed(3)]).unwrap();
    graph.finish()
}

/// A head of one matrix `[3, columns]` on the backbone's descriptor.
fn grafted(backbone: OnnxModel, matrix: &[f32]) -> Result<OnnxModel, OnnxError> {
    let columns = matrix.len() / 3;
    backbone.grafted(|graph| {
        let features = graph.value("descriptor")?;
        let weight = graph.weight("projection", &[3, columns], matrix);
        let projected = graph.node("MatMul", &[&features, &weight], &[]);
        graph.output("descriptor", &projected, &[Dimension::Batch, Dimension::Fixed(columns)])
    })
}

fn assert_near(computed: &[f32], expected: &[f32]) {
    let length = expected.iter().map(|value| value * value).sum::<f32>().sqrt();
    assert_eq!(computed.len(), expected.len());
    for (computed, expected) in computed.iter().zip(expected) {
        assert!((computed - expected / length).abs() < 1e-4, "{computed} for {expected}");
    }
}

#[test]
fn a_network_written_node_by_node_computes_what_its_nodes_say() {
    let Some(values) = computed(&backbone(), 3, [130, 140, 100]) else { return };
    assert_near(&values.unwrap(), &[30.0, 40.0, 0.0]);
}

#[test]
fn a_head_takes_the_place_of_the_outputs_and_what_nobody_needs_is_gone() {
    let model = grafted(backbone(), &[1.0, 0.0, 0.0, 2.0, 1.0, 1.0]).unwrap();
    assert_eq!(model.outputs().collect::<Vec<_>>(), ["descriptor"]);
    let graph = model.proto.graph.as_ref().unwrap();
    let operators: Vec<&str> = graph.node.iter().map(|node| node.op_type()).collect();
    assert_eq!(operators, ["GlobalAveragePool", "Flatten", "Identity", "MatMul", "Identity"]);
    assert_eq!(graph.initializer.iter().map(|weight| weight.name()).collect::<Vec<_>>(), ["projection"]);
    let Some(values) = computed(&model, 2, [130, 140, 110]) else { return };
    // Rows of the matrix are those of the planes.
    assert_near(&values.unwrap(), &[30.0 + 10.0, 80.0 + 10.0]);
}

#[test]
fn a_model_reads_back_as_it_was_written_with_what_is_said_of_it() {
    let mut model = backbone();
    model.describe("classes", "29");
    model.describe("classes", "30");
    let read = OnnxModel::read(&model.to_bytes()).unwrap();
    assert_eq!(read, model);
    assert_eq!(
        (read.described("classes"), read.described("places"), read.opset()),
        (Some("30"), None, OPSET)
    );
}

#[test]
fn weights_stored_as_half_give_the_same_to_three_digits_in_half_the_bytes() {
    let matrix: Vec<f32> = (0..300_u16).map(|index| f32::from(index) * 0.013 - 1.7).collect();
    let whole = grafted(backbone(), &matrix).unwrap();
    let half = whole.clone().stored_as_half();
    assert!(half.to_bytes().len() < whole.to_bytes().len() - 500);
    let colour = [130, 90, 110];
    let (Some(expected), Some(got)) = (computed(&whole, 100, colour), computed(&half, 100, colour)) else {
        return;
    };
    let (expected, got) = (expected.unwrap(), got.unwrap());
    assert!(expected.iter().zip(&got).all(|(expected, got)| (expected - got).abs() < 1e-3));
    assert_ne!(expected, got);
}

#[test]
fn weights_that_half_cannot_hold_and_small_ones_stay() {
    let mut large = vec![1.0; 300];
    large[7] = 70_000.0;
    for matrix in [large, vec![3e-8; 300], vec![f32::NAN; 300], vec![1.0; 30]] {
        let model = grafted(backbone(), &matrix).unwrap();
        assert_eq!(model.clone().stored_as_half(), model);
    }
}

#[test]
fn what_is_no_model_or_cannot_be_gone_on_with_is_refused_by_name() {
    assert!(matches!(OnnxModel::read(b"\xff\xff\xff"), Err(OnnxError::NotOnnx { .. })));
    assert!(matches!(OnnxModel::read(b""), Err(OnnxError::NotOnnx { .. })));
    let mut elsewhere = grafted(backbone(), &[0.0; 30]).unwrap();
    elsewhere.proto.graph.as_mut().unwrap().initializer[0].data_location =
        Some(DataLocation::External as i32);
    let error = OnnxModel::read(&elsewhere.to_bytes()).unwrap_err().to_string();
    assert!(error.contains("weight `projection` is kept in another file"), "{error}");
    let mut old = backbone();
    old.proto.opset_import[0].version = Some(11);
    let error = grafted(old, &[0.0; 3]).unwrap_err().to_string();
    assert!(error.contains("operator set 11") && error.contains("needs 13"), "{error}");
    let without = backbone().grafted(|graph| graph.value("features").map(drop));
    assert_eq!(without.unwrap_err().to_string(), "the model has no value `features`");
    let taken = backbone().grafted(|graph| {
        let means = graph.value("descriptor")?;
        graph.output("image", &means, &[Dimension::Batch, Dimension::Fixed(3)])
    });
    assert_eq!(taken.unwrap_err(), OnnxError::NameTaken { name: "image".to_owned() });
}

proptest! {
    #[test]
    fn no_bytes_bring_the_reader_down(position in any::<prop::sample::Index>(), byte: u8, cut: bool) {
        let mut bytes = grafted(backbone(), &[0.5; 30]).unwrap().to_bytes();
        let position = position.index(bytes.len());
        bytes[position] = byte;
        if cut {
            bytes.truncate(position);
        }
        if let Ok(model) = OnnxModel::read(&bytes) {
            let _ = grafted(model, &[1.0; 3]).map(OnnxModel::stored_as_half);
        }
    }
}

#[test]
fn the_shipped_backbone_takes_a_head() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/efficientnet-lite0").join(MODEL_FILE);
    let backbone = OnnxModel::read(&fs::read(path).unwrap()).unwrap();
    assert_eq!(backbone.outputs().collect::<Vec<_>>(), ["descriptor"]);
    let bytes = backbone.proto.encoded_len();
    let model = backbone.grafted(|graph| {
        let features = graph.value("descriptor")?;
        let weight = graph.weight("projection", &[512, 2], &[0.5; 1024]);
        let projected = graph.node("MatMul", &[&features, &weight], &[]);
        graph.output("descriptor", &projected, &[Dimension::Batch, Dimension::Fixed(2)])
    });
    let grown = model.unwrap().to_bytes().len();
    assert!((bytes..bytes + 10_000).contains(&grown), "{bytes} to {grown}");
}
