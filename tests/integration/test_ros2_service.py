"""The reset service, asked as Cyclone's RMW asks."""

import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="the extra [ros2] is not installed")
pytest.importorskip("rosbags", reason="rosbags is not installed")

from spikingtac.ros2.wire.idl import idl_struct, sample
from stand_ins.ros2_client import joined
from stand_ins.tracks import circling_tracks
from stand_ins.viewer import record_circling


def test_the_bytes_are_those_of_the_header_and_the_message() -> None:
    told = sample("std_srvs/Trigger_Response", {"success": True, "message": "ok"}, (7, 3))
    assert told.serialize()[4:31] == struct.pack("<QqBxxxI3s", 7, 3, 1, 3, b"ok\0")
    request = idl_struct("std_srvs/Trigger_Request", asked=True)
    found = request.deserialize(b"\0\1\0\0" + struct.pack("<QqB", 7, -2, 0))
    assert (found.guid, found.seq) == (7, -2)


def asked(source: list[str], domain: int) -> Any:
    """Publish a source in another process, ask for a reset until an answer comes, and return it."""
    given = ["--domain", str(domain), "--without-events", "--wait-s", "120"]
    process = subprocess.Popen([sys.executable, "-m", "spikingtac", "ros2", *source, *given])
    try:
        with joined(domain) as client:
            return client.ask("/tactile/reset", "std_srvs/Trigger", **NOTHING)
    finally:
        process.kill()
        process.communicate()


NOTHING = {"structure_needs_at_least_one_member": 0}


def test_tracks_cannot_be_reset_and_say_so(tmp_path: Path) -> None:
    circling_tracks(estimates=30, px_per_mm=8.0).save(tmp_path / "tracks.npz")
    reply = asked([str(tmp_path / "tracks.npz")], 1 + os.getpid() % 100)
    assert not reply.success
    assert "tracks" in reply.message


def test_a_tracker_is_reset(tmp_path: Path) -> None:
    folder = record_circling(tmp_path)
    given = ["--calibration", str(folder / "calibration.json"), "--rate-hz", "50"]
    reply = asked([str(folder), *given], 1 + os.getpid() % 100)
    assert reply.success
