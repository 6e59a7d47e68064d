"""The video has the parts of a video, and FFmpeg's reader takes it for one."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import features

from spikingtac.errors import MissingExtraError
from spikingtac.viewer.export.mp4 import FRAME_MS, as_video, export_mp4
from stand_ins.animations import COLORS, animation
from stand_ins.viewer import open_circling

needs_avif = pytest.mark.skipif(not features.check("avif"), reason="this Pillow has no AVIF")


def boxes(data: bytes) -> list[bytes]:
    """Return the types of the outermost boxes."""
    kinds, at = [], 0
    while at < len(data):
        kinds.append(data[at + 4 : at + 8])
        at += int.from_bytes(data[at : at + 4], "big") or len(data)
    return kinds


def told(path: Path) -> tuple[int, float, tuple[int, int]]:
    """Return what FFmpeg's reader says: pictures, pictures per second, width and height."""
    cv2 = pytest.importorskip("cv2", reason="the extra [bench] is not installed")
    video = cv2.VideoCapture(str(path))
    assert video.isOpened()
    asked = (cv2.CAP_PROP_FRAME_COUNT, cv2.CAP_PROP_FPS)
    count, rate_hz = (video.get(one) for one in asked)
    size = video.get(cv2.CAP_PROP_FRAME_WIDTH), video.get(cv2.CAP_PROP_FRAME_HEIGHT)
    return int(count), rate_hz, (int(size[0]), int(size[1]))


@needs_avif
def test_it_has_the_names_of_a_video_and_no_still_picture() -> None:
    before, after = animation(), as_video(animation())
    assert len(after) == len(before)
    assert before[4:12] == b"ftypavis"
    assert after[4:12] == b"ftypiso6"
    assert not {b"avis", b"avif", b"msf1"} & {after[at : at + 4] for at in range(8, 48, 4)}
    assert b"meta" in boxes(before)
    assert sorted(set(boxes(after))) == [b"free", b"ftyp", b"mdat", b"moov"]
    assert after.count(b"vide") == 1
    assert b"edts" not in after


@needs_avif
def test_another_reader_sees_a_video_of_that_length(tmp_path: Path) -> None:
    (tmp_path / "x.mp4").write_bytes(as_video(animation()))
    assert told(tmp_path / "x.mp4") == (len(COLORS), pytest.approx(1000 / FRAME_MS), (64, 48))


@needs_avif
def test_the_length_is_told_in_the_film_and_the_track() -> None:
    data = as_video(animation())
    for kind, before in ((b"mvhd", 12), (b"tkhd", 16)):
        at = data.index(kind) + 4
        wide = data[at] == 1
        place = at + 4 + before + (8 if wide else 0)
        assert int.from_bytes(data[place : place + (8 if wide else 4)], "big") == 160


@needs_avif
def test_a_view_becomes_a_video(tmp_path: Path) -> None:
    written = export_mp4(open_circling(200_000), tmp_path / "x.mp4")
    assert written == 200 // FRAME_MS
    count, rate_hz, _ = told(tmp_path / "x.mp4")
    assert (count, rate_hz) == (written, pytest.approx(1000 / FRAME_MS))


def test_a_pillow_without_avif_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(features, "check", lambda name: False)
    with pytest.raises(MissingExtraError, match=r"Pillow.*\.gif"):
        export_mp4(open_circling(200_000), tmp_path / "x.mp4")
