"""A path is not its events: who forgets to open a file is told how."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import spikingtac as st
from stand_ins.small_twin import calibration


def tracked(given: Any) -> Any:
    return st.follow(given, st.make_tracker(st.load_config("fast").tracking, calibration()), 100.0)


@pytest.mark.parametrize("taker", [st.calibrate, tracked, lambda given: st.windows(given, 1_000)])
@pytest.mark.parametrize("given", ["touch.raw", Path("touch.raw")])
def test_a_path_instead_of_events_is_refused(
    taker: Callable[[Any], Any], given: str | Path
) -> None:
    with pytest.raises(st.SpikingTacError, match=r"it: spikingtac\.open_events\('touch\.raw'\)"):
        list(taker(given))
