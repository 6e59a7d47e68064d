"""Files that appear whole or not at all: written beside their place, synced, then renamed."""

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import IO, Any

from spikingtac.errors import ConfigError, nearest

# What the name of an unfinished file holds, before the number of the process that writes it.
PARTIAL = ".partial-"


class WholeFile:
    """One file on its way.

    Until :meth:`commit`, the path holds what it held before. Devices and pipes are written as they
    are. What a killed process left beside the path is removed by the next one.

    Args:
        path: Where the file shall be; replaced if it exists.
        in_place: Write at the path itself, for a recorder: what came so far stays readable.
    """

    def __init__(self, path: str | Path, in_place: bool = False) -> None:
        self.path = Path(path)
        if self.path.is_symlink():
            self.path = self.path.resolve()
        self._beside = not (in_place or (self.path.exists() and not self.path.is_file()))
        self.partial = _partial_of(self.path) if self._beside else self.path

    def open(self, mode: str = "wb", **options: Any) -> IO[Any]:
        """Open the unfinished file."""
        return open(self.partial, mode, **options)

    def begin(self, head: bytes) -> IO[bytes]:
        """Open the unfinished file, and write how it begins."""
        file = self.open()
        try:
            file.write(head)
        except BaseException:
            self.abandon(file)
            raise
        return file

    def commit(self, file: IO[Any] | None = None) -> None:
        """Close the finished file and put it in its place; on an error it is gone.

        Raises:
            OSError: It could not be written to its end.
        """
        try:
            if file is not None:
                file.close()
            if not self._beside:
                return
            _sync(self.partial)
            if self.path.exists():
                shutil.copymode(self.path, self.partial)
            os.replace(self.partial, self.path)
        except BaseException:
            self.abandon()
            raise
        with suppress(OSError):  # not every file system can sync a folder
            _sync(self.path.parent)

    def abandon(self, file: IO[Any] | None = None) -> None:
        """Leave what was there before; a file that was written in place stays as far as it came."""
        if file is not None:
            with suppress(OSError):
                file.close()
        if self._beside:
            self.partial.unlink(missing_ok=True)


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder; it replaces ``path`` when the block ends.

    An interrupt or an error leaves the old file as it was, and no temporary one. The folder is
    created if it does not exist. The temporary name keeps the ending of ``path``, since many
    writers choose their format by it.

    Args:
        path: File to write.

    Yields:
        The path that the block has to write.
    """
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    file = WholeFile(path)
    try:
        yield file.partial
    except BaseException:
        file.abandon()
        raise
    file.commit()


def write_text(path: str | Path, text: str) -> None:
    """Write a text in UTF-8, whole or not at all."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: str | Path, document: Mapping[str, Any]) -> None:
    """Write a JSON document, whole or not at all.

    Raises:
        ValueError: A number is not finite.
    """
    write_text(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


@contextmanager
def whole_folder(path: str | Path, last: str) -> Iterator[Path]:
    """Give a folder to write to, whose files are put in their place when the block ends.

    Args:
        path: Where the files shall be; other files there stay.
        last: The file that says that all others are there: it is taken away first and put last.
    """
    folder = Path(path).resolve()
    partial = _partial_of(folder)
    partial.mkdir(parents=True)
    try:
        yield partial
        folder.mkdir(parents=True, exist_ok=True)
        (folder / last).unlink(missing_ok=True)
        for file in sorted(partial.iterdir(), key=lambda file: file.name == last):
            os.replace(file, folder / file.name)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def require_free(path: str | Path, overwrite: bool, endings: Sequence[str] = ()) -> str:
    """Refuse a file that cannot or must not be written, before any work is done.

    Args:
        path: The file; a device or a pipe is taken as it is, unless endings choose the format.
        overwrite: Whether one that is there may be replaced.
        endings: Valid endings of its name, in small letters; any unless given.

    Returns:
        The ending of its name in small letters: .csv of T.CSV.

    Raises:
        ConfigError: The file is there and ``overwrite`` is not given, the path is a folder, its
            folder does not exist, or its ending is another.
        OSError: It cannot be written.
    """
    target = Path(path)
    ending = target.suffix.lower()
    if target.is_dir():
        raise ConfigError(f"{str(path)!r} is a folder; give the name of a file")
    if not target.parent.is_dir():
        why = "is a file" if target.parent.exists() else "does not exist; create it first"
        raise ConfigError(f"the folder {str(target.parent)!r} {why}")
    if target.is_file() and not overwrite:
        raise ConfigError(
            f"{str(path)!r} is there already; "
            "choose another name, or give --overwrite to replace a file"
        )
    file = WholeFile(target)
    as_it_is = file.partial == file.path
    # A device or a pipe takes the only format under any name.
    if ending not in endings and len(endings) > (1 if as_it_is else 0):
        hint, valid = nearest(ending, endings), ", ".join(endings)
        raise ConfigError(f"cannot write {target.name!r}{hint} (valid endings: {valid})")
    try:
        if not as_it_is:
            file.abandon(file.open())
    except OSError as error:  # it names the unfinished file, which nobody asked for
        raise OSError(error.errno, error.strerror, str(path)) from error
    return ending


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _partial_of(path: Path) -> Path:
    """Return where this process writes what shall be at a path; remove what killed ones left."""
    for left in path.parent.glob(f".{escape(path.stem)}{PARTIAL}*{escape(path.suffix)}"):
        number = left.name.rpartition(PARTIAL)[2].removesuffix(path.suffix)
        if number.isdecimal() and not runs(int(number)):
            shutil.rmtree(left) if left.is_dir() else left.unlink(missing_ok=True)
    return path.with_name(f".{path.stem}{PARTIAL}{os.getpid()}{path.suffix}")


def runs(process: int) -> bool:
    """Return whether a process, given by its number, goes on."""
    try:
        os.kill(process, 0)
    except (OSError, OverflowError) as error:  # no process has a number beyond an int
        return not isinstance(error, ProcessLookupError | OverflowError)
    return True
