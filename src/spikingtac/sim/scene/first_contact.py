"""Touch a scene's gel once, so that its kernels are compiled before real time begins."""

from __future__ import annotations

from spikingtac.sim.gel.gel import Gel
from spikingtac.sim.scene.scene import Scene
from spikingtac.sim.scene.timeline import Timeline

TOUCHED_S, TOUCH_STEP_S = 1.0, 0.02
"""Every scene of the package touches within its first second; coarse steps will do."""


def touch_once(scene: Scene, seed: int) -> None:
    """Simulate a scene's first contact with the gel, so that the gel's kernels are in the cache."""
    gel, timeline = Gel(scene.gel, scene.skin.rest_mm()), Timeline(scene, seed)
    for step in range(round(TOUCHED_S / TOUCH_STEP_S)):
        gel.step(TOUCH_STEP_S, *(timeline.at(step * TOUCH_STEP_S) or (None, None)))
