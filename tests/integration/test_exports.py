"""An exported file opens with independent readers; a video plays in a browser."""

import base64
from pathlib import Path

import numpy as np
import pytest
from PIL import features

from spikingtac.ros2.stream import FIELD
from spikingtac.viewer.export import ANIMATIONS, MESSAGE_US, export
from stand_ins.browser import browser
from stand_ins.viewer import open_circling, positions_px, reference_px

DURATION_US = 400_000


def test_rosbags_reads_what_was_tracked(tmp_path: Path) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel", reason="rosbags is not installed")
    path = tmp_path / "circling.mcap"
    export(open_circling(DURATION_US), path)
    with highlevel.AnyReader([path]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        fields = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.topic == "/tactile/field"
        ]
    often = ("/tactile/events", "/tactile/field", "/tactile/image")
    expected = dict.fromkeys(often, DURATION_US // MESSAGE_US)
    assert counts == expected | {"/tactile/arrows": 12, "/tactile/contact": 2, "/diagnostics": 1}
    for field in (fields[0], fields[-1]):
        t_us = field.header.stamp.sec * 1_000_000 + field.header.stamp.nanosec // 1000
        cloud = np.frombuffer(bytes(field.data), FIELD)
        places_px = np.stack([cloud["u"], cloud["v"]], axis=1)
        np.testing.assert_allclose(places_px, positions_px(t_us), atol=1e-3)
        moved_px = places_px[:, 0] - reference_px()[:, 0]
        np.testing.assert_allclose(cloud["du"], moved_px, atol=1e-3)
        assert cloud["valid"].tolist() == [float(marker != 9) for marker in range(64)]


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
    frame_s = ANIMATIONS[".mp4"][0] / 1000
    with browser(tmp_path / "profile") as page:
        page.get("data:text/html,<title>a video</title>")
        page.set_script_timeout(60)
        found = page.execute_async_script(PLAYED, data, 4.5 * frame_s)
    assert "error" not in found, found
    assert found["seconds"] == pytest.approx(5 * frame_s)
    assert found["width"] > 300
    assert found["at"] == pytest.approx(4.5 * frame_s)
