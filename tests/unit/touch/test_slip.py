"""Slip: alarms, memory and episodes on made-up models; the package's own on closed forms."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from spikingtac.touch.elastic import SkinConfig, SurfaceResponse
from spikingtac.touch.slip.held import HeldTouchDetector
from spikingtac.touch.slip.monitor import Slip, SlipMonitor
from spikingtac.types import MarkerFrame
from stand_ins.live import frame_of

PITCH_MM, PX_PER_MM = 2.4, 15.4
X, Y = np.meshgrid(np.arange(8.0) - 3.5, np.arange(8.0) - 3.5)
PLACES_MM = PITCH_MM * np.column_stack([X.ravel(), Y.ravel()])
REFERENCE = PLACES_MM * PX_PER_MM + 160.0


def scripted(shares: list[float], monkeypatch: pytest.MonkeyPatch) -> SlipMonitor:
    """Return a monitor that estimates what a test wants, one frame after the other."""
    told = iter(shares)

    def follow(monitor: SlipMonitor, t_us: int, features: np.ndarray) -> None:
        share = next(told)
        monitor._estimate = share, float(share < 0.8)

    monkeypatch.setattr(SlipMonitor, "_follow", follow)
    return SlipMonitor(REFERENCE)


def felt(monitor: SlipMonitor, moved: np.ndarray) -> list[Slip]:
    """Return the slips of a touch that moves the markers so, a frame every ms."""
    found = [monitor.update(k * 1_000, row, touching=True) for k, row in enumerate(moved)]
    found.append(monitor.finish((len(moved) - 1) * 1_000))
    return [slip for slip in found if slip is not None]


SETTLED = [1.0] * 20  # What is told of a contact in the first 20 ms, which count for nothing.


@pytest.fixture
def slips(monkeypatch: pytest.MonkeyPatch) -> Callable[[list[float]], list[Slip]]:
    """From shares that the model tells of a touch, every ms from 1 ms on, to its slips."""

    def told(shares: list[float]) -> list[Slip]:
        moved = 0.01 * np.arange(len(shares) + 1)[:, None, None] ** 2 * REFERENCE
        return felt(scripted(shares, monkeypatch), moved)

    return told


Slips = Callable[[list[float]], list[Slip]]


def test_an_incipient_slip_announces_the_gross_one(slips: Slips) -> None:
    (slip,) = slips(SETTLED + [1.0] * 3 + [0.5] * 20 + [0.05] * 5 + [1.0] * 3)
    assert slip == Slip(24_000, 44_000, 49_000, 0.05)
    assert slip.lead_us == 20_000
    (at_once,) = slips(SETTLED + [1.0] * 3 + [0.0] * 2 + [1.0])
    assert (at_once.incipient_us, at_once.gross_us, at_once.lead_us) == (24_000, 24_000, 0)


@pytest.mark.parametrize(
    ("shares", "told"),
    [
        ([*SETTLED, *[0.64] * 20], []),  # most of the contact sticks
        ([*SETTLED, *[0.62] * 20], [(21_000, 40_000)]),
        # More sticks for a moment: the slip goes on.
        (SETTLED + [1.0] * 3 + ([0.6] * 5 + [0.75] * 5) * 3 + [1.0], [(24_000, 54_000)]),
        (SETTLED + ([1.0] * 3 + [0.5] * 6) * 2, [(24_000, 30_000), (33_000, 38_000)]),
        ([0.5] * 40, [(20_000, 40_000)]),  # nothing is told of the first 20 ms
    ],
)
def test_incipient_slips_begin_and_end(
    slips: Slips, shares: list[float], told: list[tuple[int, int]]
) -> None:
    assert [(slip.incipient_us, slip.end_us) for slip in slips(shares)] == told


def test_a_skin_that_stands_still_rings_no_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    monitor = scripted([*SETTLED, *[0.15] * 300], monkeypatch)
    moved = np.random.default_rng(0).normal(0.0, 0.05, (300, *REFERENCE.shape))
    assert felt(monitor, moved) == []
    assert (monitor.state.t_us, monitor.state.phase) == (299_000, "stick")


def test_a_slip_under_a_skin_that_stands_still_is_told_where_hardly_anything_sticks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A slow twist: the skin moves no further, the body does.
    moved = 0.02 * np.minimum(np.arange(300), 100)[:, None, None] * REFERENCE
    (slip,) = felt(scripted([1.0] * 145 + [0.05] * 155, monkeypatch), moved)
    assert (slip.gross_us, slip.end_us) == (146_000, 299_000)


@pytest.mark.parametrize(
    ("stops", "speed", "share", "told"),
    [
        (False, 2e-4, 0.22, False),
        (True, 2e-4, 0.22, True),
        (True, 2e-4, 0.3, False),
        (False, 4e-5, 0.22, False),
        (True, 4e-5, 0.22, True),
    ],
)
def test_less_evidence_suffices_where_the_field_has_stopped_following(
    monkeypatch: pytest.MonkeyPatch, stops: bool, speed: float, share: float, told: bool
) -> None:
    steps = np.where((np.arange(300) > 200) & stops, 0.1, 1.0)
    moved = speed * np.cumsum(steps)[:, None, None] * REFERENCE
    (slip,) = felt(scripted([share] * 300, monkeypatch), moved)
    assert (slip.gross_us is not None) == told
    if slip.gross_us is not None:
        assert 200_000 < slip.gross_us < 215_000


def test_a_model_steps_at_its_own_rate_however_often_frames_come() -> None:
    moved = 0.01 * np.arange(300)[:, None, None] ** 1.5 * (REFERENCE - REFERENCE.mean(axis=0)) / 99
    told = []
    for every in (1, 2, 4):
        monitor = SlipMonitor(REFERENCE)
        for k in range(0, 300, every):
            monitor.update(k * 1_000, moved[k], touching=k >= 100)
        told.append(monitor.state.sticking_share)
    assert told == pytest.approx([told[0]] * 3, abs=0.01)


SOURCE_MM, RADIUS_MM, PEAK_MPA, FRICTION = 0.5, 4.0, 0.06, 0.5


# Shares of the sliding force under a body that moves at a constant speed (Mindlin 1949).
LOADS = 1.0 - (1.0 - np.linspace(0.0, 1.0, 400)) ** 1.5


def hertz(r_mm: np.ndarray, radius_mm: float) -> np.ndarray:
    return np.sqrt(np.maximum(1.0 - (r_mm / max(radius_mm, 1e-9)) ** 2, 0.0))


def cattaneo_mindlin(loads: np.ndarray) -> np.ndarray:
    """Return displacements ``(n, m, 2)``, px, under a ball that is dragged, over its loads.

    Loads are shares of the sliding force.

    Traction: the whole slip's, less that of a disc of radius c which sticks, c / a being the cube
    root of one less the load (Cattaneo 1938, Mindlin 1949).
    """
    axis = np.arange(-RADIUS_MM, RADIUS_MM + 1e-9, SOURCE_MM)
    sources = np.column_stack([part.ravel() for part in np.meshgrid(axis, axis)])
    r_mm = np.sqrt((sources**2).sum(axis=1))
    whole = SurfaceResponse(SkinConfig(), 0.6 * SOURCE_MM, 30.0).matrix(PLACES_MM, sources)
    response = whole[:, :2]
    pressing = PEAK_MPA * SOURCE_MM**2 * hertz(r_mm, RADIUS_MM)
    out = []
    for load in loads:
        stuck = (1.0 - min(load, 1.0)) ** (1.0 / 3.0)
        less = stuck * hertz(r_mm, stuck * RADIUS_MM)
        shear = FRICTION * PEAK_MPA * SOURCE_MM**2 * (hertz(r_mm, RADIUS_MM) - less)
        out.append(response[..., 2] @ pressing + response[..., 0] @ shear)
    return np.array(out) * PX_PER_MM


def frames(moved: np.ndarray) -> Iterator[MarkerFrame]:
    for k, row in enumerate(moved):
        yield frame_of(k * 1_000, REFERENCE, row)


def dragged() -> np.ndarray:
    """Return 0.2 s each of rest, press and hold, 0.4 s of a drag to full slip, 0.1 s of slip."""
    pressed = cattaneo_mindlin(np.zeros(1))[0]
    rise = np.concatenate([np.zeros(200), np.linspace(0, 1, 200) ** 1.5, np.ones(200)])
    drag = cattaneo_mindlin(np.concatenate([LOADS, np.ones(100)]))
    return np.concatenate([rise[:, None, None] * pressed, drag])


def test_the_sticking_share_follows_cattaneo_and_mindlin_to_its_half() -> None:
    detector, told = HeldTouchDetector(REFERENCE), []
    for frame in frames(dragged()):
        detector.update(frame)
        told.append(np.nan if detector.slip is None else detector.slip.sticking_share)
    assert np.nanmin(told[450:600]) > 0.9
    expected = (1.0 - LOADS) ** (2.0 / 3.0)
    error = (np.array(told[600:1000]) - expected)[expected > 0.5]
    assert np.sqrt((error**2).mean()) < 0.15


def test_a_dragged_touch_tells_its_incipient_slip() -> None:
    release = dragged()[-1] * np.linspace(1.0, 0.0, 100)[:, None, None]
    rest = np.zeros((400, *REFERENCE.shape))
    detector = HeldTouchDetector(REFERENCE)
    held = [detector.update(frame) for frame in frames(np.concatenate([dragged(), release, rest]))]
    (touch,) = [one for one in held if one is not None]
    assert touch.slips
    first_us = touch.slips[0].incipient_us
    assert first_us is not None
    assert 640_000 < first_us < 870_000  # a third still sticks, all slips at 1,000,000


@pytest.mark.parametrize("more", [0, 1, 16])
def test_a_touch_that_has_just_begun_has_no_slip_rather_than_an_unknown_one(more: int) -> None:
    detector, stream = HeldTouchDetector(REFERENCE), frames(dragged())
    for frame in stream:
        detector.update(frame)
        if detector.touches.touching:
            break
    for _ in range(more):
        detector.update(next(stream))
    assert detector.slip is None
    held = detector.finish()
    assert held.slips == ()


def test_frames_of_a_slow_camera_tell_no_slip() -> None:
    detector = HeldTouchDetector(REFERENCE)
    for k, frame in enumerate(frames(dragged()[::50])):
        detector.update(replace(frame, t_us=k * 50_000))
    held = detector.finish()
    assert held.slips is None
