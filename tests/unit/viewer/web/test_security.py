import pytest

from spikingtac.viewer.web.access import Gate

LOCAL = {"host": "127.0.0.1:8765"}


@pytest.mark.parametrize(
    "host",
    [
        "",
        "evil.example",
        "evil.example:8765",
        "127.0.0.1.evil.example",
        "localhost.evil.example:8765",
        "192.168.0.7:8765",
        "localhost:80; script-src *",
        "localhost:80@evil.example",
    ],
)
def test_other_hosts_are_refused(host: str) -> None:
    assert "Host" in Gate().refusal({"host": host})


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "http://127.0.0.1:3000", "http://localhost:8765", "file://"],
)
def test_foreign_origins_are_refused(origin: str) -> None:
    assert "Origin" in Gate().refusal({**LOCAL, "origin": origin})


def test_beyond_loopback_a_token_is_needed() -> None:
    gate = Gate.for_host("0.0.0.0")
    assert len(gate.token) >= 24
    headers = {"host": "lab.example:8765"}
    assert "token" in gate.refusal(headers)
    assert "token" in gate.refusal(headers, "ü" + gate.token[1:])
    assert gate.refusal(headers, gate.token) == ""
    assert "Origin" in gate.refusal({**headers, "origin": "http://evil.example"}, gate.token)
    assert Gate.for_host("0.0.0.0").token != gate.token
