"""Parts of another package are found by name, and cannot replace this package's own."""

from configparser import ConfigParser
from itertools import islice
from pathlib import Path

import pytest

import spikingtac as st
from spikingtac import plugins
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.errors import ConfigError, FormatError
from spikingtac_paper.trials.methods import main_methods
from stand_ins.moving_rims import calibration, windows
from stand_ins.random_packets import packet_at

MODULE = """
from spikingtac.contact.registry import EventCountDetector
from spikingtac.events.create import NpzWriter
from spikingtac.events.formats.arrays import ArraySource
from stand_ins.live import MovedBy


def build_tracker(config, calibration, law):
    return MovedBy(calibration.reference_px)


def build_detector(config, calibrations, quiet):
    return EventCountDetector(len(list(quiet)))


class MineSource(ArraySource):
    format = "MINE"
"""

# Group -> name -> object.
POINTS = {
    plugins.TRACKERS: {"still": "my_parts:build_tracker", "disc": "my_parts:build_tracker"},
    plugins.READERS: {"mine": "my_parts:MineSource"},
    plugins.WRITERS: {"mine": "my_parts:NpzWriter", "gone": "my_parts:NoSuchThing"},
    plugins.DETECTORS: {
        "count": "my_parts:build_detector",
        "default": "my_parts:build_detector",
        "gone": "my_parts:NoSuchThing",
    },
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package as a third party would install it: a module beside a dist-info."""
    (tmp_path / "my_parts.py").write_text(MODULE, encoding="utf-8")
    info = tmp_path / "my_parts-1.2.dist-info"
    info.mkdir()
    metadata = "Metadata-Version: 2.1\nName: my-parts\nVersion: 1.2\n"
    (info / "METADATA").write_text(metadata, encoding="utf-8")
    points = ConfigParser()
    points.read_dict(POINTS)
    with (info / "entry_points.txt").open("w", encoding="utf-8") as file:
        points.write(file)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("package")
def test_an_experiment_compares_a_tracker() -> None:
    method = main_methods()["still"]
    assert "my-parts 1.2" in method.about
    assert type(method.build(calibration())).__name__ == "MovedBy"


def test_a_format_is_written_and_read(package: Path) -> None:
    with st.create_events(package / "a.mine", (70, 40)) as writer:
        writer.write(packet_at(range(5), (0, 5), (70, 40)))
    # Written as NPZ, whose signature picks the reader before the ending does.
    assert sum(len(part) for part in st.open_events(package / "a.mine")) == 5
    (package / "b.mine").write_bytes(b"something else")
    with pytest.raises(st.SpikingTacError):
        list(st.open_events(package / "b.mine"))
    with pytest.raises(ConfigError, match="my-parts"):
        st.create_events(package / "a.gone", (70, 40))


@pytest.mark.usefixtures("package")
def test_a_detector_is_made_by_its_name() -> None:
    quiet, config = list(windows(1_000, seed=1)), DetectionConfig()
    made = make_detector("count", config, [], islice(quiet, 200))
    assert made.summary().figures == {"threshold": 200}
    own = make_detector("default", config, [calibration()], quiet)
    assert "scales_ms" in own.summary().figures
    with pytest.raises(ConfigError, match="my-parts"):
        make_detector("gone", config, [], quiet)
    with pytest.raises(ConfigError, match=r"valid: event_count, default, count, gone"):
        make_detector("unheard-of", config, [], quiet)


def test_an_unknown_name_lists_what_there_is(tmp_path: Path) -> None:
    config = st.load_config("default").with_tracking(method="disk")
    with pytest.raises(ConfigError, match=r"did you mean 'disc'.*disc, blobs"):
        st.make_tracker(config.tracking, calibration())
    (tmp_path / "a.mine").write_bytes(b"?")
    with pytest.raises(FormatError, match="mine"):
        st.open_events(tmp_path / "a.mine")
    with pytest.raises(ConfigError, match="no package registers"):
        plugins.origin(plugins.TRACKERS, "still")
