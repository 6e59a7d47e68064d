"""The digital twin as a camera: a scene's events as real time passes, in a process of their own."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.events.camera import Address, Camera, is_address
from spikingtac.events.formats.file_source import Rows
from spikingtac.sim import catalog
from spikingtac.sim.camera.config import CAMERA_NAMES
from spikingtac.stream.host import Asker, Host
from spikingtac.types import US_PER_S, EventPacket, LossCounters

Options = tuple[int, str | None]  # Seed, and camera preset; None is the scene's own.
LARGEST_SEED = (1 << 32) - 1
POLL_S = 0.05  # Longest wait for a simulation before it is asked whether it goes on, s.
NAP_S = 0.001  # Longest sleep before a packet is looked at again, s.

# A packet that is given out later than this after its time is late, s (a frame's time).
LATE_S = 0.02


class RemoteSource(Host):
    """A simulation in a process of its own; it waits for its user, and loses nothing.

    It is an :class:`~spikingtac.events.source.EventSource`. A simulated sensor costs about as much
    as a tracker; side by side in one process they would share an interpreter lock, and neither
    would keep up.

    Args:
        opened: Opens it there: packets with side data.
        size: ``(width, height)`` of the packets, px.
        take_side_data: Called with each packet's side data before the packet is yielded.
    """

    def __init__(
        self,
        opened: Callable[[], Iterable[tuple[EventPacket, Any]]],
        size: tuple[int, int],
        take_side_data: Callable[[Any], None] = lambda _: None,
    ) -> None:
        self.size, self.losses, self._take = size, LossCounters(), take_side_data
        super().__init__("the events", partial(_simulate, opened=opened))

    def __iter__(self) -> Iterator[EventPacket]:
        with suppress(EOFError):
            while True:
                if (told := self.receive(POLL_S)) is not None:
                    packet, side_data = told
                    self._take(side_data)
                    yield packet


def _simulate(asker: Asker, opened: Callable[[], Iterable[tuple[EventPacket, Any]]]) -> None:
    """Tell the asker each packet with its side data; it waits while the channel is full."""
    for told in opened():
        asker.tell(told)


class TwinCamera(Camera):
    """A scene's packets, none before its time.

    A machine that is too slow delivers them late, and so does a reader that asks late; both are
    counted (``pace`` of :meth:`describe`). Nothing is left out.
    """

    OPTIONS: ClassVar[tuple[str, ...]] = ("seed", "camera")
    checked = True

    def __init__(self, scene: str, seed: int, camera: str | None) -> None:
        from spikingtac.sim.source import SceneSource  # with the gel's solvers behind it

        super().__init__()
        found = catalog.load_scene(scene).with_camera(camera)
        self.size = found.size
        self.scene, self.seed, self._preset = scene, seed, camera
        self._at_rest = SceneSource(found, seed)
        arguments = {"name": scene, "seed": seed, "camera": camera, "warm": True}
        self._source = RemoteSource(
            partial(truthful_packets, **arguments),
            self.size,
            lambda rows: self.take_truth({"marker_t_us": rows[0], "marker_px": rows[1]}),
        )
        self._packets = iter(self._source)
        self._closed = False
        # Waits until the kernels are compiled: only then time begins.
        self._next: EventPacket | None = next(self._packets, None)
        self._zero_s: float | None = None
        self._given = self._late = 0
        self._latest_s = 0.0

    @classmethod
    def open(cls, address: Address) -> Self:
        """Start to simulate; see :meth:`Camera.open`."""
        if not address.target:
            raise ConfigError("twin: needs the name of a scene (spikingtac simulate --list)")
        return cls(address.target, *twin_options(address))

    def read(self, timeout_s: float) -> Rows | None:
        """Return the events up to now; see :meth:`Camera.read`."""
        until_s = time.monotonic() + timeout_s
        while not self._closed:
            packet = self._next or next(self._packets, None)
            if packet is None:
                return None
            now_s = time.monotonic()
            if self._zero_s is None:
                self._zero_s = now_s - packet.t_end_us / US_PER_S
            wait_s = self._zero_s + packet.t_end_us / US_PER_S - now_s
            if wait_s <= 0.0:
                self._next = None
                self._given += 1
                self._late += wait_s < -LATE_S
                self._latest_s = max(self._latest_s, -wait_s)
                return packet.x, packet.y, packet.p, packet.t
            self._next = packet
            if now_s >= until_s:
                return self.nothing()
            time.sleep(min(wait_s, until_s - now_s, NAP_S))
        return None

    def close(self) -> None:
        """Stop the simulation."""
        if not self._closed:
            self._closed = True
            self._source.close()

    def describe(self) -> dict[str, Any]:
        """Return scene and seed, that it is simulated, and whether it kept up with real time."""
        latest_ms = round(1e3 * self._latest_s, 1)
        pace = {"packets": self._given, "late_packets": self._late, "latest_ms": latest_ms}
        told = {"simulated": True, "scene": self.scene, "seed": self.seed, "pace": pace}
        return told | ({"camera": self._preset} if self._preset else {})

    def truth(self) -> dict[str, NDArray[np.floating[Any]]]:
        """Return ``reference_px (m, 2)`` and ``radius_px (m,)``: the markers at rest, px."""
        names = "reference_px", "radius_px"
        return {name: getattr(self._at_rest, name).astype(np.float32) for name in names}

    def manifest(self) -> dict[str, Any]:
        """Return what a simulation's own manifest says, so that the folder reads like one."""
        return self._at_rest.manifest()


def truthful_packets(
    name: str, seed: int, camera: str | None, warm: bool = False
) -> Iterator[tuple[EventPacket, Any]]:
    """Yield a scene's packets, each with the times and positions of its markers.

    Args:
        name: Name of the scene, or its file.
        seed: Seed of its variations and noise.
        camera: Preset of the camera; None is the scene's own.
        warm: Compile everything first: the first contact would stop time.
    """
    from spikingtac.sim.source import SceneSource, touch_once

    if warm:
        touch_once(catalog.load_scene(name), seed)
    for step in SceneSource(catalog.load_scene(name).with_camera(camera), seed).steps():
        yield step.packet, (step.truth.marker_t_us, step.truth.marker_px)


def is_twin(source: str) -> bool:
    """Return whether a source is the address of a scene of the twin."""
    return is_address(source) and Address.parse(source).kind == "twin"


def twin_options(address: Address, seed: int = 0, camera: str | None = None) -> Options:
    """Return seed and camera preset of a twin's address, or those given where it names none.

    Raises:
        ConfigError: One of them is not valid.
    """
    preset = address.text("camera", camera or "", ("", *CAMERA_NAMES))
    return int(address.number("seed", seed, 0, LARGEST_SEED)), preset or None
