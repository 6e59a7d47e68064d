"""Fixtures that every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Return the folder of test recordings, or skip where it is absent."""
    folder = Path(os.environ.get("SPIKINGTAC_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"test recordings not found in {folder} (set SPIKINGTAC_DATA)")
    return folder
