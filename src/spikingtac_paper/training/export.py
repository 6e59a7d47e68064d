"""Export a denoiser to ONNX: float32 by ``torch.onnx.export``, the lean network also in int8.

ONNX Runtime's own quantisation of the float graph spends half of its time on memory layout, on a
slow upsampling and on floating point at both ends. In the int8 graph here the channels come last
everywhere, the two inputs of the concatenation share one scale, and upsampling is a concatenation
with itself. Bytes go in, quantised logits come out. ``QLinearConv`` with ``channels_last`` belongs
to ONNX Runtime's own domain (``com.microsoft``).

The ranges of the int8 network are measured on state maps of recordings
(:func:`spikingtac_paper.training.dataset.make_pairs`), never on truth.
"""

import functools
import hashlib
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn

from spikingtac.denoise import (
    ANSWER,
    BLOCKS,
    EVIDENCE,
    FORMAT,
    INPUT,
    LEVELS,
    LOGIT_STEP,
    LOGIT_ZERO,
    MANIFEST,
    OUTPUT,
)
from spikingtac.touch import OPSET
from spikingtac_paper.training.architecture import (
    FOLD,
    LEAN_DEPTH,
    MULTIPLE_PX,
    NetworkKind,
    apply_network,
)
from spikingtac_paper.training.small_networks import export

IR_VERSION = 9  # ONNX file version of that operator set.
DOMAIN = "com.microsoft"
WEIGHT_LEVELS = 127  # Largest absolute value of a quantised weight.

# Fraction of a layer's values that its int8 range excludes at either end. A finer step for all
# other values is worth more than a few outliers (measured).
RANGE_FRACTION = 1e-4
Weights = tuple[NDArray[np.float32], NDArray[np.float32]]  # Kernel and bias of a convolution.


def export_network(
    network: nn.Module, kind: NetworkKind, folder: Path, maps: Tensor
) -> tuple[Path, Path | None]:
    """Write ``KIND.onnx``, for the lean network ``lean-int8.onnx``, and their digests.

    Args:
        network: A trained network.
        kind: Its kind.
        folder: Folder to write to.
        maps: ``(n, 1, height, width)`` noisy state maps, which give the int8 ranges.

    Returns:
        Paths of the float32 and of the int8 network; only the lean one has the latter.
    """
    about = {"format": FORMAT, "fold": str(FOLD[kind]), "multiple_px": str(MULTIPLE_PX)}
    folder.mkdir(parents=True, exist_ok=True)
    lean = kind == "lean"
    names = (INPUT, EVIDENCE) if lean else (INPUT,)
    example = torch.zeros(1, FOLD[kind] ** 2, 16, 32)
    axes = {2: "rows", 3: "columns"}
    content = export(_Probability(network), dict.fromkeys(names, example), [OUTPUT], {}, axes)
    models = {f"{kind}.onnx": (onnx.load_from_string(content), about)}
    if lean:
        models["lean-int8.onnx"] = _int8_model(network.cpu().eval(), maps, about)
    digests = {}
    for name, (model, properties) in models.items():
        helper.set_model_props(model, properties)
        onnx.checker.check_model(model)
        written = model.SerializeToString(deterministic=True)
        (folder / name).write_bytes(written)
        digests[name] = hashlib.sha256(written).hexdigest()
    text = json.dumps({"format": FORMAT, "sha256": digests}, indent=1, sort_keys=True)
    (folder / MANIFEST).write_text(text + "\n", encoding="utf-8")
    paths = [folder / name for name in models]
    return paths[0], paths[1] if lean else None


class _Probability(nn.Module):
    """A network that tells probabilities in place of logits."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network.cpu().eval()

    def forward(self, *inputs: Tensor) -> Tensor:
        return torch.sigmoid(self.network(*inputs))


def _int8_model(
    network: nn.Module, maps: Tensor, about: dict[str, str]
) -> tuple[onnx.ModelProto, dict[str, str]]:
    """Return the int8 graph of a lean network and its metadata."""
    fold = FOLD["lean"]
    middle = [f"middle.{number}" for number in range(LEAN_DEPTH)]
    ranges = _ranges(network, ["stem", "down", *middle, "up", "head", "trust"], maps)
    tops = {name: high / LEVELS for name, (_, high) in ranges.items()}
    # The two inputs of the concatenation share one step.
    tops["stem"] = tops[middle[-1]] = max(tops["stem"], tops[middle[-1]])
    low, high = min(0.0, ranges["head"][0]), max(ranges["head"][1], ranges["trust"][1], 0.0)
    step = float(np.float32((high - low) / LEVELS)) or 1.0
    zero = round(-low / step)

    graph = _Graph()
    state: dict[str, Tensor] = network.state_dict()
    weights = {name: value.numpy() for name, value in state.items()}
    of = {
        name: (weights[f"{name}.0.weight"], weights[f"{name}.0.bias"])
        for name in ("stem", "down", *middle, "up")
    }
    fine = graph.convolve(BLOCKS, "stem", of["stem"], (1.0 / LEVELS, tops["stem"]))
    coarse = graph.convolve(fine, "down", of["down"], (tops["stem"], tops["down"]), stride=2)
    for before, layer in itertools.pairwise(["down", *middle]):
        coarse = graph.convolve(coarse, layer, of[layer], (tops[before], tops[layer]))
    wide = graph.upsample(coarse, len(of[middle[-1]][1]), fine)
    both = graph.add("Concat", [fine, wide], "both", axis=3)
    joined = graph.convolve(both, "up", of["up"], (tops["stem"], tops["up"]))
    graph.convolve(joined, ANSWER, _answer_weights(weights), (tops["up"], step), zero=zero)

    given, answer = (
        helper.make_tensor_value_info(name, TensorProto.UINT8, [1, "rows", "columns", channels])
        for name, channels in ((BLOCKS, fold**2), (ANSWER, fold**2 + fold))
    )
    model = helper.make_model(
        helper.make_graph(graph.nodes, "denoiser", [given], [answer], graph.constants),
        opset_imports=[helper.make_opsetid("", OPSET), helper.make_opsetid(DOMAIN, 1)],
        ir_version=IR_VERSION,
        producer_name="spikingtac",
    )
    return model, about | {LOGIT_STEP: repr(step), LOGIT_ZERO: str(zero)}


@torch.no_grad()
def _ranges(
    network: nn.Module, layers: Sequence[str], maps: Tensor
) -> dict[str, tuple[float, float]]:
    """Return the smallest and the largest output of some layers on state maps, but for outliers."""
    seen: dict[str, list[NDArray[np.float32]]] = {name: [] for name in layers}

    def keep(name: str, _module: nn.Module, _given: Any, told: Any) -> None:
        seen[name].append(told.numpy().ravel())

    hooks = [
        network.get_submodule(name).register_forward_hook(functools.partial(keep, name))
        for name in layers
    ]
    for state_map in maps:
        apply_network(network, state_map[None], FOLD["lean"])
    for hook in hooks:
        hook.remove()
    ends = (RANGE_FRACTION, 1.0 - RANGE_FRACTION)
    found = {name: np.quantile(np.concatenate(parts), ends) for name, parts in seen.items()}
    return {name: (float(low), float(high)) for name, (low, high) in found.items()}


def _answer_weights(weights: dict[str, NDArray[np.float32]]) -> Weights:
    """Return the head with the trust as one more channel; the rest fills the last machine word."""
    head, bias = weights["head.weight"], weights["head.bias"]
    extra = np.zeros((round(len(head) ** 0.5), *head.shape[1:]), np.float32)
    extra[0], more = weights["trust.weight"][0], np.zeros(len(extra), np.float32)
    more[0] = weights["trust.bias"][0]
    return np.concatenate([head, extra]), np.concatenate([bias, more])


class _Graph:
    """Nodes and constants of an int8 graph."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def add(self, kind: str, inputs: Sequence[str], name: str, **settings: Any) -> str:
        self.nodes.append(helper.make_node(kind, inputs, [name], name, **settings))
        return name

    def constant(self, name: str, value: Any) -> str:
        self.constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def convolve(
        self,
        values: str,
        name: str,
        weights: Weights,
        steps: tuple[float, float],
        *,
        zero: int = 0,
        stride: int = 1,
    ) -> str:
        kernel, bias = weights
        largest = np.abs(kernel).max(axis=(1, 2, 3))
        # A channel of zeros may have any step.
        step = np.where(largest > 0, largest, 1.0).astype(np.float32) / WEIGHT_LEVELS
        constants = {
            "in_step": np.float32(steps[0]),
            "in_zero": np.uint8(0),
            "weight": np.rint(kernel / step[:, None, None, None]).astype(np.int8),
            "step": step,
            "zero": np.zeros(len(step), np.int8),
            "out_step": np.float32(steps[1]),
            "out_zero": np.uint8(zero),
            "bias": np.rint(bias / (step * steps[0])).astype(np.int32),
        }
        inputs = [self.constant(f"{name}.{key}", value) for key, value in constants.items()]
        side = kernel.shape[-1]
        return self.add(
            "QLinearConv", [values, *inputs], name, domain=DOMAIN, channels_last=1,
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
