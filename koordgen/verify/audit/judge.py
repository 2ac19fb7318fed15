"""Judge: evaluates the properties of a program over the whole fleet, after every round of a mission."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from koordgen.runtime.program.property import (
    UNKNOWN,
    Assumption,
    BoundName,
    Known,
    Property,
    Read,
    Trail,
    Unknown,
    judged,
)
from koordgen.verify.audit.fleet_state import FleetState, SharedChange
from koordgen.verify.audit.properties import GeneratedProperties
from koordgen.verify.audit.result import (
    AFTER,
    BEGIN,
    END,
    AuditViolation,
    ObservationTime,
    Outcome,
    PropertyResult,
    ValueRow,
)
from koordgen.verify.audit.shared_store import AuditedFleet

MOST_READ = 8  # largest number of values that the report of a violation shows
MOST_ROBOTS = 6  # largest number of robots in the table of a violation
_ANY = "the run replayed a counterexample, which begins in any state in which the invariants hold"
Progress = Callable[[int, int], None]  # function that is called with the present round and the number of rounds


@dataclass(frozen=True, slots=True)
class _Evaluation:
    """Outcome of one evaluation of a property.

    `why`: the name of the unknown value, or the reason why the property has no value; otherwise empty.
    `robot`: pid of the robot that owns the unknown value; -1 if no robot owns it."""

    outcome: Outcome
    why: str = ""
    robot: int = -1


_UNRECORDED = _Evaluation("unknown", "a call of a port that is not recorded")


def evaluated(holds: Callable[[Known], bool], known: Known) -> _Evaluation:
    """Evaluate a property with the function `judged`, and record the robot that owns an unknown value."""
    robot = -1

    def listening(known: Known) -> bool:
        nonlocal robot
        try:
            return holds(known)
        except Unknown as unknown:
            robot = unknown.robot
            raise

    outcome, why = judged(listening, known)
    return _Evaluation(outcome, why, robot)


class PropertyJudge:
    """Judge of the properties of one application in a mission. `index`: the application.

    `results`: first the results of properties in the order of the program, then of assumptions, then of properties that
        cannot be checked."""

    def __init__(self, meaning: GeneratedProperties, fleet: AuditedFleet, index: int) -> None:
        mission = fleet.missions[index]
        self._meaning, self._mission = meaning, mission
        found = self._found = meaning.found
        n = self._n = len(mission.histories)
        self._properties = [(p, PropertyResult(p.kind, p.name, p.line)) for p in found.properties]
        self._assumptions = [(a, PropertyResult("assume", a.module, a.line)) for a in found.assumptions]
        unchecked = [PropertyResult(u.kind, u.name, u.line, u.why) for u in found.unchecked]  # type: ignore[arg-type]
        self.results = [f for _, f in self._properties] + [f for _, f in self._assumptions] + unchecked
        if mission.step:
            for result in self.results:
                result.unchecked = _ANY if result.of == "initially" else result.unchecked
        self._known, self._step = found.fleet(n, None), found.step(n, None)
        self._whole = FleetState(meaning, fleet, index)
        # Values at the previous observation.
        self._before: dict[str, Any] = {}
        # Outcomes in the present round, one list for each of `results`.
        self._outcomes: list[list[tuple[Outcome, str]]] = [[] for _ in self.results]

    def run(self, progress: Progress) -> list[PropertyResult]:
        whole, first, last = self._whole, self._mission.first, self._mission.last
        if first:
            for result in self.results:
                result.miss(first, self._n if result.of == "assume" else 1)
        elif not self._mission.step:
            self._fleet(ObservationTime(0, False), BEGIN, "initially")
        for round_ in range(first, last + 1):
            progress(round_, last)
            self._before = dict(whole.values)
            whole.advance()
            self._fleet(ObservationTime(round_, False), AFTER, "invariant")
            if round_:
                self._step_guarantees(round_)
            if round_ < last:
                self._before = dict(whole.values)
                whole.end()
                self._fleet(ObservationTime(round_, True), END, "invariant")
                if round_:
                    self._steps(round_)
            self._close(round_)
        return self.results

    def _close(self, round_: int) -> None:
        for result, outcomes in zip(self.results, self._outcomes, strict=True):
            result.close(round_, outcomes, of_each=result.of == "assume")
            outcomes.clear()

    def _note(
        self,
        result: PropertyResult,
        came: _Evaluation,
        observation: ObservationTime,
        violation: Callable[[], AuditViolation | None],
    ) -> None:
        missing = self._missing(came, observation) if came.outcome == "unknown" else ""
        self._outcomes[next(k for k, f in enumerate(self.results) if f is result)].append((came.outcome, missing))
        if came.outcome in ("violated", "no value") and result.first is None:
            result.first = violation()

    def _fleet(self, observation: ObservationTime, where: str, kind: str) -> None:
        self._known.put(self._whole.values)
        for property_, result in self._properties:
            sensed = any(name in self._whole.sensors for name in property_.reads)
            # a state guarantee holds in every state, as an invariant does
            of = "invariant" if property_.kind == "guarantee" else property_.kind
            if of != kind or property_.is_step or (observation.end and not sensed):
                continue
            came = evaluated(property_.holds, self._known)
            self._note(result, came, observation, partial(self._violation, property_, came, observation, where))

    def _steps(self, round_: int) -> None:
        """Evaluate the assumptions about the ports of each robot in a round.

        An assumption relates values at the start of the round to values at the end of the round."""
        observation = ObservationTime(round_, True)
        actuators = [p.name for p in self._found.program.ports if p.direction == "actuator"]
        for pid in range(self._n):
            if not self._assumptions:
                return
            step = self._step
            calls = self._whole.calls(pid)
            step.pid, step.asked = pid, calls or ()
            ports = [name for name in step.one if not name.endswith("'")]
            step.put({name: self._before[name][pid] for name in ports})
            step.put({f"{name}'": self._before[name][pid] for name in ports if name in actuators})
            step.put({f"{name}'": self._whole.values[name][pid] for name in ports if name not in actuators})
            for assumption, result in self._assumptions:
                came = _UNRECORDED if calls is None else evaluated(assumption.holds_of_calls, step)
                whose = replace(came, robot=pid)
                result.unseen |= came.outcome == "unknown" and self._in_model(pid, round_)
                self._note(result, whose, observation, partial(self._broken, assumption, whose, observation))

    def _step_guarantees(self, round_: int) -> None:
        """Judge the step guarantees of exported variables at each write of a round.

        A step guarantee is reflexive, so a variable that nobody writes keeps it."""
        observation, known = ObservationTime(round_, False), self._found.fleet(self._n, None)
        for property_, result in self._properties:
            if not property_.is_step:
                continue
            variable = next(name.removesuffix("'") for name in property_.reads)
            changes = self._whole.changes(variable)
            if not changes:
                self._note(result, _Evaluation("held"), observation, lambda: None)
            for change in changes:
                known.put({variable: change.before, f"{variable}'": change.after})
                came = evaluated(property_.holds, known)
                if came.outcome == "held" and not change.is_single:
                    came = _Evaluation("unknown", variable)
                self._note(result, came, observation, partial(self._broken_by, variable, change, came, observation))

    def _broken_by(
        self, variable: str, change: SharedChange, came: _Evaluation, observation: ObservationTime
    ) -> AuditViolation:
        values = [self._meaning.text(variable, value) for value in (change.before, change.after)]
        why = came.why if came.outcome == "no value" else ""
        row = ValueRow("", variable, *values)
        return AuditViolation(observation, AFTER, change.robots, (), (change.cause,), why, (row,))

    def _in_model(self, pid: int, round_: int) -> bool:
        """Return whether a robot takes part in the mission both at the start and at the end of a round."""
        history = self._mission.histories[pid]
        return not (history.out_at(round_) or history.out_at(round_ + 1))

    def _missing(self, came: _Evaluation, observation: ObservationTime) -> str:
        """Return a text that names the unknown value and explains why its robot's trace lacks the value.

        An assumption reads an unprimed sensor at the round's start and a primed sensor at the round's end."""
        read = came.why.partition("[")[0]
        name = read.rstrip("'")
        later = observation.end and name in self._whole.sensors and (read != name or "[" in came.why)
        if came.robot < 0:
            silent = [s.silent(observation.round) for s in self._mission.histories if s.may_act(observation.round)]
            return f"{name}: {'; '.join(silent) or 'no trace contains the value'}"
        history = self._mission.histories[came.robot]
        return f"{name} of {history.name}: {history.silent(observation.round + later)}"

    def _violation(
        self, property_: Property, came: _Evaluation, observation: ObservationTime, where: str
    ) -> AuditViolation:
        trail: Trail = []
        again = self._found.fleet(self._n, trail)
        again.copy_from(self._known)
        judged(property_.holds, again)
        bound = [each for each in trail if isinstance(each, BoundName)]
        pids = [b.value for b in bound if b.robot and b.value in range(self._n)]
        pids += [r.robot for r in trail if isinstance(r, Read) and r.robot is not None and not pids]
        rows = tuple(self._rows(property_.reads, sorted(set(pids))[:MOST_ROBOTS]))
        why = came.why if came.outcome == "no value" else ""
        return AuditViolation(observation, where, self._names(pids), self._bound(bound), self._read(trail), why, rows)

    def _rows(self, reads: Iterable[str], pids: list[int]) -> Iterable[ValueRow]:
        """Yield the values that a property reads: the values of the robots `pids`, then allwrite variables."""
        before, after, text = self._before, self._whole.values, self._meaning.text
        slots = {name for name in reads if isinstance(after.get(name), list)}
        for pid in pids:
            for name in slots:
                was = text(name, before[name][pid]) if name in before else ""
                yield ValueRow(self._mission.histories[pid].name, name, was, text(name, after[name][pid]))
        for name in reads:
            if name not in slots:
                yield ValueRow("", name, text(name, before.get(name, UNKNOWN)), text(name, after.get(name, UNKNOWN)))

    def _broken(self, assumption: Assumption, came: _Evaluation, observation: ObservationTime) -> AuditViolation:
        trail: Trail = []
        again = self._found.step(self._n, trail)
        again.copy_from(self._step)
        judged(assumption.holds_of_calls, again)
        pid, one = self._step.pid, self._step.one
        name = self._mission.histories[pid].name
        reads = dict.fromkeys(read.rstrip("'") for read in assumption.reads)
        rows = [
            ValueRow(name, read, *(self._meaning.text(read, one[each].content) for each in (read, f"{read}'")))
            for read in reads
            if read in one
        ]
        bound = [each for each in trail if isinstance(each, BoundName)]
        why = came.why if came.outcome == "no value" else ""
        where = "from the round's start to its end"
        return AuditViolation(observation, where, (name,), self._bound(bound), self._read(trail), why, tuple(rows))

    def _names(self, pids: list[int]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(self._mission.histories[pid].name for pid in pids))

    def _bound(self, bound: list[BoundName]) -> tuple[str, ...]:
        found = []
        for name, value, robot in bound:
            who = f" ({self._mission.histories[value].name})" if robot and value in range(self._n) else ""
            found.append(f"{name} = {self._meaning.text('', value)}{who}")
        return tuple(found)

    def _read(self, trail: Trail) -> tuple[str, ...]:
        found = []
        for each in trail:
            if isinstance(each, Read):
                place = "" if each.robot is None else f"[{each.robot}]"
                found.append(f"{each.name}{place} = {self._meaning.text(each.name.rstrip(chr(39)), each.value)}")
        told = list(dict.fromkeys(found))
        return tuple(told if len(told) <= MOST_READ else [*told[:MOST_READ], f"and {len(told) - MOST_READ} more"])
