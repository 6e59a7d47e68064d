"""Output of the verbs: results on stdout, as tables or as JSON; progress and remarks on stderr."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

PIPE_COLUMNS = 1_000  # Width of a table that no terminal shows, in characters: wider than any.

# Ending of a figure's name -> its unit; the first that fits counts.
UNITS = {"_mev_s": "million events/s", "_us": "us", "_ms": "ms", "_s": "s",
         "_hz": "Hz", "_px": "px", "_mm": "mm", "_n": "N"}  # fmt: skip
SHARES = ("_fraction", "_share")  # Endings of what a reader is told in per cent.

# What is told where a verb that tracks made no estimate.
UNTRACKED = "warning: nothing was tracked: no events, or too few for one estimate"

Advance = Callable[[float], None]  # Sets a progress bar to the fraction that is done, 0 to 1.


def no_progress(done: float) -> None:
    """Show nothing: an :data:`Advance` where nobody looks."""


class Table(NamedTuple):
    """A table to print.

    Attributes:
        title: One line above the table.
        columns: Their names.
        rows: Cells, as wide as ``columns``.
        words: Number of leading columns with words (left-aligned); the others hold figures.
    """

    title: str
    columns: Iterable[str]
    rows: Iterable[Iterable[object]]
    words: int = 1


def tell(as_json: bool, document: Mapping[str, Any], *shown: Table | str) -> int:
    """Print the result of a verb, and return 0.

    Args:
        as_json: Print the document and nothing else.
        document: The result as one JSON object.
        *shown: The result for a reader, in order: tables, and lines for stderr.

    Raises:
        ValueError: A number of the document is not finite; JSON cannot express it.
    """
    if as_json:
        sys.stdout.write(json.dumps(document, allow_nan=False, default=_plain) + "\n")
        return 0
    for one in shown:
        if isinstance(one, str):
            remark(one)
        else:
            _print(one)
    return 0


def figures(title: str, document: Mapping[str, Any]) -> Table:
    """Return a document as a table of names and values; units stand behind the values."""
    rows: dict[str, str] = {}
    for key, value in document.items():
        name, text = _row(key, value)
        rows[name if name not in rows else key.replace("_", " ")] = text
    return Table(title, ("", ""), rows.items(), words=2)


def counted(anomalies: Mapping[str, int], what: str = "recording") -> list[str]:
    """Return a note for each kind of damage in what was read."""
    return [f"note: {kind} {count} times in the {what}" for kind, count in anomalies.items()]


def _print(given: Table) -> None:
    from rich.console import Console
    from rich.table import Table as Grid
    from rich.text import Text

    grid = Grid(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for index, name in enumerate(given.columns):
        grid.add_column(name, justify="left" if index < given.words else "right")
    for row in given.rows:
        grid.add_row(*(Text(str(cell)) for cell in row))
    # A pipe has no width: what reads it gets each row on one line.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else PIPE_COLUMNS)
    # The title stands above the table: a narrow table would break it.
    title = Text(given.title, style="table.title")
    console.print(title, *([grid] if grid.columns else []))


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
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    console = Console(stderr=True, quiet=not sys.stderr.isatty())
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bars:
        task = bars.add_task(what, total=1.0)
        yield lambda done: bars.update(task, completed=done)


def _row(key: str, value: Any) -> tuple[str, str]:
    known = value not in (None, [])
    if key == "px_per_mm":
        return "scale", f"{value:.5g} px/mm" if known else "not known"
    if key in ("size", "grid") and isinstance(value, list | tuple):
        return key, " x ".join(map(str, value))
    if key.endswith(SHARES) and known:
        return key.replace("_", " "), f"{100 * value:.4g} %"
    ending = next((ending for ending in UNITS if key.endswith(ending)), "")
    text = f"{value:,}" if key == "events" else _text(value)
    unit = f" {UNITS[ending]}" if ending and known else ""
    return key.removesuffix(ending).replace("_", " "), text + unit


def _text(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "not known", True: "yes", False: "no"}[value]
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, dict):
        shown = (f"{key.replace('_', ' ')} {_text(one)}" for key, one in value.items())
        return ", ".join(shown) or "none"
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "none"
    return str(value)


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")
