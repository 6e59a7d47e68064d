"""An exported video plays in a browser: its length, its size, and its last picture."""

from __future__ import annotations

import base64
from pathlib import Path

import pytest
from PIL import features

from spikingtac.viewer.export import VIDEO_FRAME_MS, export
from stand_ins.browser import browser
from stand_ins.viewer import open_circling

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
