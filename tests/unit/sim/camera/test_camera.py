import copy
from dataclasses import replace

import numpy as np
import pytest

from spikingtac.sim.camera_config import (
    ReadoutConfig,
    load_camera,
)
from spikingtac.sim.event_camera import EventCamera
from spikingtac.types import EventPacket
from stand_ins.camera_stage import (
    PERIOD_US,
    SIZE,
    camera,
    film,
    image,
    strokes,
)


def columns(packet: EventPacket) -> bytes:
    return b"".join(column.tobytes() for column in (packet.t, packet.x, packet.y, packet.p))


@pytest.mark.parametrize("name", ["clean", "typical", "noisy"])
def test_any_cutting_at_the_same_images_gives_the_same_bytes(name):
    config = replace(load_camera(name), size=SIZE, readout=ReadoutConfig(cap_mev_s=1.0, loss=0.3))
    images = strokes(900.0, 60.0)
    whole = film(EventCamera(config, seed=3), images)
    sensor = EventCamera(config, seed=3)
    sensor.settle(images[0], "random")
    parts, rng, at = [], np.random.default_rng(0), 0
    while at < len(images) - 1:
        stop = min(at + int(rng.integers(1, 6)), len(images) - 1)
        parts.append(sensor.advance(images[at : stop + 1]))  # the shared end is passed over
        at = stop
    assert columns(EventPacket.concatenate(parts)) == columns(whole)


def test_equal_seeds_are_equal_to_the_byte_and_copies_go_on_alone():
    images = strokes(200.0, 20.0)
    config = replace(load_camera("typical"), size=SIZE)
    first, again, other = (EventCamera(config, seed) for seed in (7, 7, 8))
    assert columns(film(first, images)) == columns(film(again, images))
    assert columns(film(other, images)) != columns(film(again, images))
    twin = copy.deepcopy(again)
    later = [replace(item, t_us=item.t_us + images[-1].t_us) for item in images[1:]]
    assert columns(twin.advance(later)) == columns(again.advance(later))


@pytest.mark.parametrize(
    ("name", "leak_hz", "noise_hz"), [("typical", 0.07, 0.1), ("noisy", 0.2, 1.0)]
)
def test_a_still_scene_makes_the_set_rates(name, leak_hz, noise_hz):
    preset = load_camera(name)
    quiet = replace(preset, background=replace(preset.background, hot_fraction=0.0))
    span_us, pixels = 2_000_000, 320 * 320
    still = [image(t) for t in range(0, span_us + 1, 100_000)]
    packet = film(EventCamera(quiet, seed=5), still, "rested")
    assert len(packet) / pixels / 2 == pytest.approx(leak_hz + noise_hz, rel=0.05)
    on, off = packet.p.sum(), (~packet.p).sum()
    assert off / pixels / 2 == pytest.approx(noise_hz / 2, rel=0.05)
    assert (on - off) / pixels / 2 == pytest.approx(leak_hz, rel=0.05)
    halves = np.histogram(packet.t, 2, (0, span_us))[0]
    assert halves[0] == pytest.approx(halves[1], rel=0.05)


def test_missing_markers_make_nothing_and_broken_ones_less():
    images = [image(k * PERIOD_US, (0.1 * k, 0.0)) for k in range(60)]
    whole = film(camera(), images, "fresh")
    gone = [replace(item, radius_px=np.array([7.0, 0.0, 7.0, 7.0])) for item in images]
    missing = film(camera(), gone, "fresh")
    near_second = np.hypot(whole.x - 83.0, whole.y - 40.4) < 20
    assert columns(missing) == columns(whole.select(~near_second))
    cut = np.tile([0.0, 1.0, np.inf], (4, 1))
    cut[0, 2] = 0.0  # the lower half is gone
    broken = film(camera(), [replace(item, chord=cut) for item in images], "fresh")
    lower = (broken.x < 64) & (broken.y > 42.5) & (broken.y < 64)
    assert not lower.any()
    near_first = np.hypot(whole.x - 43.0, whole.y - 40.1) < 20
    fraction = (np.hypot(broken.x - 43.0, broken.y - 40.1) < 20).sum() / near_first.sum()
    assert 0.4 < fraction < 0.6
