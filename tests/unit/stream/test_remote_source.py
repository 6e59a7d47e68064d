"""A source in another process whose size is not known beforehand."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from spikingtac.errors import DeviceError, RecordingError
from spikingtac.stream.host import Factory
from spikingtac.stream.remote_source import RemoteSource
from spikingtac.types import EventPacket

SIZE = (12, 10)


def told() -> Iterator[tuple[EventPacket, Any]]:
    yield EventPacket.empty(0, 0, SIZE), None
    yield EventPacket.empty(5_000, 6_000, SIZE), "beside"


def nothing() -> Iterator[tuple[EventPacket, Any]]:
    return iter(())


def refused() -> Iterator[tuple[EventPacket, Any]]:
    raise DeviceError("there is no such camera")


def test_the_size_is_told_first_and_is_no_packet() -> None:
    beside: list[Any] = []
    source = RemoteSource(Factory(function=told), None, beside.append)
    assert source.size == SIZE
    (only,) = source
    assert (only.t_start_us, only.t_end_us) == (5_000, 6_000)
    assert beside == ["beside"]
    source.close()


@pytest.mark.parametrize(("stream", "error"), [(nothing, RecordingError), (refused, DeviceError)])
def test_what_cannot_be_opened_says_so_at_once(stream: Any, error: type[Exception]) -> None:
    with pytest.raises(error):
        RemoteSource(Factory(function=stream), None)
