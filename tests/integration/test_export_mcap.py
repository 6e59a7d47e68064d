"""An exported file opens with independent readers, and with ours when it was cut."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.events.open import open_events
from spikingtac.ros2.messages import FIELD
from spikingtac.types import EventPacket
from spikingtac.viewer.export.mcap import MESSAGE_US, export_mcap
from stand_ins.viewer import CirclingDots, open_circling, positions_px, reference_px

pytest.importorskip("mcap_ros2", reason="the extra [formats] is not installed")

DURATION_US = 400_000


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "circling.mcap"
    messages = export_mcap(open_circling(DURATION_US), path)
    assert messages == 4 * DURATION_US // MESSAGE_US
    return path


def whole() -> EventPacket:
    return EventPacket.concatenate(list(CirclingDots(DURATION_US, 50)))


def read(path: Path, topic: str) -> list[Any]:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [found for *_, found in reader.iter_decoded_messages(topics=[topic])]


def test_our_reader_gives_the_events_back(exported: Path) -> None:
    truth, source = whole(), open_events(exported)
    assert source.size == truth.size
    found = EventPacket.concatenate(list(source))
    assert len(found) == len(truth)
    order, wanted = (np.lexsort((part.p, part.y, part.x, part.t)) for part in (found, truth))
    for name in ("t", "x", "y", "p"):
        np.testing.assert_array_equal(getattr(found, name)[order], getattr(truth, name)[wanted])
    assert dict(source.losses) == {}


def test_the_field_is_what_was_tracked(exported: Path) -> None:
    messages = read(exported, "/tactile/field")
    assert len(messages) == DURATION_US // MESSAGE_US
    for message in (messages[0], messages[-1]):
        t_us = message.header.stamp.sec * 1_000_000 + message.header.stamp.nanosec // 1000
        cloud = np.frombuffer(bytes(message.data), FIELD)
        assert [item.name for item in message.fields] == list(FIELD.names or ())
        assert (message.height, message.width) == (8, 8)
        np.testing.assert_allclose(
            np.stack([cloud["u"], cloud["v"]], axis=1), positions_px(t_us), atol=1e-3
        )
        moved = positions_px(t_us) - reference_px()
        np.testing.assert_allclose(cloud["du"], moved[:, 0], atol=1e-3)
        np.testing.assert_allclose(cloud["x"] * 15.5 + 159.5, reference_px()[:, 0], atol=1e-3)
        assert cloud["valid"].tolist() == [float(marker != 9) for marker in range(64)]


def test_rosbags_reads_the_same(exported: Path) -> None:
    from rosbags.highlevel import AnyReader

    with AnyReader([exported]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        fields = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.topic == "/tactile/field"
        ]
    expected = DURATION_US // MESSAGE_US
    assert counts == dict.fromkeys(
        ("/tactile/events", "/tactile/field", "/tactile/image", "/diagnostics"), expected
    )
    other = read(exported, "/tactile/field")
    for mine, theirs in zip(fields, other, strict=True):
        assert bytes(mine.data) == bytes(theirs.data)  # type: ignore[attr-defined]


def test_image_and_diagnostics_are_readable(exported: Path) -> None:
    image = read(exported, "/tactile/image")[-1]
    assert (image.height, image.width, image.encoding) == (320, 320, "mono8")
    assert {0, 128, 255} == set(bytes(image.data))
    status = read(exported, "/diagnostics")[-1].status[0]
    assert status.message == "1 markers held"
    assert {"step_p50_us", "time_gap"} <= {item.key for item in status.values}


def test_a_truncated_file_is_salvaged_with_a_report(exported: Path, tmp_path: Path) -> None:
    data = exported.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 3 // 5])
    source = open_events(cut)
    found = sum(len(packet) for packet in source)
    assert 0 < found < len(whole())
    assert sum(source.losses.values()) > 0
