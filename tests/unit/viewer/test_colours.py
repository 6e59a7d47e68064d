"""The page's colours: told apart by people who see no green, and visible on their ground."""

from __future__ import annotations

import itertools
import re
from importlib import resources

import numpy as np
import pytest

TOLD_APART = ("on", "off", "held", "lost", "truth")
SCALE = ("scale-0", "scale-1", "scale-2", "scale-3", "scale-4")
ON_THE_IMAGE = (*TOLD_APART, *SCALE, "disc", "mesh", "arrow", "force", "good", "contact")
ON_PANELS = ("text", "soft", "arrow", "on", "edge", "good", "lost")

# CIELAB difference; 2 is just noticed side by side (the page had 7 between some).
LEAST_DIFFERENCE = 18.0
LEAST_CONTRAST, TEXT_CONTRAST = 3.0, 4.5  # WCAG 2.1, 1.4.11 and 1.4.3

# Machado, Oliveira and Fernandes, "A physiologically-based model for simulation of color vision
# deficiency", IEEE TVCG 2009: deuteranopia, in linear RGB.
DEUTERANOPIA = np.array([
    [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
    [-0.011820, 0.042940, 0.968881],
])  # fmt: skip
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = np.array([0.9505, 1.0, 1.089])


def themes() -> dict[str, dict[str, str]]:
    sheet = resources.files("spikingtac.viewer") / "page" / "theme.css"
    blocks = re.findall(r"\{([^{}]*)\}", sheet.read_text(encoding="utf-8"))
    dark, light, automatic = (dict(re.findall(r"--([\w-]+): (#\w{6})", text)) for text in blocks)
    assert light == automatic
    return {"dark": dark, "light": light}


def linear(colour: str) -> np.ndarray:
    value = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    xyz = TO_XYZ @ rgb.clip(0, 1) / WHITE
    root = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * root[1] - 16, 500 * (root[0] - root[1]), 200 * (root[1] - root[2])])


def difference(one: str, other: str, *, deuteranope: bool) -> float:
    seen = DEUTERANOPIA if deuteranope else np.eye(3)
    return float(np.linalg.norm(lab(seen @ linear(one)) - lab(seen @ linear(other))))


def contrast(one: str, other: str) -> float:
    bright, dim = sorted((TO_XYZ[1] @ linear(colour) for colour in (one, other)), reverse=True)
    return float((bright + 0.05) / (dim + 0.05))


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("deuteranope", [True, False])
def test_what_is_drawn_together_is_told_apart(theme: str, deuteranope: bool) -> None:
    colours = themes()[theme]
    pairs = list(itertools.combinations(TOLD_APART, 2))
    pairs += list(itertools.product(TOLD_APART, SCALE))
    for one, other in pairs:
        far = difference(colours[one], colours[other], deuteranope=deuteranope)
        assert far >= LEAST_DIFFERENCE, (one, other)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_what_is_drawn_stands_out(theme: str) -> None:
    colours = themes()[theme]
    on_image = {name: contrast(colours[name], colours["image"]) for name in ON_THE_IMAGE}
    on_panels = {name: contrast(colours[name], colours["panel"]) for name in ON_PANELS}
    for found in (on_image, on_panels):
        assert {name: round(c, 2) for name, c in found.items() if c < LEAST_CONTRAST} == {}
    for name in ("text", "soft"):
        assert contrast(colours[name], colours["panel"]) >= TEXT_CONTRAST
    # Longer arrows stand out more, also in a grey print.
    grey = [contrast(colours[name], colours["image"]) for name in SCALE]
    assert grey == sorted(grey)


def test_the_measure_knows_known_colours() -> None:
    assert difference("#ffffff", "#000000", deuteranope=False) == pytest.approx(100.0, abs=0.1)
    assert contrast("#ffffff", "#000000") == pytest.approx(21.0)
    # Red and green of equal lightness: far apart, and near each other for a deuteranope.
    red, green = "#d03838", "#587d00"
    assert difference(red, green, deuteranope=False) > 3 * difference(red, green, deuteranope=True)
