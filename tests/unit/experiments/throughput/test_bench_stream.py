"""The bench's stream: what is kept is what was made."""

from pathlib import Path

import numpy as np
import pytest

from spikingtac_paper.throughput import bench_stream as module
from spikingtac_paper.throughput.bench_stream import TARGET_HZ, kept_stream


def test_a_kept_stream_is_the_one_that_was_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = kept_stream("typical", 0, 1, tmp_path)
    monkeypatch.setattr(module, "bench_stream", lambda *_: pytest.fail("made again"))
    kept = kept_stream("typical", 0, 1, tmp_path)
    for name in "xypt":
        assert np.array_equal(getattr(kept.events, name), getattr(made.events, name)), name
    spans = [(s.events.t_start_us, s.events.t_end_us, s.events.size) for s in (made, kept)]
    assert spans[0] == spans[1]
    assert np.array_equal(kept.truth.marker_px, made.truth.marker_px)
    assert kept.truth.released_us == made.truth.released_us
    assert (kept.rate_hz, kept.trial) == (made.rate_hz, made.trial)
    assert made.rate_hz == pytest.approx(TARGET_HZ, rel=0.1)
