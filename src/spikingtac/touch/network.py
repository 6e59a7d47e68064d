"""Small networks as ONNX files: force, contact patch and slip run by one runtime.

A file holds the graph, its weights and, as metadata, a record: what the network was fitted to and
what its numbers mean. The networks are trained with PyTorch beside the package
(``spikingtac_paper.training.small_networks``); here they only run.
"""

import importlib.resources
import json
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.denoise.infer import open_session
from spikingtac.errors import ConfigError
from spikingtac.types import FloatArray

RECORD = "spikingtac.record"  # Key of the record in a file's metadata.

# Versions of the format that files are written in; ONNX Runtime 1.18 reads them.
IR_VERSION, OPSET = 8, 17


class Network:
    """A network in one thread.

    Attributes:
        record: What the file says of itself; empty where it says nothing.
        content: The file.
    """

    def __init__(self, content: bytes, where: str = "the model") -> None:
        """Open a network.

        Args:
            content: An ONNX file.
            where: Its name, for messages.

        Raises:
            ConfigError: It is none.
        """
        self.content = content
        self._session = open_session(content, where)
        self._inputs = [one.name for one in self._session.get_inputs()]
        about = self._session.get_modelmeta().custom_metadata_map
        try:
            self.record: dict[str, Any] = json.loads(about.get(RECORD, "{}"))
        except ValueError as error:
            raise ConfigError(f"{where!r} is no network of this package ({error})") from error

    def __call__(self, *inputs: NDArray[np.floating]) -> list[FloatArray]:
        """Return the outputs of inputs in the order of the file."""
        values = (np.ascontiguousarray(one, np.float32) for one in inputs)
        told = self._session.run(None, dict(zip(self._inputs, values, strict=True)))
        return [np.asarray(one, np.float64) for one in told]


@cache
def packaged(file: str) -> Network:
    """Return a network that comes with the package: ``patch.onnx`` or ``slip.onnx``."""
    return Network((importlib.resources.files("spikingtac.touch") / file).read_bytes(), file)


def graph(
    steps: str,
    weights: Mapping[str, NDArray[Any]],
    size: int,
    outputs: Mapping[str, int],
) -> bytes:
    """Return an ONNX file of one input, ``fields (n, size)``, without a library.

    Args:
        steps: The operations in order, as ``output=Operator(inputs)``.
        weights: Name -> array; float32 but for integers, which become int64.
        size: Width of the input.
        outputs: Name -> width of each output ``(n, width)``.
    """
    parts = [_part(1, _node(step)) for step in steps.split()]
    parts += [_part(2, b"graph")]
    parts += [_part(5, _tensor(name, values)) for name, values in weights.items()]
    parts += [_part(11, _value("fields", size))]
    parts += [_part(12, _value(name, width)) for name, width in outputs.items()]
    return _number(1, IR_VERSION) + _part(7, b"".join(parts)) + _part(8, _number(2, OPSET))


def with_record(content: bytes, record: Mapping[str, Any]) -> bytes:
    """Return an ONNX file with a record; messages of its encoding are joined by appending."""
    return content + _part(14, _part(1, RECORD.encode()) + _part(2, json.dumps(record).encode()))


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _part(field: int, content: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def _node(step: str) -> bytes:
    output, call = step.split("=")
    operator, inputs = call.rstrip(")").split("(")
    parts = [_part(1, name.encode()) for name in inputs.split(",")]
    parts += [_part(2, output.encode()), _part(4, operator.encode())]
    if operator in ("Gather", "Concat"):  # along the columns: an attribute that is an integer
        parts.append(_part(5, _part(1, b"axis") + _number(3, 1) + _number(20, 2)))
    return b"".join(parts)


def _tensor(name: str, values: NDArray[Any]) -> bytes:
    kind, dtype = (7, np.int64) if values.dtype.kind == "i" else (1, np.float32)
    shape = b"".join(_number(1, length) for length in values.shape)
    raw = np.ascontiguousarray(values, dtype).tobytes()
    return shape + _number(2, kind) + _part(8, name.encode()) + _part(9, raw)


def _value(name: str, width: int) -> bytes:
    shape = _part(1, _part(2, b"n")) + _part(1, _number(1, width))
    return _part(1, name.encode()) + _part(2, _part(1, _number(1, 1) + _part(2, shape)))
