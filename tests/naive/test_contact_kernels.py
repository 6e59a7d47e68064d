"""The contact kernels beside the same thing said plainly."""

import numpy as np
import pytest

from spikingtac.contact.evidence import (
    AFFINE_MODES,
    BESIDE,
    CLEAR_LIGHT,
    LEAST_AGREEMENT,
    MODES,
    OFF_RIM,
    RimTable,
    ScaleSums,
    ScaleTest,
    distance_of,
    evidence_of,
    rim_table,
)
from spikingtac.types import EventPacket
from stand_ins.moving_rims import SIZE, calibration, windows


def plain_evidence(packet: EventPacket, table: RimTable) -> np.ndarray:
    evidence, level, (off, on) = np.zeros((2, MODES)), np.zeros(len(table.modes)), table.steps
    for x, y, p in zip(packet.x, packet.y, packet.p, strict=True):
        row = table.row[y, x]
        if row == OFF_RIM:
            evidence[int(p), BESIDE] += 1.0
        else:
            moves = level[row] + np.array([0.0, table.steps[int(p)]])
            beyond, level[row] = np.diff(moves - moves.clip(-on, -off))[0], moves[1]
            signs = [1.0 if p else -1.0] * AFFINE_MODES
            evidence[int(p), :BESIDE] += table.modes[row] * [*signs, beyond]
    return evidence


@pytest.mark.parametrize("count", [0, 1, 5, 400])
def test_evidence(count: int) -> None:
    table = rim_table(calibration())._replace(steps=np.array([-1.2, 0.8]))
    (packet,) = windows(1, seed=count, noise=0.0, speed=lambda _: (count / 1000.0, 0.0))
    (noise,) = windows(1, seed=count, noise=float(count))
    for some in (packet, noise, EventPacket.empty(0, 1000, SIZE)):
        expected, table.level[:] = plain_evidence(some, table).ravel(), 0.0
        np.testing.assert_allclose(evidence_of(some, [table]), expected, atol=1e-9)


def test_a_pixel_that_lacks_one_event_after_its_return_is_no_distance() -> None:
    table, p = rim_table(calibration()), np.array([True, True, True, False, False])
    at = np.full((5, 2), np.argwhere(table.row == 0)[0, ::-1], np.uint16)
    packet = EventPacket(at[:, 0], at[:, 1], p, np.arange(5), 0, 1000, SIZE)
    away = [distance_of(evidence_of(one, [table])) for one in (packet.select(p), packet.select(~p))]
    assert away == pytest.approx(2.0 * table.modes[0, AFFINE_MODES] * np.array([1.0, -1.0]))


def test_scales() -> None:
    rng = np.random.default_rng(1)
    lengths = np.array([1, 2, 4, 8])
    chance, mean, parts = np.array([0.1, 0.5, 1.0, 2.0]), rng.normal(size=32), (2, 2, MODES)
    test = ScaleTest(lengths, rng.normal(size=(4, 3, 32)), chance, mean, np.ones(4))
    evidence = rng.normal(size=(60, 32))
    sums = ScaleSums(test)
    for now in range(1, 61):
        values = sums.add(evidence[now - 1])
        for scale, length in enumerate(lengths[: now.bit_length()]):
            total = (evidence[:now] - mean)[now - length :].sum(axis=0)
            light = chance[scale] * total.reshape(parts)[..., BESIDE].clip(0.0).sum()
            off, on = np.moveaxis(total.reshape(parts)[..., :AFFINE_MODES], 1, 0)
            agree = (off * on).sum() >= LEAST_AGREEMENT * max((off**2).sum(), (on**2).sum())
            expected = max(np.linalg.norm(test.whiten[scale] @ total) - light, 0.0) ** 2
            expected *= light <= CLEAR_LIGHT or agree
            assert values[scale] == pytest.approx(expected)
            np.testing.assert_allclose(sums.total(scale), total)
    sums.reset()
    assert sums.add(evidence[0])[1:].tolist() == [0.0, 0.0, 0.0]
