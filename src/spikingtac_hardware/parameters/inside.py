"""What the housing holds: skin, window, event sensor, lens, boards and light."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from spikingtac_hardware.parameters.housing import OutlineKind
from spikingtac_hardware.parameters.valid import require_positive

Paint = Literal["white", "dark"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Skin:
    """The clear gel, the discs on it and the opaque cover over them.

    Attributes:
        outline: ``rectangle`` or ``round``, as in the housing.
        size_mm: ``(width, depth)`` of the sensing area, mm.
        grid: ``(rows, columns)`` of discs.
        pitch_mm: Distance of neighbouring discs, mm.
        disc_diameter_mm: Diameter of a disc, mm.
        paint: ``white`` discs under a dark cover, or ``dark`` ones under a light cover.
        contrast: Light from the brighter of the two over that from the darker one.
        gel_mm: Thickness of the clear gel, mm.
        cover_mm: Thickness of the opaque cover, mm.
        gel_index: Refractive index of the gel.
        bright_reflectance: Share of the light that the brighter of the two sends back, 0 to 1.
        deepest_press_mm: Deepest indentation that must stay sharp, mm.
    """

    outline: OutlineKind
    size_mm: tuple[float, float]
    grid: tuple[int, int]
    pitch_mm: float
    disc_diameter_mm: float
    paint: Paint
    contrast: float
    gel_mm: float
    cover_mm: float
    gel_index: float
    bright_reflectance: float
    deepest_press_mm: float

    def __post_init__(self) -> None:
        require_positive(self)
        if self.outline == "round" and self.size_mm[0] != self.size_mm[1]:
            raise ValueError(f"size_mm is {list(self.size_mm)}: a round one has one diameter twice")
        for name, least in (("contrast", 1.0), ("gel_index", 1.0)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} is {getattr(self, name)}, it must be at least {least:g}")


@dataclass(frozen=True, kw_only=True, slots=True)
class Window:
    """The acrylic window that carries the gel.

    Attributes:
        thickness_mm: Thickness, mm.
        index: Refractive index.
        clearance_mm: Gap to the shell, mm on each side.
    """

    thickness_mm: float
    index: float
    clearance_mm: float

    def __post_init__(self) -> None:
        require_positive(self)
        if self.index < 1:
            raise ValueError(f"index is {self.index}, it must be at least 1")


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensor:
    """The event sensor.

    Attributes:
        name: Its name.
        pixels: ``(width, height)``, px; a smaller region of interest may be given.
        pixel_um: Distance of neighbouring pixels, um.
        package_mm: ``(width, depth, height)`` of the package, mm.
        image_plane_mm: Height of the pixels above the board, mm.
        power_mw: Power of the sensor and its regulators, mW.
        cost_usd: Price, dollars.
    """

    name: str
    pixels: tuple[int, int]
    pixel_um: float
    package_mm: tuple[float, float, float]
    image_plane_mm: float
    power_mw: float
    cost_usd: float

    def __post_init__(self) -> None:
        require_positive(self)

    @property
    def size_mm(self) -> tuple[float, float]:
        """``(width, height)`` of the pixels' area, mm."""
        width, height = self.pixels
        return width * self.pixel_um / 1000.0, height * self.pixel_um / 1000.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Lens:
    """The lens, as its data sheet describes it.

    Attributes:
        name: Its name.
        focal_mm: Focal length, mm.
        f_number: Focal length over the diameter of the entrance pupil.
        track_mm: Distance from the front vertex to the image, mm.
        pupil_mm: Distance of the entrance pupil behind the front vertex, mm.
        barrel_mm: Diameter of the barrel, mm.
        image_circle_mm: Diameter of the image circle, mm.
        half_angle_deg: Half the largest field of view, degrees.
        distortion: Optical distortion at ``distortion_angle_deg``, as a fraction; a barrel's is
            negative.
        distortion_angle_deg: View angle at which it is given, degrees from the axis.
        corner_light: Relative illumination at the corner of the image, 0 to 1.
        cost_usd: Price, dollars.
    """

    name: str
    focal_mm: float
    f_number: float
    track_mm: float
    pupil_mm: float
    barrel_mm: float
    image_circle_mm: float
    half_angle_deg: float
    distortion: float
    distortion_angle_deg: float
    corner_light: float
    cost_usd: float

    def __post_init__(self) -> None:
        require_positive(self, signed=("distortion",))
        for name in ("half_angle_deg", "distortion_angle_deg"):
            if getattr(self, name) >= 90:
                raise ValueError(f"{name} is {getattr(self, name)}, it must be below 90")

    @property
    def k1(self) -> float:
        """Brown's first radial coefficient in the tangent of the view angle, in air."""
        return self.distortion / math.tan(math.radians(self.distortion_angle_deg)) ** 2


@dataclass(frozen=True, kw_only=True, slots=True)
class Board:
    """The camera board and the lens holder on it.

    Attributes:
        size_mm: ``(width, depth)``, mm.
        chamfer_mm: Cut corners, mm along each edge.
        thickness_mm: Thickness, mm.
        below_mm: Height of the parts under the board, mm.
        holder_mm: Width and height of the square lens holder, mm.
        cost_usd: Price with its parts except the sensor, dollars.
    """

    size_mm: tuple[float, float]
    chamfer_mm: float
    thickness_mm: float
    below_mm: float
    holder_mm: tuple[float, float]
    cost_usd: float

    def __post_init__(self) -> None:
        require_positive(self)


@dataclass(frozen=True, kw_only=True, slots=True)
class Light:
    """LEDs about the lens, each with its own constant current.

    Attributes:
        leds: Number; a multiple of four.
        place_mm: Distance of the LEDs of the front and back from the axis, mm.
        spread_mm: Distance of their outermost LED from the middle of the side, mm. Where the
            housing is not square, the left and right sides follow.
        led_mm: ``(length, width, height)`` of an LED, mm.
        board_mm: Thickness of their board, mm.
        current_ma: Current of each, mA.
        rated_ma: Current at which ``intensity_mcd`` is given, mA.
        intensity_mcd: Luminous intensity on the axis of an LED at the rated current, mcd.
        forward_v: Forward voltage at ``current_ma``, V.
        supply_v: Supply of the driver, V.
        cost_usd: Price of board, LEDs and driver, dollars.
    """

    leds: int
    place_mm: float
    spread_mm: float
    led_mm: tuple[float, float, float]
    board_mm: float
    current_ma: float
    rated_ma: float
    intensity_mcd: float
    forward_v: float
    supply_v: float
    cost_usd: float

    def __post_init__(self) -> None:
        require_positive(self)
        if self.leds % 4:
            raise ValueError(
                f"leds is {self.leds}, it must be a multiple of 4: as many on each side"
            )
