"""Transition functions of a system: the machine of each application, on packed views.

A packed state of a system is the packed views of its applications, one after another. A view is a state of the
application's own `Machine`, so instances run, and invariants are evaluated, exactly as with one program. A variable or
port that several applications know therefore has a value in each of their views. `applied` keeps these values equal: it
carries the writes of a step into all views.

In a round, an instance reads its robot's ports as they were at the round's start, whatever other applications of the
robot have commanded in that round.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from koordgen.lang.analyze.params import with_params
from koordgen.lang.ir import decl
from koordgen.lang.ir.ports import clearable
from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.system import SystemState, joined, view
from koordgen.lang.semantics.values import Value
from koordgen.verify.explore.machine import Answer, DiscardedEvent, Machine, Packed, RobotStep
from koordgen.verify.replay.functions import semantic_value


def with_sizes(system: System, application: int) -> decl.Program:
    """Return an application's program, with the numbers of members of the applications from which it imports."""
    program = system.applications[application].program
    exporters = {i.size: system.applications[system.exporter(application, i)] for i in program.imports}
    return with_params(program, {size: len(exporter.members) for size, exporter in exporters.items()})


class SystemMachine:
    """Transitions of a system.

    `machines`: the machine of each application. `instances`: all instances, by their numbers.
    `answers`: for each application, the function that returns the possible answers of callable ports.
    `functions`: for each application, the user's file with its extern functions. Raises CannotCall."""

    def __init__(
        self, system: System, answers: Sequence[Answer], functions: Sequence[Path | None] | None = None
    ) -> None:
        self.system, self.instances = system, system.instances()
        files = functions or [None] * len(system.applications)
        self.machines = tuple([
            Machine(with_sizes(system, index), len(application.members), answers[index], files[index])
            for index, application in enumerate(system.applications)
        ])  # fmt: skip
        widths = [2 * machine.n_sys + 1 for machine in self.machines]
        self._first = [sum(widths[:index]) for index in range(len(widths))]
        self.views = tuple([slice(at, at + width) for at, width in zip(self._first, widths, strict=True)])
        # For each instance: application and pid, and the index of its private state in a packed state.
        self.units = tuple([(instance.application, instance.pid) for instance in self.instances])
        self.own_places = tuple([self._first[a] + pid for a, pid in self.units])
        applications = range(len(self.machines))
        # For each application: other applications that know some of its allwrite variables, with the variables' names.
        self._same_cells = [
            [(b, names) for b in applications if a != b and (names := self._common_cells(a, b))] for a in applications
        ]
        # For each application: applications that import some of its allread variables, with the variables' names.
        self._slot_readers = [
            [(b, names) for b in applications if (names := self._imported_slots(a, b))] for a in applications
        ]
        # For each instance: other instances on the robot with which it has a port in common.
        self._beside = [[j for j in range(len(self.instances)) if self._share_ports(i, j)] for i in self._numbers()]
        self._carried: dict[tuple[int, int, int], int] = {}
        self._columns: dict[tuple[int, int, Packed], int] = {}
        self._ported: dict[tuple[int, int, int, int, int], int] = {}

    def _numbers(self) -> range:
        return range(len(self.instances))

    def _common_cells(self, a: int, b: int) -> frozenset[str]:
        names = set(self.machines[a].allwrite) & set(self.machines[b].allwrite)
        return frozenset([name for name in names if self.system.owner(a, name) == self.system.owner(b, name)])

    def _imported_slots(self, exporter: int, importer: int) -> frozenset[str]:
        imports = self.system.applications[importer].program.imports
        return frozenset([n for i in imports if self.system.exporter(importer, i) == exporter for n in i.slots])

    def _share_ports(self, i: int, j: int) -> bool:
        one, other = self.instances[i], self.instances[j]
        ports = [
            {*self.machines[each.application].sensors, *self.machines[each.application].actuators}
            for each in (one, other)
        ]
        return i != j and one.robot == other.robot and not ports[0].isdisjoint(ports[1])

    def view(self, fleet: Packed, application: int) -> Packed:
        """Return the packed state of one application in a packed state of the system."""
        return fleet[self.views[application]]

    def packed(self, state: SystemState) -> Packed:
        """Pack a state of the executable semantics in which no robot has given a command yet."""
        found: list[int] = []
        unset = [self.unset(robot) for robot in range(self.system.robots)]
        for index, machine in enumerate(self.machines):
            fleet = machine.packed(view(self.system, state, index))
            for own, robot in zip(fleet, self.system.applications[index].members, strict=False):
                held = machine.owns.values[own]
                found.append(machine.own(held._replace(unset=unset[robot].intersection(machine.sensors))))
            found += fleet[machine.n_sys :]
        return tuple(found)

    def unset(self, robot: int) -> frozenset[str]:
        """Return the sensors that stay true until the robot's first command, by any of its applications."""
        programs = [application.program for application in self.system.applications if robot in application.members]
        return frozenset().union(*map(clearable, programs))

    def view_state(self, fleet: Packed, application: int, number: int = 1) -> State:
        """Return the state of one application at the start of round `number`."""
        return self.machines[application].state(self.view(fleet, application), number)

    def state(self, fleet: Packed, number: int = 1) -> SystemState:
        """Unpack a packed state to a state of the executable semantics, at the start of round `number`."""
        return joined(self.system, [self.view_state(fleet, index, number) for index in range(len(self.machines))])

    def failure(self) -> tuple[int, DiscardedEvent] | None:
        """Return the first discarded event, or event with a false loop invariant, and its application's index."""
        return next(((a, m.discards[0]) for a, m in enumerate(self.machines) if m.discards), None)

    def forget_failures(self) -> None:
        for machine in self.machines:
            machine.discards.clear()

    def after_init(self, fleet: Packed) -> list[Packed]:
        """Return all states that are possible after every instance has run `init`.

        Each `init` reads the variables and ports as they were before the first `init`."""
        found = [fleet]
        for number, (a, pid) in enumerate(self.units):
            machine, seen = self.machines[a], self.view(fleet, a)
            if machine.code.init is not None:
                choices = machine.init_choices(pid, seen[pid], seen[machine.n_sys :])
                found = [self.applied(after, number, seen[pid], choice) for after in found for choice in choices]
        return found

    def applied(self, fleet: Packed, number: int, begun: int, choice: RobotStep) -> Packed:
        """Return the state after the step `choice` of an instance.

        `begun`: the instance's private state at the round's start, with the ports that its event has read."""
        a, pid = self.units[number]
        machine, first = self.machines[a], self._first[a]
        own, slots, cells = first + pid, first + machine.n_sys + pid, first + 2 * machine.n_sys
        made = list(fleet)
        made[own] = choice.own if fleet[own] == begun else self._merged(number, fleet[own], begun, choice.own)
        if choice.cells != machine.nothing:
            made[cells] = machine.written(fleet[cells], choice.cells)
            for b, names in self._same_cells[a]:
                self._write(made, b, self._cells_of(a, b, names, choice.cells))
        if choice.slots != fleet[slots]:
            made[slots] = choice.slots
            for b, names in self._slot_readers[a]:
                self._write(made, b, self._columns_of(a, b, names, tuple(made[first + machine.n_sys : cells])))
        for other in self._beside[number]:
            place = self.own_places[other]
            made[place] = self._with_ports(other, made[place], number, begun, choice.own)
        return tuple(made)

    def _write(self, made: list[int], application: int, writes: int) -> None:
        machine, at = self.machines[application], self.views[application].stop - 1
        if writes != machine.nothing:
            made[at] = machine.written(made[at], writes)

    def _cells_of(self, a: int, b: int, names: frozenset[str], writes: int) -> int:
        """Return writes to allwrite variables of application `a` as writes of application `b`."""
        found = self._carried.get((a, b, writes))
        if found is None:
            values = {name: v for name, v in self.machines[a].writes.values[writes].items() if name in names}
            found = self._carried[a, b, writes] = self._writes(a, b, values)
        return found

    def _columns_of(self, a: int, b: int, names: frozenset[str], slots: Packed) -> int:
        """Return the slots of application `a` as writes to the lists of application `b`, which imports them."""
        found = self._columns.get((a, b, slots))
        if found is None:
            machine = self.machines[a]
            columns = zip(*[machine.slots.values[number] for number in slots], strict=True)
            values = {name: column for name, column in zip(machine.allread, columns, strict=True) if name in names}
            found = self._columns[a, b, slots] = self._writes(a, b, values)
        return found

    def _writes(self, a: int, b: int, values: Mapping[str, Any]) -> int:
        """Return the number that writes of application `a` have in application `b`.

        Each application has its own classes of records, so values are converted."""
        types, machine = self.machines[b].types, self.machines[b]
        return machine.cell_writes({n: machine.taken(n, semantic_value(v, types[n])) for n, v in values.items()})

    def _merged(self, number: int, now: int, begun: int, then: int) -> int:
        """Return an instance's private state after its step, if its ports have changed since the round's start.

        `now`, `begun`, `then`: its private states before the step, at the round's start, and after a step from there.
        """
        machine = self.machines[self.units[number][0]]
        held, after = machine.owns.values[now], machine.owns.values[then]
        kept = machine.own(after._replace(sensors=held.sensors, actuators=held.actuators, unset=held.unset))
        return self._with_ports(number, kept, number, begun, then)

    def _with_ports(self, number: int, own: int, by: int, begun: int, then: int) -> int:
        """Return the private state `own` of an instance after another instance, `by`, has changed ports of the robot.

        `begun`, `then`: private states of `by` before and after its step."""
        if begun == then:
            return own
        key = (number, own, by, begun, then)
        found = self._ported.get(key)
        if found is None:
            values, is_set = self._port_writes(by, begun, then)
            machine = self.machines[self.units[number][0]]
            robot = machine.owns.values[own]
            known = {n: machine.taken(n, v) for n, v in values.items() if n in robot.sensors or n in robot.actuators}
            sensors = {name: known.get(name, value) for name, value in robot.sensors.items()}
            actuators = {name: known.get(name, value) for name, value in robot.actuators.items()}
            unset = robot.unset - is_set
            found = machine.own(robot._replace(sensors=sensors, actuators=actuators, unset=unset))
            self._ported[key] = found
        return found

    def _port_writes(self, number: int, begun: int, then: int) -> tuple[dict[str, Value], frozenset[str]]:
        """Return the ports that a step of an instance changed, and the sensors that got a value."""
        machine = self.machines[self.units[number][0]]
        old, new = machine.owns.values[begun], machine.owns.values[then]
        before, after = ({**robot.sensors, **robot.actuators} for robot in (old, new))
        changed = [name for name in after if machine.key(name, before[name]) != machine.key(name, after[name])]
        return {n: semantic_value(after[n], machine.types[n]) for n in changed}, old.unset - new.unset
