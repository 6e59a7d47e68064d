"""The settings of the twin's event camera, one table for each physical part, and the presets."""

from __future__ import annotations

import importlib.resources
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from spikingtac.errors import ConfigError, nearest
from spikingtac.schema import build, read_toml

CAMERA_NAMES = ("clean", "typical", "noisy")
"""The pinned presets, stored as ``configs/cameras/<name>.toml``."""
_STORED_NAMES = (*CAMERA_NAMES, "v2e")


def _require(valid: bool, what: str) -> None:
    if not valid:
        raise ValueError(what)


@dataclass(frozen=True, kw_only=True, slots=True)
class LightConfig:
    """How much light reaches a pixel; the brighter of marker and ground at the centre counts 1.

    Attributes:
        contrast: Marker over ground intensity; below 1 the markers are dark.
        blur_px: Standard deviation of the lens's blur; the pixel's own box adds 1/12 px^2.
        edge: ``gaussian`` (lens and pixel box) or ``logistic`` with ``blur_px`` as its scale, as
            other simulators paint discs.
        vignetting: Share of the light that is lost half a sensor's width from the centre; it
            grows with the square of the distance.
        stray: Veiling light everywhere, lowering the contrast.
        linear_below: Intensity under which the front end is linear instead of logarithmic.
        flicker_depth: Relative swing of a flickering LED; 0 is a steady one.
        flicker_hz: Its frequency.
        texture: Relative rms of a random pattern behind the markers, as in a clear gel.
        texture_px: Correlation length of that pattern: small is texture, large is shading.
        texture_follow: How far the pattern moves with the markers' mean displacement; 0 is still.
    """

    contrast: float = 6.0
    blur_px: float = 0.5
    edge: Literal["gaussian", "logistic"] = "gaussian"
    vignetting: float = 0.0
    stray: float = 0.0
    linear_below: float = 0.0
    flicker_depth: float = 0.0
    flicker_hz: float = 100.0
    texture: float = 0.0
    texture_px: float = 4.0
    texture_follow: float = 0.0

    def __post_init__(self) -> None:
        _require(self.contrast > 0, f"contrast is {self.contrast}, it must be positive")
        _require(self.blur_px > 0, f"blur_px is {self.blur_px}, it must be positive")
        _require(0 <= self.vignetting <= 0.45, "vignetting must lie between 0 and 0.45")
        _require(self.stray >= 0, f"stray is {self.stray}, it must not be negative")
        _require(0 <= self.linear_below < 1, "linear_below must lie in [0, 1)")
        _require(0 <= self.flicker_depth < 1, "flicker_depth must lie in [0, 1)")
        _require(self.flicker_hz > 0, "flicker_hz must be positive")
        _require(0 <= self.texture <= 0.5, "texture must lie between 0 and 0.5")
        _require(self.texture_px > 0, "texture_px must be positive")


@dataclass(frozen=True, kw_only=True, slots=True)
class PixelConfig:
    """One pixel: photoreceptor, change detector, comparators.

    Attributes:
        threshold_on: Log-intensity step of an ON event.
        threshold_off: Log-intensity step of an OFF event.
        mismatch: Standard deviation of both thresholds from pixel to pixel.
        bandwidth_hz: Corner of the photoreceptor at intensity 1, proportional to intensity; None
            follows the light at once.
        dark: Intensity equivalent of the dark current, added in the bandwidth only.
        high_pass_hz: Corner of the optional high-pass, 0 is off.
        noise: Standard deviation (log) of band-limited photoreceptor noise, 0 is off.
        leak_hz: Rate of the ON events that the leaking reference makes at rest.
        leak_spread: Standard deviation of log10 of that rate from pixel to pixel.
        leak_jitter: Relative spread of the rate, drawn anew after each event.
        refractory_us: Dead time after an event; the reference is taken at its end.
        latency_us: Delay of an event at intensity 1, inversely proportional to intensity.
        jitter_us: Standard deviation of that delay.
    """

    threshold_on: float = 0.25
    threshold_off: float = 0.25
    mismatch: float = 0.0
    bandwidth_hz: float | None = None
    dark: float = 0.0
    high_pass_hz: float = 0.0
    noise: float = 0.0
    leak_hz: float = 0.0
    leak_spread: float = 0.1
    leak_jitter: float = 0.1
    refractory_us: float = 0.0
    latency_us: float = 0.0
    jitter_us: float = 0.0

    def __post_init__(self) -> None:
        low = min(self.threshold_on, self.threshold_off)
        _require(low >= 0.02, f"the thresholds must be at least 0.02, got {low}")
        bandwidth = self.bandwidth_hz
        _require(bandwidth is None or bandwidth > 0, "bandwidth_hz must be positive")
        for name in ("mismatch", "dark", "high_pass_hz", "noise", "leak_hz", "leak_spread",
                     "leak_jitter", "refractory_us", "latency_us", "jitter_us"):  # fmt: skip
            value = getattr(self, name)
            _require(value >= 0, f"{name} is {value}, it must not be negative")


@dataclass(frozen=True, kw_only=True, slots=True)
class BackgroundConfig:
    """Events without a cause on the skin.

    Attributes:
        rate_hz: Mean background rate of a pixel, Poisson; a pixel's polarities alternate.
        hot_fraction: Share of the array that is hot.
        hot_min_hz: Lowest rate of a hot pixel.
        hot_max_hz: Highest rate; rates are log-uniform in between.
    """

    rate_hz: float = 0.0
    hot_fraction: float = 0.0
    hot_min_hz: float = 10.0
    hot_max_hz: float = 500.0

    def __post_init__(self) -> None:
        _require(self.rate_hz >= 0, "rate_hz must not be negative")
        _require(0 <= self.hot_fraction <= 1, "hot_fraction must lie between 0 and 1")
        _require(0 < self.hot_min_hz <= self.hot_max_hz, "hot_min_hz must not exceed hot_max_hz")


@dataclass(frozen=True, kw_only=True, slots=True)
class ReadoutConfig:
    """The way out of the chip.

    Attributes:
        cap_mev_s: Most events a second, millions; None is unlimited.
        row_us: Time to switch to another row.
        backlog_us: Longest wait for the arbiter; events beyond it are dropped and counted.
        loss: Share of all events lost at random behind the arbiter (bus or driver).
    """

    cap_mev_s: float | None = None
    row_us: float = 0.0
    backlog_us: float = 1000.0
    loss: float = 0.0

    def __post_init__(self) -> None:
        _require(self.cap_mev_s is None or self.cap_mev_s > 0, "cap_mev_s must be positive")
        _require(self.row_us >= 0, "row_us must not be negative")
        _require(self.backlog_us > 0, "backlog_us must be positive")
        _require(0 <= self.loss < 1, f"loss is {self.loss}, it must lie in [0, 1)")


@dataclass(frozen=True, kw_only=True, slots=True)
class StepConfig:
    """How finely a motion between two images is rendered.

    Attributes:
        motion_px: Longest way of a marker's edge in one step.
        min_us: Shortest step; faster motions move further in it.
        max_us: Longest step of a moving marker (light moves evenly in it: at 155 px/s, 1 and 2 ms
            differ by less than 0.001 px).
        still_px: A marker that moved less since it was last rendered is left as it is.
    """

    motion_px: float = 0.1
    min_us: float = 20.0
    max_us: float = 2000.0
    still_px: float = 0.001

    def __post_init__(self) -> None:
        _require(self.motion_px > 0, "motion_px must be positive")
        _require(0 < self.min_us <= self.max_us, "min_us must be positive and at most max_us")
        _require(self.still_px >= 0, "still_px must not be negative")


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraConfig:
    """The event camera: light, pixel, background, readout and the rendering's steps.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        light: What reaches the pixels.
        pixel: What a pixel makes of it.
        background: Events without a cause.
        readout: The way out.
        steps: How finely motion is rendered.
    """

    size: tuple[int, int] = (320, 320)
    light: LightConfig = field(default_factory=LightConfig)
    pixel: PixelConfig = field(default_factory=PixelConfig)
    background: BackgroundConfig = field(default_factory=BackgroundConfig)
    readout: ReadoutConfig = field(default_factory=ReadoutConfig)
    steps: StepConfig = field(default_factory=StepConfig)

    def __post_init__(self) -> None:
        _require(min(self.size) >= 1, f"size is {self.size}, both numbers must be positive")
        _require(self.size[0] * self.size[1] <= 1 << 22, "the sensor exceeds 4 million pixels")


def load_camera(name: str | Path) -> CameraConfig:
    """Return a camera by name, or from a TOML file.

    Args:
        name: A preset (:data:`CAMERA_NAMES`); ``v2e``, the emulator whose recordings the twin is
            compared with; or a path.

    Raises:
        ConfigError: The name is unknown, or the file does not fit; names the valid values.
    """
    if str(name) in _STORED_NAMES:
        path = importlib.resources.files("spikingtac") / "configs" / "cameras" / f"{name}.toml"
        return build(CameraConfig, read_toml(Path(str(path))), f"camera {name}")
    if not Path(name).is_file():
        raise ConfigError(
            f"no camera {str(name)!r}{nearest(str(name), _STORED_NAMES)} "
            f"(valid: {', '.join(_STORED_NAMES)}, or the path of a TOML file)"
        )
    return build(CameraConfig, read_toml(name), str(name))
