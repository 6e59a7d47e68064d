"""Counterparts of cameras: what stands at the other end of the wire, speaking its real protocol.

None is hardware. Each says what it follows; those of makers' libraries run the library itself
where it is installed.
"""

from __future__ import annotations

import os
import pty
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.events.address import Address
from spikingtac.events.camera import Camera, open_camera
from spikingtac.events.evt.encode import Evt2Encoder, Evt3Encoder, Evt21Encoder
from spikingtac.events.evt.raw import format_header
from spikingtac.types import EventPacket
from stand_ins.camera_modules import DriversDevice, HalDevice, drivers_module, hal_module
from stand_ins.openmv_board import OpenMvBoard

SIZE = (320, 320)

# What the STM32 firmware sends: an Ethernet frame's worth, eight bytes' multiple.
DATAGRAM_BYTES = 1472
FRAME_BYTES = 4096 * 32  # Frames of a test; the driver's have 391 lines.
ENCODERS = {"evt2": Evt2Encoder, "evt21": Evt21Encoder, "evt3": Evt3Encoder}


def events(count: int = 3_000, first_us: int = 1_000, seed: int = 0) -> EventPacket:
    """Return events at 1 Mev/s without order in place."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(first_us, first_us + count, count)).astype(np.int64)
    x, y = (rng.integers(0, side, count).astype(np.uint16) for side in SIZE)
    return EventPacket(x, y, rng.random(count) < 0.5, t, first_us, int(t[-1]) + 1, SIZE)


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
    sender: Any
    leave: Any = lambda: None
    ends: str = "silence"


@contextmanager
def pipe(folder: Path) -> Iterator[Counterpart]:
    """A program that writes RAW (EVT3) into a named pipe."""
    path = folder / "live.raw"
    os.mkfifo(path)
    files: list[int] = []

    def begin() -> None:
        files.append(os.open(path, os.O_WRONLY))
        os.write(files[0], format_header("evt3", SIZE))

    thread = threading.Thread(target=begin)
    thread.start()
    camera = open_camera(Address.parse(f"pipe:{path}"))
    thread.join(10.0)

    def leave() -> None:
        while files:
            os.close(files.pop())

    def send(packet: EventPacket) -> None:
        os.write(files[0], words_of(packet, "evt3"))

    try:
        yield Counterpart(f"pipe:{path}", camera, send, leave, "end")
    finally:
        camera.close()
        leave()


@contextmanager
def udp(folder: Path, encoding: str = "evt2") -> Iterator[Counterpart]:
    """A board that sends words in datagrams of 1472 bytes (GenX320_STM32F7_Stream)."""
    address = f"udp:127.0.0.1:0?encoding={encoding}&size=320x320"
    camera = open_camera(Address.parse(address))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:

        def send(packet: EventPacket) -> None:
            for datagram in datagrams(packet, encoding):
                out.sendto(datagram, ("127.0.0.1", camera.port))  # type: ignore[attr-defined]

        try:
            yield Counterpart(address, camera, send)
        finally:
            camera.close()


def datagrams(packet: EventPacket, encoding: str = "evt2") -> list[bytes]:
    """Return the datagrams of events."""
    data = words_of(packet, encoding)
    return [data[at : at + DATAGRAM_BYTES] for at in range(0, len(data), DATAGRAM_BYTES)]


@contextmanager
def serial_port(folder: Path) -> Iterator[Counterpart]:
    """A microcontroller behind a pseudo-terminal that sends EVT2 words without framing."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    address = f"serial:{path}?encoding=evt2"
    camera = open_camera(Address.parse(address))
    open_ends = [master, slave]

    def leave() -> None:
        while open_ends:
            os.close(open_ends.pop())

    def send(packet: EventPacket) -> None:
        data = words_of(packet, "evt2")
        threading.Thread(target=write_all, args=(master, data), daemon=True).start()

    try:
        yield Counterpart(address, camera, send, leave, "lost")
    finally:
        camera.close()
        leave()


def write_all(file: int, data: bytes) -> None:
    """Write to a terminal, which takes 4 KB at once."""
    while data:
        data = data[os.write(file, data) :]


@contextmanager
def openmv(folder: Path) -> Iterator[Counterpart]:
    """A board that speaks Camera Protocol V2 on a pseudo-terminal, through the maker's library."""
    pytest.importorskip("openmv", reason="needs the extra [openmv]")
    board = OpenMvBoard()
    address = f"openmv:{board.port}"
    camera = open_camera(Address.parse(address))
    encoder = Evt2Encoder()

    def send(packet: EventPacket) -> None:
        data = encoder.encode(packet.t, packet.x, packet.y, packet.p).tobytes()
        for at in range(0, len(data), TRANSFER_BYTES):
            board.put(data[at : at + TRANSFER_BYTES])

    try:
        yield Counterpart(address, camera, send, board.unplug, "lost")
    finally:
        camera.close()
        board.unplug()


TRANSFER_BYTES = 2048 * 4

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


@contextmanager
def dv_network(folder: Path) -> Iterator[Counterpart]:
    """The network writer of ``dv-processing``, in a process of its own."""
    pytest.importorskip("dv_processing", reason="needs the extra [dv]")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    program = [sys.executable, "-c", DV_WRITER, str(port)]
    writer = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert writer.stdin is not None
    assert writer.stdout is not None
    writer.stdout.readline()
    camera = open_camera(Address.parse(f"dv://127.0.0.1:{port}"))
    stdin = writer.stdin

    def send(packet: EventPacket) -> None:
        path = folder / f"{int(packet.t[0])}.npz"
        np.savez(path, t=packet.t, x=packet.x, y=packet.y, p=packet.p)
        stdin.write(f"{path}\n")
        stdin.flush()

    def leave() -> None:
        writer.kill()
        writer.communicate()

    try:
        yield Counterpart(f"dv://127.0.0.1:{port}", camera, send, leave, "lost")
    finally:
        camera.close()
        leave()


@contextmanager
def aestream(folder: Path) -> Iterator[Counterpart]:
    """Datagrams as AEStream's ``dvs_to_udp`` sends them: 32 events of 8 bytes each."""
    address = "aestream:127.0.0.1:0?size=320x320"
    camera = open_camera(Address.parse(address))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:

        def send(packet: EventPacket) -> None:
            for datagram in aestream_datagrams(packet):
                out.sendto(datagram, ("127.0.0.1", camera.port))  # type: ignore[attr-defined]

        try:
            yield Counterpart(address, camera, send)
        finally:
            camera.close()


def aestream_datagrams(packet: EventPacket, timed: bool = True) -> list[bytes]:
    """Return the datagrams of events, with their times or without."""
    heads = packet.x.astype(np.uint32) << 16 | packet.y | packet.p.astype(np.uint32) << 15
    if not timed:
        data = (heads | np.uint32(1 << 31)).astype("<u4").tobytes()
    else:
        data = np.column_stack([heads, packet.t.astype(np.uint32)]).astype("<u4").tobytes()
    return [data[at : at + 256] for at in range(0, len(data), 256)]


@contextmanager
def with_module(name: str, module: Any) -> Iterator[None]:
    """Put a module where the import of a maker's library finds it."""
    before = sys.modules.get(name)
    sys.modules[name] = module
    try:
        yield
    finally:
        if before is None:
            del sys.modules[name]
        else:
            sys.modules[name] = before


@contextmanager
def prophesee(folder: Path, encoding: str = "EVT21") -> Iterator[Counterpart]:
    """A module with the documented calls of OpenEB's ``metavision_hal``; not the library."""
    device = HalDevice(encoding)
    with with_module("metavision_hal", hal_module(device)):
        camera = open_camera(Address.parse("prophesee:"))
        encoder = ENCODERS[encoding.lower()]()

        def send(packet: EventPacket) -> None:
            words = encoder.encode(packet.t, packet.x, packet.y, packet.p)
            device.buffers.append(words.view(np.uint8))

        try:
            yield Counterpart("prophesee:", camera, send, device.unplug, "lost")
        finally:
            camera.close()


@contextmanager
def neuromorphic(folder: Path) -> Iterator[Counterpart]:
    """A module with the documented calls of ``neuromorphic-drivers``; not the library."""
    device = DriversDevice()
    with with_module("neuromorphic_drivers", drivers_module(device)):
        camera = open_camera(Address.parse("nd:"))
        try:
            yield Counterpart("nd:", camera, device.put, device.unplug, "lost")
        finally:
            camera.close()


@contextmanager
def v4l2(
    folder: Path, encoding: str = "evt21", frame_bytes: int = FRAME_BYTES
) -> Iterator[Counterpart]:
    """A program in the place of ``v4l2-ctl`` that passes frames on whole, each with its mark."""
    fifo, tool, path = folder / "frames", folder / "v4l2-ctl", os.environ["PATH"]
    os.mkfifo(fifo)
    passing = f"dd if={fifo} bs={frame_bytes} iflag=fullblock status=none"
    tool.write_text(f"#!/bin/sh\nexec {passing}\n")
    tool.chmod(0o755)
    encoder = ENCODERS[encoding]()
    files: list[int] = []
    address = f"v4l2:/dev/null?encoding={encoding}&frame=4096x{frame_bytes // 4096}"
    writing = ThreadPoolExecutor(1)  # a pipe holds less than a frame; one after another
    os.environ["PATH"] = f"{folder}{os.pathsep}{path}"
    try:
        camera = open_camera(Address.parse(address))
        files.append(os.open(fifo, os.O_WRONLY))
    finally:
        os.environ["PATH"] = path

    def send(packet: EventPacket) -> None:
        data = encoder.encode(packet.t, packet.x, packet.y, packet.p).tobytes()
        for at in range(0, len(data), frame_bytes // 2):
            words = data[at : at + frame_bytes // 2] + END_MARKS[encoding]
            frame = words.ljust(frame_bytes, b"\x5a")  # what an earlier frame left
            writing.submit(write_all, files[0], frame)

    def leave() -> None:
        while files:
            os.close(files.pop())

    try:
        yield Counterpart(address, camera, send, leave, "lost")
    finally:
        leave()
        camera.close()
        writing.shutdown(wait=False)


END_MARKS = {
    "evt2": (0xE1234519).to_bytes(4, "little"),
    "evt21": (0xE1234019_89ABCDEF).to_bytes(8, "little"),
    "evt3": (0xE019).to_bytes(2, "little"),
}


# Every camera that the contract suite runs: name -> opens it with its counterpart.
COUNTERPARTS = {
    "pipe": pipe,
    "serial": serial_port,
    "v4l2-evt2": partial(v4l2, encoding="evt2"),
    "v4l2-evt21": v4l2,
    "v4l2-evt3": partial(v4l2, encoding="evt3"),
    "openmv": openmv,
    "dv": dv_network,
    "aestream": aestream,
    "prophesee-evt21": prophesee,
    "prophesee-evt3": partial(prophesee, encoding="EVT3"),
    "nd": neuromorphic,
    "udp-evt2": udp,
    "udp-evt21": partial(udp, encoding="evt21"),
    "udp-evt3": partial(udp, encoding="evt3"),
}
