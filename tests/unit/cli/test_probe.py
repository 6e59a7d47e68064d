"""``spikingtac probe``: what is refused before anything moves."""

import pytest

from spikingtac.cli.probe import Args, run
from spikingtac.errors import ConfigError


def test_an_arm_needs_a_finger_that_listens() -> None:
    with pytest.raises(ConfigError, match="needs --events and --calibration"):
        run(Args(arm="192.0.2.1"))


def test_a_hole_narrower_than_the_bit_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"at least 0\.5 mm"):
        run(Args(radius_mm=0.3))
