"""``track --cut-s``: a recording tracked in pieces, at rest, in a long hold, and after Ctrl-C."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.batch.journal import JOURNAL
from spikingtac.cli.main import main
from spikingtac.events import create_events
from spikingtac.touch.force.creep_memory import CreepConfig
from spikingtac.touch.force.files.model_file import save_force
from spikingtac.touch.force.fit import fit_force
from spikingtac.touch.force.wrench_series import WrenchSeries
from spikingtac.tracks import Tracks
from spikingtac.types import EventPacket
from stand_ins.small_twin import HOLD_US, RETURN_US, calibration, touches

REPEATS, QUIET, HOLDS = 3, 8, 26
"""How often the skin is touched, how many pieces of silence follow each touch, and how many pieces
of the film make the long hold."""
QUIET_US = 300_000
"""So long the film's skin is at rest before its first touch."""
SLOWLY = "--rate-hz", "100"
"""A recording of 15 s is tracked a dozen times: a tenth of the estimates will do."""
ERROR_PX = 0.35
"""Above the error of the whole (0.2 px), below that of a marker looked for in a wrong place."""


def part(first_us: int, last_us: int) -> tuple[EventPacket, np.ndarray]:
    """Return events of the film from 0 on, and the true markers at each millisecond."""
    whole = EventPacket.concatenate(list(touches().packets))
    chosen = whole.select((whole.t >= first_us) & (whole.t < last_us))
    moved = replace(chosen, t=chosen.t - first_us, t_start_us=0, t_end_us=last_us - first_us)
    return moved, touches().at(np.arange(first_us, last_us, 1_000))


def write(folder: Path, parts: Sequence[tuple[EventPacket, np.ndarray]]) -> np.ndarray:
    """Write parts one after the other, and the calibration; return the true course."""
    begun_us = 0
    with create_events(folder / "long.raw", touches().size) as writer:
        for packet, _ in parts:
            end_us = begun_us + packet.t_end_us
            later = replace(packet, t=packet.t + begun_us, t_start_us=begun_us, t_end_us=end_us)
            writer.write(later)
            begun_us = end_us
    calibration().save(folder / "calibration.json")
    return np.concatenate([course for _, course in parts])


def track(folder: Path, name: str, *options: str) -> int:
    given = ["--calibration", str(folder / "calibration.json"), "-o", str(folder / name)]
    return main(["track", str(folder / "long.raw"), *given, "--json", *options])


def error_px(path: Path, course_px: np.ndarray) -> np.ndarray:
    """Return the mean error at every estimate."""
    tracks = Tracks.load(path)
    true_px = course_px[np.minimum(tracks.t_us // 1_000, len(course_px) - 1)]
    return np.linalg.norm(tracks.detected_px - true_px, axis=2).mean(axis=1)


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """The same touches again and again, with rests in between, tracked as a whole."""
    folder = tmp_path_factory.mktemp("repeated")
    end_us = max(packet.t_end_us for packet in touches().packets) // 1_000 * 1_000
    course = write(folder, [part(0, end_us), *[part(0, QUIET_US)] * QUIET] * REPEATS)
    assert track(folder, "whole.npz", *SLOWLY) == 0
    return folder, course


@pytest.fixture(scope="module")
def in_pieces(repeated: tuple[Path, np.ndarray]) -> dict[str, Any]:
    """Track the same in three pieces by two workers; return what is said."""
    with contextlib.redirect_stdout(io.StringIO()) as said:
        options = "--cut-s", "5", "--workers", "2", *SLOWLY
        assert track(repeated[0], "pieces.npz", *options) == 0
    return json.loads(said.getvalue())


def test_pieces_give_what_the_whole_gives(
    repeated: tuple[Path, np.ndarray], in_pieces: dict[str, Any]
) -> None:
    folder, course_px = repeated
    whole, joined = Tracks.load(folder / "whole.npz"), Tracks.load(folder / "pieces.npz")
    np.testing.assert_array_equal(joined.t_us, whole.t_us)
    assert (in_pieces["pieces"], in_pieces["estimates"]) == (3, len(whole.t_us))
    cuts_us = joined.meta["seams"]["cuts_us"]
    assert len(cuts_us) == 2
    np.testing.assert_array_equal(
        joined.detected_px[joined.t_us < cuts_us[0]], whole.detected_px[whole.t_us < cuts_us[0]]
    )
    each_px = error_px(folder / "pieces.npz", course_px)
    for cut_us in cuts_us:
        after = (joined.t_us >= cut_us) & (joined.t_us < cut_us + 1_000_000)
        assert each_px[after].mean() < ERROR_PX
    assert each_px.mean() < 1.1 * error_px(folder / "whole.npz", course_px).mean()
    assert joined.meta["input_sha256"] == whole.meta["input_sha256"]
    assert joined.meta["losses"] == whole.meta["losses"]
    np.testing.assert_allclose(joined.rate_ev_s, whole.rate_ev_s)
    assert not (folder / "pieces.npz.pieces").exists()


@pytest.mark.usefixtures("jobs_here")
def test_a_law_with_a_memory_sees_the_whole_path(repeated: tuple[Path, np.ndarray]) -> None:
    folder, _ = repeated
    law = ("--hysteresis", "paper", *SLOWLY)
    assert track(folder, "law.npz", "--cut-s", "5", "--workers", "1", *law) == 0
    assert track(folder, "law-whole.npz", *law) == 0
    joined, whole = Tracks.load(folder / "law.npz"), Tracks.load(folder / "law-whole.npz")
    before = joined.t_us < joined.meta["seams"]["cuts_us"][0]
    np.testing.assert_allclose(joined.position_px[before], whole.position_px[before], atol=1e-3)
    assert np.abs(joined.position_px - joined.detected_px).max() > 0.1  # the law does something


@pytest.mark.usefixtures("in_pieces", "jobs_here")
def test_an_interrupted_run_goes_on(
    repeated: tuple[Path, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _ = repeated
    # What an interruption leaves: some pieces, and the lines that tell of them.
    pieces = folder / "again.npz.pieces"
    kept = _interrupted(folder, pieces)
    capsys.readouterr()
    assert track(folder, "again.npz", "--cut-s", "5", "--workers", "1", *SLOWLY) == 2
    assert "--resume" in capsys.readouterr().err
    assert track(folder, "again.npz", "--cut-s", "5", "--workers", "1", *SLOWLY, "--resume") == 0
    assert json.loads(capsys.readouterr().out)["kept"] == kept
    assert (folder / "again.npz").read_bytes() == (folder / "pieces.npz").read_bytes()
    assert not pieces.exists()


def _interrupted(folder: Path, pieces: Path) -> int:
    """Run until the join, which fails; keep the journal's first line only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("spikingtac.pipeline.pieces.join.create_tracks", _no_room)
        assert track(folder, "again.npz", "--cut-s", "5", "--workers", "1", *SLOWLY) == 3
    journal = pieces / JOURNAL
    lines = journal.read_text(encoding="utf-8").splitlines(keepends=True)
    journal.write_text(lines[0] + lines[1][:20], encoding="utf-8")
    return 1


def _no_room(*_: object) -> None:
    raise MemoryError("no room")


@pytest.mark.usefixtures("jobs_here")
def test_a_cut_in_a_long_hold_is_mended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The skin is held 16 px away for 6.5 s: no piece that begins there can see it."""
    end_us = max(packet.t_end_us for packet in touches().packets) // 1_000 * 1_000
    held = [part(HOLD_US, RETURN_US)] * HOLDS
    course_px = write(tmp_path, [part(0, HOLD_US), *held, part(RETURN_US, end_us)])
    assert track(tmp_path, "whole.npz", *SLOWLY) == 0
    capsys.readouterr()
    assert track(tmp_path, "pieces.npz", "--cut-s", "5", "--workers", "1", *SLOWLY) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["mended"] >= 1
    assert said["seam_worst_px"] > 10.0
    whole, joined = Tracks.load(tmp_path / "whole.npz"), Tracks.load(tmp_path / "pieces.npz")
    np.testing.assert_array_equal(joined.t_us, whole.t_us)
    each_px = error_px(tmp_path / "pieces.npz", course_px)
    assert each_px.mean() < error_px(tmp_path / "whole.npz", course_px).mean() + 0.05
    assert each_px.max() < error_px(tmp_path / "whole.npz", course_px).max() + 0.5


@pytest.mark.usefixtures("jobs_here")
def test_forces_go_on_over_the_cuts(repeated: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    folder, _ = repeated
    whole = Tracks.load(folder / "whole.npz")
    moved = whole.displacement_px[::5].astype(np.float64)
    # Any law will do: a sum over the markers, by which a force that begins anew would be noticed.
    wrench = np.column_stack([moved.sum(axis=1), np.abs(moved).sum(axis=(1, 2))])
    at_rest = whole.reference_px.astype(np.float64)
    series = WrenchSeries(whole.t_us[::5], at_rest, moved, wrench, "px", "whole")
    model = fit_force([series], creep=CreepConfig(fractions=(0.2,), times_s=(2.0,)))
    save_force(model, tmp_path / "force.json")
    options = ["--cut-s", "5", "--workers", "1", "--force", str(tmp_path / "force.json"), *SLOWLY]
    assert track(folder, "forces.npz", *options) == 0
    joined = Tracks.load(folder / "forces.npz")
    assert len(joined.meta["seams"]["cuts_us"]) == 2
    assert joined.wrench_estimate is not None
    assert joined.wrench_estimate.shape == (len(joined.t_us), 3)
    assert np.isfinite(joined.wrench_estimate).all()
    steps = np.abs(np.diff(joined.wrench_estimate, axis=0)).max(axis=1)
    at_cuts = np.searchsorted(joined.t_us, joined.meta["seams"]["cuts_us"]) - 1
    assert steps[at_cuts].max() < steps.max()
    assert track(folder, "forces.csv", *options) == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--cut-s", "1"], "at least 5"),
        (["--cut-s", "5", "--force", "nothing.json"], "nothing.json"),
        (["--cut-s", "5", "--second", "b.raw"], "--second"),
    ],
)
def test_what_does_not_go_together_is_refused(
    options: list[str],
    words: str,
    repeated: tuple[Path, np.ndarray],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert track(repeated[0], "refused.npz", *options) == 2
    assert words in capsys.readouterr().err
    assert not list(repeated[0].glob("refused*"))


def test_several_recordings_and_cameras_are_not_cut(
    repeated: tuple[Path, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _ = repeated
    calibrated = ["--calibration", str(folder / "calibration.json"), "--cut-s", "60"]
    for given in (["a.raw", "b.raw"], ["twin:demo"]):
        assert main(["track", *given, *calibrated]) == 2
        assert "--cut-s" in capsys.readouterr().err
