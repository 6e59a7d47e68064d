"""From events on the wire to displacements at 1 kHz, and recording at a rate, by counterparts.

Usage::

    python benchmarks/cameras.py latency [--seconds 4] [--preset fast] [--kinds pipe,udp,dv] \
        [--rounds 5] [-o results/cameras/latency.md]
    python benchmarks/cameras.py cost [--events 100]
    python benchmarks/cameras.py twin [--scene demo] [--seconds 20] [--preset default]
    python benchmarks/cameras.py record FOLDER [--rate-mev-s 3] [--seconds 60] [--stall-s 3]

``latency``: another process sends a simulated scene as time passes, 1 ms of events at a time, and
notes when. A window is complete when an event after its end was sent; told is the time from there
to the tracker's estimate, both on the clock that the processes share. The counterparts are those of
the contract tests, not hardware: USB and a real network add their own time. Of several rounds, in
which the kinds take turns, the median of each figure counts. With ``-o`` the costs stand beside.

``cost``: the processor's time of one read, of events that have arrived: what a camera's file costs
beside that of a pipe, and what of it the maker's part takes. The cameras take turns.

``twin``: a scene of the twin as a camera, tracked while it runs: how late its packets were given
out, and whether they fell behind, as the camera itself counts it.

``record``: another process sends EVT2 datagrams at a rate to ``spikingtac record``, whose live copy
has a reader that never reads; with ``--stall-s`` the disk stands still every half a minute. Told is
what was sent, written, and lost, where.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.events.address import Address
from spikingtac.events.cameras.source import CameraSource
from spikingtac.events.formats.evt.encode.evt2 import Evt2Encoder
from spikingtac.events.formats.evt.encode.evt3 import Evt3Encoder
from spikingtac.events.formats.evt.header import format_header
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.open import open_events
from spikingtac.events.source import PacketSource
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.follow import follow
from spikingtac.types import EventPacket

TESTS = Path(__file__).resolve().parents[1] / "tests"
SIZE = (320, 320)
SCENE = "finger-torsion"
KINDS = ("pipe", "udp", "serial", "v4l2", "aestream", "openmv", "dv")
COUNTERPART_OF = {
    "pipe": "pipe",
    "udp": "udp-evt2",
    "serial": "serial",
    "v4l2": "v4l2-evt2",
    "aestream": "aestream",
    "openmv": "openmv",
    "dv": "dv",
    "prophesee": "prophesee-evt21",
    "nd": "nd",
}
"""Kind whose cost is told -> its name among the counterparts of the contract tests."""
MAKERS_PART = {"openmv": "_device", "dv": "_reader", "v4l2": "_skip"}
"""Kind -> where its camera holds what the maker has decided: the library's object, or what leaves
out the rest of a frame of the driver."""
FRAME_BYTES, END_MARK = 4096 * 391, (0xE1234519).to_bytes(4, "little")
"""A frame of the Raspberry Pi's driver, and what ends its EVT2 words."""
US_PER_MS, RATE_HZ = 1_000, 1_000
DATAGRAM_BYTES = 1472
TRANSFER_BYTES = 1024 * 4
"""The smallest transfer of an OpenMV board."""
WAITS = False
"""What a sender returns whose events are not on the wire yet."""
UNCOUNTED = 10
"""Turns at the beginning that are not counted: code and caches are cold."""
SKIPPED_MS = 300
"""Estimates at the beginning that are not counted, ms: a camera's first deliveries are late."""

Send = Callable[[EventPacket], object]


def simulated(seconds: float) -> tuple[EventPacket, Calibration]:
    """Return the events of a scene from its first contact on, and the calibration of its sensor."""
    from spikingtac.sim.scene import catalog
    from spikingtac.sim.scene.source import SceneSource

    scene = catalog.load(SCENE)
    source = SceneSource(scene, seed=1, duration_s=seconds)
    calibration = Calibration(
        reference_px=np.asarray(source.reference_px),
        radius_px=np.asarray(source.radius_px),
        grid=scene.skin.grid,
        size=scene.size,
    )
    return EventPacket.concatenate(list(source)), calibration


def opened_sender(kind: str, where: str) -> Send:
    """Return what sends events to a camera of a kind; it runs in the sender's process."""
    if kind == "pipe":
        file, encoder = os.open(where, os.O_WRONLY), Evt3Encoder()
        os.write(file, format_header("evt3", SIZE))
        return lambda packet: os.write(file, words(encoder, packet))
    if kind == "udp":
        out, evt2 = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), Evt2Encoder()
        return lambda packet: [
            out.sendto(piece, ("127.0.0.1", int(where))) for piece in cut(words(evt2, packet))
        ]
    if kind == "dv":
        return dv_sender(where)
    if kind == "v4l2":
        return frame_sender(where)
    from stand_ins.camera_counterparts import aestream_datagrams

    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    return lambda packet: [
        out.sendto(piece, ("127.0.0.1", int(where))) for piece in aestream_datagrams(packet)
    ]


def words(encoder: Any, packet: EventPacket) -> bytes:
    return encoder.encode(packet.t, packet.x, packet.y, packet.p).tobytes()


def cut(data: bytes) -> list[bytes]:
    return [data[at : at + DATAGRAM_BYTES] for at in range(0, len(data), DATAGRAM_BYTES)]


def dv_sender(port: str) -> Send:
    import dv_processing as dv

    stream = dv.io.Stream.EventStream(0, "events", "TWIN_320", SIZE)
    writer = dv.io.NetworkWriter("127.0.0.1", int(port), stream)

    def send(packet: EventPacket) -> None:
        store = dv.EventStore()
        for t, x, y, p in zip(
            packet.t.tolist(), packet.x.tolist(), packet.y.tolist(), packet.p.tolist(), strict=True
        ):
            store.push_back(t, x, y, p)
        writer.writeEvents(store)

    return send


def frame_sender(where: str) -> Send:
    """Return what fills a frame with the words of each packet, as the driver does."""
    file, encoder = os.open(where, os.O_WRONLY), Evt2Encoder()

    def send(packet: EventPacket) -> None:
        data = (words(encoder, packet) + END_MARK).ljust(FRAME_BYTES, b"\x5a")
        while data:
            data = data[os.write(file, data) :]

    return send


def device_sender(kind: str) -> tuple[str, Send]:
    """Return port and sender of a device on a pseudo-terminal, which the sender's process owns."""
    encoder = Evt2Encoder()
    if kind == "openmv":
        from stand_ins.openmv_board import OpenMvBoard

        return board_sender(OpenMvBoard(), encoder)
    import pty
    import tty

    master, slave = pty.openpty()
    tty.setraw(slave)

    def send(packet: EventPacket) -> None:
        data = words(encoder, packet)
        while data:
            data = data[os.write(master, data) :]

    return os.ttyname(slave), send


def board_sender(board: Any, encoder: Any) -> tuple[str, Send]:
    """Return the port of a board, and what fills its transfers: each waits until it is full."""
    pending = bytearray()

    def send(packet: EventPacket) -> bool:
        pending.extend(words(encoder, packet))
        if len(pending) < TRANSFER_BYTES:
            return WAITS
        board.put(bytes(pending))
        pending.clear()
        return True

    return board.port, send


def sender(kind: str, where: str, folder: Path) -> None:
    """Send the scene as time passes, and write when each millisecond was sent."""
    events = EventPacket.concatenate(list(open_events(folder / "events.npz")))
    if kind in ("openmv", "serial"):
        where, send = device_sender(kind)
    else:
        send = opened_sender(kind, where)
    print(where, flush=True)
    sys.stdin.readline()  # the receiver listens
    last_ms = int(events.t[-1]) // US_PER_MS
    edges = np.searchsorted(events.t, np.arange(last_ms + 2) * US_PER_MS)
    sent_s = np.full(last_ms + 1, np.nan)
    waiting: list[int] = []
    begun_s = time.monotonic() + 0.1
    for number in range(last_ms + 1):
        packet = events.part(int(edges[number]), int(edges[number + 1]), 0, 0)
        time.sleep(max(begun_s + number * 1e-3 - time.monotonic(), 0.0))
        if len(packet):
            waiting.append(number)
            now_s = time.monotonic()
            if send(packet) is not WAITS:
                sent_s[waiting] = now_s
                waiting.clear()
    np.save(folder / "sent.npy", sent_s)
    print("sent", flush=True)
    sys.stdin.readline()
    os._exit(0)


def latencies_ms(kind: str, folder: Path, calibration: Calibration, preset: str) -> Any:
    """Return the latency of each estimate, ms."""
    where, address = place(kind, folder)
    program = [sys.executable, __file__, "send", kind, where, str(folder)]
    process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    if kind in ("openmv", "serial", "dv"):
        where = process.stdout.readline().strip()
        address = address.format(where)
    source = CameraSource(Address.parse(address), ReadOptions())
    if kind not in ("openmv", "serial", "dv"):
        process.stdout.readline()
    tracker = make_tracker(load_config(preset).with_tracking(rate_hz=RATE_HZ).tracking, calibration)
    process.stdin.write("\n")
    process.stdin.flush()
    stdout = process.stdout
    threading.Thread(target=lambda: (stdout.readline(), source.close()), daemon=True).start()
    made = [(frame.t_us, time.monotonic()) for frame in follow(source, tracker, RATE_HZ)]
    source.release()
    process.kill()
    process.communicate()
    t_us, made_s = (np.array(column) for column in zip(*made[SKIPPED_MS:], strict=True))
    events = EventPacket.concatenate(list(open_events(folder / "events.npz")))
    # The window is complete with the first event behind its end: what holds it was sent then.
    after = np.searchsorted(events.t, t_us, side="right")
    inside = after < len(events)
    sent_s = np.load(folder / "sent.npy")[events.t[after[inside]] // US_PER_MS]
    found = (made_s[inside] - sent_s) * 1e3
    return found[~np.isnan(found)], dict(source.losses.kinds())


def frames_tool(folder: Path, path: Path) -> None:
    """Put a program that passes frames on in the place of ``v4l2-ctl``."""
    tool = folder / "v4l2-ctl"
    passing = f"dd if={path} bs={FRAME_BYTES} iflag=fullblock status=none"
    tool.write_text(f"#!/bin/sh\nexec {passing}\n")
    tool.chmod(0o755)
    if str(folder) not in os.environ["PATH"].split(os.pathsep):
        os.environ["PATH"] = f"{folder}{os.pathsep}{os.environ['PATH']}"


def place(kind: str, folder: Path) -> tuple[str, str]:
    """Return where the sender sends, and the address that the receiver opens."""
    if kind == "v4l2":
        path = folder / "frames"
        path.unlink(missing_ok=True)
        os.mkfifo(path)
        frames_tool(folder, path)
        return str(path), "v4l2:/dev/null?encoding=evt2"
    if kind == "pipe":
        path = folder / "live.raw"
        path.unlink(missing_ok=True)
        os.mkfifo(path)
        return str(path), f"pipe:{path}"
    port = str(free_port())
    return port, {
        "udp": f"udp:127.0.0.1:{port}?encoding=evt2",
        "aestream": f"aestream:127.0.0.1:{port}?size=320x320",
        "dv": "dv://127.0.0.1:{}",
        "openmv": "openmv:{}?words=1024",
        "serial": "serial:{}?encoding=evt2",
    }[kind]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def warm_up(calibration: Calibration, preset: str, events: EventPacket) -> None:
    config = load_config(preset).with_tracking(rate_hz=RATE_HZ).tracking
    tracker = make_tracker(config, calibration)
    for _ in follow(PacketSource([events], SIZE), tracker, RATE_HZ):
        pass


def latency(args: argparse.Namespace) -> None:
    from spikingtac.events.create import create_events

    events, calibration = simulated(args.seconds)
    warm_up(calibration, args.preset, events)
    rate = len(events) / args.seconds / 1e6
    title = f"{SCENE}, {rate:.3f} Mev/s on average, preset {args.preset}, {RATE_HZ} Hz (simulated)"
    print(f"{title}\n{'camera':10} {'p50 ms':>8} {'p99 ms':>8} {'worst':>8}  losses")
    rounds: dict[str, list[tuple[float, ...]]] = {kind: [] for kind in args.kinds.split(",")}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with create_events(folder / "events.npz", SIZE) as writer:
            writer.write(events)
        for kind in [kind for _ in range(args.rounds) for kind in rounds]:
            found, losses = latencies_ms(kind, folder, calibration, args.preset)
            figures = (*np.percentile(found, (50, 99)), found.max(), sum(losses.values()))
            rounds[kind].append(tuple(map(float, figures)))
            shown = " ".join(f"{figure:8.3f}" for figure in figures[:3])
            print(f"{kind:10} {shown}  {losses or 'none'}", flush=True)
    if args.output is not None:
        args.events, args.bursts = 100, 300
        write_latencies(args, title, rounds, costs_us(args))


def write_latencies(
    args: argparse.Namespace,
    title: str,
    rounds: dict[str, list[tuple[float, ...]]],
    costs: dict[str, Cost],
) -> None:
    """Write the tables: medians of the rounds, and what a read costs."""
    lines = [
        "# From events on the wire to displacements",
        "",
        f"{title}.",
        "",
        f"Medians of {args.rounds} rounds of {args.seconds:g} s, in which the cameras took turns; "
        "64 markers, an estimate every millisecond. Told from when the event that completes a "
        "window was sent to when its estimate was there. The counterparts are those of the "
        "contract tests, not hardware; sender and receiver share this machine's "
        f"{len(os.sched_getaffinity(0))} processors.",
        "",
        "| camera | p50 ms | p99 ms | worst ms | lost |",
        "| --- | --- | --- | --- | --- |",
    ]
    for kind, figures in rounds.items():
        p50, p99, worst, lost = np.median(figures, axis=0)
        lines.append(f"| {kind} | {p50:.2f} | {p99:.2f} | {worst:.1f} | {lost:.0f} |")
    command = f"python benchmarks/cameras.py latency --rounds {args.rounds} -o {args.output}"
    lines += ["", *cost_table(args, costs), "", f"Made by `{command}`.", ""]
    args.output.parent.mkdir(parents=True, exist_ok=True)
    args.output.write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))


def cost_table(args: argparse.Namespace, costs: dict[str, Cost]) -> list[str]:
    """Return the lines that tell what a read costs."""
    lines = [
        f"Cost of one read of {args.events} events: the reading thread's time on the processor, "
        f"{args.bursts} reads of each camera in turns. Each is taken less the pipe's of the same "
        "turn; told is the median. The maker's part is what the library takes (`openmv`, `dv`), or "
        "to leave out what stands behind the words in a frame of the driver (`v4l2`: 1.6 MB). "
        "`prophesee` and `nd` run modules with the documented calls in the place of the makers' "
        "libraries, so that the maker's part is missing there.",
        "",
        "| camera | read us | beside a pipe, us | of these the maker's part, us | ours, us |",
        "| --- | --- | --- | --- | --- |",
    ]
    for kind, cost in costs.items():
        beside = f"{cost.beside_us:+.0f} | {cost.makers_us:.0f} | {cost.ours_us:+.0f}"
        if kind not in MAKERS_PART:
            beside = f"{cost.beside_us:+.0f} | | {cost.ours_us:+.0f}"
        lines.append(f"| {kind} | {cost.read_us:.0f} | {beside} |")
    return lines


def cost(args: argparse.Namespace) -> None:
    print("\n".join(cost_table(args, costs_us(args))))


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What one read takes on the processor: medians, us.

    Attributes:
        read_us: The whole.
        beside_us: The whole less that of a pipe.
        makers_us: What of it the maker's part takes.
        ours_us: The whole less pipe and maker's part.
    """

    read_us: float
    beside_us: float
    makers_us: float
    ours_us: float


def costs_us(args: argparse.Namespace) -> dict[str, Cost]:
    """Return what a read of each camera takes; they take turns, so that all meet the same load."""
    from stand_ins.camera_counterparts import COUNTERPARTS, events, v4l2

    opened = COUNTERPARTS | {"v4l2-evt2": partial(v4l2, encoding="evt2", frame_bytes=FRAME_BYTES)}
    spent_us: dict[str, list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        meters = {}
        for kind, counterpart in COUNTERPART_OF.items():
            folder = Path(name) / kind
            folder.mkdir()
            try:
                wired = stack.enter_context(opened[counterpart](folder))
            except BaseException as error:  # a counterpart without its library skips like a test
                print(f"{kind} is left out: {error}")
                continue
            meters[kind] = wired, PartMeter.of(wired.camera, MAKERS_PART.get(kind))
            spent_us[kind] = []
        for number in range(1, args.bursts + UNCOUNTED + 1):
            burst = events(args.events, 1_000 * number, number)
            for kind, (wired, part) in meters.items():
                wired.sender(burst)
                time.sleep(0.003)  # it has arrived; what is measured is the reading
                spent_us[kind].append(timed_read(wired.camera, len(burst), part))
    whole = {kind: np.array(spent)[UNCOUNTED:] for kind, spent in spent_us.items()}
    pipe_us = whole["pipe"][:, 0]
    return {kind: median_cost(figures, pipe_us) for kind, figures in whole.items()}


def median_cost(figures_us: Any, pipe_us: Any) -> Cost:
    read_us, makers_us = figures_us.T
    medians = map(np.median, (read_us, read_us - pipe_us, makers_us, read_us - makers_us - pipe_us))
    return Cost(**dict(zip((field.name for field in fields(Cost)), medians, strict=True)))


def timed_read(camera: Any, count: int, part: PartMeter) -> tuple[float, float]:
    """Return this thread's time on the processor until so many events are read, and whose.

    Returns:
        The whole and the maker's part, us.
    """
    part.spent_s, got = 0.0, 0
    begun_s = time.thread_time()
    while got < count:
        rows = camera.read(0.2)
        assert rows is not None
        got += len(rows[3])
    return (time.thread_time() - begun_s) * 1e6, part.spent_s * 1e6


class PartMeter:
    """Stands before a function, or an object with methods, and adds up the processor's time."""

    def __init__(self, inner: Any) -> None:
        self._inner, self.spent_s = inner, 0.0

    @classmethod
    def of(cls, camera: Any, place: str | None) -> PartMeter:
        """Return one in the place of a camera's part; without a place it stays at nothing."""
        meter = cls(None if place is None else getattr(camera, place))
        if place is not None:
            setattr(camera, place, meter)
        return meter

    def __getattr__(self, name: str) -> Any:
        inner = getattr(self._inner, name)
        return partial(self._timed, inner) if callable(inner) else inner

    def __call__(self, *given: Any) -> Any:
        """Call the function, timed."""
        return self._timed(self._inner, *given)

    def _timed(self, inner: Callable[..., Any], *given: Any) -> Any:
        begun_s = time.thread_time()
        try:
            return inner(*given)
        finally:
            self.spent_s += time.thread_time() - begun_s


def twin(args: argparse.Namespace) -> None:
    from spikingtac.sim.scene import catalog
    from spikingtac.sim.scene.source import SceneSource

    scene = catalog.load(args.scene)
    at_rest = SceneSource(scene, 0)
    calibration = Calibration(
        reference_px=np.asarray(at_rest.reference_px),
        radius_px=np.asarray(at_rest.radius_px),
        grid=scene.skin.grid,
        size=scene.size,
    )
    config = load_config(args.preset).with_tracking(rate_hz=RATE_HZ).tracking
    warm_up(calibration, args.preset, EventPacket.concatenate([next(iter(at_rest))]))
    source = CameraSource(
        Address.parse(f"twin:{args.scene}?seconds={args.seconds:g}"), ReadOptions()
    )
    begun_s, begun_us, behind_ms = None, 0, []
    for frame in follow(source, make_tracker(config, calibration), RATE_HZ):
        now_s = time.monotonic()
        if begun_s is None:
            begun_s, begun_us = now_s, frame.t_us
        behind_ms.append((now_s - begun_s) * 1e3 - (frame.t_us - begun_us) / 1e3)
    health, pace = source.health(), source.camera.describe()["pace"]
    source.release()
    behind = np.array(behind_ms) - min(behind_ms)
    p50, p99 = np.percentile(behind, (50, 99))
    print(f"twin:{args.scene}, preset {args.preset}, {RATE_HZ} Hz, {args.seconds:g} s (simulated)")
    print(f"events    {health.events}, {health.deliveries} packets")
    print(f"packets   {pace}")
    print(
        f"estimates {len(behind)}, behind the earliest p50 {p50:.1f}, p99 {p99:.1f}, "
        f"worst {behind.max():.1f} ms"
    )


def record(args: argparse.Namespace) -> None:
    port, pipe = free_port(), args.folder.with_suffix(".copy")
    pipe.unlink(missing_ok=True)
    os.mkfifo(pipe)
    stalled = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)  # a viewer that never reads
    address = f"udp:127.0.0.1:{port}?encoding=evt2"
    program = [sys.executable, __file__, "stalling", str(args.stall_s), str(args.every_s)]
    program += ["record", address, "-o", str(args.folder)]
    program += ["--json", "--overwrite", "--copy", str(pipe)]
    process = subprocess.Popen(program, stdout=subprocess.PIPE, text=True)
    wait_until_taken(port)  # what is sent before that is lost to nobody's account
    sending = [
        sys.executable,
        __file__,
        "flood",
        str(port),
        str(args.rate_mev_s),
        str(args.seconds),
    ]
    flood = subprocess.Popen(sending, stdout=subprocess.PIPE, text=True)
    held_mb: list[float] = []
    stats = Path(f"/proc/{process.pid}/status")
    while flood.poll() is None:
        held = [line for line in stats.read_text().splitlines() if line.startswith("VmRSS")]
        held_mb.append(int(held[0].split()[1]) / 1e3)
        time.sleep(0.5)
    assert flood.stdout is not None
    sent = json.loads(flood.stdout.read())
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    told = json.loads(process.communicate(timeout=120)[0])
    os.close(stalled)
    pipe.unlink(missing_ok=True)
    readable = sum(len(packet) for packet in open_events(args.folder))
    third = len(held_mb) // 3
    print(
        f"sent      {sent['events']} events in {sent['seconds']:.1f} s, {args.rate_mev_s:g} Mev/s"
    )
    print(f"disk      stalls for {args.stall_s:g} s every {args.every_s:g} s")
    print(f"received  {told['received_events']}, written {told['events']}, readable {readable}")
    print(f"lost      {told['lost_events']} by the disk, {told['losses']} before this process")
    print(f"copy      {told['copy_lost_events']} not taken by its reader")
    print(
        f"memory    {max(held_mb):.0f} MB at most, {max(held_mb[:third], default=0):.0f} MB in the "
        f"first third, {max(held_mb[-third:], default=0):.0f} MB in the last"
    )
    print(f"files     {told['files']}, {told['bytes'] / 1e6:.0f} MB")
    if args.output is not None:
        figures = {"sent": sent, "readable": readable, "held_mb": held_mb, "summary": told}
        args.output.write_text(json.dumps(figures), encoding="utf-8")


def wait_until_taken(port: int) -> None:
    """Wait until another program listens on a UDP port of this machine (Linux)."""
    while f":{port:04X} " not in Path("/proc/net/udp").read_text():
        time.sleep(0.05)


def stalling(stall_s: float, every_s: float, arguments: list[str]) -> int:
    """Run a verb on a disk that stands still from time to time, as cards and USB disks do."""
    from spikingtac.cameras.recording.segments import Segments
    from spikingtac.cli.main import main as run_verb

    write, next_s = Segments.write, [time.monotonic() + every_s]

    def slow(segments: Segments, packet: EventPacket) -> None:
        if stall_s > 0.0 and time.monotonic() >= next_s[0]:
            time.sleep(stall_s)
            next_s[0] = time.monotonic() + every_s
        write(segments, packet)

    Segments.write = slow
    return run_verb(arguments)


def flood(port: int, rate_mev_s: float, seconds: float) -> None:
    """Send EVT2 datagrams at a rate, without waiting for anybody."""
    rng = np.random.default_rng(0)
    count = round(rate_mev_s * 1e3)
    x, y = (rng.integers(0, side, count).astype(np.uint16) for side in SIZE)
    p, offset = rng.random(count) < 0.5, np.sort(rng.integers(0, US_PER_MS, count))
    encoder, pending, sent = Evt2Encoder(), b"", 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        begun_s = time.monotonic()
        for number in range(round(seconds * 1e3)):
            pending += encoder.encode(offset + number * US_PER_MS, x, y, p).tobytes()
            whole = len(pending) // DATAGRAM_BYTES * DATAGRAM_BYTES
            for at in range(0, whole, DATAGRAM_BYTES):
                out.sendto(pending[at : at + DATAGRAM_BYTES], ("127.0.0.1", port))
            pending, sent = pending[whole:], sent + count
            time.sleep(max(begun_s + number * 1e-3 - time.monotonic(), 0.0))
        out.sendto(pending, ("127.0.0.1", port))
        print(json.dumps({"events": sent, "seconds": time.monotonic() - begun_s}))


def main() -> None:
    sys.path.insert(0, str(TESTS))
    if sys.argv[1] == "send":
        return sender(sys.argv[2], sys.argv[3], Path(sys.argv[4]))
    if sys.argv[1] == "stalling":
        sys.exit(stalling(float(sys.argv[2]), float(sys.argv[3]), sys.argv[4:]))
    if sys.argv[1] == "flood":
        return flood(int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    verbs = parser.add_subparsers(required=True)
    timed = verbs.add_parser("latency")
    timed.add_argument("--seconds", type=float, default=4.0)
    timed.add_argument("--preset", default="fast")
    timed.add_argument("--kinds", default=",".join(KINDS))
    timed.add_argument("--rounds", type=int, default=1)
    timed.add_argument("-o", "--output", type=Path)
    timed.set_defaults(run=latency)
    read = verbs.add_parser("cost")
    read.add_argument("--events", type=int, default=100)
    read.add_argument("--bursts", type=int, default=200)
    read.set_defaults(run=cost)
    paced = verbs.add_parser("twin")
    paced.add_argument("--scene", default="demo")
    paced.add_argument("--seconds", type=float, default=20.0)
    paced.add_argument("--preset", default="default")
    paced.set_defaults(run=twin)
    kept = verbs.add_parser("record")
    kept.add_argument("folder", type=Path)
    kept.add_argument("--rate-mev-s", type=float, default=3.0)
    kept.add_argument("--seconds", type=float, default=60.0)
    kept.add_argument("--stall-s", type=float, default=0.0)
    kept.add_argument("--every-s", type=float, default=30.0)
    kept.add_argument("-o", "--output", type=Path)
    kept.set_defaults(run=record)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
