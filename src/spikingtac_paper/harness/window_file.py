"""Quiet windows on disk, so that every process builds its detector from the same ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from spikingtac.atomic_files import replacing
from spikingtac.types import EventPacket


def save_windows(path: Path, windows: Sequence[tuple[EventPacket, ...]]) -> None:
    """Write consecutive windows of one sensor."""
    packets = [window[0] for window in windows]
    x, y, p, t = (np.concatenate([getattr(one, name) for one in packets]) for name in "xypt")
    edges = np.array([packets[0].t_start_us, *(packet.t_end_us for packet in packets)])
    with replacing(path) as temporary:
        np.savez_compressed(temporary, edges=edges, size=packets[0].size, x=x, y=y, p=p, t=t)


def load_windows(path: Path) -> list[tuple[EventPacket, ...]]:
    """Read the windows that :func:`save_windows` wrote."""
    with np.load(path, allow_pickle=False) as file:
        x, y, p, t, edges = (file[name] for name in ("x", "y", "p", "t", "edges"))
        width, height = (int(side) for side in file["size"])
    whole = EventPacket(
        x=x, y=y, p=p, t=t, t_start_us=int(edges[0]), t_end_us=int(edges[-1]), size=(width, height)
    )
    cuts = np.searchsorted(t, edges)
    return [
        (whole.part(int(first), int(last), int(start), int(end)),)
        for first, last, start, end in zip(cuts, cuts[1:], edges, edges[1:], strict=False)
    ]
