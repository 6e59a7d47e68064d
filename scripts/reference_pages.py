"""Write docs/reference/cli.md and api.md from the code.

    python scripts/reference_pages.py            # write both pages
    python scripts/reference_pages.py --check    # exit 1 where a page is out of date

The pages hold what ``--help`` and the docstrings say, so that they can be read without either.
"""

import dataclasses
import inspect
import re
import sys
import textwrap
import typing
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import docstring_parser

import spikingtac
from spikingtac.cli.main import function_of, verbs
from spikingtac.cli.options import about

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "reference"
CLI_HEAD = """\
# The command line

Every verb takes `--help`, `--json` (one JSON object on stdout) and `--debug` (the traceback of an
error). Results go to stdout, progress and remarks to stderr. Exit codes: 0 done, 1 the input is at
fault, 2 the arguments are, 3 the machine is, 130 after Ctrl-C. `NO_COLOR` is respected.
This page is made by `scripts/reference_pages.py`.
"""
API_HEAD = """\
# Python

```python
import spikingtac as st
```

These names are public: they are imported when they are first used, and do not change without an
entry in the changelog. Everything else may. This page is made by `scripts/reference_pages.py`.
"""

# End of a first sentence: the page gives that of each argument, ``help`` gives the rest.
SENTENCE = re.compile(r"(?<=[a-z0-9)`])\. (?=[A-Z`])")
SHARED = 2  # Number of verbs from which on an option with one description is described once.
SECTION = re.compile(r"^(Args|Attributes|Returns|Yields|Raises|Example|Examples):$", re.M)


def cli_page() -> str:
    """Return the page of the command line: a list of arguments for each verb.

    An option that several verbs describe alike is described once.
    """
    tables = {verb: _table(verb) for verb in verbs()}
    verbs_of = Counter(row for rows in tables.values() for row in rows)
    shared: dict[str, str] = {}  # Option -> item; of two items the one that more verbs have.
    for row, count in verbs_of.most_common():
        if count >= SHARED and row.startswith("- `-"):
            shared.setdefault(row.split("`")[1], row)
    parts = [
        CLI_HEAD,
        "## Options of several verbs\n",
        "\n".join(sorted(shared.values())) + "\n",
    ]
    for verb, rows in tables.items():
        parts.append(f"## {verb}\n\n{about(function_of(verb)[1])}\n")
        own = [row for row in rows if row not in shared.values()]
        if own:
            parts.append("\n".join(own) + "\n")
        if also := [
            row[2:].split(maxsplit=1)[0].strip(":,") for row in rows if row in shared.values()
        ]:
            parts.append(f"Also: {', '.join(also)}.\n")
    return "\n".join(parts)


def _table(verb: str) -> list[str]:
    """Return an item for each argument, the positional ones (in capitals) first."""
    arguments = function_of(verb)[1]
    rows = (_row(arguments, field) for field in dataclasses.fields(arguments))
    return sorted(rows, key=lambda row: row.startswith("- `-"))


def api_page() -> str:
    """Return the page of the public names: summary, call, arguments, errors."""
    parts = [API_HEAD]
    for name in spikingtac.__all__:
        if name == "__version__":
            continue
        value = getattr(spikingtac, name)
        text = _plain(inspect.getdoc(value) or "")
        call = f"`{_signature(name, value)}`\n"
        if dataclasses.is_dataclass(value) and isinstance(value, type):
            # The list of its fields tells the call of a dataclass, so the defaults go there.
            fields = dataclasses.fields(value)
            for field in fields:
                told = f"- {field.name}{_default(field).replace(' (required)', '')}:"
                text = text.replace(f"- {field.name}:", told)
            call = "" if all(f"\n- {field.name}" in text for field in fields) else call
        elif call == f"`st.{name}`\n":
            call = ""
        parts += [f"## {name}\n", *([call] if call else []), text]
    return "\n".join(parts)


def _row(arguments: type, field: dataclasses.Field[Any]) -> str:
    hint = typing.get_type_hints(arguments, include_extras=True)[field.name]
    extras = typing.get_args(hint)[1:] if typing.get_origin(hint) is typing.Annotated else ()
    settings = [e for e in extras if hasattr(e, "aliases")]
    positional = "Positional" in repr(arguments.__annotations__.get(field.name, hint))
    names = [f"--{field.name.replace('_', '-')}"]
    names += [alias for one in settings for alias in one.aliases or ()]
    if positional:
        metavar = [one.metavar for one in settings if one.metavar]
        names = [metavar[0] if metavar else field.name.upper()]
    helps = [one.help for one in settings if isinstance(one.help, str)]
    told = helps or [
        param.description
        for kind in arguments.__mro__[:-1]
        for param in docstring_parser.parse_from_object(kind).params
        if param.arg_name == field.name
    ]
    shown = (
        " ".join(f"`{name}`" for name in names)
        if positional
        else ", ".join(f"`{name}`" for name in names)
    )
    return f"- {shown}{_default(field)}: {' '.join(told[0].split())}"


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
        return " (required)"
    value = field.default
    if value is dataclasses.MISSING or value is None or value is False or value in ((), ""):
        return ""
    return f" (`{value}`)"


def _signature(name: str, value: Any) -> str:
    """Return the call with the names and defaults of its arguments; their types are in the text."""
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return f"st.{name}"
    bare = [one.replace(annotation=one.empty) for one in signature.parameters.values()]
    returned = signature.empty if inspect.isclass(value) else signature.return_annotation
    text = str(inspect.Signature(bare, return_annotation=returned)).replace("spikingtac.", "")
    text = re.sub(r"<function (\w+) at \w+>", r"\1", text).replace("=<factory>", "=...")
    text = re.sub(r"-> '([^']*)'", r"-> \1", text)
    return f"st.{name}{text}"


def _plain(docstring: str) -> str:
    """Return a docstring of Google's style as Markdown: sections become lists."""
    text, *rest = SECTION.split(re.sub(r":(?:\w+:)?\w+:`~?([^`]*)`", r"`\1`", docstring))
    parts = [text.replace("``", "`").strip() + "\n"]
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        body = textwrap.dedent(body.strip("\n"))
        if title.startswith("Example"):
            parts.append(f"```python\n{body.strip()}\n```\n")
        else:
            items = [f"- {SENTENCE.split(i)[0]}" for i in _items(body.replace("``", "`"))]
            parts.append(f"{title}:\n\n" + "\n".join(items) + "\n")
    return "\n".join(parts)


def _items(body: str) -> Iterator[str]:
    """Yield the items of a section: a line, and the deeper lines below it."""
    item: list[str] = []
    for line in body.splitlines():
        if line.strip() and not line.startswith(" ") and item:
            yield " ".join(" ".join(item).split())
            item = []
        item.append(line)
    if item:
        yield " ".join(" ".join(item).split())


def main() -> int:
    """Write the pages, or tell which are out of date."""
    stale = 0
    for name, text in (("cli.md", cli_page()), ("api.md", api_page())):
        path = FOLDER / name
        if path.read_text(encoding="utf-8") == text:
            continue
        stale += 1
        if "--check" in sys.argv[1:]:
            sys.stderr.write(f"{path.name} is out of date: python scripts/reference_pages.py\n")
        else:
            path.write_text(text, encoding="utf-8")
    return stale if "--check" in sys.argv[1:] else 0


if __name__ == "__main__":
    sys.exit(main())
