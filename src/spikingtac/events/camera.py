"""The one protocol for every camera, the kinds of cameras, and the addresses that name them.

An address, ``KIND:TARGET?option=value&option=value``, stands wherever a recording is named:
``openmv:/dev/ttyACM0``, ``udp:7777?encoding=evt2&size=320x320``, ``dv://127.0.0.1:7777``, ``nd:``.

Opening, counting, reconnecting and packing are the same for all cameras and stand in
:mod:`spikingtac.events.camera_source`; a camera's own file says only how its bytes become columns.
Other packages register kinds under the entry point group ``spikingtac.cameras``.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, ClassVar, NamedTuple, Self

from numpy.typing import NDArray

from spikingtac import plugins
from spikingtac.errors import ConfigError, named, nearest
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.packing import NO_ROWS, Rows
from spikingtac.types import LossCounters

_FORM = re.compile(r"(?P<kind>[a-z][a-z0-9]+):(?P<target>[^?]*)(?:\?(?P<options>.*))?", re.DOTALL)

# Schemes of files elsewhere: no cameras.
_NET = frozenset({"http", "https", "ftp", "ftps", "file", "rtsp", "ssh", "s3"})
STANDARD_INPUT = "-"  # The path that means standard input.
_SIZE = re.compile(r"([1-9]\d{0,4})x([1-9]\d{0,4})")


@dataclass(frozen=True, kw_only=True)
class Address:
    """The address of a camera, taken apart; what does not fit it is a ConfigError.

    Attributes:
        kind: How the camera is reached, as ``udp``.
        target: Which one: a device, a port, a host, a scene; may be empty.
        options: What stands behind the question mark.
    """

    kind: str
    target: str = ""
    options: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str | Path) -> Self:
        """Take an address apart.

        Example:
            >>> address = Address.parse("udp:7777?encoding=evt2&size=320x320")
            >>> address.kind, address.target, address.size("size")
            ('udp', '7777', (320, 320))

        Raises:
            ConfigError: It is none, or an option is not ``name=value`` or stands twice.
        """
        found = _FORM.fullmatch(str(text))
        if found is None:
            raise ConfigError(
                f"{str(text)!r} is no address of a camera; it has the form "
                "KIND:TARGET?option=value&option=value, as udp:7777?encoding=evt2&size=320x320"
            )
        options: dict[str, str] = {}
        for part in filter(None, (found["options"] or "").split("&")):
            name, equals, value = part.partition("=")
            if not equals or not name or name in options:
                raise ConfigError(
                    f"{str(text)!r}: {part!r} must be name=value, each name once, joined by &"
                )
            options[name] = value
        return cls(kind=found["kind"], target=found["target"], options=options)

    def __str__(self) -> str:
        options = "&".join(f"{name}={value}" for name, value in self.options.items())
        return f"{self.kind}:{self.target}" + (f"?{options}" if options else "")

    def text(self, name: str, default: str = "", valid: Iterable[str] = ()) -> str:
        """Return an option, one of the valid values where such are named."""
        value, choices = self.options.get(name, default), list(valid)
        if choices and value not in choices:
            raise self._misfit(name, f"one of {', '.join(choices)}{nearest(value, choices)}")
        return value

    def number(self, name: str, default: float, low: float, high: float) -> float:
        """Return an option as a number from ``low`` to ``high``."""
        try:
            value = float(self.options.get(name, default))
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise self._misfit(name, f"a number from {low:g} to {high:g}")
        return value

    def size(self, name: str) -> tuple[int, int] | None:
        """Return an option ``WIDTHxHEIGHT`` in px, or None where it is not given."""
        found = _SIZE.fullmatch(self.options.get(name, ""))
        if found is None and name in self.options:
            raise self._misfit(name, "WIDTHxHEIGHT in px, as 320x320")
        return (int(found[1]), int(found[2])) if found else None

    def _misfit(self, name: str, valid: str) -> ConfigError:
        given = self.options.get(name)
        return ConfigError(f"{str(self)!r}: {name} is {given!r}, it must be {valid}")

    def host_port(self, host: str, low: int = 1) -> tuple[str, int]:
        """Return the target ``PORT`` or ``HOST:PORT`` (slashes before it are passed over).

        Args:
            host: Host where the target names none.
            low: Least port; 0 lets the system choose one.

        Raises:
            ConfigError: There is no such port.
        """
        named, _, port = self.target.lstrip("/").rpartition(":")
        if not port.isdecimal() or not low <= int(port) < 1 << 16:
            raise ConfigError(
                f"{str(self)!r}: the target must be PORT or HOST:PORT with a port up to 65535"
            )
        return named or host, int(port)


def is_address(path: str | Path) -> bool:
    """Return whether a path has the form of a camera's address, and is no file."""
    found = _FORM.fullmatch(str(path))
    return found is not None and found["kind"] not in _NET and not Path(path).exists()


def is_stream(path: Path) -> bool:
    """Return whether a path names something that can be read once, as it comes.

    That is standard input, a named pipe, a character device, or the address of a camera.
    """
    told = str(path) == STANDARD_INPUT or is_address(path)
    return told or path.is_fifo() or path.is_char_device()


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
    camera = named(plugins.WithPlugins(own, plugins.CAMERAS), address.kind, "kind of camera")
    chosen: type[Camera] = resolve_name(camera) if isinstance(camera, str) else camera
    valid = (*chosen.OPTIONS, *SOURCE_OPTIONS)
    for name in address.options:
        if name not in valid:
            raise ConfigError(
                f"{str(address)!r}: {address.kind} has no option {name!r}{nearest(name, valid)} "
                f"(valid: {', '.join(valid)})"
            )
    return chosen.open(address)
