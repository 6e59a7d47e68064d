"""Checks of this machine; each looks, changes nothing and reaches no network."""

from __future__ import annotations

import os
import platform
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

USBFS_MEMORY_MB = 1000
"""USB buffer memory that makers of USB cameras advise (FLIR, "Understanding USBFS on Linux")."""
USB3_SPEED_MBIT_S = 5000
"""SuperSpeed; an event camera on USB 2 (480) drops events in fast motion."""
VIEWER_PORT = 8765
"""Port of ``spikingtac view`` unless given."""
SOCKET_BUFFER_BYTES = 8 << 20
"""Buffer that a camera's datagrams ask for (``cameras/udp.py``): 0.7 s at 3 Mev/s."""
LATENCY_LIMIT_MS = 1.0
"""Interval of deliveries from which on a window of 1 ms is no latency of 1 ms."""
SLOW_CLOCKS = ("hpet", "acpi_pm", "jiffies")
"""Clock sources that cost a microsecond or more for each look at the time."""
CAMERA_VENDORS = {"03fd": "Prophesee", "04b4": "Prophesee (Cypress bridge)", "1fc9": "Prophesee",
                  "31f7": "Prophesee", "152a": "iniVation", "37c5": "OpenMV"}  # fmt: skip
"""USB vendor id -> whose event cameras carry it."""
CORE = ("numpy", "scipy", "numba", "onnxruntime", "matplotlib", "starlette", "uvicorn",
        "websockets")  # fmt: skip
"""The modules that a plain installation brings."""
SLOW_DELIVERY = (
    "ask the maker's driver for smaller transfers (openmv: words=1024; OpenEB's kernel driver: "
    "mipi_frame_period)"
)
NOTHING_CAME = "see that the camera is on, its address is right, and something moves before it"
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
INTEGRATIONS = {
    "spikingtac_mujoco": "./integrations/mujoco",
    "lerobot_camera_spikingtac": "./integrations/lerobot_camera_spikingtac",
}
"""Module of a distribution beside the package -> where it is installed from."""
_SOCKET_LIMIT = Path("/proc/sys/net/core/rmem_max")
_CLOCK = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
_USB = Path("/sys/bus/usb/devices")
_RULES = (Path("/etc/udev/rules.d"), Path("/lib/udev/rules.d"))


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check found.

    Attributes:
        name: What was looked at.
        status: ``ok``, ``note`` (works, could be better) or ``fail`` (something will not work).
        found: What is there.
        remedy: What to do about it, empty where nothing is to be done.
    """

    name: str
    status: str
    found: str
    remedy: str = ""


def inspect_machine() -> Iterator[Finding]:
    """Yield the findings of every check, in order of importance."""
    version, cores = platform.python_version(), os.cpu_count() or 1
    yield Finding("python", "ok", f"{version} on {platform.system()}, {cores} cores")
    yield from _libraries()
    yield from _settings()
    yield from _usb_cameras()
    yield from _ports()


def _libraries() -> Iterator[Finding]:
    from spikingtac.cameras.found import is_installed, remedy
    from spikingtac.events.cameras.kinds import KINDS

    absent = _absent(CORE)
    if absent:
        yield Finding("libraries", "fail", absent, "pip install --force-reinstall spikingtac")
    else:
        yield Finding("libraries", "ok", "complete")
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen) if chosen else Path(__file__).resolve().parents[1]
    # Numba makes the folder itself; what counts is whether its nearest ancestor may be written.
    standing = next(path for path in (folder, *folder.parents) if path.exists())
    yield _noted(
        "kernel cache",
        os.access(standing, os.W_OK),
        f"{folder}",
        "it cannot be written: set NUMBA_CACHE_DIR to a folder of yours, or every start may "
        "compile again",
    )
    for extra, modules in EXTRAS.items():
        absent = _absent(modules)
        todo = f"pip install 'spikingtac[{extra}]' if you need it"
        yield _noted(f"extra [{extra}]", not absent, absent or "installed", todo)
    for module, folder in INTEGRATIONS.items():
        absent = _absent((module,))
        todo = f"pip install {folder} in a copy of the repository if you need it"
        yield _noted(f"integration {module}", not absent, absent or "installed", todo)
    for name, kind in KINDS.items():  # those of extras are told with the extras
        if kind.module and not kind.extra:
            found = f"{kind.about}: {'' if is_installed(name) else 'not '}installed"
            todo = f"{remedy(name)} if you have one"
            yield _noted("camera library", is_installed(name), found, todo)


def _settings() -> Iterator[Finding]:
    cpus = Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    governors = {_text(path) for path in cpus} or {"not adjustable here"}
    yield _noted(
        "cpu governor",
        governors <= {"performance", "not adjustable here"},
        ", ".join(sorted(governors)),
        "live at 1 kHz: sudo cpupower frequency-set -g performance",
    )
    memory = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
    text = _text(memory)
    yield _noted(
        "usb memory",
        not text.isdecimal() or int(text) == 0 or int(text) >= USBFS_MEMORY_MB,  # 0: no limit
        f"{text} MB" if text.isdecimal() else "no USB on this machine",
        f"for a camera: echo {USBFS_MEMORY_MB} | sudo tee {memory}",
    )
    limit = _text(_SOCKET_LIMIT)
    if limit.isdecimal():
        todo = f"for udp: cameras: sudo sysctl -w net.core.rmem_max={SOCKET_BUFFER_BYTES}"
        enough = int(limit) >= SOCKET_BUFFER_BYTES
        yield _noted("socket buffer", enough, f"at most {int(limit) >> 10} KiB", todo)
    clock = _text(_CLOCK)
    if clock:
        todo = "slow to read: choose tsc in the machine's settings or kernel options"
        yield _noted("clock", clock not in SLOW_CLOCKS, f"the kernel's clock is {clock}", todo)


def _usb_cameras() -> Iterator[Finding]:
    seen = False
    for device in sorted(_USB.glob("*/idVendor")):
        maker = CAMERA_VENDORS.get(_text(device))
        if maker is not None:
            seen = True
            speed = _text(device.with_name("speed"))
            fast = not speed.isdecimal() or int(speed) >= USB3_SPEED_MBIT_S
            todo = "plug it into a USB 3 port with a USB 3 cable"
            yield _noted("camera", fast, f"{maker} at {speed} Mbit/s", todo)
    if not seen:
        yield Finding("camera", "ok", "none plugged in")
    elif not any(_names_vendor(path) for folder in _RULES for path in folder.glob("*.rules")):
        todo = "install the udev rules that come with the camera's driver"
        yield Finding("udev rules", "note", "none for it", todo)
    for path in sorted([*Path("/dev").glob("ttyACM*"), *Path("/dev").glob("video*")]):
        if not os.access(path, os.R_OK | os.W_OK):
            group = "video" if path.name.startswith("video") else "dialout"
            todo = f"sudo usermod -aG {group} $USER, then log in again"
            yield Finding("permissions", "note", f"{path} may not be opened by you", todo)


def _ports() -> Iterator[Finding]:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        free = True
        try:
            probe.bind(("127.0.0.1", VIEWER_PORT))
        except OSError:
            free = False
    found = f"{VIEWER_PORT} is {'free' if free else 'taken'}"
    yield _noted("viewer port", free, found, "give the viewer another one: --port N")


def delivery(address: str, seconds: float) -> Iterator[Finding]:
    """Open a camera, and yield how it delivers.

    Args:
        address: The camera's.
        seconds: How long to listen, s.

    Raises:
        SpikingTacError: The camera cannot be opened.
    """
    from spikingtac.cli.interrupt import ending_on_interrupt
    from spikingtac.events.address import Address
    from spikingtac.events.cameras.source import CameraSource
    from spikingtac.events.formats.file_source import ReadOptions

    given = Address.parse(address)
    options = {**given.options, "seconds": f"{seconds:g}"}
    timed = Address(kind=given.kind, target=given.target, options=options)
    source = CameraSource(timed, ReadOptions())
    with ending_on_interrupt(source):
        for _ in source.columns():
            pass
    source.release()
    health = source.health()
    rate = health.events / seconds
    fast = health.interval_p50_ms is not None and health.interval_p50_ms <= LATENCY_LIMIT_MS
    found = f"{health.sentence}; {rate / 1e6:.3f} Mev/s over {seconds:g} s"
    yield _noted("delivery", fast, found, SLOW_DELIVERY if health.events else NOTHING_CAME)
    for kind, count in health.losses.items():
        yield Finding("delivery", "note", f"{kind}: {count}")


def _noted(name: str, good: bool, found: str, remedy: str) -> Finding:
    return Finding(name, "ok", found) if good else Finding(name, "note", found, remedy)


def _absent(modules: tuple[str, ...]) -> str:
    absent = [module for module in modules if find_spec(module) is None]
    return f"without {', '.join(absent)}" if absent else ""


def _names_vendor(rules: Path) -> bool:
    text = _text(rules).lower()
    return any(f'=="{vendor}"' in text for vendor in CAMERA_VENDORS)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
