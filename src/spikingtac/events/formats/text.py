"""Event tables as text: by comma, semicolon, tab, bar or blanks, with or without a header."""

import io
import itertools
import re
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import FormatError
from spikingtac.events.formats import columns
from spikingtac.events.formats.columns import Order, order_named
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.types import FloatArray, LossCounters

CHUNK_BYTES = 1 << 20

# Bytes at the beginning, in the middle and at the end that tell the order of the columns.
SAMPLE_BYTES = 1 << 16

NUMBER_LIMIT = 1e19  # Numbers beyond are damage.

# What may part words; a comma comes last, since it may be the decimal mark beside another one.
_DELIMITERS = ";\t|, "

# Words of a polarity -> its number.
_WORDS = {"true": "1", "on": "1", "+": "1", "false": "0", "off": "0", "-": "0"}
_SIZE = re.compile(r"(?:size|geometry|resolution)\W{1,3}(\d+)\s*[x,;\s]\s*(\d+)", re.IGNORECASE)
_WIDTH_HEIGHT = re.compile(r"(?:width\W{1,3}|x@)(\d+).*?(?:height\W{1,3}|y@)(\d+)", re.IGNORECASE)
_NAME = re.compile(r"[A-Za-zµ][\w.]*\s*(?:[\[({][^\])}]*[\])}])?")  # In a comment.
_ROW = re.compile(rb"^\s*[^#%\s]", re.MULTILINE)  # NumPy warns of a text without one.
_NO_ROW = ("", "#", "%")  # How other lines than rows begin.
# The header of a table without names, and the mark of a spreadsheet.
_NUMBERED = re.compile(r"\W*0\W+1\W+2\W+3(\W+4)?\W*|sep=.?")


class TextSource(columns.TableSource):
    """Events of a text table.

    The first line, or a comment, names the columns in any order, with units of time; else their
    values tell the order (:mod:`spikingtac.events.formats.columns`). The size stands in a comment
    (``# size W H``, ``%geometry:W,H``) or in a first line of two numbers. Lines that do not parse,
    or have another number of columns than most, are counted as ``bad_record``. A polarity may be
    a word such as ON; other columns of words are left out.

    Raises:
        FormatError: The columns cannot be told, or one is missing.
    """

    format = "text table"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._delimiter, self._width, self.losses = "", 0, LossCounters()
        self._labels: set[int] = set()  # columns of words, or that no role needs
        self._start = self._read_head(path)
        super().__init__(path, options)

    def _read_head(self, path: Path) -> int:
        """Read comments and the header; return the offset of the first line of numbers."""
        comments: list[str] = []
        with path.open("rb") as file:
            while line := file.readline(CHUNK_BYTES):
                bare = line.removeprefix(b"\xef\xbb\xbf")  # what some programs begin UTF-8 with
                # The only letter outside of ASCII that matters, where the text is no UTF-8.
                text = bare.decode("utf-8", "replace").replace("\ufffd", "µ").strip()
                if not text or _NUMBERED.fullmatch(text):
                    continue
                if size := _SIZE.search(text) or _WIDTH_HEIGHT.search(text):
                    self._named_size = int(size[1]), int(size[2])
                if text[0] in "#%":
                    comments.append(text)
                    continue
                words = _split(text)
                unread = [word for word in words if _number(word) is None]
                few = len(words) - len(unread) < len(columns.ROLES)
                if few and any(re.match(r"[A-Za-z_µ]", word) for word in unread):
                    self._order, self._width = _named(words, path), len(words)
                    continue
                if len(words) == 2 and not comments and not self._order.place:
                    whole = all(word.isdecimal() for word in words)
                    self._named_size = (int(words[0]), int(words[1])) if whole else None
                    continue
                start = file.tell() - len(bare)
                self._look_at(path, start, comments)
                return start
            return file.tell()

    def _look_at(self, path: Path, start: int, comments: list[str]) -> None:
        """Learn the form of the rows and the order of their columns."""
        samples = [sample for sample in _samples(path, start) if _ROW.search(sample)]
        lines = [line for line in samples[0].splitlines() if _ROW.match(line)]
        marks = Counter(_delimiter(line.decode("utf-8", "replace")) for line in lines)
        self._delimiter = marks.most_common(1)[0][0]
        rows = [_split(line.decode("utf-8", "replace"), self._delimiter) for line in lines]
        width, named = Counter(map(len, rows)).most_common(1)[0][0], self._width
        self._width = named or width  # the last cells may be empty
        whole = [[_number(word) for word in row] for row in rows if len(row) == self._width]
        for comment in comments if not self._order.place else ():  # as # timestamp x y polarity
            names = _NAME.findall(re.sub(r"^[#%!\s]*(?:\w+\s*:)?", "", comment))
            self._order = order_named(names[: self._width]) or self._order
        place = self._order.place
        words = [column.count(None) > len(column) // 2 for column in zip(*whole, strict=True)]
        # Of a table with names, what no role needs may hold anything.
        kept = [k for k in range(self._width) if k in place.values() or not (place or words[k])]
        self._labels = {*range(self._width)}.difference(kept)
        tables = [] if place else [self._table(sample) for sample in samples]
        told = len(kept) >= len(columns.ROLES) and any(map(len, tables))
        if not (max(place.values()) < width <= self._width if place else told):
            header = f" and the header {named}" if named else ""
            raise FormatError(
                f"{str(path)!r} is no table of events: its rows, as {','.join(rows[0])[:40]!r}, "
                f"have {width} columns{header}, but time, x, y and polarity are needed, each a "
                "plain number in a column of its own"
            )
        if not place:
            found = columns.order_of_values([table[:, kept] for table in tables], repr(str(path)))
            self._order = Order({role: kept[index] for role, index in found.place.items()})

    def _tables(self) -> Iterator[FloatArray]:
        tail = b""
        for data in itertools.chain(self._chunks(self._start, CHUNK_BYTES), [b""]):
            complete, newline, tail = (tail + (data or b"\n")).rpartition(b"\n")
            if not newline and len(tail) >= CHUNK_BYTES:  # no line is so long
                self.losses.add("bad_record")
                tail = b""
            if _ROW.search(complete) and self._order.place:
                yield self._table(complete)

    def _table(self, text: bytes) -> FloatArray:
        """Return the lines that parse, ``(n, columns)``: at once if all do, else one by one."""
        mark, apart = self._delimiter.encode(), self._delimiter.strip(" ") or None
        text = text.replace(b",", b".") if self._delimiter in "; \t" else text
        text = (text + b"\n").replace(b"\r\n", b"\n").replace(mark + b"\n", b"\n")
        try:
            with warnings.catch_warnings(action="ignore"):  # a block without numbers is empty
                form: Any = {"delimiter": apart, "encoding": "latin-1", "quotechar": '"'}
                table = np.loadtxt(io.BytesIO(text), ndmin=2, **form)
            if table.shape[1] != self._width:
                raise ValueError("another number of columns")
        except ValueError:
            nothing, missing = f" {self._delimiter}", [""] * self._width
            plain = text.decode("utf-8", "replace").replace('"', "").splitlines()
            plain = [line.rstrip(nothing) for line in plain]
            lines = [line.split(apart) for line in plain if line.lstrip()[:1] not in _NO_ROW]
            rows = [
                [0.0 if k in self._labels else _number(word) for k, word in enumerate(words)]
                for words in (words + missing[len(words) :] for words in lines)
            ]
            rows = [row for row in rows if len(row) == self._width and None not in row]
            self.losses.add("bad_record", len(lines) - len(rows))
            table = np.array(rows, np.float64).reshape(len(rows), self._width)
        sound = (np.abs(table) < NUMBER_LIMIT).all(axis=1)
        self.losses.add("bad_record", len(table) - int(np.count_nonzero(sound)))
        return table if sound.all() else table[sound]


def labelled_table(path: Path) -> tuple[list[str], FloatArray]:
    """Return the names in a table's header, and its numbers ``(n, names)``; comments are left out.

    Raises:
        ValueError: A row is no finite number for each name; says which line.
    """
    text = enumerate(path.read_text(encoding="utf-8-sig").splitlines(), 1)
    lines = [(number, line) for number, line in text if line.lstrip()[:1] not in _NO_ROW]
    if len(lines) < 2:
        raise ValueError("it holds no rows of numbers")
    names, mark, rows = _split(lines[0][1]), _delimiter(lines[0][1]), list[FloatArray]()
    for number, line in lines[1:]:
        rows.append(np.array([_number(word) for word in _split(line, mark)], np.float64))
        if rows[-1].shape != (len(names),) or not np.isfinite(rows[-1]).all():
            raise ValueError(f"line {number} is {line[:40]!r} instead of {len(names)} numbers")
    return names, np.stack(rows)


def looks_like_text(sample: bytes) -> bool:
    """Return whether bytes begin a table of numbers, perhaps after comments and a header."""
    lines = sample.decode("utf-8", "replace").splitlines()[:-1] or [sample.decode("latin-1")]
    rows = [_split(line) for line in lines if line.lstrip()[:1] not in _NO_ROW]
    numbers = [row for row in rows if len(row) >= 4 and None not in map(_number, row)]
    return b"\0" not in sample and len(numbers) > 0 and len(numbers) >= len(rows) // 2


def _samples(path: Path, start: int) -> list[bytes]:
    """Return whole lines from the beginning, the middle and the end of the rows."""
    end, samples = path.stat().st_size, []
    room = max(end - start - SAMPLE_BYTES, 0)
    with path.open("rb") as file:
        for place in sorted({start, start + room // 2, start + room}):
            file.seek(place)
            lines = file.read(SAMPLE_BYTES).split(b"\n")
            whole = lines[int(place > start) : len(lines) - int(file.tell() < end)]
            samples.append(b"\n".join(whole or lines))
    return samples


def _delimiter(text: str) -> str:
    return next((m for least in (3, 1) for m in _DELIMITERS if text.count(m) >= least), " ")


def _split(line: str, delimiter: str = "") -> list[str]:
    """Return the words of a line; blanks part them only where nothing else does."""
    delimiter = delimiter or _delimiter(line)
    blanks = re.sub(r"\s+(?=[\[({<])", "", line).split() if delimiter == " " else None
    words = [word.strip().strip('"') for word in blanks or line.split(delimiter)]
    return words[:-1] if words and not words[-1] else words


def _number(word: str) -> float | None:
    try:
        return float(_WORDS.get(word.strip().lower(), word).replace(",", "."))
    except ValueError:
        return None


def _named(names: list[str], path: Path) -> Order:
    if order := order_named(names):
        return order
    missing = [role for role in "txyp" if role not in {columns.role_of(name)[0] for name in names}]
    lacks = f"lacks {', '.join(missing)}" if missing else "names a column twice"
    raise FormatError(
        f"{str(path)!r}: the header {','.join(names)!r} {lacks}; wanted are columns of time (s, "
        "ms, us or ns), x, y and polarity, such as t_us,x,y,p (or leave the header out); polarity "
        "holds 0 and 1, -1 and 1, + and -, ON and OFF or true and false"
    )
