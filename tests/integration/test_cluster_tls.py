"""A cluster that is reached with certificates: ours work, those of another authority do not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
pytest.importorskip("cryptography", reason="cryptography is not installed")

from spikingtac.cli.main import main
from spikingtac.events import create_events
from spikingtac.types import EventPacket
from stand_ins.certificates import make_certificates
from stand_ins.dask_cluster import DaskCluster


def test_work_goes_over_tls_and_strangers_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = (make_certificates(tmp_path / name) for name in ("ours", "theirs"))
    t = np.arange(100)
    with create_events(tmp_path / "a.raw", (32, 32)) as writer:
        column = (t % 32).astype(np.uint16)
        writer.write(EventPacket(column, column, t > 50, t, 0, 100, (32, 32)))
    with DaskCluster(tmp_path, workers=1, tls=ours) as cluster:
        line = ["convert", str(tmp_path / "a.raw"), "--to", "npz", "--json"]
        line += ["--scheduler", cluster.address]
        assert main([*line, "-o", str(tmp_path / "out"), "--tls", str(ours)]) == 0
        assert json.loads(capsys.readouterr().out)["done"] == 1
        assert (tmp_path / "out" / "a.npz").is_file()
        monkeypatch.setattr("spikingtac.batch.cluster.CONNECT_S", 2.0)
        assert main([*line, "-o", str(tmp_path / "no"), "--tls", str(theirs)]) == 3
        assert "no Dask scheduler answers" in capsys.readouterr().err
        plain = [word.replace("tls://", "tcp://") for word in line]
        assert main([*plain, "-o", str(tmp_path / "no")]) == 3
