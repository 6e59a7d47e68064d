"""What a check found, in figures and in one sentence."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check.

    Attributes:
        name: Name of the check, ``part.property``.
        reason: What the value is and what is needed, in one sentence.
        value: What was found.
        needed: The limit.
        unit: Unit of both.
        at_least: True where ``needed`` is the least value, False where it is the largest.
    """

    name: str
    reason: str
    value: float
    needed: float
    unit: str
    at_least: bool = True

    @property
    def passed(self) -> bool:
        """True where the value is within its limit, up to a rounding error of one billionth."""
        excess = self.value - self.needed
        return (excess if self.at_least else -excess) >= -1e-9


def least(name: str, what: str, value: float, needed: float, unit: str = "mm") -> Finding:
    """Return a finding on a value that must not be smaller than a limit.

    Args:
        name: Name of the check.
        what: The sentence up to the value, as in ``"the window leaves"``.
        value: What was found.
        needed: The limit.
        unit: Unit of both.
    """
    reason = f"{what} {_shown(value)} {unit}".rstrip() + f"; needed {_shown(needed)}"
    return Finding(name, reason, float(value), float(needed), unit)


def most(name: str, what: str, value: float, allowed: float, unit: str = "mm") -> Finding:
    """Return a finding on a value that must not be larger than a limit; see :func:`least`."""
    reason = f"{what} {_shown(value)} {unit}".rstrip() + f"; allowed {_shown(allowed)}"
    return Finding(name, reason, float(value), float(allowed), unit, at_least=False)


def _shown(value: float) -> str:
    text = f"{value:.2f}" if abs(value) < 100 else f"{value:.0f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
