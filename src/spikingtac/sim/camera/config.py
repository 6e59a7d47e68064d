"""Settings of the simulated event camera, with one table for each physical part, and presets."""

import importlib.resources
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from spikingtac.schema import from_toml, require_within, stored_file

CONFIGS = Path(str(importlib.resources.files("spikingtac") / "configs"))

# The pinned presets, stored as ``configs/cameras/<name>.toml``.
CAMERA_NAMES = ("clean", "typical", "noisy")

_STORED_NAMES = (*CAMERA_NAMES, "v2e", "real-like")


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
        linear_below: Intensity below which the front end is linear instead of logarithmic. It also
            adds to the light that sets the bandwidth, as in the emulator v2e.
        texture: Relative rms of a fixed random pattern behind the markers.
    """

    contrast: float = 6.0
    blur_px: float = 0.5
    edge: Literal["gaussian", "logistic"] = "gaussian"
    vignetting: float = 0.0
    stray: float = 0.0
    linear_below: float = 0.0
    texture: float = 0.0

    def __post_init__(self) -> None:
        require_within(self, contrast=(1e-3, 1e3), blur_px=(0.05, 20.0), vignetting=(0.0, 0.45))
        require_within(self, stray=(0.0, 100.0), linear_below=(0.0, 0.99), texture=(0.0, 0.5))


@dataclass(frozen=True, kw_only=True, slots=True)
class PixelConfig:
    """One pixel: photoreceptor, change detector and comparators.

    Attributes:
        threshold_on: Step of log intensity that causes an ON event.
        threshold_off: Step of log intensity that causes an OFF event.
        mismatch: Standard deviation of both thresholds from pixel to pixel, in log intensity.
        bandwidth_hz: Corner frequency of the photoreceptor at intensity 1, Hz. It is proportional
            to intensity. None is an infinite bandwidth.
        leak_hz: Rate of the ON events that the leak of the reference causes at rest, Hz.
        refractory_us: Dead time after an event, us. The reference is sampled at its end.
        latency_us: Delay of an event at intensity 1, us. It is inversely proportional to intensity.
        jitter_us: Standard deviation of that delay, us.
    """

    threshold_on: float = 0.25
    threshold_off: float = 0.25
    mismatch: float = 0.0
    bandwidth_hz: float | None = None
    leak_hz: float = 0.0
    refractory_us: float = 0.0
    latency_us: float = 0.0
    jitter_us: float = 0.0

    def __post_init__(self) -> None:
        require_within(self, threshold_on=(0.02, 10.0), threshold_off=(0.02, 10.0))
        require_within(self, mismatch=(0.0, 1.0), bandwidth_hz=(1e-3, 1e7), leak_hz=(0.0, 1e4))
        require_within(self, refractory_us=(0.0, 1e6), latency_us=(0.0, 1e6), jitter_us=(0.0, 1e5))


@dataclass(frozen=True, kw_only=True, slots=True)
class BackgroundConfig:
    """Background activity: events that no motion causes.

    Attributes:
        rate_hz: Mean background rate of one pixel, Hz. The events are a Poisson process and the
            polarities of a pixel alternate.
        hot_fraction: Fraction of the pixels that are hot.
    """

    rate_hz: float = 0.0
    hot_fraction: float = 0.0

    def __post_init__(self) -> None:
        require_within(self, rate_hz=(0.0, 1e4), hot_fraction=(0.0, 1.0))


@dataclass(frozen=True, kw_only=True, slots=True)
class ReadoutConfig:
    """The readout: rate limit of the arbiter, and losses.

    Attributes:
        cap_mev_s: Largest event rate, million events per second; None is unlimited.
        loss: Fraction of all events that are lost at random behind the arbiter (bus or driver).
    """

    cap_mev_s: float | None = None
    loss: float = 0.0

    def __post_init__(self) -> None:
        require_within(self, cap_mev_s=(1e-3, 1e4), loss=(0.0, 0.999))


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraConfig:
    """The event camera: light, pixel, background and readout.

    Attributes:
        light: Light that reaches the pixels.
        pixel: Response of a pixel.
        background: Events that no motion causes.
        readout: Rate limit and losses of the readout.
    """

    light: LightConfig = field(default_factory=LightConfig)
    pixel: PixelConfig = field(default_factory=PixelConfig)
    background: BackgroundConfig = field(default_factory=BackgroundConfig)
    readout: ReadoutConfig = field(default_factory=ReadoutConfig)


def load_camera(name: str | Path) -> CameraConfig:
    """Return a camera by name, or from a TOML file.

    Args:
        name: A preset (:data:`CAMERA_NAMES`), ``v2e`` (the emulator with which the simulated camera
            is compared), or the path of a TOML file.

    Raises:
        ConfigError: The name is unknown, or the file does not fit. The message names the valid
            values.
    """
    return from_toml(CameraConfig, stored_file(name, CONFIGS / "cameras", _STORED_NAMES, "camera"))
