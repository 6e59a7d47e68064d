"""Two sessions played as one: commands of playback go to both."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

SHARED = frozenset({"play", "speed"})
"""Commands that go to both sessions, whatever their clocks."""
SEEK = "seek_us"


class Commanded(Protocol):
    """A session that greets and takes commands."""

    def command(self, name: str, value: Any) -> None:
        """Pass a command on; never waits."""
        ...

    def greeting(self, after: int) -> tuple[int, bytes] | None:
        """Return the latest greeting after a number, or None."""
        ...


class Together:
    """Passes the commands of two sessions' pages on.

    Args:
        sessions: The sessions.
        one_clock: Whether their times are on one clock: only then a time means the same to both.

    Attributes:
        commands: For each session, what takes the commands of its pages.
    """

    def __init__(self, sessions: Sequence[Commanded], *, one_clock: bool) -> None:
        self._sessions, self._one_clock = sessions, one_clock
        self._begun = not one_clock
        self.commands: list[Callable[[str, Any], None]] = [
            partial(self._pass_on, number) for number in range(len(sessions))
        ]

    def begin(self) -> None:
        """Bring both to the same time once both are ready; further calls do nothing."""
        if self._begun:
            return
        spans = self._spans_us()
        if spans is not None:
            self._begun = True
            self._pass_on(0, SEEK, max(first for first, _ in spans))

    def _pass_on(self, number: int, name: str, value: Any) -> None:
        both = name in SHARED or (name == SEEK and self._one_clock)
        if name == SEEK and both:
            value = self._within_both(value)
        for session in self._sessions if both else self._sessions[number : number + 1]:
            session.command(name, value)

    def _within_both(self, t_us: int) -> int:
        """Return the nearest time that both recordings hold, so that both go to the same one."""
        spans = self._spans_us()
        if spans is None:
            return t_us
        first_us, last_us = max(first for first, _ in spans), min(last for _, last in spans)
        return max(min(t_us, last_us), first_us)

    def _spans_us(self) -> list[tuple[int, int]] | None:
        """Return beginning and end of each recording, or None while one of them gets ready."""
        spans = []
        for session in self._sessions:
            greeting = session.greeting(0)
            overview = json.loads(greeting[1]).get("overview") if greeting else None
            if overview is None:
                return None
            spans.append((int(overview["t_start_us"]), int(overview["t_end_us"])))
        return spans
