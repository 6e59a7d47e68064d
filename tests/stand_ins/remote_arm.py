"""An arm driver in a process of its own.

ur_rtde is native code that a wrong answer of a controller can crash; a test must survive that.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import time
from functools import partial
from typing import Any

from spikingtac.errors import SpikingTacError
from spikingtac.robot import ur

METHODS = ("pose", "speed_mm_s", "move_linear", "stop", "confirm_stop", "state", "close")


def drive(pipe: Any, host: str, constants: dict[str, Any]) -> None:
    """Open an arm and call its methods as told, until the pipe is closed."""
    for name, value in constants.items():
        setattr(ur, name.upper(), value)
    try:
        arm = ur.URArm(host)
    except SpikingTacError as error:
        pipe.send(error)
        return
    time.sleep(0.05)
    pipe.send(None)
    with contextlib.suppress(EOFError):
        while True:
            name, arguments = pipe.recv()
            try:
                pipe.send(getattr(arm, name)(*arguments))
            except SpikingTacError as error:
                pipe.send(error)


class RemoteArm(contextlib.AbstractContextManager["RemoteArm"]):
    """A URArm in another process, with the methods of :class:`spikingtac.robot.arm.Arm`.

    Args:
        host: The controller's address.
        constants: What replaces constants of :mod:`spikingtac.robot.ur`.
    """

    def __init__(self, host: str, **constants: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, there = context.Pipe()
        self._process = context.Process(target=drive, args=(there, host, constants), daemon=True)
        self._process.start()
        there.close()
        for name in METHODS:
            setattr(self, name, partial(self._call, name))
        try:
            self._answer()
        except SpikingTacError:
            self.kill()
            raise

    def __exit__(self, *exception: object) -> None:
        self.kill()

    def end(self) -> int | None:
        """End the process and return its exit code."""
        self._pipe.close()
        self._process.join(20.0)
        return self._process.exitcode

    def kill(self) -> None:
        """End the process at once, as when this computer dies."""
        self._process.kill()
        self.end()

    def _call(self, name: str, *arguments: Any) -> Any:
        self._pipe.send((name, arguments))
        return self._answer()

    def _answer(self) -> Any:
        answer = self._pipe.recv()  # an EOFError: the driver's process has ended
        if isinstance(answer, Exception):
            raise answer
        return answer
