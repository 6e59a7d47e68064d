"""Counterparts of cameras: what stands at the other end of the wire, speaking its real protocol.

None is hardware. Each says what it follows; those of makers' libraries run the library itself
where it is installed. Each ends with the stack that it is opened on.
"""

import os
import pty
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.events.camera import Address, Camera, open_camera
from spikingtac.events.evt.encode import ENCODERS, Evt2Encoder
from spikingtac.events.evt.raw import format_header
from spikingtac.types import EventPacket
from stand_ins.camera_modules import DriversDevice, HalDevice, drivers_module, hal_module
from stand_ins.openmv_board import OpenMvBoard
from stand_ins.random_packets import packet_of

SIZE = (320, 320)

# What the STM32 firmware sends: an Ethernet frame's worth, eight bytes' multiple.
DATAGRAM_BYTES = 1472
TRANSFER_BYTES = 2048 * 4
FRAME_BYTES = 4096 * 32  # Frames of a test; the driver's have 391 lines.
END_MARKS = {
    "evt2": (0xE1234519).to_bytes(4, "little"),
    "evt21": (0xE1234019_89ABCDEF).to_bytes(8, "little"),
    "evt3": (0xE019).to_bytes(2, "little"),
}


def events(count: int = 3_000, first_us: int = 1_000, seed: int = 0) -> EventPacket:
    """Return events at 1 Mev/s without order in place."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(first_us, first_us + count, count))
    x, y = (rng.integers(0, side, count) for side in SIZE)
    return packet_of(t, x, y, rng.random(count) < 0.5, SIZE)


def words_of(packet: EventPacket, encoding: str) -> bytes:
    """Return the words that a sensor would send."""
    return ENCODERS[encoding]().encode(packet.t, packet.x, packet.y, packet.p).tobytes()


@dataclass
class Counterpart:
    """A camera and what stands at its other end.

    Attributes:
        address: The camera's.
        camera: The open camera.
        sender: Sends events, whole.
        leave: Unplugs it, or ends its sender.
        ends: What reading tells then: ``end`` of the stream, that the camera is ``lost``, or
            ``silence`` where the protocol cannot tell.
    """

    address: str
    camera: Camera
    sender: Callable[[EventPacket], object]
    leave: Callable[[], object] = lambda: None
    ends: str = "silence"


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """Return a port of this machine that nobody listens on."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def opened_camera(opened: ExitStack, address: str) -> Camera:
    camera = open_camera(Address.parse(address))
    opened.callback(camera.close)
    return camera


def closing(opened: ExitStack, files: list[int]) -> Callable[[], None]:
    """Return what closes files once, at the end of the stack at the latest."""

    def leave() -> None:
        while files:
            os.close(files.pop())

    opened.callback(leave)
    return leave


def write_all(file: int, data: bytes) -> None:
    """Write to a terminal or a pipe, which take a part at once."""
    while data:
        data = data[os.write(file, data) :]


def pipe(opened: ExitStack, folder: Path) -> Counterpart:
    """A program that writes RAW (EVT3) into a named pipe."""
    path, files = folder / "live.raw", list[int]()
    os.mkfifo(path)
    leave = closing(opened, files)

    def begin() -> None:
        files.append(os.open(path, os.O_WRONLY))
        os.write(files[0], format_header("evt3", SIZE))

    thread = threading.Thread(target=begin)
    thread.start()
    camera = opened_camera(opened, f"pipe:{path}")
    thread.join(10.0)
    return Counterpart(
        f"pipe:{path}", camera, lambda p: os.write(files[0], words_of(p, "evt3")), leave, "end"
    )


def by_datagrams(
    address: str, pieces: Callable[[EventPacket], list[bytes]], opened: ExitStack, folder: Path
) -> Counterpart:
    """A sender of datagrams to a camera that listens on a free port."""
    camera: Any = opened_camera(opened, address)
    out = opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    there = "127.0.0.1", camera.port
    return Counterpart(address, camera, lambda p: [out.sendto(one, there) for one in pieces(p)])


def datagrams(packet: EventPacket, encoding: str = "evt2") -> list[bytes]:
    """Return the datagrams of events as a board sends them (GenX320_STM32F7_Stream)."""
    data = words_of(packet, encoding)
    return [data[at : at + DATAGRAM_BYTES] for at in range(0, len(data), DATAGRAM_BYTES)]


def udp(encoding: str) -> Callable[[ExitStack, Path], Counterpart]:
    address = f"udp:127.0.0.1:0?encoding={encoding}&size=320x320"
    return partial(by_datagrams, address, partial(datagrams, encoding=encoding))


def serial_port(opened: ExitStack, folder: Path) -> Counterpart:
    """A microcontroller behind a pseudo-terminal that sends EVT2 words without framing."""
    master, slave = pty.openpty()
    leave = closing(opened, [master, slave])
    address = f"serial:{os.ttyname(slave)}?encoding=evt2"
    camera = opened_camera(opened, address)

    def send(packet: EventPacket) -> None:
        given = master, words_of(packet, "evt2")
        threading.Thread(target=write_all, args=given, daemon=True).start()

    return Counterpart(address, camera, send, leave, "lost")


def openmv(opened: ExitStack, folder: Path) -> Counterpart:
    """A board that speaks Camera Protocol V2 on a pseudo-terminal, through the maker's library."""
    pytest.importorskip("openmv", reason="needs the extra [openmv]")
    board, encoder = OpenMvBoard(), Evt2Encoder()
    opened.callback(board.unplug)

    def send(packet: EventPacket) -> None:
        data = encoder.encode(packet.t, packet.x, packet.y, packet.p).tobytes()
        for at in range(0, len(data), TRANSFER_BYTES):
            board.put(data[at : at + TRANSFER_BYTES])

    address = f"openmv:{board.port}"
    return Counterpart(address, opened_camera(opened, address), send, board.unplug, "lost")


DV_WRITER = """
import sys
import dv_processing as dv
import numpy as np
stream = dv.io.Stream.EventStream(0, "events", "TWIN_320", (320, 320))
writer = dv.io.NetworkWriter("127.0.0.1", int(sys.argv[1]), stream)
print("listening", flush=True)
for line in sys.stdin:
    events = np.load(line.strip())
    store = dv.EventStore()
    for t, x, y, p in zip(*(events[name].tolist() for name in "txyp")):
        store.push_back(t, x, y, p)
    writer.writeEvents(store)
"""


def dv_network(opened: ExitStack, folder: Path) -> Counterpart:
    """The network writer of ``dv-processing``, in a process of its own."""
    pytest.importorskip("dv_processing", reason="needs the extra [dv]")
    port = free_port(socket.SOCK_STREAM)
    program = [sys.executable, "-c", DV_WRITER, str(port)]
    writer = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    stdin, stdout = writer.stdin, writer.stdout
    stdout.readline()

    def send(packet: EventPacket) -> None:
        path = folder / f"{int(packet.t[0])}.npz"
        np.savez(path, t=packet.t, x=packet.x, y=packet.y, p=packet.p)
        stdin.write(f"{path}\n")
        stdin.flush()

    def leave() -> None:
        writer.kill()
        writer.communicate()

    opened.callback(leave)
    address = f"dv://127.0.0.1:{port}"
    return Counterpart(address, opened_camera(opened, address), send, leave, "lost")


@contextmanager
def with_module(name: str, module: Any) -> Iterator[None]:
    """Put a module where the import of a maker's library finds it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, name, module)
        yield


def prophesee(encoding: str, opened: ExitStack, folder: Path) -> Counterpart:
    """A module with the documented calls of OpenEB's ``metavision_hal``; not the library."""
    device, encoder = HalDevice(encoding), ENCODERS[encoding.lower()]()
    opened.enter_context(with_module("metavision_hal", hal_module(device)))

    def send(packet: EventPacket) -> None:
        device.buffers.append(encoder.encode(packet.t, packet.x, packet.y, packet.p).view(np.uint8))

    camera = opened_camera(opened, "prophesee:")
    return Counterpart("prophesee:", camera, send, device.unplug, "lost")


def neuromorphic(opened: ExitStack, folder: Path) -> Counterpart:
    """A module with the documented calls of ``neuromorphic-drivers``; not the library."""
    device = DriversDevice()
    opened.enter_context(with_module("neuromorphic_drivers", drivers_module(device)))
    return Counterpart("nd:", opened_camera(opened, "nd:"), device.put, device.unplug, "lost")


def v4l2(encoding: str, opened: ExitStack, folder: Path) -> Counterpart:
    """A program in the place of ``v4l2-ctl`` that passes frames on whole, each with its mark."""
    fifo, tool, half = folder / "frames", folder / "v4l2-ctl", FRAME_BYTES // 2
    os.mkfifo(fifo)
    passing = f"dd if={fifo} bs={FRAME_BYTES} iflag=fullblock status=none"
    tool.write_text(f"#!/bin/sh\nexec {passing}\n")
    tool.chmod(0o755)
    encoder, files = ENCODERS[encoding](), list[int]()
    writing = ThreadPoolExecutor(1)  # a pipe holds less than a frame; one after another
    opened.callback(writing.shutdown, wait=False)
    address = f"v4l2:/dev/null?encoding={encoding}&frame=4096x{FRAME_BYTES // 4096}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", str(folder), prepend=os.pathsep)
        camera = opened_camera(opened, address)
        files.append(os.open(fifo, os.O_WRONLY))

    def send(packet: EventPacket) -> None:
        data = encoder.encode(packet.t, packet.x, packet.y, packet.p).tobytes()
        for at in range(0, len(data), half):
            words = data[at : at + half] + END_MARKS[encoding]
            # What stands behind the mark is what an earlier frame left.
            writing.submit(write_all, files[0], words.ljust(FRAME_BYTES, b"\x5a"))

    return Counterpart(address, camera, send, closing(opened, files), "lost")


# Every camera that the contract suite runs: name -> opens it with its counterpart.
COUNTERPARTS: dict[str, Callable[[ExitStack, Path], Counterpart]] = {
    "pipe": pipe,
    "serial": serial_port,
    **{f"v4l2-{encoding}": partial(v4l2, encoding) for encoding in ENCODERS},
    "openmv": openmv,
    "dv": dv_network,
    "prophesee-evt21": partial(prophesee, "EVT21"),
    "prophesee-evt3": partial(prophesee, "EVT3"),
    "nd": neuromorphic,
    **{f"udp-{encoding}": udp(encoding) for encoding in ENCODERS},
}
