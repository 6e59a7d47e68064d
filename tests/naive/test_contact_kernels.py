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
    evidence_of,
    rim_table,
)
from spikingtac.types import EventPacket
from stand_ins.moving_rims import SIZE, calibration, windows


def plain_evidence(packet: EventPacket, table: RimTable) -> np.ndarray:
    evidence = np.zeros((2, MODES))
    for x, y, p in zip(packet.x, packet.y, packet.p, strict=True):
        row = table.row[y, x]
        if row == OFF_RIM:
            evidence[int(p), BESIDE] += 1.0
        else:
            evidence[int(p), :BESIDE] += (1.0 if p else -1.0) * table.modes[row]
    return evidence


@pytest.mark.parametrize("count", [0, 1, 5, 400])
def test_evidence(count: int) -> None:
    table = rim_table(calibration())
    (packet,) = windows(1, seed=count, noise=0.0, speed=lambda _: (count / 1000.0, 0.0))
    (noise,) = windows(1, seed=count, noise=float(count))
    for some in (packet, noise, EventPacket.empty(0, 1000, SIZE)):
        expected = plain_evidence(some, table).ravel()
        np.testing.assert_allclose(evidence_of(some, [table]), expected, atol=1e-9)


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
