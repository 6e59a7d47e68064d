"""An exported file opens with independent readers; a video plays in a browser."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import features

from spikingtac.ros2.stream import FIELD
from spikingtac.viewer.export import MESSAGE_US, VIDEO_FRAME_MS, export
from stand_ins.browser import browser
from stand_ins.viewer import open_circling, positions_px, reference_px

DURATION_US = 400_000


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mcap_ros2", reason="the extra [formats] is not installed")
    path = tmp_path_factory.mktemp("export") / "circling.mcap"
    messages = export(open_circling(DURATION_US), path)
    assert messages > 3 * DURATION_US // MESSAGE_US
    return path


def read(path: Path, topic: str) -> list[Any]:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [found for *_, found in reader.iter_decoded_messages(topics=[topic])]


def test_the_field_is_what_was_tracked(exported: Path) -> None:
    messages = read(exported, "/tactile/field")
    assert len(messages) == DURATION_US // MESSAGE_US
    for message in (messages[0], messages[-1]):
        t_us = message.header.stamp.sec * 1_000_000 + message.header.stamp.nanosec // 1000
        cloud = np.frombuffer(bytes(message.data), FIELD)
        assert [item.name for item in message.fields] == list(FIELD.names or ())
        assert (message.height, message.width) == (8, 8)
        np.testing.assert_allclose(
            np.stack([cloud["u"], cloud["v"]], axis=1), positions_px(t_us), atol=1e-3
        )
        moved = positions_px(t_us) - reference_px()
        np.testing.assert_allclose(cloud["du"], moved[:, 0], atol=1e-3)
        np.testing.assert_allclose(cloud["x"] * 15.5 + 159.5, reference_px()[:, 0], atol=1e-3)
        assert cloud["valid"].tolist() == [float(marker != 9) for marker in range(64)]


def test_rosbags_reads_the_same(exported: Path) -> None:
    from rosbags.highlevel import AnyReader

    with AnyReader([exported]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        fields = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.topic == "/tactile/field"
        ]
    expected = DURATION_US // MESSAGE_US
    often = dict.fromkeys(("/tactile/events", "/tactile/field", "/tactile/image"), expected)
    assert counts == often | {"/tactile/arrows": 12, "/tactile/contact": 2, "/diagnostics": 1}
    other = read(exported, "/tactile/field")
    for mine, theirs in zip(fields, other, strict=True):
        assert bytes(mine.data) == bytes(theirs.data)  # type: ignore[attr-defined]


PLAYED = """
const [data, last_s, done] = arguments;
const video = document.createElement("video");
video.muted = true;
video.onerror = () => done({error: video.error.message});
video.onloadeddata = () => { video.currentTime = last_s; };
const found = () => ({seconds: video.duration, width: video.videoWidth, at: video.currentTime});
video.onseeked = () => done(found());
video.src = `data:video/mp4;base64,${data}`;
"""


@pytest.mark.skipif(not features.check("avif"), reason="this Pillow has no AVIF")
def test_a_browser_plays_an_exported_view(tmp_path: Path) -> None:
    assert export(open_circling(200_000), tmp_path / "x.mp4") == 5
    data = base64.b64encode((tmp_path / "x.mp4").read_bytes()).decode()
    last_s = 4.5 * VIDEO_FRAME_MS / 1000
    with browser(tmp_path / "profile") as page:
        page.get("data:text/html,<title>a video</title>")
        page.set_script_timeout(60)
        found = page.execute_async_script(PLAYED, data, last_s)
    assert "error" not in found, found
    assert found["seconds"] == pytest.approx(5 * VIDEO_FRAME_MS / 1000)
    assert found["width"] > 300
    assert found["at"] == pytest.approx(last_s)
