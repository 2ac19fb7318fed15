"""One robot of a chaos test: a bundle as koordgen built it, on a body that does nothing.
usage: robot_main.py BUNDLE [arguments of the bundle]"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, sys.argv[1])  # the bundle's own copy of the runtime, not the checkout's

from koordgen.runtime.agent.process import main
from koordgen.runtime.config.settings import Settings
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Finding, Sensed

PR_SET_PDEATHSIG = 1


class Still:
    """A body that is always ready and at rest."""

    period = 0.1
    ready = True
    stopped = True
    progress = "standing"
    stall = ""

    def __init__(self, settings: Settings, key: bytes | None) -> None:
        """Nothing to open."""

    def diagnose(self) -> list[Finding]:
        return [Finding("still", "ok", "a body that does nothing")]

    def start(self, now: float) -> None: ...

    def poll(self, now: float) -> None: ...

    def sense(self, now: float) -> Sensed:
        return Sensed({"Motion.position": Point()}, now)

    def command(self, actuators: Mapping[str, Any], now: float) -> None: ...

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        raise LookupError(port)

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None: ...

    def log_lines(self) -> list[str]:
        return []

    def hold(self, on: bool, now: float) -> None: ...

    def stop(self, now: float) -> None: ...

    def close(self) -> None: ...


def ours() -> Any:
    from program import PROGRAM  # type: ignore[import-not-found]

    return PROGRAM


if __name__ == "__main__":
    parent = os.getppid()
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # no robot outlives its test
    if os.getppid() != parent:
        raise SystemExit(1)
    raise SystemExit(main(ours(), Still, Path(sys.argv[1]), sys.argv[2:]))
