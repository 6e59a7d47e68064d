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
given = {"calibration": "finger.json", "preset": "fast", "rate_hz": 200.0}
with st.live("touch.raw", **given) as sensor:
    print(sum(1 for frame in sensor))
print(sensor.health.state, sensor.health.missed, sensor.latest().number, len(list(sensor)))
next(iter(st.live("touch.raw", **given)))  # dropped: its shared memory is not left behind
st.live("touch.raw", **given)  # also before its process has begun
"""

# Kernels that are compiled, or loaded, by the noise, and those that the touches ask for besides.
KERNELS = """
import gc
from numba.core.dispatcher import Dispatcher
import spikingtac as st
from spikingtac.pipeline.follow import CheckedSource
from spikingtac.stream.live import noise
def follow(source):
    list(st.follow(CheckedSource(source, sensor), st.make_tracker(tracking, sensor), 1000.0))
    found = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]
    return {(one.py_func.__qualname__, kinds) for one in found for kinds in one.signatures}
sensor, tracking = st.Calibration.load("finger.json"), st.load_config("fast").tracking
touches = st.events.PacketSource(list(st.open_events("touch.raw")), sensor.size)
known = follow(noise(sensor.size))
print(len(known) > 5, sorted(name for name, _ in follow(touches) - known))
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
    count = str(len(alone))
    assert done.stdout.split() == [count, "ended", "0", count, "0"], done.stderr
    assert done.stderr == ""


def test_no_kernel_is_left_to_compile_when_a_sensor_is_touched(folder: Path) -> None:
    command = [sys.executable, "-c", KERNELS]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.stdout == "True []\n", done.stderr


def test_frames_can_be_awaited_and_are_those_of_the_tracker(
    folder: Path, alone: list[st.MarkerFrame]
) -> None:
    async def taken() -> list[st.MarkerFrame]:
        given = {"calibration": calibration(), "preset": "fast", "rate_hz": RATE_HZ}
        with st.live(folder / "touch.raw", **given) as sensor:
            with pytest.raises(TimeoutError):  # whoever gives up waiting loses no frame
                await asyncio.wait_for(anext(aiter(sensor)), 0.05)
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
