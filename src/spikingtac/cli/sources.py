"""Sources of events on the command line: how they end, keep deadlines, and are opened in pairs."""

from __future__ import annotations

import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import spikingtac as st
from spikingtac import events
from spikingtac.cli.messages import remark, warn
from spikingtac.errors import ConfigError
from spikingtac.events.camera import is_address, is_stream

if TYPE_CHECKING:
    from spikingtac.pipeline.follow import CheckedSource

EXIT_TERMINATED = 143  # 128 + SIGTERM, what a shell reports of a program that was terminated.
Result = TypeVar("Result")


@contextmanager
def ending_on_interrupt(*sources: object) -> Iterator[None]:
    """Close live sources at the first Ctrl-C or SIGTERM; a second one interrupts as usual.

    Args:
        *sources: Those with ``close()`` end so; where none has it, the work is interrupted at once.
    """
    closes = [close for source in sources if (close := getattr(source, "close", None)) is not None]

    def end(number: int, _: Any) -> None:
        signal.signal(number, signal.default_int_handler)  # a second one interrupts
        for close in closes:
            close()

    handler = end if closes else None
    with _on_signal(signal.SIGINT, handler), _on_signal(signal.SIGTERM, handler):
        yield


def ended_by_sigterm() -> AbstractContextManager[None]:
    """Turn SIGTERM into SystemExit while the context lasts, so that what was opened is closed.

    A verb that drives an arm then brakes it, and one that writes removes what is unfinished. Python
    by itself would end without closing.
    """
    return _on_signal(signal.SIGTERM, _terminate)


def _terminate(*_: Any) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not end the braking
    raise SystemExit(EXIT_TERMINATED)


@contextmanager
def _on_signal(number: signal.Signals, handler: Any) -> Iterator[None]:
    """Handle a signal while the context lasts; only the main thread may."""
    if handler is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


def require_live(sources: Iterable[Path | str], *, where: bool) -> None:
    """Refuse ``--realtime`` for what has no deadline: a recording would take a core for itself.

    Args:
        sources: What is read.
        where: Whether it is given.

    Raises:
        ConfigError: A source is a recording.
    """
    for source in sources:
        if where and not is_stream(Path(source)):
            raise ConfigError(
                f"{str(source)!r} is a recording and has no deadlines; --realtime is for cameras "
                "(an address, a named pipe, or -), leave it out"
            )


def ask_for_real_time() -> None:
    """Ask the system for what helps to keep deadlines, and tell what was granted."""
    from spikingtac.stream.real_time import meet_deadlines

    remark(meet_deadlines())


def fitting(path: Path, source: st.EventSource) -> st.Calibration:
    """Return the calibration of a source's sensor.

    Raises:
        CalibrationError: It cannot be read, or is of a sensor of another size.
    """
    from spikingtac.pipeline.track import require_same_size

    calibration = st.Calibration.load(path)
    require_same_size(source.size, calibration.size)
    return calibration


def checked(source: st.EventSource, calibration: st.Calibration, strict: bool) -> CheckedSource:
    """Return a source that warns once, or raises, where its events contradict the calibration."""
    from spikingtac.pipeline.follow import CheckedSource, refuse

    return CheckedSource(source, calibration, refuse if strict else warn)


def camera_address(source: Path) -> str:
    """Return the address that a source means; a pipe is one, too.

    Raises:
        ConfigError: It is a file or a folder.
    """
    if is_address(source):
        return str(source)
    if is_stream(source):
        return f"pipe:{source}"
    if source.exists():
        raise ConfigError(
            f"{str(source)!r} is recorded already; to copy it or a part of it: "
            "spikingtac convert IN OUT"
        )
    raise ConfigError(
        f"{str(source)!r} is no camera; give an address, as udp:7777?encoding=evt2&size=320x320, "
        "or a named pipe (spikingtac cameras lists what is plugged in)"
    )


def open_two(first: Path, second: Path, *, strict: bool = False) -> list[events.FileSource]:
    """Open two fingers, the second one with its times on the first one's clock.

    Cameras meet on the host's clock while they deliver; recordings of cameras bring their clocks in
    their manifests. The same folder twice means its second sensor.

    Raises:
        ConfigError: One is a camera and the other a recording.
        SpikingTacError: As of :func:`~spikingtac.events.open.open_events`.
    """
    from spikingtac.events.open import open_second
    from spikingtac.stream.pair import live_pair

    live = [is_stream(first), is_stream(second)]
    if all(live):
        options = events.ReadOptions(strict=strict)
        addresses = [events.Address.parse(camera_address(path)) for path in (first, second)]
        cameras = [events.CameraSource(address, options) for address in addresses]
        return list(live_pair(cameras, options))
    if any(live):
        raise ConfigError(
            f"{str(first)!r} and {str(second)!r}: one is a camera and the other a recording; give "
            "two of a kind"
        )
    source, known = open_second(first, second, strict=strict)
    if not known:
        warn(
            f"{first.name} and {second.name} know no common clock; their times are taken as they "
            f"are. If both timed one line: spikingtac align {first} {second} --by triggers -o PAIR"
        )
    return [st.open_events(first, strict=strict), source]


def anomalies_of(*sources: st.EventSource) -> dict[str, int]:
    """Return how often each kind of damage was met in what was read."""
    return dict(sum((Counter(dict(one.losses.kinds())) for one in sources), Counter[str]()))


def for_each(
    work: Callable[[int, events.FileSource], Result], sources: Sequence[events.FileSource]
) -> list[Result]:
    """Do the work on both sources: at once for cameras, which do not wait, else one by one."""
    if not all(hasattr(source, "close") for source in sources):
        return [work(number, source) for number, source in enumerate(sources)]
    with ThreadPoolExecutor(len(sources), "spikingtac-finger") as pool:
        running = [pool.submit(work, number, source) for number, source in enumerate(sources)]
        try:
            wait(running, return_when=FIRST_EXCEPTION)
        finally:  # where one has failed, the other one would go on without end
            if not all(future.done() for future in running):
                for source in sources:
                    source.close()  # type: ignore[attr-defined]
        return [future.result() for future in running]
