"""The kinds of cameras by the name in their address, each with where its file is.

A kind is imported when it is asked for, as those that other packages register under the entry
point group ``spikingtac.cameras`` are: naming and listing loads no camera's library.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module

from spikingtac import plugins
from spikingtac.errors import named
from spikingtac.events.address import Address
from spikingtac.events.cameras.camera import Camera
from spikingtac.plugins import with_plugins


@dataclass(frozen=True, kw_only=True)
class CameraKind:
    """One way in which cameras are reached.

    Attributes:
        place: ``module:class`` of the camera.
        example: An address, for help and errors.
        about: What it reads, in a few words.
        module: Module of the library that it needs; empty where the plain installation suffices.
        extra: Extra of this package that brings that library; empty where none can.
    """

    place: str
    example: str
    about: str
    module: str = ""
    extra: str = ""


# Kind -> what it is; those of other packages are not listed.
KINDS: dict[str, CameraKind] = {
    "openmv": CameraKind(
        place="spikingtac.cameras.openmv:OpenMvCamera",
        example="openmv:/dev/ttyACM0",
        about="GenX320 on an OpenMV board (firmware 5.0 or later)",
        module="openmv",
        extra="openmv",
    ),
    "prophesee": CameraKind(
        place="spikingtac.cameras.prophesee:PropheseeCamera",
        example="prophesee:",
        about="EVK kits and GenX320 through OpenEB",
        module="metavision_hal",
    ),
    "v4l2": CameraKind(
        place="spikingtac.cameras.v4l2:V4l2Camera",
        example="v4l2:/dev/video0?encoding=evt21",
        about="GenX320 on a Raspberry Pi, through its kernel driver, or a dump of its frames",
    ),
    "udp": CameraKind(
        place="spikingtac.cameras.udp:UdpCamera",
        example="udp:7777?encoding=evt2&size=320x320",
        about="EVT words in datagrams, as an STM32 board sends them",
    ),
    "serial": CameraKind(
        place="spikingtac.cameras.serial_port:SerialCamera",
        example="serial:/dev/ttyACM0?encoding=evt2&size=320x320",
        about="EVT words over a serial port",
    ),
    "dv": CameraKind(
        place="spikingtac.cameras.dv:DvCamera",
        example="dv://127.0.0.1:7777",
        about="DVXplorer and DAVIS (dv:), or a network stream of dv-processing",
        module="dv_processing",
        extra="dv",
    ),
    "nd": CameraKind(
        place="spikingtac.cameras.neuromorphic:NeuromorphicCamera",
        example="nd:",
        about="EVK3 HD, EVK4, DVXplorer and DAVIS346 through neuromorphic-drivers",
        module="neuromorphic_drivers",
        extra="neuromorphic",
    ),
    "aestream": CameraKind(
        place="spikingtac.cameras.aestream:AestreamCamera",
        example="aestream:3333?size=346x260",
        about="the datagrams of AEStream and SPIF boards",
    ),
    "pipe": CameraKind(
        place="spikingtac.cameras.pipe:PipeCamera",
        example="pipe:live.raw",
        about="RAW from a named pipe, or standard input as pipe:-",
    ),
    "ring": CameraKind(
        place="spikingtac.stream.attached:RingCamera",
        example="ring:press",
        about="what another process reads, under an address with share=press",
    ),
    "twin": CameraKind(
        place="spikingtac.sim.twin_camera:TwinCamera",
        example="twin:finger-torsion",
        about="a scene of the digital twin in real time (simulated)",
    ),
}


def open_camera(address: Address) -> Camera:
    """Open the camera of an address.

    Raises:
        ConfigError: The kind is unknown, or the address does not fit it.
        MissingExtraError: Its library is not installed.
        DeviceError: There is no such camera, or it refuses.
    """
    camera = named(with_plugins(_classes(), plugins.CAMERAS), address.kind, "kind of camera")
    chosen = import_camera(camera) if isinstance(camera, str) else camera
    address.require_options((*chosen.OPTIONS, *SOURCE_OPTIONS))
    return chosen.open(address)


# Options of every address: what the source itself understands.
SOURCE_OPTIONS = ("seconds", "share")


def _classes() -> dict[str, str | type[Camera]]:
    return {name: kind.place for name, kind in KINDS.items()}


def import_camera(place: str) -> type[Camera]:
    """Return the class at ``module:class``."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)
