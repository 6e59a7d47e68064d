"""Access control: keep other web pages and other machines out.

Any page in the user's browser can reach a loopback port. The Host header is checked against DNS
rebinding and the Origin header against foreign pages. A random token is required wherever the
server is bound to more than loopback.
"""

from __future__ import annotations

import ipaddress
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

TOKEN_BYTES = 18
"""144 random bits in a URL of 24 characters."""
_HOST = re.compile(r"[A-Za-z0-9.\-]+(:\d+)?|\[[0-9A-Fa-f:.]+\](:\d+)?")


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


def page_headers(host: str, framed: bool = False) -> dict[str, str]:
    """Return the headers of every answer: own scripts and styles only, no frames, no caching.

    Args:
        host: The request's Host header, already checked, or an empty string for a refusal.
        framed: Whether one of the own pages shows others of them in frames.
    """
    frames = "'self'" if framed else "'none'"
    sockets = f" ws://{host} wss://{host}" if host else ""
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        f"connect-src 'self'{sockets}; "
        f"base-uri 'none'; form-action 'none'; frame-src {frames}; frame-ancestors {frames}"
    )
    return {
        "content-security-policy": policy,
        "x-content-type-options": "nosniff",
        "referrer-policy": "no-referrer",
        "cross-origin-opener-policy": "same-origin",
        "cross-origin-resource-policy": "same-origin",
        "cache-control": "no-store",
    }
