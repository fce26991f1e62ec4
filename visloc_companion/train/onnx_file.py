"""From a network to the bytes of an ONNX file, and from these to smaller ones; the same network gives the same bytes."""

from __future__ import annotations

import logging
import warnings

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper
from torch.export import Dim

from visloc_companion.localise.model_folder import VariantName
from visloc_companion.train.networks import FeatureNetwork

INPUT, OUTPUT = "image", "features"
OPSET = 18
"""What torch.onnx writes natively; read by every provider of the ladder."""
EXAMPLE = (2, 3, 64, 96)
SMALL = 64
"""Tensors of fewer values (biases) keep their precision."""


def onnx_bytes(network: FeatureNetwork) -> bytes:
    """ONNX in float32 with free N, H and W. Nothing of the machine that made it is in it."""
    network.eval()
    free = {0: Dim.AUTO, 2: Dim.AUTO, 3: Dim.AUTO}
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the exporter about itself
            program = torch.onnx.export(
                network,
                (torch.zeros(EXAMPLE),),
                dynamo=True,
                opset_version=OPSET,
                input_names=[INPUT],
                output_names=[OUTPUT],
                dynamic_shapes=(free,),
                verbose=False,
            )
    finally:
        logger.setLevel(level)
    if program is None:
        raise RuntimeError("torch.onnx.export gave no program")
    return _serialised(_bare(program.model_proto))


def reduced(content: bytes, variant: VariantName) -> bytes:
    """The same network with its weights as float16, or as int8 with one scale for each output channel.

    Computation stays float32: the runtime turns the weights back when it opens the file.
    """
    model = onnx.load_from_string(content)
    graph = model.graph
    kept, added, casts = [], [], []
    for tensor in graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype != np.float32 or values.size < SMALL:
            kept.append(tensor)
            continue
        stored = f"{tensor.name}_{variant}"
        if variant == "float16":
            added.append(numpy_helper.from_array(values.astype(np.float16), stored))
            casts.append(helper.make_node("Cast", [stored], [tensor.name], to=onnx.TensorProto.FLOAT))
        else:
            scale = np.maximum(np.abs(values).reshape(len(values), -1).max(1) / 127, 1e-12).astype(np.float32)
            steps = np.rint(values / scale.reshape(-1, *[1] * (values.ndim - 1))).astype(np.int8)
            added += [numpy_helper.from_array(steps, stored), numpy_helper.from_array(scale, f"{stored}_scale")]
            casts.append(helper.make_node("DequantizeLinear", [stored, f"{stored}_scale"], [tensor.name], axis=0))
    nodes = list(graph.node)
    del graph.initializer[:], graph.node[:]
    graph.initializer.extend([*kept, *added])
    graph.node.extend([*casts, *nodes])
    onnx.checker.check_model(model)
    return _serialised(model)


def _serialised(model: onnx.ModelProto) -> bytes:
    return bytes(model.SerializeToString(deterministic=True))


def _bare(model: onnx.ModelProto) -> onnx.ModelProto:
    """Without stack traces, paths and the exporter's names for sizes."""
    graph = model.graph
    graph.name = "features"
    del model.metadata_props[:], graph.metadata_props[:], graph.value_info[:]
    graph.doc_string = model.doc_string = ""
    for node in graph.node:
        del node.metadata_props[:]
        node.doc_string = ""
    for tensor in graph.initializer:
        del tensor.metadata_props[:]
        tensor.doc_string = ""
    for value in (graph.input[0], graph.output[0]):
        del value.metadata_props[:]
        for axis, name in ((0, "N"), (2, "H"), (3, "W")):
            value.type.tensor_type.shape.dim[axis].dim_param = name
    onnx.checker.check_model(model)
    return model
