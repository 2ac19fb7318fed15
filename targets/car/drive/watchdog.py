"""The car's watchdog: a process that holds the drive's device beside the agent and brakes when the agent falls silent.

It is run by its path, with nothing but Python's standard library (`python3 -I -S watchdog.py SOCKET`), so that it is
there within some 30 ms and has nothing in it that can get stuck. SOCKET is the number of a SEQPACKET socket, on which
the agent sends a letter and what belongs to it:

    H bytes   hold this device (its descriptor comes along); written to it, these bytes make the car brake
    A json    ... by a datagram to this address
    B time    a command has just been written to the device; seconds on the system's monotonic clock
    R         let go of the device: the agent has closed it

and gets back `B time` for each B, and `L late` when it had to brake: seconds since the last command. The agent writes
its commands to the device itself: no command is later for the watchdog.
"""

from __future__ import annotations

import fcntl
import gc
import math
import os
import select
import signal
import socket
import struct
import sys
import time
from contextlib import suppress

LATE = 0.15  # seconds without a command after which it brakes
PERIOD = 0.05  # seconds between two orders to brake
LAST = 2.0  # seconds for which it brakes after the agent's death: a car at 3 m/s stands by then


class Watchdog:
    """What is held, and when to brake next. Nothing the agent sends makes it raise."""

    def __init__(self, agent: socket.socket) -> None:
        self._agent = agent
        self._device = -1
        self._address: tuple[object, ...] | None = None
        self._brake = self._unsent = b""
        self._commanded = -math.inf
        self._braking = False
        self._due = math.inf
        self._end = math.inf  # when a watchdog without an agent is done

    def run(self) -> None:
        """Until the agent has closed its end and the car has been braked for long enough."""
        while (now := time.monotonic()) < self._end:
            wait = max(0.0, min(self._due, self._end) - now)
            if self._end < math.inf:
                time.sleep(wait)
            elif select.select([self._agent], [], [], None if wait == math.inf else wait)[0]:
                self._take()
                continue  # all that has been said counts before it brakes: it may have been kept from running, too
            if (now := time.monotonic()) >= self._due:
                self._write(now)

    def _take(self) -> None:
        try:
            data, descriptors, _, _ = socket.recv_fds(self._agent, 4096, 1)
        except OSError:
            data, descriptors = b"", []
        match data[:1]:
            case b"H" if descriptors:
                self._let_go()
                self._device, self._brake = descriptors[0], data[1:]
            case b"A":
                import json  # only cars whose drive is on a network pay for it

                self._address = tuple(json.loads(data[1:]))
            case b"B":
                self._commanded = struct.unpack("d", data[1:])[0]
                self._due, self._braking = self._commanded + LATE, False
                with suppress(OSError):
                    self._agent.send(data)
            case b"R":
                self._let_go()
            case _:
                self._orphaned()

    def _orphaned(self) -> None:
        """The agent is gone: brake at once, and give back the lock on the device, which its successor will need."""
        now = time.monotonic()
        if self._device < 0 or self._commanded == -math.inf:
            self._end = now
            return
        with suppress(OSError):
            fcntl.flock(self._device, fcntl.LOCK_UN)
        self._due, self._end = now, now + LAST

    def _write(self, now: float) -> None:
        if not self._braking:
            self._braking = True
            with suppress(OSError):
                self._agent.send(b"L" + struct.pack("d", now - self._commanded))
        self._due = now + PERIOD
        data = self._unsent or self._brake  # a cut frame goes first: its half would spoil the next
        try:
            if self._address is not None:
                self._send(data)
            else:
                self._unsent = data[os.write(self._device, data) :]
        except OSError:
            return  # takes nothing now, is unplugged, or not connected yet: try again, the agent gives us a new one

    def _send(self, data: bytes) -> None:
        with socket.socket(fileno=os.dup(self._device)) as device:
            device.sendto(data, self._address or ())

    def _let_go(self) -> None:
        if self._device >= 0:
            with suppress(OSError):
                os.close(self._device)
        self._device, self._address, self._unsent, self._due = -1, None, b"", math.inf


def main() -> None:
    gc.disable()
    # Signals that end the agent are the agent's business: this process ends after it.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    Watchdog(socket.socket(fileno=int(sys.argv[1]))).run()


if __name__ == "__main__":
    main()
