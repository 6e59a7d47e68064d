"""``view`` offers the other recordings of a folder on this machine only."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from spikingtac.cli import view
from spikingtac.viewer.openers import open_from_shelf, open_view_or_events
from spikingtac.viewer.web import show as show_module


@pytest.fixture
def openers(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    found: list[Any] = []
    monkeypatch.setattr(
        show_module, "show", lambda views, *_: found.append(views[0].function) or {}
    )
    return found


def test_a_recording_on_loopback_offers_the_others(tmp_path: Path, openers: list[Any]) -> None:
    file = tmp_path / "events.raw"
    file.write_bytes(b"")
    here = view.Args(source=str(file), json=True)
    for args in (here, replace(here, host="0.0.0.0"), replace(here, source="twin:demo")):
        view.run(args)
    assert openers == [open_from_shelf, open_view_or_events, open_view_or_events]
