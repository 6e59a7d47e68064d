"""Digests of files: the same events must give the same bytes in every version and on every machine.

A change here is a change of format: say so in the changelog.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from spikingtac.events import create_events
from spikingtac.types import EventPacket

DIGESTS = {
    "evt2": "dd0a2be8f66db109",
    "evt21": "28cfae0d91b595f9",
    "evt3": "073e836c66ac5ca8",
    "npz": "c16b46f6893ab740",
    "csv": "5eaebf4a9ffd23bd",
    "aedat4": "ddbeae9d60bf7f9c",
}


def packet() -> EventPacket:
    """Return events from arithmetic alone: vectors, ties, wraps and silence."""
    index = np.arange(4_000)
    t = index // 7 * 3 + (index // 1_000) * 9_000_000
    x, y = (index * 3) % 320, (index // 7) % 240
    p = (index // 40) % 3 > 0
    span = int(t[0]), int(t[-1]) + 1
    return EventPacket(x.astype(np.uint16), y.astype(np.uint16), p, t, *span, (320, 240))


def digest(kind: str, folder: Path) -> str:
    encoding = kind if kind.startswith("evt") else None
    path = folder / f"a.{'raw' if encoding else kind}"
    with create_events(path, (320, 240), encoding=encoding) as writer:
        writer.write(packet())
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


@pytest.mark.parametrize("kind", DIGESTS)
def test_bytes_are_as_ever(kind: str, tmp_path: Path) -> None:
    assert digest(kind, tmp_path) == DIGESTS[kind]
