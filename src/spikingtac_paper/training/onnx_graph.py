"""Build the network's ONNX graph from its weights, without torch.

The graph is that of :mod:`spikingtac_paper.training.architecture`, followed by the sigmoid; a test
compares the two. Height and width are free.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.denoise import EVIDENCE, FORMAT, INPUT, OUTPUT
from spikingtac.errors import ConfigError

OPSET = 17  # ONNX operator set: that of ONNX Runtime 1.18, the oldest supported version.
IR_VERSION = 9  # ONNX file version of that operator set.

# As in :mod:`spikingtac_paper.training.architecture`, which needs torch.
EVFLOWNET_LEVELS, RESIDUAL_BLOCKS = 4, 2
Weights = dict[str, NDArray[np.float32]]


class _Graph:
    def __init__(self, weights: Weights) -> None:
        from onnx import helper

        self._make_node = helper.make_node
        self.weights = weights
        self.nodes: list[Any] = []
        self.constants: Weights = {}

    def add(self, kind: str, *inputs: str, name: str = "", **settings: Any) -> str:
        name = name or f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(self._make_node(kind, inputs, [name], name, **settings))
        return name

    def constant(self, name: str, value: NDArray[np.float32]) -> str:
        self.constants[name] = value
        return name

    def convolve(self, values: str, layer: str, stride: int = 1, name: str = "") -> str:
        kernel, bias = self._weight(f"{layer}.weight"), self._weight(f"{layer}.bias")
        side = self.weights[kernel].shape[-1]
        return self.add(
            "Conv", values, kernel, bias, name=name, pads=[side // 2] * 4, strides=[stride, stride],
            kernel_shape=[side, side],
        )  # fmt: skip

    def block(self, values: str, layer: str, stride: int = 1) -> str:
        return self.add("Relu", self.convolve(values, f"{layer}.0", stride), name=layer)

    def upsample(self, values: str) -> str:
        scales = self.constant("scales", np.array([1, 1, 2, 2], np.float32))
        return self.add(
            "Resize", values, "", scales, mode="nearest", nearest_mode="floor",
            coordinate_transformation_mode="asymmetric",
        )  # fmt: skip

    def _weight(self, name: str) -> str:
        if name not in self.weights:
            raise ConfigError(f"the weights lack the tensor {name!r}; they are for another network")
        return self.constant(name, self.weights[name])


def build_model(weights: Weights, network: dict[str, Any], fold: int, multiple_px: int) -> Any:
    """Return the ``onnx.ModelProto`` of a trained network.

    Args:
        weights: Tensor name -> array, as in ``weights.safetensors``.
        network: Configuration of the network, as in the metadata of that file.
        fold: Side of a block, px.
        multiple_px: Multiple to which the sides of a map are padded, px.

    Raises:
        ConfigError: A tensor is missing.
    """
    from onnx import TensorProto, checker, helper, numpy_helper

    graph = _Graph(weights)
    logits = _lean(graph) if network["kind"] == "lean" else _evflownet(graph)
    graph.add("Sigmoid", logits)
    graph.nodes[-1].output[0] = OUTPUT
    shape = [1, fold**2, "rows", "columns"]
    inputs = (INPUT, EVIDENCE) if network["kind"] == "lean" else (INPUT,)
    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "denoiser",
            [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in inputs],
            [helper.make_tensor_value_info(OUTPUT, TensorProto.FLOAT, shape)],
            [numpy_helper.from_array(value, name) for name, value in graph.constants.items()],
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="spikingtac",
    )
    about = {"format": FORMAT, "fold": str(fold), "multiple_px": str(multiple_px)}
    helper.set_model_props(model, about)
    checker.check_model(model)
    return model


def lean_layers(weights: Weights) -> list[str]:
    """Return the layers of a lean network whose outputs give the int8 ranges."""
    return ["stem", "down", *middle_layers(weights), "up", "head", "trust"]


def middle_layers(weights: Weights) -> list[str]:
    """Return the convolutions at the coarse resolution, after the strided one."""
    more = (f"middle.{number}" for number in itertools.count(1))
    return ["middle.0", *itertools.takewhile(lambda name: f"{name}.0.weight" in weights, more)]


def _lean(graph: _Graph) -> str:
    fine = graph.block(INPUT, "stem")
    coarse = graph.block(fine, "down", stride=2)
    for layer in middle_layers(graph.weights):
        coarse = graph.block(coarse, layer)
    joined = graph.add("Concat", fine, graph.upsample(coarse), axis=1)
    joined = graph.block(joined, "up")
    change = graph.convolve(joined, "head", name="head")
    trust = graph.add("Relu", graph.convolve(joined, "trust"), name="trust")
    return graph.add("Add", change, graph.add("Mul", EVIDENCE, trust))


def _evflownet(graph: _Graph) -> str:
    skips = [INPUT]
    for level in range(EVFLOWNET_LEVELS):
        skips.append(graph.block(skips[-1], f"encoders.{level}", stride=2))
    values = skips[-1]
    for index in range(RESIDUAL_BLOCKS):
        first = graph.block(values, f"residuals.{index}.first")
        second = graph.convolve(first, f"residuals.{index}.second")
        values = graph.add("Relu", graph.add("Add", values, second))
    for level, skip in enumerate(reversed(skips[1:])):
        joined = graph.upsample(graph.add("Concat", values, skip, axis=1))
        values = graph.block(joined, f"decoders.{level}")
    return graph.convolve(values, "head")
