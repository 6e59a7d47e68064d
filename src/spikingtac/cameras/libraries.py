"""Makers' libraries: imported with an error that says what brings them, and asked what they see."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from spikingtac.errors import DeviceError, MissingExtraError
from spikingtac.events.camera import KINDS

# USB vendor numbers of OpenMV boards: OpenMV's own, and pid.codes' that older ones carry.
USB_VENDORS = (0x37C5, 0x1209)
VIDEO = Path("/sys/class/video4linux")

# Names of the video devices that a Prophesee sensor's driver makes on a Raspberry Pi.
VIDEO_NAMES = ("genx320", "imx636", "rp1-cfe-csi2_ch0")


def require(module: str, package: str, extra: str) -> Any:
    """Return the module of an optional library.

    Args:
        module: Name to import.
        package: Name to install.
        extra: Extra of this package that brings it; empty where the maker alone gives it out.

    Raises:
        MissingExtraError: It is not installed.
        DeviceError: It is installed and cannot be loaded.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != module.partition(".")[0]:
            raise DeviceError(
                f"{package} is installed, but needs {error.name!r}: {error}"
            ) from error
        how = f"pip install 'spikingtac[{extra}]'" if extra else f"install {package} from its maker"
        raise MissingExtraError(
            f"this camera is read by the library {package}, which is not installed; {how}"
        ) from error
    except (ImportError, OSError) as error:
        raise DeviceError(
            f"{package} is installed but cannot be loaded ({error}); install it again"
        ) from error


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
    searches: dict[str, Callable[[], Iterator[FoundCamera]]] = {
        "openmv": _openmv,
        "prophesee": _prophesee,
        "v4l2": _v4l2,
        "dv": _dv,
        "nd": _neuromorphic,
    }
    for kind, search in searches.items():
        if not is_installed(kind):
            continue
        try:
            yield from search()
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
    listing = require("serial.tools.list_ports", "pyserial", "openmv")
    ports = listing.comports()
    return [(one.device, one.serial_number or "") for one in ports if one.vid in USB_VENDORS]


def _openmv() -> Iterator[FoundCamera]:
    for port, serial in openmv_ports():
        yield FoundCamera(address=f"openmv:{port}", model="OpenMV board", serial=serial)


def _prophesee() -> Iterator[FoundCamera]:
    library = require("metavision_hal", "OpenEB (metavision_hal)", "")
    for serial in library.DeviceDiscovery.list():
        yield FoundCamera(address=f"prophesee:{serial}", model="OpenEB", serial=str(serial))


def _v4l2() -> Iterator[FoundCamera]:
    for path in sorted(VIDEO.glob("video*/name")):
        name = path.read_text(encoding="utf-8", errors="replace").strip()
        if name.startswith(VIDEO_NAMES):
            yield FoundCamera(address=f"v4l2:/dev/{path.parent.name}", model=name)


def _dv() -> Iterator[FoundCamera]:
    library = require("dv_processing", "dv-processing", "dv")
    for device in library.io.camera.discover():
        serial = str(device.serialNumber)
        yield FoundCamera(address=f"dv:{serial}", model=str(device.cameraModel), serial=serial)


def _neuromorphic() -> Iterator[FoundCamera]:
    library = require("neuromorphic_drivers", "neuromorphic-drivers", "neuromorphic")
    for device in library.list_devices():
        serial = device.serial or ""
        yield FoundCamera(
            address=f"nd:{serial}",
            model=device.name.value,
            serial=serial,
            remark=device.error or "",
        )
