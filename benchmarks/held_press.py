"""How the force of a press that is held for a minute drifts, with and without creep taken off.

    python benchmarks/held_press.py

Bodies press on the twin's gel without camera (places with an error of 0.05 px); the force is told
from the skin's stiffness. Printed is the change of told over true normal force between the second
second and the last two: a constant error cancels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.gel.indenters import IndenterConfig
from spikingtac.sim.scene.motions import MotionConfig
from spikingtac.sim.scene.scene import ContactConfig, Scene
from spikingtac.sim.scene.segments import SegmentConfig
from spikingtac.sim.scene.source import SceneSource
from spikingtac.touch.elastic.surface_response import SkinConfig
from spikingtac.touch.elastic.synthetic_contacts import synthetic_series
from spikingtac.touch.force.creep_memory import CreepConfig, CreepMemory
from spikingtac.touch.force.fit import fit_force
from spikingtac.touch.force.wrench_series import WrenchSeries
from spikingtac_paper.touch.twin_wrench import _px_per_mm

HOLD_S, NOISE_PX, SEED = 60.0, 0.05, 3
EARLY_S, LATE_S = (1.5, 3.0), (58.0, 60.0)
BODIES = (
    ("ball", {"radius_x_mm": 5.0, "radius_y_mm": 5.0}, 0.7),
    ("punch", {"radius_mm": 3.0}, 0.35),
    ("finger", {"radius_x_mm": 7.0, "radius_y_mm": 7.0}, 1.6),
)


def held(kind: str, settings: dict[str, float], depth_mm: float) -> Scene:
    """Return a scene with one press that is held."""
    segments = (
        SegmentConfig(kind="press", depth_mm=depth_mm, duration_s=0.4),
        SegmentConfig(kind="hold", duration_s=HOLD_S),
        SegmentConfig(kind="lift", height_mm=0.3, duration_s=0.3),
    )
    motion = MotionConfig(x_mm=1.0, y_mm=-0.5, height_mm=0.2, segments=segments)
    contact = ContactConfig(indenter=IndenterConfig(kind=kind, settings=settings), motion=motion)
    return Scene(
        about="a held press", lead_in_s=0.2, lead_out_s=0.2, mechanics_hz=50.0, contacts=(contact,)
    )


def pressed(source: SceneSource, creep: CreepConfig) -> WrenchSeries:
    """Return the markers of a scene, without the creep, and the true wrench."""
    rng, memory = np.random.default_rng(0), CreepMemory(creep)
    times, moved, wrench = [], [], []
    for state, image in source.frames():
        away = image.center_px - source.reference_px
        noisy = away + rng.normal(0.0, NOISE_PX, away.shape)
        times.append(state.t_us)
        moved.append(memory.elastic(state.t_us, noisy))
        wrench.append(np.concatenate([state.force_n, np.zeros(3)]))
    return WrenchSeries(
        np.array(times, np.int64),
        source.reference_px,
        np.array(moved),
        np.array(wrench),
        "px",
        "held",
    )


def main() -> None:
    """Print the drifts of three bodies."""
    model = None
    for body in BODIES:
        scene = held(*body)
        gel = scene.gel
        creeps = {
            "as seen": CreepConfig(),
            "creep off": CreepConfig(
                fractions=gel.spectrum.fractions, times_s=gel.spectrum.times_s
            ),
        }
        for name, creep in creeps.items():
            source = SceneSource(scene, SEED)
            series = pressed(source, creep)
            if model is None:
                skin = SkinConfig(
                    shear_modulus_kpa=gel.shear_modulus_kpa,
                    thickness_mm=gel.thickness_mm,
                    camera_distance_mm=scene.optics.distance_mm,
                )
                scale = _px_per_mm(source.reference_px)
                model = fit_force([], drawn=synthetic_series(skin, source.reference_px, scale))
            told = model.estimate(series)[0][:, 2]
            early, late = (_mean_ratio(series, told, span) for span in (EARLY_S, LATE_S))
            print(f"{body[0]}, {name}: {late / early - 1:+.1%}")


def _mean_ratio(
    series: WrenchSeries, told: NDArray[np.float64], span_s: tuple[float, float]
) -> float:
    chosen = (series.t_us > 1e6 * span_s[0]) & (series.t_us < 1e6 * span_s[1])
    return float(told[chosen].mean() / series.wrench[chosen, 2].mean())


if __name__ == "__main__":
    main()
