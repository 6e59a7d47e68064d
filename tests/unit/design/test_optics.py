"""Optics: Snell's law, the data sheet, and the twin's lens against traced rays."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from spikingtac.sim.optics.projection import Optics
from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.scene import Scene
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.optics import Imaging
from spikingtac_hardware.parameters.design import Design, load_design, names
from spikingtac_hardware.twin import scene_with_design

RADII_MM = np.array([1.0, 4.0, 8.4, 12.0])


def imaging(design: Design) -> Imaging:
    return Imaging(Layout(design))


def without_plates(distortion: float = 0.0) -> Design:
    design = load_design()
    return replace(
        design,
        window=replace(design.window, index=1.0),
        skin=replace(design.skin, gel_index=1.0),
        lens=replace(design.lens, distortion=distortion),
    )


def test_without_plates_and_distortion_it_is_a_pinhole() -> None:
    pinhole = imaging(without_plates())
    assert pinhole.image_px(RADII_MM) == pytest.approx(pinhole.px_per_mm * RADII_MM, rel=1e-12)
    lens = pinhole.twin_lens()
    assert lens.distance_mm == pytest.approx(pinhole.reduced_mm, rel=1e-9)
    assert (lens.k1, lens.k2) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_scale_and_distance_follow_from_the_data_sheet() -> None:
    design = load_design()
    seen = imaging(design)
    reduced = seen.air_mm + 2.0 / 1.49 + 2.5 / 1.41
    assert seen.reduced_mm == pytest.approx(reduced)
    magnification = 0.93 / (reduced - 0.93)
    assert seen.px_per_mm == pytest.approx(magnification / 0.0063)


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


def test_plates_alone_stretch_the_edge() -> None:
    design = load_design()
    plates = replace(design, lens=replace(design.lens, distortion=0.0))
    assert (imaging(plates).image_px(RADII_MM) > imaging(plates).px_per_mm * RADII_MM).all()


def test_the_field_is_where_the_sensor_ends() -> None:
    seen = imaging(load_design())
    assert seen.image_px(np.array([seen.field_mm[0] / 2]))[0] == pytest.approx(160.0, abs=1e-3)
    assert min(seen.field_mm) >= 20.6


def test_blur_grows_with_the_press_and_with_the_aperture() -> None:
    design = load_design()
    wide = replace(design, lens=replace(design.lens, f_number=1.4))
    assert imaging(design).blur_px(0.0) == 0.0
    assert imaging(wide).blur_px(1.0) == pytest.approx(2 * imaging(design).blur_px(1.0))
    assert imaging(design).blur_px(2.0) > 2 * imaging(design).blur_px(1.0)


def projected_px(scene: Scene, indentation_mm: float) -> np.ndarray:
    exact = replace(scene.optics.discs, radius_sigma_mm=0.0, position_sigma_mm=0.0)
    state = scene.skin.at_rest()
    pressed = state.marker_mm + np.array([0.0, 0.0, indentation_mm])
    image = Optics(replace(scene.optics, discs=exact)).project(replace(state, marker_mm=pressed))
    return image.center_px - (np.array(scene.size) - 1) / 2


@pytest.mark.parametrize("name", names())
def test_the_twin_images_the_discs_as_the_rays_do(name: str) -> None:
    design = load_design(name)
    scene = scene_with_design(catalog.load("quiet"), design)
    distance_mm = np.hypot(*scene.skin.rest_mm().T)
    traced_px = imaging(design).image_px(distance_mm)
    assert np.hypot(*projected_px(scene, 0.0).T) == pytest.approx(traced_px, abs=0.2)


@pytest.mark.parametrize("name", names())
def test_the_twin_moves_pressed_discs_as_the_rays_do(name: str) -> None:
    """A press of 0.3 mm: rays through a thinner gel, against the twin's one distance."""
    press_mm = 0.3
    design = load_design(name)
    scene = scene_with_design(catalog.load("quiet"), design)
    moved_px = np.hypot(*projected_px(scene, press_mm).T) - np.hypot(*projected_px(scene, 0.0).T)
    seen, distance_mm = imaging(design), np.hypot(*scene.skin.rest_mm().T)
    gel_mm = design.skin.gel_mm - press_mm
    tangent = seen.tangent(distance_mm)
    for _ in range(20):  # the same equation with the thinner gel
        inside = tangent / np.sqrt(1.41**2 + (1.41**2 - 1) * tangent**2)
        above = seen.radius_mm(tangent, design.window.thickness_mm)
        tangent = tangent + (distance_mm - above - gel_mm * inside) / seen.reduced_mm
    traced_px = seen.px_per_mm * seen.reduced_mm * tangent * (1 + design.lens.k1 * tangent**2)
    assert moved_px == pytest.approx(traced_px - seen.image_px(distance_mm), rel=0.15, abs=0.05)


def test_the_default_twin_follows_from_the_paper_s_size() -> None:
    """Scale within 0.2 %, discs of 7 px, a pitch of 37 px; rest positions within 1.5 px."""
    twin = catalog.load("quiet")
    ours = scene_with_design(twin, load_design())
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


def test_what_differs_from_the_default_twin_is_explained() -> None:
    """Gel and window weaken the motion under indentation: a longer distance than 13 mm in air."""
    twin, ours = (scene.optics for scene in (catalog.load("quiet"),
                  scene_with_design(catalog.load("quiet"), load_design())))  # fmt: skip
    in_air = imaging(load_design()).reduced_mm
    assert in_air < twin.distance_mm < ours.distance_mm
    assert 1.41 * in_air < ours.distance_mm < 1.7 * in_air
