"""The loop that plays, tracks and publishes; it runs in a process of its own."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from spikingtac.errors import ConfigError, SpikingTacError
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.pipeline.checked_source import CheckedSource
from spikingtac.schema import to_mapping
from spikingtac.stream.shared_memory import Publisher
from spikingtac.tuning import with_value
from spikingtac.types import MarkerFrame
from spikingtac.viewer.pace import Pacer, StreamHealth
from spikingtac.viewer.record import EXPOSURE_US, Record, TrackFile
from spikingtac.viewer.replay.event_store import EventStore
from spikingtac.viewer.replay.playback import Playback
from spikingtac.viewer.snapshot import greeting, images, map_of, moving
from spikingtac.viewer.source import ViewSource
from spikingtac.viewer.web.wire import encode

FRAME_HZ = 60.0  # Frames offered per second; displays show no more.

# Share of a frame's time that tracking may take before the frame is published anyway.
WORK_SHARE = 0.7
GREETING_S = 0.5  # How often the greeting is renewed while the length of the source still grows.

# Further behind its aim, tracking repeats a stretch; the page keeps its picture meanwhile.
CATCHING_UP_US = 50_000
SLACK_US = 40_000  # A delay of up to this is made up for; a longer one stretches the time.


class Session:
    """One view, played under the commands of its pages.

    Attributes:
        playback: The tracked stream.
        playing: False while paused.
        speed: Seconds of the recording per second.
        failure: What ended a live source, or None; what came before it can still be viewed.
    """

    def __init__(
        self,
        view: ViewSource,
        frames: Publisher,
        greetings: Publisher,
        *,
        repeat: bool = False,
        tracks: Path | None = None,
    ) -> None:
        """Open a view.

        Args:
            view: What is shown.
            frames: Takes the frame messages.
            greetings: Takes the greeting, as JSON.
            repeat: Begin again at the end instead of pausing there.
            tracks: File for every estimate, or None.
        """
        self.record = Record()
        self._tracks = TrackFile(tracks, view.calibration.reference_px) if tracks else None
        self._notice, self._retuned = view.notice, False
        source = view.source
        # Looking at events needs no calibration.
        if len(view.calibration.reference_px) and not view.own_calibration:
            source = CheckedSource(source, view.calibration, self.warn)
        store = EventStore(source)
        if view.ends:
            store.extend_to_end()
        if view.desk is not None:
            view.desk.begin_anew()  # the kernels were warmed up with it
        self._view, self._config = view, view.config
        self._frames, self._greetings, self._repeat = frames, greetings, repeat
        self.playback = self._tracked(store)
        self.playing, self.speed = True, 1.0
        self._exposure_us, self._with_map = EXPOSURE_US, False
        self._playhead_us = float(store.t_start_us)
        self.pacer = Pacer(1 / FRAME_HZ)
        self._shown: tuple[dict[str, Any], dict[str, NDArray[Any]]] | None = None
        self._greeted_s = 0.0
        self.failure: Exception | None = None
        self._health = None if view.ends else StreamHealth(lambda: store.waited_s)

    def command(self, name: str, value: Any) -> None:
        """Carry out a command of a page (already parsed); a refusal becomes a notice."""
        actions: dict[str, Callable[[Any], object]] = {
            "play": self._play,
            "speed": lambda speed: setattr(self, "speed", float(speed)),
            "seek_us": self._seek,
            "exposure_us": lambda exposure: setattr(self, "_exposure_us", exposure),
            "map": lambda shown: setattr(self, "_with_map", shown),
            "set": self._set,
            "defaults": lambda _: self._retune(self._view.config),
            "reset": lambda _: self._health.reset() if self._health else None,
            "calibrate": lambda _: self._calibrate(),
            "list": lambda _: setattr(self, "_greeted_s", 0.0),
            "begin_anew": lambda _: self._view.desk.begin_anew() if self._view.desk else None,
        }
        if name in actions:
            actions[name](value)

    def warn(self, why: str) -> None:
        """Add a line to the page's notice, and greet the page anew."""
        self._notice, self._greeted_s = f"{self._notice} {why}".strip(), 0.0

    def step(self) -> None:
        """Play on by one frame, publish it, and wait for the time of the next one."""
        self.pacer.begin()
        self._adopt_calibration()
        start_us = self.playback.position_us
        # Where tracking cannot keep up, the playhead waits: time slows down, no event is skipped.
        if self.playing and self.playback.aim_us - start_us <= SLACK_US:
            self._playhead_us += self.speed * 1e6 / FRAME_HZ
            self.playback.aim(int(self._playhead_us))
        reached = self._work()
        if self.playing and reached and self._playhead_us >= self._last_us():
            self._play(self._repeat)
        self.record.take(self._view, self.playback)
        self._publish(start_us, reached)
        self.pacer.wait()

    def summary(self, picture: Path | None = None) -> dict[str, Any]:
        """Return the figures of what was shown so far, and draw it where a file is given.

        Raises:
            ConfigError: A picture is asked for, and nothing was shown.
        """
        if picture is not None:
            self.record.save_picture(picture, self._view, self.playback)
        return self.record.summary(self._view, self.playback)

    def close(self, before: Callable[[], object] = lambda: None) -> None:
        """Complete the tracks, remove the stored events, end a source that runs by itself.

        Args:
            before: Called once the tracks are complete, while the events are still there.
        """
        if self._tracks is not None:
            self._tracks.close(
                {
                    **self._view.provenance,
                    **self._view.calibration.scale(),
                    "config": {"tracking": to_mapping(self._config)},
                    "losses": dict(self._view.source.losses),
                    "simulated": self._view.simulated,
                    "retuned": self._retuned,
                }
            )
        try:
            before()
        finally:
            if self._view.desk is not None:
                self._view.desk.close()
            self.playback.store.close()
            self._view.close()

    @property
    def view(self) -> ViewSource:
        """What is shown now."""
        return self._view

    def _work(self) -> bool:
        """Track for a frame's time; True once the aim is reached or the source is lost."""
        if self._health is None:
            return self.playback.work(WORK_SHARE / FRAME_HZ)
        try:
            reached = self.playback.work(WORK_SHARE / FRAME_HZ)
        except (SpikingTacError, OSError, RuntimeError) as error:
            self.failure = error
            self._health.lost(str(error))
            self.playback.aim(self.playback.position_us)
            return True
        self._health.delivered()
        return reached

    def _take(self, frame: MarkerFrame) -> None:
        """Take every estimate; the pages see some of them."""
        self.record.estimate(frame)
        if self._tracks is not None:
            self._tracks.take(frame)
        if self._view.felt is not None:
            self._view.felt.take(frame)

    def _tracked(self, store: EventStore) -> Playback:
        view = self._view
        return Playback(
            store,
            self._tracker,
            view.make_detector,
            rate_hz=view.rate_hz,
            on_frame=self._take,
        )

    def _calibrate(self) -> None:
        if self._view.desk is not None:
            self._view.desk.calibrate(self.playback.store, self.playback.position_us)

    def _adopt_calibration(self) -> None:
        """Track the markers from now on, once the page's calibration is there."""
        found = self._view.desk.poll() if self._view.desk else None
        if found is None:
            return
        aim_us = self.playback.aim_us
        self._view = self._view.calibrated(self._view, found)
        self._config, self._notice = self._view.config, ""
        self.playback = self._tracked(self.playback.store)
        self.playback.aim(aim_us)
        if self._view.ends:  # a recording is played again, now with its markers
            self._play(True)
            self._seek(self.playback.store.t_start_us)
        self._greeted_s = 0.0

    def _tracker(self) -> MarkerTracker:
        return self._view.make_tracker(self._config)

    def _play(self, playing: bool) -> None:
        if playing and self._playhead_us >= self._last_us():
            self._seek(self.playback.store.t_start_us)
        self.playing = playing

    def _seek(self, t_us: int) -> None:
        store = self.playback.store
        self._playhead_us = float(min(max(t_us, store.t_start_us), store.t_end_us))
        self.playback.aim(int(self._playhead_us))

    def _last_us(self) -> float:
        """Return where playing ends: at the end of the source, or never while it goes on."""
        store = self.playback.store
        return store.t_end_us if store.ended else float("inf")

    def _set(self, setting: list[Any]) -> None:
        try:
            self._retune(with_value(self._config, setting[0], setting[1]))
        except ConfigError as error:
            self._notice = str(error)

    def _retune(self, config: Any) -> None:
        self._config, self._notice, self._retuned = config, "", True
        self.playback.aim(self.playback.position_us)
        self.playback.retune(self._tracker)
        self._greeted_s = 0.0

    def _publish(self, start_us: int, reached: bool) -> None:
        self._greet()
        behind_us = self.playback.aim_us - self.playback.position_us
        catching_up = not reached and behind_us > CATCHING_UP_US
        if not catching_up or self._shown is None:
            self._shown = self._snapshot()
        scalars, arrays = self._shown
        advanced_us = self.playback.position_us - start_us
        state = "OK" if reached else "CATCHING UP" if catching_up else "OVERLOAD"
        state = "DISCONNECTED" if self.failure is not None else state
        status = {
            "stamp_ms": round(time.time() * 1e3, 3),
            "playing": self.playing,
            "speed": self.speed,
            "pace": 0.0 if catching_up else round(advanced_us / 1e6 * FRAME_HZ, 3),
            "behind_us": behind_us,
            "state": state,
            "overruns": self.pacer.overruns,
            "watchdog": self._health.told() if self._health else None,
            "exposure_us": self._exposure_us,
            "notice": self._notice,
            "displacement_max_px": round(self.record.largest_px, 3),
            "contacts_found": len(self.playback.contacts),
        }
        if not self._frames.publish(encode({**scalars, **status}, arrays)):
            raise ValueError("a frame is larger than the ring's slots")

    def _greet(self) -> None:
        now_s = time.monotonic()
        growing = not self.playback.store.ended and now_s - self._greeted_s > GREETING_S
        if not self._greeted_s or growing:
            document = greeting(self._view, self.playback, self._config)
            self._greetings.publish(json.dumps(document).encode())
            self._greeted_s = now_s

    def _snapshot(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        scalars, arrays = moving(self._view, self.playback)
        scalars["losses"] = dict(self._view.source.losses)
        state_map = map_of(self.playback) if self._with_map else None
        return scalars, {**arrays, **images(self.playback, self._exposure_us, state_map)}
