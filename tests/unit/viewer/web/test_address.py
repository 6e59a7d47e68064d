"""An address that cannot be served on is refused at once, and says why."""

from __future__ import annotations

import errno
import gc
import os
import signal
import socket

import pytest
from starlette.applications import Starlette

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.viewer.web.access import check_address, unusable
from spikingtac.viewer.web.server import serve

ELSEWHERE = "192.0.2.1"
"""An address of documentation (RFC 5737): no machine has it."""


def test_a_taken_port_is_refused_before_anything_is_computed() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(DeviceError, match=f"{port} of 127.0.0.1 is in use.*--port N"):
            check_address("127.0.0.1", port)
    check_address("127.0.0.1", port)
    check_address("127.0.0.1", 0)


def test_another_machines_address_is_not_called_a_matter_of_ports() -> None:
    with pytest.raises(ConfigError, match=f"--host '{ELSEWHERE}' is no address of this machine"):
        check_address(ELSEWHERE, 0)


def test_an_interrupt_that_comes_while_the_session_is_asked_is_not_lost() -> None:
    asked = 0

    def alive() -> bool:
        nonlocal asked
        asked += 1
        if asked == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return asked < 30

    serve(Starlette(), "127.0.0.1", 0, lambda _: None, alive)
    assert 3 <= asked < 30


def test_a_forbidden_port_is_said_to_be() -> None:
    found = unusable("127.0.0.1", 80, PermissionError(errno.EACCES, "Permission denied"))
    assert "port 80 is not permitted" in str(found)


def test_a_port_that_is_taken_later_ends_without_a_traceback(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(DeviceError, match="is in use"):
            serve(Starlette(), "127.0.0.1", port, lambda _: None, lambda: True)
    gc.collect()  # a task's unread exception is told when the task is collected
    assert [record.getMessage() for record in caplog.records if record.name == "asyncio"] == []
