"""A Robotiq gripper behind its ASCII socket on loopback."""

import contextlib
import socket
import socketserver
import threading
import time


class FakeGripper(socketserver.ThreadingTCPServer):
    """Listens on a free port; closes its fingers on an object, if there is one.

    The fingers move on at each question about them, so that a client sees them move first.

    Args:
        object_at: Position at which the fingers meet something, or None.
    """

    daemon_threads = True

    def __init__(self, object_at: int | None = None) -> None:
        super().__init__(("127.0.0.1", 0), _Session)
        self.port = self.server_address[1]
        self.object_at = object_at
        self.values = dict.fromkeys(("ACT", "STA", "GTO", "SPE", "FOR", "FLT"), 0)
        self.values |= dict.fromkeys(("POS", "PRE", "OBJ"), 3)
        self.silent = self.bare_ack = False
        self.byte_period_s, self.sent_bytes = 0.0, 0
        self.answer_instead: str | None = None
        self.connections: list[socket.socket] = []
        threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True).start()

    def __exit__(self, *exception: object) -> None:
        self.shutdown()
        self.drop()
        self.server_close()

    def drop(self) -> None:
        """Cut the connections."""
        for connection in self.connections:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def answer(self, words: list[str]) -> str:
        """Return the answer to a line."""
        if self.answer_instead is not None:
            return self.answer_instead + "\n"
        values, name = self.values, words[1]
        if words[0] == "GET":
            told = f"{name} {values[name]}\n"
            if name in ("POS", "OBJ"):
                self._arrive()
            return told
        values[name] = int(words[2])
        if name == "ACT":
            values["STA"] = 3 if values["ACT"] else 0
        if name == "POS":
            values["PRE"], values["POS"], values["OBJ"] = values["POS"], self._place, 0
        return "ack" if self.bare_ack else "ack\n"

    _place = 3  # Where the fingers are.

    def _arrive(self) -> None:
        goal = self.values["PRE"]
        meets = self.object_at is not None and self._place <= self.object_at <= goal
        self._place = self.object_at if meets and self.object_at is not None else goal
        self.values |= {"POS": self._place, "OBJ": 2 if meets else 3}


class _Session(socketserver.StreamRequestHandler):
    server: FakeGripper

    def handle(self) -> None:
        self.server.connections.append(self.connection)
        with contextlib.suppress(OSError, ValueError):
            for line in self.rfile:
                if not self.server.silent:
                    for byte in self.server.answer(line.decode().split()).encode():
                        time.sleep(self.server.byte_period_s)
                        self.connection.sendall(bytes([byte]))
                        self.server.sent_bytes += 1
