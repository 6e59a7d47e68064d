"""The ablations: variants of the default tracker under several lights, noises and event losses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from spikingtac import Calibration, MarkerTracker, make_tracker
from spikingtac.config import Config, load_config
from spikingtac.events import BackgroundActivityFilter
from spikingtac.types import EventPacket
from spikingtac_paper.point_tracking.cases import CAMERAS, LOOPS
from spikingtac_paper.trials.methods import (
    Method,
    as_published,
    compared_laws,
    of_config,
)
from spikingtac_paper.trials.trial import Trial

ABLATION_SCENES = ("mixed", "finger-slides", "drag-release")  # Trajectories of the ablations.

# Methods that run under every light, noise and loss; the variants run with three cameras.
COMPARED = ("default", "fast", "paper")

RATES_HZ = (100, 350, 2_000, 10_000)
LOSSES = (0.1, 0.3, 0.5)
CONTRASTS = (3.0, 4.5, 9.0, 12.0)
CAPS_MEV_S = (0.5, 1.0)
BLURS_PX = (1.0, 1.5)
NOISES_HZ = (0.3, 1.0, 3.0)  # Background rates per pixel that replace the rate of ``typical``, Hz.

SHIFT_PX = 1.0  # Error of the wrong calibration, px.


def ablation_methods() -> dict[str, Method]:
    """Return the default tracker, its variants, and those of the published pipeline."""
    paper = load_config("paper")
    kept_map = paper.with_tracking(blobs=replace(paper.tracking.blobs, refresh_us=0))
    methods = [
        of_config("fast", "the same tracker at 10 kHz"),
        of_config("paper", "the published pipeline with a filter and a refreshed map"),
        of_config("paper-kept-map", "the map is never refreshed", kept_map),
        as_published("paper-printed", "without filter and refreshed map, as printed"),
    ]
    for name in ("none", "median3", "box7"):
        filtered = paper.with_tracking(denoiser=name)
        methods.append(of_config(f"paper-{name}", f"denoiser {name} for the network", filtered))
    methods += compared_laws()
    return default_variants() | {method.name: method for method in methods}


def default_variants() -> dict[str, Method]:
    """Return the default tracker, and the same with one part changed or left out."""
    base = load_config("default")

    def disc(**changes: float | bool) -> Config:
        return base.with_tracking(disc=replace(base.tracking.disc, **changes))  # type: ignore[arg-type]

    configs = {
        "default": ("unchanged", base),
        "default-no-leak": ("the map never leaks", disc(leak_per_s=0.0)),
        "default-no-adaptation": ("steps fixed under event loss", disc(adapt_to_loss=False)),
        "default-no-backlash": ("no backlash correction", disc(backlash=0.0)),
        "default-no-shrinkage": ("no shrinkage to neighbours", disc(shrink=0.0)),
        "default-levels": ("levels also where steps are large", disc(dead_bands=False)),
    }
    for rate in RATES_HZ:
        faster = base.with_tracking(rate_hz=float(rate))
        configs[f"default-{rate}-hz"] = f"{rate} estimates per second", faster
    methods = [of_config(name, about, config) for name, (about, config) in configs.items()]
    methods += [_wrongly_calibrated(name, base) for name in WRONG_CALIBRATIONS]
    about = "filter of isolated events before the map"
    isolated = of_config("default-activity-filter", about, base)
    methods.append(replace(isolated, before=_without_isolated_events))
    return {method.name: method for method in methods}


def methods_on(trial: Trial) -> tuple[str, ...]:
    """Return the names of the methods that run on a trial of the ablations."""
    if trial.case == LOOPS:
        return ("default", *(method.name for method in compared_laws()))
    if trial.settings or f"{trial.case.removesuffix(trial.scene)}" not in CAMERAS:
        return COMPARED
    return tuple(ablation_methods())


def ablation_trials(seeds: range, scenes: Iterable[str]) -> list[Trial]:
    """Return the trials of the ablations: cameras, light, noise and event loss."""
    trials = []
    for scene in scenes:
        for seed in seeds:
            base = Trial(case=scene, scene=scene, seed=seed, serial=1 + seed, groups=("all",))
            trials += [
                *(_under(base, prefix, *camera) for prefix, camera in CAMERAS.items()),
                _under(base, "clean/", "clean", 0.0),
                *(_under(base, f"loss{100 * loss:.0f}/", "typical", loss) for loss in LOSSES),
                *(_set(base, f"noise-{n:g}", {"background": {"rate_hz": n}}) for n in NOISES_HZ),
                *(_set(base, f"contrast-{c:g}", {"light": {"contrast": c}}) for c in CONTRASTS),
                *(_set(base, f"cap-{c:g}", {"readout": {"cap_mev_s": c}}) for c in CAPS_MEV_S),
                *(_set(base, f"blur-{b:g}", {"light": {"blur_px": b}}) for b in BLURS_PX),
            ]
    loops = [Trial(case=LOOPS, scene=LOOPS, seed=seed, serial=1 + seed) for seed in seeds]
    return [*loops, *trials]


def _under(base: Trial, prefix: str, camera: str, loss: float) -> Trial:
    case, groups = f"{prefix}{base.scene}", (f"{prefix}all",)
    return replace(base, camera=camera, loss=loss, case=case, groups=groups)


def _set(base: Trial, prefix: str, settings: dict[str, dict[str, float]]) -> Trial:
    case, groups = f"{prefix}/{base.scene}", (f"{prefix}/all",)
    return replace(base, settings=settings, case=case, groups=groups)


def _shifted(calibration: Calibration) -> Calibration:
    sign = np.where(np.arange(len(calibration.reference_px)) % 2, 1.0, -1.0)[:, None]
    shift = sign * np.array([SHIFT_PX, -SHIFT_PX]) / np.sqrt(2.0)
    return replace(calibration, reference_px=calibration.reference_px + shift)


# Methods that take the calibration for another: name -> what differs, and how.
WRONG_CALIBRATIONS: dict[str, tuple[str, Callable[[Calibration], Calibration]]] = {
    "default-no-lag": ("no lag correction", lambda one: replace(one, lag_us=0.0)),
    "default-binary-map": (
        "every event sets its pixel, as in the paper",
        lambda one: replace(one, step_on=1.0, step_off=1.0, step_on_map=None, step_off_map=None),
    ),
    "default-no-recovery": (
        "pixels that recover are not known", lambda one: replace(one, recovery_s=None)
    ),
    "default-calibration-1px-off": ("references 1 px off", _shifted),
    "default-contrast-3": ("contrast assumed to be 3", lambda one: replace(one, contrast=3.0)),
    "default-contrast-12": ("contrast assumed to be 12", lambda one: replace(one, contrast=12.0)),
    "default-uniform-steps": (
        "one step for all pixels", lambda one: replace(one, step_on_map=None, step_off_map=None)
    ),
}  # fmt: skip


def _wrongly_calibrated(name: str, base: Config) -> Method:
    about, change = WRONG_CALIBRATIONS[name]

    def build(calibration: Calibration) -> MarkerTracker:
        return make_tracker(base.tracking, change(calibration))

    return replace(of_config(name, about, base), build=build)


def _without_isolated_events(
    packets: Iterable[EventPacket], calibration: Calibration
) -> Iterator[EventPacket]:
    keep = BackgroundActivityFilter(calibration.size)
    return (keep(packet) for packet in packets)
