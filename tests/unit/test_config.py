from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import PRESETS, Config, load_config
from spikingtac.errors import ConfigError
from spikingtac.markers.registry import make_tracker

CALIBRATION = Calibration(
    reference_px=np.array([[30.0, 30.0]]), radius_px=np.array([6.0]), grid=(1, 1), size=(64, 64)
)


def test_presets_name_their_methods_and_rates() -> None:
    said = {name: load_config(name).tracking for name in PRESETS}
    assert {name: tracking.method for name, tracking in said.items()} == {
        "default": "disc",
        "fast": "disc",
        "paper": "blobs",
    }
    assert [tracking.rate_hz for tracking in said.values()] == [1_000.0, 10_000.0, 350.0]
    assert [tracking.hysteresis for tracking in said.values()] == ["none", "none", "paper"]


def test_a_file_overrides_and_unknown_keys_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[tracking]\nrate_hz = 500\n[tracking.disc]\nshrink = 0.5\n")
    config = load_config(path)
    assert config.tracking.rate_hz == 500.0
    assert config.tracking.disc.shrink == 0.5
    path.write_text("[tracking]\nrate_hx = 500\n")
    with pytest.raises(ConfigError, match="did you mean 'rate_hz'"):
        load_config(path)
    path.write_text("[tracking.disc]\nshrink = -1.0\n")
    with pytest.raises(ConfigError, match="shrink is -1"):
        load_config(path)


def test_unknown_names_get_the_nearest() -> None:
    with pytest.raises(ConfigError, match="did you mean 'default'"):
        load_config("defualt")
    with pytest.raises(ConfigError, match="did you mean 'disc'"):
        make_tracker(Config().with_tracking(method="disk").tracking, CALIBRATION)
    with pytest.raises(ConfigError, match="anchored"):
        make_tracker(Config().with_tracking(hysteresis="anchor").tracking, CALIBRATION)


def test_contact_detection_is_configured_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('[contact]\ndetector = "event_count"\nfalse_alarms_per_hour = 3\n')
    contact = load_config(path).contact
    assert (contact.detector, contact.false_alarms_per_hour) == ("event_count", 3.0)
    path.write_text("[contact]\nfalse_alarms_per_hour = 0\n")
    with pytest.raises(ConfigError, match="must be positive"):
        load_config(path)
