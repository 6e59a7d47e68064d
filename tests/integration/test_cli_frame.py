"""The frame of the command line: help, mistakes of a new user, wrong files, exit codes."""

import json
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cli import main as frame
from spikingtac.cli.main import function_of, main
from spikingtac.cli.main import verbs as all_verbs
from spikingtac.errors import ConfigError, MissingExtraError, RecordingError
from stand_ins.known import known
from stand_ins.tracks import circling_tracks
from stand_ins.verbs import Verbs
from stand_ins.viewer import record_circling

COMMAND = Path(sys.executable).with_name("spikingtac")

# Names of the arguments that say where something is written.
WRITTEN = {"output", "picture", "target", "export"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with its calibration, one without events, tracks, and a truth."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "circling").mkdir()
    record_circling(folder / "circling")
    for ending in ("npz", "csv"):
        circling_tracks(estimates=20).save(folder / f"tracks.{ending}")
    (folder / "tracks.parquet").write_bytes(b"PAR1\0")
    np.savez(folder / "truth.npz", marker_t_us=np.arange(2), marker_px=np.zeros((2, 64, 2)))
    np.savez(folder / "zero.npz", t=[], x=[], y=[], p=[], size=(320, 320))
    (folder / "finger.json").symlink_to(folder / "circling" / "calibration.json")
    known(np.full((1, 2), 99.0), size=(640, 480)).save(folder / "wide.json")
    return folder


def test_the_command_lists_every_verb_and_ends_quietly_without_a_reader(verbs: Verbs) -> None:
    pipe, text = subprocess.PIPE, verbs.said("--help")
    assert all(f"\n  {verb} " in text for verb in all_verbs())
    with subprocess.Popen([COMMAND, "--help"], stdout=pipe, stderr=pipe) as process:
        process.stdout.close()
        noise = process.stderr.read()
    assert (process.returncode, noise) == (frame.EXIT_BROKEN_PIPE, b"")


def test_a_verb_runs_without_stdout_and_stderr(made: Path, tmp_path: Path) -> None:
    words = f"exec '{COMMAND}' convert '{made / 'circling'}' '{tmp_path / 'events.npz'}' >&- 2>&-"
    assert subprocess.run(["/bin/sh", "-c", words], check=False).returncode == 0
    assert (tmp_path / "events.npz").is_file()


TWICE = "--calibration finger.json --second-calibration finger.json"
FORCE = "--calibration finger.json --force c --limit-n 1"


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("touch tracks.npz --preset fast", "--preset"),
        ("track circling -o new.npz --second-calibration wide.json", "--second-calibration"),
        ("export tracks.npz --to zarr -o new --fps 7", "--fps"),
        ("force check tracks.npz -o new.npz", "--output"),
        ("force apply tracks.npz -o new.npz --wrench truth.npz", "--wrench"),
        ("force fit tracks.npz --thickness-mm 9", "--thickness-mm"),
        ("force fit tracks.npz --force new.onnx", "--force"),
        ("calibrate --check finger.json circling --pitch-mm 3", "--pitch-mm"),
        ("calibrate --check finger.json circling -o new.json", "--output"),
        ("calibrate finger.json --pitch-mm 3 --sensor 1 -o new.json", "--sensor"),
        ("view circling --seed 2", "--seed"),
        ("view udp:0 --camera ideal", "--camera"),
        ("info tracks.npz --sensor 1", "--sensor"),
        ("info zero.npz --encoding evt2", "--encoding"),
        ("ros2 tracks.npz --rate-hz 100", "--rate-hz"),
        ("plot circling --kind hot --at-s 1", "--at-s"),
        ("plot tracks.npz --slow 2", "--slow"),
        ("compare tracks.npz tracks.npz --theme dark", "--theme"),
        ("contact circling --detector event_count --calibration finger.json", "--calibration"),
        ("align circling --poses poses.csv --by triggers", "--by"),
        ("align circling circling --poses-clock unix", "--poses-clock"),
        ("doctor --seconds 9", "--seconds"),
        (f"track circling -o new.npz --second circling {TWICE} --sensor 1", "--sensor"),
        (f"guard --arm twin: --events a --quiet b {FORCE} --budget 2", "--budget"),
    ],
)
def test_options_that_mean_nothing_are_refused(
    words: str, option: str, made: Path, verbs: Verbs
) -> None:
    given = [made / word if (made / word).exists() else word for word in words.split()]
    assert f"error: {option} " in verbs.said(*given, code=2)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (RecordingError("cut"), 1),
        (ConfigError("unknown"), 2),
        (MissingExtraError("none"), 3),
        (FileNotFoundError(2, "No such file", "x.raw"), 1),
        (PermissionError(13, "Permission denied", "x.raw"), 1),
        (OSError(28, "No space left on device"), 3),
        (ZeroDivisionError("a mistake of ours"), 3),
        (KeyboardInterrupt(), frame.EXIT_INTERRUPTED),
    ],
)
def test_errors_become_exit_codes(
    error: BaseException, code: int, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    def fail(arguments: list[str]) -> int:
        raise error

    monkeypatch.setattr(frame, "_dispatch", fail)
    assert main(["info", "--json"]) == code
    captured = capsys.readouterr()
    if isinstance(error, KeyboardInterrupt):
        assert captured.err == ""
        return
    assert json.loads(captured.out)["exit_code"] == code
    assert captured.err.startswith("spikingtac: error: ")
    told = [part in captured.err for part in ("; you may not read", "free some", "Traceback")]
    assert told == [isinstance(error, PermissionError), "No space" in str(error), False]
    assert main(["info", "--debug"]) == code
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("verb", all_verbs())
def test_help_shows_no_none_and_verbs_that_write_take_overwrite(verb: str, verbs: Verbs) -> None:
    text = " ".join(verbs.said(verb, "--help").split())
    for nothing in ("{None", "(default: None)", "(default: False)", "(default: )"):
        assert nothing not in text.replace("│ │ ", "")
    assert "usage: spikingtac" in text
    names = {field.name for field in fields(function_of(verb)[1])}
    assert "overwrite" in names or not names & WRITTEN


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("calibrat",), "did you mean 'calibrate'"),
        (("info", "--stricd", "x"), "did you mean '--strict'"),
        (("track", "a.raw"), "--calibration calibration.json"),
        (("view",), "SOURCE"),
        (("view", "a", "--export", "x.gif", "-o", "x.png"), "--picture is for the page"),
        (("convert", "a", "b", "--crop", "1", "2"), "--crop"),
        (("plot", "udp:7777"), "is a live source; record it first"),
        (("plot", "a", "b"), "Unrecognized options: b"),
        (("track", "a", "--workers=1.5"), "--workers takes a whole number, '1.5' is none"),
        (("convert", "a", "b", "--size", "9,9"), "2 whole numbers with a blank or an x"),
        (("convert", "--crop", "1", "2", "3", "a", "b"), "--crop takes 4 whole numbers with"),
        (
            ("track", "a", "--polarity", "whites"),
            "--polarity cannot be 'whites'; did you mean 'white'? (valid: white",
        ),
        (("plot", "a", "--at-s", "nan"), "--at-s takes a number, 'nan' is none"),
        (("view", "demo", "--seed", "-1"), "--seed is -1, it must not be negative"),
        (("experiment", "holes", "-o", "run", "--seeds", "0"), "--seeds is 0, it must be above 0"),
        (("calibrate", "a", "--plot", "a.xyz"), "(valid endings: .png"),
        (("calibrate", "a", "-o", "a.xyz"), "(valid endings: .json)"),
        (("touch", "a", "-o", "a.parquet"), "(valid endings: .csv)"),
        (("track", "a", "-o", "a.XYZ"), "(valid endings: .npz, .csv, .parquet)"),
        (("track", "a", "-o", "/dev/null"), "(valid endings: .npz, .csv, .parquet)"),
        (("compare", "a", "b", "--table", "a.xlsx"), "(valid endings: .csv)"),
        (("force", "fit", "a", "-o", "a.json"), "(valid endings: .onnx)"),
        (("force", "apply", "a", "-o", "a.csv"), "(valid endings: .npz)"),
        (("experiment", "point-trackng", "-o", "run"), "did you mean 'point-tracking'"),
        (
            ("experiment", "point-tracking", "-o", "run", "--methods", "defualt"),
            "did you mean 'default'",
        ),
    ],
)
def test_what_is_typed_wrong_is_told_in_words(
    words: tuple[str, ...], told: str, verbs: Verbs, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    document = verbs.told(*words, code=2)
    assert (document["exit_code"], document["kind"]) == (2, "ConfigError")
    assert told in document["error"]
    assert "class" not in document["error"]
    assert verbs.err.startswith("spikingtac: error: ")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("track", "tracks.npz", "--calibration", "finger.json"), "it holds tracks"),
        (("view", "finger.json"), "it is a calibration"),
        (("plot", "truth.npz"), "holds no tracks: it holds the truth"),
        (("track", "circling", "--calibration", "tracks.npz"), "no calibration: it holds tracks"),
        (("track", "circling", "--calibration", "circling/events.raw"), "make one with"),
        (("track", "circling", "--calibration", "wide.json"), "the calibration is for 640x480"),
        (("compare", "tracks.npz", "finger.json"), "neither tracks nor a truth: it is a calib"),
        (("compare", "tracks.npz", "nowhere.npz"), "No such file"),
        (("compare", "tracks.csv", "tracks.npz"), "no tracks: it is a table; tracks are"),
        (("plot", "tracks.csv"), "no events: it is a table; tracks are read as .npz,"),
        (("plot", "tracks.parquet"), "no events: it is a table; tracks are read as .npz,"),
        (("touch", "nowhere.npz"), "there is no file"),
        (("info", "touches.csv"), "no events: it is a list of touches"),
        (("ros2", "nowhere.raw"), "there is no file"),
        (("view", "demmo"), "no file or folder 'demmo', and no scene of that name; did you mean"),
    ],
)
def test_what_a_file_is_instead_is_told(
    words: tuple[str, ...], told: str, made: Path, verbs: Verbs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(made)
    (made / "touches.csv").write_text("begin_us,end_us,duration_us,peak_us\n")
    output = ("-o", "new.npz") if words[0] == "track" else ()
    assert told in verbs.said(*words, *output, code=1)


def test_what_is_no_recording_is_not_blamed_for_a_missing_calibration(
    tmp_path: Path, verbs: Verbs
) -> None:
    (tmp_path / "words.txt").write_text("dear diary\n")
    (tmp_path / "folder").mkdir()
    (tmp_path / "noise.raw").write_bytes(np.random.default_rng(0).bytes(30_000))
    for path in tmp_path.iterdir():
        assert "calibration" not in verbs.said("view", path, "--headless", code=1)
    for words in (("touch", tmp_path), ("calibrate", tmp_path), ("convert", tmp_path, "b.npz")):
        assert f"holds: {str(tmp_path / 'noise.raw')!r}" in verbs.said(*words, code=2)


def test_nothing_tracked_is_told(made: Path, tmp_path: Path, verbs: Verbs) -> None:
    given = made / "zero.npz", "--calibration", made / "finger.json"
    for verb, option, name in (("track", "-o", "x.npz"), ("view", "--export", "x.mcap")):
        assert "no events" in verbs.said(verb, *given, option, tmp_path / name)


def test_figures_stand_with_their_units(made: Path, verbs: Verbs) -> None:
    text = " ".join(verbs.said("info", made / "circling").split())
    for unit in (" %", " us", "million events/s", "duration"):
        assert unit in text
    for key in ("on_fraction", "rate_mev", "rate ev s", "duration_s"):
        assert key not in text
    text = " ".join(verbs.said("info", made / "tracks.npz").split())
    assert "never observed 9" in text
    assert "scale not known" in text


@pytest.mark.parametrize("verb", ["convert", "calibrate", "track", "touch"])
def test_no_verb_replaces_what_it_reads(verb: str, made: Path, verbs: Verbs) -> None:
    recording, events = made / "circling", made / "circling" / "events.raw"
    output = [events] if verb == "convert" else ["-o", events]
    known = ["--calibration", made / "finger.json"] if verb in ("track", "touch") else []
    before = events.read_bytes()
    for read in (recording, events):
        said = verbs.said(verb, read, *output, *known, "--overwrite", code=2)
        assert "is the input itself" in said
    assert events.read_bytes() == before


@pytest.mark.parametrize("verb", ["convert", "calibrate", "track"])
def test_a_file_is_replaced_only_when_asked(
    verb: str, made: Path, tmp_path: Path, verbs: Verbs
) -> None:
    fails = verb == "calibrate"  # without events: what was there stays
    output = tmp_path / ("out.json" if fails else "out.npz")
    recording = made / ("zero.npz" if fails else "circling")
    output.write_bytes(b"mine")
    given = [verb, recording, *(() if verb == "convert" else ("-o",)), output]
    given += ["--calibration", made / "finger.json"] if verb == "track" else []
    assert "--overwrite" in verbs.said(*given, code=2)
    assert output.read_bytes() == b"mine"
    verbs.said(*given, "--overwrite", code=int(fails))
    assert (output.read_bytes() == b"mine") == fails
    assert not list(tmp_path.glob(".*"))
