"""Output of the verbs: results on stdout, progress and remarks on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from rich.console import Console

PIPE_COLUMNS = 1_000
"""Width of a table that no terminal shows, in characters: wider than any."""


class Advance(Protocol):
    """Sets a progress bar."""

    def __call__(self, done: float) -> None:
        """Set the fraction that is done, 0 to 1."""
        ...


def emit_json(document: Mapping[str, Any]) -> None:
    """Print one JSON object on stdout.

    Raises:
        ValueError: A number is not finite; JSON cannot express it.
    """
    sys.stdout.write(json.dumps(document, allow_nan=False, default=_plain) + "\n")


def emit_table(
    title: str, columns: Iterable[str], rows: Iterable[Iterable[object]], words: int = 1
) -> None:
    """Print a table on stdout.

    Args:
        title: One line above the table.
        columns: Their names.
        rows: Cells, as wide as ``columns``.
        words: Number of leading columns with words (left-aligned); the others hold figures.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for index, name in enumerate(columns):
        table.add_column(name, justify="left" if index < words else "right")
    for row in rows:
        table.add_row(*(Text(str(cell)) for cell in row))
    # A pipe has no width: what reads it gets each row on one line.
    width = None if sys.stdout.isatty() else PIPE_COLUMNS
    console = Console(highlight=False, width=width)
    console.print(Text(title, style="table.title"))  # above it: within, a narrow table breaks it
    console.print(table)


def remark(text: str) -> None:
    """Print a remark on stderr."""
    sys.stderr.write(text + "\n")


def warn(text: str) -> None:
    """Print a warning on stderr."""
    remark(f"warning: {text}")


@contextmanager
def progress(what: str) -> Iterator[Advance]:
    """Show a bar on stderr while the block runs; silent where stderr is no terminal.

    Args:
        what: The work in a few words.

    Yields:
        A function that takes the fraction done, 0 to 1.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    console = _stderr_console()
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bars:
        task = bars.add_task(what, total=1.0)
        yield lambda done: bars.update(task, completed=done)


def _stderr_console() -> Console:
    from rich.console import Console

    return Console(stderr=True, quiet=not sys.stderr.isatty())


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")
