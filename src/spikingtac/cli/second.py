"""Two fingers: two sources of events on one time base, for every verb that takes two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro

from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.messages import warn
from spikingtac.cli.options import JsonArgs
from spikingtac.errors import ConfigError
from spikingtac.events.manifest import name_of

if TYPE_CHECKING:
    from spikingtac.events.formats.file_source import FileSource

Result = TypeVar("Result")


def second_name(path: Path) -> Path:
    """Return where the second sensor's output goes: ``tracks.npz`` becomes ``tracks_1.npz``."""
    return path.with_name(name_of(path.name, 1))


@dataclass(frozen=True, kw_only=True)
class SecondArgs(JsonArgs):
    """Options of verbs that take two fingers."""

    second: Annotated[Path | None, tyro.conf.arg(metavar="RECORDING")] = None
    """The other finger: its recording or camera, put on the first one's clock."""
    second_calibration: Path | None = None
    """calibration.json of the other finger."""

    def calibrations(self, first: Path | None, many: bool) -> list[Path]:
        """Return the calibrations of two fingers.

        Args:
            first: Of the first one, or None where it was not given.
            many: Whether the command line means many recordings.

        Raises:
            ConfigError: One is missing, or there are many recordings.
        """
        if many:
            raise ConfigError("--second is the other finger of one recording; give a single one")
        if first is None or self.second_calibration is None:
            raise ConfigError(
                "two fingers need a calibration each: --calibration and --second-calibration"
            )
        return [first, self.second_calibration]


def work_on_two(
    first: Path, second: Path, strict: bool, work: Callable[[int, FileSource], Result]
) -> list[Result]:
    """Open two fingers and do the work on both; Ctrl-C ends cameras."""
    sources = open_two(first, second, strict=strict)
    with ending_on_interrupt(*sources):
        return for_each(work, sources)


def open_two(first: Path, second: Path, *, strict: bool = False) -> list[FileSource]:
    """Open two fingers, the second one with its times on the first one's clock.

    Cameras meet on the host's clock while they deliver; recordings of cameras bring their clocks in
    their manifests. The same folder twice means its second sensor.

    Raises:
        ConfigError: One is a camera and the other a recording.
        SpikingTacError: As of :func:`~spikingtac.events.open.open_events`.
    """
    from spikingtac.events.address import is_stream
    from spikingtac.events.open import open_events, open_second

    live = [is_stream(first), is_stream(second)]
    if all(live):
        return _cameras(first, second, strict)
    if any(live):
        raise ConfigError(
            f"{str(first)!r} and {str(second)!r}: one is a camera and the other a recording; give "
            "two of a kind"
        )
    source, known = open_second(first, second, strict=strict)
    if not known:
        warn(
            f"{first.name} and {second.name} know no common clock; their times are taken as they "
            f"are. To find it by what both felt: spikingtac align {first} {second} -o PAIR"
        )
    return [open_events(first, strict=strict), source]


def for_each(
    work: Callable[[int, FileSource], Result], sources: Sequence[FileSource]
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


def _cameras(first: Path, second: Path, strict: bool) -> list[FileSource]:
    from spikingtac.cli.verbs.record import camera_address
    from spikingtac.events.address import Address
    from spikingtac.events.camera_source import CameraSource
    from spikingtac.events.formats.file_source import ReadOptions
    from spikingtac.stream.pair import live_pair

    options = ReadOptions(strict=strict)
    addresses = [Address.parse(camera_address(path)) for path in (first, second)]
    cameras = [CameraSource(address, options) for address in addresses]
    return list(live_pair(cameras[0], cameras[1], options))
