"""An exported video plays in a browser, with its pictures in their order."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import features

from spikingtac.viewer.export import VIDEO_FRAME_MS, export
from stand_ins.browser import browser
from stand_ins.viewer import open_circling

PLAYED = """
const [data, times_s, done] = arguments;
const bytes = Uint8Array.from(atob(data), letter => letter.charCodeAt(0));
const video = document.createElement("video");
video.muted = true;
video.onerror = () => done({error: video.error.message});
video.src = URL.createObjectURL(new Blob([bytes], {type: "video/mp4"}));
const canvas = document.createElement("canvas");
canvas.width = canvas.height = 1;
const seen = [];
const take = () => {
  const context = canvas.getContext("2d");
  const x = video.videoWidth >> 1, y = video.videoHeight >> 1;
  context.drawImage(video, x, y, 1, 1, 0, 0, 1, 1);
  seen.push([...context.getImageData(0, 0, 1, 1).data]);
  if (seen.length < times_s.length) seek();
  else done({seconds: video.duration, width: video.videoWidth, seen});
};
// A picture may be shown later than "seeked" says, and one that is shown already not again.
const seek = () => {
  let taken = false;
  const once = () => { if (!taken) { taken = true; take(); } };
  video.requestVideoFrameCallback(once);
  video.onseeked = () => setTimeout(once, 2000);
  video.currentTime = times_s[seen.length];
};
video.onloadeddata = seek;
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    if not features.check("avif"):
        pytest.skip("this Pillow has no AVIF")
    with browser(tmp_path_factory.mktemp("profile")) as opened:
        opened.get("data:text/html,<title>a video</title>")
        opened.set_script_timeout(60)
        yield opened


def played(page: Any, video: bytes, pictures: int) -> dict[str, Any]:
    """Return length, width and the middle of each picture, as the browser shows them."""
    times_s = [(number + 0.5) * VIDEO_FRAME_MS / 1000 for number in range(pictures)]
    found = page.execute_async_script(PLAYED, base64.b64encode(video).decode(), times_s)
    assert "error" not in found, found
    assert found["seconds"] == pytest.approx(pictures * VIDEO_FRAME_MS / 1000)
    return found


def test_a_browser_plays_an_exported_view(page: Any, tmp_path: Path) -> None:
    assert export(open_circling(200_000), tmp_path / "x.mp4") == 5
    assert played(page, (tmp_path / "x.mp4").read_bytes(), 5)["width"] > 300
