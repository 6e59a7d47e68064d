"""Which schedulers may be connected to."""

import sys
from pathlib import Path

import pytest

from spikingtac.batch.cluster import TLS_FILES, check_address, run_on_cluster
from spikingtac.batch.run import Batch, run_batch
from spikingtac.errors import ConfigError, DeviceError, MissingExtraError
from stand_ins.dask_cluster import SETTINGS

HOW_TO = Path(__file__).parents[3] / "docs" / "how-to" / "work-on-many-recordings.md"


def test_the_how_to_tells_to_set_what_the_measured_cluster_has_set() -> None:
    text = HOW_TO.read_text(encoding="utf-8")
    assert [
        f"{name}={value}" for name, value in SETTINGS.items() if f"{name}={value}" not in text
    ] == []


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("tcp://127.0.0.1:8786", "tcp://127.0.0.1:8786"),
        ("tcp://localhost", "tcp://localhost:8786"),
        ("tcp://[::1]:99", "tcp://[::1]:99"),
    ],
)
def test_this_machine_is_reached_plainly(given: str, meant: str) -> None:
    assert check_address(given, None) == meant


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("tcp://10.0.0.7:8786", "without encryption"),
        ("tcp://cluster.example:8786", "without encryption"),
        ("tcp://0.0.0.0:8786", "without encryption"),
        ("127.0.0.1:8786", "no address"),
        ("http://127.0.0.1", "no address"),
        ("tcp://127.0.0.1:8786/x", "no address"),
        ("tcp://127.0.0.1:99999", "99999"),
        ("tls://cluster.example:8786", "go together"),
    ],
)
def test_others_are_refused(given: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        check_address(given, None)


def test_tls_needs_its_three_files(tmp_path: Path) -> None:
    (tmp_path / TLS_FILES[0]).write_text("x")
    with pytest.raises(ConfigError, match=r"holds no cert\.pem, key\.pem"):
        check_address("tls://cluster.example", tmp_path)
    for name in TLS_FILES:
        (tmp_path / name).write_text("x")
    assert check_address("tls://cluster.example", tmp_path) == "tls://cluster.example:8786"
    with pytest.raises(ConfigError, match="go together"):
        check_address("tcp://127.0.0.1:8786", tmp_path)


def test_the_extra_is_named_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"spikingtac\[cluster\]"):
        list(run_on_cluster([], "tcp://127.0.0.1:8786"))


def test_a_first_connection_that_fails_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run.json that stayed made the same command, with the scheduler there, fail."""
    pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    monkeypatch.setattr("spikingtac.batch.cluster.CONNECT_S", 0.3)
    (tmp_path / "a.raw").write_bytes(b"x")
    batch = Batch(
        name="convert",
        work="spikingtac.cli.files.convert:convert_one",
        recordings=[tmp_path / "a.raw"],
        folder=tmp_path / "out",
        ending=".npz",
        settings={},
    )
    for _ in range(2):
        with pytest.raises(DeviceError, match="no Dask scheduler answers"):
            run_batch(batch, lambda jobs: run_on_cluster(jobs, "tcp://127.0.0.1:1"))
        assert list((tmp_path / "out").iterdir()) == []


def test_a_scheduler_that_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    monkeypatch.setattr("spikingtac.batch.cluster.CONNECT_S", 0.3)
    with pytest.raises(DeviceError, match="no Dask scheduler answers"):
        list(run_on_cluster([], "tcp://127.0.0.1:1"))
