"""Recordings of real cameras, with facts that were established independently."""

from pathlib import Path

import numpy as np
import pytest

from spikingtac.events import open_events
from spikingtac.types import EventPacket
from stand_ins.random_packets import assert_equal, whole

FACTS = {
    "evt2_rotating_dot.raw": (539_481, (640, 480), 1_317_888, 1_367_888),
    "evt3_busy_scene.raw": (219_596, (1280, 720), 11_718_656, 11_727_457),
    "ros2_evt3_events.db3": (343_474, (640, 480), 7_139_845, 9_218_023),
    "ros1_evt3_events.bag": (343_474, (640, 480), 7_139_845, 9_218_023),
}


def read(path: Path) -> EventPacket:
    return whole(open_events(path))


@pytest.mark.parametrize("name", FACTS)
def test_counts_sizes_and_times(data_dir: Path, name: str) -> None:
    events = read(data_dir / "real" / name)
    assert (len(events), events.size, int(events.t[0]), int(events.t[-1])) == FACTS[name]
    assert (np.diff(events.t) >= 0).all()


def test_both_bags_hold_the_same(data_dir: Path) -> None:
    ros2 = open_events(data_dir / "real" / "ros2_evt3_events.db3")
    assert_equal(whole(ros2), read(data_dir / "real" / "ros1_evt3_events.bag"))
    assert len(ros2.triggers) == ros2.losses["trigger"] == 4_157
    assert ros2.losses["gap"] == 0


@pytest.mark.parametrize("name", ["real/evt3_busy_scene.raw", "v2e/bootstrap.raw", "v2e/mix.raw"])
def test_evt3_equals_the_library_element_by_element(data_dir: Path, name: str) -> None:
    evt3 = pytest.importorskip("evt3", reason="the oracle comes with the extra [bench]")
    ours, theirs = read(data_dir / name), evt3.decode_file(str(data_dir / name))
    np.testing.assert_array_equal(ours.t, theirs.t.astype(np.int64))
    np.testing.assert_array_equal(ours.x, theirs.x)
    np.testing.assert_array_equal(ours.y, theirs.y)
    np.testing.assert_array_equal(ours.p, theirs.p.astype(bool))
