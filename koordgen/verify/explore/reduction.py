"""State-space reduction: ignores differences between private states that affect no later step.

1. Unread local variables. A local variable is unread if no invariant names it and no event reads a value in it that
  another event wrote. All other steps are the same for all its values, so the variable is removed from states. Reads
  are found at run time, not in the text of events: a variable counts as unread until an event reads it, which raises
  `VariableRead`. Then the variable is kept, and the search restarts.

   An event is idle if it reads and writes only such a variable (a counter that runs down) and belongs to no `priority:`
   block, whose other events would read its guard. Idle events are left out of rounds. They are run separately on all
   values that the variable can take, to find faults, and to find out whether they are ever enabled. Other events write
   values to the variable that do not depend on removed values, so every such value occurs in some robot of the search.
   2. Robots that can only stop. Each event of such a robot has a false guard or does nothing but `stop`, now and for
   ever, judged by the robot's locals and own slots alone, which no other robot writes. The robot is represented by one
   that has already stopped: for each step of one of them, the other one skips its event. In both, all locals that no
   invariant names are removed.

Both reductions preserve the number of rounds to any violation. They do not preserve deadlocks, since a robot that is
represented by a stopped one may still have an event. So if a deadlock is found, the search restarts without reductions.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable
from functools import cache
from typing import Any

from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.tree import walk
from koordgen.runtime.program import program as rt
from koordgen.verify.explore.machine import Interned, Machine, Packed, PrivateState

MAX_TRIED = 10_000  # largest number of values of one variable on which idle events are run


class VariableRead(BaseException):
    """Raised if an event reads a variable that counted as unread.

    It is a BaseException, because generated code reports any Exception as a fault of the event."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


class _Others(BaseException):
    """Raised if an event reads more than its robot's locals, actuators and own slots."""


class _Hidden(rt.Cell[Any]):
    __slots__ = ()

    @property
    def value(self) -> Any:
        raise _Others

    @value.setter
    def value(self, value: Any) -> None:
        raise _Others


class _OwnSlots(rt.Slots[Any]):
    __slots__ = ()

    def __getitem__(self, index: int) -> Any:
        if index != self._pid:
            raise _Others
        return super().__getitem__(index)

    @property
    def all(self) -> tuple[Any, ...]:
        raise _Others


@cache
def unread_cell(name: str) -> type[rt.Cell[Any]]:
    """Return a class of cells that raise VariableRead if an event reads them before it writes them."""

    class Watched(rt.Cell[Any]):
        __slots__ = ()

        @rt.Cell.value.getter  # type: ignore[attr-defined,untyped-decorator]
        def value(self) -> Any:
            if not self.line:
                raise VariableRead(name)
            return super().value

    return Watched


def restricted(begin: type[rt.Transaction], sensors: Collection[str]) -> type[rt.Transaction]:
    """Return a subclass of the transaction class `begin` that shows only one robot's own variables.

    These are the robot's locals, actuators and own slots. `sensors` names the attributes that the subclass removes."""

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
    """State-space reduction for the fleets of one program.

    `locals`: names of the local variables that are removed from states.
    `idle`: indices of the events that use only a removed variable."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        program = machine.program
        named = {node.name for p in program.properties for node in walk(p.formula) if isinstance(node, expr.LocalOf)}
        self._named = tuple([v.name for v in program.locals if v.name in named])
        guards = {node.name for e in program.events for node in walk(e.guard) if isinstance(node, expr.LocalRead)}
        restricted = [_only_variable(event) for event in program.events]
        unread = [v.name for v in program.locals if v.name not in named]
        self._take([name for name in unread if name not in guards or name in restricted])

    def keep(self, name: str) -> None:
        """Stop removing a variable from states, because an event reads it."""
        self._take([other for other in self.locals if other != name])

    def _take(self, names: list[str]) -> None:
        self.locals = tuple(names)
        events = enumerate(self.machine.program.events)
        self._turning = {index: name for index, event in events if (name := _only_variable(event)) in names and name}
        self.idle = frozenset(self._turning)
        self._kept = tuple([v.name for v in self.machine.program.locals if v.name not in names])
        self._standing: dict[tuple[int, int, int], int] = {}
        self._alike: Interned[int] = Interned()
        self._tried: set[Hashable] = set()
        self.machine.watch({name: unread_cell(name) for name in names})
        self._alone = restricted(self.machine.begin, self.machine.sensor_attributes.values())

    def fleet(self, fleet: Packed) -> Packed:
        """Return the fleet that represents the given fleet."""
        n_sys, seen = self.machine.n_sys, fleet[self.machine.n_sys :]
        return (*[self.own(pid, fleet[pid], seen) for pid in range(n_sys)], *seen)

    def own(self, pid: int, own: int, seen: Packed) -> int:
        """Return the number of the private state that represents the given one.

        It depends on the store only through the robot's own slots."""
        key = (pid, own, seen[pid])
        found = self._standing.get(key)
        if found is None:
            found = self._standing[key] = self._stands(pid, own, seen)
        return found

    def _stands(self, pid: int, own: int, seen: Packed) -> int:
        machine = self.machine
        robot = machine.owns.values[own]
        self._turn(pid, robot, seen)
        stopped = robot.stopped or self._finished(pid, robot, seen)
        names = self._named if stopped else self._kept
        key = (*[machine.key(name, robot.locals[name]) for name in names], machine.ports_key(robot), stopped)
        if stopped != robot.stopped:
            own = machine.own(robot._replace(stopped=True))
        return self._alike.values[self._alike.number(key, own)]

    def _turn(self, pid: int, robot: PrivateState, seen: Packed) -> None:
        """Run the idle events on all values that their variables can take from the robot's present values."""
        machine, code = self.machine, self.machine.code
        if robot.stopped:
            return
        for name in set(self._turning.values()):
            pending = [robot.locals[name]]
            for value in pending:  # the loop itself appends to this list
                key = (name, machine.key(name, value))
                if key in self._tried:
                    continue
                self._tried.add(key)
                if len(self._tried) > MAX_TRIED:
                    raise VariableRead(name)
                frame = machine.frame(pid, robot._replace(locals={**robot.locals, name: value}), seen)
                for index in [index for index, turning in self._turning.items() if turning == name]:
                    event = code.events[index]
                    try:
                        ready = rt.enabled(event, code.begin(frame))
                        done = rt.run(code, event.effect, code.begin(frame)) if ready else None
                    except Exception:  # the guard has a fault, so keep the variable: the search then reports the fault
                        raise VariableRead(name) from None
                    if isinstance(done, rt.Fault) or (done is not None and done.violated):
                        raise VariableRead(name)
                    if done is not None:
                        machine.enabled.add(index)
                        pending.append(done.locals[name])

    def _finished(self, pid: int, robot: PrivateState, seen: Packed) -> bool:
        """Return whether a robot will do nothing but stop, whatever other robots do."""
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
                    continue  # the event with priority also does nothing but stop, now and for ever
                done = rt.run(code, event.effect, self._alone(frame))
            except (Exception, VariableRead, _Others):
                return False
            if not isinstance(done, rt.Effects) or done.violated or not done.stopped or done.shared or done.actuators:
                return False
            if any(done.locals[name] is not robot.locals[name] for name in self._named):
                return False
            stopping.append(index)
        machine.enabled.update(stopping)
        return bool(stopping)


def _only_variable(event: decl.Event) -> str | None:
    """Return the only variable that an event uses; None for an event that uses more.

    None, too, for an event that is atomic or belongs to a `priority:` block."""
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
