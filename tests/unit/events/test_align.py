"""Two clocks from an external line: offset and drift within the stated errors, or refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from spikingtac.cli.main import main
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.align import SyncLine, load_poses, through_triggers
from spikingtac.events.create import create_events
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.open import open_events
from spikingtac.events.recording import RetimedSource
from spikingtac.types import EventPacket

OFFSET_US, DRIFT_PPM = 4_321_000.0, 80.0


def on_own(t_us: NDArray[Any]) -> NDArray[np.int64]:
    """Put true times on the mapped clock."""
    return np.rint(t_us * (1.0 + DRIFT_PPM * 1e-6) + OFFSET_US).astype(np.int64)


def line(t_us: NDArray[Any], begun_us: float = 0.0, channel: int = 2) -> SyncLine:
    triggers = Triggers()
    triggers.append(np.rint(t_us).astype(np.int64), channel, True)
    return SyncLine(int(begun_us), triggers)


def assert_true(found: Any, sigmas: float = 4.0) -> None:
    drift_ppm = (1.0 / (1.0 + DRIFT_PPM * 1e-6) - 1.0) * 1e6
    assert found.learned_from == "triggers"
    true_us = (found.own_us - OFFSET_US) / (1.0 + DRIFT_PPM * 1e-6)
    assert abs(found.base_us - true_us) < sigmas * found.error_us
    assert abs(found.drift_ppm - drift_ppm) < sigmas * found.drift_error_ppm


@pytest.mark.parametrize("seed", range(5))
def test_odd_moments_give_the_clocks_in_spite_of_lost_edges(seed: int) -> None:
    """Each camera loses a tenth of the edges, begins and ends at another time, and jitters."""
    rng = np.random.default_rng(seed)
    moments_us = np.cumsum(rng.uniform(20_000, 800_000, 120))
    mine, theirs = (moments_us[rng.random(120) > 0.1] for _ in range(2))
    jitter_us = rng.normal(0.0, 5.0, len(mine))
    own, base = line(on_own(mine[10:] + jitter_us[10:])), line(theirs[:-8])
    found = through_triggers(own, base)
    assert_true(found)
    assert found.error_us < 2.0
    assert found.drift_error_ppm is not None
    assert found.drift_error_ppm < 0.1


def test_a_regular_line_is_taken_where_it_began_while_both_recorded() -> None:
    pulses_us = 2_000_000 + np.arange(3_000) * 33_333.0
    mine = on_own(pulses_us)
    assert_true(through_triggers(line(mine, mine[0] - 700_000), line(pulses_us)))
    for cut in (0, 3):  # the same number of edges, or some that one alone has seen
        with pytest.raises(RecordingError, match="at odd moments"):
            through_triggers(line(mine[cut:], mine[cut] - 20_000), line(pulses_us))
    few = pulses_us[:4]  # too few to tell by chance
    with pytest.raises(RecordingError, match="at odd moments"):
        through_triggers(line(on_own(few[1:]), on_own(few[1:])[0] - 9), line(few[:-1], few[0] - 9))


def test_one_pulse_gives_the_offset_alone() -> None:
    found = through_triggers(line(np.array([9_000_000])), line(np.array([2_000_000])))
    assert (found.own_us, found.base_us, found.drift_error_ppm) == (9e6, 2e6, None)


def test_other_lines_and_channels_are_refused() -> None:
    rng = np.random.default_rng(1)
    one, other = (line(np.cumsum(rng.uniform(1e5, 9e5, 60)), 9_000) for _ in range(2))
    with pytest.raises(RecordingError, match="trigger edges agree"):
        through_triggers(one, other)
    with pytest.raises(ConfigError, match="of no channel"):
        through_triggers(one, line(np.arange(5.0), channel=3))
    for lines in (one, other):
        lines.triggers.append([10**9], 5, True)
    with pytest.raises(ConfigError, match=r"several channels \(2, 5\); choose"):
        through_triggers(one, other)
    with pytest.raises(ConfigError, match=r"on channel 4 .* both: 2, 5"):
        through_triggers(one, other, 4)
    assert through_triggers(one, other, 5).drift_ppm == 0.0


def test_align_puts_events_and_edges_on_the_first_clock(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(3)
    moments_us = np.sort(rng.uniform(1e6, 19e6, 30))
    t_us = np.sort(rng.uniform(0.0, 20e6, 5_000))
    x, y = rng.integers(0, 320, (2, len(t_us))).astype(np.uint16)
    for name, right in (("left.npz", False), ("right.raw", True)):
        t, seen, last = (
            on_own(times) if right else times.astype(np.int64)
            for times in (t_us, moments_us, moments_us[-1:] + 500)
        )
        edges = Triggers()
        edges.append(seen, 1, True)
        edges.append(last, 4, True)
        with create_events(tmp_path / name, (320, 320)) as writer:
            writer.add_triggers(edges)
            writer.write(EventPacket(x, y, x > y, t, int(t[0]), int(t[-1]) + 1, (320, 320)))
    given = ["align", str(tmp_path / "left.npz"), str(tmp_path / "right.raw"), "--json"]
    assert main([*given, "--trigger-channel", "1", "-o", str(tmp_path / "pair")]) == 0
    told = json.loads(capsys.readouterr().out)["time_base"]
    assert told["learned_from"] == "triggers"
    assert abs(told["drift_ppm"] + DRIFT_PPM) < 4.0 * told["drift_error_ppm"] < 1.0
    right = np.concatenate([packet.t for packet in open_events(tmp_path / "pair", sensor=1)])
    assert np.abs(right - t_us).max() < 4.0
    assert main([*given, "--by", "triggers"]) == 2
    assert "--trigger-channel" in capsys.readouterr().out
    source = open_events(tmp_path / "right.raw")
    line = SyncLine.of(open_events(tmp_path / "left.npz"))
    found = through_triggers(SyncLine.of(source), line, 1)
    placed = RetimedSource(source, found, ReadOptions())
    assert sum(len(packet) for packet in placed) == len(t_us)
    assert np.abs(placed.triggers.t_us[:-1] - moments_us).max() < 4.0


def test_a_table_is_read_in_any_unit_of_time_and_any_order_of_columns(tmp_path: Path) -> None:
    rows = "x_mm,t_s,grip\n1,0.5,0\n2,0.75,1\n"
    (tmp_path / "p.csv").write_text(rows)
    found = load_poses(tmp_path / "p.csv")
    assert found.t_us.tolist() == [500_000, 750_000]
    assert found.names == ("x_mm", "grip")
    assert found.state.tolist() == [[1.0, 0.0], [2.0, 1.0]]


@pytest.mark.parametrize(
    "text",
    ["", "x,y\n1,2\n", "t_s,t_us,x\n1,2,3\n", "t_s,x\n1,nan\n", "t_s,x\n2,1\n1,1\n", "t_s,x\n1\n"],
)
def test_what_is_no_table_of_poses_is_refused_with_what_it_needs(tmp_path: Path, text: str) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(RecordingError, match="one time column"):
        load_poses(tmp_path / "p.csv")
