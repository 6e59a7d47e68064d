"""The ``.npz`` of an OpenMV recorder, made here as its documentation describes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import FormatError
from spikingtac.events.open import open_events
from spikingtac.types import EventPacket


def rows(t_us: np.ndarray, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    count = len(t_us)
    x, y, on = rng.integers(0, 320, count), rng.integers(0, 320, count), rng.integers(0, 2, count)
    seconds, rest = np.divmod(t_us, 1_000_000)
    return np.column_stack([on, seconds % (1 << 16), rest // 1000, rest % 1000, x, y]).astype("<u2")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_its_events_are_read_and_its_pickle_is_not(tmp_path: Path, save: object) -> None:
    t_us = np.sort(np.random.default_rng(1).integers(0, 3_000_000, 100_000))
    events = rows(t_us)
    events[500:510, 0] = 16  # an external trigger's type, as the firmware numbers it
    save(  # type: ignore[operator]
        tmp_path / "a.npz",
        events=events,
        metadata=np.array({"mode": "events"}, dtype=object),
    )
    source = open_events(tmp_path / "a.npz")
    found = EventPacket.concatenate(list(source))
    kept = events[:, 0] < 2
    np.testing.assert_array_equal(found.t, t_us[kept])
    np.testing.assert_array_equal(found.x, events[kept, 4])
    np.testing.assert_array_equal(found.y, events[kept, 5])
    np.testing.assert_array_equal(found.p, events[kept, 0] == 1)
    assert source.format == "OpenMV NPZ"
    assert source.size == (320, 320)
    assert dict(source.losses) == {"vendor_word": 10}


def test_seconds_that_wrap_go_on(tmp_path: Path) -> None:
    t_us = (1 << 16) * 1_000_000 + np.arange(-500, 500, dtype=np.int64) * 100
    np.savez(tmp_path / "a.npz", events=rows(t_us))
    found = EventPacket.concatenate(list(open_events(tmp_path / "a.npz")))
    np.testing.assert_array_equal(found.t, t_us)


def test_histograms_and_other_arrays_say_what_they_are(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", events=np.zeros((3, 320, 320), np.uint8))
    with pytest.raises(FormatError, match="histograms"):
        list(open_events(tmp_path / "a.npz"))
