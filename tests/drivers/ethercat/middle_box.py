"""A box in the wire that spoils what passes: frames are lost, late, doubled, overtaken, corrupted, their clock slips.

`python -m tests.drivers.ethercat.middle_box MASTER_SIDE SEGMENT_SIDE` takes a line of standard input for each change
and says it back when it is in force: `whole`, `cut`, `loss P`, `duplicate P`, `reorder P`, `corrupt P` (P: probability
for each frame, either way; corrupted are only frames on their way to the master), `delay S`, `clock NS` (added to the
distributed clock in returned frames). It stands in for `tc netem`, which few kernels of containers have.
"""

from __future__ import annotations

import heapq
import os
import random
import select
import socket
import struct
import sys
import time

from drivers.ethercat.frames import DC_SYSTEM_TIME
from replay.realtime import go_realtime

OVERTAKEN = 0.0015  # s that a frame waits which others are to overtake at 1 kHz
_FRMW = 14


class Box:
    """Two ends and what happens between them."""

    def __init__(self, master: socket.socket, segment: socket.socket) -> None:
        self.ends = (master, segment)
        self.fault, self.amount = "whole", 0.0
        self._random = random.Random(1)
        self._waiting: list[tuple[float, int, int, bytes]] = []
        self._number = 0

    def take(self, end: int) -> None:
        """A frame came in at `end`, 0 the master's."""
        frame, address = self.ends[end].recvfrom(2048)
        if address[2] == socket.PACKET_OUTGOING:
            return
        hit = self._random.random() < self.amount
        if self.fault == "cut" or (self.fault == "loss" and hit):
            return
        if self.fault == "corrupt" and hit and end == 1:
            frame = self._corrupted(frame)
        if self.fault == "clock" and end == 1:
            frame = _slipped(frame, int(self.amount))
        wait = OVERTAKEN if self.fault == "reorder" and hit else self.amount if self.fault == "delay" else 0.0
        for _ in range(2 if self.fault == "duplicate" and hit else 1):
            if wait:
                self._number += 1
                heapq.heappush(self._waiting, (time.monotonic() + wait, self._number, 1 - end, frame))
            else:
                self.ends[1 - end].send(frame)

    def due(self) -> float:
        """Send what has waited long enough; s until the next is due."""
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, _, end, frame = heapq.heappop(self._waiting)
            self.ends[end].send(frame)
        return max(0.0, self._waiting[0][0] - time.monotonic()) if self._waiting else 1.0

    def _corrupted(self, frame: bytes) -> bytes:
        spoiled = bytearray(frame)
        for _ in range(3):
            spoiled[self._random.randrange(14, len(frame))] ^= 1 << self._random.randrange(8)
        return bytes(spoiled)


def _slipped(frame: bytes, slip: int) -> bytes:
    at, more = 16, True
    while more and at + 12 <= len(frame):
        command, _, _, offset, head, _ = struct.unpack_from("<BBHHHH", frame, at)
        size, more = head & 0x7FF, bool(head & 0x8000)
        if command == _FRMW and offset == DC_SYSTEM_TIME and size >= 8:
            (ticks,) = struct.unpack_from("<Q", frame, at + 10)
            return frame[: at + 10] + struct.pack("<Q", (ticks + slip) % (1 << 64)) + frame[at + 18 :]
        at += 12 + size
    return frame


def _end(interface: str) -> socket.socket:
    end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
    end.bind((interface, 3))
    return end


def main(master: str, segment: str) -> None:
    """Run until standard input ends."""
    box = Box(_end(master), _end(segment))
    go_realtime("middle box", 60)
    print("ready", flush=True)
    while True:
        ready, _, _ = select.select([*box.ends, 0], [], [], box.due())
        for end, wire in enumerate(box.ends):
            if wire in ready:
                box.take(end)
        if 0 in ready:
            line = os.read(0, 256).decode().strip()
            if not line:
                return
            name, _, amount = line.partition(" ")
            box.fault, box.amount = name, float(amount or 0)
            print(line, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
