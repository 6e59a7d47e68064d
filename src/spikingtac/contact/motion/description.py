"""Describe a contact: its place on the gel, its direction, and its onset.

Stopping an arm needs none of this. The detector works it out on request, after the decision.
"""

from __future__ import annotations

import numpy as np

from spikingtac.contact.details import GelTouch
from spikingtac.contact.motion.scales import Vector

MOVED_RATIO = 5.0
"""A marker counts as moved where its squared evidence exceeds that of noise by this factor. Under
noise alone the ratio is exponentially distributed: 1 in 150 by chance."""


def gel_touch(evidence: Vector, center_px: Vector, noise: float) -> GelTouch | None:
    """Return place and direction from the markers' evidence, or None where no marker moved.

    Args:
        evidence: ``(m, 2)`` sum of each marker's evidence since the onset.
        center_px: ``(m, 2)`` centres of the markers, px.
        noise: Expected squared length of a marker's evidence without contact.
    """
    power = (evidence**2).sum(axis=1)
    weight = np.maximum(power - MOVED_RATIO * noise, 0.0)
    moved = weight > 0.0
    if not moved.any():
        return None
    weight = weight / weight.sum()
    place = weight @ center_px
    unit = evidence / np.sqrt(np.maximum(power, np.finfo(float).tiny))[:, None]
    away = center_px - place
    arm = weight @ np.hypot(away[:, 0], away[:, 1])
    moment = weight @ (away[:, 0] * unit[:, 1] - away[:, 1] * unit[:, 0])
    push = weight @ unit
    return GelTouch(
        place_px=(float(place[0]), float(place[1])),
        push=(float(push[0]), float(push[1])),
        turn=float(moment / arm) if arm > 0.0 else 0.0,
        markers=int(moved.sum()),
    )


def likeliest_onset(progress: Vector) -> int:
    """Return the maximum-likelihood onset of a drift that lasts to the end, in windows.

    For Gaussian sums the likeliest time of change is the minimum of the running sum less a
    reference drift (Page, Biometrika 41, 1954). The reference is half the mean drift since then.

    Args:
        progress: ``(n + 1,)`` running sum along the contact's direction, from 0 windows on.
    """
    lowest = int(progress.argmin())
    slope = (progress[-1] - progress[lowest]) / max(len(progress) - 1 - lowest, 1)
    return int((progress - 0.5 * slope * np.arange(len(progress))).argmin())
