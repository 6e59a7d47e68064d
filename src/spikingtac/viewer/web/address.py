"""The address that a page is served on: whether it can be, and how a user reaches it."""

from __future__ import annotations

import errno
import socket

from spikingtac.errors import ConfigError, DeviceError, SpikingTacError

LAST_PORT = 65_535
"""Largest port number of TCP (RFC 793: 16 bits)."""
VALID_HOSTS = "valid are 127.0.0.1 (this machine alone) and 0.0.0.0 (every network that it is on)"


def check_address(host: str, port: int) -> None:
    """Refuse an address that no page can be served on, before anything is computed.

    Args:
        host: Address to bind to.
        port: Port, or 0 for any free one.

    Raises:
        ConfigError: The port is out of range, or the host is no address of this machine.
        DeviceError: The port is taken, or not permitted.
    """
    if not 0 <= port <= LAST_PORT:
        raise ConfigError(f"--port is {port}, valid is 0 (any free one) to {LAST_PORT}")
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise ConfigError(
            f"--host {host!r} is no address of this machine ({error}); {VALID_HOSTS}"
        ) from error
    family, kind, _, _, address = found[0]
    with socket.socket(family, kind) as probe:
        # As the server does: a port whose last connections fade away is free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError as error:
            raise unusable(host, port, error) from error


def unusable(host: str, port: int, error: BaseException | None) -> SpikingTacError:
    """Return the error of an address that the system refuses.

    Args:
        host: Address that was asked for.
        port: Its port.
        error: What the system said.
    """
    why = error.errno if isinstance(error, OSError) else None
    if why == errno.EADDRNOTAVAIL:
        return ConfigError(f"--host {host!r} is no address of this machine; {VALID_HOSTS}")
    if why in (errno.EACCES, errno.EPERM):
        return DeviceError(
            f"port {port} is not permitted (those below 1024 seldom are); give another one: "
            "--port N, or --port 0 for any free one"
        )
    return DeviceError(
        f"port {port} of {host} is in use, by another page perhaps; give another one: --port N, "
        "or --port 0 for any free one"
    )


def addresses(host: str, port: int, token: str) -> list[str]:
    """Return what a user needs to reach the page, here and from another machine."""
    query = f"/?token={token}" if token else "/"
    return [
        f"open {page_url(host, port, token)} (Ctrl-C ends)",
        f"from another machine: ssh -N -L {port}:127.0.0.1:{port} THIS_MACHINE, "
        f"then http://127.0.0.1:{port}{query}",
    ]


def page_url(host: str, port: int, token: str) -> str:
    """Return the page's address for a browser."""
    shown = f"[{host}]" if ":" in host else host
    return f"http://{shown}:{port}/" + (f"?token={token}" if token else "")
