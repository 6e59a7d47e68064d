"""Who may see the page; an address that cannot be served on is refused at once, with the reason."""

from __future__ import annotations

import os
import signal
import socket

import pytest

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.viewer.access import Gate, listen
from spikingtac.viewer.server import PageServer, serve

ELSEWHERE = "192.0.2.1"  # An address of documentation (RFC 5737): no machine has it.

LOCAL = {"host": "127.0.0.1:8765"}


@pytest.mark.parametrize(
    "host",
    [
        "",
        "evil.example",
        "evil.example:8765",
        "127.0.0.1.evil.example",
        "localhost.evil.example:8765",
        "192.168.0.7:8765",
        "localhost:80; script-src *",
        "localhost:80@evil.example",
    ],
)
def test_other_hosts_are_refused(host: str) -> None:
    assert "Host" in Gate().refusal({"host": host})


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "http://127.0.0.1:3000", "http://localhost:8765", "file://"],
)
def test_foreign_origins_are_refused(origin: str) -> None:
    assert "Origin" in Gate().refusal({**LOCAL, "origin": origin})


def test_beyond_loopback_a_token_is_needed() -> None:
    gate = Gate.for_host("0.0.0.0")
    assert len(gate.token) >= 24
    headers = {"host": "lab.example:8765"}
    assert "token" in gate.refusal(headers)
    assert "token" in gate.refusal(headers, "ü" + gate.token[1:])
    assert gate.refusal(headers, gate.token) == ""
    assert "Origin" in gate.refusal({**headers, "origin": "http://evil.example"}, gate.token)
    assert Gate.for_host("0.0.0.0").token != gate.token


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
    with pytest.raises(DeviceError, match=r"port 80 of .* is not permitted"):
        listen("127.0.0.1", 80)


def test_an_interrupt_that_comes_while_the_session_is_asked_is_not_lost() -> None:
    asked = 0

    def alive() -> bool:
        nonlocal asked
        asked += 1
        if asked == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return asked < 30

    serve(PageServer([], Gate()), listen("127.0.0.1", 0), alive)
    assert 3 <= asked < 30
