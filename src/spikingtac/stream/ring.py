"""A ring in shared memory through which one process shows its messages to others.

The writer never waits for its readers. Each reader keeps its own place; what it was too slow for is
gone, and the running weight in the messages tells exactly how much that was. A message carries a
checksum, so that one that is overwritten while it is read is never used.
"""

from __future__ import annotations

import os
import struct
import weakref
import zlib
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from typing import Any

from spikingtac.atomic_files import runs
from spikingtac.errors import DeviceError

# Offsets of the numbers in the head, bytes: places of the oldest message, of the end and of the
# newest message; weight so far; whether the writer has ended, and its process; the size of the
# sensor that is shown, px.
OLDEST, END, NEWEST, WEIGHT, CLOSED, WRITER, WIDTH, HEIGHT = range(0, 64, 8)
HEAD_BYTES = 64
_NUMBER = struct.Struct("Q")  # as this machine holds it: it is read and written at once

# What stands before a message: weight before, weight, length, checksum. A message begins at a
# multiple of its size, so that these numbers never go on at the beginning of the ring.
_MESSAGE = struct.Struct("<QQII")


class SharedRing:
    """One writer, any number of :class:`RingReader` in any process.

    Attributes:
        name: Under which other processes attach.
        room: Room for messages, bytes.
        buffer: The memory: the numbers above, then the messages.
        close: Releases the memory; its creator also removes it.

    Example:
        >>> ring = SharedRing.create(1024)
        >>> other = SharedRing.attach(ring.name)
        >>> ring.publish(b"first"), ring.publish(b"second")
        (True, True)
        >>> [bytes(message) for message in iter(RingReader(other).next, None)]
        [b'first', b'second']
        >>> other.close(); ring.close()
    """

    def __init__(self, memory: SharedMemory, owner: bool) -> None:
        assert memory.buf is not None
        self._memory, self.name, self.buffer = memory, memory.name, memory.buf
        # A ring that is dropped is given back, too.
        self.close = weakref.finalize(self, give_back, memory, owner)
        self.room = (memory.size - HEAD_BYTES) // _MESSAGE.size * _MESSAGE.size

    @classmethod
    def create(cls, room_bytes: int, name: str | None = None) -> SharedRing:
        """Make a ring; its creator removes it.

        Args:
            room_bytes: Room for messages; each needs 24 to 47 bytes besides.
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
            abandoned = not left.written
            give_back(left._memory, abandoned)
            if abandoned:
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
            give_back(memory, True)
            raise DeviceError(
                f"no {room_bytes >> 20} MiB of shared memory are left ({error.strerror}); end "
                "other programs, or make /dev/shm larger"
            ) from error
        ring = cls(memory, True)
        ring.put(WRITER, os.getpid())
        return ring

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
        return not self.get(CLOSED) and runs(self.get(WRITER))

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

    def publish(self, *parts: Any, weight: int = 1) -> bool:
        """Append a message, given in parts; False where it does not fit into the ring at all.

        A reader that misses it is told its ``weight``: one message, or its events.
        """
        data = b"".join(parts)
        begin, oldest, before = self.get(END), self.get(OLDEST), self.weight
        end = after(begin, len(data))
        if end - begin > self.room:
            return False
        while end - oldest > self.room:  # given up before it is overwritten
            oldest = after(oldest, self.head(oldest)[2])
        self.put(OLDEST, oldest)
        place = begin % self.room + HEAD_BYTES
        _MESSAGE.pack_into(self.buffer, place, before, weight, len(data), zlib.crc32(data))
        place = (begin + _MESSAGE.size) % self.room + HEAD_BYTES
        fits = HEAD_BYTES + self.room - place
        self.buffer[place : place + min(len(data), fits)] = data[:fits]
        if len(data) > fits:
            self.buffer[HEAD_BYTES : HEAD_BYTES + len(data) - fits] = data[fits:]
        self.put(WEIGHT, before + weight)
        self.put(NEWEST, begin)
        self.put(END, end)
        return True

    def head(self, at: int) -> tuple[int, int, int, int]:
        """Return what stands before the message at a place."""
        return _MESSAGE.unpack_from(self.buffer, at % self.room + HEAD_BYTES)

    def read(self, at: int, length: int) -> bytearray:
        """Return the message of so many bytes at a place."""
        place = (at + _MESSAGE.size) % self.room + HEAD_BYTES
        data = bytearray(self.buffer[place : min(place + length, HEAD_BYTES + self.room)])
        data += self.buffer[HEAD_BYTES : HEAD_BYTES + length - len(data)]
        return data


def give_back(memory: SharedMemory, owner: bool) -> None:
    """Release shared memory; its owner also removes it."""
    memory.close()
    if owner:
        with suppress(FileNotFoundError):
            memory.unlink()


def after(at: int, length: int) -> int:
    """Return the place after a message of so many bytes at a place."""
    return at + (length + 2 * _MESSAGE.size - 1) // _MESSAGE.size * _MESSAGE.size


class RingReader:
    """Takes the messages of a ring in order, or the latest; what it was too slow for is counted.

    Args:
        ring: The ring.
        from_now: Begin with the next message.

    Attributes:
        lost: Weight of what was overwritten before it was taken, or passed over.
    """

    def __init__(self, ring: SharedRing, *, from_now: bool = False) -> None:
        self._ring = ring
        self._at, self._weight = (ring.get(END), ring.weight) if from_now else (0, 0)
        self.lost = 0

    def next(self) -> bytearray | None:
        """Return the next message that is there, or None."""
        ring = self._ring
        while ring.get(END) > (at := max(self._at, ring.get(OLDEST))):
            before, weight, length, checksum = ring.head(at)
            data = ring.read(at, min(length, ring.room))
            if ring.get(OLDEST) > at:  # overwritten while it was read
                continue
            self._at = after(at, len(data))
            if zlib.crc32(data) != checksum:  # damaged: the next weight tells
                continue
            self.lost += before - self._weight
            self._weight = before + weight
            return data
        return None

    def latest(self) -> bytearray | None:
        """Return the latest message, or None where it was taken already."""
        self._at = max(self._at, self._ring.get(NEWEST))
        return self.next()

    def give_up(self) -> None:
        """Count what was published and not taken as lost."""
        self.lost += self._ring.weight - self._weight
        self._weight, self._at = self._ring.weight, self._ring.get(END)
