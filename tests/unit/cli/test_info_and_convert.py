"""The verbs info and convert: keys, cuts, flips and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cli.files import convert, info
from spikingtac.cli.main import main
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events import create_events, open_events
from spikingtac.types import EventPacket

SIZE = (32, 24)
KEYS = {
    "format", "size", "events", "on_fraction", "t_first_us", "t_last_us", "duration_s",
    "mean_rate_mev_s", "peak_rate_mev_s", "anomalies", "health",
}  # fmt: skip


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    t = np.concatenate((np.arange(0, 10_000, 10), np.arange(20_000, 20_500))).astype(np.int64)
    column = (np.arange(len(t)) % 20).astype(np.uint16)
    packet = EventPacket(column, column, column < 5, t, 0, 20_500, SIZE)
    with create_events(tmp_path / "a.raw", SIZE) as writer:
        writer.write(packet)
    return tmp_path / "a.raw"


def test_info_prints_the_contracts_keys(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(recorded), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) == KEYS
    assert (found["format"], found["size"], found["events"]) == ("EVT3", [32, 24], 1_500)
    assert (found["t_first_us"], found["t_last_us"]) == (0, 20_499)
    assert found["on_fraction"] == 0.25
    assert found["duration_s"] == pytest.approx(0.020499)
    assert found["mean_rate_mev_s"] == pytest.approx(1_500 / 20_499)
    assert found["peak_rate_mev_s"] == 0.5
    assert found["anomalies"] == {}


def test_info_says_what_is_wrong(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recorded.write_bytes(recorded.read_bytes() + b"\x00")
    assert info.run(info.Args(file=recorded)) == 0
    shown = capsys.readouterr().out
    assert "truncated" in shown
    assert "1,500" in shown
    assert main(["info", str(recorded), "--strict"]) == 1
    assert "truncated" in capsys.readouterr().err


def test_info_of_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.raw").write_bytes(b"")
    with pytest.raises(RecordingError, match="is empty"):
        info.run(info.Args(file=tmp_path / "a.raw"))


def test_the_peak_does_not_depend_on_the_packets(recorded: Path) -> None:
    peaks = {
        info.summary(open_events(recorded, chunk_events=n))["peak_rate_mev_s"]
        for n in (1, 7, 100, 10_000)
    }
    assert peaks == {0.5}


@pytest.mark.parametrize("name", ["b.npz", "b.csv", "b.raw"])
def test_convert_cuts_and_flips(recorded: Path, name: str, capsys) -> None:
    target = recorded.with_name(name)
    arguments = ["--from-us", "5000", "--to-us", "20100", "--flip-polarity", "--json"]
    assert main(["convert", str(recorded), str(target), *arguments]) == 0
    assert json.loads(capsys.readouterr().out)["events"] == 600
    found = EventPacket.concatenate(list(open_events(target)))
    whole = EventPacket.concatenate(list(open_events(recorded)))
    inside = (whole.t >= 5_000) & (whole.t < 20_100)
    np.testing.assert_array_equal(found.t, whole.t[inside])
    np.testing.assert_array_equal(found.p, ~whole.p[inside])


def test_convert_writes_the_encoding_that_is_asked_for(recorded: Path) -> None:
    target = recorded.with_name("b.raw")
    assert convert.run(convert.Args(files=(recorded, target), encoding="evt21")) == 0
    assert open_events(target).format == "EVT2.1"


def test_convert_refuses_what_makes_no_sense(recorded: Path) -> None:
    other = recorded.with_name("b.raw")
    before = recorded.read_bytes()
    for arguments in (
        convert.Args(files=(recorded, recorded)),
        convert.Args(files=(recorded, recorded.parent)),
        convert.Args(files=(recorded, recorded.parent / "no" / "b.raw")),
        convert.Args(files=(recorded, other), from_us=5, to_us=5),
        convert.Args(files=(recorded, other.with_suffix(".npz")), encoding="evt2"),
    ):
        with pytest.raises(ConfigError):
            convert.run(arguments)
    assert recorded.read_bytes() == before
