"""The reset service, asked as Cyclone's RMW asks: by a client that is built here from raw bytes."""

import os
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="the extra [ros2] is not installed")

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct, types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from spikingtac.events import create_events
from spikingtac.ros2.dds import DdsConfig
from spikingtac.ros2.service import reply_type, request_type
from stand_ins.tracks import circling_tracks
from stand_ins.viewer import CirclingDots, open_circling

PATIENCE_S = 30.0
QOS = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


@dataclass
class Request(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    """What a client sends: its id, the number of the request, and nothing."""

    guid: types.uint64
    seq: types.int64
    structure_needs_at_least_one_member: types.uint8


@dataclass
class Reply(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    """What it waits for."""

    guid: types.uint64
    seq: types.int64
    success: bool
    message: str


def test_the_bytes_are_those_of_the_header_and_the_message() -> None:
    asked = request_type()(guid=7, seq=-2, structure_needs_at_least_one_member=0)
    told = reply_type()(guid=7, seq=3, success=True, message="ok")
    assert asked.serialize()[4:21] == struct.pack("<QqB", 7, -2, 0)
    assert told.serialize()[4:31] == struct.pack("<QqBxxxI3s", 7, 3, 1, 3, b"ok\0")


def asked(source: list[str], domain: int) -> Reply:
    """Publish a source in another process, ask for a reset until an answer comes, and return it."""
    given = ["--domain", str(domain), "--without-events", "--wait-s", "0"]
    process = subprocess.Popen([sys.executable, "-m", "spikingtac", "ros2", *source, *given])
    within = Domain(domain, DdsConfig(domain=domain).document())
    participant = DomainParticipant(domain)
    try:
        asks = Topic(participant, "rq/tactile/resetRequest", Request)
        tells = Topic(participant, "rr/tactile/resetReply", Reply)
        writer = DataWriter(participant, asks, qos=QOS)
        reader = DataReader(participant, tells, qos=QOS)
        deadline_s = time.monotonic() + PATIENCE_S
        while not (writer.get_matched_subscriptions() and reader.get_matched_publications()):
            assert time.monotonic() < deadline_s, "no service"
            time.sleep(0.05)
        writer.write(Request(guid=41, seq=12, structure_needs_at_least_one_member=0))
        while not (found := reader.take()):
            assert time.monotonic() < deadline_s, "no answer"
            assert process.poll() is None, "the publisher has ended"
            time.sleep(0.01)
        return found[0]
    finally:
        process.kill()
        process.communicate()
        del participant, within


def test_tracks_cannot_be_reset_and_say_so(tmp_path: Path) -> None:
    circling_tracks(estimates=30_000, px_per_mm=8.0).save(tmp_path / "tracks.npz")
    reply = asked([str(tmp_path / "tracks.npz")], 1 + os.getpid() % 100)
    assert (reply.guid, reply.seq, reply.success) == (41, 12, False)
    assert "tracks" in reply.message


def test_a_tracker_is_reset(tmp_path: Path) -> None:
    source = CirclingDots(duration_us=8_000_000)
    with create_events(tmp_path / "events.raw", source.size) as writer:
        for packet in source:
            writer.write(packet)
    open_circling().calibration.save(tmp_path / "calibration.json")
    given = ["--calibration", str(tmp_path / "calibration.json"), "--rate-hz", "50"]
    reply = asked([str(tmp_path), *given], 1 + os.getpid() % 100)
    assert (reply.guid, reply.seq, reply.success) == (41, 12, True)
