"""The picture of the ``denoise`` experiment: one moment before and after each denoiser."""

from __future__ import annotations

import numpy as np

from spikingtac_paper.denoise.cases import METHODS, DenoiseConfig, denoiser_of
from spikingtac_paper.denoise.recordings import render
from spikingtac_paper.denoise.scoring import Degradation, state_maps
from spikingtac_paper.harness.svg import pyplot, svg_text

SCENE = "finger-slides"
NOISE_HZ, DROP = 1.0, 0.5
DURATION_S, SHOWN_S = 2.0, 1.9
CORNER_PX = 160
"""Side of the part of the map that is shown, from its top left corner, px."""


def before_and_after(config: DenoiseConfig) -> tuple[str, str]:
    """Return (caption, SVG): the clean map, the noisy one, and each method's."""
    recording = render(SCENE, config.seeds[0], DURATION_S).clean
    degradation = Degradation(
        noise_hz=NOISE_HZ, drop=DROP, window_us=config.window_us(NOISE_HZ), seed=config.seeds[0]
    )
    events = degradation.filtered(degradation.apply(recording.events))
    at_us = np.array([round(1e6 * SHOWN_S)])
    pictures = {"clean": next(state_maps(recording, recording.events, "binary", at_us))}
    noisy = next(state_maps(recording, events, "binary", at_us))
    for name in METHODS:
        pictures[name] = denoiser_of(name).clean(noisy).copy()
    figure, axes = pyplot().subplots(1, len(pictures), figsize=(2.0 * len(pictures), 2.3))
    for axis, (name, picture) in zip(axes, pictures.items(), strict=True):
        axis.imshow(picture[:CORNER_PX, :CORNER_PX], cmap="gray", vmin=0, vmax=1)
        axis.set_title(name, fontsize=8)
        axis.set_axis_off()
    figure.tight_layout()
    caption = (
        f"A corner of the binary map at {NOISE_HZ:g} Hz/px with {DROP:.0%} of the signal events "
        f"dropped, behind the activity filter ({SCENE}, simulated): before and after."
    )
    return caption, svg_text(figure)
