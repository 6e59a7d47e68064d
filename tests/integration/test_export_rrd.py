"""The Rerun export. Its library takes 0.8 GB, so [dev] lacks it and most of this skips there."""

import sys
from pathlib import Path

import pytest

from spikingtac.errors import MissingExtraError
from spikingtac.viewer.export import export
from stand_ins.viewer import open_circling


def test_without_its_extra_it_says_which_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"spikingtac\[rerun\]"):
        export(open_circling(10_000), tmp_path / "x.rrd")
    assert list(tmp_path.iterdir()) == []
