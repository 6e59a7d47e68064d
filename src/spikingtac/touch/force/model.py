"""A fitted force model, and the stream of wrenches that it makes from marker displacements."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spikingtac.atomic_files import replacing
from spikingtac.calibration.lens import marker_pitch_px
from spikingtac.errors import PATH, ConfigError, require_type
from spikingtac.touch.network import Network
from spikingtac.touch.series import COMPONENTS, WrenchSeries
from spikingtac.types import US_PER_S, FloatArray

BATCH = 4096  # Frames that the network takes at once, so that memory is bounded.
SCHEMA = 5  # Version of the record.
SIGMAS_90 = 1.645  # Standard deviations in half of a 90 % interval of normal errors.
HINT = "make one with: spikingtac force fit FILES -o force.onnx"
REST_RADII = 2.0  # Amplitude, radii of rest, at which half of the error at rest is taken off.

# Distance from the learned markers up to which a layout is the same, pitches (data/force: 0.16).
LAYOUT_PITCHES = 0.35

# Time at rest over which the zero averages, and the weight of the calibrated rest, s.
AVERAGE_S, PRIOR_S = 3.0, 0.3
LONGEST_STEP_S = 0.1  # Rest that one frame stands for at most, s: a single frame is noise, too.

# What a field gains from its own past: shares of its means over two times, s. A gel that has just
# been pressed gives way: the same force moves it less far than the tared field says (R2 of the
# normal force between the series of data/force 0.89 instead of 0.86; 0.02 to 8 s were tried).
# Other gels do not: the fit decides whether there is a memory.
MEMORY_SHARES, MEMORY_S = np.array([[0.15], [0.3]]), np.array([[0.3], [5.0]])

# Frames farther apart, s, tell nothing of what was between: the memory fades as at rest.
LONGEST_GAP_S = 0.2


def other_sensor(
    reference: FloatArray, unit: str, own: FloatArray, own_unit: str, whose: str
) -> str:
    """Return how markers differ from those of another one by name; nothing where they do not."""
    if reference.shape != own.shape or unit != own_unit:
        return f"{len(reference)} markers in {unit}, {whose} {len(own)} in {own_unit}"
    aside = reference - reference.mean(axis=0) - own + own.mean(axis=0)
    off = float(np.sqrt((aside**2).sum(axis=1).mean()))
    same = off <= LAYOUT_PITCHES * marker_pitch_px(own)
    return "" if same else f"markers that lie {off:.2g} {unit} from those of {whose}"


class FieldStream:
    """Displacement fields from the skin's present rest, which frames close to it move."""

    def __init__(self, radius: float, size: int, memory: bool) -> None:
        """Start at the calibrated rest.

        Args:
            radius: Largest rms distance of a rest frame to the zero, in the fields' unit.
            size: Numbers in a frame.
            memory: Whether fields gain from their past.
        """
        self._radius, self._memory = radius, memory
        self._last = np.zeros(size)
        self._last_us: int | None = None
        self.tare(PRIOR_S)

    def tare(self, rested_s: float = AVERAGE_S) -> None:
        """Take the last frame for the rest, as if it had lasted for some time, s."""
        self._zero, self._rested_s = self._last, rested_s
        self._means = np.zeros((len(MEMORY_S), len(self._last)))

    def update(self, t_us: int, displacement: FloatArray) -> FloatArray:
        """Take in the frame ``(size,)`` of a time, us, and return it from the zero."""
        before_us, self._last, self._last_us = self._last_us, displacement, t_us
        elapsed_s = 0.0 if before_us is None else max(t_us - before_us, 0) / US_PER_S
        away = displacement - self._zero
        if away @ away < self._radius**2 * len(away):
            step_s = LONGEST_STEP_S if before_us is None else min(elapsed_s, LONGEST_STEP_S)
            self._rested_s = min(self._rested_s + step_s, AVERAGE_S)
            self._zero = self._zero + step_s / self._rested_s * away
            away = displacement - self._zero
        return self._with_memory(elapsed_s, away) if self._memory else away

    def _with_memory(self, elapsed_s: float, away: FloatArray) -> FloatArray:
        """Solve e = u + sum of c_i ((1 - g_i) m_i + g_i e) for e; the means m_i follow it."""
        fade = -np.expm1(-elapsed_s / MEMORY_S)
        if elapsed_s > LONGEST_GAP_S:
            self._means *= 1.0 - fade
            fade = np.zeros_like(fade)
        kept = (MEMORY_SHARES * (1.0 - fade) * self._means).sum(axis=0)
        told = (away + kept) / (1.0 - float((MEMORY_SHARES * fade).sum()))
        self._means += fade * (told - self._means)
        return told


def fields_of(series: WrenchSeries, radius: float, memory: bool) -> FloatArray:
    """Return the fields ``(n, size)`` of a series."""
    flat = series.displacement.reshape(len(series.t_us), -1)
    stream = FieldStream(radius, flat.shape[1], memory)
    frames = zip(series.t_us.tolist(), flat, strict=True)
    return np.array([stream.update(t_us, row) for t_us, row in frames]).reshape(flat.shape)


@dataclass(frozen=True, slots=True)
class Wrench:
    """The force and the moment that the skin feels at one time.

    Attributes:
        t_us: Time, us.
        values: ``(c,)`` forces in N, then moments in Nm.
        half_width: ``(c,)`` half of the 90 % interval of each, in its unit.
    """

    t_us: int
    values: FloatArray
    half_width: FloatArray

    @property
    def force_n(self) -> FloatArray:
        """``(3,)`` force, N."""
        return self.values[:3]

    @property
    def force_sigma_n(self) -> FloatArray:
        """``(3,)`` one standard deviation of it, N."""
        return self.half_width[:3] / SIGMAS_90

    @property
    def least_n(self) -> float:
        """The force that is surely reached, N: the nearest to zero of its 90 % interval."""
        return float(np.linalg.norm(np.maximum(np.abs(self.force_n) - self.half_width[:3], 0.0)))

    def exceeds(self, limit_n: float) -> bool:
        """Return whether the force is surely larger than a limit, N: less its 90 % interval."""
        return self.least_n > limit_n


class ForceModel:
    """A network from displacements to a wrench, with its record.

    Attributes:
        network: From fields ``(n, size)`` to wrenches and spreads ``(n, c)``.
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
        self.network, self.record = network, network.record
        try:
            if self.record["schema"] != SCHEMA:
                raise ValueError(f"schema {self.record['schema']}, this version reads {SCHEMA}")
            self.unit: str = self.record["unit"]
            self.reference = np.array(self.record["reference"], np.float64)
            self.components = COMPONENTS[: len(self.record["interval"])]
            self._interval = np.array(self.record["interval"], np.float64).T
            self.rest_radius = float(self.record["rest_radius"])
            self.memory = bool(self.record["memory"])
            # From this sensor's displacements to those of the sensor that was learned, and from the
            # wrench that is told of them to its own.
            target = self.record.get("target", {})
            resample = np.array(target.get("resample", np.eye(len(self.reference))))
            self._resample = np.kron(resample, np.eye(2)).T
            self._gain = np.array(target.get("gain", np.eye(len(self.components))))
            self._zero = network(np.zeros((1, self._resample.shape[1])))[0][0]
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(f"{where} holds no force model: {error}; {HINT}") from error

    def require(self, reference: FloatArray, unit: str, name: str = "the tracker") -> None:
        """Refuse markers of another layout, number, scale or unit.

        Args:
            reference: ``(m, 2)`` markers at rest.
            unit: Their unit.
            name: Whose they are, for the message.

        Raises:
            ConfigError: The model was learned on another sensor.
        """
        if why := other_sensor(reference, unit, self.reference, self.unit, "the force model"):
            raise ConfigError(
                f"{name} has {why}; a force model belongs to one sensor: fit one on its own "
                "presses: spikingtac force fit tracks.npz --wrench FORCES -o force.onnx"
            )

    def estimator(self) -> ForceEstimator:
        """Return a stream of wrenches that starts at the calibrated rest."""
        return ForceEstimator(self)

    def estimate(self, series: WrenchSeries) -> tuple[FloatArray, FloatArray]:
        """Return values ``(n, c)`` and half-widths ``(n, c)`` of a series, causally.

        Raises:
            ConfigError: The series does not fit the model, or holds no frame.
        """
        series = series.in_image()
        if not len(series.t_us):
            raise ConfigError(f"{series.name} holds no frame: there is nothing to estimate from")
        self.require(series.reference, series.unit, series.name)
        fields = fields_of(series, self.rest_radius, self.memory)
        parts = np.array_split(fields, len(fields) // BATCH + 1)
        values, widths = zip(*(self.wrench(part) for part in parts), strict=True)
        return np.concatenate(values), np.concatenate(widths)

    def wrench(self, fields: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return wrenches and half-widths ``(n, c)`` of fields ``(n, size)`` from their zero."""
        values, spread = self.network(fields @ self._resample)
        values = (values - rest_share(fields, self.rest_radius) * self._zero) @ self._gain
        floor, share, factor = self._interval
        return values, floor + share * np.abs(values) + factor * (spread @ np.abs(self._gain))

    def save(self, path: str | Path) -> None:
        """Write ``force.onnx``, whole or not at all."""
        with replacing(path) as partial:
            partial.write_bytes(self.network.content)


def rest_share(fields: FloatArray, radius: float) -> FloatArray:
    """Return which share ``(n, 1)`` of the wrench at rest is taken off: 1 at rest."""
    return 1.0 / (1.0 + (fields**2).mean(axis=1, keepdims=True) / (REST_RADII * radius) ** 2)


def load_force(path: str | Path) -> ForceModel:
    """Read ``force.onnx``; one that is missing or damaged raises ConfigError."""
    require_type(path, PATH, "load_force('force.onnx')")
    try:
        network = Network(Path(path).read_bytes(), str(path))
    except (OSError, ConfigError) as error:
        raise ConfigError(f"cannot read {str(path)!r}: {error}; {HINT}") from error
    return ForceModel(network, str(path))


class ForceEstimator:
    """A causal stream: one frame of displacements in, one wrench out.

    Example:
        >>> load_force("force.onnx").estimator().update(t_us, moved_px).force_n  # doctest: +SKIP
    """

    def __init__(self, model: ForceModel) -> None:
        self._model = model
        self.reset()

    def reset(self) -> None:
        """Return to the calibrated rest."""
        model = self._model
        self._fields = FieldStream(model.rest_radius, model.reference.size, model.memory)

    def tare(self) -> None:
        """Take the last frame for the skin at rest: displacement and force are zero there."""
        self._fields.tare()

    def update(self, t_us: int, displacement: FloatArray) -> Wrench:
        """Take in displacements ``(m, 2)`` in the model's unit and return the wrench.

        Raises:
            ConfigError: They are not of the model's markers, or not finite; nothing is taken in.
        """
        displacement = np.asarray(displacement, np.float64)
        if not np.isfinite(displacement).all():
            raise ConfigError(f"displacements at {t_us} us are not finite; leave such frames out")
        if displacement.shape != self._model.reference.shape:
            raise ConfigError(
                f"displacements are {displacement.shape}, markers of the force model "
                f"{self._model.reference.shape}; fit one of this sensor: spikingtac force fit"
            )
        values, half_width = self._model.wrench(
            self._fields.update(t_us, displacement.ravel())[None]
        )
        return Wrench(t_us, values[0], half_width[0])
