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
from typing import Any

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
_MESSAGE = struct.Struct("<QQIII")  # number, weight before, weight, length, checksum


class SharedRing:
    """One writer, any number of readers in any process.

    Attributes:
        name: Under which other processes attach.

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
        self.name = memory.name
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
        try:
            memory = SharedMemory(name, create=True, size=HEAD_BYTES + room_bytes)
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
        try:
            # A page that is missing later would end the process.
            os.posix_fallocate(memory._fd, 0, HEAD_BYTES + room_bytes)  # type: ignore[attr-defined]
        except AttributeError:  # another system than Linux
            pass
        except OSError as error:
            memory.close()
            memory.unlink()
            raise DeviceError(
                f"no {room_bytes >> 20} MiB of shared memory are left ({error.strerror}); end "
                "other programs, or make /dev/shm larger"
            ) from error
        assert memory.buf is not None
        memory.buf[:HEAD_BYTES] = bytes(HEAD_BYTES)
        _NUMBER.pack_into(memory.buf, WRITER, os.getpid())
        _NUMBER.pack_into(memory.buf, ROOM, room_bytes)
        return cls(memory, True)

    @classmethod
    def for_latest(cls, largest_bytes: int, count: int = SLOTS) -> SharedRing:
        """Make a ring for so many messages of a largest length."""
        return cls.create(count * (largest_bytes + _MESSAGE.size))

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
        length, checksum = sum(map(len, parts)), 0
        begin, oldest = self.get(END), self.get(OLDEST)
        end = begin + _MESSAGE.size + length
        if end - begin > self.room:
            return False
        while end - oldest > self.room:  # given up before it is overwritten
            oldest += _MESSAGE.size + _MESSAGE.unpack(self._read(oldest, _MESSAGE.size))[3]
        self.put(OLDEST, oldest)
        before, number, at = self.get(WEIGHT), self.get(COUNT) + 1, begin + _MESSAGE.size
        for part in parts:
            self._write(at, part)
            checksum, at = zlib.crc32(part, checksum), at + len(part)
        self._write(begin, _MESSAGE.pack(number, before, weight, length, checksum))
        self.put(WEIGHT, before + weight)
        self.put(COUNT, number)
        self.put(NEWEST, begin)
        self.put(END, end)
        return True

    def latest(self, after: int) -> tuple[int, bytes] | None:
        """Return ``(number, message)`` of the latest message, or None.

        Args:
            after: Number that the caller has; only a later one is returned.
        """
        at = self.get(NEWEST)
        if self.get(COUNT) <= after:
            return None
        number, _, _, checksum, data = self.message(at)
        whole = self.get(OLDEST) <= at and zlib.crc32(data) == checksum
        return (number, bytes(data)) if whole and number > after else None

    def reader(self, *, from_now: bool = False) -> RingReader:
        """Return a reader of all messages in order, or of those from the next one on."""
        return RingReader(self, from_now)

    def message(self, at: int) -> tuple[int, int, int, int, bytearray]:
        """Return number, weight before, weight, checksum and bytes of the message at a place.

        They hold only where the oldest message is at this place or before it afterwards.
        """
        number, before, weight, length, checksum = _MESSAGE.unpack(self._read(at, _MESSAGE.size))
        data = self._read(at + _MESSAGE.size, min(length, self.room))
        return number, before, weight, checksum, data

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

    def _read(self, at: int, length: int) -> bytearray:
        """Return the bytes at a place, which go on at the ring's beginning."""
        first = HEAD_BYTES + at % self.room
        data = bytearray(self.buffer[first : min(first + length, HEAD_BYTES + self.room)])
        data += self.buffer[HEAD_BYTES : HEAD_BYTES + length - len(data)]
        return data

    def _write(self, at: int, data: Any) -> None:
        first = at % self.room
        fits = min(len(data), self.room - first)
        self.buffer[HEAD_BYTES + first : HEAD_BYTES + first + fits] = data[:fits]
        self.buffer[HEAD_BYTES : HEAD_BYTES + len(data) - fits] = data[fits:]


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
            number, before, weight, checksum, data = ring.message(at)
            if ring.get(OLDEST) > at:  # overwritten while it was read
                continue
            self._at = at + _MESSAGE.size + len(data)
            if zlib.crc32(data) != checksum:  # damaged: the next number tells
                continue
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
