"""Scenes of the twin on the sensor of a design."""

from dataclasses import replace

from spikingtac.schema import merged
from spikingtac.sim import OpticsConfig, Scene
from spikingtac_hardware.checks import require_sound
from spikingtac_hardware.design import Design, load_design
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.optics import Imaging, light_figures


def scene_on_design(scene: Scene, design: Design | str) -> Scene:
    """Return a scene whose sensor is that of a design: grid, gel, lens, sensor size, light.

    Bodies, motions, camera preset, specimen, tolerances of the discs and the gel's stiffness stay
    those of the scene. Broken and missing discs stay where the grid is the same.

    Args:
        scene: A scene of the twin.
        design: A design, its name, or the path of a TOML file.

    Raises:
        ConfigError: There is no such design, or it fails its checks.

    Example:
        >>> from spikingtac.sim import load_scene
        >>> scene_on_design(load_scene("quiet"), "paper-size").skin.pitch_mm
        2.4
    """
    if isinstance(design, str):
        design = load_design(design)
    require_sound(design)
    layout = Layout(design)
    imaging = Imaging(layout)
    skin = design.skin
    contrast = skin.contrast if skin.paint == "white" else 1 / skin.contrast
    light = {"contrast": contrast, "vignetting": light_figures(layout, imaging)["vignetting"]}
    settings = merged(scene.camera.settings, {"light": light})
    lens = imaging.twin_lens()
    del lens["residual_px"]
    discs = replace(scene.optics.discs, radius_mm=skin.disc_diameter_mm / 2)
    if scene.skin.grid != skin.grid:
        discs = replace(discs, broken=(), missing=())
    return replace(
        scene,
        skin=replace(scene.skin, grid=skin.grid, pitch_mm=skin.pitch_mm),
        gel=replace(scene.gel, thickness_mm=skin.gel_mm + skin.cover_mm),
        optics=OpticsConfig(size=design.sensor.pixels, discs=discs, **lens),
        camera=replace(scene.camera, settings=settings),
    )
