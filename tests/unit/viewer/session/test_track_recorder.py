from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.plots.summary import Course, Picture, save_summary
from spikingtac.tracks import Tracks
from spikingtac.types import MarkerFrame
from spikingtac.viewer.export.output_files import check_picture, tracks_beside
from spikingtac.viewer.session.track_recorder import FileTrackRecorder

REST = np.array([[1.0, 2.0]])


def frame(t_us: int) -> MarkerFrame:
    moved = REST + t_us
    return MarkerFrame(t_us, moved, moved, moved - REST, np.zeros(1, bool), np.ones(1))


def test_each_time_is_written_once_however_often_it_is_played(tmp_path: Path) -> None:
    recorder = FileTrackRecorder(tmp_path / "x.npz", REST)
    for t_us in (1, 2, 3, 2, 3, 4, 1, 5):
        recorder.take(frame(t_us))
    recorder.close({"seed": 3})
    tracks = Tracks.load(tmp_path / "x.npz")
    assert tracks.t_us.tolist() == [1, 2, 3, 4, 5]
    np.testing.assert_array_equal(tracks.displacement_px[:, 0, 0], [1, 2, 3, 4, 5])
    assert tracks.meta["seed"] == 3


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_a_picture_is_replaced_only_when_asked(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"x.{ending}"
    check_picture(path, overwrite=False)
    one = Picture(
        image=np.zeros((4, 4), np.uint8),
        reference_px=REST,
        position_px=REST + 1,
        radius_px=np.ones(1),
        t_s=0.0,
    )
    some = np.arange(3.0)
    save_summary(path, "x", one, Course(t_s=some, displacement_px=some[:, None], rate_kev_s=some))
    with pytest.raises(ConfigError, match="--overwrite"):
        check_picture(path, overwrite=False)
    check_picture(path, overwrite=True)


def test_tracks_go_beside_the_picture() -> None:
    assert tracks_beside(Path("a/b.png")) == Path("a/b.tracks.npz")
