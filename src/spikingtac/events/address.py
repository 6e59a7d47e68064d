"""Addresses of cameras: ``KIND:TARGET?option=value&option=value``, wherever a recording is named.

``openmv:/dev/ttyACM0``, ``udp:7777?encoding=evt2&size=320x320``, ``dv://127.0.0.1:7777``, ``nd:``.
"""

import re
import stat
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from spikingtac.errors import ConfigError, nearest

_FORM = re.compile(r"(?P<kind>[a-z][a-z0-9]+):(?P<target>[^?]*)(?:\?(?P<options>.*))?", re.DOTALL)

# Schemes of files elsewhere: no cameras.
_NET = frozenset({"http", "https", "ftp", "ftps", "file", "rtsp", "ssh", "s3"})
STANDARD_INPUT = "-"  # The path that means standard input.
_SIZE = re.compile(r"([1-9]\d{0,4})x([1-9]\d{0,4})")


@dataclass(frozen=True, kw_only=True)
class Address:
    """The address of a camera, taken apart.

    Attributes:
        kind: How the camera is reached, as ``udp``.
        target: Which one: a device, a port, a host, a scene; may be empty.
        options: What stands behind the question mark.
    """

    kind: str
    target: str = ""
    options: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str | Path) -> Self:
        """Take an address apart.

        Example:
            >>> address = Address.parse("udp:7777?encoding=evt2&size=320x320")
            >>> address.kind, address.target, address.size("size")
            ('udp', '7777', (320, 320))

        Raises:
            ConfigError: It is none, or an option is not ``name=value`` or stands twice.
        """
        found = _FORM.fullmatch(str(text))
        if found is None:
            raise ConfigError(
                f"{str(text)!r} is no address of a camera; it has the form "
                "KIND:TARGET?option=value&option=value, as udp:7777?encoding=evt2&size=320x320"
            )
        options: dict[str, str] = {}
        for part in filter(None, (found["options"] or "").split("&")):
            name, equals, value = part.partition("=")
            if not equals or not name or name in options:
                raise ConfigError(
                    f"{str(text)!r}: {part!r} must be name=value, each name once, joined by &"
                )
            options[name] = value
        return cls(kind=found["kind"], target=found["target"], options=options)

    def __str__(self) -> str:
        options = "&".join(f"{name}={value}" for name, value in self.options.items())
        return f"{self.kind}:{self.target}" + (f"?{options}" if options else "")

    def require_options(self, valid: Iterable[str]) -> None:
        """Refuse an option that this kind of camera does not have.

        Raises:
            ConfigError: Names the first unknown option and the nearest valid one.
        """
        names = list(valid)
        for name in self.options:
            if name not in names:
                raise ConfigError(
                    f"{str(self)!r}: {self.kind} has no option {name!r}{nearest(name, names)} "
                    f"(valid: {', '.join(names)})"
                )

    def text(self, name: str, default: str = "", valid: Iterable[str] = ()) -> str:
        """Return an option, one of the valid values where such are named.

        Raises:
            ConfigError: It is none of them.
        """
        value, choices = self.options.get(name, default), list(valid)
        if choices and value not in choices:
            raise self._misfit(name, f"one of {', '.join(choices)}{nearest(value, choices)}")
        return value

    def number(self, name: str, default: float, low: float, high: float) -> float:
        """Return an option as a number from ``low`` to ``high``.

        Raises:
            ConfigError: It is no number, or outside.
        """
        try:
            value = float(self.options.get(name, default))
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise self._misfit(name, f"a number from {low:g} to {high:g}")
        return value

    def size(self, name: str) -> tuple[int, int] | None:
        """Return an option ``WIDTHxHEIGHT`` in px, or None where it is not given.

        Raises:
            ConfigError: It is no size.
        """
        text = self.options.get(name)
        if text is None:
            return None
        found = _SIZE.fullmatch(text)
        if found is None:
            raise self._misfit(name, "WIDTHxHEIGHT in px, as 320x320")
        return int(found[1]), int(found[2])

    def _misfit(self, name: str, valid: str) -> ConfigError:
        given = self.options.get(name)
        return ConfigError(f"{str(self)!r}: {name} is {given!r}, it must be {valid}")

    def host_port(self, host: str, low: int = 1) -> tuple[str, int]:
        """Return the target ``PORT`` or ``HOST:PORT`` (slashes before it are passed over).

        Args:
            host: Host where the target names none.
            low: Least port; 0 lets the system choose one.

        Raises:
            ConfigError: There is no such port.
        """
        named, _, port = self.target.lstrip("/").rpartition(":")
        if not port.isdecimal() or not low <= int(port) < 1 << 16:
            raise ConfigError(
                f"{str(self)!r}: the target must be PORT or HOST:PORT with a port up to 65535"
            )
        return named or host, int(port)


def is_address(path: str | Path) -> bool:
    """Return whether a path has the form of a camera's address, and is no file."""
    found = _FORM.fullmatch(str(path))
    return found is not None and found["kind"] not in _NET and not Path(path).exists()


def is_stream(path: Path) -> bool:
    """Return whether a path names something that can be read once, as it comes.

    That is standard input, a named pipe, a character device, or the address of a camera.
    """
    if str(path) == STANDARD_INPUT or is_address(path):
        return True
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)
