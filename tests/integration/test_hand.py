"""Several fingers at once: equal to one alone, and a dead one harms nobody."""

import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import spikingtac as st
from spikingtac.errors import ConfigError
from stand_ins.known import known
from stand_ins.random_packets import save_events
from stand_ins.small_twin import calibration, touches
from stand_ins.waiting import wait_until

RATE_HZ = 200.0


@pytest.fixture(scope="module")
def finger(tmp_path_factory: pytest.TempPathFactory) -> st.Finger:
    folder = tmp_path_factory.mktemp("hand")
    save_events(folder / "touch.raw", *touches().packets)
    calibration().save(folder / "calibration.json")
    tracking = replace(st.load_config("fast").tracking, rate_hz=RATE_HZ)
    return st.Finger(
        source=folder / "touch.raw", calibration=folder / "calibration.json", tracking=tracking
    )


def test_fingers_give_what_each_gives_alone_and_a_dead_one_harms_nobody(
    finger: st.Finger, tmp_path: Path
) -> None:
    sensor = st.Calibration.load(finger.calibration)
    alone = list(
        st.follow(st.open_events(finger.source), st.make_tracker(finger.tracking, sensor), RATE_HZ)
    )
    other = tmp_path / "other.json"
    known(sensor.reference_px, size=(320, 240)).save(other)
    fingers = {
        "thumb": finger,
        "killed": finger,
        "missing": replace(finger, source="no-such-file.raw"),
        "foreign": replace(finger, calibration=other),
    }
    with st.Hand(fingers) as hand:
        wait_until(lambda: hand.health()["killed"].frames > 0)
        os.kill(hand.fingers["killed"].process_id, signal.SIGKILL)
        wait_until(lambda: hand.health()["thumb"].state == "ended")
        for name in ("missing", "foreign"):
            wait_until(lambda name=name: hand.health()[name].state == "failed")
        health, latest = hand.health(), hand.latest()
    assert health["killed"].state == "killed"
    assert health["killed"].frames < len(alone)
    assert "no-such-file.raw" in health["missing"].why
    assert "320x240" in health["foreign"].why
    assert latest["missing"] is None
    thumb = latest["thumb"]
    assert thumb is not None
    assert (thumb.number, thumb.t_us) == (len(alone), alone[-1].t_us)
    np.testing.assert_allclose(thumb.displacement_px, alone[-1].displacement_px, atol=1e-5)
    assert health["thumb"].why == ""
    assert health["thumb"].age_ms is not None


def test_a_hand_without_fingers_and_without_calibration_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="needs a finger"):
        st.Hand({})
    with pytest.raises(st.SpikingTacError, match=r"none\.json"):
        st.Hand({"a": st.Finger(source="x.raw", calibration=tmp_path / "none.json")})
