"""Who may see the page, and where it is served.

Any page in the user's browser can reach a loopback port. The Host header is checked against DNS
rebinding and the Origin header against foreign pages. A random token is required wherever the
server is bound to more than loopback.
"""

from __future__ import annotations

import errno
import ipaddress
import os
import re
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

from spikingtac.errors import ConfigError, DeviceError

TOKEN_BYTES = 18  # 144 random bits in a URL of 24 characters.
_HOST = re.compile(r"[A-Za-z0-9.\-]+(:\d+)?|\[[0-9A-Fa-f:.]+\](:\d+)?")


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """How a page is served.

    Attributes:
        host: Address to serve on; beyond loopback the printed address carries a random token.
        port: Port, or 0 for any free one.
        no_browser: Serve the page, but open no browser.
        seconds: Duration, s; without end unless given (10 for a camera or a scene with --headless).
    """

    host: str = "127.0.0.1"
    port: int = 8765
    no_browser: bool = False
    seconds: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Gate:
    """Accepts or refuses requests by their headers.

    Attributes:
        token: Needed in the query, or an empty string where the server is bound to loopback.
    """

    token: str = ""

    @classmethod
    def for_host(cls, host: str) -> Gate:
        """Return the gate of a server bound to ``host``; a token guards all but loopback."""
        return cls(token="" if is_loopback(host) else secrets.token_urlsafe(TOKEN_BYTES))

    def refusal(self, headers: Mapping[str, str], token: str | None = None) -> str:
        """Return why a request is refused, or an empty string.

        Args:
            headers: With lower-case names.
            token: What the request brought.
        """
        host = headers.get("host", "")
        if refusal := self.host_refusal(host):
            return refusal
        origin = headers.get("origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return f"the Origin {origin!r} is foreign"
        if self.token and not secrets.compare_digest((token or "").encode(), self.token.encode()):
            return "the token is missing or wrong; open the address that the command printed"
        return ""

    def host_refusal(self, host: str) -> str:
        """Return why a Host header is refused, or an empty string.

        Args:
            host: The header, or an empty string where the request brought none.
        """
        if not _HOST.fullmatch(host):
            return "the Host header is missing or malformed"
        if not self.token and not is_loopback(urlsplit(f"//{host}").hostname or ""):
            return f"the Host {host!r} is not this machine's loopback name"
        return ""


def is_loopback(host: str) -> bool:
    """Return True for ``localhost`` and for loopback addresses."""
    try:
        return host == "localhost" or ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def page_headers(host: str) -> dict[str, str]:
    """Return the headers of every answer: own scripts and styles only, no frames, no caching.

    Args:
        host: The request's Host header, already checked, or an empty string for a refusal.
    """
    sockets = f" ws://{host} wss://{host}" if host else ""
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        f"connect-src 'self'{sockets}; "
        "base-uri 'none'; form-action 'none'; frame-src 'none'; frame-ancestors 'none'"
    )
    return {
        "content-security-policy": policy,
        "x-content-type-options": "nosniff",
        "referrer-policy": "no-referrer",
        "cross-origin-opener-policy": "same-origin",
        "cross-origin-resource-policy": "same-origin",
        "cache-control": "no-store",
    }


LAST_PORT = 65_535  # Largest port number of TCP (RFC 793: 16 bits).

# What the system says of a port that is taken, or not permitted.
REFUSED = (errno.EADDRINUSE, errno.EACCES, errno.EPERM)


def listen(host: str, port: int) -> socket.socket:
    """Take an address for the page, before anything is computed.

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
        return socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET
        )
    except (OSError, TypeError) as error:
        code = getattr(error, "errno", None) or 0
        if code in REFUSED:
            raise DeviceError(
                f"port {port} of {host} cannot be used ({os.strerror(code)}); give another "
                "one: --port N, or --port 0 for any free one"
            ) from error
        raise ConfigError(
            f"--host {host!r} is no address of this machine; valid are 127.0.0.1 (this machine "
            "alone) and 0.0.0.0 (every network that it is on)"
        ) from error
