"""Settings of the simulated event camera, with one table for each physical part, and presets."""

from __future__ import annotations

import importlib.resources
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from spikingtac.errors import ConfigError, nearest
from spikingtac.schema import build, read_toml

CAMERA_NAMES = ("clean", "typical", "noisy")
"""The pinned presets, stored as ``configs/cameras/<name>.toml``."""
_STORED_NAMES = (*CAMERA_NAMES, "v2e", "real-like")


def _require(valid: bool, what: str) -> None:
    if not valid:
        raise ValueError(what)


@dataclass(frozen=True, kw_only=True, slots=True)
class LightConfig:
    """Light on a pixel. The brighter of marker and ground has intensity 1 at the sensor's centre.

    Attributes:
        contrast: Marker intensity divided by ground intensity. Below 1 the markers are dark.
        blur_px: Standard deviation of the lens blur, px. The square pixel adds a variance of 1/12
            px^2.
        edge: Profile of a disc's edge: ``gaussian`` (lens and square pixel), or ``logistic`` with
            ``blur_px`` as its scale, as other simulators draw discs.
        vignetting: Fraction of the light that is lost at half a sensor width from the centre. The
            loss grows with the square of the distance.
        stray: Stray (veiling) light at every pixel, as an intensity. It lowers the contrast.
        linear_below: Intensity below which the front end is linear instead of logarithmic.
        flicker_depth: Relative amplitude of a flickering lamp; 0 is a steady lamp.
        flicker_hz: Frequency of the flicker, Hz.
        texture: Relative rms of a random pattern behind the markers, as in a clear gel.
        texture_px: Correlation length of that pattern, px. A small value gives texture, a large one
            shading.
        texture_follow: Displacement of the pattern divided by the mean displacement of the markers;
            0 is a fixed pattern.
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
    """One pixel: photoreceptor, change detector and comparators.

    Attributes:
        threshold_on: Step of log intensity that causes an ON event.
        threshold_off: Step of log intensity that causes an OFF event.
        mismatch: Standard deviation of both thresholds from pixel to pixel, in log intensity.
        bandwidth_hz: Corner frequency of the photoreceptor at intensity 1, Hz. It is proportional
            to intensity. None is an infinite bandwidth.
        dark: Dark current as an equivalent intensity. It raises the bandwidth only.
        high_pass_hz: Corner frequency of the optional high-pass filter, Hz; 0 switches it off.
        noise: Standard deviation of band-limited photoreceptor noise, in log intensity; 0 switches
            it off.
        leak_hz: Rate of the ON events that the leak of the reference causes at rest, Hz.
        leak_spread: Standard deviation of the decimal logarithm of that rate from pixel to pixel.
        leak_jitter: Relative standard deviation of the rate, drawn anew after each event.
        refractory_us: Dead time after an event, us. The reference is sampled at its end.
        latency_us: Delay of an event at intensity 1, us. It is inversely proportional to intensity.
        jitter_us: Standard deviation of that delay, us.
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
    """Background activity: events that no motion causes.

    Attributes:
        rate_hz: Mean background rate of one pixel, Hz. The events are a Poisson process and the
            polarities of a pixel alternate.
        hot_fraction: Fraction of the pixels that are hot.
        hot_min_hz: Lowest rate of a hot pixel, Hz.
        hot_max_hz: Highest rate of a hot pixel, Hz. The rates are log-uniform in between.
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
    """The readout: rate limit of the arbiter, and losses.

    Attributes:
        cap_mev_s: Largest event rate, million events per second; None is unlimited.
        row_us: Time to switch to another row, us.
        backlog_us: Longest wait for the arbiter, us. Events that would wait longer are dropped and
            counted.
        loss: Fraction of all events that are lost at random behind the arbiter (bus or driver).
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
    """Time steps in which the motion between two images is rendered.

    Attributes:
        motion_px: Longest travel of a marker's edge in one step, px.
        min_us: Shortest step, us. Faster motions travel further in one step.
        max_us: Longest step of a moving marker, us. The light moves evenly within a step; at 155
            px/s, steps of 1 and 2 ms differ by less than 0.001 px.
        still_px: A marker is not rendered again until it has moved by more than this, px.
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
    """The event camera: light, pixel, background, readout and the steps of rendering.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        light: Light that reaches the pixels.
        pixel: Response of a pixel.
        background: Events that no motion causes.
        readout: Rate limit and losses of the readout.
        steps: Time steps of rendering.
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
        name: A preset (:data:`CAMERA_NAMES`), ``v2e`` (the emulator with which the simulated camera
            is compared), or the path of a TOML file.

    Raises:
        ConfigError: The name is unknown, or the file does not fit. The message names the valid
            values.
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
