"""A detector of another package: found by its entry point, loaded when it is asked for."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.registry import DetectionConfig, detector_names, make_detector
from spikingtac.errors import ConfigError
from stand_ins.moving_rims import windows

MODULE = """
from spikingtac.contact.event_count import EventCountConfig, EventCountDetector

def build(config, calibrations, quiet):
    return EventCountDetector(EventCountConfig(threshold=len(list(quiet))))
"""
DECLARED = """
[spikingtac.contact_detectors]
thirds = third_party_detector:build
broken = no_such_package_anywhere:build
event_count = no_such_package_anywhere:build
"""


@pytest.fixture
def other_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Install a package that declares detectors, as pip would."""
    (tmp_path / "third_party_detector.py").write_text(MODULE)
    info = tmp_path / "third_party-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third-party\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(DECLARED)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("third_party_detector", None)


def built(name: str) -> ContactDetector:
    return make_detector(name, DetectionConfig(), [], windows(200, seed=1))


def test_an_installed_detector_is_built_by_its_name(other_package: None) -> None:
    assert "thirds" in detector_names()
    assert "third_party_detector" not in sys.modules
    assert built("thirds").summary().figures == {"threshold": 200}


def test_a_package_that_cannot_be_loaded_is_named(other_package: None) -> None:
    with pytest.raises(ConfigError, match=r"'broken'.*no_such_package_anywhere"):
        built("broken")


def test_no_package_replaces_a_detector_of_this_one(other_package: None) -> None:
    assert built("event_count").summary().quiet is not None
    assert sorted(detector_names()) == sorted(set(detector_names()))


def test_without_the_package_its_name_is_unknown() -> None:
    with pytest.raises(ConfigError, match="unknown contact detector 'thirds'"):
        built("thirds")
