"""A robot's trace: JSON lines of format koord-trace/1, one a round, which the simulator and the replayer read.

`time` is the agent's local monotonic clock in seconds. Points are [x, y, z], metres, local ENU. Kinds: header, phase,
init, round, view, log, stall, stream, monitor, metrics, checkpoint. What an event saw and did can be told from it
alone: `replay` does. A disk that is full or gone ends the trace with one warning, never the robot.

A trace with a limit is written in parts (see `trace_parts`). A part begins with all that a reader needs to understand
it without the older parts, which may have been deleted: header, phases, view and checkpoint.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Any

import msgspec

from koordgen.runtime.program.program import Calls, Effects, Fault, Frame, Life, Program
from koordgen.runtime.trace.parts import Parts

if TYPE_CHECKING:  # it is made of what this module has
    from koordgen.runtime.trace.watched import Change

FORMAT = "koord-trace/1"
STARTING = "starting"  # the phase with which a trace begins


class Record(msgspec.Struct, frozen=True):
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
    calls: Calls = ()
    restored: Life | None = None  # what the robot went on with, when it came back before this round


Observe = Callable[[Record], None]


class Trace:
    """Writes to `file`, each round at once; without a file it does nothing. `warn` is told when tracing ends early."""

    def __init__(self, file: IO[bytes] | Parts | None, warn: Callable[[str], None]) -> None:
        self._file = file
        self._warn = warn
        self._encoder = msgspec.json.Encoder(enc_hook=repr)
        self._pid = -1
        self._slots: Collection[str] = ()
        self._told: dict[str, Any] = {}  # of the shared store, as this part has recorded it
        # For the beginning of the next part:
        self._header: dict[str, Any] = {}
        self._part = 0
        self._phase = ""
        self._phases: dict[str, Mapping[str, Any]] = {}  # the record with which each phase but the first began
        self._view: Mapping[str, Any] | None = None
        self._life: Life | None = None  # own variables after the last recorded round; None: not known yet
        self._last = -1  # that round; 0: `init`

    @property
    def open(self) -> bool:
        """Whether what is told is written anywhere."""
        return self._file is not None

    def header(self, program: Program, robot: str, pid: int, n_sys: int, delta: float) -> None:
        """First of all."""
        self._slots = [v.name for v in program.shared if v.kind == "allread"]
        self._pid = pid
        self._header = {
            "kind": "header",
            "format": FORMAT,
            "app": program.name,
            "robot": robot,
            "pid": pid,
            "n_sys": n_sys,
            "delta": delta,
            "program_hash": program.program_hash,
        }
        self._write(self._header)

    def phase(self, time: float, phase: str, detail: str) -> None:
        record = {"kind": "phase", "time": time, "phase": phase, "detail": detail}
        self._tell(record)
        if phase != self._phase:
            self._phase = phase
            if phase != STARTING:
                self._phases[phase] = record

    def init(self, time: float, sensors: Mapping[str, Any], effects: Effects, after: Life, calls: Calls) -> None:
        """`init` has run: what it saw and wrote, all own variables `after` it."""
        self._turn_if_full(time)
        self._told, self._life, self._last = {}, after, 0
        line = {
            "kind": "init",
            "time": time,
            "sensors": sensors,
            "locals": after.locals,
            "shared": effects.shared,
            "actuators": after.actuators,
            "stopped": after.stopped,
        }
        extra = {"calls": calls, "violated": effects.violated}
        self._write(line | {key: value for key, value in extra.items() if value})

    def view(self, time: float, number: int, since: int, members: Sequence[int]) -> None:
        """Who counts from round `since` on: each robot's incarnation, -1 of one that does not."""
        record = {"kind": "view", "time": time, "number": number, "since": since, "members": members}
        self._tell(record)
        self._view = record

    def log(self, time: float, level: str, message: str) -> None:
        self._tell({"kind": "log", "time": time, "level": level, "message": message})

    def stall(self, time: float, state: str, why: str, lasted: float) -> None:
        """A stall begins, goes on or ends (see `stall`); `lasted` is its length in seconds so far."""
        self._tell({"kind": "stall", "time": time, "state": state, "why": why, "lasted": round(lasted, 3)})

    def stream(self, time: float, round_: int, port: str, text: str) -> None:
        """A line that the program put out; round 0 is `init`. It stands in the same part as its round."""
        self._write({"kind": "stream", "time": time, "round": round_, "port": port, "text": text})

    def metrics(self, time: float, snapshot: Mapping[str, Any]) -> None:
        """How well the robot hears and keeps its rounds (see `metrics`)."""
        self._tell({"kind": "metrics", "time": time, **snapshot})

    def monitor(self, change: Change) -> None:
        """A property has come to another outcome."""
        told = {
            name: getattr(change, name) for name in ("time", "round", "of", "name", "line", "outcome", "age", "why")
        }
        self._tell({"kind": "monitor", **told, "action": change.action})

    def round(self, record: Record, clock_bound: float, counters: Mapping[str, int]) -> None:
        """One round; `clock_bound` is how far fleet time may be off (s), `counters` those that changed. Of its
        locals those that the event wrote; `violated` are the lines of its loop invariants that did not hold. `copy` is
        what has changed in this robot's copy of the shared store since it was told last, of an allread variable by
        pid."""
        self._turn_if_full(record.time)
        fault, effects, restored = record.fault, record.effects, record.restored
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
        extra = {
            "locals": _written(record),
            "copy": self._changed(record),
            "stopped": effects is not None and effects.stopped,
            "restored": restored and {name: getattr(restored, name) for name in Life.__struct_fields__},
            "counters": counters,
            "calls": record.calls,
            "violated": effects.violated if effects else (),
        }
        self._write(line | {key: value for key, value in extra.items() if value})
        self._live(record)

    def _live(self, record: Record) -> None:
        """Update the robot's own variables by a round that was recorded."""
        self._last, effects = record.round, record.effects
        life = self._life = record.restored or self._life
        if life is not None and effects is not None:
            actuators, stopped = {**life.actuators, **effects.actuators}, life.stopped or effects.stopped
            self._life = Life(record.round, effects.locals, actuators, stopped)

    def _turn_if_full(self, time: float) -> None:
        """Begin another part where the current one is full; never between a round and its streams."""
        parts = self._file
        if not isinstance(parts, Parts) or not parts.full:
            return
        try:
            parts.turn()
        except OSError as error:
            self._end(error)
            return
        self._part += 1
        self._told = {}
        self._write({**self._header, "part": self._part})
        for record in self._phases.values():
            self._write(record)
        if self._view is not None:
            self._write(self._view)
        own = {"own": msgspec.structs.asdict(self._life)} if self._life is not None else {}
        self._write({"kind": "checkpoint", "time": time, "round": self._last, **own})
        parts.began()

    def _changed(self, record: Record) -> dict[str, Any]:
        """What is another object than before has been written since. A robot's own slots were told with its events; of
        an allwrite variable another robot's write may have counted."""
        found: dict[str, Any] = {}
        frame, told = record.frame, self._told
        if frame is None:
            return found
        for name, value in frame.shared.items():
            before = told.get(name)
            if value is before:
                continue
            told[name] = value
            if name not in self._slots:
                found[name] = value
            elif before is None:
                found[name] = dict(enumerate(value))
            else:
                news = {p: v for p, v in enumerate(value) if v is not before[p] and p != self._pid}
                if news:
                    found[name] = news
        return found

    def close(self) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None

    def _tell(self, record: Mapping[str, Any]) -> None:
        """Write a record that may stand in the next part as well."""
        self._turn_if_full(record["time"])
        self._write(record)

    def _write(self, record: Mapping[str, Any]) -> None:
        if self._file is None:
            return
        try:
            self._file.write(self._encoder.encode(record) + b"\n")
            self._file.flush()
        except OSError as error:
            self._end(error)

    def _end(self, error: OSError) -> None:
        self.close()
        self._warn(f"the trace ends here: {error.strerror or error}")


def _written(record: Record) -> dict[str, Any]:
    """The locals that the event wrote."""
    effects, frame = record.effects, record.frame
    if effects is None or frame is None:
        return {}
    return {name: value for name, value in effects.locals.items() if value is not frame.locals.get(name)}
