//! Which parts of a graph are quantised, and which graphs are refused.

use proptest::prelude::*;

use super::*;
use crate::onnx::proto::tensor_proto::DataType;
use crate::onnx::proto::{NodeProto, TensorProto};
use crate::onnx::{Dimension, GraphBuilder};

const FOLLOWS_CONVOLUTION: [&str; 3] = ["QuantizeLinear", "DequantizeLinear", "MaxPool"];

/// Weights that differ from each other.
fn weights(count: usize) -> Vec<f32> {
    (0..count).map(|index| ((index * 37 % 101) as f32 - 50.0) / 90.0).collect()
}

/// conv, ReLU, max pool, conv and Add, global pool, product, ReLU, and a product that is the head.
fn network() -> OnnxModel {
    let mut graph = GraphBuilder::new("toy");
    let side = Dimension::Fixed(16);
    let image = graph.input("image", &[Dimension::Batch, Dimension::Fixed(3), side, side]);
    let first = graph.weight("first", &[40, 3, 3, 3], &weights(1080));
    let bias = graph.weight("bias", &[40], &weights(40));
    let conv = graph.node("Conv", &[&image, &first, &bias], &[("pads", Attribute::Ints(vec![1; 4]))]);
    let relu = graph.node("Relu", &[&conv], &[]);
    let pooled = graph.node("MaxPool", &[&relu], &[("kernel_shape", Attribute::Ints(vec![2, 2]))]);
    let second = graph.weight("second", &[40, 40, 1, 1], &weights(1600));
    let conv = graph.node("Conv", &[&pooled, &second], &[]);
    let sum = graph.node("Add", &[&conv, &pooled], &[]);
    let means = graph.node("GlobalAveragePool", &[&sum], &[]);
    let means = graph.node("Flatten", &[&means], &[]);
    let third = graph.weight("third", &[16, 40], &weights(640));
    let product = graph.node("Gemm", &[&means, &third], &[("transB", Attribute::Int(1))]);
    let relu = graph.node("Relu", &[&product], &[]);
    let head = graph.weight("head", &[16, 6], &weights(96));
    let descriptor = graph.node("MatMul", &[&relu, &head], &[]);
    graph.output("descriptor", &descriptor, &[Dimension::Batch, Dimension::Fixed(6)]).unwrap();
    graph.finish()
}

/// Ranges of all that `model` wants measured.
fn ranges(model: &OnnxModel) -> Ranges {
    let (_, names) = model.observed().unwrap();
    names.into_iter().map(|name| (name, Range { least: -1.0, greatest: 3.0 })).collect()
}

fn quantised(model: &OnnxModel) -> Result<OnnxModel, OnnxError> {
    model.quantised(&ranges(model))
}

fn nodes(model: &OnnxModel) -> &[NodeProto] {
    &model.proto.graph.as_ref().unwrap().node
}

fn weight<'a>(model: &'a OnnxModel, name: &str) -> Option<&'a TensorProto> {
    model.proto.graph.as_ref().unwrap().initializer.iter().find(|weight| weight.name() == name)
}

/// The operator that gives the input `number` of `node`, and its node.
fn giver<'a>(model: &'a OnnxModel, node: &NodeProto, number: usize) -> Option<&'a NodeProto> {
    nodes(model).iter().find(|giver| giver.output.contains(&node.input[number]))
}

fn of_operator<'a>(model: &'a OnnxModel, operator: &str) -> Vec<&'a NodeProto> {
    nodes(model).iter().filter(|node| node.op_type() == operator).collect()
}

#[test]
fn layers_are_quantised_and_the_head_is_not() {
    let model = network();
    let int8 = quantised(&model).unwrap();
    assert_eq!(int8.described(STORAGE_KEY), Some("int8"));
    assert!(int8.is_quantised() && !model.is_quantised() && !model.stored_as_half().is_quantised());
    for (operator, from_integers) in [("Conv", true), ("Gemm", true), ("MatMul", false)] {
        for node in of_operator(&int8, operator) {
            for number in [0, 1] {
                let giver = giver(&int8, node, number).map_or("a weight", |giver| giver.op_type());
                assert_eq!(giver == "DequantizeLinear", from_integers, "{operator} takes {giver}");
            }
        }
    }
    assert!(weight(&int8, "head").is_some() && weight(&int8, "first").is_none());
    let first = weight(&int8, "first as s8").unwrap();
    assert_eq!((first.data_type(), first.dims.as_slice()), (DataType::Int8 as i32, [40, 3, 3, 3].as_slice()));
    assert_eq!(weight(&int8, "bias as int32").unwrap().data_type(), DataType::Int32 as i32);
    assert_eq!(OnnxModel::read(&int8.to_bytes()).unwrap(), int8);
}

#[test]
fn channels_lie_along_the_axis_of_the_operator() {
    let int8 = quantised(&network()).unwrap();
    let axis = |node: &NodeProto| giver(&int8, node, 1).unwrap().attribute[0].i();
    let axes: Vec<i64> =
        nodes(&int8).iter().filter(|node| ["Conv", "Gemm"].contains(&node.op_type())).map(axis).collect();
    assert_eq!(axes, [0, 0, 0]);
    let mut graph = GraphBuilder::new("product");
    let input = graph.input("input", &[Dimension::Batch, Dimension::Fixed(8)]);
    let matrix = graph.weight("matrix", &[8, 5], &weights(40));
    let product = graph.node("MatMul", &[&input, &matrix], &[]);
    let relu = graph.node("Relu", &[&product], &[]);
    graph.output("descriptor", &relu, &[Dimension::Batch, Dimension::Fixed(5)]).unwrap();
    let int8 = quantised(&graph.finish()).unwrap();
    let product = of_operator(&int8, "MatMul")[0];
    let restored = giver(&int8, product, 1).unwrap();
    assert_eq!(restored.attribute[0].i(), 1);
    assert_eq!(weight(&int8, &restored.input[1]).unwrap().dims, [5]);
}

#[test]
fn a_convolution_and_its_activation_function_are_one_and_pooling_keeps_the_scale() {
    let model = network();
    let (_, measured) = model.observed().unwrap();
    // Not what the first convolution gives, for ReLU follows; nor the pooled, whose range is that of the ReLU.
    assert_eq!(measured, ["conv 2", "flatten", "image", "relu"]);
    let int8 = quantised(&model).unwrap();
    let conv = of_operator(&int8, "Conv")[0];
    let takers = |name: &str| {
        nodes(&int8).iter().filter(|node| node.input.iter().any(|input| input == name)).collect::<Vec<_>>()
    };
    let relu = takers(&conv.output[0]);
    assert_eq!((relu.len(), relu[0].op_type()), (1, "Relu"));
    let mut value = &relu[0].output[0];
    let mut scales = Vec::new();
    for operator in FOLLOWS_CONVOLUTION {
        let [taker] = takers(value)[..] else { panic!("{operator} is not alone") };
        assert_eq!(taker.op_type(), operator);
        scales.extend(weight(&int8, taker.input.get(1).map_or("", String::as_str)));
        value = &taker.output[0];
    }
    scales.extend(weight(&int8, &takers(value)[0].input[1]));
    assert_eq!(scales.len(), 3);
    assert!(scales.iter().all(|scale| scale.raw_data == scales[0].raw_data));
}

#[test]
fn weights_stored_as_half_are_quantised_alike_and_scales_are_never_stored_so() {
    let half = network().stored_as_half();
    let int8 = quantised(&half).unwrap();
    let kept: Vec<&str> = of_operator(&int8, "Cast").iter().map(|cast| cast.output[0].as_str()).collect();
    assert_eq!(kept, ["head"]);
    let whole = quantised(&network()).unwrap();
    let integers = |model: &OnnxModel| weight(model, "first as s8").unwrap().raw_data.clone().unwrap();
    let off = integers(&int8).into_iter().zip(integers(&whole)).map(|(a, b)| (a as i8).abs_diff(b as i8));
    assert!(off.max().unwrap() <= 1);
    let mut many = GraphBuilder::new("many channels");
    let image = many
        .input("image", &[Dimension::Batch, Dimension::Fixed(1), Dimension::Fixed(4), Dimension::Fixed(4)]);
    let wide = many.weight("wide", &[100, 1, 2, 2], &weights(400));
    let conv = many.node("Conv", &[&image, &wide], &[]);
    many.output(
        "maps",
        &conv,
        &[Dimension::Batch, Dimension::Fixed(100), Dimension::Fixed(3), Dimension::Fixed(3)],
    )
    .unwrap();
    let int8 = quantised(&many.finish()).unwrap();
    assert_eq!(int8.clone().stored_as_half(), int8);
}

#[test]
fn a_narrow_convolution_stays_and_takes_what_was() {
    let mut graph = GraphBuilder::new("narrow");
    let shape =
        |channels| [Dimension::Batch, Dimension::Fixed(channels), Dimension::Fixed(4), Dimension::Fixed(4)];
    let image = graph.input("image", &shape(40));
    let wide = graph.weight("wide", &[32, 40, 1, 1], &weights(1280));
    let narrow = graph.weight("narrow", &[32, 32, 1, 1], &weights(1024));
    let first = graph.node("Conv", &[&image, &wide], &[]);
    let second = graph.node("Conv", &[&first, &narrow], &[]);
    graph.output("maps", &second, &shape(32)).unwrap();
    let int8 = quantised(&graph.finish()).unwrap();
    assert_eq!(of_operator(&int8, "Conv")[1].input, ["conv", "narrow"]);
}

#[test]
fn weights_that_two_layers_share_are_quantised_once_and_the_other_layer_takes_what_was() {
    let mut graph = GraphBuilder::new("shared");
    let side = Dimension::Fixed(4);
    let shape = [Dimension::Batch, Dimension::Fixed(40), side, side];
    let image = graph.input("image", &shape);
    let shared = graph.weight("shared", &[40, 40, 1, 1], &weights(1600));
    let first = graph.node("Conv", &[&image, &shared], &[]);
    let second = graph.node("Conv", &[&first, &shared], &[]);
    graph.output("maps", &second, &shape).unwrap();
    let int8 = quantised(&graph.finish()).unwrap();
    let second = of_operator(&int8, "Conv")[1];
    assert_eq!(second.input, ["conv", "shared"]);
}

/// The toy network with something about it changed.
fn changed(change: impl FnOnce(&mut crate::onnx::proto::GraphProto)) -> OnnxModel {
    let mut model = network();
    change(model.proto.graph.as_mut().unwrap());
    model
}

#[test]
fn damaged_weights_are_refused_by_name() {
    let with = |change: fn(&mut TensorProto)| {
        let model =
            changed(|graph| change(graph.initializer.iter_mut().find(|w| w.name() == "second").unwrap()));
        let refused = model.observed().unwrap_err();
        assert_eq!(model.quantised(&ranges(&network())).unwrap_err(), refused);
        refused.to_string()
    };
    let fit = "weight `second` has 1600 values, which do not make up";
    assert_eq!(with(|weight| weight.dims = vec![40, 40, 1, -1]), format!("{fit} [40, 40, 1, -1]"));
    assert_eq!(with(|weight| weight.dims = vec![i64::MAX; 4]), format!("{fit} {:?}", [i64::MAX; 4]));
    assert_eq!(
        with(|weight| weight.dims = vec![1 << 40, 0, 1, 1]),
        format!("{fit} {:?}", [1_i64 << 40, 0, 1, 1])
    );
    assert_eq!(with(|weight| weight.dims.clear()), format!("{fit} []"));
    assert_eq!(
        with(|weight| weight.dims = vec![40, 40]),
        "weight `second` of a convolution has shape [40, 40]"
    );
    let words = with(|weight| weight.raw_data = None);
    assert_eq!(words, "weight `second` has 0 values, which do not make up [40, 40, 1, 1]");
    let words = with(|weight| weight.raw_data = Some(f32::NAN.to_le_bytes().repeat(1600)));
    assert_eq!(words, "weight `second` has a value that is not finite");
}

#[test]
fn ranges_that_are_missing_or_not_finite_are_refused_by_name() {
    let model = network();
    let mut bad = ranges(&model);
    bad.insert("relu".to_owned(), Range { least: 0.0, greatest: f32::NAN });
    let words = model.quantised(&bad).unwrap_err().to_string();
    assert_eq!(
        words,
        "the range of `relu` from 0 to NaN is not finite; calibrate anew on images of the place"
    );
    bad.remove("relu");
    let words = model.quantised(&bad).unwrap_err().to_string();
    assert_eq!(words, "the range of `relu` was not measured; calibrate anew on images of the place");
}

#[test]
fn old_operators_and_graphs_without_a_layer_are_refused() {
    let mut old = network();
    old.proto.opset_import[0].version = Some(11);
    assert_eq!(old.observed().unwrap_err(), OnnxError::OldOperators { got: 11, needed: OLDEST_OPSET });
    let int8 = quantised(&network()).unwrap();
    assert_eq!(int8.quantised(&Ranges::new()).unwrap_err(), OnnxError::NothingToQuantise);
    let bare = changed(|graph| graph.initializer.clear());
    assert_eq!(bare.observed().unwrap_err(), OnnxError::NothingToQuantise);
}

#[test]
fn weights_that_run_in_a_circle_are_no_weights() {
    let circle = changed(|graph| {
        graph.initializer.clear();
        let identity = |from: &str, to: &str| NodeProto {
            op_type: Some("Identity".to_owned()),
            input: vec![from.to_owned()],
            output: vec![to.to_owned()],
            ..Default::default()
        };
        graph.node.extend([identity("first", "second"), identity("second", "first")]);
    });
    assert_eq!(circle.observed().unwrap_err(), OnnxError::NothingToQuantise);
}

proptest! {
    #[test]
    fn no_bytes_bring_the_quantiser_down(position in any::<prop::sample::Index>(), byte: u8, half: bool) {
        let model = if half { network().stored_as_half() } else { network() };
        let mut bytes = model.to_bytes();
        let position = position.index(bytes.len());
        bytes[position] = byte;
        if let Ok(changed) = OnnxModel::read(&bytes) {
            let _ = changed.observed();
            let _ = changed.quantised(&ranges(&model)).map(OnnxModel::stored_as_half);
        }
    }
}
