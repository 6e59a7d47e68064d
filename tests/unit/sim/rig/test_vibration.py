"""The arm's vibration has the stated rms, spectrum and independence of the step."""

import numpy as np
import pytest

from spikingtac.sim.rig.rig import Vibration


@pytest.mark.parametrize("dt_s", [0.0005, 0.004])
def test_rms_and_resonance_do_not_depend_on_the_step(dt_s: float) -> None:
    vibration = Vibration(0.03, np.random.default_rng(1))
    path = np.array([vibration.advance(dt_s) for _ in range(round(30.0 / dt_s))])
    assert path.std() == pytest.approx(0.03, rel=0.1)
    power = np.abs(np.fft.rfft(path, axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(path), dt_s)
    low, high = (power[(frequency > a) & (frequency < b)].mean() for a, b in ((13, 17), (0, 5)))
    assert low > 8.0 * high
    assert np.abs(np.corrcoef(path.T) - np.eye(3)).max() < 0.2
