"""NumPy archives that are damaged or claim too much are refused in our words."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import RecordingError
from spikingtac.events.formats.array_file import load_arrays

MIB = 1 << 20


def archive(path: Path) -> Path:
    np.savez_compressed(path, a=np.arange(5), b=np.zeros((0, 2)), c=np.array("text"), d=np.eye(3).T)
    return path


def test_arrays_come_back(tmp_path: Path) -> None:
    found = load_arrays(archive(tmp_path / "a.npz"), "arrays")
    with np.load(tmp_path / "a.npz") as expected:
        assert set(found) == set(expected.files)
        for name in found:
            np.testing.assert_array_equal(found[name], expected[name])
            assert found[name].flags.writeable


@pytest.mark.parametrize("seed", range(60))
def test_damage_is_told_in_our_words(tmp_path: Path, seed: int) -> None:
    data = bytearray(archive(tmp_path / "a.npz").read_bytes())
    rng = np.random.default_rng(seed)
    for place in rng.integers(0, len(data), 1 + seed % 4):
        data[place] = rng.integers(0, 256)
    (tmp_path / "a.npz").write_bytes(data[: len(data) - seed % 7 * 20])
    sound = load_arrays(archive(tmp_path / "b.npz"), "arrays")
    try:
        found = load_arrays(tmp_path / "a.npz", "arrays")
    except RecordingError:
        return
    for name in found.keys() & sound.keys():
        np.testing.assert_array_equal(found[name], sound[name])


def test_a_bomb_is_refused(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", size=np.zeros(200 * MIB, np.uint8))
    with pytest.raises(RecordingError, match="128 MiB"):
        load_arrays(tmp_path / "a.npz", "arrays")
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as file:
        head = "{'descr': '|u1', 'fortran_order': False, 'shape': (1000000000000,), }"
        length = len(head).to_bytes(2, "little")
        file.writestr("a.npy", b"\x93NUMPY\x01\x00" + length + head.encode())
    with pytest.raises(RecordingError, match="claims"):
        load_arrays(tmp_path / "b.npz", "arrays")
