"""Run a trained denoiser with ONNX Runtime: one thread, buffers bound once, nothing allocated.

onnxruntime is imported when a network is opened and not before. Neither torch nor onnx is needed.
"""

from __future__ import annotations

import hashlib
import json
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.denoise.fold import evidence_kernel, fold_kernel, folded_shape, unfold_kernel
from spikingtac.errors import ConfigError

FORMAT = "spikingtac-denoiser-1"
"""Marks a network file as ours, in its metadata."""
INPUT, EVIDENCE, OUTPUT = "folded", "evidence", "cleaned"
"""Names of the graph's inputs and output; not every network takes the evidence."""
MANIFEST = "weights.json"
"""Beside network files: their sha256, so that damage is found."""
SHIPPED = {
    "network": "lean.onnx",
    "network-int8": "lean-int8.onnx",
    "supervised": "supervised.onnx",
}
"""Name of a denoiser -> file among the shipped weights."""
SMOOTH_REACH = 2
"""Pixels on each side of the centre of the smoothing."""
_QUIET = 4
"""ONNX Runtime's level for fatal errors only: what fails here is raised, not printed."""


class NetworkDenoiser:
    """A trained network as a :class:`~spikingtac.denoise.denoiser.Denoiser`.

    Maps of any size are taken; the buffers are made for the first one and again when the size
    changes.

    Args:
        path: An ``.onnx`` file that ``spikingtac train`` or :mod:`spikingtac.denoise.export` made.

    Raises:
        ConfigError: The file is missing, damaged (its sha256 is not the one in ``weights.json``
            beside it), no network, or a network of another origin.

    Example:
        >>> import numpy as np
        >>> cleaned = shipped_denoiser("network-int8").clean(np.zeros((320, 320), np.float32))
        >>> cleaned.shape, bool(cleaned.max() < 0.5)
        ((320, 320), True)
    """

    def __init__(self, path: str | Path) -> None:
        content = _checked_content(Path(path))
        self._session = _open_session(content, str(path))
        self._fold, self._multiple_px = _checked_metadata(self._session, str(path))
        self._weighs = len(self._session.get_inputs()) == 2
        self._binding: Any = None
        self._folded = self._evidence = self._answer = np.empty((1, 0, 0, 0), np.float32)
        self._out = self._smooth = np.empty((0, 0), np.float32)
        self._sums = np.empty(0, np.float32)

    def clean(self, state_map: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the cleaned map; the next call overwrites it.

        Args:
            state_map: ``(height, width)`` float32 from 0 to 1.

        Raises:
            ConfigError: It is no such array.
        """
        if state_map.shape != self._out.shape:
            self._bind(state_map)
        fold_kernel(state_map, self._folded[0], self._fold)
        if self._weighs:
            evidence_kernel(state_map, self._smooth, self._sums)
            fold_kernel(self._smooth, self._evidence[0], self._fold)
        self._session.run_with_iobinding(self._binding)
        unfold_kernel(self._answer[0], self._out, self._fold)
        return self._out

    def _bind(self, state_map: NDArray[np.float32]) -> None:
        if state_map.ndim != 2 or state_map.size == 0:
            raise ConfigError(
                f"a state map has the shape (height, width), this one has {state_map.shape}"
            )
        height, width = state_map.shape
        shape = (1, *folded_shape((height, width), self._fold, self._multiple_px))
        self._folded, self._evidence, self._answer = (np.zeros(shape, np.float32) for _ in range(3))
        self._binding = self._session.io_binding()
        inputs = [(INPUT, self._folded), (EVIDENCE, self._evidence)][: 1 + self._weighs]
        for name, buffer in inputs:
            self._binding.bind_input(name, "cpu", 0, np.float32, shape, buffer.ctypes.data)
        self._binding.bind_output(OUTPUT, "cpu", 0, np.float32, shape, self._answer.ctypes.data)
        self._smooth = np.empty((height, width), np.float32)
        self._sums = np.empty(width + 2 * SMOOTH_REACH, np.float32)
        self._out = np.empty((height, width), np.float32)


def shipped_denoiser(name: str) -> NetworkDenoiser:
    """Open one of the networks that come with the package.

    Args:
        name: A key of :data:`SHIPPED`.
    """
    with resources.as_file(resources.files("spikingtac.denoise") / "weights") as folder:
        return NetworkDenoiser(folder / SHIPPED[name])


def _checked_content(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"cannot read the network {str(path)!r}: {error.strerror}; "
            "give an .onnx file that spikingtac train wrote"
        ) from error
    expected = _listed_digest(path)
    found = hashlib.sha256(content).hexdigest()
    if expected is not None and expected != found:
        raise ConfigError(
            f"the network {str(path)!r} is damaged: its sha256 is {found[:12]}..., "
            f"{MANIFEST} says {expected[:12]}...; install the package or export the network again"
        )
    return content


def _listed_digest(path: Path) -> str | None:
    manifest = path.parent / MANIFEST
    if not manifest.is_file():
        return None
    try:
        return json.loads(manifest.read_text(encoding="utf-8"))["sha256"].get(path.name)
    except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
        raise ConfigError(
            f"{str(manifest)!r} is no list of weights; export the network again"
        ) from error


def _open_session(content: bytes, where: str) -> Any:
    import onnxruntime as ort

    options = ort.SessionOptions()
    # More threads have a terrible tail: p99 of 4.9 ms at 2, 135 ms at 4 (docs/explanation).
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = _QUIET
    try:
        return ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the runtime has a class of its own for each kind of damage
        raise ConfigError(
            f"{where!r} is no network that ONNX Runtime can read; "
            "it is damaged or something else; give an .onnx file that spikingtac train wrote"
        ) from error


def _checked_metadata(session: Any, where: str) -> tuple[int, int]:
    about = session.get_modelmeta().custom_metadata_map
    names = [item.name for item in (*session.get_inputs(), *session.get_outputs())]
    if about.get("format") != FORMAT or names not in (
        [INPUT, OUTPUT],
        [INPUT, EVIDENCE, OUTPUT],
    ):
        raise ConfigError(
            f"{where!r} is a network of another origin (inputs and outputs {names}); "
            f"this package reads files of the format {FORMAT}"
        )
    fold, multiple_px = int(about["fold"]), int(about["multiple_px"])
    channels = session.get_inputs()[0].shape[1]
    if channels != fold**2:
        raise ConfigError(
            f"{where!r} takes {channels} channels, but blocks of {fold}x{fold} px have {fold**2}"
        )
    return fold, multiple_px
