"""Waiting for what another thread or process does."""

import os
import time
from collections.abc import Callable

# What a loaded machine may add to a stated time; 0.3 holds on an idle one.
SLACK_S = float(os.environ.get("SPIKINGTAC_SLACK_S", "5"))
PATIENCE_S = 90.0  # A cold cache is compiled meanwhile, and other tests run beside.


def wait_until(done: Callable[[], object], patience_s: float = PATIENCE_S) -> float:
    """Wait until something is true, and return for how long, s."""
    begun_s = time.monotonic()
    while not done():
        assert time.monotonic() - begun_s < patience_s, "it did not come"
        time.sleep(0.005)
    return time.monotonic() - begun_s
