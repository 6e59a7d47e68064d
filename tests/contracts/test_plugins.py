"""Parts of another package are found by name, and cannot replace this package's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import spikingtac as st
from spikingtac import plugins
from spikingtac.errors import ConfigError, FormatError
from spikingtac_paper.trials.methods import main_methods
from stand_ins.plugin_package import install

CALIBRATION = st.Calibration(
    reference_px=np.array([[20.0, 20.0], [50.0, 20.0]]),
    radius_px=np.full(2, 7.0),
    grid=(1, 2),
    size=(70, 40),
)


def packet() -> st.EventPacket:
    t_us = np.arange(5, dtype=np.int64)
    x, y = np.full(5, 3, np.uint16), np.full(5, 4, np.uint16)
    return st.EventPacket(x, y, t_us % 2 == 0, t_us, 0, 5, (70, 40))


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    points = {
        plugins.TRACKERS: {"still": "my_parts:build_tracker", "disc": "my_parts:build_tracker"},
        plugins.READERS: {"mine": "my_parts:MineSource"},
        plugins.WRITERS: {"mine": "my_parts:NpzWriter", "gone": "my_parts:NoSuchThing"},
    }
    install(tmp_path, points)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("package")
def test_an_experiment_compares_it() -> None:
    method = main_methods()["still"]
    assert "my-parts 1.2" in method.about
    assert method.key() != main_methods()["default"].key()


def test_a_format_is_written_and_read(package: Path) -> None:
    with st.create_events(package / "a.mine", (70, 40)) as writer:
        writer.write(packet())
    # Written as NPZ, whose signature picks the reader before the ending does.
    assert sum(len(part) for part in st.open_events(package / "a.mine")) == 5
    (package / "b.mine").write_bytes(b"something else")
    with pytest.raises(st.SpikingTacError):
        list(st.open_events(package / "b.mine"))


def test_what_cannot_be_loaded_is_named(package: Path) -> None:
    with pytest.raises(ConfigError, match="my-parts"):
        st.create_events(package / "a.gone", (70, 40))


def test_an_unknown_name_lists_what_there_is(tmp_path: Path) -> None:
    config = st.load_config("default").with_tracking(method="unheard-of")
    with pytest.raises(ConfigError, match="disc, bands, blobs"):
        st.make_tracker(config.tracking, CALIBRATION)
    (tmp_path / "a.mine").write_bytes(b"?")
    with pytest.raises(FormatError, match="mine"):
        st.open_events(tmp_path / "a.mine")
    with pytest.raises(ConfigError, match="no package registers"):
        plugins.origin(plugins.TRACKERS, "still")
