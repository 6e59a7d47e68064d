"""What every codec shares: the writer's base, triggers, and the kinds of damage."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spikingtac.atomic_files import WholeFile
from spikingtac.errors import FormatError
from spikingtac.types import EventPacket

# Every kind that a source counts in its ``losses``, and what it means.
KINDS: dict[str, str] = {
    "truncated": "the file ends inside a word, a record or a message",
    "resynchronised": "bytes were lost or inserted; the word boundary was found again",
    "garbage": "blocks of words that fit no alignment; no event was taken from them",
    "unknown_word": "words of a type that the format does not define",
    "out_of_range": "events outside of the sensor; dropped",
    "missing_state": "events before the first time, row or vector base; dropped",
    "time_backwards": "time went back by less than 0.1 s; held until it caught up",
    "time_glitch": "single time words that contradict both neighbours; ignored",
    "time_reset": "time restarted; re-based so that it goes on from the last event",
    "time_jump": "time leapt forward by 1 s or more; a leap of 2^24 us is taken back",
    "gap": "a stretch is missing: time words or sequence numbers that always follow do not",
    "silences": "stretches without any event, though the camera has noise; markers were followed",
    "unsorted": "rows that came before their predecessor in time; sorted",
    "other_data": "frames, samples of an IMU, other cameras beside the events; left out, no loss",
    "trigger": "external trigger edges; delivered apart, no loss",
    "padding": "padding words; no loss",
    "vendor_word": "words for vendor extensions (others, continued); skipped, no loss",
    "unknown_message": "messages of an encoding or type that is not read",
    "before_zero": "events from before the zero of another clock that they were put on; dropped",
    "overflow": "buffers that overran: datagrams, packets or events were dropped on their way",
    "missed": "events that came in time, but that this user was too slow for",
    "duplicate": "datagrams that came twice; the second one was dropped",
    "reordered": "datagrams that came late; their events are kept, at the time reached by then",
    "late": "events of a camera after its silence, for times that were told without it; dropped",
    "foreign": "datagrams of another sender than the first; dropped",
    "no_end_mark": "frames without the mark that ends their events; read to their end",
    "disconnected": "the camera was gone",
    "reconnected": "the camera came back; what happened meanwhile is missing",
    "hot_pixels": "pixels that became hot while markers were followed; ignored since, no loss",
    "bad_record": "lines, records or chunks that do not parse or fail their checksum",
}

# Columns of trigger edges in archives, where there are any.
TRIGGERS = ("trigger_t_us", "trigger_channel", "trigger_edge")

# A leap forward by so much is counted; sensors send events and time words far more often.
JUMP_US = 1_000_000

# A fall of the time by less is held until the source catches up, a larger one re-based.
RESET_US = 100_000


EDGE = np.dtype([("t_us", np.int64), ("channel", np.uint8), ("edge", np.bool_)])


class Triggers:
    """Edges on a camera's external trigger inputs, as columns that grow in order of time."""

    def __init__(self) -> None:
        self._parts: list[NDArray[Any]] = []

    @property
    def rows(self) -> NDArray[Any]:
        """All edges, as structures of time, channel and edge."""
        if len(self._parts) != 1:
            self._parts[:] = [np.concatenate([np.empty(0, EDGE), *self._parts])]
        return self._parts[0]

    @property
    def t_us(self) -> NDArray[np.int64]:
        """Times of the edges, us."""
        return self.rows["t_us"]

    @property
    def channel(self) -> NDArray[np.uint8]:
        """Input that each edge was seen on."""
        return self.rows["channel"]

    @property
    def edge(self) -> NDArray[np.bool_]:
        """True where the signal rose, False where it fell."""
        return self.rows["edge"]

    def __len__(self) -> int:
        return sum(map(len, self._parts))

    def __iter__(self) -> Iterator[tuple[int, int, bool]]:
        return iter(self.rows.tolist())

    def append(self, t_us: ArrayLike, channel: ArrayLike, edge: ArrayLike) -> None:
        """Append edges that follow the ones before in time; single values count for all."""
        rows = np.empty(np.atleast_1d(t_us).shape, EDGE)
        rows["t_us"], rows["channel"], rows["edge"] = t_us, channel, edge
        self._parts.append(rows)

    def extend(self, others: Self) -> None:
        """Append the edges of another collection."""
        self._parts.extend(others._parts)

    def clear(self) -> None:
        """Forget all edges."""
        self._parts.clear()

    def select(self, keep: NDArray[Any] | slice) -> Self:
        """Return the edges that a mask, an index array or a slice keeps."""
        chosen = type(self)()
        chosen._parts.append(self.rows[keep])
        return chosen

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns by their keys in archives; none where there are no edges."""
        return {f"trigger_{name}": self.rows[name] for name in EDGE.names or () if len(self)}

    def channels(self) -> dict[str, dict[str, int]]:
        """Return count, first and last time of each channel, us, by the channel's number."""
        found = {}
        for channel in np.unique(self.channel).tolist():
            t_us = self.t_us[self.channel == channel].tolist()
            found[str(channel)] = {
                "count": len(t_us), "t_first_us": t_us[0], "t_last_us": t_us[-1],
            }  # fmt: skip
        return found


class Blocks:
    """Rows that are given out in whole blocks: a file's bytes do not depend on the packets.

    Args:
        kind: Type of a row, a structure.
        length: Rows of a block.

    Attributes:
        rest: Rows that wait for the next ones.
    """

    def __init__(self, kind: np.dtype[Any], length: int) -> None:
        self.rest, self._length = np.zeros(0, kind), length

    def add(self, **columns: NDArray[Any]) -> NDArray[Any]:
        """Take rows, given as columns; return the whole blocks that there are by now."""
        held = len(self.rest)
        rows = np.zeros(held + len(next(iter(columns.values()))), self.rest.dtype)
        rows[:held] = self.rest  # joining arrays would drop their padding
        for name, column in columns.items():
            rows[name][held:] = column
        whole = len(rows) // self._length * self._length
        self.rest = rows[whole:]
        return rows[:whole]


class WrittenWhole(ABC):
    """Something written in a ``with`` block: completed at its end, given up where it raises."""

    @abstractmethod
    def close(self) -> None:
        """Complete what is written; further calls do nothing."""

    @abstractmethod
    def abandon(self) -> None:
        """Give up without completing it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is not None:
            return self.abandon()
        try:
            self.close()
        except BaseException:
            self.abandon()
            raise


class EventWriter(WrittenWhole):
    """A file that events are appended to, packet by packet, at constant memory.

    The file appears when it is closed; used as a context, it appears unless there was an error.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        triggers_left_out: Trigger edges that the format cannot hold.
    """

    size: tuple[int, int]
    triggers_left_out: int = 0

    def write(self, packet: EventPacket) -> None:
        """Append the events of a packet that follows the ones before it in time.

        Raises:
            ConfigError: The packet breaks what it promises.
            FormatError: An event lies outside of the file's sensor, or does not fit the format.
        """
        packet.sound()
        if packet.size != tuple(self.size) and len(packet):
            reach = int(packet.x.max()), int(packet.y.max())
            if reach[0] >= self.size[0] or reach[1] >= self.size[1]:
                raise FormatError(
                    f"events reach {reach}, outside of the sensor of {self.size[0]}x{self.size[1]} "
                    "px; crop them or give the true size"
                )
        self._add(packet)

    def _add(self, packet: EventPacket) -> None:
        """Append the events of a packet that was checked: what a format has to define."""
        raise NotImplementedError

    def add_triggers(self, triggers: Triggers) -> None:
        """Append trigger edges that follow the ones before; formats that hold none leave them out.

        Edges are given before the packet in whose time they lie, or at any time up to the end
        where the format keeps them apart from the events.
        """
        self.triggers_left_out += len(triggers)


class OneFileWriter(EventWriter):
    """A writer of one file.

    Args:
        path: File to write; replaced if it exists.
        size: ``(width, height)`` of the sensor, px.
        head: How the file begins.
        in_place: For a recorder: what came so far stands at the path, also if it is killed.

    Attributes:
        side_limit_px: Rows and columns that the format's addresses can name.

    Raises:
        FormatError: The sensor is larger.
    """

    side_limit_px = 1 << 16

    def __init__(
        self, path: str | Path, size: tuple[int, int], head: bytes = b"", in_place: bool = False
    ) -> None:
        if max(size) > self.side_limit_px:
            raise FormatError(
                f"a sensor of {size[0]}x{size[1]} px does not fit into the addresses of "
                f"{Path(path).suffix} files (at most {self.side_limit_px} each); write .npz or .h5"
            )
        self.size = size
        self._target = WholeFile(path, in_place)
        self._file = self._target.begin(head)

    def close(self) -> None:
        """Complete the file; further calls do nothing."""
        if not self._file.closed:
            self._finish()
            self._target.commit(self._file)

    def abandon(self) -> None:
        """Give up: leave what was there before; in place, leave what came so far."""
        self._target.abandon(self._file)

    def _finish(self) -> None:
        """Write what was kept back."""
