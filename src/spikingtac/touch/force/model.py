"""A fitted force model, and the stream of wrenches that it makes from marker displacements."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.touch.force.creep_memory import CreepConfig, CreepMemory
from spikingtac.touch.force.laws import ComponentLaw
from spikingtac.touch.force.live.one_field import OneField
from spikingtac.touch.force.novelty import Novelty
from spikingtac.touch.force.rest_zero import RestZero, RestZeroConfig
from spikingtac.touch.force.shape import FieldBasis, FieldFeatures, amplitude
from spikingtac.touch.force.stacked_laws import StackedLaws
from spikingtac.touch.force.wrench_series import COMPONENTS, UNITS, WrenchSeries

Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Wrench:
    """The force and the moment that the skin feels at one time.

    Attributes:
        t_us: Time, us.
        values: ``(c,)`` forces in N, then moments in Nm: the model's components.
        half_width: ``(c,)`` half of the 90 % interval of each, in its unit.
        distance: How far the field is from those that were learned; above 1 is beyond them.
    """

    t_us: int
    values: Field
    half_width: Field
    distance: float

    @property
    def force_n(self) -> Field:
        """``(3,)`` force, N."""
        return self.values[:3]

    @property
    def extrapolated(self) -> bool:
        """True where the model was never taught anything like this field."""
        return self.distance > 1.0


@dataclass(frozen=True, slots=True)
class Interval:
    """Half-width of a 90 % interval: a floor and a share of the amount, widened by distance.

    Attributes:
        floor: Half-width at rest, N or Nm.
        share: Growth of the half-width with the absolute estimate.
    """

    floor: float
    share: float


@dataclass(frozen=True, kw_only=True)
class ForceModel:
    """Laws from displacements to a wrench; made by :func:`spikingtac.touch.force.fit.fit_force`.

    Attributes:
        unit: Unit of the displacements, ``"mm"`` or ``"px"``.
        reference: ``(m, d)`` markers of the series that were learned, in ``unit``.
        rms: Root mean square of the training displacements, in ``unit``.
        basis: What fields are described by.
        laws: One law per component.
        intervals: One interval per component.
        novelty: What distance to the learned fields is.
        zero: How the rest is followed.
        creep: How the skin creeps under a constant force.
        about: Where the model came from: files, frames, ranges, errors between series.
    """

    unit: str
    reference: Field
    rms: float
    basis: FieldBasis
    laws: tuple[ComponentLaw, ...]
    intervals: tuple[Interval, ...]
    novelty: Novelty
    zero: RestZeroConfig
    creep: CreepConfig = field(default_factory=CreepConfig)
    about: dict[str, Any] = field(default_factory=dict)
    _stacked: StackedLaws = field(init=False, repr=False, compare=False)
    _widths: tuple[Field, Field] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._require_consistency()
        object.__setattr__(self, "_stacked", StackedLaws(self.laws, self.basis))
        floors = np.array([interval.floor for interval in self.intervals])
        shares = np.array([interval.share for interval in self.intervals])
        object.__setattr__(self, "_widths", (floors, shares))

    def _require_consistency(self) -> None:
        """Refuse parts that do not fit each other: the compiled estimate would not notice."""
        size, modes = self.basis.modes.shape
        deviations = len(self.novelty.deviation)
        if self.unit not in UNITS or not self.rms > 0:
            raise ConfigError(f"unit {self.unit!r} and rms {self.rms} are not mm or px and above 0")
        if self.reference.shape != (size // self.basis.dimensions, self.basis.dimensions):
            raise ConfigError(f"modes of {size} numbers do not fit markers {self.reference.shape}")
        if self.basis.centers.ndim != 2 or self.basis.centers.shape[1] != modes + 1:
            raise ConfigError(f"centers {self.basis.centers.shape} do not fit {modes} modes")
        if not 0 < deviations <= modes or not self.novelty.edge > 0:
            raise ConfigError(f"a novelty of {deviations} deviations does not fit {modes} modes")
        if len(self.laws) != len(self.intervals) or not 3 <= len(self.laws) <= len(COMPONENTS):
            raise ConfigError(f"{len(self.laws)} laws and {len(self.intervals)} intervals")

    @property
    def components(self) -> tuple[str, ...]:
        """Names of what is estimated."""
        return COMPONENTS[: len(self.laws)]

    def fields(self, series: WrenchSeries) -> Field:
        """Return the fields ``(n, m d)`` of a series from its zero, over the training rms.

        Raises:
            ConfigError: The series has other markers, another unit or no depth.
        """
        self._check(series)
        flat = series.displacement[:, :, : self.reference.shape[1]].reshape(len(series.t_us), -1)
        rest, creep = self._rest(), CreepMemory(self.creep)
        return fields_from_rest(series.t_us, flat / self.rms, creep, rest)

    def estimate(self, series: WrenchSeries) -> tuple[Field, Field, Field]:
        """Return values ``(n, c)``, half-widths ``(n, c)`` and distances ``(n,)`` of a series.

        The zero is learned from the series itself, causally.

        Raises:
            ConfigError: The series does not fit the model.
        """
        return self._evaluate(self.fields(series))

    def estimator(self) -> ForceEstimator:
        """Return a stream of wrenches that starts at the calibrated rest."""
        return ForceEstimator(self)

    def require_image(self, markers: int) -> None:
        """Refuse to be used on a tracker's frames of that many markers, px in the image.

        Raises:
            ConfigError: The model was learned on another sensor, in another unit or with depth.
        """
        if (len(self.reference), self.reference.shape[1], self.unit) == (markers, 2, "px"):
            return
        raise ConfigError(
            f"the force model is of {len(self.reference)} markers in {self.reference.shape[1]} "
            f"coordinates in {self.unit}, the tracker gives {markers} in 2 in px; "
            "fit one on tracks: spikingtac force fit tracks.npz --wrench FORCES -o force.json"
        )

    def _one_field(self) -> OneField:
        return self._stacked.one_field(self.basis, self.novelty)

    def _rest(self) -> RestZero:
        return RestZero(self.zero, self.zero.radius_share, self.reference.size)

    def _evaluate(self, fields: Field) -> tuple[Field, Field, Field]:
        features = FieldFeatures(fields, self.basis)
        values = self._stacked(features)
        distance = self.novelty(fields, self.basis.modes)
        floors, shares = self._widths
        widths = (floors + shares * np.abs(values)) * np.maximum(distance, 1.0)[:, None]
        return values, widths, distance

    def _check(self, series: WrenchSeries) -> None:
        markers, depth = self.reference.shape
        if series.unit != self.unit:
            raise ConfigError(
                f"{series.name} is in {series.unit}, the force model was learned in {self.unit}; "
                "fit a model on displacements of that unit"
            )
        if len(series.reference) != markers:
            raise ConfigError(
                f"{series.name} has {len(series.reference)} markers, the force model {markers}; "
                "a force model belongs to one sensor"
            )
        if series.displacement.shape[2] < depth:
            raise ConfigError(
                f"{series.name} has no depth, the force model was learned with it; "
                "fit one without: spikingtac force fit FILES -o force.json"
            )


class ForceEstimator:
    """A causal stream: one frame of displacements in, one wrench out.

    Example:
        >>> estimator = load_force("force.json").estimator()  # doctest: +SKIP
        >>> moved_px = frame.detected_px - calibration.reference_px  # doctest: +SKIP
        >>> estimator.update(frame.t_us, moved_px).force_n  # doctest: +SKIP
    """

    def __init__(self, model: ForceModel) -> None:
        self._model, self._wrench = model, model._one_field()
        self.reset()

    def reset(self) -> None:
        """Return to the calibrated rest."""
        self._rest = self._model._rest()
        self._creep = CreepMemory(self._model.creep)

    def update(self, t_us: int, displacement: Field) -> Wrench:
        """Take in displacements ``(m, d)`` in the model's unit and return the wrench.

        Raises:
            ConfigError: They are not of the model's markers and coordinates.
        """
        if displacement.shape != self._model.reference.shape:
            raise ConfigError(
                f"displacements of shape {displacement.shape} do not fit the force model, whose "
                f"markers are {self._model.reference.shape}; fit a model of this sensor: "
                "spikingtac force fit"
            )
        elastic = self._creep.elastic(t_us, displacement.ravel() / self._model.rms)
        away = self._rest.subtract(t_us, elastic)
        values, distance = self._wrench(away)
        floors, shares = self._model._widths
        widths = (floors + shares * np.abs(values)) * max(distance, 1.0)
        return Wrench(t_us, values, widths, distance)


def fields_from_rest(
    t_us: NDArray[np.int64], fields: Field, creep: CreepMemory, rest: RestZero
) -> Field:
    """Return fields ``(n, size)`` without creep and from the zero of their time."""
    rows = zip(t_us.tolist(), fields, strict=True)
    elastic = [creep.elastic(time_us, row) for time_us, row in rows]
    return rest.subtract_all(t_us, np.array(elastic).reshape(fields.shape))


def field_rms(fields: Field) -> float:
    """Return the root mean square of displacements of any shape."""
    return float(np.sqrt(np.mean(amplitude(fields.reshape(len(fields), -1), 0.0) ** 2)))
