"""Writer of a robot's trace: lines of JSON as `schema` defines them, for simulators and `replay`.

A trace contains all inputs and results of events, so `replay` needs no other file. A full or missing disk ends the
trace with one warning. The robot goes on.

A trace with a size limit is written in parts (see `parts`). Older parts may be deleted, so each part begins with all
that a reader needs: header, phases, view and checkpoint."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Any, Literal

import msgspec

from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Calls, Effects, Fault, Frame, Life
from koordgen.runtime.trace import schema
from koordgen.runtime.trace.parts import TraceFileParts
from koordgen.runtime.trace.schema import FORMAT, LEFT_OUT

if TYPE_CHECKING:  # a real import would be a cycle: `monitored` imports this module
    from koordgen.runtime.trace.monitored import Change

STARTING = "starting"  # first phase of every trace


class RoundRecord(msgspec.Struct, frozen=True):
    """Record of one round for the trace and for monitors. Times are seconds of the robot's local clock."""

    round: int
    time: float
    late: float  # seconds from the start of the round until the robot chose its event
    sensors: Mapping[str, Any]
    frame: Frame | None  # input of the event; None if the round was skipped
    event: str | None = None
    effects: Effects | None = None
    skipped: str | None = None
    fault: Fault | None = None
    calls: Calls = ()
    restored: Life | None = None  # state with which the robot continued, if it rejoined before this round
    application: str = ""  # name of the application whose event it is; "" if the fleet has only one


Observe = Callable[[RoundRecord], None]


class Trace:
    """Writer of a robot's trace. Each record is written to `file` immediately; without a file nothing is written.

    `warn` is called with a message if the trace ends because of an error."""

    def __init__(self, file: IO[bytes] | TraceFileParts | None, warn: Callable[[str], None]) -> None:
        self._file = file
        self._warn = warn
        self._encoder = msgspec.json.Encoder(enc_hook=repr)
        self._applications: dict[str, _Recorded] = {}  # by the name in records; "": the only application
        # The fields below are written at the beginning of the next part.
        self._header: schema.RobotHeader | None = None
        self._part = 0
        self._phase = ""
        self._phases: dict[str, schema.Phase] = {}  # first record of each phase except STARTING
        self._view: schema.ViewRecord | None = None

    @property
    def open(self) -> bool:
        """True until the trace is closed or ended by an error."""
        return self._file is not None

    def header(self, fleet: FleetProgram, robot: str, pid: int, n_sys: int, delta: float) -> None:
        """Write the header of the trace. Call this before all other methods that write records."""
        for instance in fleet.of_robot(pid):
            application = fleet.applications[instance.application]
            slots = frozenset([v.name for v in application.own if v.kind == "allread"])
            key = application.name if fleet.is_composed else ""
            self._applications[key] = _Recorded(application.name, instance.pid, slots)
        names = tuple([application.name for application in fleet.applications])
        self._header = schema.RobotHeader(FORMAT, fleet.name, names, robot, pid, n_sys, delta, fleet.program_hash)
        self._write(self._header)

    def phase(self, time: float, phase: str, detail: str) -> None:
        record = schema.Phase(phase, detail, time, LEFT_OUT, LEFT_OUT)
        self._write_record(record, time)
        if phase != self._phase:
            self._phase = phase
            if phase != STARTING:
                self._phases[phase] = record

    def init(
        self, time: float, sensors: Mapping[str, Any], effects: Effects, after: Life, calls: Calls,
        application: str = "",
    ) -> None:  # fmt: skip
        """Write a record of `init`: its sensor values, its writes, and all private variables `after` it.

        application: the application whose `init` ran; "": the only one."""
        self._turn_if_full(time)
        of = self._of(application)
        of.shared, of.life, of.last = {}, after, 0
        self._write(
            schema.InitRecord(
                sensors=sensors,
                locals=after.locals,
                shared=effects.shared,
                actuators=after.actuators,
                violated=effects.violated or LEFT_OUT,
                stopped=after.stopped,
                calls=calls or LEFT_OUT,
                time=time,
                t=LEFT_OUT,
                pid=LEFT_OUT,
                application=of.name,
            )
        )

    def view(self, time: float, number: int, since: int, members: Sequence[int]) -> None:
        """Write the view that begins at round `since`. `members`: each robot's incarnation, -1 for a non-member."""
        record = schema.ViewRecord(number, since, tuple(members), time, LEFT_OUT, LEFT_OUT)
        self._write_record(record, time)
        self._view = record

    def log(self, time: float, level: str, message: str) -> None:
        self._write_record(schema.LogLine(level, message, time, LEFT_OUT, LEFT_OUT), time)

    def stall(self, time: float, state: Literal["begins", "goes on", "ends"], why: str, lasted: float) -> None:
        """Write that a stall of the vehicle begins, goes on or ends. `lasted`: seconds since the stall began."""
        self._write_record(schema.Stall(state, why, round(lasted, 3), time, LEFT_OUT, LEFT_OUT), time)

    def stream(self, time: float, round_: int, port: str, text: str, application: str = "") -> None:
        """Write a line of an application's output in a round; round 0 is `init`.

        Line and round are in the same part of the trace."""
        self._write(schema.StreamLine(port, text, round_, time, LEFT_OUT, LEFT_OUT, self._of(application).name))

    def metrics(self, time: float, snapshot: Mapping[str, Any]) -> None:
        """Write a snapshot of the quality of the robot's links and rounds."""
        self._write_record(schema.MetricsRecord(**snapshot, time=time, t=LEFT_OUT, pid=LEFT_OUT), time)

    def monitor(self, change: Change, application: str = "") -> None:
        """Write a change of the verdict of an application's property."""
        record = schema.Monitor(
            change.of, change.name, change.line, change.outcome, change.age, change.why, change.action, change.round,
            change.time, LEFT_OUT, LEFT_OUT, self._of(application).name,
        )  # fmt: skip
        self._write_record(record, change.time)

    def _of(self, application: str) -> _Recorded:
        """Return what was recorded of an application. An application without a header has no name in the records."""
        if application not in self._applications:
            self._applications[application] = _Recorded("", -1, ())
        return self._applications[application]

    def round(self, record: RoundRecord, clock_bound: float, counters: Mapping[str, int]) -> None:
        """Write one round of the robot.

        `clock_bound`: largest error of the robot's fleet time in seconds; inf: not known.
        `counters`: the counters that changed.
        `locals` of the record contains the local variables that the event wrote. `copy` of the record contains the
        changes of the robot's copy of the shared variables since the last record; for an allread variable pid -> value.
        """
        self._turn_if_full(record.time)
        of = self._of(record.application)
        fault, effects, restored = record.fault, record.effects, record.restored
        shared, actuators = (effects.shared, effects.actuators) if effects else ({}, {})
        violated, stopped = (effects.violated, effects.stopped) if effects else ((), False)
        # Arguments are passed by position, in the order of the schema: keyword arguments take five times as long.
        line = schema.Round(
            record.round, record.event, record.skipped,
            schema.EventFault(fault.file, fault.line, fault.reason) if fault else None,
            round(record.late, 6), record.sensors,
            _written(record) or LEFT_OUT, shared, actuators, of.changed(record) or LEFT_OUT,
            record.calls or LEFT_OUT, violated or LEFT_OUT, stopped or LEFT_OUT,
            _restored(restored) if restored else LEFT_OUT,
            round(clock_bound, 6) if clock_bound < math.inf else None, counters or LEFT_OUT,
            record.time, LEFT_OUT, LEFT_OUT, of.name,
        )  # fmt: skip
        self._write(line)
        of.live(record)

    def _turn_if_full(self, time: float) -> None:
        """Begin a new part of the trace if the current part is full.

        This is never called between the record of a round and the streams of that round."""
        parts = self._file
        if not isinstance(parts, TraceFileParts) or not parts.full:
            return
        try:
            parts.turn()
        except OSError as error:
            self._end(error)
            return
        self._part += 1
        if self._header is not None:
            self._write(msgspec.structs.replace(self._header, part=self._part))
        for record in self._phases.values():
            self._write(record)
        if self._view is not None:
            self._write(self._view)
        for of in self._applications.values():
            of.shared = {}
            own = _restored(of.life) if of.life is not None else LEFT_OUT
            self._write(schema.Checkpoint(of.last, own, time, LEFT_OUT, LEFT_OUT, of.name))
        parts.began()

    def close(self) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None

    def _write_record(self, record: msgspec.Struct, time: float) -> None:
        """Write a record for which a new part of the trace may be begun."""
        self._turn_if_full(time)
        self._write(record)

    def _write(self, record: msgspec.Struct) -> None:
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


def _restored(life: Life) -> schema.Restored:
    return schema.Restored(life.round, life.locals, life.actuators, life.stopped)


def _written(record: RoundRecord) -> dict[str, Any]:
    """Return the local variables that the event of a round wrote."""
    effects, frame = record.effects, record.frame
    if effects is None or frame is None:
        return {}
    return {name: value for name, value in effects.locals.items() if value is not frame.locals.get(name)}


class _Recorded:
    """Values of an application as the records of a trace give them.

    name, pid, slots: the application's name, this robot's pid in it, and its allread variables.
    shared: shared variables as the records of this part give them.
    life: private variables after the last recorded round; None: unknown.
    last: number of the last recorded round; 0: `init`; -1: none.
    """

    def __init__(self, name: str, pid: int, slots: Collection[str]) -> None:
        self.name, self._pid, self._slots = name, pid, slots
        self.shared: dict[str, Any] = {}
        self.life: Life | None = None
        self.last = -1

    def live(self, record: RoundRecord) -> None:
        """Update the private variables with the effects of a recorded round."""
        self.last, effects = record.round, record.effects
        life = self.life = record.restored or self.life
        if life is not None and effects is not None:
            actuators, stopped = {**life.actuators, **effects.actuators}, life.stopped or effects.stopped
            self.life = Life(record.round, effects.locals, actuators, stopped)

    def changed(self, record: RoundRecord) -> dict[str, Any]:
        """Return the shared variables that changed since the last record; a new object counts as a change.

        The robot's own slots are left out, because they are recorded with its events. Allwrite variables are included,
        because another robot may have written them."""
        found: dict[str, Any] = {}
        frame, told = record.frame, self.shared
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
                changed = {p: v for p, v in enumerate(value) if v is not before[p] and p != self._pid}
                if changed:
                    found[name] = changed
        return found
