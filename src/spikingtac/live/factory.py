"""How another process makes what it needs: a function and its arguments travel there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Factory(Generic[T]):
    """A function of a module with its keyword arguments; both can travel to another process.

    Attributes:
        function: A function of a module, called once in the other process.
        arguments: Its keyword arguments.
    """

    function: Callable[..., T]
    arguments: dict[str, Any] = field(default_factory=dict)

    def __call__(self) -> T:
        """Return what the function makes."""
        return self.function(**self.arguments)
