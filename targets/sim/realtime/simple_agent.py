"""Agent process of a robot of fidelity `simple` in real time.

The bundle's own program over a remote body.

Usage: `python -m targets.sim.realtime.simple_agent PLATFORM PORT BUNDLE DRIVERS [options of bundles]`. The sim bundle
and the robot's are on PYTHONPATH. DRIVERS is a JSON list with three strings per driver."""

from __future__ import annotations

import importlib
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from koordgen.runtime.agent.process import main
from targets.sim.base.bodies import BodyCommand, BodyState, Vector
from targets.sim.base.programs import load_programs

_encode, _decode = msgspec.msgpack.Encoder().encode, msgspec.msgpack.Decoder(tuple[Vector, Vector, float, float]).decode


class RemoteBody:
    """Body in the harness's process, commanded and observed by datagrams."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._harness: Any = None  # its address, once known

    def state(self) -> BodyState | None:
        """Return the newest state received since the last call."""
        newest: bytes | None = None
        try:
            while True:
                newest, self._harness = self._socket.recvfrom(2048)
        except OSError:  # no more datagrams
            pass
        try:
            return None if newest is None else BodyState(*_decode(newest))
        except msgspec.DecodeError:
            return None

    def fly(self, velocity: Vector, yaw_rate: float) -> None:
        self._ask("fly", *velocity, yaw_rate)

    def motors(self, on: bool) -> None:
        self._ask("motors", float(on))

    def drive(self, speed: float, steering: float) -> None:
        self._ask("drive", speed, steering)

    def brake(self, deceleration: float) -> None:
        self._ask("brake", deceleration)

    def _ask(self, what: str, *values: float) -> None:
        if self._harness is not None:
            try:
                self._socket.sendto(_encode(BodyCommand(what, values)), self._harness)
            except OSError:
                return  # lost like any datagram; the next command follows soon


def run(argv: list[str]) -> int:
    """Run the agent. Return its exit status."""
    platform, port, bundle, drivers, *options = argv
    module, _, member = platform.partition(":")
    make: Callable[..., Any] = getattr(importlib.import_module(module), member)
    program, properties = load_programs(Path(bundle))
    found = {
        served: getattr(importlib.import_module(name), cls)
        for served, name, cls in msgspec.json.decode(drivers, type=list[tuple[str, str, str]])
    }
    body = RemoteBody(int(port))
    squad = importlib.import_module("squad").SQUAD if (Path(bundle) / "squad.py").is_file() else None
    return main(
        program, lambda settings, key: make(settings, key, body), Path(bundle), options, found, properties, squad
    )


if __name__ == "__main__":
    raise SystemExit(run(sys.argv[1:]))
