"""What tests share is made by the first process of a run that asks, and read by the others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stand_ins.made_once import FOLDER_VARIABLE, made_once


def made_again() -> np.ndarray:
    raise AssertionError("it was made twice")


def test_a_value_is_made_once_in_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("fcntl", reason="a system without locks of files")
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    made = made_once("numbers", lambda: np.arange(3.0))
    np.testing.assert_array_equal(made_once("numbers", made_again), made)
    with pytest.raises(AssertionError, match="twice"):
        made_once("others", made_again)


def test_what_could_not_be_made_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    with pytest.raises(AssertionError, match="twice"):
        made_once("numbers", made_again)
    assert made_once("numbers", lambda: 7) == 7
