"""Makers' libraries: imported with an error that says what brings them, read alike, and listed."""

from __future__ import annotations

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

# Kind of camera -> module to import, and name to install.
LIBRARIES = {
    "openmv": ("openmv.camera", "openmv"),
    "prophesee": ("metavision_hal", "OpenEB (metavision_hal)"),
    "dv": ("dv_processing", "dv-processing"),
    "nd": ("neuromorphic_drivers", "neuromorphic-drivers"),
}

# USB vendor numbers of OpenMV boards: OpenMV's own, and pid.codes' that older ones carry.
USB_VENDORS = (0x37C5, 0x1209)
VIDEO = Path("/sys/class/video4linux")

# Names of the video devices that a Prophesee sensor's driver makes on a Raspberry Pi.
VIDEO_NAMES = ("genx320", "imx636", "rp1-cfe-csi2_ch0")


def require(kind: str, module: str = "") -> Any:
    """Return the module of the library that a kind of camera needs.

    Args:
        kind: A key of :data:`LIBRARIES`.
        module: Another module that the same extra brings.

    Raises:
        MissingExtraError: It is not installed.
        DeviceError: It is installed and cannot be loaded.
    """
    wanted, package = LIBRARIES[kind]
    try:
        return importlib.import_module(module or wanted)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] not in (module or wanted).split("."):
            raise DeviceError(
                f"{package} is installed, but needs {error.name!r}: {error}"
            ) from error
        extra = KINDS[kind].extra
        how = f"pip install 'spikingtac[{extra}]'" if extra else f"install {package} from its maker"
        raise MissingExtraError(
            f"this camera is read by the library {package}, which is not installed; {how}"
        ) from error
    except (ImportError, OSError) as error:
        raise DeviceError(
            f"{package} is installed but cannot be loaded ({error}); install it again"
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


@dataclass(frozen=True, kw_only=True, slots=True)
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
        if not is_installed(kind):
            continue
        try:
            for target, model, serial, remark in search():
                address = f"{kind}:{target}"
                yield FoundCamera(address=address, model=model, serial=serial, remark=remark)
        except Exception as error:  # a maker's library may raise anything
            yield FoundCamera(address="", model=KINDS[kind].module, remark=f"it says: {error}")


def is_installed(kind: str) -> bool:
    """Return whether the library of a kind of camera is there."""
    module = KINDS[kind].module
    return not module or find_spec(module) is not None


def remedy(kind: str) -> str:
    """Return what brings the library of a kind of camera."""
    extra = KINDS[kind].extra
    return f"pip install 'spikingtac[{extra}]'" if extra else "build OpenEB from its sources"


def openmv_ports() -> list[tuple[str, str]]:
    """Return port and serial number of the OpenMV boards that are plugged in."""
    ports = require("openmv", "serial.tools.list_ports").comports()
    return [(one.device, one.serial_number or "") for one in ports if one.vid in USB_VENDORS]


# Target of an address, model, serial number, remark.
Seen = tuple[str, str, str, str]


def _prophesee() -> Iterator[Seen]:
    for serial in map(str, require("prophesee").DeviceDiscovery.list()):
        yield serial, "OpenEB", serial, ""


def _v4l2() -> Iterator[Seen]:
    for path in sorted(VIDEO.glob("video*/name")):
        name = path.read_text(encoding="utf-8", errors="replace").strip()
        if name.startswith(VIDEO_NAMES):
            yield f"/dev/{path.parent.name}", name, "", ""


def _dv() -> Iterator[Seen]:
    for device in require("dv").io.camera.discover():
        yield str(device.serialNumber), str(device.cameraModel), str(device.serialNumber), ""


def _neuromorphic() -> Iterator[Seen]:
    for device in require("nd").list_devices():
        serial = device.serial or ""
        yield serial, device.name.value, serial, device.error or ""


_SEARCHES: dict[str, Callable[[], Iterable[Seen]]] = {
    "openmv": lambda: [(port, "OpenMV board", serial, "") for port, serial in openmv_ports()],
    "prophesee": _prophesee,
    "v4l2": _v4l2,
    "dv": _dv,
    "nd": _neuromorphic,
}
