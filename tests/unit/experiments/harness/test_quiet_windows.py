"""Windows come back as they were, the empty ones too."""

from pathlib import Path

import numpy as np

from spikingtac.types import EventPacket
from spikingtac_paper.harness.quiet_windows import load_windows, save_windows

SIZE = (320, 320)


def test_windows_come_back(tmp_path: Path) -> None:
    full = EventPacket(
        x=np.array([1, 2], np.uint16),
        y=np.array([3, 4], np.uint16),
        p=np.array([True, False]),
        t=np.array([5001, 5900]),
        t_start_us=5000,
        t_end_us=6000,
        size=SIZE,
    )
    windows = [(full,), (EventPacket.empty(6000, 7000, SIZE),)]
    save_windows(tmp_path / "quiet.npz", windows)
    for (was,), (now,) in zip(windows, load_windows(tmp_path / "quiet.npz"), strict=True):
        assert (was.t_start_us, was.t_end_us, was.size) == (now.t_start_us, now.t_end_us, now.size)
        for name in "xypt":
            np.testing.assert_array_equal(getattr(was, name), getattr(now, name))
