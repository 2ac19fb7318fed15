"""Flights over links that break and heal: real sockets and a real pseudo-terminal, on the test's own clock."""

from __future__ import annotations

import contextlib
import os
import pty
import socket
import tty
from pathlib import Path
from typing import Protocol

import pytest

from benchmarks.fixtures.quad_rig import ORIGIN, Rig, settings
from targets.planning.process import Inside
from targets.quad.platform.platform import Quad
from targets.sim.autopilots.autopilot import SimulatedAutopilot
from targets.sim.base.bodies import DeviceContext


class Line(Protocol):
    """The autopilot's end of a link, and what may befall it."""

    url: str

    def receive(self) -> list[bytes]: ...

    def send(self, data: bytes) -> None: ...

    def cut(self) -> None: ...

    def mend(self) -> None: ...

    def close(self) -> None: ...


class TcpLine:
    """A server as ArduPilot's simulator is one: a connection at a time. A cut closes all, so that nobody answers."""

    def __init__(self, folder: Path) -> None:
        self._server: socket.socket | None = None
        self._connection: socket.socket | None = None
        self._port = 0
        self.mend()
        self.url = f"tcp:127.0.0.1:{self._port}"

    def mend(self) -> None:
        self._server = socket.create_server(("127.0.0.1", self._port))
        self._server.setblocking(False)
        self._port = self._server.getsockname()[1]

    def cut(self) -> None:
        for end in (self._connection, self._server):
            if end is not None:
                end.close()
        self._connection = self._server = None

    def receive(self) -> list[bytes]:
        with contextlib.suppress(BlockingIOError):
            if self._connection is None and self._server is not None:
                self._connection, _ = self._server.accept()
                self._connection.setblocking(False)
        with contextlib.suppress(OSError):
            data = self._connection.recv(65536) if self._connection is not None else b""
            return [data] if data else []
        return []

    def send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            if self._connection is not None:
                self._connection.send(data)

    def close(self) -> None:
        self.cut()


class SerialLine:
    """A pseudo-terminal behind a name that stays, as /dev/serial/by-id has them. A cut unplugs it."""

    def __init__(self, folder: Path) -> None:
        self._name = folder / "autopilot"
        self._ends: tuple[int, ...] = ()
        self.mend()
        self.url = f"serial:{self._name}:115200"

    def mend(self) -> None:
        self._ends = pty.openpty()
        tty.setraw(self._ends[1])
        os.set_blocking(self._ends[0], False)
        self._name.symlink_to(os.ttyname(self._ends[1]))

    def cut(self) -> None:
        for end in self._ends:
            os.close(end)
        self._ends = ()
        self._name.unlink(missing_ok=True)

    def receive(self) -> list[bytes]:
        with contextlib.suppress(OSError):
            return [os.read(self._ends[0], 65536)] if self._ends else []
        return []

    def send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            if self._ends:
                os.write(self._ends[0], data)

    def close(self) -> None:
        self.cut()


class UdpLine:
    """An autopilot that sends to the agent's port. After a cut it does so from another port: it was started anew."""

    def __init__(self, folder: Path) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self._to = free.getsockname()
        self._socket: socket.socket | None = None
        self.mend()
        self.url = f"udpin:127.0.0.1:{self._to[1]}"

    def mend(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def cut(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def receive(self) -> list[bytes]:
        found: list[bytes] = []
        with contextlib.suppress(OSError):
            while self._socket is not None:
                found.append(self._socket.recv(2048))
        return found

    def send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            if self._socket is not None:
                self._socket.sendto(data, self._to)

    def close(self) -> None:
        self.cut()


@pytest.mark.parametrize("kind", [TcpLine, SerialLine, UdpLine])
def test_a_flight_over_a_link_that_breaks_and_heals(kind: type[Line], tmp_path: Path) -> None:
    line = kind(tmp_path)  # type: ignore[call-arg]
    rig = Rig(autopilot=False)
    context = DeviceContext("alice", {}, {"boot": 1.0, "spool_up": 0.3}, ORIGIN, 1, b"")
    rig.autopilot = SimulatedAutopilot(rig.body, context, line)
    rig.quad = Quad(settings(autopilot=line.url), None, clock=lambda: rig.now, sleep=rig.pass_time, planning=Inside)
    try:
        rig.fly()
        rig.go(4.0, 0.0)
        rig.run(1.0)
        line.cut()
        rig.run(1.0)
        assert not rig.quad.ready and "nothing comes on" in rig.quad.progress
        line.mend()
        assert rig.run(4.0, lambda: rig.quad.ready), rig.progress
        assert rig.run(12.0, rig.reached)
        rig.quad.stop(rig.now)
        assert rig.run(15.0, lambda: rig.quad.stopped)
        assert rig.autopilot.copter.mode == 9 and not any("GCS" in said for said in rig.progress)
    finally:
        rig.quad.close()
        line.close()
