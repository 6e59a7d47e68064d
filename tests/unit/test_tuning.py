from dataclasses import dataclass, field

import pytest

from spikingtac.config import PRESETS, load_config
from spikingtac.denoise.classical import DENOISERS
from spikingtac.errors import ConfigError
from spikingtac.tuning import controls, in_use, with_value


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


def test_the_denoisers_to_choose_from_are_those_of_the_registry() -> None:
    made = {control.name: control for control in controls(load_config("paper").tracking)}
    assert made["denoiser"].choices == tuple(DENOISERS)
    assert made["denoiser"].value == "network-int8"
