"""An OpenMV board on a pseudo-terminal that speaks Camera Protocol V2; not hardware.

Framing, sequence numbers, fragments, channels and their commands follow the maker's library
``openmv`` 1.0.7, whose own checksums it uses. The script that it is sent is not run: what the
script would register, the board registers.
"""

import os
import pty
import select
import struct
import threading
import tty
from collections import deque

SYNC = 0xD5AA
HEADER = struct.Struct("<HBBBBHH")
ACK, FRAGMENT, EVENT = 1, 1 << 4, 1 << 5
MAX_PAYLOAD = 4096
STDIN, STDOUT, EVENTS = 1, 2, 5
STOP, EXEC, RESET = 1, 2, 3


class OpenMvBoard:
    """One board; ``port`` is what a PC opens.

    Args:
        complaint: What the script prints instead of streaming, as on firmware without a GenX320.
    """

    def __init__(self, complaint: str = "") -> None:
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave
        self.script = ""
        self._complaint, self._said = complaint, b""
        self._running = False
        self._crc = True
        self._transfers: deque[bytes] = deque()
        self._buffer = b""
        self._alive = True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def put(self, words: bytes) -> None:
        """Let the sensor fill a transfer."""
        self._transfers.append(words)

    def unplug(self) -> None:
        if self._alive:
            self._alive = False
            self._thread.join(5.0)
            os.close(self._master)
            os.close(self._slave)

    def _serve(self) -> None:
        while self._alive:
            if select.select([self._master], [], [], 0.02)[0]:
                self._buffer += os.read(self._master, 1 << 16)
                self._take()

    def _take(self) -> None:
        while len(self._buffer) >= HEADER.size:
            sync, sequence, channel, _, opcode, length, _ = HEADER.unpack_from(self._buffer)
            if sync != SYNC:
                self._buffer = self._buffer[1:]
                continue
            total = HEADER.size + (length + 4 if length else 0)
            if len(self._buffer) < total:
                return
            data = self._buffer[HEADER.size : HEADER.size + length]
            self._buffer = self._buffer[total:]
            self._answer(sequence, channel, opcode, data)

    def _answer(self, sequence: int, channel: int, opcode: int, data: bytes) -> None:
        if opcode == 0x00:  # PROTO_SYNC: checksums are on until the capabilities are set
            self._crc = True
        reply = self._reply(channel, opcode, data)
        if not reply:
            self._send(sequence, channel, opcode, ACK, b"")
        pieces = [reply[at : at + MAX_PAYLOAD] for at in range(0, len(reply), MAX_PAYLOAD)]
        for number, piece in enumerate(pieces):
            flags = FRAGMENT if number < len(pieces) - 1 else 0
            self._send((sequence + number) & 0xFF, channel, opcode, flags, piece)
        if opcode == 0x02:
            self._crc = bool(struct.unpack_from("<I", data)[0] & 1)
        if opcode == 0x28 and channel == STDIN and struct.unpack_from("<I", data)[0] == EXEC:
            self._run()

    def _run(self) -> None:
        if self._complaint:
            self._said = self._complaint.encode()
            return
        self._running = True
        self._send(0, 0, 0x13, EVENT, struct.pack("<H", 0))  # a channel was registered

    def _reply(self, channel: int, opcode: int, data: bytes) -> bytes:
        if opcode == 0x01:
            return struct.pack("<IH10x", 0b1111, MAX_PAYLOAD)
        if opcode == 0x04:
            return bytes([2, 0, 0, 1, 0, 0, 5, 0, 0]) + bytes(7)
        if opcode == 0x12:
            return struct.pack("<I3II3I2I2I4I3I", 0x411, 1, 2, 3, 0x37C51206, *[0] * 14)
        if opcode == 0x20:
            names = {STDIN: b"stdin", STDOUT: b"stdout"} | (
                {EVENTS: b"events"} if self._running else {}
            )
            return b"".join(
                struct.pack("<BB14s", number, 0, name) for number, name in names.items()
            )
        if opcode == 0x21:
            ready = bool(self._transfers) and self._running
            return struct.pack("<I", ready << EVENTS | bool(self._said) << STDOUT)
        if opcode == 0x25:
            held = self._said if channel == STDOUT else (self._transfers or [b""])[0]
            return struct.pack("<I", len(held))
        if opcode == 0x26:
            offset, length = struct.unpack("<II", data)
            if channel == STDOUT:
                said, self._said = self._said, b""
                return said[offset : offset + length]
            return self._transfers.popleft()[offset : offset + length]
        self._control(channel, opcode, data)
        return b""

    def _control(self, channel: int, opcode: int, data: bytes) -> None:
        if channel == STDIN and opcode == 0x27:
            offset, length = struct.unpack_from("<II", data)
            self.script = self.script[:offset] + data[8 : 8 + length].decode()
        elif channel == STDIN and opcode == 0x28:
            command = struct.unpack_from("<I", data)[0]
            self.script = "" if command == RESET else self.script
            self._running = self._running and command != STOP

    def _send(self, sequence: int, channel: int, opcode: int, flags: int, data: bytes) -> None:
        from openmv.crc import crc16, crc32

        head = struct.pack("<HBBBBH", SYNC, sequence, channel, flags, opcode, len(data))
        packet = head + struct.pack("<H", crc16(head) if self._crc else 0)
        if data:
            packet += data + struct.pack("<L", crc32(data) if self._crc else 0)
        while packet and self._alive:
            packet = packet[os.write(self._master, packet) :]
