"""The lean network as an int8 graph: bytes in, quantised logits out.

ONNX Runtime's own quantisation of the float graph spends half of its time on memory layout, on a
slow upsampling and on floating point at both ends. In this graph the channels come last everywhere,
the two inputs of the concatenation share one scale, and upsampling is a concatenation with itself.

``QLinearConv`` with ``channels_last`` belongs to ONNX Runtime's own domain (``com.microsoft``).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.denoise import ANSWER, BLOCKS, FORMAT, LEVELS, LOGIT_STEP, LOGIT_ZERO
from spikingtac_paper.training.onnx_graph import IR_VERSION, OPSET, Weights, middle_layers

DOMAIN = "com.microsoft"
WEIGHT_LEVELS = 127  # Largest absolute value of a quantised weight.


class _BlockGraph:
    def __init__(self) -> None:
        from onnx import helper, numpy_helper

        self._make_node, self._from_array = helper.make_node, numpy_helper.from_array
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def add(self, kind: str, inputs: Sequence[str], name: str, **settings: Any) -> str:
        self.nodes.append(self._make_node(kind, inputs, [name], name, **settings))
        return name

    def constant(self, name: str, value: Any) -> str:
        self.constants.append(self._from_array(np.asarray(value), name))
        return name

    def convolve(
        self,
        values: str,
        name: str,
        weights: tuple[NDArray[np.float32], NDArray[np.float32]],
        steps: tuple[float, float],
        *,
        zero: int = 0,
        stride: int = 1,
    ) -> str:
        kernel, bias = weights
        largest = np.abs(kernel).max(axis=(1, 2, 3))
        # A channel of zeros may have any step.
        step = np.where(largest > 0, largest, 1.0).astype(np.float32) / WEIGHT_LEVELS
        levels = np.rint(kernel / step[:, None, None, None]).astype(np.int8)
        inputs = [
            values,
            self.constant(f"{name}.in_step", np.float32(steps[0])),
            self.constant(f"{name}.in_zero", np.uint8(0)),
            self.constant(f"{name}.weight", levels),
            self.constant(f"{name}.step", step),
            self.constant(f"{name}.zero", np.zeros(len(step), np.int8)),
            self.constant(f"{name}.out_step", np.float32(steps[1])),
            self.constant(f"{name}.out_zero", np.uint8(zero)),
            self.constant(f"{name}.bias", np.rint(bias / (step * steps[0])).astype(np.int32)),
        ]
        side = kernel.shape[-1]
        return self.add(
            "QLinearConv", inputs, name, domain=DOMAIN, channels_last=1,
            kernel_shape=[side, side], pads=[side // 2] * 4, strides=[stride, stride],
        )  # fmt: skip

    def upsample(self, values: str, channels: int, like: str) -> str:
        inner = self.constant("inner_shape", np.array([0, 0, -1, channels], np.int64))
        own = self.constant("channels", np.array([channels], np.int64))
        wide = self.add("Concat", [values, values], "wide", axis=3)
        wide = self.add("Reshape", [wide, inner], "wide_row")
        tall = self.add("Concat", [wide, wide], "tall", axis=2)
        size = self.add("Shape", [like], "size", end=3)
        shape = self.add("Concat", [size, own], "shape", axis=0)
        return self.add("Reshape", [tall, shape], "twice")


def build_block_model(
    weights: Weights,
    ranges: dict[str, tuple[float, float]],
    fold: int,
    multiple_px: int,
) -> Any:
    """Return the ``onnx.ModelProto`` of a lean network in int8.

    Args:
        weights: Tensor name -> array, as in ``weights.safetensors``.
        ranges: Smallest and largest value of each of
            :func:`~spikingtac_paper.training.onnx_graph.lean_layers` on state maps.
        fold: Side of a block, px.
        multiple_px: Multiple to which the sides of a map are padded, px.
    """
    from onnx import TensorProto, checker, helper

    graph = _BlockGraph()
    step, zero = _logit_quantum(ranges)
    _add_layers(graph, weights, ranges, (step, zero))
    domains = [helper.make_opsetid("", OPSET), helper.make_opsetid(DOMAIN, 1)]
    shape = [1, "rows", "columns"]
    given, answer = (
        helper.make_tensor_value_info(name, TensorProto.UINT8, [*shape, channels])
        for name, channels in ((BLOCKS, fold**2), (ANSWER, fold**2 + fold))
    )
    model = helper.make_model(
        helper.make_graph(graph.nodes, "denoiser", [given], [answer], graph.constants),
        opset_imports=domains,
        ir_version=IR_VERSION,
        producer_name="spikingtac",
    )
    about = {"format": FORMAT, "fold": str(fold), "multiple_px": str(multiple_px)}
    about |= {LOGIT_STEP: repr(step), LOGIT_ZERO: str(zero)}
    helper.set_model_props(model, about)
    checker.check_model(model)
    return model


def _add_layers(
    graph: _BlockGraph,
    weights: Weights,
    ranges: dict[str, tuple[float, float]],
    quantum: tuple[float, int],
) -> None:
    tops = {name: high / LEVELS for name, (_, high) in ranges.items()}
    middle = middle_layers(weights)
    # The two inputs of the concatenation share one step.
    tops["stem"] = tops[middle[-1]] = max(tops["stem"], tops[middle[-1]])

    def of(layer: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        return weights[f"{layer}.0.weight"], weights[f"{layer}.0.bias"]

    fine = graph.convolve(BLOCKS, "stem", of("stem"), (1.0 / LEVELS, tops["stem"]))
    steps = (tops["stem"], tops["down"])
    coarse = graph.convolve(fine, "down", of("down"), steps, stride=2)
    for before, layer in itertools.pairwise(["down", *middle]):
        coarse = graph.convolve(coarse, layer, of(layer), (tops[before], tops[layer]))
    wide = graph.upsample(coarse, len(of(middle[-1])[1]), fine)
    both = graph.add("Concat", [fine, wide], "both", axis=3)
    joined = graph.convolve(both, "up", of("up"), (tops["stem"], tops["up"]))
    step, zero = quantum
    graph.convolve(joined, ANSWER, _answer_weights(weights), (tops["up"], step), zero=zero)


def _logit_quantum(ranges: dict[str, tuple[float, float]]) -> tuple[float, int]:
    low = min(0.0, ranges["head"][0])
    high = max(ranges["head"][1], ranges["trust"][1], 0.0)
    step = float(np.float32((high - low) / LEVELS)) or 1.0
    return step, round(-low / step)


def _answer_weights(weights: Weights) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    # The trust becomes one more channel of the head; the rest fills the last machine word.
    head, bias = weights["head.weight"], weights["head.bias"]
    pixels, inputs, side, _ = head.shape
    extra = np.zeros((round(pixels**0.5), inputs, side, side), np.float32)
    extra[0, :, side // 2, side // 2] = weights["trust.weight"][0, :, 0, 0]
    more = np.zeros(len(extra), np.float32)
    more[0] = weights["trust.bias"][0]
    return np.concatenate([head, extra]), np.concatenate([bias, more])
