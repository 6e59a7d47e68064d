import json

import pytest

from spikingtac.viewer.web.wire import CommandError, parse_command


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ack", 7),
        ("play", True),
        ("speed", 0.25),
        ("speed", 2),
        ("seek_us", -5),
        ("exposure_us", 30_000),
        ("map", False),
        ("set", ["gain", 1.5]),
        ("set", ["law", "paper"]),
        ("defaults", True),
        ("list", True),
        ("open", "day/second"),
    ],
)
def test_commands_are_understood(name: str, value: object) -> None:
    assert parse_command(json.dumps({name: value})) == (name, value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "null",
        "[]",
        "{}",
        '{"play": 1}',
        '{"open": ""}',
        '{"open": ["first"]}',
        '{"play": true, "ack": 1}',
        '{"speed": 0}',
        '{"speed": 1e9}',
        '{"speed": NaN}',
        '{"speed": true}',
        '{"seek_us": 1.5}',
        '{"seek_us": 1e300}',
        '{"exposure_us": 1}',
        '{"set": ["gain"]}',
        '{"set": ["gain", [1]]}',
        '{"set": {"gain": 1}}',
        '{"exec": "x"}',
        "[" * 900,
        '{"set": ["' + "x" * 2000 + '", 1]}',
    ],
)
def test_everything_else_is_refused(text: str) -> None:
    with pytest.raises(CommandError):
        parse_command(text)
