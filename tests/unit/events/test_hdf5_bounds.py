"""HDF5 files that point elsewhere or claim too much are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from spikingtac.errors import FormatError
from spikingtac.events import open_events
from spikingtac.events.formats import hdf5_layout


def write(path: Path, name: str = "x") -> Any:
    file = h5py.File(path, "w")
    for column in "xypt":
        if column != name:
            file[f"events/{column}"] = np.zeros(8, np.int64)
    return file


def test_external_storage_is_not_read(tmp_path: Path) -> None:
    with write(tmp_path / "a.h5") as file:
        file.create_dataset("events/x", (8,), "u1", external=[("/etc/passwd", 0, 8)])
    with pytest.raises(FormatError, match="other files"):
        open_events(tmp_path / "a.h5")


@pytest.mark.parametrize("soft", [False, True])
def test_links_are_not_followed(tmp_path: Path, soft: bool) -> None:
    with h5py.File(tmp_path / "b.h5", "w") as other:
        other["x"] = np.zeros(8)
    with write(tmp_path / "a.h5") as file:
        file["away" if soft else "events/x"] = h5py.ExternalLink("b.h5", "/x")
        if soft:
            file["events/x"] = h5py.SoftLink("/away")
    with pytest.raises(FormatError, match="is a link, which is not followed"):
        open_events(tmp_path / "a.h5")


def test_a_huge_chunk_is_refused(tmp_path: Path) -> None:
    with write(tmp_path / "a.h5") as file:
        file.create_dataset("events/x", (1 << 30,), "u1", chunks=(1 << 30,))
    with pytest.raises(FormatError, match="128 MiB"):
        open_events(tmp_path / "a.h5")


@pytest.mark.parametrize(
    ("attributes", "size"),
    [
        ({"geometry": "64x48"}, (64, 48)),
        ({"width": 32, "height": np.int32(24)}, (32, 24)),
        ({"sensor_resolution": np.array([20, 30])}, (30, 20)),
    ],
)
def test_the_size_comes_from_the_attributes(
    tmp_path: Path, attributes: dict[str, Any], size: tuple[int, int]
) -> None:
    with write(tmp_path / "a.h5") as file:
        file["events/x"] = np.zeros(8, np.int64)
        file["events"].attrs.update(attributes)
        file["events"].attrs["note"] = np.zeros(3)
    assert open_events(tmp_path / "a.h5").size == size


def test_attributes_without_end_are_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with write(tmp_path / "a.h5") as file:
        file["events/x"] = np.zeros(8, np.int64)
    monkeypatch.setattr(hdf5_layout, "TIME_LIMIT_S", 1e-3)
    with pytest.raises(FormatError, match="no end of its attributes"):
        open_events(tmp_path / "a.h5")
