"""A fitted force model, and the stream of wrenches that it makes from marker displacements."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing
from spikingtac.errors import ConfigError
from spikingtac.touch.force.field_stream import FieldStream
from spikingtac.touch.force.series import COMPONENTS, WrenchSeries
from spikingtac.touch.network import Network, read, with_record

Field = NDArray[np.float64]

SCHEMA = 5  # Version of the record.
SIGMAS_90 = 1.645  # Standard deviations in half of a 90 % interval of normal errors.
HINT = "make one with: spikingtac force fit FILES -o force.onnx"

# Amplitude, in radii of rest, at which half of the network's error at rest is taken off (ours).
REST_RADII = 2.0

# Distance from the learned markers, in their own nearest distance, up to which markers are of the
# same layout (ours: the references of data/force differ by 0.16 between series).
LAYOUT_PITCHES = 0.35


@dataclass(frozen=True, slots=True)
class Wrench:
    """The force and the moment that the skin feels at one time.

    Attributes:
        t_us: Time, us.
        values: ``(c,)`` forces in N, then moments in Nm: the model's components.
        half_width: ``(c,)`` half of the 90 % interval of each, in its unit.
    """

    t_us: int
    values: Field
    half_width: Field

    @property
    def force_n(self) -> Field:
        """``(3,)`` force, N."""
        return self.values[:3]

    @property
    def force_sigma_n(self) -> Field:
        """``(3,)`` one standard deviation of it, N."""
        return self.half_width[:3] / SIGMAS_90

    def exceeds(self, limit_n: float) -> bool:
        """Return whether the force is surely larger than a limit, N: less its 90 % interval."""
        nearest = np.maximum(np.abs(self.force_n) - self.half_width[:3], 0.0)
        return bool(np.sqrt((nearest**2).sum()) > limit_n)


class Target(NamedTuple):
    """Another sensor, on which a model is used that was learned elsewhere.

    Attributes:
        resample: ``(m, k)`` from the displacements of its k markers to those of the m learned.
        gain: ``(c, c)`` from the wrench that is told of them to its own.
    """

    resample: Field
    gain: Field

    @classmethod
    def read(cls, record: dict[str, Any]) -> Target:
        """Return the target of a model's record."""
        return cls(np.array(record["resample"], np.float64), np.array(record["gain"], np.float64))

    def fields(self, fields: Field) -> Field:
        """Return fields ``(n, 2 k)`` of its markers as ``(n, 2 m)`` of those that were learned."""
        moved = fields.reshape(len(fields), -1, 2)
        return np.einsum("mk,nkd->nmd", self.resample, moved).reshape(len(fields), -1)


class ForceModel:
    """A network from displacements to a wrench, with its record.

    Attributes:
        record: Where the model came from: series, frames, ranges, errors between series.
        unit: Unit of the displacements, ``"mm"`` or ``"px"``.
        reference: ``(m, 2)`` markers of the series that were learned, in ``unit``.
        components: Names of what is estimated.
    """

    def __init__(self, network: Network, where: str = "the force model") -> None:
        """Take a network and check its record.

        Raises:
            ConfigError: It is no force model of this version.
        """
        self._network = network
        self.record: dict[str, Any] = network.record
        try:
            if self.record["schema"] != SCHEMA:
                raise ValueError(f"schema {self.record['schema']}, this version reads {SCHEMA}")
            self.unit: str = self.record["unit"]
            self.reference = np.array(self.record["reference"], np.float64)
            self.components = COMPONENTS[: len(self.record["interval"])]
            self._interval = np.array(self.record["interval"], np.float64).T
            self.rest_radius = float(self.record["rest_radius"])
            self.memory = bool(self.record["memory"])
            target = self.record.get("target")
            self._target = None if target is None else Target.read(target)
            size = self.reference.size if self._target is None else 2 * len(self._target.resample)
            self._zero = zero_wrench(self._network, size)
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(f"{where} holds no force model: {error}; {HINT}") from error

    def require(self, reference: Field, unit: str, name: str = "the tracker") -> None:
        """Refuse markers of another layout, number, scale or unit.

        Args:
            reference: ``(m, 2)`` markers at rest.
            unit: Their unit.
            name: Whose they are, for the message.

        Raises:
            ConfigError: The model was learned on another sensor.
        """
        own = self.reference
        why = f"{reference.shape} in {unit}, the force model {own.shape} in {self.unit}"
        if reference.shape == own.shape and unit == self.unit:
            shifted = reference - reference.mean(axis=0) + own.mean(axis=0)
            away = np.sqrt(((own[:, None] - own[None]) ** 2).sum(axis=2))
            nearest = float(np.median(np.sort(away, axis=1)[:, 1]))
            off = float(np.sqrt(((shifted - own) ** 2).sum(axis=1).mean()))
            if off <= LAYOUT_PITCHES * nearest:
                return
            why = f"markers that lie {off:.2g} {unit} from those of the force model"
        raise ConfigError(
            f"{name} has {why}; a force model belongs to one sensor: fit one on its own presses: "
            "spikingtac force fit tracks.npz --wrench FORCES -o force.onnx"
        )

    def estimator(self) -> ForceEstimator:
        """Return a stream of wrenches that starts at the calibrated rest."""
        return ForceEstimator(self)

    def estimate(self, series: WrenchSeries) -> tuple[Field, Field]:
        """Return values ``(n, c)`` and half-widths ``(n, c)`` of a series, causally.

        Raises:
            ConfigError: The series does not fit the model.
        """
        series = series.in_image()
        self.require(series.reference, series.unit, series.name)
        estimator = self.estimator()
        frames = zip(series.t_us.tolist(), series.displacement, strict=True)
        told = [estimator.update(t_us, moved) for t_us, moved in frames]
        shape = (len(told), len(self.components))
        values = np.array([one.values for one in told]).reshape(shape)
        return values, np.array([one.half_width for one in told]).reshape(shape)

    def wrench(self, field: Field) -> tuple[Field, Field]:
        """Return wrench and half-width ``(c,)`` of a field ``(size,)`` from its zero."""
        seen = field if self._target is None else self._target.fields(field[None])[0]
        values, spread = (out[0] for out in self._network(seen[None]))
        values = values - self._zero * rest_share(field, self.rest_radius)
        if self._target is not None:
            values, spread = values @ self._target.gain, spread @ np.abs(self._target.gain)
        floor, share, factor = self._interval
        return values, floor + share * np.abs(values) + factor * spread

    def with_record(self, changes: dict[str, Any]) -> ForceModel:
        """Return the same network with another record."""
        content = with_record(self._network.content, {**self.record, **changes})
        return ForceModel(Network(content, "the force model"))

    def told(self, fields: Field) -> Field:
        """Return what the network tells ``(n, c)`` of fields of the markers that it learned."""
        return self._network(fields)[0]

    def save(self, path: str | Path) -> None:
        """Write ``force.onnx``.

        Raises:
            ConfigError: The file cannot be written.
        """
        try:
            with replacing(Path(path)) as partial:
                partial.write_bytes(self._network.content)
        except OSError as error:
            raise ConfigError(f"cannot write {str(path)!r}: {error.strerror}") from error


def zero_wrench(network: Network, size: int) -> Field:
    """Return what a network tells ``(c,)`` of markers at rest."""
    return network(np.zeros((1, size)))[0][0]


def rest_share(fields: Field, radius: float) -> Field:
    """Return by how much of that the wrench of fields ``(..., size)`` is reduced: 1 at rest."""
    far = (fields**2).mean(axis=-1) / (REST_RADII * radius) ** 2
    return 1.0 / (1.0 + far)


def load_force(path: str | Path) -> ForceModel:
    """Read ``force.onnx``.

    Raises:
        ConfigError: The file is missing, damaged, or holds no force model.
    """
    return ForceModel(read(path, HINT), str(path))


class ForceEstimator:
    """A causal stream: one frame of displacements in, one wrench out.

    Example:
        >>> estimator = load_force("force.onnx").estimator()  # doctest: +SKIP
        >>> moved_px = frame.detected_px - calibration.reference_px  # doctest: +SKIP
        >>> estimator.update(frame.t_us, moved_px).force_n  # doctest: +SKIP
    """

    def __init__(self, model: ForceModel) -> None:
        self._model = model
        self._fields = FieldStream(model.rest_radius, model.reference.size, model.memory)
        self._last: Field | None = None

    def reset(self) -> None:
        """Return to the calibrated rest."""
        self._fields.reset()
        self._last = None

    def tare(self) -> None:
        """Take the last frame for the skin at rest: displacement and force are zero there."""
        if self._last is not None:
            self._fields.tare(self._last)

    def update(self, t_us: int, displacement: Field) -> Wrench:
        """Take in displacements ``(m, 2)`` in the model's unit and return the wrench.

        Raises:
            ConfigError: They are not of the model's markers and coordinates.
        """
        if displacement.shape != self._model.reference.shape:
            raise ConfigError(
                f"displacements of shape {displacement.shape} do not fit the force model, whose "
                f"markers are {self._model.reference.shape}; fit a model of this sensor: "
                "spikingtac force fit"
            )
        self._last = displacement.ravel().astype(np.float64)
        return Wrench(t_us, *self._model.wrench(self._fields.update(t_us, self._last)))
