"""A small animation whose every picture is one colour."""

from __future__ import annotations

import io

from PIL import Image

from spikingtac.viewer.export.mp4 import FRAME_MS

COLORS = ((200, 30, 30), (30, 200, 30), (30, 30, 200), (220, 220, 220))
SIZE = (64, 48)


def animation() -> bytes:
    """Return it as AVIF."""
    first, *rest = [Image.new("RGB", SIZE, color) for color in COLORS]
    file = io.BytesIO()
    first.save(file, "AVIF", save_all=True, append_images=rest, duration=FRAME_MS)
    return file.getvalue()
