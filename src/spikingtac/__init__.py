"""Event-camera tactile sensing: from raw events to marker displacements and contacts.

The names below are imported when they are first used, so that ``import spikingtac`` costs a few
milliseconds and loads neither NumPy nor Numba nor SciPy nor Matplotlib.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from spikingtac.errors import SpikingTacError as SpikingTacError
    from spikingtac.events.source import EventSource as EventSource
    from spikingtac.events.source import PacketSource as PacketSource
    from spikingtac.events.windows import windows as windows
    from spikingtac.types import Calibration as Calibration
    from spikingtac.types import Contact as Contact
    from spikingtac.types import EventPacket as EventPacket
    from spikingtac.types import LossCounters as LossCounters
    from spikingtac.types import MarkerFrame as MarkerFrame
    from spikingtac.types import Pose as Pose

_HOMES = {
    "Calibration": "types",
    "Contact": "types",
    "EventPacket": "types",
    "EventSource": "events.source",
    "LossCounters": "types",
    "MarkerFrame": "types",
    "PacketSource": "events.source",
    "Pose": "types",
    "SpikingTacError": "errors",
    "windows": "events.windows",
}
"""Public name -> the module that defines it."""

__all__ = ["__version__", *sorted(_HOMES)]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name == "__version__":
        value: Any = importlib.import_module("importlib.metadata").version("spikingtac")
    elif name in _HOMES:
        value = getattr(importlib.import_module(f"spikingtac.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module 'spikingtac' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return sorted({*globals(), *__all__})
