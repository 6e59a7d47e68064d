"""Run a trained denoiser with ONNX Runtime, on one thread and with fixed buffers.

onnxruntime is imported when a network is opened. Neither torch nor onnx is needed.
"""

import hashlib
import json
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.denoise.blocks import (
    SMOOTH_REACH,
    SMOOTH_SUM,
    WORDS,
    combine_logits_kernel,
    fold_blocks,
    folded_shape,
    quantise_kernel,
    smooth_kernel,
    unfold_blocks,
)
from spikingtac.errors import ConfigError

FORMAT = "spikingtac-denoiser-1"  # Format name in the metadata of a network file.

# Names of a float graph's inputs and output. Not every network has the second input.
INPUT, EVIDENCE, OUTPUT = "folded", "evidence", "cleaned"

# Names of an int8 graph's input and output (:mod:`spikingtac_paper.training.export`).
BLOCKS, ANSWER = "blocks", "answer"

# Its metadata: the logit of one step of the output, and the byte of logit 0.
LOGIT_STEP, LOGIT_ZERO = "logit_step", "logit_zero"
MANIFEST = "weights.json"  # File beside network files with their SHA-256, which reveals damage.

# Name of a denoiser -> file among the weights of the package.
SHIPPED = {"network": "lean.onnx", "network-int8": "lean-int8.onnx"}

# ONNX Runtime's log level for fatal errors. Other failures are raised as exceptions.
_LOG_FATAL_ONLY = 4


class NetworkDenoiser:
    """A trained network as a :class:`~spikingtac.denoise.classical.Denoiser`.

    Maps may have any size. The buffers are allocated for the first map, and again when the size
    changes.

    Args:
        path: An ``.onnx`` file of ``spikingtac train`` or of
            :mod:`spikingtac_paper.training.export`.

    Raises:
        ConfigError: The file is missing, is damaged (its SHA-256 differs from that in
            ``weights.json`` beside it), is not a network, or is a network of another origin.

    Example:
        >>> import numpy as np
        >>> cleaned = shipped_denoiser("network-int8").clean(np.zeros((320, 320), np.float32))
        >>> cleaned.shape, bool(cleaned.max() < 0.5)
        ((320, 320), True)
    """

    def __init__(self, path: str | Path) -> None:
        self._session = open_session(_read_checked(Path(path)), str(path))
        self._blocks, self._quantum = _checked_metadata(self._session, str(path))
        self._buffers: _BlockBuffers | None = None

    def clean(self, state_map: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the denoised map. The next call may overwrite it.

        Args:
            state_map: ``(height, width)`` float32 from 0 to 1.

        Raises:
            ConfigError: The array has another number of dimensions, or is empty.
        """
        if state_map.ndim != 2 or state_map.size == 0:
            raise ConfigError(
                f"a state map has the shape (height, width), this one has {state_map.shape}"
            )
        if self._quantum is None:
            return self._cleaned(state_map)
        if self._buffers is None or self._buffers.out.shape != state_map.shape:
            of = self._session, self._blocks, self._quantum
            self._buffers = _BlockBuffers(*of, state_map.shape)
        return self._buffers.run(state_map)

    def _cleaned(self, state_map: NDArray[np.float32]) -> NDArray[np.float32]:
        """Run a float graph: map, and smoothed map less one half, as channels first."""
        given = {INPUT: fold_blocks(state_map, *self._blocks)[np.newaxis]}
        if len(self._session.get_inputs()) == 2:
            smooth = np.empty_like(state_map, order="C")
            sums = np.empty(state_map.shape[1] + 2 * SMOOTH_REACH, np.float32)
            smooth_kernel(np.ascontiguousarray(state_map), smooth, sums)
            evidence = smooth / np.float32(SMOOTH_SUM) - np.float32(0.5)
            given[EVIDENCE] = fold_blocks(evidence, *self._blocks)[np.newaxis]
        (answer,) = self._session.run([OUTPUT], given)
        return np.ascontiguousarray(unfold_blocks(answer[0], state_map.shape))


class _BlockBuffers:
    """Buffers of an int8 graph: bytes with channels last in and out; the evidence is added here."""

    def __init__(
        self,
        session: Any,
        blocks: tuple[int, int],
        quantum: tuple[float, float],
        size: tuple[int, int],
    ) -> None:
        self._session, self._quantum, fold = session, quantum, blocks[0]
        pixels, rows, columns = folded_shape(size, *blocks)
        padded, word = (rows * fold, columns * fold), WORDS[fold]
        self._levels, self._change = (np.zeros(padded, np.uint8) for _ in range(2))
        self._blocks = np.zeros((rows, columns, pixels), np.uint8)
        self._answer = np.zeros((rows, columns, pixels + fold), np.uint8)
        # The same memory by the word.
        self._word_views: tuple[NDArray[Any], ...] = tuple(
            buffer.view(word) for buffer in (self._levels, self._blocks, self._answer, self._change)
        )
        self._trust = self._answer[:, :, pixels]
        self._binding = session.io_binding()
        for bind, name, buffer in (
            (self._binding.bind_input, BLOCKS, self._blocks),
            (self._binding.bind_output, ANSWER, self._answer),
        ):
            bind(name, "cpu", 0, np.uint8, (1, *buffer.shape), buffer.ctypes.data)
        self._smooth = np.empty(padded, np.uint16)
        self._sums = np.empty(padded[1] + 2 * SMOOTH_REACH, np.uint16)
        self._weight = np.empty(padded[1], np.float32)
        self.out = np.empty(size, np.float32)

    def run(self, state_map: NDArray[np.float32]) -> NDArray[np.float32]:
        levels, blocks, answer, change = self._word_views
        rows, columns, fold = blocks.shape
        quantise_kernel(state_map, self._levels)
        blocks[:] = levels.reshape(rows, fold, columns).transpose(0, 2, 1)
        self._session.run_with_iobinding(self._binding)
        smooth_kernel(self._levels, self._smooth, self._sums)
        change.reshape(rows, fold, columns)[:] = answer[:, :, :fold].transpose(0, 2, 1)
        combine_logits_kernel(
            self._change, self._trust, self._smooth, self._quantum, self._weight, self.out
        )
        return self.out


def shipped_denoiser(name: str) -> NetworkDenoiser:
    """Open one of the networks of the package.

    Args:
        name: A key of :data:`SHIPPED`.
    """
    with resources.as_file(resources.files("spikingtac.denoise") / "weights") as folder:
        return NetworkDenoiser(folder / SHIPPED[name])


def _read_checked(path: Path) -> bytes:
    manifest = path.parent / MANIFEST
    try:
        content = path.read_bytes()
        known = json.loads(manifest.read_bytes())["sha256"] if manifest.is_file() else {}
        expected = known.get(path.name)
    except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
        raise ConfigError(
            f"cannot read the network {str(path)!r} or {MANIFEST} beside it ({error}); "
            "give an .onnx file that spikingtac train wrote, or export the network again"
        ) from error
    found = hashlib.sha256(content).hexdigest()
    if expected not in (None, found):
        raise ConfigError(
            f"the network {str(path)!r} is damaged: its sha256 is {found[:12]}..., "
            f"{MANIFEST} says {expected[:12]}...; install the package or export the network again"
        )
    return content


def open_session(content: bytes, where: str) -> Any:
    """Open a network in one thread.

    Args:
        content: An ONNX file.
        where: Its name, for the message.

    Raises:
        ConfigError: It is none.
    """
    import onnxruntime as ort

    options = ort.SessionOptions()
    # More threads have a terrible tail: p99 of 4.9 ms at 2, 135 ms at 4 (docs/explanation).
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = _LOG_FATAL_ONLY
    try:
        return ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the runtime has a class of its own for each kind of damage
        raise ConfigError(
            f"{where!r} is no network that ONNX Runtime can read; "
            "it is damaged or something else; give a file that spikingtac wrote"
        ) from error


def _checked_metadata(
    session: Any, where: str
) -> tuple[tuple[int, int], tuple[float, float] | None]:
    """Return side and multiple of the blocks, px, and of an int8 graph its step and zero."""
    about = session.get_modelmeta().custom_metadata_map
    names = [item.name for item in (*session.get_inputs(), *session.get_outputs())]
    known = ([INPUT, OUTPUT], [INPUT, EVIDENCE, OUTPUT], [BLOCKS, ANSWER])
    if about.get("format") != FORMAT or names not in known:
        raise ConfigError(
            f"{where!r} is a network of another origin (inputs and outputs {names}); "
            f"this package reads files of the format {FORMAT}"
        )
    fold, multiple_px = int(about["fold"]), int(about["multiple_px"])
    in_blocks = names == [BLOCKS, ANSWER]
    channels = session.get_inputs()[0].shape[3 if in_blocks else 1]
    if channels != fold**2:
        raise ConfigError(
            f"{where!r} takes {channels} channels, but blocks of {fold}x{fold} px have {fold**2}"
        )
    quantum = (float(about[LOGIT_STEP]), float(about[LOGIT_ZERO])) if in_blocks else None
    return (fold, multiple_px), quantum
