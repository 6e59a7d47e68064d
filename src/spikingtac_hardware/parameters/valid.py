"""Refuse lengths and prices that are not positive."""

from __future__ import annotations

from dataclasses import fields
from typing import Any


def require_positive(part: Any, signed: tuple[str, ...] = ()) -> None:
    """Refuse the first number of a dataclass that is not positive.

    Args:
        part: The dataclass.
        signed: Fields that may be zero or negative.

    Raises:
        ValueError: Names the field, what was given and what is valid.
    """
    for field in fields(part):
        value = getattr(part, field.name)
        numbers = value if isinstance(value, tuple) else (value,)
        for number in numbers:
            wrong = isinstance(number, int | float) and not number > 0
            if wrong and field.name not in signed:
                raise ValueError(f"{field.name} is {number}, it must be positive")
