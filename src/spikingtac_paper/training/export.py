"""Export ``weights.safetensors`` to ONNX, as float32 and as static int8.

This needs ``onnx`` and ``safetensors``, not torch. The ranges of the int8 network are measured on
state maps of recordings (:func:`spikingtac_paper.training.dataset.make_pairs`), never on truth.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.denoise import (
    EVIDENCE,
    FORMAT,
    INPUT,
    MANIFEST,
    SMOOTH_REACH,
    evidence_kernel,
    fold_kernel,
    folded_shape,
)
from spikingtac.errors import ConfigError, MissingExtraError
from spikingtac_paper.training.block_graph import build_block_model
from spikingtac_paper.training.onnx_graph import build_model, lean_layers

# Multiples of a block to which the sides of a map are padded: four halvings, or one.
EVFLOWNET_MULTIPLE, LEAN_MULTIPLE = 16, 2

# Fraction of a layer's values that its int8 range excludes at either end.
#
# A finer step for all other values is worth more than a few outliers (measured).
RANGE_FRACTION = 1e-4
_Inputs = dict[str, NDArray[np.float32]]
EXTRA = "exporting needs onnx and safetensors; install them with: pip install 'spikingtac[train]'"


def export_network(
    weights: str | Path,
    folder: str | Path,
    maps: Sequence[NDArray[np.float32]],
    name: str = "lean",
) -> tuple[Path, Path | None]:
    """Write ``NAME.onnx``, for the lean network ``NAME-int8.onnx``, and their digests.

    Args:
        weights: ``weights.safetensors`` of a training run.
        folder: Folder to write to.
        maps: ``(height, width)`` noisy state maps of one size, which give the int8 ranges.
        name: Stem of the files.

    Returns:
        Paths of the float32 and of the int8 network; only the lean one has the latter.

    Raises:
        ConfigError: The weights are damaged or of another origin, or there are no maps.
        MissingExtraError: The extra ``[train]`` is not installed.
    """
    if not maps:
        raise ConfigError("int8 ranges need state maps of recordings; none were given")
    tensors, network = read_weights(weights)
    fold = int(network["fold"])
    multiple_px = fold * (LEAN_MULTIPLE if network["kind"] == "lean" else EVFLOWNET_MULTIPLE)
    model = build_model(tensors, network, fold, multiple_px)
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    plain, int8 = out / f"{name}.onnx", out / f"{name}-int8.onnx"
    plain.write_bytes(model.SerializeToString(deterministic=True))
    if network["kind"] != "lean":
        _write_digests(out, (plain,))
        return plain, None
    inputs = [_graph_inputs(state_map, fold, multiple_px) for state_map in maps]
    ranges = _ranges(model, lean_layers(tensors), inputs)
    blocks = build_block_model(tensors, ranges, fold, multiple_px)
    int8.write_bytes(blocks.SerializeToString(deterministic=True))
    _write_digests(out, (plain, int8))
    return plain, int8


def read_weights(path: str | Path) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Read tensors and the network's configuration from ``weights.safetensors``.

    Raises:
        ConfigError: The file is not such a file, is damaged, or is of another origin.
        MissingExtraError: safetensors is not installed.
    """
    try:
        from safetensors import safe_open
    except ImportError as error:
        raise MissingExtraError(EXTRA) from error
    try:
        with safe_open(path, framework="numpy") as file:
            about = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except Exception as error:  # the library raises its own class, OSError or ValueError
        raise ConfigError(f"{str(path)!r} is no readable safetensors file: {error}") from error
    if about.get("format") != FORMAT or "network" not in about:
        raise ConfigError(f"{str(path)!r} holds no weights of this package's denoiser")
    return tensors, json.loads(about["network"])


def _graph_inputs(state_map: NDArray[np.float32], fold: int, multiple_px: int) -> _Inputs:
    height, width = state_map.shape
    given = np.ascontiguousarray(state_map, np.float32)
    evidence = np.empty_like(given)
    evidence_kernel(given, evidence, np.empty(width + 2 * SMOOTH_REACH, np.float32))
    shape = folded_shape((height, width), fold, multiple_px)
    made = {INPUT: np.empty((1, *shape), np.float32), EVIDENCE: np.empty((1, *shape), np.float32)}
    fold_kernel(given, made[INPUT][0], fold)
    fold_kernel(evidence, made[EVIDENCE][0], fold)
    return made


def _ranges(model: Any, names: list[str], inputs: list[_Inputs]) -> dict[str, tuple[float, float]]:
    import onnxruntime as ort
    from onnx import helper

    open_model = type(model)()
    open_model.CopyFrom(model)
    open_model.graph.output.extend(helper.make_empty_tensor_value_info(name) for name in names)
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(
        open_model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    runs: Any = [session.run(names, given) for given in inputs]
    ends = (RANGE_FRACTION, 1.0 - RANGE_FRACTION)
    ranges = {}
    for name, *values in zip(names, *runs, strict=True):
        low, high = np.quantile(np.concatenate([part.ravel() for part in values]), ends)
        ranges[name] = (float(low), float(high))
    return ranges


def _write_digests(folder: Path, files: Sequence[Path]) -> None:
    digests = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    text = json.dumps({"format": FORMAT, "sha256": digests}, indent=1, sort_keys=True)
    (folder / MANIFEST).write_text(text + "\n", encoding="utf-8")
