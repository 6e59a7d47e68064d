"""Which recordings files, folders and patterns name, and where their results go."""

from pathlib import Path

import numpy as np
import pytest

from spikingtac.batch.inputs import (
    find_recordings,
    is_many,
    outputs_of,
)
from spikingtac.errors import ConfigError


@pytest.fixture
def day(tmp_path: Path) -> Path:
    """A folder with recordings of every kind, and with files that are none."""
    (tmp_path / "press.2").mkdir()
    (tmp_path / "press.2" / "events.raw").write_bytes(b"x")
    np.savez(tmp_path / "press.2" / "truth.npz", marker_px=np.zeros(1))
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("x")
    (tmp_path / "later").mkdir()
    (tmp_path / "later" / "slide.raw").write_bytes(b"x")
    (tmp_path / "later" / ".slide.partial-1.raw").write_bytes(b"x")
    np.savez(tmp_path / "events.npz", t=np.zeros(1), x=np.zeros(1))
    np.savez(tmp_path / "tracks.npz", t_us=np.zeros(1), displacement_px=np.zeros(1))
    (tmp_path / "broken.npz").write_bytes(b"PK")
    (tmp_path / "table.csv").write_text("t,x\n")
    (tmp_path / "notes.md").write_text("x")
    return tmp_path


def names(found: list[Path], day: Path) -> list[str]:
    return [str(path.relative_to(day)) for path in found]


def test_a_folder_stands_for_the_recordings_in_it_and_below(day: Path) -> None:
    expected = ["bag", "broken.npz", "events.npz", "later/slide.raw", "press.2"]
    assert names(find_recordings([day]), day) == expected


def test_a_pattern_and_what_it_overlaps_are_taken_once(day: Path) -> None:
    found = find_recordings([day / "*" / "*.raw", day / "later", day / "table.csv"])
    assert names(found, day) == ["later/slide.raw", "press.2/events.raw", "table.csv"]
    assert names(find_recordings([day / "p*"]), day) == ["press.2"]


def test_results_of_an_earlier_run_are_no_recordings(day: Path) -> None:
    inside = day / "later"
    assert "later/slide.raw" not in names(find_recordings([day], apart_from=inside), day)
    with pytest.raises(ConfigError, match="name a recording"):
        find_recordings([])


@pytest.mark.parametrize("given", ["-", "udp:7777", "twin:demo"])
def test_live_sources_are_refused(given: str) -> None:
    with pytest.raises(ConfigError, match="live source"):
        find_recordings([Path("a.raw"), Path(given)])


def test_one_recording_is_not_many(day: Path) -> None:
    one = (day / "press.2", day / "events.npz", day / "bag", day / "gone.raw", Path("udp:7777"))
    assert not any(is_many([path]) for path in one)
    assert is_many([day])
    assert is_many([day / "*.raw"])
    assert is_many([day / "a.raw", day / "b.raw"])


def test_results_lie_as_their_recordings_do(day: Path) -> None:
    outputs = outputs_of([day / "press.2", day / "later" / "slide.raw"], Path("/out"), ".npz")
    assert outputs == [Path("/out/press.2.npz"), Path("/out/later/slide.npz")]
    assert outputs_of([day / "later" / "slide.raw"], Path("/out"), ".csv") == [
        Path("/out/slide.csv")
    ]


def test_two_recordings_never_share_a_result(day: Path) -> None:
    with pytest.raises(ConfigError, match="would both be written"):
        outputs_of([day / "a.raw", day / "a.es"], Path("/out"), ".npz")
