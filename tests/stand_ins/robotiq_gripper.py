"""A Robotiq gripper behind its ASCII socket on loopback."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable

FULL_TRAVEL_S = 0.1


class FakeGripper:
    """Listens on a free port; closes its fingers on an object, if there is one.

    Args:
        object_at: Position at which the fingers meet something, or None.
    """

    def __init__(self, object_at: int | None = None) -> None:
        self.object_at = object_at
        self.values = dict.fromkeys(("ACT", "STA", "GTO", "SPE", "FOR", "FLT"), 0)
        self.values |= dict.fromkeys(("POS", "PRE", "OBJ"), 3)
        self.silent = False
        self.bare_ack = False
        self.byte_period_s = 0.0
        self.answer_instead: str | None = None
        self._start = (0.0, 3)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._connections: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._start_thread(self._accept)

    def __enter__(self) -> FakeGripper:
        return self

    def __exit__(self, *exception: object) -> None:
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._threads[0].join(5.0)  # a connection may have come in meanwhile
        self.drop()
        for thread in self._threads:
            thread.join(5.0)

    def drop(self) -> None:
        """Cut the connections."""
        for connection in self._connections:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def _start_thread(self, work: Callable[..., None], *arguments: object) -> None:
        self._threads.append(threading.Thread(target=work, args=arguments, daemon=True))
        self._threads[-1].start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                self._connections.append(connection)
                self._start_thread(self._serve, connection)

    def _serve(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError, ValueError), connection, connection.makefile() as lines:
            for line in lines:
                if not self.silent:
                    self._send(connection, self._answer(line.split()).encode())

    def _send(self, connection: socket.socket, answer: bytes) -> None:
        """Send an answer, byte by byte where it is asked to be slow."""
        if self.byte_period_s == 0.0:
            connection.sendall(answer)
            return
        for byte in answer:
            time.sleep(self.byte_period_s)
            connection.sendall(bytes([byte]))

    def _answer(self, words: list[str]) -> str:
        if self.answer_instead is not None:
            return self.answer_instead + "\n"
        if words[0] == "GET":
            self._move()
            return f"{words[1]} {self.values[words[1]]}\n"
        self._set(words[1], int(words[2]))
        return "ack" if self.bare_ack else "ack\n"

    def _set(self, name: str, value: int) -> None:
        self._move()
        self.values[name] = value
        if name == "ACT":
            self.values["STA"] = 3 if value else 0
        if name == "POS":
            self.values["PRE"], self.values["POS"] = value, self._start[1]
            self._start = (time.monotonic(), self._start[1])

    def _move(self) -> None:
        """Let the fingers go on towards the asked position."""
        values, (start_s, origin) = self.values, self._start
        goal = values["PRE"]
        share = min((time.monotonic() - start_s) / FULL_TRAVEL_S, 1.0)
        place = round(origin + share * (goal - origin))
        closing = self.object_at is not None and goal > origin
        meets = closing and origin <= self.object_at <= place
        values["POS"] = self.object_at if meets and self.object_at is not None else place
        values["OBJ"] = 2 if meets else (3 if share == 1.0 else 0)
        if share == 1.0:
            self._start = (start_s, values["POS"])
