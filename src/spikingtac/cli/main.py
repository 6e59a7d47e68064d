"""The frame of the command line: verb -> dataclass -> function, and errors -> exit codes."""

from __future__ import annotations

import contextlib
import errno
import importlib
import io
import json
import os
import sys
import traceback
from collections.abc import Sequence
from typing import Any

from spikingtac.cli.registry import VERBS, module_of, overview, verbs
from spikingtac.errors import ConfigError, SpikingTacError, nearest

EXIT_INPUT, EXIT_ARGUMENTS, EXIT_MACHINE = 1, 2, 3
EXIT_INTERRUPTED = 130  # 128 + SIGINT, what a shell reports of a program stopped by Ctrl-C.
EXIT_BROKEN_PIPE = 141  # 128 + SIGPIPE, what a shell reports when the reader of a pipe has left.

# Matrices are small here: beside other work, a second thread makes a product of 64 by 10 numbers
# take 11 ms instead of 0.1 ms (ours). NumPy reads this when it is first imported.
ONE_THREAD = "1"
_INPUT_ERRORS = (errno.ENOENT, errno.EISDIR, errno.ENOTDIR, errno.EACCES, errno.EPERM)

# Error of the operating system -> what its text leaves open.
_WAYS_OUT = {
    errno.ENOENT: "; check the path",
    errno.EISDIR: "; a file is needed here",
    errno.EACCES: "; you may not read or write it: see its permissions with ls -l",
    errno.EPERM: "; you may not read or write it: see its permissions with ls -l",
    errno.EROFS: "; choose a folder that can be written",
    errno.ENOSPC: "; free some space, or choose another folder",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code.

    Args:
        argv: Arguments without the program's name; None takes those of the process.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", ONE_THREAD)
    _survive_narrow_encodings()
    debug = _take_flag(arguments, "--debug")
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


def exit_code(error: Exception) -> int:
    """Return the exit code that an error stands for.

    What is no :class:`SpikingTacError` is neither the input's nor the arguments' fault, unless the
    operating system says that a named file is not there, is no file, or is not permitted.
    """
    if isinstance(error, SpikingTacError):
        return error.exit_code
    if isinstance(error, OSError) and error.errno in _INPUT_ERRORS:
        return EXIT_INPUT
    return EXIT_MACHINE


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        sys.stdout.write(overview())
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
    module = importlib.import_module(module_of(verb))
    return module.run(_parsed(module.Args, verb, rest))


def _parsed(arguments: type, verb: str, rest: list[str]) -> Any:
    import tyro

    from spikingtac.cli.options import HELP, check_options, check_values, description, for_help

    check_options(arguments, verb, rest)
    asked = not HELP.isdisjoint(rest)
    if not asked:
        check_values(arguments, rest)
    told = io.StringIO()
    try:
        with contextlib.redirect_stderr(told):
            return tyro.cli(
                for_help(arguments) if asked else arguments,
                prog=f"spikingtac {verb}",
                description=description(arguments),
                args=rest,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
            )
    except SystemExit as stop:
        if stop.code == 0:
            raise
        raise ConfigError(f"{_plain(told.getvalue())}; see: spikingtac {verb} --help") from stop


def _plain(box: str) -> str:
    """Return the parser's text without the box around it and without its way to the help."""
    lines = [line.strip(" \u2502") for line in box.splitlines()[1:]]  # the sides of the box
    ends = [n for n, line in enumerate(lines) if not line or line[0] in "\u2500\u2570"]
    return " ".join(lines[: min(ends, default=len(lines))])


def _report(error: Exception, as_json: bool) -> int:
    code = exit_code(error)
    known = isinstance(error, SpikingTacError | OSError)
    message = _said(error) if known else f"internal error, {type(error).__name__}: {error}"
    hint = "" if known else " (please report it with the output of --debug)"
    sys.stderr.write(f"spikingtac: error: {message}{hint}\n")
    if as_json:
        document = {"error": message, "kind": type(error).__name__, "exit_code": code}
        sys.stdout.write(json.dumps(document) + "\n")
    return code


def _said(error: Exception) -> str:
    """Return an error's text; what the operating system refuses is said with a way out."""
    if not isinstance(error, OSError) or error.filename is None or error.strerror is None:
        return str(error)
    hint = _WAYS_OUT.get(error.errno or 0, "")
    return f"{str(error.filename)!r}: {error.strerror}{hint}"


def _take_flag(arguments: list[str], flag: str) -> bool:
    if flag not in arguments:
        return False
    arguments.remove(flag)
    return True


def _survive_narrow_encodings() -> None:
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
