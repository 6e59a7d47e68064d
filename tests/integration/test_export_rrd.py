"""The Rerun export. Its library takes 0.8 GB, so [dev] lacks it and most of this skips there."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import MissingExtraError
from spikingtac.viewer.export import export
from spikingtac.viewer.export.rrd import STEP_US
from stand_ins.viewer import open_circling, positions_px, reference_px

DURATION_US = 400_000


def test_without_its_extra_it_says_which_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"spikingtac\[rerun\]"):
        export(open_circling(10_000), tmp_path / "x.rrd")
    assert list(tmp_path.iterdir()) == []


def test_rerun_reads_every_entry_back(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the extra [rerun] is not installed")
    path = tmp_path / "circling.rrd"
    assert export(open_circling(DURATION_US), path) == DURATION_US // STEP_US
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", "-vvv", path],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    ).stdout
    for entity in ("/sensor/events", "/sensor/displacement", "/rate/events_per_s", "/contacts"):
        assert entity in printed
    largest = np.hypot(*(positions_px(STEP_US) - reference_px()).T).max()
    assert f"{largest:.6f}"[:6] in printed
