"""The verbs of the command line: name, one line of help, and module.

The product's own table is static, so that ``spikingtac --help`` answers without importing any
verb. Other packages add verbs through the entry point group ``spikingtac.verbs``: the entry's name
is the verb, its value a module with ``Args`` and ``run(args)``, and the first line of the module's
docstring is its line of help.
"""

from __future__ import annotations

import ast
import shutil
import textwrap
from importlib import metadata, util
from pathlib import Path

GROUP = "spikingtac.verbs"  # Entry point group of the verbs that other packages add.

# Verb -> one line of help; the module of that name has ``Args`` and ``run(args)``.
VERBS: dict[str, str] = {
    "demo": "watch a simulated finger press, twist and slide, tracked live; no hardware needed",
    "info": "print the content of an event file: format, size, counts, rates, damage",
    "convert": "write an event file in another format, or a part of it",
    "export": "write tracks as a data set for robot learning: LeRobot, Zarr",
    "record": "record a camera into a folder: lossless, in files, readable after a crash",
    "align": "put two fingers, and a robot's poses, on one clock, and say how well it is known",
    "simulate": "render a scene of the digital twin into a recording folder with ground truth",
    "calibrate": "learn where the markers rest and how they look, from slides or contacts",
    "track": "follow every marker through a recording",
    "contact": "find the contacts in a recording, from raw events in 1 ms windows",
    "touch": "list the touches in a recording: begin, end, place, area and peak of each",
    "force": "learn forces from displacements with measured wrenches, and check them",
    "probe": "find centre and radius of a hole by touch, on the twin or a real arm",
    "guard": "watch a camera's stream and stop a moving arm at the first contact",
    "view": "show a recording or a scene in the browser: replay, tune, measure",
    "ros2": "publish a sensor to ROS 2, live; ROS need not be installed",
    "foxglove": "show a sensor in Foxglove, live; neither ROS nor a bridge is needed",
    "plot": "draw tracks: displacement over time, vector field, heat map, strain",
    "compare": "compare two tracks, or tracks with a truth: errors over time and by marker",
    "cameras": "list the cameras that are plugged in, and the ways to reach one",
    "doctor": "check this machine: extras, kernel cache, CPU governor, ports; measure a camera",
}

OVERVIEW = """\
usage: spikingtac VERB [options]

Event-camera tactile sensing: marker displacements and contacts from raw events.

verbs:
{verbs}

options for every verb:
  -h, --help   show the options of the verb
  --json       print one JSON object on stdout; progress goes to stderr
  --debug      show the traceback of an error
  --version    print the version

exit codes: 0 done, 1 the input is at fault, 2 the arguments are, 3 the machine is.
"""


def added_verbs() -> dict[str, str]:
    """Return the verbs that other packages add: name -> module."""
    points = metadata.entry_points(group=GROUP)
    return {point.name: point.value for point in points if point.name not in VERBS}


def verbs() -> dict[str, str]:
    """Return every verb with one line of help; no verb is imported for it."""
    return VERBS | {verb: _first_line(module) for verb, module in added_verbs().items()}


def overview() -> str:
    """Return the text of ``spikingtac --help``."""
    every = verbs()
    longest = max(len(verb) for verb in every)
    width, indent = shutil.get_terminal_size().columns, " " * (longest + 5)
    lines = (
        textwrap.fill(f"  {verb:<{longest}}   {line}", max(width, 60), subsequent_indent=indent)
        for verb, line in every.items()
    )
    return OVERVIEW.format(verbs="\n".join(lines))


def module_of(verb: str) -> str:
    """Return the full name of the module of a verb."""
    return f"spikingtac.cli.verbs.{verb}" if verb in VERBS else added_verbs()[verb]


def _first_line(module: str) -> str:
    """Return the first line of a module's docstring, read from its source."""
    try:
        spec = util.find_spec(module)
        text = Path(spec.origin).read_text(encoding="utf-8") if spec and spec.origin else ""
        line = (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
        return line[:1].lower() + line[1:].removesuffix(".")
    except (ImportError, OSError, SyntaxError):
        return "cannot be loaded; update or remove the package that brings it"
