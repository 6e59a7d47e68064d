"""What the paper states stands in the code, and paper-map.md names code and tests that exist."""

from __future__ import annotations

import re
from pathlib import Path

from spikingtac.markers.laws import PaperLawConfig
from spikingtac.markers.paper import PAPER_RATE_HZ

PROJECT = Path(__file__).resolve().parents[2]
PAPER_MAP = PROJECT / "docs" / "explanation" / "paper-map.md"


def test_values_of_the_paper() -> None:
    assert PaperLawConfig() == PaperLawConfig(delta_px=4.0, gamma=0.7)
    assert PAPER_RATE_HZ == 350


def test_paper_map_names_what_exists() -> None:
    named = re.findall(r"`([\w/]+\.py)`", PAPER_MAP.read_text(encoding="utf-8"))
    assert len(named) > 10
    roots = (PROJECT / "src" / "spikingtac", PROJECT / "tests", PROJECT)
    assert [name for name in named if not any((root / name).is_file() for root in roots)] == []
