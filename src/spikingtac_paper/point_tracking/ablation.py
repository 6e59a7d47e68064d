"""The ablations: variants of the default tracker under several lights, noises and event losses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from spikingtac import Calibration, MarkerTracker, make_tracker
from spikingtac.config import Config, load_config
from spikingtac.events import BackgroundActivityFilter
from spikingtac.types import EventPacket, MarkerFrame
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
    others = {method.name: method for method in (*_references(), *compared_laws())}
    return default_variants() | others


def default_variants() -> dict[str, Method]:
    """Return the default tracker, and the same with one part changed or left out."""
    return {method.name: method for method in _variants()}


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


def _variants() -> Iterator[Method]:
    base = load_config("default")
    yield of_config("default", "unchanged", base)
    yield _changed(
        "default-binary-map", "every event sets its pixel, as in the paper", base, _binary
    )
    filtered = of_config(
        "default-activity-filter", "filter of isolated events before the map", base
    )
    yield replace(filtered, before=_without_isolated_events)
    yield _without_hold("default-no-hold", "an unobserved marker is output at rest", base)
    yield _changed_disc("default-no-lag", "no lag correction", base, lag_us=0.0)
    yield _changed_disc("default-no-leak", "the map never leaks", base, leak_per_s=0.0)
    yield _changed_disc(
        "default-no-adaptation", "steps fixed under event loss", base, adapt_to_loss=False
    )
    yield _changed_disc("default-no-backlash", "no backlash correction", base, backlash=0.0)
    yield _changed_disc("default-no-shrinkage", "no shrinkage to neighbours", base, shrink=0.0)
    levels = base.with_tracking(rare_off_method="")
    yield of_config("default-levels", "levels also where OFF events are rare", levels)
    yield _changed("default-no-recovery", "pixels that recover are not known", base, _lasting)
    bands = base.with_tracking(method="bands")
    yield of_config("default-bands", "band fit in place of the disc fit", bands)
    yield _changed("default-calibration-1px-off", "references 1 px off", base, _shifted)
    yield _changed("default-contrast-3", "contrast assumed to be 3", base, _contrast(3.0))
    yield _changed("default-contrast-12", "contrast assumed to be 12", base, _contrast(12.0))
    yield _changed("default-uniform-steps", "one step for all pixels", base, _uniform)
    for rate in RATES_HZ:
        faster = base.with_tracking(rate_hz=float(rate))
        yield of_config(f"default-{rate}-hz", f"{rate} estimates per second", faster)


def _references() -> Iterator[Method]:
    """Yield the other presets, and the published pipeline with one part changed."""
    paper = load_config("paper")
    yield of_config("fast", "the same tracker at 10 kHz", load_config("fast"))
    yield of_config("paper", "the published pipeline with a filter and a refreshed map", paper)
    kept = paper.with_tracking(blobs=replace(paper.tracking.blobs, refresh_us=0))
    yield of_config("paper-kept-map", "the map is never refreshed", kept)
    yield as_published("paper-printed", "without filter and refreshed map, as printed")
    yield _without_hold("paper-no-hold", "no hold: a marker without a blob is at rest", paper)
    for denoiser in ("none", "median3", "box7"):
        config = paper.with_tracking(denoiser=denoiser)
        yield of_config(f"paper-{denoiser}", f"denoiser {denoiser} for the network", config)


def _changed_disc(name: str, about: str, base: Config, **changes: float | bool) -> Method:
    disc = replace(base.tracking.disc, **changes)  # type: ignore[arg-type]
    return of_config(name, about, base.with_tracking(disc=disc))


def _changed(
    name: str, about: str, base: Config, change: Callable[[Calibration], Calibration]
) -> Method:
    def build(calibration: Calibration) -> MarkerTracker:
        return make_tracker(base.tracking, change(calibration))

    return replace(of_config(name, about, base), build=build)


def _without_hold(name: str, about: str, base: Config) -> Method:
    def build(calibration: Calibration) -> MarkerTracker:
        return NoHold(make_tracker(base.tracking, calibration), calibration)

    return replace(of_config(name, about, base), build=build, reads=())


def _without_isolated_events(
    packets: Iterable[EventPacket], calibration: Calibration
) -> Iterator[EventPacket]:
    keep = BackgroundActivityFilter(calibration.size)
    return (keep(packet) for packet in packets)


def _binary(calibration: Calibration) -> Calibration:
    return replace(calibration, step_on=1.0, step_off=1.0, step_on_map=None, step_off_map=None)


def _uniform(calibration: Calibration) -> Calibration:
    return replace(calibration, step_on_map=None, step_off_map=None)


def _lasting(calibration: Calibration) -> Calibration:
    return replace(calibration, recovery_s=None)


def _contrast(contrast: float) -> Callable[[Calibration], Calibration]:
    return lambda calibration: replace(calibration, contrast=contrast)


def _shifted(calibration: Calibration) -> Calibration:
    sign = np.where(np.arange(len(calibration.reference_px)) % 2, 1.0, -1.0)[:, None]
    shift = sign * np.array([SHIFT_PX, -SHIFT_PX]) / np.sqrt(2.0)
    return replace(calibration, reference_px=calibration.reference_px + shift)


class NoHold:
    """Outputs the rest position for each marker that coasts or is predicted."""

    def __init__(self, tracker: MarkerTracker, calibration: Calibration) -> None:
        """Wrap a tracker; its own state does not change.

        Args:
            tracker: Any tracker.
            calibration: The calibration, with the rest positions.
        """
        self._tracker, self._rest_px = tracker, calibration.reference_px

    def absorb(self, packet: EventPacket) -> None:
        """Pass the events on."""
        self._tracker.absorb(packet)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the tracker's frame with unobserved markers at rest."""
        frame = self._tracker.estimate(t_us)
        coasted = frame.coasted[:, None]
        detected_px = np.where(coasted, self._rest_px, frame.detected_px)
        position_px = np.where(coasted, self._rest_px, frame.position_px)
        return replace(
            frame,
            detected_px=detected_px,
            position_px=position_px,
            displacement_px=position_px - self._rest_px,
        )

    def reset(self) -> None:
        """Reset the tracker."""
        self._tracker.reset()
