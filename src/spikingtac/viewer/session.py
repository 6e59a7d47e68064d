"""The loop that plays, tracks and publishes; it runs in a process of its own."""

import json
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from spikingtac.errors import ConfigError, SpikingTacError
from spikingtac.pipeline.follow import CheckedSource
from spikingtac.tuning import with_value
from spikingtac.types import MarkerFrame
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.record import EXPOSURE_US, Record
from spikingtac.viewer.snapshot import encode, greeting, snapshot
from spikingtac.viewer.source import MOST_EVENTS, EventStore, ViewSource

Publish = Callable[[bytes], object]  # Offers a message to whoever looks; never waits.
FRAME_HZ = 60.0  # Frames offered per second; displays show no more.

# Share of a frame's time that tracking may take before the frame is published anyway.
WORK_SHARE = 0.7
GREETING_S = 0.5  # How often the greeting is renewed while the length of the source still grows.

# Further behind its aim, tracking repeats a stretch; the page keeps its picture meanwhile.
CATCHING_UP_US = 50_000
SLACK_US = 40_000  # A delay of up to this is made up for; a longer one stretches the time.


class Session:
    """One view, played under the commands of its pages.

    Args:
        view: What is shown.
        publish: Takes a frame message.
        greet: Takes a greeting, JSON.
        repeat: Begin again at the end instead of pausing there.

    Attributes:
        playback: The tracked stream, with the view.
        record: What was shown so far.
        playing: False while paused.
        speed: Seconds of the recording per second.
        failure: What ended a live source, or None; what came before it can still be viewed.
    """

    def __init__(
        self, view: ViewSource, publish: Publish, greet: Publish, *, repeat: bool = False
    ) -> None:
        self._send_frame, self._send_greeting, self._repeat = publish, greet, repeat
        self.record, self._notice = Record(), ""
        source = view.source
        # Looking at events needs no calibration.
        if len(view.calibration.reference_px) and not view.own_calibration:
            source = CheckedSource(source, view.calibration, self.warn)
        store = EventStore(source, float("inf") if view.ends else MOST_EVENTS)
        if view.ends:
            store.extend_to(float("inf"))
        if view.desk is not None:
            view.desk.begin_anew()  # the kernels were warmed up with it
        self._show(store, view)
        self.playing, self.speed = True, 1.0
        self._exposure_us, self._with_map = EXPOSURE_US, False
        self._playhead_us = float(store.t_start_us)
        self._shown: tuple[dict[str, Any], dict[str, NDArray[Any]]] | None = None
        self.failure: Exception | None = None
        self._overruns, self._due_s = 0, time.perf_counter() + 1 / FRAME_HZ

    def command(self, name: str, value: Any) -> None:
        """Carry out a command of a page (already parsed); a refusal becomes a notice."""
        playback = self.playback
        desk, store = playback.view.desk, playback.store
        actions: dict[str, Callable[[], object]] = {
            "play": lambda: self._play(value),
            "speed": lambda: setattr(self, "speed", float(value)),
            "seek_us": lambda: self._seek(value),
            "exposure_us": lambda: setattr(self, "_exposure_us", value),
            "map": lambda: setattr(self, "_with_map", value),
            "set": lambda: self._retune(with_value(playback.config, *value)),
            "defaults": lambda: self._retune(playback.view.config),
        }
        if desk is not None:
            actions["calibrate"] = lambda: desk.calibrate(store.between, playback.position_us)
            actions["begin_anew"] = desk.begin_anew
        try:
            actions.get(name, lambda: None)()
        except ConfigError as error:
            self._notice = str(error)

    def warn(self, why: str) -> None:
        """Add a line to the page's notice, and greet the page anew."""
        self._notice, self._greeted_s = f"{self._notice} {why}".strip(), 0.0

    def step(self) -> None:
        """Play on by one frame, and publish it."""
        self._adopt_calibration()
        start_us = self.playback.position_us
        # Where tracking cannot keep up, the playhead waits: time slows down, no event is skipped.
        if self.playing and self.playback.aim_us - start_us <= SLACK_US:
            self._playhead_us += self.speed * 1e6 / FRAME_HZ
            self.playback.aim(int(self._playhead_us))
        reached = self._work()
        if self.playing and reached and self._at_end():
            self._play(self._repeat)
        self.record.take(self.playback)
        self._greet()
        self._publish(start_us, reached)

    def rest(self) -> None:
        """Sleep until the next frame is due; a late one delays the loop, no burst makes up."""
        now_s = time.perf_counter()
        self._overruns += now_s > self._due_s
        time.sleep(max(self._due_s - now_s, 0.0))
        self._due_s = max(self._due_s, now_s) + 1 / FRAME_HZ

    def close(self) -> None:
        """End what runs by itself: the source, and a calibration that goes on."""
        if (desk := self.playback.view.desk) is not None:
            desk.close()
        self.playback.store.close()

    def _show(self, store: EventStore, view: ViewSource) -> None:
        """Begin to track a view's events."""
        self.playback, self._greeted_s = Playback(store, view, self._take), 0.0

    def _work(self) -> bool:
        """Track for a frame's time; True once the aim is reached or the source is lost."""
        playback = self.playback
        try:
            return playback.work(WORK_SHARE / FRAME_HZ)
        except (SpikingTacError, OSError, RuntimeError) as error:
            if playback.view.ends:
                raise
            self.failure = error
            playback.aim(playback.position_us)
            return True

    def _take(self, frame: MarkerFrame) -> None:
        """Take every estimate; the pages see some of them."""
        self.record.estimate(frame)
        if self.playback.view.felt is not None:
            self.playback.view.felt.take(frame)

    def _adopt_calibration(self) -> None:
        """Track the markers from now on, once the page's calibration is there."""
        store, view, aim_us = self.playback.store, self.playback.view, self.playback.aim_us
        if (desk := view.desk) is None or (found := desk.poll()) is None:
            return
        self._notice = ""
        self._show(store, replace(view, **desk.tracked_by(found)))
        self.playback.aim(aim_us)
        if view.ends:  # a recording is played again, now with its markers
            self._play(True)
            self._seek(store.t_start_us)

    def _play(self, playing: bool) -> None:
        if playing and self._at_end():
            self._seek(self.playback.store.t_start_us)
        self.playing = playing

    def _seek(self, t_us: int) -> None:
        store = self.playback.store
        self._playhead_us = float(min(max(t_us, store.kept_from_us), store.t_end_us))
        self.playback.aim(int(self._playhead_us))

    def _at_end(self) -> bool:
        store = self.playback.store
        return store.ended and self._playhead_us >= store.t_end_us

    def _retune(self, config: Any) -> None:
        self._notice, self._greeted_s = "", 0.0
        self.playback.aim(self.playback.position_us)
        self.playback.retune(config)

    def _greet(self) -> None:
        now_s = time.monotonic()
        growing = not self.playback.store.ended and now_s - self._greeted_s > GREETING_S
        if growing or not self._greeted_s:
            self._send_greeting(json.dumps(greeting(self.playback)).encode())
            self._greeted_s = now_s

    def _publish(self, start_us: int, reached: bool) -> None:
        playback = self.playback
        catching_up = not reached and playback.aim_us - playback.position_us > CATCHING_UP_US
        if not catching_up or self._shown is None:
            self._shown = snapshot(playback, self._exposure_us, self._with_map)
        scalars, arrays = self._shown
        advanced_us = playback.position_us - start_us
        state = "OK" if reached else "CATCHING UP" if catching_up else "OVERLOAD"
        status = {
            "stamp_ms": round(time.time() * 1e3, 3),
            "playing": self.playing,
            "speed": self.speed,
            "pace": 0.0 if catching_up else round(advanced_us / 1e6 * FRAME_HZ, 3),
            "state": "DISCONNECTED" if self.failure is not None else state,
            "overruns": self._overruns,
            "failure": None if self.failure is None else str(self.failure),
            "notice": self._notice,
        }
        self._send_frame(encode({**scalars, **status}, arrays))
