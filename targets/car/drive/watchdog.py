"""Watchdog process of the car: shares the drive's device with the agent, and brakes if the agent stops commanding.

The agent starts it as `python3 -I -S watchdog.py SOCKET`, with Python's standard library only. So the process starts
within about 30 ms, and contains nothing that can block. SOCKET is the descriptor of a SEQPACKET socket. The agent sends
these messages, each of which is a letter and its data:

    H bytes   hold this device, whose descriptor is attached; the bytes, written to it, make the car brake
    A json    send the bytes of H as datagrams to this address
    B time    a command has just been written to the device, at this time (s on the system's monotonic clock)
    R         release the device: the agent has closed it

The watchdog answers each B with `B time`. When it begins to brake, it sends `L late`: the seconds since the last
command.
The agent writes its commands to the device itself, so the watchdog does not delay them.
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

LATE = 0.15  # seconds without a command after which the watchdog brakes
PERIOD = 0.05  # seconds between two brake commands
LAST = 2.0  # seconds for which the watchdog brakes after the agent's death: enough to stop a car that drives at 3 m/s


class Watchdog:
    """Watchdog: it holds a device and knows when the next brake command is due. No message makes it raise."""

    def __init__(self, agent: socket.socket) -> None:
        self._agent = agent
        self._device = -1
        self._address: tuple[object, ...] | None = None
        self._brake = self._unsent = b""
        self._commanded = -math.inf
        self._braking = False
        self._due = math.inf
        self._end = math.inf  # time at which a watchdog whose agent has died ends

    def run(self) -> None:
        """Run until the agent has closed its socket and the car has been braked for LAST seconds."""
        while (now := time.monotonic()) < self._end:
            wait = max(0.0, min(self._due, self._end) - now)
            if self._end < math.inf:
                time.sleep(wait)
            elif select.select([self._agent], [], [], None if wait == math.inf else wait)[0]:
                self._receive()
                continue  # handle all messages before braking, because this process itself may have been suspended
            if (now := time.monotonic()) >= self._due:
                self._write(now)

    def _receive(self) -> None:
        try:
            data, descriptors, _, _ = socket.recv_fds(self._agent, 4096, 1)
        except OSError:
            data, descriptors = b"", []
        match data[:1]:
            case b"H" if descriptors:
                self._let_go()
                self._device, self._brake = descriptors[0], data[1:]
            case b"A":
                import json  # imported only for a drive on a network

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
        """Brake at once, because the agent has died. Unlock the device, because a restarted agent needs it."""
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
        # First write the rest of a partly written frame, which would corrupt the next frame.
        data = self._unsent or self._brake
        try:
            if self._address is not None:
                self._send(data)
            else:
                self._unsent = data[os.write(self._device, data) :]
        except OSError:
            return  # the device is full, unplugged or not connected: retry, or wait for another device from the agent

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
    # Ignore the signals that end the agent, because this process must brake after the agent's end.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    Watchdog(socket.socket(fileno=int(sys.argv[1]))).run()


if __name__ == "__main__":
    main()
