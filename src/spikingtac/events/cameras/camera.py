"""The one protocol for every camera: read what has come, describe it, close it.

Opening, counting, reconnecting and packing are the same for all and stand in
:mod:`spikingtac.events.cameras.source`; a camera's own file says only how its bytes become columns.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.address import Address
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import Rows
from spikingtac.types import LossCounters


class Camera(ABC):
    """One open camera.

    Attributes:
        OPTIONS: Names of the options that its address may carry.
        EXTRA: Extra of this package that brings its library; empty where none is needed.
        size: ``(width, height)`` of the sensor, px.
        checked: Whether the columns come checked (in order, on the sensor, of the package's types).
        losses: What was lost or mended, by kind (``codec.KINDS``); the camera counts into it.
        triggers: Trigger edges met so far.
        take_truth: Called with growing arrays of ``truth.npz`` by a simulation, which knows them.
    """

    OPTIONS: ClassVar[tuple[str, ...]] = ()
    EXTRA: ClassVar[str] = ""
    size: tuple[int, int]
    checked: bool = False

    def __init__(self) -> None:
        self.losses = LossCounters()
        self.triggers = Triggers()
        self.take_truth: Callable[[Mapping[str, NDArray[Any]]], None] = lambda rows: None

    @classmethod
    @abstractmethod
    def open(cls, address: Address) -> Self:
        """Open the camera and start it.

        Raises:
            ConfigError: The address does not fit this kind of camera.
            MissingExtraError: Its library is not installed; names what brings it.
            DeviceError: There is no such camera, or it refuses; says what to do.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> Rows | None:
        """Return the columns x, y, p and t (us) of what has come, after waiting if nothing has.

        The columns may be views of buffers that the next call overwrites.

        Args:
            timeout_s: Longest wait, s; then the columns are empty.

        Returns:
            None once the camera has ended by itself, as a pipe does whose writer has left.

        Raises:
            CameraLostError: The camera is gone.
            RecordingError: Its words cannot be read.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop the camera and release it; further calls do nothing."""

    def describe(self) -> dict[str, Any]:
        """Return what is known of it for the manifest: model, serial, encoding, library ..."""
        return {}

    def biases(self) -> dict[str, int]:
        """Return its biases by the maker's names; empty where it has none that can be read."""
        return {}

    def roi(self) -> list[list[int]]:
        """Return ``[x, y, width, height]`` of each window that sends, px; empty if not told."""
        return []

    def truth(self) -> Mapping[str, NDArray[Any]]:
        """Return the arrays of ``truth.npz`` that do not grow; a simulation alone knows any."""
        return {}

    def manifest(self) -> dict[str, Any]:
        """Return fields for the manifest itself, beside those of :meth:`describe`."""
        return {}

    @staticmethod
    def nothing() -> Rows:
        """Return the columns of no event."""
        words = np.empty(0, np.uint16)
        return words, words, np.empty(0, np.bool_), np.empty(0, np.int64)
