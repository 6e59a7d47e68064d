"""The recordings that a page may open are those of one folder, and nothing else."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from spikingtac.errors import ConfigError, SpikingTacError
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


def test_the_first_one_offers_the_others(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    view = open_from_shelf(source=str(folder / "first"), preset="fast")
    assert view.shelf is not None
    assert isinstance(view.shelf, Shelf)
    assert (view.opened, view.shelf.folder) == ("first", folder)
    other = view.shelf.open("day/second")
    assert (other.label, other.opened, other.config) == ("second", "day/second", view.config)
    monkeypatch.chdir(folder / "first")
    here = open_from_shelf(source=".")
    assert here.shelf is not None
    assert here.opened in here.shelf.names()


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


def test_one_that_cannot_be_played_changes_nothing(folder: Path) -> None:
    def refuse(_: object) -> Playing:
        raise SpikingTacError("it is empty")

    first = open_from_shelf(source=str(folder / "first"))
    tried: list[tuple[Any, Any]] = [(first, refuse), (replace(first, shelf=None), Playing)]
    for view, play in tried:
        played: Any = Playing(view)
        greetings: Any = Published()
        assert _another(play, greetings, played, "first") is played
        assert played.warned
        assert not played.closed
