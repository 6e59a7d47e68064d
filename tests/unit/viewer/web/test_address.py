"""An address that cannot be served on is refused at once, and says why."""

from __future__ import annotations

import os
import signal
import socket

import pytest
from starlette.applications import Starlette

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.viewer.web.access import listen
from spikingtac.viewer.web.server import serve

ELSEWHERE = "192.0.2.1"  # An address of documentation (RFC 5737): no machine has it.


def test_a_taken_port_is_refused_before_anything_is_computed() -> None:
    with listen("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(DeviceError, match=f"{port} of 127.0.0.1 is in use.*--port N"):
            listen("127.0.0.1", port)
    listen("127.0.0.1", port).close()


def test_another_machines_address_is_not_called_a_matter_of_ports() -> None:
    with pytest.raises(ConfigError, match=f"--host '{ELSEWHERE}' is no address of this machine"):
        listen(ELSEWHERE, 0)


def test_a_forbidden_port_is_said_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbid(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(socket.socket, "bind", forbid)
    with pytest.raises(DeviceError, match="port 80 is not permitted"):
        listen("127.0.0.1", 80)


def test_an_interrupt_that_comes_while_the_session_is_asked_is_not_lost() -> None:
    asked = 0

    def alive() -> bool:
        nonlocal asked
        asked += 1
        if asked == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return asked < 30

    serve(Starlette(), listen("127.0.0.1", 0), alive)
    assert 3 <= asked < 30
