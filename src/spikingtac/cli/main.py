"""The frame of the command line: verb -> dataclass -> function, and errors -> exit codes.

The product's own table of verbs is static, so that ``spikingtac --help`` answers without importing
any verb. Other packages add verbs through the entry point group ``spikingtac.verbs``: the entry's
name is the verb, its value a module with ``Args`` and ``run(args)``, and the first line of the
module's docstring is its line of help.
"""

import ast
import contextlib
import errno
import importlib
import io
import json
import os
import shutil
import sys
import textwrap
import traceback
from collections.abc import Callable, Sequence
from importlib import metadata, util
from pathlib import Path
from typing import Any, get_type_hints

from spikingtac.errors import ConfigError, SpikingTacError, nearest

GROUP = "spikingtac.verbs"  # Entry point group of the verbs that other packages add.

# Verb -> one line of help. The module of that name has ``run(args)``, unless another one holds it.
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
    "doctor": "check this machine: extras, kernel cache, CPU governor; measure a camera",
}

# Verb -> module that holds it beside another one, as a function of the verb's name.
BESIDE = {
    "demo": "view",
    "simulate": "view",
    "export": "convert",
    "align": "record",
    "foxglove": "ros2",
    "compare": "plot",
    "doctor": "cameras",
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

EXIT_INPUT, EXIT_ARGUMENTS, EXIT_MACHINE = 1, 2, 3
EXIT_INTERRUPTED = 130  # 128 + SIGINT, what a shell reports of a program stopped by Ctrl-C.
EXIT_BROKEN_PIPE = 141  # 128 + SIGPIPE, what a shell reports when the reader of a pipe has left.

# Threads of a matrix product. Matrices are small here: beside other work, a second thread makes a
# product of 64 by 10 numbers take 11 ms instead of 0.1 ms (measured). NumPy reads this when it is
# first imported.
ONE_THREAD = "1"
_UNREADABLE = "; you may not read or write it: see its permissions with ls -l"

# Error of the operating system -> whose fault it is, and what its text leaves open.
_OF_THE_SYSTEM = {
    errno.ENOENT: (EXIT_INPUT, "; check the path"),
    errno.EISDIR: (EXIT_INPUT, "; a file is needed here"),
    errno.ENOTDIR: (EXIT_INPUT, "; a folder is needed here"),
    errno.EACCES: (EXIT_INPUT, _UNREADABLE),
    errno.EPERM: (EXIT_INPUT, _UNREADABLE),
    errno.EROFS: (EXIT_MACHINE, "; choose a folder that can be written"),
    errno.ENOSPC: (EXIT_MACHINE, "; free some space, or choose another folder"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code.

    Args:
        argv: Arguments without the program's name; None takes those of the process.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", ONE_THREAD)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by what started this program
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115
        elif hasattr(stream, "reconfigure"):  # a narrow encoding must not end a verb
            stream.reconfigure(errors="replace")
    debug = "--debug" in arguments
    if debug:
        arguments.remove("--debug")
    try:
        code = _dispatch(arguments)
        sys.stdout.flush()
        return code
    except SystemExit as stop:  # the parser's own: help (0) or bad usage (2)
        return stop.code if isinstance(stop.code, int) else EXIT_ARGUMENTS
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Python would complain while it closes stdout; give it somewhere to write.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except Exception as error:  # the one place where errors become text and exit codes
        if debug:
            traceback.print_exc()
        return _report(error, as_json="--json" in arguments)


def verbs() -> dict[str, str]:
    """Return every verb with one line of help; no verb is imported for it."""
    return VERBS | {verb: _first_line(module) for verb, module in _added().items()}


def function_of(verb: str) -> tuple[Callable[[Any], int], type]:
    """Return a verb's function, and the dataclass of its arguments."""
    own = f"spikingtac.cli.verbs.{BESIDE.get(verb, verb)}"
    module = importlib.import_module(own if verb in VERBS else _added()[verb])
    run = getattr(module, verb if verb in BESIDE else "run")
    return run, get_type_hints(run)["args"]


def _added() -> dict[str, str]:
    """Return the verbs that other packages add: name -> module."""
    points = metadata.entry_points(group=GROUP)
    return {point.name: point.value for point in points if point.name not in VERBS}


def _overview() -> str:
    """Return the text of ``spikingtac --help``."""
    every = verbs()
    longest = max(len(verb) for verb in every)
    width, indent = shutil.get_terminal_size().columns, " " * (longest + 5)
    lines = (
        textwrap.fill(f"  {verb:<{longest}}   {line}", max(width, 60), subsequent_indent=indent)
        for verb, line in every.items()
    )
    return OVERVIEW.format(verbs="\n".join(lines))


def _first_line(module: str) -> str:
    """Return the first line of a module's docstring, read from its source."""
    try:
        spec = util.find_spec(module)
        text = Path(spec.origin).read_text(encoding="utf-8") if spec and spec.origin else ""
        line = (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
        return line[:1].lower() + line[1:].removesuffix(".")
    except (ImportError, OSError, SyntaxError):
        return "cannot be loaded; update or remove the package that brings it"


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        sys.stdout.write(_overview())
        return 0 if arguments else EXIT_ARGUMENTS
    if arguments[0] in ("-V", "--version"):
        from spikingtac._version import package_version

        sys.stdout.write(f"spikingtac {package_version()}\n")
        return 0
    verb, rest = arguments[0], arguments[1:]
    if verb not in VERBS and verb not in (every := verbs()):
        raise ConfigError(
            f"unknown verb {verb!r}{nearest(verb, every)} (valid: {', '.join(every)})"
        )
    run, options = function_of(verb)
    given = _parsed(options, verb, rest)
    from spikingtac.cli.sources import ended_by_sigterm

    with ended_by_sigterm():
        return run(given)


def _parsed(arguments: type, verb: str, rest: list[str]) -> Any:
    import tyro

    from spikingtac.cli.options import HELP, check_given, description, for_help

    rest = check_given(arguments, verb, rest)
    told = io.StringIO()
    try:
        with contextlib.redirect_stderr(told):
            return tyro.cli(
                arguments if HELP.isdisjoint(rest) else for_help(arguments),
                prog=f"spikingtac {verb}",
                description=description(arguments),
                args=rest,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
            )
    except SystemExit as stop:
        if stop.code == 0:
            raise
        # The parser's text without the box around it and without its way to the help.
        lines = [line.strip(" \u2502") for line in told.getvalue().splitlines()[1:]]
        ends = [n for n, line in enumerate(lines) if not line or line[0] in "\u2500\u2570"]
        plain = " ".join(lines[: min(ends, default=len(lines))])
        raise ConfigError(f"{plain}; see: spikingtac {verb} --help") from stop


def _report(error: Exception, as_json: bool) -> int:
    """Tell an error and return its exit code.

    What is no :class:`SpikingTacError` is neither the input's nor the arguments' fault, unless the
    operating system says that a named file is not there, is no file, or is not permitted.
    """
    code, message, hint = EXIT_MACHINE, str(error), ""
    if isinstance(error, SpikingTacError):
        code = error.exit_code
    elif isinstance(error, OSError):
        code, way_out = _OF_THE_SYSTEM.get(error.errno or 0, (EXIT_MACHINE, ""))
        where = "" if error.filename is None else f"{str(error.filename)!r}: "
        message = f"{where}{error.strerror or error}{way_out}"
    else:
        message = f"internal error, {type(error).__name__}: {error}"
        hint = " (please report it with the output of --debug)"
    sys.stderr.write(f"spikingtac: error: {message}{hint}\n")
    if as_json:
        document = {"error": message, "kind": type(error).__name__, "exit_code": code}
        with contextlib.suppress(OSError):  # stdout may be what is full
            sys.stdout.write(json.dumps(document) + "\n")
    return code
