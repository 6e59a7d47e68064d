"""A ring in shared memory through which one process shows its messages to others.

The writer never waits and does not know its readers. A reader takes the latest message, or one
after the other; those that it was too slow for are gone, and their sequence numbers tell how many.
A slot carries its sequence number and a checksum, so that a reader detects and drops a message that
was overwritten meanwhile.
"""

from __future__ import annotations

import struct
import zlib
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from typing import Protocol

SLOTS = 4
"""The writer publishes three more messages before it overwrites the slot of the latest one."""
_LATEST = struct.Struct("<Q")
_HEADER = struct.Struct("<QII")  # sequence, length, checksum
_HEAD_BYTES = 64  # a cache line of its own for the number that both sides watch


class Publisher(Protocol):
    """Takes the latest message; the loop that publishes never waits for it."""

    def publish(self, message: bytes) -> bool:
        """Offer a message; False where it was too large and was not taken."""
        ...


class SharedRing:
    """One writer, any number of readers in any process.

    Example:
        >>> ring = SharedRing.create(slot_bytes=64)
        >>> reader = SharedRing.attach(ring.name, slot_bytes=64)
        >>> ring.publish(b"first"), ring.publish(b"second")
        (True, True)
        >>> reader.latest(after=0)
        (2, b'second')
        >>> reader.latest(after=2) is None
        True
        >>> reader.following(after=0)
        (1, b'first')
        >>> reader.close(); ring.close()
    """

    def __init__(self, memory: SharedMemory, slot_bytes: int, slots: int, owner: bool) -> None:
        self._memory, self._slot_bytes, self._owner = memory, slot_bytes, owner
        self._slots = slots
        self._buffer = _buffer_of(memory)
        self._sequence = 0

    @classmethod
    def create(cls, slot_bytes: int, slots: int = SLOTS) -> SharedRing:
        """Make a ring for messages of at most ``slot_bytes``; its creator removes it."""
        size = _HEAD_BYTES + slots * (_HEADER.size + slot_bytes)
        memory = SharedMemory(create=True, size=size)
        _buffer_of(memory)[:_HEAD_BYTES] = bytes(_HEAD_BYTES)
        return cls(memory, slot_bytes, slots, True)

    @classmethod
    def attach(cls, name: str, slot_bytes: int, slots: int = SLOTS) -> SharedRing:
        """Open a ring that another process made, with what it was made with."""
        return cls(_attached(name), slot_bytes, slots, False)

    @property
    def name(self) -> str:
        """The name under which other processes attach."""
        return self._memory.name

    def publish(self, message: bytes) -> bool:
        """Make a message the latest one; False where it does not fit into a slot."""
        if len(message) > self._slot_bytes:
            return False
        sequence = self._sequence + 1
        start = self._slot(sequence)
        body = start + _HEADER.size
        # Sequence 0 tells readers of this slot that it is being rewritten.
        _HEADER.pack_into(self._buffer, start, 0, 0, 0)
        self._buffer[body : body + len(message)] = message
        _HEADER.pack_into(self._buffer, start, sequence, len(message), zlib.crc32(message))
        _LATEST.pack_into(self._buffer, 0, sequence)
        self._sequence = sequence
        return True

    def latest(self, after: int) -> tuple[int, bytes] | None:
        """Return ``(sequence, message)`` of the latest message, or None.

        Args:
            after: Sequence number that the caller has; only a later one is returned.
        """
        newest = self._newest()
        return self._message(newest) if newest > after else None

    def following(self, after: int) -> tuple[int, bytes] | None:
        """Return ``(sequence, message)`` of the next message, the oldest that is left, or None.

        Args:
            after: Sequence number that the caller has; how many it has missed is what lies between.
        """
        while (newest := self._newest()) > after:
            after = max(after + 1, newest - self._slots + 2)  # the writer may be at the oldest one
            if (found := self._message(after)) is not None:
                return found
        return None

    def close(self) -> None:
        """Release the memory; its creator also removes it."""
        self._buffer.release()
        self._memory.close()
        if self._owner:
            self._memory.unlink()

    def _newest(self) -> int:
        return _LATEST.unpack_from(self._buffer, 0)[0]

    def _message(self, sequence: int) -> tuple[int, bytes] | None:
        """Return a message with its number; None where it was overwritten."""
        start = self._slot(sequence)
        stored, length, checksum = _HEADER.unpack_from(self._buffer, start)
        if stored != sequence or length > self._slot_bytes:
            return None
        message = bytes(self._buffer[start + _HEADER.size : start + _HEADER.size + length])
        return (sequence, message) if zlib.crc32(message) == checksum else None

    def _slot(self, sequence: int) -> int:
        return _HEAD_BYTES + (sequence % self._slots) * (_HEADER.size + self._slot_bytes)


def _attached(name: str) -> SharedMemory:
    """Open memory of another process; this one's tracker must not remove it at its end."""
    register = resource_tracker.register
    resource_tracker.register = lambda *_: None  # Python 3.13 has an argument for it
    try:
        return SharedMemory(name=name)
    finally:
        resource_tracker.register = register


def _buffer_of(memory: SharedMemory) -> memoryview:
    if memory.buf is None:  # only after close()
        raise ValueError("the shared memory is closed")
    return memory.buf
