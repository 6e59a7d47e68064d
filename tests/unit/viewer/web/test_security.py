import pytest

from spikingtac.viewer.web.access import Gate, is_loopback, page_headers

LOCAL = {"host": "127.0.0.1:8765"}


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:9", "localhost", "[::1]:8765"])
def test_loopback_names_are_let_in(host: str) -> None:
    assert Gate().refusal({"host": host}) == ""
    assert Gate().refusal({"host": host, "origin": f"http://{host}"}) == ""


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


def test_loopback_needs_no_token() -> None:
    assert Gate.for_host("127.0.0.1").token == Gate.for_host("::1").token == ""


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("localhost", True), ("127.8.9.1", True), ("[::1]", True), ("10.0.0.1", False), ("x", False)],
)
def test_loopback(host: str, loopback: bool) -> None:
    assert is_loopback(host) is loopback


def test_the_page_may_load_only_its_own() -> None:
    policy = page_headers("localhost:8765")["content-security-policy"]
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    assert "ws://localhost:8765" in policy
    assert "frame-ancestors 'none'" in policy
