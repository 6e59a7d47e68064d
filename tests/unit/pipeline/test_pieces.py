"""Where a recording is cut, how seams are judged, and how pieces are joined."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events import create_events, open_events
from spikingtac.pipeline.pieces.join import Stretch, join
from spikingtac.pipeline.pieces.plan import SHARED_US, Piece, PlanPass
from spikingtac.pipeline.pieces.seams import SETTLED_US, Agreement, distance
from spikingtac.touch.force.model import ForceModel, Wrench
from spikingtac.tracks import Tracks
from spikingtac.types import EventPacket, MarkerFrame, SourceHealth

SIZE = (32, 32)
SENSOR = Calibration(
    reference_px=np.array([[8.0, 8.0], [24.0, 8.0]]),
    radius_px=np.array([3.0, 3.0]),
    grid=(1, 2),
    size=SIZE,
)


def recording(folder: Path, t: np.ndarray, name: str = "long.raw") -> Path:
    t = np.sort(t).astype(np.int64)
    rng = np.random.default_rng(1)
    x, y = (rng.integers(0, 32, len(t)).astype(np.uint16) for _ in range(2))
    with create_events(folder / name, SIZE) as writer:
        writer.write(EventPacket(x, y, x > 15, t, int(t[0]), int(t[-1]) + 1, SIZE))
    return folder / name


def planned(path: Path, cut_s: float = 10.0) -> tuple[PlanPass, list[Piece]]:
    plan = PlanPass(open_events(path), cut_s, overlap_s=2.0)
    return plan, list(plan.pieces())


def test_pieces_follow_each_other_and_overlap(tmp_path: Path) -> None:
    t = np.random.default_rng(2).integers(500, 45_000_000, 600_000)
    plan, pieces = planned(recording(tmp_path, t))
    assert plan.first_us == t.min()
    assert plan.events == len(t)
    assert [piece.number for piece in pieces] == list(range(len(pieces)))
    assert (pieces[0].from_us, pieces[0].cut_us) == (t.min(), t.min())
    assert (pieces[-1].next_us, pieces[-1].to_us) == (None, None)
    for piece, after in itertools.pairwise(pieces):
        assert piece.next_us == after.cut_us
        assert piece.to_us == after.cut_us + SHARED_US
        assert 9_000_000 <= after.cut_us - piece.cut_us <= 10_000_000
        assert 2_000_000 <= after.cut_us - after.from_us <= 3_000_000
        assert after.cut_us in t
        assert after.from_us in t


def test_a_cut_lies_where_little_happens(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    t = rng.integers(0, 30_000_000, 500_000)
    calm = (9_400_000, 9_700_000)
    t = t[(t < calm[0]) | (t > calm[1]) | (rng.random(len(t)) < 0.02)]
    _, pieces = planned(recording(tmp_path, t))
    assert calm[0] - 50_000 <= pieces[1].cut_us <= calm[1]


def test_a_silence_of_several_cuts_is_one_piece(tmp_path: Path) -> None:
    t = np.concatenate([np.arange(0, 4_000_000, 40), np.arange(40_000_000, 60_000_000, 40)])
    _, pieces = planned(recording(tmp_path, t))
    cuts = [piece.cut_us for piece in pieces]
    assert cuts[1] == 40_000_000
    assert cuts == sorted(set(cuts))


def test_a_piece_reads_its_own_events_only(tmp_path: Path) -> None:
    t = np.random.default_rng(4).integers(0, 40_000_000, 900_000)
    path = recording(tmp_path, t)
    whole = EventPacket.concatenate(list(open_events(path)))
    _, pieces = planned(path)
    for piece in pieces[1:]:
        source = open_events(path)
        assert piece.place is not None
        source.begin = Piece.parse(piece.document()).place
        read = EventPacket.concatenate(list(source))
        assert len(read) < len(whole)
        assert read.t[0] <= piece.from_us
        for name in "xypt":
            np.testing.assert_array_equal(
                getattr(read, name), getattr(whole, name)[len(whole) - len(read) :]
            )


def test_other_formats_are_read_from_the_start(tmp_path: Path) -> None:
    t = np.arange(0, 30_000_000, 100)
    plan, pieces = planned(recording(tmp_path, t, "long.npz"))
    assert not plan.seekable
    assert len(pieces) == 3
    assert all(piece.place is None for piece in pieces)


def test_recordings_without_events_and_short_cuts_are_refused(tmp_path: Path) -> None:
    with create_events(tmp_path / "empty.raw", SIZE):
        pass
    with pytest.raises(RecordingError, match="no events"):
        list(PlanPass(open_events(tmp_path / "empty.raw"), 10.0).pieces())
    for cut_s in (0.0, -1.0, 4.9, float("nan")):
        with pytest.raises(ConfigError, match="at least 5"):
            PlanPass(open_events(tmp_path / "empty.raw"), cut_s)


def tracks(
    t_us: np.ndarray, shift_px: float, coasted: bool = False, gaps: int = 0
) -> tuple[Tracks, list[MarkerFrame]]:
    place = SENSOR.reference_px + np.array([[shift_px, 0.0], [0.0, 0.0]])
    frames = [
        MarkerFrame(
            int(t),
            place,
            place,
            place - SENSOR.reference_px,
            np.array([coasted, False]),
            np.ones(2),
            SourceHealth(gaps=gaps),
        )
        for t in t_us
    ]
    return Tracks.of(frames, SENSOR), frames


def test_distance_is_taken_where_both_have_estimates() -> None:
    one, _ = tracks(np.arange(0, 100, 10), 0.0)
    other, _ = tracks(np.arange(50, 150, 10), 0.4)
    found = distance(one, other)
    assert found.mean_px == pytest.approx(0.2, abs=1e-6)
    assert found.worst_px == pytest.approx(0.4, abs=1e-6)
    assert found.small
    assert not distance(one, tracks(np.arange(0, 100, 10), 2.0)[0]).small
    assert distance(one, tracks(np.arange(200, 300, 10), 9.0)[0]).small  # nothing contradicts


def test_a_marker_that_both_have_lost_tells_nothing() -> None:
    t_us = np.arange(0, 100, 10)
    assert distance(tracks(t_us, 0.0, True)[0], tracks(t_us, 9.0, True)[0]).small
    assert not distance(tracks(t_us, 0.0, True)[0], tracks(t_us, 9.0)[0]).small


def test_two_ways_agree_once_they_have_for_long_enough() -> None:
    t_us = np.arange(0, 3_000_000, 10_000)
    begun, _ = tracks(t_us, 0.0)
    apart, near = tracks(t_us[:50], 5.0)[1], tracks(t_us[50:], 0.1)[1]
    agreement = Agreement(begun)
    yielded = list(agreement.until([*apart, *near]))
    assert agreement.agreed_us == t_us[50] + SETTLED_US
    assert yielded[-1].t_us == agreement.agreed_us - 10_000
    never = Agreement(begun)
    assert len(list(never.until(apart))) == 50
    assert never.agreed_us is None


def test_joined_counters_go_on(tmp_path: Path) -> None:
    paths = []
    for number, (first, gaps) in enumerate(((0, 2), (1_000, 1))):
        found, frames = tracks(np.arange(first, first + 1_500, 100), 1.0, gaps=gaps)
        more = tracks(np.arange(first + 1_500, first + 2_000, 100), 1.0, gaps=gaps + 3)[1]
        del found
        Tracks.of([*frames, *more], SENSOR).save(tmp_path / f"{number}.npz")
        paths.append(tmp_path / f"{number}.npz")
    stretches = [
        Stretch(path=paths[0], from_us=0, to_us=1_700),
        Stretch(path=paths[1], from_us=1_700, to_us=None),
    ]
    for name in ("joined.npz", "joined.csv"):
        summary = join(stretches, tmp_path / name, SENSOR, None, {"seams": {}})
        assert summary.estimates == 30
        assert summary.largest_px == pytest.approx(1.0)
    joined = Tracks.load(tmp_path / "joined.npz")
    np.testing.assert_array_equal(joined.t_us, np.arange(0, 3_000, 100))
    assert joined.gaps is not None
    assert joined.gaps[[0, 14, 15, 17, 24, -1]].tolist() == [0, 0, 3, 3, 3, 6]
    rows = (tmp_path / "joined.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + 30 * 2


class Remembering:
    """Stands for a force model whose values depend on every frame before."""

    class Estimator:
        def __init__(self) -> None:
            self.seen_px = np.zeros(2)

        def update(self, t_us: int, moved_px: np.ndarray) -> Wrench:
            self.seen_px = self.seen_px + moved_px.mean(axis=0) + t_us * 1e-6
            return Wrench(t_us, self.seen_px, np.ones(2), 0.5)

    def require_image(self, markers: int) -> None:
        assert markers == len(SENSOR.reference_px)

    def estimator(self) -> Estimator:
        return self.Estimator()


def test_forces_go_on_where_pieces_are_joined(tmp_path: Path) -> None:
    t_us, model = np.arange(0, 3_000, 100), cast(ForceModel, Remembering())
    frames = tracks(t_us, 1.0)[1]
    for name, part in (("whole", frames), ("a", frames[:17]), ("b", frames[17:])):
        Tracks.of(part, SENSOR).save(tmp_path / f"{name}.npz")
    pieces = {
        "joined": [("a", 0, 1_700), ("b", 1_700, None)],
        "at_once": [("whole", 0, None)],
    }
    for name, parts in pieces.items():
        stretches = [
            Stretch(path=tmp_path / f"{part}.npz", from_us=first, to_us=last)
            for part, first, last in parts
        ]
        join(stretches, tmp_path / f"{name}.npz", SENSOR, None, {}, model)
    joined, whole = (Tracks.load(tmp_path / f"{name}.npz") for name in pieces)
    assert joined.wrench_estimate is not None
    assert np.ptp(joined.wrench_estimate[:, 0]) > 1.0
    np.testing.assert_array_equal(joined.wrench_estimate, whole.wrench_estimate)
    with pytest.raises(ConfigError, match=r"written to \.npz"):
        join(stretches, tmp_path / "no.csv", SENSOR, None, {}, model)
