"""The one protocol for every camera, and the kinds of cameras by the name in their address.

Opening, counting, reconnecting and packing are the same for all and stand in
:mod:`spikingtac.events.camera_source`; a camera's own file says only how its bytes become columns.
Other packages register kinds under the entry point group ``spikingtac.cameras``.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Self

from numpy.typing import NDArray

from spikingtac import plugins
from spikingtac.errors import named
from spikingtac.events.address import Address
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.packing import NO_ROWS, Rows
from spikingtac.plugins import import_place, with_plugins
from spikingtac.types import LossCounters


class Camera(ABC):
    """One open camera.

    Attributes:
        OPTIONS: Names of the options that its address may carry.
        size: ``(width, height)`` of the sensor, px.
        format: Name of the format of its bytes, where they are a file's; empty of a camera.
        checked: Whether the columns come checked (in order, on the sensor, of the package's types).
        losses: What was lost or mended, by kind (``codec.KINDS``); the camera counts into it.
        triggers: Trigger edges met so far.
        take_truth: Called with growing arrays of ``truth.npz`` by a simulation, which knows them.
    """

    OPTIONS: ClassVar[tuple[str, ...]] = ()
    size: tuple[int, int]
    format: str = ""
    checked: bool = False

    def __init__(self) -> None:
        self.losses = LossCounters()
        self.triggers = Triggers()
        self.take_truth: Callable[[Mapping[str, NDArray[Any]]], None] = lambda rows: None

    @classmethod
    @abstractmethod
    def open(cls, address: Address) -> Self:
        """Open the camera and start it.

        Raises:
            ConfigError: The address does not fit this kind of camera.
            MissingExtraError: Its library is not installed; names what brings it.
            DeviceError: There is no such camera, or it refuses; says what to do.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> Rows | None:
        """Return the columns x, y, p and t (us) of what has come, after waiting if nothing has.

        The columns may be views of buffers that the next call overwrites.

        Args:
            timeout_s: Longest wait, s; then the columns are empty.

        Returns:
            None once the camera has ended by itself, as a pipe does whose writer has left.

        Raises:
            CameraLostError: The camera is gone.
            RecordingError: Its words cannot be read.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop the camera and release it; further calls do nothing."""

    def describe(self) -> dict[str, Any]:
        """Return what is known of it for the manifest: model, serial, encoding, library ..."""
        return {}

    def biases(self) -> dict[str, int]:
        """Return its biases by the maker's names; empty where it has none that can be read."""
        return {}

    def roi(self) -> list[list[int]]:
        """Return ``[x, y, width, height]`` of each window that sends, px; empty if not told."""
        return []

    def truth(self) -> Mapping[str, NDArray[Any]]:
        """Return the arrays of ``truth.npz`` that do not grow; a simulation alone knows any."""
        return {}

    def manifest(self) -> dict[str, Any]:
        """Return fields for the manifest itself, beside those of :meth:`describe`."""
        return {}

    @staticmethod
    def nothing() -> Rows:
        """Return the columns of no event."""
        return NO_ROWS


class CameraKind(NamedTuple):
    """One way in which cameras are reached.

    Attributes:
        place: ``module:class`` of the camera, within this package.
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


# Kind -> what it is; those of other packages are not listed. A kind is imported when it is asked
# for: naming and listing loads no camera's library.
KINDS = {
    "openmv": CameraKind(
        "cameras.openmv:OpenMvCamera", "openmv:/dev/ttyACM0",
        "GenX320 on an OpenMV board (firmware 5.0 or later)", "openmv", "openmv"),
    "prophesee": CameraKind(
        "cameras.makers:PropheseeCamera", "prophesee:",
        "EVK kits and GenX320 through OpenEB", "metavision_hal"),
    "v4l2": CameraKind(
        "cameras.v4l2:V4l2Camera", "v4l2:/dev/video0?encoding=evt21",
        "GenX320 on a Raspberry Pi, through its kernel driver, or a dump of its frames"),
    "udp": CameraKind(
        "cameras.udp:UdpCamera", "udp:7777?encoding=evt2&size=320x320",
        "EVT words in datagrams, as an STM32 board sends them"),
    "serial": CameraKind(
        "cameras.pipe:SerialCamera", "serial:/dev/ttyACM0?encoding=evt2&size=320x320",
        "EVT words over a serial port"),
    "dv": CameraKind(
        "cameras.makers:DvCamera", "dv://127.0.0.1:7777",
        "DVXplorer and DAVIS (dv:), or a network stream of dv-processing", "dv_processing", "dv"),
    "nd": CameraKind(
        "cameras.makers:NeuromorphicCamera", "nd:",
        "EVK3 HD, EVK4, DVXplorer and DAVIS346 through neuromorphic-drivers",
        "neuromorphic_drivers", "neuromorphic"),
    "pipe": CameraKind(
        "cameras.pipe:PipeCamera", "pipe:live.raw",
        "RAW from a named pipe, or standard input as pipe:-"),
    "ring": CameraKind(
        "stream.packets:RingCamera", "ring:press",
        "what another process reads, under an address with share=press"),
    "twin": CameraKind(
        "sim.twin_camera:TwinCamera", "twin:finger-torsion",
        "a scene of the digital twin in real time (simulated)"),
}  # fmt: skip
SOURCE_OPTIONS = ("seconds", "share")  # Options of every address, which the source understands.


def open_camera(address: Address) -> Camera:
    """Open the camera of an address.

    Raises:
        ConfigError: The kind is unknown, or the address does not fit it.
        MissingExtraError: Its library is not installed.
        DeviceError: There is no such camera, or it refuses.
    """
    own = {name: f"spikingtac.{kind.place}" for name, kind in KINDS.items()}
    camera = named(with_plugins(own, plugins.CAMERAS), address.kind, "kind of camera")
    chosen: type[Camera] = import_place(camera) if isinstance(camera, str) else camera
    address.require_options((*chosen.OPTIONS, *SOURCE_OPTIONS))
    return chosen.open(address)
