"""The recordings that a page may open are those of one folder, and nothing else."""

import json
from pathlib import Path
from typing import Any

import pytest

from spikingtac.errors import ConfigError
from spikingtac.viewer.hosted import _another
from spikingtac.viewer.openers import Shelf, open_from_shelf
from stand_ins.viewer import record_circling


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two recordings, one of them in a folder, and a third outside of it."""
    parent = tmp_path_factory.mktemp("shelf")
    inside = parent / "inside"
    for place in (inside / "first", inside / "day" / "second", parent / "secret"):
        place.mkdir(parents=True)
        record_circling(place)
    (inside / "notes.txt").write_text("no recording")
    (inside / "link").symlink_to(parent / "secret")
    return inside


def test_it_names_what_lies_in_the_folder_but_no_link_out_of_it(folder: Path) -> None:
    assert Shelf(folder=folder).names() == ["day/second", "first"]


@pytest.mark.parametrize(
    "name", ["../secret", "link", "/etc/passwd", "notes.txt", "", ".", "first/../../secret"]
)
def test_nothing_else_is_opened(folder: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="choose one of the list"):
        Shelf(folder=folder).open(name)


class Playing:
    """A session that keeps what it was told."""

    def __init__(self, view: Any) -> None:
        self.view, self.warned, self.closed = view, "", False

    def warn(self, why: str) -> None:
        self.warned = why

    def close(self) -> None:
        self.closed = True


class Published:
    """Greetings, as a list."""

    def __init__(self) -> None:
        self.messages: list[dict] = []

    def publish(self, message: bytes) -> bool:
        self.messages.append(json.loads(message))
        return True


def test_another_recording_replaces_the_one_that_is_played(folder: Path) -> None:
    played: Any = Playing(open_from_shelf(source=str(folder / "first")))
    greetings: Any = Published()
    make: Any = Playing
    following: Any = _another(make, greetings, played, "day/second")
    assert following is not played
    assert played.closed
    assert following.view.opened == "day/second"
    assert "starting" in greetings.messages[0]
