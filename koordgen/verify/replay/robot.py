"""Replay of one robot's rounds: runs them on recorded inputs, and compares recorded outputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.ports import held
from koordgen.lang.ir.types import Type
from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import Instance, System
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes, declared
from koordgen.lang.semantics.state import Robot, State, Store, World
from koordgen.lang.semantics.step import Step, execute, has_priority, select
from koordgen.lang.semantics.system import initial_system, view
from koordgen.lang.semantics.values import Value
from koordgen.verify.replay.store import had_frame
from koordgen.verify.replay.trace import TraceLine
from koordgen.verify.replay.values import BadValue, from_trace, plain

# Reason of a discarded event that depends only on the robot's clock. No replay can check such a reason.
OVERRAN = "not finished by the round's publish deadline"


class Difference(NamedTuple):
    """Difference between trace and program.

    `number`: the line of the trace.
    `pid`: the robot, by its pid in the fleet.
    `application`: the application, if the fleet has several.
    `recorded`: the value in the trace.
    `computed`: the value that the semantics computes."""

    number: int
    round: int
    pid: int
    what: str
    recorded: Any
    computed: Any
    application: str = ""


class Unreplayable(Exception):
    """Raised if a trace cannot be replayed. `number` is the trace's line, `why` the reason."""

    def __init__(self, number: int, why: str) -> None:
        super().__init__(f"line {number}: {why}")
        self.number, self.why = number, why


@dataclass
class Counts:
    rounds: int = 0
    events: int = 0
    violated: int = 0  # number of events and `init`s in which the semantics finds a false loop invariant
    late: int = 0  # number of events that exceeded their time budget, which no replay can check


@dataclass
class Replay:
    """Replay of one instance: an application at work on one robot.

    `instance`: the application's index in the system, the robot's pid in the application, and the robot.
    `externs`: the extern functions, as in `World`.
    `followed`: "run" or "step" if the traced run executed a counterexample; otherwise empty. In such a run, a robot may
        run any enabled event or no event. For "step", the record of `init` contains the first state of the
        counterexample."""

    system: System
    instance: Instance
    externs: Mapping[str, Any]
    counts: Counts = field(default_factory=Counts)
    followed: str = ""

    def __post_init__(self) -> None:
        application = self.system.applications[self.instance.application]
        self.program, self.pid, self.n_sys = application.program, self.instance.pid, len(application.members)
        self._types: dict[str, Type] = declared(self.program)
        self._first = self._initial({})
        self._slots = {v.name for v in self.program.shared if v.kind == "allread"}
        self._own: dict[str, Value] = dict(self._first.robots[self.pid].locals)
        self._actuators: dict[str, Value] = {}
        self._store: dict[str, Any] = {}  # the robot's copy of the store; an allread variable maps pid -> value
        self._streams: list[tuple[str, str]] = []
        self._round = 0
        self._begun = False  # whether the values of the robot's own variables are known.
        # Copy of the shared store that the robot read according to its last record. An allread variable maps pid ->
        # value.
        self.saw: Mapping[str, Any] | None = None

    def _initial(self, sensors: Mapping[str, Value]) -> State:
        """Return the state before any `init`, as the application sees it. `sensors`: first values of this robot."""
        given = [sensors if robot == self.instance.robot else {} for robot in range(self.system.robots)]
        return view(self.system, initial_system(self.system, given), self.instance.application)

    def line(self, line: TraceLine) -> Iterator[Difference]:
        """Replay one record. Yield each difference between recorded and computed values. Raises Unreplayable."""
        self.saw = None
        record = line.record
        try:
            match record["kind"]:
                case "init":
                    yield from self._init(line, record)
                case "checkpoint":
                    yield from self._checkpoint(line, record)
                case "round":
                    yield from self.end(line.number)
                    self._round = int(record["round"])
                    yield from self._replay_round(line, record)
                case _:
                    yield from self._stream(line, record)
        except (BadValue, LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
            reason = str(error) if isinstance(error, BadValue) else f"a broken record: {error!r}"
            raise Unreplayable(line.number, reason) from None

    def end(self, number: int) -> Iterator[Difference]:
        """Yield the differences at the end of the last round.

        The differences are stream outputs of the program that the trace does not contain."""
        for port, text in self._streams:
            yield Difference(number, self._round, self.pid, port, None, text)
        self._streams = []

    def skip(self) -> None:
        """Prepare for a gap in the records. The robot's own variables are not compared in the next record."""
        self._begun, self._streams = False, []

    def _checkpoint(self, line: TraceLine, record: dict[str, Any]) -> Iterator[Difference]:
        """Continue with the next part of a trace, which begins with the values of the robot's own variables.

        If the previous part was replayed to its end, these values must equal the last values in the previous part."""
        self._store = {}
        if self._begun and record["round"] != self._round:
            self.skip()
        self._round = int(record["round"])
        own = record.get("own")
        if own is None:
            return
        for group, known in (("locals", self._own), ("actuators", self._actuators)):
            recorded = own.get(group, {})
            for name in {**known, **recorded}:
                computed = plain(known[name]) if name in known else None
                if name in known and recorded.get(name) == computed:
                    continue  # keep the computed value: null in a trace denotes any number that is not finite
                if self._begun:
                    yield Difference(line.number, self._round, self.pid, name, recorded.get(name), computed)
                known.update(self._values({name: recorded[name]} if name in recorded else {}))
        self._begun = True

    def _init(self, line: TraceLine, record: dict[str, Any]) -> Iterator[Difference]:
        self._round, self._store, self._begun = 0, {}, True
        if self.followed != "step":
            yield from self._ran_init(line, record)
        self._own = self._values(record["locals"])
        self._actuators = self._values(record["actuators"])

    def _ran_init(self, line: TraceLine, record: dict[str, Any]) -> Iterator[Difference]:
        given = {**self._unset(record), **self._values(record["sensors"])}
        state = self._initial(given)
        actuators = {n: v for n, v in state.robots[self.pid].ports.items() if n not in record["sensors"]}
        done = execute(self.program, self.program.init, state, self.pid, self._world(record))
        if isinstance(done, Discarded):
            yield Difference(line.number, 0, self.pid, "init", "it ran", f"init is discarded: {done}")
        else:
            computed = {"locals": done.locals, "shared": {**done.slots, **done.cells}, "stopped": done.stopped}
            yield from self._compared(line, record, {**computed, "actuators": {**actuators, **done.ports}})
            yield from self._loops(line, record, done)
            self._streams = list(done.streams)

    def _unset(self, record: dict[str, Any]) -> dict[str, Value]:
        """Return the actuators without a command whose value is that of a sensor that the program does not declare."""
        hidden = [n for n, s in held(self.program).items() if n in record["actuators"] and s not in record["sensors"]]
        return {name: from_trace(record["actuators"][name], self._types[name]) for name in hidden}

    def _replay_round(self, line: TraceLine, record: dict[str, Any]) -> Iterator[Difference]:
        self.counts.rounds += 1
        restored = record.get("restored")
        if restored is not None:
            self._begun = True
            self._own, self._actuators = self._values(restored["locals"]), self._values(restored["actuators"])
        event, fault = record.get("event"), record.get("fault")
        if not had_frame(record):
            return
        self._learn(record.get("copy", {}))
        self.saw = {name: dict(held) if name in self._slots else held for name, held in self._store.items()}
        state = self._state(line, record)
        chosen = self._chosen(state, record)
        if fault is not None:
            yield from self._fault(line, event, fault, chosen, state, record)
            return
        computed = (
            None if chosen is None else chosen.name if isinstance(chosen, decl.Event) else f"{chosen.event} discarded"
        )
        if event != computed:
            yield Difference(line.number, self._round, self.pid, "the event", event, computed)
        elif isinstance(chosen, decl.Event):
            self.counts.events += 1
            yield from self._event(
                line, record, execute(self.program, chosen.effect, state, self.pid, self._world(record))
            )
        self._own |= self._values(record.get("locals", {}))
        self._actuators |= self._values(record.get("actuators", {}))
        for name, value in record.get("shared", {}).items():
            written = from_trace(value, self._types[name])
            # `copy` has no own slots. An allwrite variable is in `copy` if it differs from the last copy, whatever this
            # instance wrote: another write of the same round may have restored the old value.
            if name in self._slots:
                self._store[name][self.pid] = written

    def _chosen(self, state: State, record: dict[str, Any]) -> decl.Event | Step | None:
        """Return the event that the robot must have chosen; None if no event was possible.

        If a guard without a value discards the step, return the discarded step."""
        world, name = self._world(record), record.get("event")
        if not self.followed:
            return select(self.program, state, self.pid, world)
        if name is None and record.get("fault") is None:
            return None
        named = [event for event in self.program.events if name is None or event.name == name]
        tried = (event for event in named if has_priority(self.program, event, state, self.pid, world))
        found = (select(replace(self.program, events=(event,)), state, self.pid, world) for event in tried)
        return next((each for each in found if isinstance(each, Step) is (name is None) and each is not None), None)

    def _event(self, line: TraceLine, record: dict[str, Any], done: Writes | Discarded) -> Iterator[Difference]:
        if isinstance(done, Discarded):
            yield Difference(
                line.number, self._round, self.pid, f"event {record['event']}", "it counted", f"discarded: {done}"
            )
            return
        # The record omits a local variable if the event wrote the variable's old value again.
        recorded = {**{name: plain(value) for name, value in self._own.items()}, **record.get("locals", {})}
        computed = {"locals": done.locals, "shared": {**done.slots, **done.cells}, "actuators": done.ports}
        yield from self._compared(line, {**record, "locals": recorded}, {**computed, "stopped": done.stopped})
        yield from self._loops(line, record, done)
        self._streams = list(done.streams)
        # Keep the computed value, because null in a trace denotes any number that is not finite.
        for name, value in done.locals.items():
            if plain(value) == recorded[name]:
                self._own[name] = value

    def _loops(self, line: TraceLine, record: dict[str, Any], done: Writes) -> Iterator[Difference]:
        """Compare the recorded lines of false loop invariants with the semantics."""
        recorded, computed = record.get("violated", []), [span.line for span in done.violated]
        self.counts.violated += bool(computed)
        if recorded != computed:
            yield Difference(
                line.number, self._round, self.pid, "the list of false loop invariants", recorded, computed
            )

    def _fault(
        self, line: TraceLine, event: str | None, fault: dict[str, Any], chosen: decl.Event | Step | None, state: State,
        record: dict[str, Any],
    ) -> Iterator[Difference]:  # fmt: skip
        """Check that a discarded event has no value by the semantics.

        An event that was discarded because it was late is not checked, because only the robot's clock decides
        lateness."""
        if fault.get("reason") == OVERRAN:
            self.counts.late += 1
            return
        done: Any = chosen.outcome if isinstance(chosen, Step) else chosen
        if isinstance(chosen, decl.Event):
            done = execute(self.program, chosen.effect, state, self.pid, self._world(record))
        recorded = f"discarded at line {fault.get('line')}: {fault.get('reason')}"
        name = chosen.name if isinstance(chosen, decl.Event) else None
        if not isinstance(done, Discarded):
            yield Difference(line.number, self._round, self.pid, f"event {event or name}", recorded, "it counts")
        elif event != name or done.span.line != fault.get("line"):
            yield Difference(
                line.number, self._round, self.pid, f"event {event}", recorded, f"{name} discarded at {done}"
            )

    def _stream(self, line: TraceLine, record: dict[str, Any]) -> Iterator[Difference]:
        recorded = (str(record["port"]), str(record["text"]))
        computed = self._streams.pop(0) if self._streams else None
        if recorded != computed:
            yield Difference(
                line.number, int(record["round"]), self.pid, recorded[0], recorded[1], computed and computed[1]
            )

    def _compared(self, line: TraceLine, record: dict[str, Any], computed: Mapping[str, Any]) -> Iterator[Difference]:
        for group, values in computed.items():
            recorded = record.get(group, False if group == "stopped" else {})
            if group == "stopped":
                if bool(recorded) != values:
                    yield Difference(line.number, self._round, self.pid, "stop", bool(recorded), values)
                continue
            for name in [*values, *[n for n in recorded if n not in values]]:
                wanted = plain(values[name]) if name in values else None
                if name not in recorded or name not in values or recorded[name] != wanted:
                    yield Difference(line.number, self._round, self.pid, name, recorded.get(name), wanted)

    def _learn(self, copy: dict[str, Any]) -> None:
        for name, value in copy.items():
            if name in self._slots:
                slots = self._store.setdefault(name, {})
                slots.update({int(pid): from_trace(own, self._types[name]) for pid, own in value.items()})
            else:
                self._store[name] = from_trace(value, self._types[name])

    def _state(self, line: TraceLine, record: dict[str, Any]) -> State:
        """Return the state that the robot read in the round.

        The other robots' own variables are unknown, but no event reads these variables."""
        for shared in self.program.shared:
            known = self._store.get(shared.name)
            if known is None or (shared.kind == "allread" and len(known) < self.n_sys):
                raise Unreplayable(line.number, f"the value of {shared.name} is not recorded (an older trace?)")
        slots = {n: tuple([self._store[n][p] for p in range(self.n_sys)]) for n in self._slots}
        cells = {name: value for name, value in self._store.items() if name not in self._slots}
        own = Robot(self._own, {**self._actuators, **self._values(record["sensors"])}, False)
        robots = tuple([own if p == self.pid else r for p, r in enumerate(self._first.robots)])
        return State(self._first.params, robots, Store(slots, cells), self._round)

    def _world(self, record: dict[str, Any]) -> World:
        """Return a world in which callable ports give the recorded answers. Calls without a record fail."""
        calls = [(port, args, answer) for port, args, answer in record.get("calls", [])]

        def answer(pid: int, port: str, args: tuple[Value, ...]) -> Value:
            given = [plain(arg) for arg in args]
            for k, (name, asked, found) in enumerate(calls):
                if name == port and asked == given:
                    if any((n, a) == (port, asked) for n, a, _ in calls[k + 1 :]):
                        # Another recorded call has the same arguments and perhaps another answer. So each answer is
                        # used only once.
                        del calls[k]
                    return from_trace(found, self._types[port])
            raise LookupError(f"no recorded call of {port} has these arguments")

        return World(self.externs, answer)

    def _values(self, recorded: Mapping[str, Any]) -> dict[str, Value]:
        return {name: from_trace(value, self._types[name]) for name, value in recorded.items()}
