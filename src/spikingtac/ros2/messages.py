"""What is measured as ROS 2 messages: plain mappings, for MCAP files and for the wire."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.events.evt.encode import Evt3Encoder
from spikingtac.types import EventPacket, MarkerFrame

NS_PER_S, NS_PER_US = 1_000_000_000, 1_000
FRAME_ID = "tactile_sensor"

# A marker: rest position in mm about the image's centre (px where the scale is unknown), position
# u, v and displacement du, dv in px, and 1 where it was seen.
FIELD = np.dtype([(name, "<f4") for name in ("x", "y", "z", "u", "v", "du", "dv", "valid")])
MM_PER_M = 1_000.0
DRAWN_MM_PER_PX = 0.1  # Scale of the arrows in RViz where none is known (ours).
FLOAT32 = 7  # Datatype code of a PointField.
LINE_LIST = 5  # Kind of a Marker: a line for each two points.
LINE_MM = 0.08  # Width of an arrow's line (ours).


@dataclass(frozen=True, slots=True)
class Layout:
    """The markers at rest, and how they are laid out.

    Attributes:
        reference_px: ``(m, 2)`` rest positions, px.
        grid: Rows and columns; their product is m. Markers without rows are one row.
        centre_px: ``(x, y)`` of the image's centre, px.
        px_per_mm: Scale, None where it is unknown.
        size_px: Width and height of the image, None where they are unknown.
    """

    reference_px: NDArray[np.floating]
    grid: tuple[int, int]
    centre_px: tuple[float, float]
    px_per_mm: float | None
    size_px: tuple[int, int] | None = None

    @classmethod
    def of_image(
        cls,
        reference_px: NDArray[np.floating],
        grid: tuple[int, int] | None,
        size: tuple[int, int],
        px_per_mm: float | None,
    ) -> Layout:
        """Return the layout in an image of ``size`` (width, height), px."""
        centre_px = ((size[0] - 1) / 2, (size[1] - 1) / 2)
        rows = grid or (1, len(reference_px))
        return cls(reference_px, rows, centre_px, px_per_mm, (int(size[0]), int(size[1])))

    @property
    def about_centre_px(self) -> NDArray[np.floating]:
        """``(m, 2)`` rest positions about the image's centre, px."""
        return self.reference_px - np.array(self.centre_px)


def header(t_ns: int) -> dict[str, Any]:
    """Return a header with a time, ns."""
    stamp = {"sec": t_ns // NS_PER_S, "nanosec": t_ns % NS_PER_S}
    return {"stamp": stamp, "frame_id": FRAME_ID}


def field_message(frame: MarkerFrame, layout: Layout) -> dict[str, Any]:
    """Return the displacement field of a frame as a PointCloud2, without header."""
    cloud = np.zeros(len(frame.coasted), FIELD)
    rest = layout.about_centre_px / (layout.px_per_mm or 1.0)
    cloud["x"], cloud["y"] = rest.T
    cloud["u"], cloud["v"] = frame.position_px.T
    cloud["du"], cloud["dv"] = frame.displacement_px.T
    cloud["valid"] = ~frame.coasted
    return {
        "height": layout.grid[0],
        "width": layout.grid[1],
        "fields": POINT_FIELDS,
        "is_bigendian": False,
        "point_step": FIELD.itemsize,
        "row_step": FIELD.itemsize * layout.grid[1],
        "data": cloud.tobytes(),
        "is_dense": True,
    }


POINT_FIELDS = [
    {"name": name, "offset": 4 * index, "datatype": FLOAT32, "count": 1}
    for index, name in enumerate(FIELD.names or ())
]


def arrows_message(frame: MarkerFrame, layout: Layout, t_ns: int) -> dict[str, Any]:
    """Return the displacements as lines from rest to place, in metres, as a MarkerArray."""
    px_per_m = (layout.px_per_mm or 1.0 / DRAWN_MM_PER_PX) * MM_PER_M
    rest = layout.about_centre_px / px_per_m
    ends = np.stack((rest, rest + frame.displacement_px / px_per_m), axis=1).reshape(-1, 2)
    seen = np.repeat(~frame.coasted, 2)
    lines = {
        "header": header(t_ns),
        "ns": "displacement",
        "type": LINE_LIST,
        "pose": {"orientation": {"w": 1.0}},
        "scale": {"x": LINE_MM / MM_PER_M},
        "color": {"r": 1.0, "g": 0.6, "b": 0.0, "a": 1.0},
        "points": [{"x": x, "y": y} for x, y in ends[seen].tolist()],
    }
    return {"markers": [lines]}


def wrench_message(values: NDArray[np.floating]) -> dict[str, Any]:
    """Return forces (N) and moments (Nm) as a WrenchStamped, without header."""
    names = ("x", "y", "z")
    force = dict(zip(names, values[:3].tolist(), strict=False))
    torque = dict(zip(names, values[3:6].tolist(), strict=False))
    return {"wrench": {"force": force, "torque": torque}}


def camera_info_message(layout: Layout, distance_mm: float | None = None) -> dict[str, Any]:
    """Return what is known of the camera as a CameraInfo, without header.

    The lens was never calibrated: its distortion has neither model nor coefficients. A scale at the
    skin and the distance of the skin give the focal length (that of a pinhole, px); without them
    the matrices are zero, which is what the message asks for where a camera is not calibrated.

    Args:
        layout: The markers, with the size of the image.
        distance_mm: From the lens (its entrance pupil) to the skin.

    Raises:
        ConfigError: The size is unknown, or the distance is given where the scale is unknown.
    """
    if layout.size_px is None:
        raise ConfigError("the size of the image is unknown: give the sensor's calibration")
    info: dict[str, Any] = {"height": layout.size_px[1], "width": layout.size_px[0]}
    if distance_mm is None:
        return info
    if layout.px_per_mm is None:
        raise ConfigError(
            "a distance gives the focal length where the scale is known; calibrate with --pitch-mm"
        )
    focal_px, (x, y) = layout.px_per_mm * distance_mm, layout.centre_px
    k = [focal_px, 0.0, x, 0.0, focal_px, y, 0.0, 0.0, 1.0]
    p = [*k[0:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0]
    return info | {"k": k, "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "p": p}


def events_message(packet: EventPacket, encoder: Evt3Encoder, origin_us: int) -> dict[str, Any]:
    """Return events as an EventPacket, without header and number.

    Args:
        packet: The events.
        encoder: One for the whole stream: its words refer to earlier ones.
        origin_us: Time of the stream's beginning, us.
    """
    words = encoder.encode(packet.t - origin_us, packet.x, packet.y, packet.p)
    return {
        "height": packet.size[1],
        "width": packet.size[0],
        "time_base": origin_us * NS_PER_US,
        "encoding": "evt3",
        "is_bigendian": False,
        "events": words.astype("<u2").tobytes(),
    }


def diagnostics_message(
    hardware: str, coasted: int, figures: Mapping[str, float]
) -> dict[str, Any]:
    """Return a DiagnosticArray, without header.

    Args:
        hardware: The sensor.
        coasted: Number of markers that were not seen.
        figures: What else is told, by name.
    """
    status = {
        "level": 1 if coasted else 0,
        "name": "spikingtac: tracking",
        "message": f"{coasted} markers held" if coasted else "all markers seen",
        "hardware_id": hardware,
        "values": [{"key": key, "value": f"{value:g}"} for key, value in figures.items()],
    }
    return {"status": [status]}
