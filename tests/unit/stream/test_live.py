"""A sensor that is followed live, by a plain script and by a loop that awaits."""

import asyncio
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import spikingtac as st
from spikingtac.types import EventPacket
from stand_ins.small_twin import calibration, touches

pytestmark = pytest.mark.waits
RATE_HZ = 200.0

SCRIPT = """
import spikingtac as st
with st.live("touch.raw", calibration="finger.json", preset="fast", rate_hz=200.0) as sensor:
    print(sum(1 for frame in sensor), sensor.health.state, sensor.health.missed)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("live")
    with st.create_events(made / "touch.raw", touches().size) as writer:
        writer.write(EventPacket.concatenate(list(touches().packets)))
    calibration().save(made / "finger.json")
    return made


@pytest.fixture(scope="module")
def alone(folder: Path) -> list[st.MarkerFrame]:
    tracker = st.make_tracker(st.load_config("fast").tracking, calibration())
    return list(st.follow(st.open_events(folder / "touch.raw"), tracker, RATE_HZ))


def test_a_plain_script_gets_every_frame(folder: Path, alone: list[st.MarkerFrame]) -> None:
    (folder / "plain.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "plain.py"], cwd=folder, capture_output=True, text=True, timeout=300
    )
    assert done.stdout.split() == [str(len(alone)), "ended", "0"], done.stderr


def test_frames_can_be_awaited_and_are_those_of_the_tracker(
    folder: Path, alone: list[st.MarkerFrame]
) -> None:
    async def taken() -> list[st.MarkerFrame]:
        given = {"calibration": calibration(), "preset": "fast", "rate_hz": RATE_HZ}
        with st.live(folder / "touch.raw", **given) as sensor:
            return [frame async for frame in sensor]

    frames = asyncio.run(taken())
    assert [frame.t_us for frame in frames] == [frame.t_us for frame in alone]
    np.testing.assert_array_equal(frames[-1].position_px, alone[-1].position_px)
    np.testing.assert_array_equal(frames[-1].coasted, alone[-1].coasted)


def test_what_cannot_be_followed_is_raised(folder: Path) -> None:
    with (
        st.live(folder / "no.raw", calibration=folder / "finger.json") as sensor,
        pytest.raises(st.SpikingTacError, match=r"no\.raw"),
    ):
        list(sensor)
