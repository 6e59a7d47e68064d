"""Presets and files of settings, and the controls that their fields make."""

from dataclasses import dataclass, field
from pathlib import Path

import pytest

from spikingtac.config import PRESETS, load_config
from spikingtac.errors import ConfigError, SettingsFileError
from spikingtac.markers.laws import PaperLawConfig
from spikingtac.tuning import controls, in_use, with_value


def test_presets_name_their_methods_and_rates() -> None:
    said = {name: load_config(name).tracking for name in PRESETS}
    assert [tracking.method for tracking in said.values()] == ["disc", "disc", "blobs"]
    assert [tracking.rate_hz for tracking in said.values()] == [1_000.0, 10_000.0, 350.0]
    assert said["paper"].paper_law == PaperLawConfig(delta_px=4.0, gamma=0.7)
    assert [tracking.hysteresis for tracking in said.values()] == ["none", "none", "paper"]


def test_a_file_overrides_and_unknown_keys_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[tracking]\nrate_hz = 500\n[tracking.disc]\nshrink = 0.5\n")
    config = load_config(path)
    assert config.tracking.rate_hz == 500.0
    assert config.tracking.disc.shrink == 0.5
    for line, told in {
        "rate_hx = 500": "did you mean 'rate_hz'",
        "disc.shrink = -1.0": "shrink is -1, valid are 0 to 2",
        "rate_hz = 1e300": "rate_hz is 1e[+]300, valid are 0.1 to 1e[+]06",
        "disc.lag_us = 0.0": "unknown key 'lag_us'",  # which older versions knew
    }.items():
        path.write_text(f"[tracking]\n{line}\n")
        with pytest.raises(SettingsFileError, match=told):
            load_config(path)


def test_contact_detection_is_configured_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('[contact]\ndetector = "event_count"\nfalse_alarms_per_hour = 3\n')
    contact = load_config(path).contact
    assert (contact.detector, contact.false_alarms_per_hour) == ("event_count", 3.0)


@dataclass(frozen=True, kw_only=True)
class Inner:
    lag_us: int = field(default=900, metadata={"range": (0, 5000)})
    fixed: float = 2.0


@dataclass(frozen=True, kw_only=True)
class Outer:
    step_px: float = field(default=0.2, metadata={"range": (0.0, 1.0)})
    gain: float = field(default=1.0, metadata={"range": (0.5, 2.0), "unit": "x"})
    law: str = field(default="none", metadata={"choices": ("none", "paper")})
    clip: bool = field(default=True, metadata={"range": (0, 1)})
    inner: Inner = field(default_factory=Inner)


def test_controls_say_what_the_fields_say() -> None:
    made = {control.name: control for control in controls(Outer())}
    assert list(made) == ["step_px", "gain", "law", "clip", "inner.lag_us"]
    assert (made["step_px"].kind, made["step_px"].unit) == ("number", "px")
    assert made["step_px"].step == pytest.approx(0.005)
    assert made["gain"].unit == "x"
    assert made["law"].choices == ("none", "paper")
    assert made["clip"].kind == "switch"
    lag = made["inner.lag_us"]
    assert (lag.kind, lag.low, lag.high, lag.step, lag.unit) == ("whole", 0, 5000, 1, "µs")


def test_a_value_is_set_at_its_place_and_nowhere_else() -> None:
    before = Outer()
    after = with_value(before, "inner.lag_us", 1200.0)
    assert after.inner == Inner(lag_us=1200)
    assert isinstance(after.inner.lag_us, int)
    assert (after.step_px, before.inner.lag_us) == (before.step_px, 900)
    assert with_value(before, "law", "paper").law == "paper"
    assert with_value(before, "clip", False).clip is False


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("step_px", 1.01, "0 to 1"),
        ("step_px", True, "0 to 1"),
        ("step_px", float("nan"), "0 to 1"),
        ("step_px", "0.5", "0 to 1"),
        ("law", "papers", "none, paper"),
        ("clip", 1, "valid"),
        ("inner.fixed", 1.0, "cannot be tuned"),
        ("stp_px", 0.1, "did you mean 'step_px'"),
    ],
)
def test_what_does_not_fit_is_refused(name: str, value: object, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        with_value(Outer(), name, value)


@pytest.mark.parametrize("preset", PRESETS)
def test_every_control_takes_the_presets_own_value(preset: str) -> None:
    config = load_config(preset).tracking
    made = list(in_use(config))
    assert len(made) > 3
    for control in made:
        assert with_value(config, control.name, control.value) == config
