"""A ring in shared memory through which one process shows its messages to others.

The writer never waits for its readers. Each reader keeps its own place; what it was too slow for is
gone, and the running counts in the messages tell exactly how much that was. A message carries its
number and a checksum, so that one that is overwritten while it is read is never used.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from typing import Any, Protocol

from spikingtac.errors import DeviceError

# Largest messages that a ring for the latest one holds: the writer publishes three more of them
# before it overwrites the latest.
SLOTS = 4

# Offsets in the head, bytes: room for messages; places of the oldest message, of the end and of
# the newest message; messages and weight so far; whether the writer has ended, and its process;
# a number that the writer tells.
ROOM, OLDEST, END, NEWEST, COUNT, WEIGHT, CLOSED, WRITER, NOTE = range(0, 72, 8)
HEAD_BYTES = 128
_NUMBER = struct.Struct("<Q")
_MESSAGE = struct.Struct("<QQIIII")  # number, weight before, weight, length, checksum, filler
ALIGNED = 8


class Publisher(Protocol):
    """Takes the latest message; the loop that publishes never waits for it."""

    def publish(self, message: bytes, /) -> bool:
        """Offer a message; False where it was too large and was not taken."""
        ...


class SharedRing:
    """One writer, any number of readers in any process.

    Example:
        >>> ring = SharedRing.create(1024)
        >>> other = SharedRing.attach(ring.name)
        >>> ring.publish(b"first"), ring.publish(b"second")
        (True, True)
        >>> other.latest(after=0)
        (2, b'second')
        >>> other.latest(after=2) is None
        True
        >>> [bytes(message) for message in other.reader()]
        [b'first', b'second']
        >>> other.close(); ring.close()
    """

    def __init__(self, memory: SharedMemory, owner: bool) -> None:
        assert memory.buf is not None
        self._memory, self._owner, self.buffer = memory, owner, memory.buf
        self.room = self.get(ROOM)

    @classmethod
    def create(cls, room_bytes: int, name: str | None = None) -> SharedRing:
        """Make a ring; its creator removes it.

        Args:
            room_bytes: Room for messages; a message needs :data:`_MESSAGE` besides.
            name: Name under which others find it; one that is left by a process that has ended is
                replaced.

        Raises:
            DeviceError: Another process writes under this name, or there is no room.
        """
        room = -(-room_bytes // ALIGNED) * ALIGNED
        try:
            memory = SharedMemory(name, create=True, size=HEAD_BYTES + room)
        except FileExistsError as error:
            assert name is not None
            left = cls.attach(name)
            left._owner = not left.written
            left.close()
            if left._owner:
                return cls.create(room_bytes, name)
            raise DeviceError(
                f"another program shares its events under {name!r}; choose another name"
            ) from error
        reserve, file = getattr(os, "posix_fallocate", None), getattr(memory, "_fd", -1)
        try:
            if reserve is not None and file >= 0:  # a page that is missing later ends the process
                reserve(file, 0, HEAD_BYTES + room)
        except OSError as error:
            memory.close()
            memory.unlink()
            raise DeviceError(
                f"no {room >> 20} MiB of shared memory are left ({error.strerror}); end other "
                "programs, or make /dev/shm larger"
            ) from error
        assert memory.buf is not None
        memory.buf[:HEAD_BYTES] = bytes(HEAD_BYTES)
        _NUMBER.pack_into(memory.buf, WRITER, os.getpid())
        _NUMBER.pack_into(memory.buf, ROOM, room)
        return cls(memory, True)

    @classmethod
    def for_latest(cls, largest_bytes: int, count: int = SLOTS) -> SharedRing:
        """Make a ring for so many messages of a largest length."""
        return cls.create(count * (largest_bytes + _MESSAGE.size + ALIGNED))

    @classmethod
    def attach(cls, name: str) -> SharedRing:
        """Open a ring that another process made; FileNotFoundError where there is none."""
        register = resource_tracker.register
        # The tracker of this process must not remove it at its end (Python 3.13: track=False).
        resource_tracker.register = lambda *_: None
        try:
            return cls(SharedMemory(name=name), False)
        finally:
            resource_tracker.register = register

    @property
    def name(self) -> str:
        """The name under which other processes attach."""
        return self._memory.name

    @property
    def written(self) -> bool:
        """True while the writer goes on: it has neither ended nor died."""
        if self.get(CLOSED):
            return False
        try:
            os.kill(self.get(WRITER), 0)
        except OSError as error:
            return isinstance(error, PermissionError)
        return True

    @property
    def finished(self) -> bool:
        """True once the writer has said that nothing follows."""
        return bool(self.get(CLOSED))

    @property
    def weight(self) -> int:
        """Weight of all that was published so far."""
        return self.get(WEIGHT)

    def get(self, what: int) -> int:
        """Return a number of the head."""
        return _NUMBER.unpack_from(self.buffer, what)[0]

    def put(self, what: int, value: int) -> None:
        """Set a number of the head."""
        _NUMBER.pack_into(self.buffer, what, value)

    def publish(self, *parts: Any, weight: int = 0) -> bool:
        """Append a message, given in parts; False where it does not fit into the ring at all.

        A reader that misses it is told its ``weight``, as events.
        """
        length, at = sum(map(len, parts)), self.get(END)
        need, left = _MESSAGE.size + -(-length // ALIGNED) * ALIGNED, self.room - at % self.room
        at += left if need > left else 0
        end = at + need
        if need > self.room:
            return False
        before, number = self.get(WEIGHT), self.get(COUNT) + 1
        self._give_up(at, end)
        place = at % self.room + HEAD_BYTES
        body, checksum = place + _MESSAGE.size, 0
        for part in parts:
            self.buffer[body : body + len(part)] = part
            checksum, body = zlib.crc32(part, checksum), body + len(part)
        _MESSAGE.pack_into(self.buffer, place, number, before, weight, length, checksum, 0)
        self.put(WEIGHT, before + weight)
        self.put(COUNT, number)
        self.put(NEWEST, at)
        self.put(END, end)
        return True

    def latest(self, after: int) -> tuple[int, bytes] | None:
        """Return ``(number, message)`` of the latest message, or None.

        Args:
            after: Number that the caller has; only a later one is returned.
        """
        found = self.message(self.get(NEWEST)) if self.get(COUNT) > after else None
        return None if found is None or found[0] <= after else (found[0], bytes(found[3]))

    def reader(self, *, from_now: bool = False) -> RingReader:
        """Return a reader of all messages in order, or of those from the next one on."""
        return RingReader(self, from_now)

    def message(self, at: int) -> tuple[int, int, int, bytearray] | None:
        """Return number, weight before, weight and bytes at a place; None where there is none."""
        left = self.room - at % self.room - _MESSAGE.size
        if left < 0:
            return None
        place = at % self.room + HEAD_BYTES
        number, before, weight, length, checksum, filler = _MESSAGE.unpack_from(self.buffer, place)
        if filler or length > left:
            return None
        place += _MESSAGE.size
        data = bytearray(self.buffer[place : place + length])
        whole = self.get(OLDEST) <= at and zlib.crc32(data) == checksum
        return (number, before, weight, data) if whole else None

    def after(self, at: int) -> int:
        """Return where the message behind that of a place begins, a filler passed over."""
        left = self.room - at % self.room
        if left >= _MESSAGE.size:
            head = _MESSAGE.unpack_from(self.buffer, at % self.room + HEAD_BYTES)
            left = left if head[5] else _MESSAGE.size + -(-head[3] // ALIGNED) * ALIGNED
        return at + left

    def finish(self) -> None:
        """Say that nothing follows."""
        self.put(CLOSED, 1)

    def close(self) -> None:
        """Release the memory; its creator also removes it."""
        self.buffer.release()
        self._memory.close()
        if self._owner:
            with suppress(FileNotFoundError):
                self._memory.unlink()

    def _give_up(self, at: int, end: int) -> None:
        """Give up the oldest messages that a new one overwrites, before it does."""
        former, oldest = self.get(END), self.get(OLDEST)
        while end - oldest > self.room:
            oldest = self.after(oldest) if oldest < former else at
        self.put(OLDEST, oldest)
        if at - former >= _MESSAGE.size:
            _MESSAGE.pack_into(self.buffer, former % self.room + HEAD_BYTES, 0, 0, 0, 0, 0, 1)


class RingReader:
    """Takes the messages of a ring in order; what it was too slow for is counted.

    Attributes:
        number: That of the latest message.
        taken: Messages that were returned.
        missed: Messages that were overwritten before.
        lost: Their weight.
    """

    def __init__(self, ring: SharedRing, from_now: bool) -> None:
        self._ring = ring
        self._at = ring.get(END) if from_now else 0
        self.number = ring.get(COUNT) if from_now else 0
        self._weight = ring.get(WEIGHT) if from_now else 0
        self.taken = self.missed = self.lost = 0

    def next(self) -> bytearray | None:
        """Return the next message that is there, or None."""
        ring = self._ring
        while ring.get(END) > (at := max(self._at, ring.get(OLDEST))):
            found, following = ring.message(at), ring.after(at)
            if ring.get(OLDEST) > at:  # overwritten while it was read
                continue
            self._at = following
            if found is None:  # a filler, or damaged: the next number tells
                continue
            number, before, weight, data = found
            self.missed += number - 1 - self.number
            self.lost += before - self._weight
            self.number, self._weight = number, before + weight
            self.taken += 1
            return data
        return None

    def give_up(self) -> None:
        """Count what was published and not taken as lost."""
        number, weight = self._ring.get(COUNT), self._ring.get(WEIGHT)
        self.missed += number - self.number
        self.lost += weight - self._weight
        self.number, self._weight, self._at = number, weight, self._ring.get(END)

    def __iter__(self) -> Iterator[bytearray]:
        while (data := self.next()) is not None:
            yield data
