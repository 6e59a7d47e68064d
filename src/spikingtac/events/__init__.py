"""Events: sources, formats, windows and filters."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spikingtac.events.create import create_events
    from spikingtac.events.open import open_events
    from spikingtac.events.recording import Recording, RecordingWriter
    from spikingtac.events.source import EventSource, PacketSource
    from spikingtac.events.windows import cut, windows

__all__ = [
    "EventSource",
    "PacketSource",
    "Recording",
    "RecordingWriter",
    "create_events",
    "cut",
    "open_events",
    "windows",
]

_HOMES = {
    "EventSource": "source",
    "PacketSource": "source",
    "Recording": "recording",
    "RecordingWriter": "recording",
    "create_events": "create",
    "cut": "windows",
    "open_events": "open",
    "windows": "windows",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
