"""The contact kernels beside the same thing said plainly."""

import numpy as np
import pytest

from spikingtac.contact.evidence import (
    AFFINE_MODES,
    OFF_RIM,
    RimTable,
    ScaleSums,
    ScaleTest,
    evidence_kernel,
    exceeded_kernel,
    rim_table,
)
from spikingtac.types import EventPacket
from stand_ins.moving_rims import SIZE, calibration, windows


def plain_evidence(packet: EventPacket, table: RimTable) -> tuple[np.ndarray, np.ndarray]:
    evidence = np.zeros((2, AFFINE_MODES))
    by_marker = np.zeros((len(table.center_px), 2))
    for x, y, p in zip(packet.x, packet.y, packet.p, strict=True):
        row = table.row[y, x]
        if row != OFF_RIM:
            sign = 1.0 if p else -1.0
            evidence[int(p)] += sign * table.modes[row]
            by_marker[table.marker[row]] += sign * table.modes[row, :2]
    return evidence, by_marker


@pytest.mark.parametrize("count", [0, 1, 5, 400])
def test_evidence(count: int) -> None:
    table = rim_table(calibration())
    (packet,) = windows(1, seed=count, noise=0.0, speed=lambda _: (count / 1000.0, 0.0))
    (noise,) = windows(1, seed=count, noise=float(count))
    for some in (packet, noise, EventPacket.empty(0, 1000, SIZE)):
        evidence, by_marker = np.ones((2, AFFINE_MODES)), np.ones((9, 2), np.float32)
        evidence_kernel(some.x, some.y, some.p, *table[:3], evidence, by_marker)
        expected = plain_evidence(some, table)
        np.testing.assert_allclose(evidence, expected[0], atol=1e-9)
        np.testing.assert_allclose(by_marker, expected[1], atol=1e-4)


def test_scales() -> None:
    rng = np.random.default_rng(1)
    lengths = np.array([1, 2, 4, 8])
    test = ScaleTest(lengths, rng.normal(size=(4, 3, 5)), rng.normal(size=5), np.ones(4))
    evidence = rng.normal(size=(60, 5))
    sums = ScaleSums(test)
    for now in range(1, 61):
        values = sums.add(evidence[now - 1])
        for scale, length in enumerate(lengths):
            total = (evidence[:now] - test.mean)[now - length :].sum(axis=0)
            expected = float(((test.whiten[scale] @ total) ** 2).sum()) if now >= length else 0.0
            assert values[scale] == pytest.approx(expected)
            if now >= length:
                np.testing.assert_allclose(sums.total(scale), total)
    kept = np.cumsum((evidence - test.mean)[-8:] @ np.ones(5))
    np.testing.assert_allclose(np.diff(sums.course(np.ones(5))), np.diff(kept, prepend=0.0))
    sums.reset()
    assert sums.add(evidence[0])[1:].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("seed", range(5))
def test_exceeded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, threshold = rng.exponential(size=9), rng.exponential(size=9) + seed
    ratio = values / threshold
    expected = int(ratio.argmax()) if ratio.max() > 1.0 else -1
    assert exceeded_kernel(values, threshold) == expected
