"""A robot's trace: JSON lines of format koord-trace/1, one a round, which the simulator and the replayer read.

`time` is the agent's local monotonic clock in seconds. Points are [x, y, z], metres, local ENU. Kinds: header,
phase, round, log, stream, metrics. A disk that is full or gone ends the trace with one warning, never the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import IO, Any

import msgspec

from koordgen.runtime.program import Effects, Fault, Frame

FORMAT = "koord-trace/1"


@dataclass(frozen=True, slots=True)
class Record:
    """What happened in a round, for the trace and for monitors. Times in seconds of the local clock."""

    round: int
    time: float
    late: float  # seconds after the tick at which it was decided
    sensors: Mapping[str, Any]
    frame: Frame | None  # what the event saw; None when the round was skipped
    event: str | None = None
    effects: Effects | None = None
    skipped: str | None = None
    fault: Fault | None = None
    calls: tuple[tuple[str, tuple[Any, ...], Any], ...] = ()  # of callable ports: port, arguments, answer


Observe = Callable[[Record], None]


class Trace:
    """Writes to `file`, each round at once; without a file it does nothing. `warn` is told when tracing ends early."""

    def __init__(self, file: IO[bytes] | None, warn: Callable[[str], None]) -> None:
        self._file = file
        self._warn = warn
        self._encoder = msgspec.json.Encoder(enc_hook=repr)

    def header(self, app: str, robot: str, pid: int, n_sys: int, delta: float, program_hash: str) -> None:
        self._write(
            {
                "kind": "header",
                "format": FORMAT,
                "app": app,
                "robot": robot,
                "pid": pid,
                "n_sys": n_sys,
                "delta": delta,
                "program_hash": program_hash,
            }
        )

    def phase(self, time: float, phase: str, detail: str) -> None:
        self._write({"kind": "phase", "time": time, "phase": phase, "detail": detail})

    def log(self, time: float, level: str, message: str) -> None:
        self._write({"kind": "log", "time": time, "level": level, "message": message})

    def stream(self, time: float, round_: int, port: str, text: str) -> None:
        """A line that the program put out; round 0 is `init`."""
        self._write({"kind": "stream", "time": time, "round": round_, "port": port, "text": text})

    def metrics(self, time: float, snapshot: Mapping[str, Any]) -> None:
        """How well the robot hears and keeps its rounds (see `metrics`)."""
        self._write({"kind": "metrics", "time": time, **snapshot})

    def round(self, record: Record, clock_bound: float, counters: Mapping[str, int]) -> None:
        """One round; `clock_bound` is how far fleet time may be off (s), `counters` those that changed."""
        fault, effects = record.fault, record.effects
        line = {
            "kind": "round",
            "time": record.time,
            "round": record.round,
            "event": record.event,
            "skipped": record.skipped,
            "fault": {"file": fault.file, "line": fault.line, "reason": fault.reason} if fault else None,
            "sensors": record.sensors,
            "shared": effects.shared if effects else {},
            "actuators": effects.actuators if effects else {},
            "late": round(record.late, 6),
            "clock_bound": round(clock_bound, 6),
        }
        extra = {"counters": counters, "calls": record.calls}
        self._write(line | {key: value for key, value in extra.items() if value})

    def close(self) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None

    def _write(self, record: Mapping[str, Any]) -> None:
        if self._file is None:
            return
        try:
            self._file.write(self._encoder.encode(record) + b"\n")
            self._file.flush()
        except OSError as error:
            self.close()
            self._warn(f"the trace ends here: {error.strerror or error}")
