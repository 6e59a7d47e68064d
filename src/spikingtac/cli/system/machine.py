"""Checks of this machine; each looks, changes nothing and reaches no network."""

from __future__ import annotations

import os
import platform
import socket
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

from spikingtac.cli.system.camera_checks import camera_checks
from spikingtac.cli.system.finding import Finding

USBFS_MEMORY_MB = 1000
"""USB buffer memory that makers of USB cameras advise (FLIR, "Understanding USBFS on Linux")."""
USB3_SPEED_MBIT_S = 5000
"""SuperSpeed; an event camera on USB 2 (480) drops events in fast motion."""
VIEWER_PORT = 8765
"""Port of ``spikingtac view`` unless given."""
CAMERA_VENDORS = {"03fd": "Prophesee", "04b4": "Prophesee (Cypress bridge)", "1fc9": "Prophesee",
                  "31f7": "Prophesee", "152a": "iniVation", "37c5": "OpenMV"}  # fmt: skip
"""USB vendor id -> whose event cameras carry it."""
CORE = ("numpy", "scipy", "numba", "onnxruntime", "matplotlib", "starlette", "uvicorn",
        "websockets")  # fmt: skip
"""The modules that a plain installation brings."""
EXTRAS = {
    "train": ("torch", "safetensors", "onnx", "onnxscript"),
    "formats": ("h5py", "hdf5plugin", "lz4", "mcap_ros2", "zstandard"),
    "arm": ("ruckig",),
    "robot": ("rtde_receive",),
    "bench": ("cv2", "trackpy", "evt3"),
    "rerun": ("rerun",),
    "tables": ("pandas",),
    "parquet": ("pyarrow",),
    "cluster": ("distributed",),
    "ros2": ("cyclonedds",),
    "foxglove": ("foxglove",),
    "lerobot": ("pyarrow", "pandas"),
    "zarr": ("zarr",),
    "design": ("build123d", "trimesh"),
    "docs": ("mkdocs", "material", "mkdocstrings"),
    "openmv": ("openmv",),
    "dv": ("dv_processing",),
    "neuromorphic": ("neuromorphic_drivers",),
    "cameras": ("openmv", "dv_processing", "neuromorphic_drivers"),
}
"""Extra -> the modules that it brings."""
_CPU = Path("/sys/devices/system/cpu")
_USB = Path("/sys/bus/usb/devices")
_USBFS = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
_RULES = (Path("/etc/udev/rules.d"), Path("/lib/udev/rules.d"))


def inspect_machine() -> Iterator[Finding]:
    """Yield the findings of every check, in order of importance."""
    checks: tuple[Callable[[], Iterator[Finding]], ...] = (
        _python, _core, _kernel_cache, _extras, _governor, _usb_memory, _cameras, camera_checks,
        _port,
    )  # fmt: skip
    for check in checks:
        yield from check()


def _python() -> Iterator[Finding]:
    version, cores = platform.python_version(), os.cpu_count() or 1
    found = f"{version} on {platform.system()} {platform.machine()}, {cores} cores"
    yield Finding(name="python", status="ok", found=found)


def _core() -> Iterator[Finding]:
    absent = [module for module in CORE if find_spec(module) is None]
    if absent:
        found, remedy = f"without {', '.join(absent)}", "pip install --force-reinstall spikingtac"
        yield Finding(name="libraries", status="fail", found=found, remedy=remedy)
    else:
        yield Finding(name="libraries", status="ok", found="complete")


def _kernel_cache() -> Iterator[Finding]:
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen) if chosen else Path(__file__).resolve().parents[2]
    # Numba makes the folder itself; what counts is whether its nearest ancestor may be written.
    standing = next(path for path in (folder, *folder.parents) if path.exists())
    if os.access(standing, os.W_OK):
        yield Finding(name="kernel cache", status="ok", found=f"{folder} can be written")
        return
    yield Finding(
        name="kernel cache",
        status="note",
        found=f"{folder} cannot be written",
        remedy="set NUMBA_CACHE_DIR to a folder of yours, or every start may compile again",
    )


def _extras() -> Iterator[Finding]:
    for extra, modules in EXTRAS.items():
        absent = [module for module in modules if find_spec(module) is None]
        if not absent:
            yield Finding(name=f"extra [{extra}]", status="ok", found="installed")
            continue
        yield Finding(
            name=f"extra [{extra}]",
            status="note",
            found=f"without {', '.join(absent)}",
            remedy=f"pip install 'spikingtac[{extra}]' if you need it",
        )


def _governor() -> Iterator[Finding]:
    governors = {_text(path) for path in _CPU.glob("cpu[0-9]*/cpufreq/scaling_governor")}
    if not governors:
        yield Finding(name="cpu governor", status="ok", found="not adjustable here")
    elif governors == {"performance"}:
        yield Finding(name="cpu governor", status="ok", found="performance")
    else:
        yield Finding(
            name="cpu governor",
            status="note",
            found=", ".join(sorted(governors)),
            remedy="live at 1 kHz: sudo cpupower frequency-set -g performance",
        )


def _usb_memory() -> Iterator[Finding]:
    text = _text(_USBFS)
    if not text.isdecimal():
        yield Finding(name="usb memory", status="ok", found="no USB on this machine")
    elif int(text) == 0 or int(text) >= USBFS_MEMORY_MB:  # 0 means without limit
        yield Finding(name="usb memory", status="ok", found=f"{text} MB")
    else:
        yield Finding(
            name="usb memory",
            status="note",
            found=f"{text} MB",
            remedy=f"for a camera: echo {USBFS_MEMORY_MB} | sudo tee {_USBFS}",
        )


def _cameras() -> Iterator[Finding]:
    seen = False
    for device in sorted(_USB.glob("*/idVendor")):
        maker = CAMERA_VENDORS.get(_text(device))
        if maker is None:
            continue
        seen = True
        speed = _text(device.with_name("speed"))
        slow = speed.isdecimal() and int(speed) < USB3_SPEED_MBIT_S
        yield Finding(
            name="camera",
            status="note" if slow else "ok",
            found=f"{maker} at {speed} Mbit/s",
            remedy="plug it into a USB 3 port with a USB 3 cable" if slow else "",
        )
    if not seen:
        yield Finding(name="camera", status="ok", found="none plugged in")
    elif not any(_names_vendor(path) for folder in _RULES for path in folder.glob("*.rules")):
        remedy = "install the udev rules that come with the camera's driver"
        yield Finding(name="udev rules", status="note", found="none for it", remedy=remedy)


def _port() -> Iterator[Finding]:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        try:
            probe.bind(("127.0.0.1", VIEWER_PORT))
        except OSError:
            remedy = "give the viewer another one: --port N"
            found = f"{VIEWER_PORT} is taken"
            yield Finding(name="viewer port", status="note", found=found, remedy=remedy)
            return
    yield Finding(name="viewer port", status="ok", found=f"{VIEWER_PORT} is free")


def _names_vendor(rules: Path) -> bool:
    text = _text(rules).lower()
    return any(f'=="{vendor}"' in text for vendor in CAMERA_VENDORS)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
