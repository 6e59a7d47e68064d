"""The kernels of touches and live forces against the same sums over whole arrays."""

from __future__ import annotations

import numpy as np

from spikingtac.touch.force.model import (
    AVERAGE_S,
    LONGEST_GAP_S,
    MEMORY_S,
    MEMORY_SHARES,
    PRIOR_S,
    FieldStream,
)

Array = np.ndarray


def test_fields_are_told_from_their_zero_with_their_past() -> None:
    """The zero as a mean of rests, and the memory marker by marker, in plain Python."""
    rng, radius = np.random.default_rng(3), 0.5
    stream, zero, rested_s, t_us = FieldStream(radius, 8, memory=True), np.zeros(8), PRIOR_S, 0
    means, seen, gaps = np.zeros((2, 8)), 0, 0
    for number in range(200):
        step_us = int(rng.integers(1_000, 250_000)) if number else 0
        t_us, step_s = t_us + step_us, 1e-6 * step_us
        frame = 0.3 + 0.1 * rng.normal(size=8) + 4.0 * (number % 3 == 2)
        away = frame - zero
        if (away * away).mean() < radius**2:
            seen += 1
            share_s = min(step_s, 0.1) if number else 0.1
            rested_s = min(rested_s + share_s, AVERAGE_S)
            zero = zero + share_s / rested_s * away
        found = stream.update(t_us, frame)
        fade = [1.0 - np.exp(-step_s / tau) for tau in MEMORY_S[:, 0]]
        if step_s > LONGEST_GAP_S:
            gaps += 1
            means = np.array([(1.0 - g) * row for g, row in zip(fade, means, strict=True)])
            fade = [0.0, 0.0]
        shares = MEMORY_SHARES[:, 0]
        kept = sum(c * (1.0 - g) * m for c, g, m in zip(shares, fade, means, strict=True))
        told = (frame - zero + kept) / (1.0 - sum(c * g for c, g in zip(shares, fade, strict=True)))
        means = np.array([m + g * (told - m) for g, m in zip(fade, means, strict=True)])
        np.testing.assert_allclose(found, told, rtol=1e-12, atol=1e-13)
    assert 100 < seen < 150
    assert gaps > 10
