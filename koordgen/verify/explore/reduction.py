"""Reduction of private states: merges private states whose differences affect no later step.

First reduction: unread local variables are removed from states.

- A local variable is unread if no property names it, and no event reads a value that an earlier event wrote to it. The
  values of an unread variable make no difference to the steps of the program.
- Reads are detected when events run. An event that reads a removed variable raises `VariableRead`. The variable is then
  kept in states, and the search restarts.
- An idle event uses only one removed variable, for example to count down, and stands in no `priority:` block, since the
  other events of a block depend on its guard. Rounds leave idle events out. Idle events run separately, on all values
  that the variable can have, to find faults and to find out which idle events are ever enabled. Every value that
  another event writes to the variable occurs in the search, because it does not depend on removed values.

Second reduction: a robot that can only stop is represented by a stopped robot.

- Each event of such a robot has a false guard or does nothing but `stop`, now and in all later rounds. This is decided
  from the robot's locals, actuators and own slots, which no other robot writes.
- For each step of the one robot, the other robot can skip its event. Locals that no property names are removed from
  the states of both robots.

Both reductions preserve the number of rounds to any violation. They do not preserve deadlocks, since a robot that can
only stop still has an enabled event. So the search restarts without reductions if it finds a deadlock.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable
from functools import cache
from typing import Any

from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.tree import walk
from koordgen.runtime.program import program as rt
from koordgen.verify.explore.machine import Interned, Machine, Packed, PrivateState

MAX_TRIED = 10_000  # largest number of pairs of a removed variable and a value on which idle events run


class VariableRead(BaseException):
    """Raised if an event reads a local variable that is removed from states.

    This class is a BaseException, because generated code turns every Exception into a fault of the event."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


class _ForeignRead(BaseException):
    """Raised if an event reads a variable that other robots can write, or another robot's slot."""


class _Hidden(rt.Cell[Any]):
    __slots__ = ()

    @property
    def value(self) -> Any:
        raise _ForeignRead

    @value.setter
    def value(self, value: Any) -> None:
        raise _ForeignRead


class _OwnSlots(rt.Slots[Any]):
    __slots__ = ()

    def __getitem__(self, index: int) -> Any:
        if index != self._pid:
            raise _ForeignRead
        return super().__getitem__(index)

    @property
    def all(self) -> tuple[Any, ...]:
        raise _ForeignRead


@cache
def unread_cell(name: str) -> type[rt.Cell[Any]]:
    """Return a cell class for variable `name` that raises VariableRead on a read before the first write."""

    class Watched(rt.Cell[Any]):
        __slots__ = ()

        @rt.Cell.value.getter  # type: ignore[attr-defined,untyped-decorator]
        def value(self) -> Any:
            if not self.line:
                raise VariableRead(name)
            return super().value

    return Watched


def restricted(begin: type[rt.Transaction], sensors: Collection[str]) -> type[rt.Transaction]:
    """Return a subclass of `begin` in which an event can read only the variables of its own robot.

    These are the robot's locals, actuators and own slots. Reads of other variables raise an exception.
    `sensors`: names of the attributes with sensor values, which the subclass removes."""

    class Alone(begin):  # type: ignore[misc,valid-type]
        def __init__(self, frame: rt.Frame) -> None:
            super().__init__(frame)
            for sensor in sensors:
                delattr(self, sensor)

        def shared(self, name: str) -> rt.Cell[Any]:
            super().shared(name)
            cell = self.written[name] = _Hidden(None)
            return cell

        def slots(self, name: str) -> rt.Slots[Any]:
            slots = self.written[name] = _OwnSlots(super().slots(name).all, self.pid)
            return slots

    return Alone


class StateReduction:
    """Reduction of the private states of one program's robots.

    `locals`: names of the local variables that are removed from states.
    `idle`: indices of the idle events, which use only one removed variable."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        program = machine.program
        named = {node.name for p in program.properties for node in walk(p.formula) if isinstance(node, expr.LocalOf)}
        self._named = tuple([v.name for v in program.locals if v.name in named])
        guards = {node.name for e in program.events for node in walk(e.guard) if isinstance(node, expr.LocalRead)}
        restricted = [_only_variable(event) for event in program.events]
        unread = [v.name for v in program.locals if v.name not in named]
        self._set_removed([name for name in unread if name not in guards or name in restricted])

    def keep(self, name: str) -> None:
        """Stop removing the variable `name` from states, because an event has read the variable."""
        self._set_removed([other for other in self.locals if other != name])

    def _set_removed(self, names: list[str]) -> None:
        self.locals = tuple(names)
        events = enumerate(self.machine.program.events)
        self._idle_variables = {
            index: name for index, event in events if (name := _only_variable(event)) in names and name
        }
        self.idle = frozenset(self._idle_variables)
        self._kept = tuple([v.name for v in self.machine.program.locals if v.name not in names])
        self._representatives: dict[tuple[int, int, int], int] = {}
        self._alike: Interned[int] = Interned()
        self._tried: set[Hashable] = set()
        self.machine.watch({name: unread_cell(name) for name in names})
        self._alone = restricted(self.machine.begin, self.machine.sensor_attributes.values())

    def fleet(self, fleet: Packed) -> Packed:
        """Replace the private state of each robot in a fleet's state by its representative."""
        n_sys, seen = self.machine.n_sys, fleet[self.machine.n_sys :]
        return (*[self.own(pid, fleet[pid], seen) for pid in range(n_sys)], *seen)

    def own(self, pid: int, own: int, seen: Packed) -> int:
        """Return the number of the private state that represents the private state `own` of robot `pid`.

        The result depends on the robot's own slots, but on no other shared variable."""
        key = (pid, own, seen[pid])
        found = self._representatives.get(key)
        if found is None:
            found = self._representatives[key] = self._representative(pid, own, seen)
        return found

    def _representative(self, pid: int, own: int, seen: Packed) -> int:
        machine = self.machine
        robot = machine.owns.values[own]
        self._run_idle_events(pid, robot, seen)
        stopped = robot.stopped or self._finished(pid, robot, seen)
        names = self._named if stopped else self._kept
        key = (*[machine.key(name, robot.locals[name]) for name in names], machine.ports_key(robot), stopped)
        if stopped != robot.stopped:
            own = machine.own(robot._replace(stopped=True))
        return self._alike.values[self._alike.number(key, own)]

    def _run_idle_events(self, pid: int, robot: PrivateState, seen: Packed) -> None:
        """Run the idle events on the present values of their variables, and on all values that they write."""
        machine, code = self.machine, self.machine.code
        if robot.stopped:
            return
        for name in set(self._idle_variables.values()):
            pending = [robot.locals[name]]
            for value in pending:  # the loop body appends to `pending`
                key = (name, machine.key(name, value))
                if key in self._tried:
                    continue
                self._tried.add(key)
                if len(self._tried) > MAX_TRIED:
                    raise VariableRead(name)
                frame = machine.frame(pid, robot._replace(locals={**robot.locals, name: value}), seen)
                for index in [index for index, turning in self._idle_variables.items() if turning == name]:
                    event = code.events[index]
                    try:
                        ready = rt.enabled(event, code.begin(frame))
                        done = rt.run(code, event.effect, code.begin(frame)) if ready else None
                    except Exception:  # the guard has a fault: keep the variable, so that the search reports the fault
                        raise VariableRead(name) from None
                    if isinstance(done, rt.Fault) or (done is not None and done.violated):
                        raise VariableRead(name)
                    if done is not None:
                        machine.enabled.add(index)
                        pending.append(done.locals[name])

    def _finished(self, pid: int, robot: PrivateState, seen: Packed) -> bool:
        """Return whether a robot can do nothing but stop, now and later, whatever other robots do."""
        machine, code = self.machine, self.machine.code
        frame = machine.frame(pid, robot, seen)
        stopping = []
        for index, event in enumerate(code.events):
            if index in self.idle:
                continue
            try:
                if not rt.enabled(event, self._alone(frame)):
                    continue
                if any(code.events[earlier].guard(self._alone(frame)) for earlier in machine.earlier[index]):
                    continue  # a higher event of the `priority:` block runs instead; the loop also checks that event
                done = rt.run(code, event.effect, self._alone(frame))
            except (Exception, VariableRead, _ForeignRead):
                return False
            if not isinstance(done, rt.Effects) or done.violated or not done.stopped or done.shared or done.actuators:
                return False
            if any(done.locals[name] is not robot.locals[name] for name in self._named):
                return False
            stopping.append(index)
        machine.enabled.update(stopping)
        return bool(stopping)


def _only_variable(event: decl.Event) -> str | None:
    """Return the name of the one local variable that an event uses; None if the event uses more.

    Also returns None for an atomic event and for an event in a `priority:` block."""
    names, parts = set(), (event.guard, event.effect)
    for node in walk(parts):
        match node:
            case expr.LocalRead(name) | stmt.LocalPlace(name):
                names.add(name)
            case expr.Pid() | expr.SlotRead() | expr.SlotsRead() | expr.SharedRead() | expr.PortRead():
                return None
            case (
                expr.PortCall()
                | expr.ExternCall()
                | stmt.OwnSlot()
                | stmt.SharedPlace()
                | stmt.PortPlace()
                | stmt.Stop()
            ):
                return None
            case _:
                pass
    return names.pop() if len(names) == 1 and event.lock is None and event.priority is None else None
