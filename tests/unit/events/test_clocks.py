"""Clocks that drift, jitter and lie: maps are found within the error that they state."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.align import SyncLine, load_poses, through_triggers
from spikingtac.events.camera_source import DeliveryMeter
from spikingtac.events.clock import ClockFit, TimeMap, through_moments
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.open import open_events
from spikingtac.events.recording import RetimedSource
from spikingtac.stream.pair import LiveMap
from stand_ins.random_packets import packet_of, save_events
from stand_ins.verbs import Verbs


def watched(
    drift_ppm: float, start_s: float = 1_000.0, seed: int = 0, end_s: float = 120.0
) -> TimeMap:
    """A host hears every 4 ms of a clock that began at ``start_s``; transport is 0.2 ms or more."""
    rng, fit = np.random.default_rng(seed), ClockFit()
    for own_s in np.arange(0.0, end_s, 0.004):
        late_s = 2e-4 + rng.exponential(1e-3)
        fit.arrived(round(own_s * 1e6), start_s + own_s * (1.0 + drift_ppm * 1e-6) + late_s)
    mapping = fit.mapping()
    assert mapping is not None
    return mapping


@pytest.mark.parametrize("seed", range(2))
def test_two_clocks_meet_at_their_host_within_five_errors(seed: int) -> None:
    own, base = watched(40.0, 1_003.5, seed), watched(-25.0, 1_000.0, seed + 100)
    assert 0.0 < base.host_s(60e6) - (1_000.0 + 60.0 * (1 - 25e-6)) < 5e-4  # the fastest transport
    found = own.then(base.inverse())
    true_drift_ppm = ((1 + 40e-6) / (1 - 25e-6) - 1) * 1e6
    assert abs(found.drift_ppm - true_drift_ppm) < 5.0 * found.drift_error_ppm < 5.0
    for own_s in (0.0, 60.0, 120.0):
        host_s = 1_003.5 + own_s * (1 + 40e-6)
        truth_us = (host_s - 1_000.0) / (1 - 25e-6) * 1e6
        error_us = abs(found(np.array([round(own_s * 1e6)]))[0] - truth_us)
        assert error_us < 5.0 * found.error_at_us(own_s * 1e6) + 1.0
        assert found.error_at_us(own_s * 1e6) < 100.0


def test_there_and_back_and_through_documents() -> None:
    found = TimeMap(own_us=5e8, base_us=1.7e15, drift_ppm=33.0, error_us=7.0, drift_error_ppm=0.2)
    t_us = np.arange(0, 10**9, 10**7)
    assert np.abs(found.inverse()(found(t_us)) - t_us).max() <= 1
    assert TimeMap.from_document(found.summary()) == found
    assert TimeMap.from_clock(found.clock_summary()).at(7e8) == pytest.approx(found.at(7e8), abs=1)
    assert (np.diff(found(np.arange(0, 10**6, 7))) >= 0).all()
    for change in ({"base_us": "soon"}, {"own_us": 1e999}):
        with pytest.raises(RecordingError, match="time_base"):
            TimeMap.from_document({**found.summary(), **change})


def test_little_is_known_at_first_and_memory_stays_bounded() -> None:
    assert ClockFit().mapping() is None
    short = watched(50.0, end_s=1.0)
    assert (short.drift_ppm, short.drift_error_ppm) == (0.0, None)
    for count, held_s in ((20_000, 0.0), (40, 6.5)):  # at first, deliveries were held
        fit = ClockFit()
        for number in range(count):
            fit.arrived(number * 100_000, max(5.0 + number * 0.1 * (1.0 + 1e-5), held_s))
        mapping = fit.mapping()
        assert len(fit._bins) < 4096
        assert mapping.drift_ppm == pytest.approx(10.0, abs=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_taps_give_offset_and_drift_and_mistaken_ones_are_left_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    own_us = np.sort(rng.integers(0, 300_000_000, 40)).astype(float)
    base_us = 1e6 + own_us * (1 + 60e-6) + rng.normal(0.0, 300.0, 40)
    base_us[rng.integers(0, 40, 6)] += 40_000.0
    found = through_moments(own_us, base_us)
    assert abs(found.drift_ppm - 60.0) < 5.0 * found.drift_error_ppm
    truth_us = 1e6 + found.own_us * (1 + 60e-6)
    assert abs(found.base_us - truth_us) < 5.0 * found.error_us
    assert 10.0 < found.error_us < 200.0
    with pytest.raises(ConfigError, match="in pairs"):
        through_moments(own_us, base_us[1:])


def delivered(seed: int, away_s: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Deliver both every 2 ms with late arrivals; return mapped times and true ones, us."""
    rng = np.random.default_rng(seed)
    base, own = ClockFit(), ClockFit()
    shift_us: list[float] = []
    lives = LiveMap(own.mapping, shift_us), LiveMap(base.mapping, shift_us)
    found, truth = [], []
    for now_s in np.arange(0.0, 10.0, 0.002):
        host_s = 500.0 + now_s
        base_us, own_us = now_s * (1 - 30e-6) * 1e6, (now_s + 7.25) * (1 + 50e-6) * 1e6
        base.arrived(round(base_us), host_s + 3e-4 + rng.exponential(2e-3))
        if now_s >= away_s:
            own.arrived(round(own_us), host_s + 3e-4 + rng.exponential(2e-3))
            events_us = np.sort(rng.integers(round(own_us) - 2_000, round(own_us) + 1, 20))
            found.append(lives[0](events_us))
            there_us = lives[1](np.array([round(base_us)]))
            truth.append(there_us + (events_us - own_us) * (1 - 80e-6))
    return np.concatenate(found), np.concatenate(truth)


@pytest.mark.parametrize(("seed", "away_s"), [(0, 0.0), (1, 0.0), (5, 5.0)])
def test_live_times_stay_in_order_and_come_near_the_truth(seed: int, away_s: float) -> None:
    found, truth = delivered(seed, away_s)
    packets = found.reshape(-1, 20)
    assert (np.diff(packets, axis=1) >= 0).all()
    assert (packets[1:, 0] - packets[:-1, -1] >= -1).all()
    error_us = np.abs(found - truth)
    assert error_us.max() < 12_000  # the first delivery may be late by so much
    assert error_us[len(error_us) // 2 :].max() < 300


def test_the_interval_of_deliveries_is_told_in_words() -> None:
    now = [0.0]
    meter = DeliveryMeter(lambda: now[0])
    assert "nothing" in meter.health({}).sentence
    for number in range(100):
        now[0] = 0.004 * number
        meter.delivered(50, now[0])
    health = meter.health({"gap": 2})
    assert health.sentence.startswith("packets every 4.0 ms")
    assert "a 1 ms window is not a 1 ms latency" in health.sentence
    assert (health.events, health.losses) == (5_000, {"gap": 2})


OFFSET_US, DRIFT_PPM = 4_321_000.0, 80.0


def on_own(t_us: NDArray[Any]) -> NDArray[np.int64]:
    """Put true times on the mapped clock."""
    return np.rint(t_us * (1.0 + DRIFT_PPM * 1e-6) + OFFSET_US).astype(np.int64)


def line(t_us: NDArray[Any], begun_us: float = 0.0, channel: int = 2) -> SyncLine:
    triggers = Triggers()
    triggers.append(np.rint(t_us).astype(np.int64), channel, True)
    return SyncLine(int(begun_us), triggers)


def assert_true(found: Any) -> None:
    drift_ppm = (1.0 / (1.0 + DRIFT_PPM * 1e-6) - 1.0) * 1e6
    assert found.learned_from == "triggers"
    true_us = (found.own_us - OFFSET_US) / (1.0 + DRIFT_PPM * 1e-6)
    assert abs(found.base_us - true_us) < 4.0 * found.error_us
    assert abs(found.drift_ppm - drift_ppm) < 4.0 * found.drift_error_ppm


@pytest.mark.parametrize("seed", range(5))
def test_odd_moments_give_the_clocks_in_spite_of_lost_edges(seed: int) -> None:
    """Each camera loses a tenth of the edges, begins and ends at another time, and jitters."""
    rng = np.random.default_rng(seed)
    moments_us = np.cumsum(rng.uniform(20_000, 800_000, 120))
    mine, theirs = (moments_us[rng.random(120) > 0.1] for _ in range(2))
    own, base = line(on_own(mine[10:] + rng.normal(0.0, 5.0, len(mine))[10:])), line(theirs[:-8])
    found = through_triggers(own, base)
    assert_true(found)
    assert found.error_us < 2.0
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


def test_few_edges_are_enough() -> None:
    moments_us = np.array([0.1e6, 0.25e6, 0.47e6, 0.6e6, 0.91e6])
    found = through_triggers(line(moments_us + 37.0), line(moments_us))
    assert (found.base_us - found.own_us, found.drift_ppm) == (pytest.approx(-37.0), 0.0)


def test_one_pulse_gives_the_offset_alone() -> None:
    found = through_triggers(line(np.array([9_000_000])), line(np.array([2_000_000])))
    assert (found.own_us, found.base_us, found.drift_error_ppm) == (9e6, 2e6, None)


def test_other_lines_and_channels_are_refused() -> None:
    rng = np.random.default_rng(1)
    one, other = (line(np.cumsum(rng.uniform(1e5, 9e5, 60)), 9_000) for _ in range(2))
    with pytest.raises(RecordingError, match="trigger edges agree"):
        through_triggers(one, other)
    with pytest.raises(ConfigError, match="of no channel; record them at once"):
        through_triggers(one, line(np.arange(5.0), channel=3))
    for lines in (one, other):
        lines.triggers.append([10**9], 5, True)
    with pytest.raises(ConfigError, match=r"several channels \(2, 5\); choose"):
        through_triggers(one, other)
    with pytest.raises(ConfigError, match=r"on channel 4 .* both: 2, 5"):
        through_triggers(one, other, 4)
    assert through_triggers(one, other, 5).drift_ppm == 0.0


def test_align_puts_events_and_edges_on_the_first_clock(tmp_path: Path, verbs: Verbs) -> None:
    rng = np.random.default_rng(3)
    moments_us = np.sort(rng.uniform(1e6, 19e6, 30))
    t_us = np.sort(rng.uniform(0.0, 20e6, 5_000))
    x, y = rng.integers(0, 320, (2, len(t_us)))
    for name, right in (("left.npz", False), ("right.raw", True)):
        t, seen, last = (
            on_own(times) if right else times.astype(np.int64)
            for times in (t_us, moments_us, moments_us[-1:] + 500)
        )
        edges = Triggers()
        edges.append(seen, 1, True)
        edges.append(last, 4, True)
        save_events(tmp_path / name, packet_of(t, x, y, x > y, (320, 320)), triggers=edges)
    with (tmp_path / "right.raw").open("ab") as file:
        file.write(b"\x90")
    given = "align", tmp_path / "left.npz", tmp_path / "right.raw"
    document = verbs.told(*given, "--trigger-channel", 1, "-o", tmp_path / "pair")
    assert document["anomalies"]["truncated"] == 1
    told = document["time_base"]
    assert told["learned_from"] == "triggers"
    assert abs(told["drift_ppm"] + DRIFT_PPM) < 4.0 * told["drift_error_ppm"] < 1.0
    right = np.concatenate([packet.t for packet in open_events(tmp_path / "pair", sensor=1)])
    assert np.abs(right - t_us).max() < 4.0
    for sensor in (0, 1):
        list(paired := open_events(tmp_path / "pair", sensor=sensor))
        assert np.abs(paired.triggers.t_us[:-1] - moments_us).max() < 4.0
    assert "--trigger-channel" in verbs.said(*given, "--by", "triggers", code=2)
    (tmp_path / "day").mkdir()
    inside = (tmp_path / "right.raw").rename(tmp_path / "day" / "events.raw")
    over = "align", given[1], inside, "--trigger-channel", 1, "-o", inside.parent, "--overwrite"
    assert "is read" in verbs.said(*over, code=2)
    inside.rename(tmp_path / "right.raw")  # it is still there
    source = open_events(tmp_path / "right.raw")
    line = SyncLine.of(open_events(tmp_path / "left.npz"))
    placed = RetimedSource(source, through_triggers(SyncLine.of(source), line, 1), ReadOptions())
    assert sum(len(packet) for packet in placed) == len(t_us)
    assert np.abs(placed.triggers.t_us[:-1] - moments_us).max() < 4.0


@pytest.mark.parametrize(
    "text",
    [
        "x_mm,t_s,grip\n1,0.5,0\n2,0.75,1\n",
        "# by hand\nx_mm;t_s;grip\n1,0;0,5;0,0\n\n2,0;0,75;1,0\n",
        '"x_mm"\t"t_s"\t"grip"\n1\t0.5\t0\n2\t0.75\t1\n',
    ],
)
def test_a_table_is_read_in_any_unit_and_order_of_columns(tmp_path: Path, text: str) -> None:
    (tmp_path / "p.csv").write_text(text)
    found = load_poses(tmp_path / "p.csv")
    assert found.t_us.tolist() == [500_000, 750_000]
    assert found.names == ("x_mm", "grip")
    assert found.state.tolist() == [[1.0, 0.0], [2.0, 1.0]]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x,y\n1,2\n",
        "t_s,t_us,x\n1,2,3\n",
        "t_s,x\n1,nan\n",
        "t_s,x\n2,1\n1,1\n",
        "t_s,x\n1,2\n1\n",
    ],
)
def test_what_is_no_table_of_poses_is_refused_with_what_it_needs(tmp_path: Path, text: str) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(RecordingError, match=r"poses: (?!.*unpack).*one time column"):
        load_poses(tmp_path / "p.csv")
