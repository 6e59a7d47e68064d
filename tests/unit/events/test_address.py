"""Addresses of cameras, and paths: what they mean, and where they are refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import spikingtac as st
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.address import Address, is_address
from spikingtac.events.open import open_events
from stand_ins.small_twin import calibration


def test_an_address_is_taken_apart_and_put_together() -> None:
    text = "udp:7777?encoding=evt2&size=320x320"
    address = Address.parse(text)
    assert (address.kind, address.target) == ("udp", "7777")
    assert address.size("size") == (320, 320)
    assert str(address) == text
    assert Address.parse("nd:").target == ""


def test_files_are_no_addresses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text in ("events.raw", "C:\\data\\a.raw", "-", "https://host/a.raw", "a"):
        assert not is_address(text)
    with pytest.raises(RecordingError, match="there is no file"):
        open_events("https://example.org/a.raw")
    monkeypatch.chdir(tmp_path)
    assert is_address("udp:7777")
    Path("udp:7777").write_bytes(b"")
    assert not is_address("udp:7777")


@pytest.mark.parametrize("text", ["udp:1?a", "udp:1?a=1&a=2", "udp:1?=1"])
def test_options_are_names_with_values_once(text: str) -> None:
    with pytest.raises(ConfigError, match="name=value"):
        Address.parse(text)


def tracked(given: Any) -> Any:
    return st.follow(given, st.make_tracker(st.load_config("fast").tracking, calibration()), 100.0)


@pytest.mark.parametrize("taker", [st.calibrate, tracked, lambda given: st.windows(given, 1_000)])
@pytest.mark.parametrize("given", ["touch.raw", Path("touch.raw")])
def test_a_path_instead_of_events_is_refused(
    taker: Callable[[Any], Any], given: str | Path
) -> None:
    with pytest.raises(st.SpikingTacError, match=r"it: spikingtac\.open_events\('touch\.raw'\)"):
        list(taker(given))
