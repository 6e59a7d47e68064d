"""Controls for the page and for ROS 2, made from the metadata of a config's fields.

A field joins the panel by saying what range makes sense, where it is defined::

    step_on: float = field(default=0.15, metadata={"range": (0.02, 0.6), "unit": ""})

``choices`` instead of ``range`` makes a list. Nested dataclasses become groups; names are dotted.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

from spikingtac.errors import ConfigError, nearest

T = TypeVar("T")

# Method or law -> the fields of the tracking configuration that it reads.
_STAGES = {
    "disc": ("disc",),
    "blobs": ("denoiser", "blobs"),
    "paper": ("paper_law",),
}
STEPS = 200  # Positions of a slider.

# Last part of a field's name -> unit.
UNITS = {"us": "µs", **{unit: unit for unit in ("ms", "px", "mm", "hz", "s")}}


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class Control:
    """One slider, switch or list.

    Attributes:
        name: Dotted name of the field, as in the configuration file.
        kind: ``number``, ``whole``, ``switch`` or ``choice``.
        value: Present value.
        low: Least value of a number.
        high: Greatest value of a number.
        step: Distance between a number's values.
        unit: Unit, or an empty string.
        choices: The names of a list.
    """

    name: str
    kind: str
    value: Any
    low: float = 0.0
    high: float = 1.0
    step: float = 0.01
    unit: str = ""
    choices: tuple[str, ...] = ()


def controls(config: Any, prefix: str = "") -> Iterator[Control]:
    """Yield a control for each field of a dataclass whose metadata has a range or choices."""
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), prefix + field.name
        if dataclasses.is_dataclass(value):
            yield from controls(value, f"{name}.")
        elif "choices" in field.metadata or "range" in field.metadata:
            yield _control(name, value, field.metadata)


def in_use(config: Any) -> Iterator[Control]:
    """Yield the controls that have an effect under the configuration's method and law.

    A configuration that names neither has all its controls in use.
    """
    chosen = {getattr(config, name, None) for name in ("method", "hysteresis")}
    used = {field for name in chosen for field in _STAGES.get(str(name), ())}
    idle = {field for fields in _STAGES.values() for field in fields} - used
    for control in controls(config):
        if not hasattr(config, "method") or control.name.partition(".")[0] not in idle:
            yield control


def with_value(config: T, name: str, value: Any) -> T:
    """Return the config with one control set.

    Raises:
        ConfigError: The name belongs to no control, or the value is outside its range.
    """
    known = {control.name: control for control in controls(config)}
    if name not in known:
        raise ConfigError(f"{name!r} cannot be tuned{nearest(name, known)}")
    return _replaced(config, name.split("."), _checked(known[name], value))


def _control(name: str, value: Any, metadata: Mapping[str, Any]) -> Control:
    if "choices" in metadata:
        return Control(name=name, kind="choice", value=value, choices=tuple(metadata["choices"]))
    if isinstance(value, bool):
        return Control(name=name, kind="switch", value=value)
    low, high = (float(end) for end in metadata["range"])
    whole, suffix = isinstance(value, int), name.rpartition("_")[2]
    return Control(
        name=name,
        kind="whole" if whole else "number",
        value=value,
        low=low,
        high=high,
        step=1.0 if whole else (high - low) / STEPS,
        unit=metadata.get("unit", UNITS.get(suffix, "")),
    )


def _checked(control: Control, value: Any) -> Any:
    chosen = control.kind == "choice" and value in control.choices
    if chosen or (control.kind == "switch" and isinstance(value, bool)):
        return value
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if control.kind in ("number", "whole") and number and control.low <= value <= control.high:
        return round(value) if control.kind == "whole" else float(value)
    valid = control.choices or (f"{control.low:g} to {control.high:g}",)
    raise ConfigError(f"{control.name} = {value!r} is not valid (valid: {', '.join(valid)})")


def _replaced(config: Any, path: list[str], value: Any) -> Any:
    name, *rest = path
    new = _replaced(getattr(config, name), rest, value) if rest else value
    return dataclasses.replace(config, **{name: new})
