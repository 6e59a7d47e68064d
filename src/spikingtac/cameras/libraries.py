"""Makers' libraries: imported with an error that says what brings them, read alike, and listed."""

import contextlib
import importlib
import time
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

from spikingtac.errors import CameraLostError, DeviceError, MissingExtraError
from spikingtac.events.camera import KINDS, Camera
from spikingtac.events.formats.file_source import Rows

# USB vendor numbers of OpenMV boards: OpenMV's own, and pid.codes' that older ones carry.
USB_VENDORS = (0x37C5, 0x1209)
VIDEO = Path("/sys/class/video4linux")

# Names of the video devices that a Prophesee sensor's driver makes on a Raspberry Pi.
VIDEO_NAMES = ("genx320", "imx636", "rp1-cfe-csi2_ch0")


def require(kind: str, module: str = "") -> Any:
    """Return the module of the library that a kind of camera needs.

    Args:
        kind: A key of :data:`spikingtac.events.camera.KINDS`.
        module: Another module that the same extra brings.

    Raises:
        MissingExtraError: It is not installed.
        DeviceError: It is installed and cannot be loaded.
    """
    wanted = module or KINDS[kind].module
    try:
        return importlib.import_module(wanted)
    except (ImportError, OSError) as error:
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing is not None and wanted.startswith(missing):
            raise MissingExtraError(
                f"this camera is read by the library {wanted}, which is not installed; "
                f"{remedy(kind)}"
            ) from error
        raise DeviceError(
            f"{wanted} is installed but cannot be loaded ({error}); install it again"
        ) from error


class LibraryCamera(Camera):
    """A camera that is read through its maker's library, which may raise anything.

    Args:
        device: The library's object.

    Attributes:
        POLL_S: Sleep between two looks for events, s.
        about: What is told of the camera; ``model`` names it in errors.
    """

    POLL_S: ClassVar[float] = 0.0002

    def __init__(self, device: Any) -> None:
        super().__init__()
        self._device: Any = device
        self.about: dict[str, Any] = {}

    def read(self, timeout_s: float) -> Rows | None:
        """Return the next events; see :meth:`Camera.read`."""
        until_s = time.monotonic() + timeout_s
        while self._device is not None:
            try:
                rows = self._waiting()
            except CameraLostError:
                raise
            except (Exception, SystemExit) as error:
                raise CameraLostError(f"{self.about['model']} is gone ({error})") from error
            if rows is not None:
                return rows
            if time.monotonic() >= until_s:
                return self.nothing()
            time.sleep(self.POLL_S)
        return None

    def close(self) -> None:
        """Stop the camera and release it."""
        device, self._device = self._device, None
        for step in self._farewell(device) if device is not None else ():
            with contextlib.suppress(Exception, SystemExit):
                step()

    def describe(self) -> dict[str, Any]:
        """Return model, serial number and what else its library tells."""
        return self.about

    @abstractmethod
    def _waiting(self) -> Rows | None:
        """Return the events that are here, or None."""

    def _farewell(self, device: Any) -> Iterable[Callable[[], object]]:
        """Return what is to be called at the end."""
        return ()


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """One camera that is plugged in, or one library that could not be asked.

    Attributes:
        address: How to open it; empty where a library failed.
        model: What it says it is.
        serial: Its serial number, or empty.
        remark: What is wrong with it, or empty.
    """

    address: str
    model: str
    serial: str = ""
    remark: str = ""


def plugged_in() -> Iterator[FoundCamera]:
    """Yield the cameras that can be seen, in the order of the kinds."""
    for kind, search in _SEARCHES.items():
        if is_installed(kind):
            try:
                yield from search()
            except Exception as error:  # a maker's library may raise anything
                yield FoundCamera("", KINDS[kind].module, remark=f"it says: {error}")


def is_installed(kind: str) -> bool:
    """Return whether the library of a kind of camera is there."""
    module = KINDS[kind].module
    return not module or find_spec(module) is not None


def remedy(kind: str) -> str:
    """Return what brings the library of a kind of camera."""
    extra = KINDS[kind].extra
    return f"pip install 'spikingtac[{extra}]'" if extra else "build OpenEB from its sources"


def openmv_boards() -> Iterator[FoundCamera]:
    """Yield the OpenMV boards that are plugged in, each with its port in the address."""
    for one in require("openmv", "serial.tools.list_ports").comports():
        if one.vid in USB_VENDORS:
            yield FoundCamera(f"openmv:{one.device}", "OpenMV board", one.serial_number or "")


def _prophesee() -> Iterator[FoundCamera]:
    for serial in map(str, require("prophesee").DeviceDiscovery.list()):
        yield FoundCamera(f"prophesee:{serial}", "OpenEB", serial)


def _v4l2() -> Iterator[FoundCamera]:
    for path in sorted(VIDEO.glob("video*/name")):
        name = path.read_text(encoding="utf-8", errors="replace").strip()
        if name.startswith(VIDEO_NAMES):
            yield FoundCamera(f"v4l2:/dev/{path.parent.name}", name)


def _dv() -> Iterator[FoundCamera]:
    for device in require("dv").io.camera.discover():
        serial = str(device.serialNumber)
        yield FoundCamera(f"dv:{serial}", str(device.cameraModel), serial)


def _neuromorphic() -> Iterator[FoundCamera]:
    for device in require("nd").list_devices():
        serial = device.serial or ""
        yield FoundCamera(f"nd:{serial}", device.name.value, serial, device.error or "")


_SEARCHES: dict[str, Callable[[], Iterator[FoundCamera]]] = {
    "openmv": openmv_boards,
    "prophesee": _prophesee,
    "v4l2": _v4l2,
    "dv": _dv,
    "nd": _neuromorphic,
}
