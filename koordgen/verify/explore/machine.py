"""Transition function of one program: runs the robots' generated code on packed fleets.

A packed fleet of N robots is a flat tuple of 2 N + 1 small ints:

- one int for each robot's private state: locals, ports, and whether the robot has stopped;
- one int for each robot's slots of the allread variables;
- one int for the allwrite variables.

Equal ints denote equal values. Floats are distinguished by all their bits. The number of the round is left out, since
no event can read it. The results of transitions are memoised.
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
# Call: arguments "Module.port" and the call's arguments; result: the answer.
# Answer: arguments pid, the robot's sensors, "Module.port" and the call's arguments; result: all possible answers.
Call = Callable[[str, tuple[Any, ...]], Any]
# pid, its sensors, "Module.port", arguments -> all possible answers
Answer = Callable[[int, Mapping[str, Any], str, tuple[Any, ...]], tuple[Any, ...]]
_numbers = count()


class PrivateState(NamedTuple):
    """Private state of one robot. Ports are named "Module.port".

    `unset`: sensors that commands clear, but that no command has cleared yet. Such sensors are true."""

    locals: Mapping[str, Any]
    sensors: Mapping[str, Any]
    actuators: Mapping[str, Any]
    stopped: bool
    unset: frozenset[str] = frozenset()


class RobotStep(NamedTuple):
    """One possible step of a robot.

    `event`: index of the event.
    `own`: number of the private state after the event.
    `slots`: number of the robot's slots after the event.
    `cells`: number of the event's writes to allwrite variables."""

    event: int
    own: int
    slots: int
    cells: int


class DiscardedEvent(NamedTuple):
    """An event that was discarded, or an event in which a loop invariant was false.

    `event`: index of the event; -1 for `init`.
    `seen`: the store that the event read: slots and allwrite variables of a packed fleet.
    `line`: line of the fault or of the loop invariant.
    `choice`: the step of an event with a false loop invariant; None for a discarded event."""

    pid: int
    event: int
    own: int
    seen: Packed
    line: int
    reason: str
    choice: RobotStep | None = None


class AnswerEnumeration:
    """Runs one event repeatedly, once for each combination of answers of callable ports.

    Within a run, equal calls get equal answers."""

    def __init__(self, answers: Callable[[str, tuple[Any, ...]], tuple[Any, ...]]) -> None:
        self._answers = answers
        self._raised: Exception | None = None

    def runs(self) -> Iterator[None]:
        """Yield once per combination of answers. After each yield, the caller runs the event.

        If computing the possible answers raised an exception, it is raised again here. Otherwise the run would report
        it as a fault of the event."""
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
    """Table that gives each value a number. Values with equal keys have the same number."""

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

    If the program has extern functions, the user's file with these functions is loaded. Raises CannotCall if that
    fails.

    `discards`: all discarded events so far.
    `enabled`: indices of the events that had a result so far."""

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
        self.begin: type[rt.Transaction] = self.code.begin  # class of the transactions in which events run
        place = {event.name: index for index, event in enumerate(program.events)}
        self.earlier = [tuple([place[e.name] for e in program.earlier(event)]) for event in program.events]
        self._look: rt.Transaction | None = None
        self.sensor_attributes = {f"{m}.{port}": self.names.ports[m, port] for m, port in self.names.sensors}

    def prior(self, events: Sequence[int], pid: int, own: int, begun: Packed) -> tuple[int, ...]:
        """Return those of `events` that a robot may run by the rules of `priority:` blocks.

        For such an event, every earlier guard of its block has a value and is false on the store at the round's start.
        """
        robot = self.owns.values[own]
        held = {earlier: self._may_hold(earlier, pid, robot, begun) for e in events for earlier in self.earlier[e]}
        return tuple([event for event in events if not any(held[earlier] for earlier in self.earlier[event])])

    def first(self, pid: int, own: int, begun: Packed) -> int | None:
        """Return the event that an agent runs: the first in text order whose guard holds or has no value."""
        robot = self.owns.values[own]
        if robot.stopped:
            return None
        return next((e for e in range(len(self.code.events)) if self._may_hold(e, pid, robot, begun)), None)

    def _may_hold(self, event: int, pid: int, robot: PrivateState, begun: Packed) -> bool:
        """Return whether the guard of an event holds or has no value."""
        try:
            return self.code.events[event].guard(self._looking(pid, robot, begun, rt.no_ports))
        except Exception:  # evaluating the guard failed, so it has no value
            return True

    def choices(self, events: Sequence[int], pid: int, own: int, seen: Packed) -> tuple[RobotStep, ...]:
        """Return the possible steps of a robot that reads the store `seen`.

        There is one step for each event whose guard holds, and for each combination of answers. Discarded events are
        recorded in `discards` instead. All `events` must have priority (see `prior`)."""
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
        """Run an event. Returns None if the event's guard does not hold."""
        try:
            if not rt.enabled(event, looking):
                return None
            return rt.run(self.code, event.effect, self.begin(frame()), event.line)
        # The guard raised an exception. Run it again as an effect, so that its fault is reported like one of an effect.
        except Exception:
            return rt.run(self.code, event.guard, self.begin(frame()), event.line)  # type: ignore[arg-type]

    def after_init(self, fleet: Packed) -> list[Packed]:
        """Return all possible fleets after every robot has run `init`.

        Each `init` reads the store as it was before any `init`."""
        init = self.code.init
        if init is None:
            return [fleet]
        found, seen = [fleet], fleet[self.n_sys :]
        for pid in range(self.n_sys):
            robot = self.owns.values[fleet[pid]]
            asking = self._asking(pid, robot)
            frame = self.frame(pid, robot, seen, asking.call)
            made: dict[RobotStep, None] = {}
            for _ in asking.runs():
                done = rt.run(self.code, init, self.code.begin(frame))
                if isinstance(done, rt.Fault):
                    self.discards.append(DiscardedEvent(pid, -1, fleet[pid], seen, done.line, done.reason))
                else:
                    made[self._noted(-1, pid, fleet[pid], seen, done)] = None
            found = [self.applied(after, pid, choice) for after in found for choice in made]
        return found

    def applied(self, fleet: Packed, pid: int, choice: RobotStep) -> Packed:
        """Return the fleet after one robot's event, with all its writes."""
        made = list(fleet)
        made[pid], made[self.n_sys + pid] = choice.own, choice.slots
        if choice.cells != self.nothing:
            made[-1] = self._cells(fleet[-1], choice.cells)
        return tuple(made)

    def watch(self, cells: Mapping[str, type[rt.Cell[Any]]]) -> None:
        """Use these classes for the cells of locals in all later runs.

        A cell holds the value of one variable in a transaction."""
        self.begin = watching(self.code.begin, cells) if cells else self.code.begin
        self._look = None

    def _looking(self, pid: int, robot: PrivateState, seen: Packed, call: Call) -> Any:
        """Return the transaction on which guards are evaluated.

        A guard writes nothing, so one transaction is reused for all guards. Only values that differ are stored in it
        again."""
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
        """Return the values that an event of a robot can read."""
        columns = zip(*[self.slots.values[number] for number in seen[:-1]], strict=True)
        shared = dict(zip(self.allread, columns, strict=True)) if self.allread else {}
        shared |= dict(zip(self.allwrite, self.cells.values[seen[-1]], strict=True))
        return rt.Frame(pid, self.n_sys, robot.locals, shared, robot.sensors, robot.actuators, call)

    def own(self, robot: PrivateState) -> int:
        """Return the number of a private state."""
        own = tuple([self.key(v.name, robot.locals[v.name]) for v in self.program.locals])
        return self.owns.number((own, self.ports_key(robot), robot.stopped), robot)

    def ports_key(self, robot: PrivateState) -> Hashable:
        """Return a key that differs for different values of a robot's ports."""
        sensors = [self.key(name, robot.sensors[name]) for name in self.sensors]
        return (*sensors, *[self.key(name, robot.actuators[name]) for name in self.actuators], robot.unset)

    def packed(self, state: State) -> Packed:
        """Return a state of the semantics as a packed fleet. No command may have been given in this state yet."""
        robots = [self.own(self._own(robot)) for robot in state.robots]
        slots = [
            self._slots(tuple([self._taken(name, state.store.slots[name][pid]) for name in self.allread]))
            for pid in range(self.n_sys)
        ]
        cells = tuple([self._taken(name, state.store.cells[name]) for name in self.allwrite])
        return (*robots, *slots, self._cell_number(cells))

    def state(self, fleet: Packed, number: int = 1) -> State:
        """Return a packed fleet as a state of the semantics, at the start of round `number`."""
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
        """Return the step of an event with the effects `done`.

        If a loop invariant was false in the event, it is added to `discards`."""
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
        key = tuple([(name, self.key(name, value)) for name, value in cells.items()])
        return RobotStep(index, own, slots, self.writes.number(key, cells))

    def _cells(self, before: int, writes: int) -> int:
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
        """Return a hashable key of a variable's value.

        A program can distinguish 0.0 from -0.0, which compare equal. So floats are represented by their text."""
        key: Hashable = repr(value) if with_floats(self.types[name]) else value
        return key

    def _own(self, robot: Robot) -> PrivateState:
        ports = {name: self._taken(name, value) for name, value in robot.ports.items()}
        locals_ = {name: self._taken(name, value) for name, value in robot.locals.items()}
        sensors = {name: ports[name] for name in self.sensors}
        return PrivateState(locals_, sensors, {name: ports[name] for name in self.actuators}, robot.stopped, self.unset)

    def _taken(self, name: str, value: Any) -> Any:
        return python_value(value, self.types[name], self.scope, self.names)

    def _meant(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {name: semantic_value(value, self.types[name]) for name, value in values.items()}


def watching(begin: type[rt.Transaction], cells: Mapping[str, type[rt.Cell[Any]]]) -> type[rt.Transaction]:
    """Return a subclass of the transaction class `begin` that uses other cell classes for some locals."""

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
    module = sys.modules[name] = ModuleType(name)  # Python resolves the annotations of record classes in this module
    scope: dict[str, Any] = vars(module)
    scope["__file__"] = "program.py"
    exec(compile(program_text(program), "program.py", "exec"), scope)
    if program.externs:
        scope["LIBRARY"].load()
    return scope
