"""What is lost or gained by pooling the trunk otherwise, or by larger images: the nearest descriptor, single frames.

    LOCI_DATA=DIR PYTHONPATH=models:tests python3 tests/suite/poolings.py

The tasks are those of tests/score_model.py. From one trunk, at 224 and at 320 pixels: its head pooled on average; GeM
(p = 3) of the last 5 × 5 stage; the whole map of that stage; the rows that the shipped descriptor is made of, unfitted;
and these with the shipped projection, which was fitted at 224. Maps of larger images are averaged to the same size.
"""

import os
from pathlib import Path

import numpy as np
import onnxruntime
from onnx import TensorProto, helper

import build
import score_model

SIDES_PX = (224, 320)
COARSE_SIDE, FINE_SIDE = 7, 14


def trunk(weights, side_px):
    """A session that answers the three maps that Backbone names."""
    build.SIDE_PX = side_px
    graph = build.Graph(np.float32)
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in build.Backbone(graph, weights).build("image")]
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, ["batch", 3, side_px, side_px])
    body = helper.make_graph(graph.nodes, "trunk", [image], outputs, graph.initialisers)
    opset = helper.make_opsetid("", build.ONNX_OPSET)
    return onnxruntime.InferenceSession(helper.make_model(body, opset_imports=[opset], ir_version=build.ONNX_IR_VERSION).SerializeToString())


def averaged(values, side):
    """[channels, n, n] averaged to [channels, side, side], parts of cells counted in part."""
    n = values.shape[-1]
    first, last = np.arange(side)[:, None] * n / side, (np.arange(side)[:, None] + 1) * n / side
    cells = np.arange(n)[None]
    share = np.clip(np.minimum(last, cells + 1) - np.maximum(first, cells), 0, None) * side / n
    return np.einsum("ij,cjk,lk->cil", share, values, share)


def unit(values):
    return values / max(np.linalg.norm(values), 1e-12)


def rows(values, width, stride):
    """7 rows of 2 columns that overlap, rooted, of unit length, as build.rows makes them."""
    channels, side, _ = values.shape
    values = values.reshape(channels, 7, side // 7, side).mean(2)
    values = np.stack([values[..., :width].mean(-1), values[..., stride:stride + width].mean(-1)], -1).ravel()
    return unit(np.sign(values) * np.sqrt(np.abs(values)))


def descriptors(session, file, fitted):
    fine, coarse, head = (output[0].astype(float) for output in session.run(None, {"image": build.load_image(file)}))
    coarse_map, fine_map = averaged(coarse, COARSE_SIDE), averaged(fine, FINE_SIDE)
    pooled = unit(np.sqrt(head.mean((1, 2))))
    what = np.concatenate([pooled, build.COARSE_WEIGHT * rows(coarse_map, 4, 3)])
    where = rows(fine_map, 8, 6)
    projected = [unit((values - mean) @ projection) for values, (mean, projection) in zip((what, where), fitted)]
    return {
        "pooled head": pooled,
        "GeM": unit(np.cbrt((np.maximum(coarse, 1e-6) ** 3).mean((1, 2)))),
        "whole map": unit(coarse_map.ravel()),
        "rows": np.concatenate([what, build.WHERE_WEIGHT * where]),
        "rows, fitted": np.concatenate([projected[0], build.WHERE_WEIGHT * projected[1]]),
    }


def recall_at_1(task, described, kind):
    _, _, query, reference, right, recent = task
    asked, known = (np.array([unit(described[frame][kind]) for frame in frames]) for frames in (query, reference))
    similar = asked @ known.T
    if recent is not None:
        similar = np.where(recent, -2, similar)
    return right[np.arange(len(query)), similar.argmax(1)].mean()


def main():
    data, weights = Path(os.environ["LOCI_DATA"]), build.read_weights(build.find_weights())
    fitted = [[np.load(build.FITTED / f"{part}_{name}.npy").astype(float) for name in ("mean", "projection")] for part in build.PARTS]
    tasks = score_model.corridor(data / "corridor_two_laps") + score_model.robot(data / "robot_laps") + score_model.webcams(data / "webcams_day_night")
    for side_px in SIDES_PX:
        session = trunk(weights, side_px)
        for task in tasks:
            name, files, query, reference, *_ = task
            described = {frame: descriptors(session, files[frame], fitted) for frame in {*query, *reference}}
            for kind in next(iter(described.values())):
                print(f"{side_px} px  {name} (n {len(query)})  {kind}  R@1 {recall_at_1(task, described, kind):.3f}", flush=True)


if __name__ == "__main__":
    main()
