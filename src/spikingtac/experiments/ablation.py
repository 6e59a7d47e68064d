"""What each idea of the default tracker is worth: one change at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from spikingtac.config import Config, load_config
from spikingtac.events.filters import BackgroundActivityConfig, BackgroundActivityFilter
from spikingtac.experiments.methods import Method, of_config
from spikingtac.experiments.trials import Trial
from spikingtac.registry import make_tracker
from spikingtac.schema import to_mapping
from spikingtac.types import Calibration, EventPacket

ABLATION_SCENES = ("mixed", "finger-slides", "drag-release")
"""Trajectories of the ablations."""

RATES_HZ = (100, 350, 2_000, 10_000)
LOSSES = (0.1, 0.3, 0.5)
CONTRASTS = (3.0, 4.5, 9.0, 12.0)
CAPS_MEV_S = (0.5, 1.0)
BLURS_PX = (1.0, 1.5)
SHIFT_PX = 1.0
"""Error of the wrong calibration, each coordinate in turn."""

GAMMAS, DELTAS_PX = (0.3, 0.5, 0.7, 1.0), (2.0, 4.0, 6.0)
"""Sweep of the published law."""


def ablation_methods() -> dict[str, Method]:
    """Return the default tracker and its variants."""
    base = load_config("default")
    methods = [
        of_config("default", "unchanged", base),
        _changed(
            "default-binary-map", "every event sets its pixel, as in the paper", base, _binary
        ),
        _filtered("default-activity-filter", "background-activity filter before the map", base),
        _care("default-no-lag", "no lag correction", base, lag_us=0.0),
        _care("default-no-leak", "the map never leaks", base, leak_per_s=0.0),
        _care(
            "default-no-adaptation", "steps do not adapt to lost events", base, adapt_to_loss=False
        ),
        of_config(
            "default-no-grid-pull",
            "no pull of the neighbours",
            base.with_tracking(disc=replace(base.tracking.disc, grid_weight=0.0)),
        ),
        of_config(
            "default-centroid", "centroid for disc fit", base.with_tracking(method="centroid")
        ),
        _changed("default-calibration-1px-off", "references 1 px off", base, _shifted),
        _changed("default-contrast-3", "contrast taken for 3", base, _contrast(3.0)),
        _changed("default-contrast-12", "contrast taken for 12", base, _contrast(12.0)),
        _changed("default-uniform-steps", "one step for all pixels", base, _uniform),
        of_config("default-law-paper", "published law", base.with_tracking(hysteresis="paper")),
        of_config(
            "default-law-anchored", "anchored law", base.with_tracking(hysteresis="anchored")
        ),
        *(
            of_config(f"default-{rate}-hz", f"{rate} estimates/s", base.with_tracking(rate_hz=rate))
            for rate in RATES_HZ
        ),
        *(_law(base, gamma, delta) for gamma in GAMMAS for delta in DELTAS_PX),
        *_paper_variants(),
    ]
    return {method.name: method for method in methods}


def ablation_trials(seeds: range, scenes: Iterable[str]) -> list[Trial]:
    """Return the trials under which the variants are compared: light, noise and loss, too."""
    trials = []
    for scene in scenes:
        for seed in seeds:
            base = Trial(case=scene, scene=scene, seed=seed, serial=1 + seed, groups=("all",))
            trials += [
                base,
                replace(base, camera="clean", case=f"clean/{scene}", groups=("clean/all",)),
                replace(base, camera="noisy", case=f"noisy/{scene}", groups=("noisy/all",)),
                *(_lossy(base, loss) for loss in LOSSES),
                *(_set(base, f"contrast-{c:g}", {"light": {"contrast": c}}) for c in CONTRASTS),
                *(_set(base, f"cap-{c:g}", {"readout": {"cap_mev_s": c}}) for c in CAPS_MEV_S),
                *(_set(base, f"blur-{b:g}", {"light": {"blur_px": b}}) for b in BLURS_PX),
            ]
    return trials


def _lossy(base: Trial, loss: float) -> Trial:
    prefix = f"loss{100 * loss:.0f}"
    return replace(base, loss=loss, case=f"{prefix}/{base.scene}", groups=(f"{prefix}/all",))


def _set(base: Trial, prefix: str, settings: dict[str, dict[str, float]]) -> Trial:
    case, groups = f"{prefix}/{base.scene}", (f"{prefix}/all",)
    return replace(base, settings=settings, case=case, groups=groups)


def _care(name: str, about: str, base: Config, **changes: float | bool) -> Method:
    care = replace(base.tracking.care, **changes)  # type: ignore[arg-type]
    return of_config(name, about, base.with_tracking(care=care))


def _law(base: Config, gamma: float, delta_px: float) -> Method:
    law = replace(base.tracking.paper_law, gamma=gamma, delta_px=delta_px)
    config = base.with_tracking(hysteresis="paper", paper_law=law)
    name = f"default-law-gamma{gamma:g}-delta{delta_px:g}"
    return of_config(name, f"published law, gamma {gamma:g}, delta {delta_px:g} px", config)


def _paper_variants() -> Iterator[Method]:
    base = load_config("paper")
    for denoiser in ("none", "median3", "box7"):
        config = base.with_tracking(denoiser=denoiser, hysteresis="none")
        yield of_config(f"paper-{denoiser}", f"published front end, denoiser {denoiser}", config)


def _changed(
    name: str, about: str, base: Config, change: Callable[[Calibration], Calibration]
) -> Method:
    return replace(
        of_config(name, about, base),
        build=lambda calibration: make_tracker(base.tracking, change(calibration)),
        settings={"change": about, **to_mapping(base.tracking)},
    )


def _filtered(name: str, about: str, base: Config) -> Method:
    return replace(
        of_config(name, about, base),
        before=_without_lone_events,
        settings={"change": about, **to_mapping(base.tracking)},
    )


def _without_lone_events(
    packets: Iterable[EventPacket], calibration: Calibration
) -> Iterator[EventPacket]:
    keep = BackgroundActivityFilter(BackgroundActivityConfig(), calibration.size)
    return (keep(packet) for packet in packets)


def _binary(calibration: Calibration) -> Calibration:
    return replace(calibration, step_on=1.0, step_off=1.0, step_on_map=None, step_off_map=None)


def _uniform(calibration: Calibration) -> Calibration:
    return replace(calibration, step_on_map=None, step_off_map=None)


def _contrast(contrast: float) -> Callable[[Calibration], Calibration]:
    return lambda calibration: replace(calibration, contrast=contrast)


def _shifted(calibration: Calibration) -> Calibration:
    sign = np.where(np.arange(len(calibration.reference_px)) % 2, 1.0, -1.0)[:, None]
    shift = sign * np.array([SHIFT_PX, -SHIFT_PX]) / np.sqrt(2.0)
    return replace(calibration, reference_px=calibration.reference_px + shift)
