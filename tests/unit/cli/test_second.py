"""Two fingers: recordings one by one, cameras at once, and names of what belongs to the second."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

from spikingtac.cli.sources import SecondArgs, for_each
from spikingtac.errors import ConfigError

PATIENCE_S = 20.0


class Live:
    """A source that can be closed, as a camera's."""

    def __init__(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True


def test_cameras_are_read_at_once_and_recordings_one_by_one() -> None:
    both_run = threading.Barrier(2)
    cameras: list[Any] = [Live(), Live()]
    ranks = for_each(lambda number, source: both_run.wait(PATIENCE_S) >= 0 and number, cameras)
    assert ranks == [0, 1]
    order: list[int] = []
    recordings: list[Any] = [object(), object()]
    assert for_each(lambda number, source: order.append(number) or number, recordings) == [0, 1]
    assert order == [0, 1]


@pytest.mark.parametrize("failing", [0, 1])
def test_where_one_camera_fails_the_other_one_is_closed(failing: int) -> None:
    cameras: list[Any] = [Live(), Live()]

    def work(number: int, source: Any) -> None:
        if number == failing:
            raise ConfigError("it does not fit")
        while not source.closed:
            threading.Event().wait(0.01)

    with pytest.raises(ConfigError, match="does not fit"):
        for_each(work, cameras)
    assert cameras[1 - failing].closed


def test_each_finger_needs_its_calibration() -> None:
    one, two = Path("one.json"), Path("two.json")
    assert SecondArgs(second_calibration=two).calibrations(one, many=False) == [one, two]
    with pytest.raises(ConfigError, match="each"):
        SecondArgs().calibrations(one, many=False)
    with pytest.raises(ConfigError, match="single one"):
        SecondArgs(second_calibration=two).calibrations(one, many=True)
