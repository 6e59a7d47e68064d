"""The calibration of another sensor of the same size is noticed by every verb that uses one."""

import json
import shutil
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from spikingtac.sim.catalog import load_scene
from spikingtac.sim.render import simulate
from spikingtac.viewer.opening import open_view
from spikingtac.viewer.session import Session
from stand_ins.known import known
from stand_ins.verbs import Verbs


@pytest.fixture(scope="module")
def slides(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("slides") / "one"
    simulate(load_scene("train-slides"), folder, seed=0, duration_s=1.6)
    return folder


@pytest.fixture(scope="module")
def own(slides: Path) -> Path:
    return saved(slides, slides.parent / "own.json", moved_px=0.0)


@pytest.fixture(scope="module")
def foreign(slides: Path) -> Path:
    """Another specimen: its markers were placed with a scatter of 1 px a direction."""
    return saved(slides, slides.parent / "foreign.json", moved_px=1.0)


def saved(recording: Path, path: Path, moved_px: float) -> Path:
    with np.load(recording / "truth.npz") as truth:
        reference_px, radius_px = truth["reference_px"], truth["radius_px"]
    reference_px = reference_px + np.random.default_rng(3).normal(0, moved_px, reference_px.shape)
    # With steps: `track` learns those of a file that has none, which takes longer than all else.
    known(reference_px, radius_px, step=0.14, contrast=6.0).save(path)
    return path


@pytest.mark.parametrize("verb", ["track", "contact", "touch"])
def test_it_is_told_and_strict_refuses_it_but_not_the_own_one(
    verb: str, slides: Path, own: Path, foreign: Path, tmp_path: Path, verbs: Verbs
) -> None:
    given: list[object] = [verb, slides]
    if verb == "track":
        given += ["-o", tmp_path / "tracks.npz", "--overwrite"]
    warned = verbs.said(*given, "--calibration", foreign)
    assert "warning: the recording does not fit the calibration" in warned
    refused = verbs.said(*given, "--calibration", foreign, "--strict", code=1)
    assert "lacks edge_px, or something pressed at first; calibrate this sensor: spik" in refused
    for calibration, misfits in ((foreign, True), (own, False)):
        strict = [] if misfits else ["--strict"]
        found = verbs.told(*given, "--calibration", calibration, *strict)
        if verb == "track":
            with np.load(tmp_path / "tracks.npz") as tracks:
                meta = json.loads(str(tracks["meta"]))
            assert meta["calibration_misfit"] == found["calibration_misfit"]
        if verb != "touch":
            assert (found["calibration_misfit"] is not None) == misfits
        assert misfits or "does not fit" not in verbs.err


def test_recordings_are_checked_against_a_calibration(
    slides: Path, own: Path, foreign: Path, tmp_path: Path, verbs: Verbs
) -> None:
    assert "fits own.json" in verbs.said("calibrate", slides, "--check", own)
    assert "fits" not in verbs.err
    found = verbs.told("calibrate", slides, "--check", foreign, code=1)
    assert (found["fits"], found["contradiction"] > found["limit"]) == (False, True)
    simulate(load_scene("quiet"), still := tmp_path / "still", seed=0, duration_s=0.3)
    assert "too little moves" in verbs.said("calibrate", still, "--check", own, code=1)
    day = tmp_path / "day"
    for name in ("a", "b"):
        shutil.copytree(slides, day / name)
    (day / "bad.raw").write_bytes(b"junk")
    line = ["calibrate", day, "--workers", 1]
    many = verbs.told(*line, "--check", foreign, "-o", tmp_path / "checked", code=1)
    assert (many["done"], many["failed"]) == (2, 1)
    assert [row.get("fits") for row in many["rows"]] == [None, 0, 0]
    assert json.loads((tmp_path / "checked" / "a.json").read_text())["words"].startswith("the rec")
    assert "--check" in verbs.said(*line, code=2)


def test_the_page_says_it(slides: Path, foreign: Path, own: Path) -> None:
    for calibration, misfits in ((foreign, True), (own, False)):
        view, taken = open_view(str(slides), calibration=str(calibration)), Mock(return_value=True)
        session = Session(view, taken, bool)  # type: ignore[arg-type]
        session.step()
        session.close()
        assert (b"does not fit the calibration" in taken.call_args.args[0]) == misfits
