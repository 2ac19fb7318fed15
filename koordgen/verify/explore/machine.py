"""Transition function of one program: runs the generated code of robots on packed states of a fleet.

A packed state of a fleet of N robots is a flat tuple of 2 N + 1 ints:

- one int for each robot's private state: locals, ports, and whether the robot has stopped;
- one int for each robot's slots of the allread variables;
- one int for the allwrite variables.

Each int is an index into a table of values (`Interned`), and equal values have equal ints. 0.0 and -0.0 count as
different values, since a program can distinguish them. The number of the round is left out, since no event can read it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, NamedTuple, TypeVar

from koordgen.build.emit.names import Names
from koordgen.build.emit.program import functions_module, program_text
from koordgen.build.emit.types import with_floats
from koordgen.lang.ir import decl
from koordgen.lang.ir.ports import clearable, clears
from koordgen.lang.semantics.exec import declared
from koordgen.lang.semantics.state import Robot, State, Store
from koordgen.lang.semantics.step import initial
from koordgen.runtime.program import program as rt
from koordgen.verify.replay.functions import CannotCall, load, python_value, semantic_value

T = TypeVar("T")
Packed = tuple[int, ...]
# function that answers calls of ports: ("Module.port", arguments of the call) -> answer
Call = Callable[[str, tuple[Any, ...]], Any]
# function that returns all possible answers: (pid, the robot's sensors, "Module.port", arguments) -> answers
Answer = Callable[[int, Mapping[str, Any], str, tuple[Any, ...]], tuple[Any, ...]]
_numbers = count()


class PrivateState(NamedTuple):
    """Private state of one robot. Ports are named "Module.port".

    `unset`: sensors that stay true until the first command sets them to false."""

    locals: Mapping[str, Any]
    sensors: Mapping[str, Any]
    actuators: Mapping[str, Any]
    stopped: bool
    unset: frozenset[str] = frozenset()


class RobotStep(NamedTuple):
    """One possible step of a robot: an event and its results, as indices into tables of `Machine`.

    `event`: index of the event in the program.
    `own`: the private state of the robot after the event.
    `slots`: the robot's slots after the event.
    `cells`: the event's writes to allwrite variables."""

    event: int
    own: int
    slots: int
    cells: int


class DiscardedEvent(NamedTuple):
    """An event that was discarded, or an event in which a loop invariant was false.

    `event`: index of the event; -1 for `init`.
    `own`: number of the robot's private state before the event.
    `seen`: the shared variables that the event read, as in a packed state: slots of all robots, allwrite variables.
    `line`: line of the fault or of the loop invariant.
    `choice`: step of the event with the false loop invariant; None for a discarded event."""

    pid: int
    event: int
    own: int
    seen: Packed
    line: int
    reason: str
    choice: RobotStep | None = None


class AnswerEnumeration:
    """Enumeration of the answers that callable ports can give to one event.

    The event runs once for each combination of answers. Within one run, equal calls get equal answers."""

    def __init__(self, answers: Callable[[str, tuple[Any, ...]], tuple[Any, ...]]) -> None:
        self._answers = answers
        self._raised: Exception | None = None

    def runs(self) -> Iterator[None]:
        """Yield once for each combination of answers. After each yield, the caller runs the event.

        An exception of the function that computes possible answers is raised again here. Without that, the exception
        would count as a fault of the event."""
        self._pending: list[tuple[int, ...]] = [()]
        while self._pending:
            self._script = self._pending.pop()
            self._given: dict[Hashable, Any] = {}
            yield
            if self._raised is not None:
                raise self._raised

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        key = (port, repr(args))
        if key not in self._given:
            place = len(self._given)
            try:
                options = self._answers(port, args)
            except Exception as error:
                self._raised = error
                raise
            if place == len(self._script):
                self._pending += [(*self._script, other) for other in range(1, len(options))]
                self._script = (*self._script, 0)
            self._given[key] = options[self._script[place]]
        return self._given[key]


class Interned(Generic[T]):
    """Table that numbers values. Values with equal keys get the same number."""

    def __init__(self) -> None:
        self.values: list[T] = []
        self._numbers: dict[Hashable, int] = {}

    def number(self, key: Hashable, value: T) -> int:
        found = self._numbers.setdefault(key, len(self.values))
        if found == len(self.values):
            self.values.append(value)
        return found


class Machine:
    """Transitions of one program in a fleet of `n_sys` robots.

    `functions`: the user's file with the extern functions of the program. Raises CannotCall if the program has extern
        functions and the file cannot be loaded.
    `discards`: the events that were discarded, or in which a loop invariant was false, in order.
    `enabled`: indices of the events that had a result at least once."""

    def __init__(self, program: decl.Program, n_sys: int, answer: Answer, functions: Path | None = None) -> None:
        self.program, self.n_sys, self.answer = program, n_sys, answer
        self.names = Names(program)
        self.scope = _compiled(program, functions)
        self.code: rt.Program = self.scope["PROGRAM"]
        ports = [(f"{m.name}.{p.name}", p) for m in program.modules for p in m.ports]
        self.types = declared(program)
        self.sensors = tuple(name for name, port in ports if port.direction == "sensor")
        self.actuators = tuple(name for name, port in ports if port.direction == "actuator")
        self.unset, self._clears = clearable(program), clears(program)
        self.allread = tuple(v.name for v in program.shared if v.kind == "allread")
        self.allwrite = tuple(v.name for v in program.shared if v.kind == "allwrite")
        self.owns: Interned[PrivateState] = Interned()
        self.slots: Interned[tuple[Any, ...]] = Interned()
        self.cells: Interned[tuple[Any, ...]] = Interned()
        self.writes: Interned[Mapping[str, Any]] = Interned()
        self.nothing = self.writes.number((), {})
        self._written: dict[tuple[int, int], int] = {}
        self.params = initial(program, 1).params
        self.discards: list[DiscardedEvent] = []
        self.enabled: set[int] = set()
        # class of the object that holds the values of all variables while an event runs
        self.begin: type[rt.Transaction] = self.code.begin
        place = {event.name: index for index, event in enumerate(program.events)}
        self.earlier = [tuple([place[e.name] for e in program.earlier(event)]) for event in program.events]
        self._look: rt.Transaction | None = None
        self.sensor_attributes = {f"{m}.{port}": self.names.ports[m, port] for m, port in self.names.sensors}

    def prior(self, events: Sequence[int], pid: int, own: int, begun: Packed) -> tuple[int, ...]:
        """Return the events in `events` that the `priority:` blocks of the program allow a robot to run.

        An event in a block is allowed if all earlier guards of the block are false at the start of the round. A guard
        without a value does not count as false. `begun`: the shared variables at the start of the round.
        """
        robot = self.owns.values[own]
        held = {earlier: self._may_hold(earlier, pid, robot, begun) for e in events for earlier in self.earlier[e]}
        return tuple([event for event in events if not any(held[earlier] for earlier in self.earlier[event])])

    def first(self, pid: int, own: int, begun: Packed) -> int | None:
        """Return the index of the event that an agent runs; None if the agent runs no event.

        An agent runs the first event of the program whose guard is true or has no value."""
        robot = self.owns.values[own]
        if robot.stopped:
            return None
        return next((e for e in range(len(self.code.events)) if self._may_hold(e, pid, robot, begun)), None)

    def _may_hold(self, event: int, pid: int, robot: PrivateState, begun: Packed) -> bool:
        """Return whether the guard of an event is true or has no value."""
        try:
            return self.code.events[event].guard(self._looking(pid, robot, begun, rt.no_ports))
        except Exception:  # a guard that raises an exception has no value
            return True

    def choices(self, events: Sequence[int], pid: int, own: int, seen: Packed) -> tuple[RobotStep, ...]:
        """Return the possible steps of a robot whose events read the shared variables `seen`.

        Each event whose guard is true makes one step for each combination of answers of callable ports. Discarded
        events make no step, and are recorded in `discards`. `prior` must allow all `events`."""
        robot = self.owns.values[own]
        if robot.stopped:
            return ()
        asking = self._asking(pid, robot)
        looking = self._looking(pid, robot, seen, asking.call)
        found: dict[RobotStep, None] = {}
        for index in events:
            for _ in asking.runs():
                done = self._run(self.code.events[index], looking, lambda: self.frame(pid, robot, seen, asking.call))
                if isinstance(done, rt.Fault):
                    self.discards.append(DiscardedEvent(pid, index, own, seen, done.line, done.reason))
                elif isinstance(done, rt.Effects):
                    self.enabled.add(index)
                    found[self._noted(index, pid, own, seen, done)] = None
        return tuple(found)

    def _asking(self, pid: int, robot: PrivateState) -> AnswerEnumeration:
        return AnswerEnumeration(lambda port, args: self.answer(pid, robot.sensors, port, args))

    def _run(self, event: rt.Event, looking: Any, frame: Callable[[], rt.Frame]) -> rt.Effects | rt.Fault | None:
        """Run an event, and return its effects or its fault; None if the guard of the event is false."""
        try:
            if not rt.enabled(event, looking):
                return None
            return rt.run(self.code, event.effect, self.begin(frame()), event.line)
        # The guard raised an exception. Run the guard as if it were an effect, to turn the exception into a fault.
        except Exception:
            return rt.run(self.code, event.guard, self.begin(frame()), event.line)  # type: ignore[arg-type]

    def after_init(self, fleet: Packed) -> list[Packed]:
        """Return all states of the fleet that are possible after every robot has run `init`.

        Each robot's `init` reads the shared variables as they were before the first `init`."""
        if self.code.init is None:
            return [fleet]
        found, seen = [fleet], fleet[self.n_sys :]
        for pid in range(self.n_sys):
            choices = self.init_choices(pid, fleet[pid], seen)
            found = [self.applied(after, pid, choice) for after in found for choice in choices]
        return found

    def init_choices(self, pid: int, own: int, seen: Packed) -> tuple[RobotStep, ...]:
        """Return the possible steps of a robot that runs `init` and reads the shared variables `seen`.

        Without an `init`, returns no step. A discarded `init` makes no step, and is recorded in `discards`."""
        init, robot = self.code.init, self.owns.values[own]
        if init is None:
            return ()
        asking = self._asking(pid, robot)
        frame = self.frame(pid, robot, seen, asking.call)
        made: dict[RobotStep, None] = {}
        for _ in asking.runs():
            done = rt.run(self.code, init, self.code.begin(frame))
            if isinstance(done, rt.Fault):
                self.discards.append(DiscardedEvent(pid, -1, own, seen, done.line, done.reason))
            else:
                made[self._noted(-1, pid, own, seen, done)] = None
        return tuple(made)

    def applied(self, fleet: Packed, pid: int, choice: RobotStep) -> Packed:
        """Return the state of the fleet after the step `choice` of robot `pid`."""
        made = list(fleet)
        made[pid], made[self.n_sys + pid] = choice.own, choice.slots
        if choice.cells != self.nothing:
            made[-1] = self.written(fleet[-1], choice.cells)
        return tuple(made)

    def watch(self, cells: Mapping[str, type[rt.Cell[Any]]]) -> None:
        """Use special cell classes for some local variables in all later runs of events.

        A cell is the object that holds the value of a variable while an event runs.
        `cells`: name of the variable -> cell class."""
        self.begin = watching(self.code.begin, cells) if cells else self.code.begin
        self._look = None

    def _looking(self, pid: int, robot: PrivateState, seen: Packed, call: Call) -> Any:
        """Return the transaction on which guards are evaluated.

        A guard writes nothing, so all guards use the same transaction object. Only values that changed since the last
        guard are stored in the object."""
        if self._look is None:
            self._look, self._looked = self.begin(self.frame(pid, robot, seen)), (robot, seen)
        look: Any = self._look
        known, store = self._looked
        self._looked = robot, seen
        if store is not seen or look.pid != pid:
            columns = zip(*[self.slots.values[number] for number in seen[:-1]], strict=True)
            for name, column in zip(self.allread, columns, strict=False):
                look.written[name].show(column, pid)
        if store is not seen:
            for name, value in zip(self.allwrite, self.cells.values[seen[-1]], strict=True):
                look.written[name].show(value)
        if known is not robot:
            for name, value in robot.locals.items():
                look.written[name].show(value)
            for name, value in robot.actuators.items():
                look.written[name].show(value)
            for name, value in robot.sensors.items():
                setattr(look, self.sensor_attributes[name], value)
        look.pid, look.call = pid, call
        return look

    def frame(self, pid: int, robot: PrivateState, seen: Packed, call: Call = rt.no_ports) -> rt.Frame:
        """Return the values that an event of robot `pid` can read."""
        columns = zip(*[self.slots.values[number] for number in seen[:-1]], strict=True)
        shared = dict(zip(self.allread, columns, strict=True)) if self.allread else {}
        shared |= dict(zip(self.allwrite, self.cells.values[seen[-1]], strict=True))
        return rt.Frame(pid, self.n_sys, robot.locals, shared, robot.sensors, robot.actuators, call)

    def own(self, robot: PrivateState) -> int:
        """Return the number of a private state. A new private state is added to the table `owns`."""
        own = tuple([self.key(v.name, robot.locals[v.name]) for v in self.program.locals])
        return self.owns.number((own, self.ports_key(robot), robot.stopped), robot)

    def ports_key(self, robot: PrivateState) -> Hashable:
        """Return a hashable key for the values of a robot's ports. Different values have different keys."""
        sensors = [self.key(name, robot.sensors[name]) for name in self.sensors]
        return (*sensors, *[self.key(name, robot.actuators[name]) for name in self.actuators], robot.unset)

    def packed(self, state: State) -> Packed:
        """Pack a state of the executable semantics in which no robot has given a command yet."""
        robots = [self.own(self._own(robot)) for robot in state.robots]
        slots = [
            self._slots(tuple([self.taken(name, state.store.slots[name][pid]) for name in self.allread]))
            for pid in range(self.n_sys)
        ]
        cells = tuple([self.taken(name, state.store.cells[name]) for name in self.allwrite])
        return (*robots, *slots, self._cell_number(cells))

    def state(self, fleet: Packed, number: int = 1) -> State:
        """Unpack a packed state to a state of the executable semantics, at the start of round `number`."""
        robots = []
        for own in fleet[: self.n_sys]:
            held = self.owns.values[own]
            ports = self._meant({**held.sensors, **held.actuators})
            robots.append(Robot(self._meant(held.locals), ports, held.stopped))
        columns = zip(*[self.slots.values[n] for n in fleet[self.n_sys : -1]], strict=True)
        slots = {
            name: tuple([semantic_value(value, self.types[name]) for value in column])
            for name, column in zip(self.allread, columns, strict=False)
        }
        cells = dict(zip(self.allwrite, self.cells.values[fleet[-1]], strict=True))
        return State(self.params, tuple(robots), Store(slots, self._meant(cells)), number)

    def _noted(self, index: int, pid: int, own: int, seen: Packed, done: rt.Effects) -> RobotStep:
        """Return the step that an event with the effects `done` makes.

        If a loop invariant was false in the event, the event is also added to `discards`."""
        choice = self._choice(index, pid, self.owns.values[own], seen, done)
        for line in done.violated[:1]:
            reason = f"the loop invariant on line {line} is false or has no value"
            self.discards.append(DiscardedEvent(pid, index, own, seen, line, reason, choice))
        return choice

    def _choice(self, index: int, pid: int, robot: PrivateState, seen: Packed, done: rt.Effects) -> RobotStep:
        cleared = {sensor: False for name in done.actuators for sensor in self._clears.get(name, ())}
        sensors = {**robot.sensors, **cleared} if cleared else robot.sensors
        actuators = {**robot.actuators, **done.actuators} if done.actuators else robot.actuators
        own = self.own(PrivateState(done.locals, sensors, actuators, done.stopped, robot.unset.difference(cleared)))
        slots = seen[pid]
        if any(name in done.shared for name in self.allread):
            held = zip(self.allread, self.slots.values[slots], strict=True)
            slots = self._slots(tuple([done.shared.get(name, value) for name, value in held]))
        cells = {name: done.shared[name] for name in self.allwrite if name in done.shared}
        return RobotStep(index, own, slots, self.cell_writes(cells))

    def cell_writes(self, values: Mapping[str, Any]) -> int:
        """Return the number of writes to allwrite variables: name -> value."""
        return self.writes.number(tuple([(name, self.key(name, value)) for name, value in values.items()]), values)

    def written(self, before: int, writes: int) -> int:
        """Return the number of the allwrite variables `before` after the writes `writes`, also a number."""
        found = self._written.get((before, writes))
        if found is None:
            new = self.writes.values[writes]
            held = zip(self.allwrite, self.cells.values[before], strict=True)
            found = self._cell_number(tuple([new.get(name, value) for name, value in held]))
            self._written[before, writes] = found
        return found

    def _cell_number(self, values: tuple[Any, ...]) -> int:
        return self.cells.number(tuple(map(self.key, self.allwrite, values)), values)

    def _slots(self, values: tuple[Any, ...]) -> int:
        return self.slots.number(tuple(map(self.key, self.allread, values)), values)

    def key(self, name: str, value: Any) -> Hashable:
        """Return a hashable key for the value of a variable.

        The key of a value with floats is its text, because 0.0 and -0.0 are equal in Python but differ in a program."""
        key: Hashable = repr(value) if with_floats(self.types[name]) else value
        return key

    def _own(self, robot: Robot) -> PrivateState:
        ports = {name: self.taken(name, value) for name, value in robot.ports.items()}
        locals_ = {name: self.taken(name, value) for name, value in robot.locals.items()}
        sensors = {name: ports[name] for name in self.sensors}
        return PrivateState(locals_, sensors, {name: ports[name] for name in self.actuators}, robot.stopped, self.unset)

    def taken(self, name: str, value: Any) -> Any:
        """Return a value of the semantics in the form in which the generated code has it."""
        return python_value(value, self.types[name], self.scope, self.names)

    def _meant(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {name: semantic_value(value, self.types[name]) for name, value in values.items()}


def watching(begin: type[rt.Transaction], cells: Mapping[str, type[rt.Cell[Any]]]) -> type[rt.Transaction]:
    """Return a subclass of `begin` that uses special cell classes for some local variables."""

    class Watching(begin):  # type: ignore[misc,valid-type]
        def local(self, name: str) -> rt.Cell[Any]:
            cell: rt.Cell[Any] = super().local(name)
            if name in cells:
                cell = self.written[name] = cells[name](cell.value)
            return cell

    return Watching


def _compiled(program: decl.Program, functions: Path | None) -> dict[str, Any]:
    if program.externs:
        if functions is None or not functions.is_file():
            missing = functions or f"{functions_module(program)}.py"
            raise CannotCall(f"{missing}, the file with the extern functions, does not exist")
        load(program, functions)
    name = f"explored{next(_numbers)}"
    module = sys.modules[name] = ModuleType(name)  # Python looks up the annotations of record classes in this module
    scope: dict[str, Any] = vars(module)
    scope["__file__"] = "program.py"
    exec(compile(program_text(program), "program.py", "exec"), scope)
    if program.externs:
        scope["LIBRARY"].load()
    return scope
