"""Several fingers at once: equal to one alone, and a dead one harms nobody."""

import os
import signal
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

import spikingtac as st
from stand_ins.known import known
from stand_ins.random_packets import save_events
from stand_ins.small_twin import calibration, touches
from stand_ins.waiting import wait_until

RATE_HZ = 200.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hand")
    save_events(folder / "touch.raw", *touches().packets)
    calibration().save(folder / "calibration.json")
    return folder


def test_fingers_give_what_each_gives_alone_and_a_dead_one_harms_nobody(
    folder: Path, tmp_path: Path
) -> None:
    touch, calibration_path = folder / "touch.raw", folder / "calibration.json"
    sensor = st.Calibration.load(calibration_path)
    tracker = st.make_tracker(st.load_config("fast").tracking, sensor)
    alone = list(st.follow(st.open_events(touch), tracker, RATE_HZ))
    other = tmp_path / "other.json"
    known(sensor.reference_px, size=(320, 240)).save(other)
    with ExitStack() as opened:
        hand = {
            name: opened.enter_context(
                st.live(source, calibration=path, preset="fast", rate_hz=RATE_HZ)
            )
            for name, source, path in (
                ("thumb", touch, calibration_path),
                ("killed", touch, calibration_path),
                ("missing", "no-such-file.raw", calibration_path),
                ("foreign", touch, other),
            )
        }
        wait_until(lambda: hand["killed"].health.frames > 0)
        os.kill(hand["killed"]._host.pid, signal.SIGKILL)
        wait_until(lambda: hand["thumb"].health.state == "ended")
        for name in ("missing", "foreign"):
            wait_until(lambda name=name: hand[name].health.state == "failed")
        health = {name: finger.health for name, finger in hand.items()}
        latest = {name: finger.latest() for name, finger in hand.items()}
    assert health["killed"].state == "killed"
    assert health["killed"].frames < len(alone)
    assert "no-such-file.raw" in health["missing"].why
    assert "320x240" in health["foreign"].why
    assert latest["missing"] is None
    thumb = latest["thumb"]
    assert (thumb.number, thumb.t_us) == (len(alone), alone[-1].t_us)
    np.testing.assert_array_equal(thumb.displacement_px, alone[-1].displacement_px)
    assert health["thumb"].why == ""
    assert health["thumb"].age_ms is not None


def test_a_calibration_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(st.SpikingTacError, match=r"none\.json"):
        st.live("x.raw", calibration=tmp_path / "none.json")
