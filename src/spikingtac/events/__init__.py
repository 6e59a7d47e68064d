"""Events: sources, formats, windows and filters.

What is most used is found here; the function ``windows`` stays in ``spikingtac.events.windows``,
since the module's name would hide it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spikingtac.events.create import create_events
    from spikingtac.events.open import open_events
    from spikingtac.events.recording import Recording, RecordingWriter
    from spikingtac.events.source import EventSource, PacketSource

__all__ = [
    "EventSource",
    "PacketSource",
    "Recording",
    "RecordingWriter",
    "create_events",
    "open_events",
]

_HOMES = {
    "EventSource": "source",
    "PacketSource": "source",
    "Recording": "recording",
    "RecordingWriter": "recording",
    "create_events": "create",
    "open_events": "open",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
