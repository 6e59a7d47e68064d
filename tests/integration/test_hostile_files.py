"""A short attack on every reader; ``benchmarks/attack.py`` is the long one."""

from pathlib import Path

import numpy as np
import pytest

from stand_ins.hostile_files import FILE_NAMES, KINDS, mutated, outcome, seed_file

MUTANTS = 25


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_read_or_refused(tmp_path: Path, kind: str) -> None:
    sound = seed_file(kind, tmp_path)
    assert outcome(sound) == "read"
    data = sound.read_bytes()
    path = tmp_path / "m" / FILE_NAMES[kind]
    path.parent.mkdir()
    outcomes = set()
    for seed in range(MUTANTS):
        path.write_bytes(mutated(data, np.random.default_rng(seed)))
        outcomes.add(outcome(path))
    assert outcomes <= {"read", "refused"}
    assert "read" in outcomes or kind in ("h5", "npz", "npy")
