"""Pictures: the robot as MuJoCo sees it, and the skin beside it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures
from PIL import ImageDraw

import spikingtac as st
from spikingtac_mujoco import gl
from spikingtac_mujoco.sensor import Floats, Reading

Image = NDArray[np.uint8]

# Size of each of the two pictures, px, and height of the text below the skin.
HEIGHT, WIDTH, TEXT = 288, 240, 48
ARROW_GAIN = 4.0  # Length of an arrow over the displacement.
DISC_PX = 6.0  # Radius of a marker on the sensor, px.
GIF_COLORS, GIF_MS = 48, 60


class Camera:
    """MuJoCo's renderer for one camera of a model.

    Raises:
        ConfigError: There is no OpenGL; says what is missing.
    """

    def __init__(self, model: mujoco.MjModel, camera: str = "view") -> None:
        if gl.choose() == gl.OFF:
            raise st.ConfigError(gl.missing())
        try:
            self._renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
        except Exception as error:  # each backend fails in its own way
            raise st.ConfigError(f"{gl.missing()} ({error})") from error
        self._camera = camera

    def image(self, data: mujoco.MjData) -> Image:
        """Return the picture ``(height, width, 3)`` of a state."""
        self._renderer.update_scene(data, self._camera)
        return self._renderer.render().copy()

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()


def skin_image(reference_px: Floats, reading: Reading, lines: Iterable[str] = ()) -> Image:
    """Return the skin as the sensor tells it: discs where the markers are, and arrows from rest.

    Args:
        reference_px: ``(m, 2)`` markers at rest, px.
        reading: What it tells.
        lines: Text below.
    """
    span_px = np.ptp(reference_px, axis=0).max() + 8.0 * DISC_PX
    scale = WIDTH / span_px
    place = (reference_px - reference_px.mean(axis=0)) * scale + WIDTH / 2.0
    picture = Pictures.new("RGB", (WIDTH, HEIGHT), (18, 18, 22))
    pen = ImageDraw.Draw(picture)
    moved = reading.displacement_px * scale
    radius = DISC_PX * scale
    for (x, y), (dx, dy), lost in zip(place, moved, reading.coasted, strict=True):
        box = (x + dx - radius, y + dy - radius, x + dx + radius, y + dy + radius)
        pen.ellipse(box, fill=(120, 60, 60) if lost else (205, 205, 205))
        tip = (x + ARROW_GAIN * dx, y + ARROW_GAIN * dy)
        pen.line((x, y, *tip), fill=(255, 150, 30), width=2)
    text = "\n".join(lines)
    pen.rectangle((0, HEIGHT - TEXT, WIDTH, HEIGHT), fill=(0, 0, 0))
    pen.multiline_text((4, HEIGHT - TEXT + 2), text, fill=(230, 230, 230), spacing=1)
    return np.asarray(picture)


def write_gif(path: Path, frames: list[Image]) -> None:
    """Write a looping animation."""
    sample = Pictures.fromarray(np.vstack([frames[0], frames[len(frames) // 2], frames[-1]]))
    palette = sample.quantize(GIF_COLORS)  # one for all, so that colours do not flicker
    first, *others = (
        Pictures.fromarray(frame).quantize(palette=palette, dither=0) for frame in frames
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    first.save(path, save_all=True, append_images=others, duration=GIF_MS, loop=0, optimize=True)
