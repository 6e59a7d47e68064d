"""A session in a process of its own, beside the server of its page.

A busy thread beside the tracking loop would stretch a step of half a millisecond to several, since
threads share one interpreter lock. Each session therefore runs in another process than the server.
"""

import json
import time
from collections.abc import Callable
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

from spikingtac.stream.host import Asker, Host
from spikingtac.stream.live import noise
from spikingtac.stream.real_time import meet_deadlines
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.record import EXPOSURE_US
from spikingtac.viewer.session import Session
from spikingtac.viewer.snapshot import FRAME_BYTES, GREETING_BYTES, snapshot
from spikingtac.viewer.source import EventStore, ViewSource

# Longest wait for a session to complete its tracks, s; an idle machine needs 0.1 s.
SHUTDOWN_S = 20.0
LOOK_S = 0.1  # Longest wait for a word of the session, s.
STOP = "stop"  # The last command of a session; pages cannot send it.
STARTING = "getting ready; the first start on a machine compiles for some seconds"

KEPT = 4  # Messages of the largest length that a ring holds: the latest is read meanwhile.
BUDGET_S = 600.0  # Time for the compilation of all kernels, s.


class SessionProcess(Host):
    """Starts a session in a process of its own and reads its latest frames.

    Args:
        open_view: Opens what is viewed, in the session's process.
        **session: Options of :func:`run_session`; a picture is whole once :meth:`stop` has
            returned.

    Attributes:
        frames: Ring of what changes.
        greetings: Ring of what is constant.
    """

    def __init__(self, open_view: Callable[[], ViewSource], **session: Any) -> None:
        work = partial(run_session, open_view=open_view, **session)
        super().__init__("the page", work, KEPT * FRAME_BYTES, KEPT * GREETING_BYTES)
        self.frames, self.greetings = self.rings

    def stop(self) -> dict[str, Any] | None:
        """Stop the process, and return the summary of what was shown; None where it hangs.

        Raises:
            Exception: What the session failed with.
        """
        summary = None
        if self.tell((STOP, None)):
            until_s = time.monotonic() + SHUTDOWN_S
            with suppress(EOFError):
                while time.monotonic() < until_s:
                    summary = self.receive(LOOK_S) or summary
            self.wait(SHUTDOWN_S)
        return summary

    def close(self) -> None:
        """Stop the process and release the shared memory."""
        try:
            with suppress(Exception):  # it was told where it mattered
                self.stop()
        finally:  # also where a second Ctrl-C cuts the wait short
            super().close()


def run_session(
    asker: Asker,
    open_view: Callable[[], ViewSource],
    repeat: bool = False,
    picture: Path | None = None,
    realtime: bool = False,
) -> None:
    """Open a view and play it until the asker ends it, who is told the summary.

    Args:
        asker: Sends commands, and is told of an error.
        open_view: Opens what is viewed.
        repeat: Begin again at the end.
        picture: File for the summary picture, or None.
        realtime: Ask for what helps to keep deadlines.

    Raises:
        SpikingTacError: The view could not be opened, or failed.
    """
    asker.grace_s = SHUTDOWN_S
    frames, greetings = asker.rings
    view = open_view()
    first = {"label": view.label, "simulated": view.simulated, "starting": STARTING}
    greetings.publish(json.dumps(first).encode())
    warm_up(view)
    granted = meet_deadlines() if realtime else ""
    session = Session(view, frames.publish, greetings.publish, repeat=repeat)
    session.warn(granted)
    try:
        while not asker.gone.is_set():
            # Of a dragged slider or timeline only the last position counts.
            said = {(name, name == "set" and value[0]): value for name, value in asker.said()}
            if (STOP, False) in said:
                break
            for (name, _), value in said.items():
                session.command(name, value)
            session.step()
            session.rest()
        if picture is not None:
            session.record.save_picture(picture, session.playback)
        asker.tell(session.record.summary(session.playback))
    finally:
        session.close()
    if session.failure is not None:
        raise session.failure


def warm_up(view: ViewSource) -> None:
    """Track noise with a tracker of the view's, and discard both.

    A simulated sensor compiles its kernels in a process of its own. Compiling those of the tracker
    meanwhile, instead of waiting for the first event, halves the time of the first start.
    """
    with closing(EventStore(noise(view.source.size))) as store:
        playback = Playback(store, view)
        playback.aim(store.t_end_us)
        playback.work(BUDGET_S)
        snapshot(playback, EXPOSURE_US, False)
