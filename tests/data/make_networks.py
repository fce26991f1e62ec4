"""Makes the networks of this folder (needs onnx): `python tests/data/make_networks.py`.

`tiny.onnx` has what the real ones have: any batch, height and width, a stride, an enlargement, a skip connection. `fixed.onnx`
takes one size only.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

WIDTH = 2
CHANNELS = 10


def network(size: list[int | str]) -> onnx.ModelProto:
    rng = np.random.default_rng(7)
    shapes = {"w1": (WIDTH, 3, 3, 3), "w2": (WIDTH, WIDTH, 3, 3), "w3": (CHANNELS, 2 * WIDTH, 1, 1)}
    weights = {name: rng.normal(0, 1.3 / np.prod(shape[1:]) ** 0.5, shape) for name, shape in shapes.items()}
    constants = [numpy_helper.from_array(array.astype(np.float32), name) for name, array in weights.items()]
    constants.append(numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32), "scales"))
    nodes = [
        helper.make_node("Conv", ["image", "w1"], ["full"], pads=[1, 1, 1, 1]),
        helper.make_node("Relu", ["full"], ["skip"]),
        helper.make_node("Conv", ["skip", "w2"], ["half"], pads=[1, 1, 1, 1], strides=[2, 2]),
        helper.make_node("Resize", ["half", "", "scales"], ["up"], mode="linear", coordinate_transformation_mode="half_pixel"),
        helper.make_node("Concat", ["skip", "up"], ["both"], axis=1),
        helper.make_node("Conv", ["both", "w3"], ["features"]),
    ]
    graph = helper.make_graph(
        nodes,
        "tiny",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [size[0], 3, *size[1:]])],
        [helper.make_tensor_value_info("features", TensorProto.FLOAT, [size[0], CHANNELS, *size[1:]])],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    onnx.checker.check_model(model, full_check=True)
    return model


def all_networks() -> dict[str, bytes]:
    return {
        "tiny.onnx": network(["n", "h", "w"]).SerializeToString(deterministic=True),
        "fixed.onnx": network(["n", 32, 32]).SerializeToString(deterministic=True),
    }


if __name__ == "__main__":
    for name, content in all_networks().items():
        (Path(__file__).parent / name).write_bytes(content)
