"""The verbs info and convert: keys, cuts, flips and refusals."""

import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cli.main import main
from spikingtac.events import open_events
from spikingtac.types import EventPacket
from stand_ins.random_packets import packet_of, save_events, whole
from stand_ins.tracks import circling_tracks
from stand_ins.verbs import Verbs

SIZE = (32, 24)
KEYS = {
    "format", "size", "events", "on_fraction", "t_first_us", "t_last_us", "duration_s",
    "mean_rate_mev_s", "peak_rate_mev_s", "anomalies", "health", "triggers", "trigger_channels",
}  # fmt: skip


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    t = np.concatenate((np.arange(0, 10_000, 10), np.arange(20_000, 20_500))).astype(np.int64)
    column = np.arange(len(t)) % 20
    return save_events(tmp_path / "a.raw", packet_of(t, column, column, column < 5, SIZE))


def test_info_prints_the_contracts_keys(recorded: Path, verbs: Verbs) -> None:
    found = verbs.told("info", recorded)
    assert set(found) == KEYS
    assert (found["format"], found["size"], found["events"]) == ("EVT3", [32, 24], 1_500)
    assert (found["t_first_us"], found["t_last_us"]) == (0, 20_499)
    assert found["on_fraction"] == 0.25
    assert found["duration_s"] == pytest.approx(0.020499)
    assert found["mean_rate_mev_s"] == pytest.approx(1_500 / 20_499)
    assert found["peak_rate_mev_s"] == 0.5
    assert found["anomalies"] == {}


def test_verbs_that_only_read_count_damage(recorded: Path, verbs: Verbs) -> None:
    with recorded.open("ab") as file:
        file.write(b"\x90")
    assert verbs.told("info", recorded)["anomalies"] == {"truncated": 1}
    output = recorded.with_name("events.png")
    assert verbs.told("plot", recorded, "-o", output)["anomalies"] == {"truncated": 1}
    said = verbs.said("plot", recorded, "-o", output, "--overwrite")
    assert "truncated 1 times in the recording" in said


def test_what_a_recording_does_not_hold_is_refused(recorded: Path, verbs: Verbs) -> None:
    assert "holds no sensor 1" in verbs.said("info", recorded, "--sensor", 1, code=2)
    target, too_far = recorded.with_name("b.npz"), 1 << 62
    said = verbs.said("convert", recorded, target, "--shift-us", too_far, code=2)
    assert "shift_us is 4611686018427387904, valid are" in said
    for part in (("--crop", 30, 22, 32, 24), ("--from-us", 30_000), ("--to-us", -5)):
        assert "nothing is kept of" in verbs.said("convert", recorded, target, *part, code=1)


def converted(recorded: Path, *options: str) -> EventPacket:
    target = recorded.with_name("changed.npz")
    assert main(["convert", str(recorded), str(target), "--overwrite", *options]) == 0
    return whole(open_events(target))


def test_convert_cuts_crops_flips_turns_and_shifts(recorded: Path) -> None:
    events = whole(open_events(recorded))
    times = ["--from-us", "5000", "--to-us", "20100", "--flip-polarity", "--shift-us", "-100"]
    found = converted(
        recorded, *times, "--crop", "4", "2", "20", "24", "--flip", "x", "--rotate", "90"
    )
    inside = (events.x >= 4) & (events.x < 20) & (events.y >= 2)
    inside &= (events.t >= 5_000) & (events.t < 20_100)
    x, y = events.x[inside].astype(int) - 4, events.y[inside].astype(int) - 2
    assert found.size == (22, 16)
    np.testing.assert_array_equal(found.x, 21 - y)  # clockwise: what was below is left
    np.testing.assert_array_equal(found.y, 15 - x)  # x was mirrored first
    np.testing.assert_array_equal(found.t, events.t[inside] - 100)
    np.testing.assert_array_equal(found.p, ~events.p[inside])
    for given in (["64", "48"], ["64x48"]):
        assert converted(recorded, "--size", *given).size == (64, 48)


def test_convert_drops_hot_pixels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(0, 2_000_000, 500, np.int64)
    hot = np.arange(len(t)) % 2 == 0
    row, column = np.where(hot, 7, np.divmod(np.arange(len(t)) % 576, 24))
    recorded = save_events(tmp_path / "a.raw", packet_of(t, column, row, hot, SIZE))
    found = converted(recorded, "--hot-pixels", "drop")
    assert not ((found.x == 7) & (found.y == 7)).any()
    assert "1 hot pixels" in capsys.readouterr().err
    assert len(converted(recorded)) == len(t) > len(found) > len(t) // 3


def test_triggers_stay_where_the_format_holds_them(tmp_path: Path, verbs: Verbs) -> None:
    words = [0x8 << 28]  # EVT 2.0: upper time 0, then edges on channel 3 at 10 and 50 us, an event
    words += [0xA << 28 | t_us << 22 | 3 << 8 | rises for t_us, rises in ((10, 1), (50, 0))]
    words += [0x1 << 28 | 60 << 22 | 5 << 11 | 7]
    source = tmp_path / "t.raw"
    head = b"% evt 2.0\n% format EVT2;height=24;width=32\n% end\n"
    source.write_bytes(head + np.array(words, "<u4").tobytes())
    found = verbs.told("info", source)
    channel = {"count": 2, "t_first_us": 10, "t_last_us": 50}
    assert (found["triggers"], found["trigger_channels"]) == (2, {"3": channel})
    target = tmp_path / "t.npz"
    verbs.said("convert", source, target, "--from-us", 20, "--shift-us", 5)
    archive = np.load(target)
    names = ("trigger_t_us", "trigger_channel", "trigger_edge")
    assert [archive[name].tolist() for name in names] == [[55], [3], [False]]
    assert "2 left out" in verbs.said("convert", source, tmp_path / "t.csv")


def test_info_tells_what_files_of_ours_are(tmp_path: Path, verbs: Verbs) -> None:
    circling_tracks(estimates=20).save(tmp_path / "tracks.npz")
    t_us, rest = np.arange(5) * 1000, np.zeros((3, 2))
    moved, wrench = np.full((5, 3, 2), 0.3), np.full((5, 6), 2.0)
    series = {"t_us": t_us, "reference_mm": rest, "displacement_mm": moved, "wrench": wrench}
    np.savez(tmp_path / "series.npz", **series)
    np.savez(tmp_path / "truth.npz", marker_t_us=t_us, marker_px=moved)
    row = {"method": "default", "case": "all", "metric": "m", "value": 1.0, "source": "twin"}
    (tmp_path / "report.json").write_text(json.dumps({"experiment": "holes", "rows": [row, row]}))
    force = {"schema": 3, "components": ["fx"], "reference": [[0, 0]], "unit": "mm"}
    (tmp_path / "force.json").write_text(json.dumps(force))
    expected = {
        "tracks.npz": ("tracks", "estimates", 20),
        "series.npz": ("series", "force_max_n", np.sqrt(12.0)),
        "truth.npz": ("truth", "markers", 3),
        "report.json": ("report", "methods", ["default"]),
        "force.json": ("force", "components", ["fx"]),
    }
    for name, (kind, key, value) in expected.items():
        found = verbs.told("info", tmp_path / name)
        assert (found["format"], found[key]) == (kind, value)
        assert found["about"] in verbs.said("info", tmp_path / name)
