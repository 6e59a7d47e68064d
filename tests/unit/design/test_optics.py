"""Optics and light of a design, and the twin's scenes on it."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spikingtac.events.recording import Recording
from spikingtac.sim import catalog
from spikingtac.sim.optics import Optics
from spikingtac.sim.scene import Scene
from spikingtac_hardware.design import Design, load_design, names
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.optics import Imaging, illuminance_lux
from spikingtac_hardware.twin import scene_on_design
from stand_ins.verbs import Verbs

pytestmark = pytest.mark.usefixtures("discs_in_their_places")

RADII_MM = np.array([1.0, 4.0, 8.4, 12.0])


def imaging(design: Design) -> Imaging:
    return Imaging(Layout(design))


def without_plates() -> Design:
    return load_design().changed(
        window={"index": 1.0}, skin={"gel_index": 1.0}, lens={"distortion": 0.0}
    )


def test_without_plates_and_distortion_it_is_a_pinhole() -> None:
    pinhole = imaging(without_plates())
    assert pinhole.image_px(RADII_MM) == pytest.approx(pinhole.px_per_mm * RADII_MM, rel=1e-12)
    lens = pinhole.twin_lens()
    assert lens["distance_mm"] == pytest.approx(pinhole.reduced_mm, rel=1e-9)
    assert (lens["k1"], lens["k2"]) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("degrees", [5.0, 30.0, 57.0])
def test_rays_obey_snell(degrees: float) -> None:
    seen = imaging(load_design())
    angle = math.radians(degrees)
    inside = [math.asin(math.sin(angle) / index) for index in (1.49, 1.41)]
    wanted = seen.air_mm * math.tan(angle) + 2.0 * math.tan(inside[0]) + 2.5 * math.tan(inside[1])
    tangent = np.array([math.tan(angle)])
    assert seen.radius_mm(tangent)[0] == pytest.approx(wanted, rel=1e-12)
    assert seen.tangent(np.array([wanted]))[0] == pytest.approx(tangent[0], rel=1e-12)
    at_window = seen.air_mm * math.tan(angle)
    assert seen.radius_mm(tangent, 0.0)[0] == pytest.approx(at_window, rel=1e-12)
    assert seen.radius_mm(tangent, 2.0)[0] == pytest.approx(at_window + 2.0 * math.tan(inside[0]))


def test_the_field_is_where_the_sensor_ends() -> None:
    seen = imaging(load_design())
    assert seen.image_px(np.array([seen.field_mm[0] / 2]))[0] == pytest.approx(160.0, abs=1e-3)
    assert min(seen.field_mm) >= 20.6


def projected_px(scene: Scene, indentation_mm: float) -> np.ndarray:
    state = scene.skin.at_rest()
    pressed = state.marker_mm + np.array([0.0, 0.0, indentation_mm])
    image = Optics(scene.optics).project(replace(state, marker_mm=pressed))
    return image.center_px - (np.array(scene.size) - 1) / 2


@pytest.mark.parametrize("name", names())
def test_the_twin_images_and_moves_pressed_discs_as_the_rays_do(name: str) -> None:
    """A press of 0.3 mm: rays through a thinner gel, against the twin's one distance."""
    press_mm = 0.3
    design = load_design(name)
    scene = scene_on_design(catalog.load_scene("quiet"), design)
    seen, distance_mm = imaging(design), np.hypot(*scene.skin.rest_mm().T)
    at_rest_px, pressed_px = (np.hypot(*projected_px(scene, z).T) for z in (0.0, press_mm))
    assert at_rest_px == pytest.approx(seen.image_px(distance_mm), abs=0.2)
    moved_px = pressed_px - at_rest_px
    gel_mm = design.skin.gel_mm - press_mm
    tangent = seen.tangent(distance_mm)
    for _ in range(20):  # the same equation with the thinner gel
        inside = tangent / np.sqrt(1.41**2 + (1.41**2 - 1) * tangent**2)
        above = seen.radius_mm(tangent, design.window.thickness_mm)
        tangent = tangent + (distance_mm - above - gel_mm * inside) / seen.reduced_mm
    traced_px = seen.px_per_mm * seen.reduced_mm * tangent * (1 + design.lens_k1 * tangent**2)
    assert moved_px == pytest.approx(traced_px - seen.image_px(distance_mm), rel=0.15, abs=0.05)


def test_the_default_twin_follows_from_the_paper_s_size() -> None:
    """Scale within 0.2 %, discs of 7 px, a pitch of 37 px; rest positions within 1.5 px."""
    twin = catalog.load_scene("quiet")
    ours = scene_on_design(twin, load_design())
    assert ours.optics.px_per_mm == pytest.approx(twin.optics.px_per_mm, rel=2e-3)
    assert ours.optics.discs == twin.optics.discs
    assert ours.skin == twin.skin
    assert ours.gel == twin.gel
    assert ours.size == twin.size
    assert round(ours.skin.pitch_mm * ours.optics.px_per_mm) == 37
    assert round(ours.optics.discs.radius_mm * ours.optics.px_per_mm) == 7
    apart_px = np.linalg.norm(projected_px(ours, 0.0) - projected_px(twin, 0.0), axis=1)
    assert apart_px.mean() < 0.8
    assert apart_px.max() < 1.5


def lit(design: Design, places_mm: list[list[float]]) -> np.ndarray:
    layout = Layout(design)
    return illuminance_lux(layout, Imaging(layout), np.array(places_mm))


def test_the_middle_is_lit_by_every_led_alike() -> None:
    design = load_design()
    layout = Layout(design)
    x, y = layout.led_boxes_mm()[0][0]
    height = layout.window_bottom_mm - layout.led_top_mm + 2.0 / 1.49 + 2.5 / 1.41
    away2 = height**2 + x**2 + y**2
    candela = 0.350 * 4.0 / 20.0
    through = 1 - (0.49 / 2.49) ** 2
    wanted = 8 * candela * through * height**2 / away2**2 * 1e6
    assert lit(design, [[0.0, 0.0]])[0] == pytest.approx(wanted)


def test_pillars_cast_shadows() -> None:
    design = load_design()
    slim = design.changed(fasteners={"insert_wall_mm": 0.01, "insert_hole_mm": 0.02})
    corner, middle = [[10.2, 10.2]], [[0.0, 0.0]]
    assert lit(slim, corner)[0] > 1.05 * lit(design, corner)[0]
    assert lit(slim, middle) == pytest.approx(lit(design, middle))


def test_a_recording_of_a_design(tmp_path: Path, verbs: Verbs) -> None:
    arguments = ["simulate", "finger-presses", "--design", "gelsight-like", "--duration-s", 0.1]
    verbs.said(*arguments, "-o", tmp_path / "a", "--seed", 1)
    truth = Recording.open(tmp_path / "a").truth() or {}
    assert truth["reference_px"].shape == (70, 2)
    assert json.loads((tmp_path / "a" / "manifest.json").read_text())["size"] == [320, 240]


def test_motion_camera_specimen_and_damage_stay_the_scene_s() -> None:
    scene = catalog.load_scene("finger-presses").with_camera("noisy").with_serial(7)
    broken = replace(scene.optics, discs=replace(scene.optics.discs, broken=(60,), missing=(3,)))
    scene = replace(scene, optics=broken)
    ours = scene_on_design(scene, load_design())
    assert (ours.contacts, ours.variation) == (scene.contacts, scene.variation)
    assert (ours.camera.preset, ours.skin.serial) == ("noisy", 7)
    assert (ours.optics.discs.broken, ours.optics.discs.missing) == ((60,), (3,))
    other = scene_on_design(scene, load_design("gelsight-like"))
    assert (other.optics.discs.broken, other.optics.discs.missing) == ((), ())
    assert other.camera.settings["light"]["contrast"] == pytest.approx(1 / 6)


def test_a_design_that_fails_is_no_sensor(tmp_path: Path, verbs: Verbs) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text("[skin]\npitch_mm = 3.0\n")
    words = "simulate", "quiet", "--design", bad, "-o", tmp_path / "a"
    assert "disc.inside" in verbs.said(*words, code=2)
    assert not (tmp_path / "a").exists()
