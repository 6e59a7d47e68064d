"""An arm driver in a process of its own, spoken to in lines of JSON over its standard streams.

ur_rtde is native code that a wrong answer of a controller can crash; a test must survive that. Run
as a script, this file is the process: it drives one URArm.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac import errors
from spikingtac.robot.arm import ArmState
from spikingtac.types import Pose

ANSWER = "answer: "


class RemoteArm:
    """A URArm in another process; see :class:`spikingtac.robot.arm.Arm`."""

    def __init__(self, host: str, **config: Any) -> None:
        command = [sys.executable, str(Path(__file__)), host, json.dumps(config)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            text=True,
        )  # fmt: skip
        try:
            self._read()
        except errors.SpikingTacError:
            self.end()
            raise

    def __enter__(self) -> RemoteArm:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._process.returncode is None:
            self.kill()

    def pose(self) -> Pose:
        position, rotation = self._call("pose")
        return Pose(np.array(position), np.array(rotation))

    def speed_mm_s(self) -> np.ndarray:
        return np.array(self._call("speed_mm_s"))

    def move_linear(self, target_mm: np.ndarray, speed_mm_s: float) -> None:
        self._call("move_linear", np.asarray(target_mm).tolist(), speed_mm_s)

    def stop(self) -> None:
        self._call("stop")

    def confirm_stop(self) -> None:
        self._call("confirm_stop")

    def state(self) -> ArmState:
        return ArmState(self._call("state"))

    def close(self) -> None:
        self._call("close")

    def end(self) -> int:
        """End the process and return its exit code."""
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        return self._process.wait(20.0)

    def kill(self) -> None:
        """End the process at once, as when this computer dies."""
        self._process.kill()
        self.end()

    def _call(self, name: str, *arguments: Any) -> Any:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([name, *arguments]) + "\n")
        self._process.stdin.flush()
        return self._read()

    def _read(self) -> Any:
        assert self._process.stdout is not None
        for line in self._process.stdout:  # ur_rtde prints there too
            if line.startswith(ANSWER):
                # ur_rtde may go on in the same line, from another thread.
                (kind, value), _ = json.JSONDecoder().raw_decode(line[len(ANSWER) :])
                if kind != "done":
                    raise getattr(errors, kind)(value)
                return value
        raise RuntimeError(f"the driver's process ended with {self._process.wait(20.0)}")


def main() -> None:
    """Drive one arm as told on the standard input."""
    from spikingtac.robot import ur

    arm = None

    def serve(name: str, *arguments: Any) -> Any:
        nonlocal arm
        if arm is None:
            for constant, value in json.loads(sys.argv[2]).items():
                setattr(ur, constant.upper(), value)
            arm = ur.URArm(sys.argv[1])
            time.sleep(0.05)
            return None
        value = getattr(arm, name)(*arguments)
        if isinstance(value, Pose):
            return [value.position_mm.tolist(), value.rotation.tolist()]
        if isinstance(value, ArmState):
            return value.value
        return value.tolist() if isinstance(value, np.ndarray) else value

    def answer(kind: str, value: Any) -> None:
        print("\n" + ANSWER + json.dumps([kind, value]), flush=True)

    for line in itertools.chain(['["open"]'], sys.stdin):
        _reply(serve, answer, line)


def _reply(serve: Any, answer: Any, line: str) -> None:
    try:
        answer("done", serve(*json.loads(line)))
    except errors.SpikingTacError as error:
        answer(type(error).__name__, str(error))


if __name__ == "__main__":
    main()
