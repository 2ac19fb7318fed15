"""Monitors of one robot: evaluate invariants, port assumptions and contracts on the values that the robot knows.

An invariant, or a guarantee about one state, is evaluated at the start of a round, on committed values of one time: the
robot's own sensors and variables, and its copy of the shared variables. Ports and local variables of other robots are
unknown. A port assumption is evaluated on a step: from the state after a round's event to the sensor values of the next
round."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from koordgen.runtime.config.settings import Action, Settings
from koordgen.runtime.program.extern import Contract
from koordgen.runtime.program.program import Effects
from koordgen.runtime.program.property import (
    UNKNOWN,
    Assumption,
    BoundName,
    Known,
    Outcome,
    Properties,
    Read,
    Trail,
    judged,
)
from koordgen.runtime.program.runner import LEFT, Limit, Overrun
from koordgen.runtime.trace.monitored import (
    FOR_GOOD,
    OWN,
    SENSED,
    SHARED,
    Change,
    MonitoredProperty,
    Observation,
    usable,
)
from koordgen.runtime.trace.writer import RoundRecord
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.safety import GO, SafetyVerdict

SHARE = 0.03  # share of the agent's CPU time for the evaluation of properties that are only logged
LONGEST_WAIT = 50  # after this number of rounds a property is evaluated regardless of the CPU budget
BUDGET = 0.1  # largest duration of the evaluation of all properties in a round, as a share of the round
MOST_OVERRUNS = 3  # a property that exceeds the largest duration more often is switched off
LOOPS = "loop invariants"  # name in the settings that stands for all loop invariants

Report = Callable[[Change], None]


class Monitors:
    """Monitors of one robot.

    The agent calls `look` with the observation of each round after it has sent the round's entry, and `hear` with the
    record of each committed round. `verdict`: reaction that violated properties require. `limit`: interrupts long
    evaluations. Properties with an action are always evaluated. Properties that are only logged are evaluated as far as
    the CPU budget allows, the least recently evaluated property first. `cpu`: clock of the CPU time."""

    def __init__(
        self, found: Properties | None, settings: Settings, report: Report, limit: Limit, cpu: Cpu | None = None
    ) -> None:
        self.verdict = GO
        self._pid, self._names = settings.pid, tuple(p.name for p in settings.peers)
        self._delta, self._stale_after = settings.delta, settings.safety.peer_timeout
        self._actions = settings.monitors
        self._report, self._limit, self._cpu = report, limit, cpu
        self._round = 0
        self._invariants: list[MonitoredProperty] = []
        self._assumptions: list[MonitoredProperty] = []
        # broken contract -> its property, and the event that broke the contract
        self._contracts: dict[Contract, tuple[MonitoredProperty, str | None]] = {}
        self._loops: dict[
            int, tuple[MonitoredProperty, str | None]
        ] = {}  # line of a false loop invariant -> its property and event
        self._off: list[MonitoredProperty] = []
        self._last: RoundRecord | None = None
        self._actuators: Mapping[str, Any] | None = None  # values after the last recorded round
        self._found = found
        if found is not None:
            self._watch(found)

    def _watch(self, found: Properties) -> None:
        n, program = len(self._names), found.program
        self._known, self._step = found.fleet(n, None), found.step(n, None)
        self._known.pid = self._step.pid = self._pid
        place = {p.name: SENSED for p in program.ports if p.direction == "sensor"}
        place |= {v.name: SHARED for v in program.shared}
        for p in found.properties:
            if p.kind != "initially" and not p.is_step and (action := self._action(p.name)) != "off":
                places = [place.get(name, OWN) for name in p.reads]
                reads, needs, senses = frozenset(p.reads), max(places, default=SENSED), SENSED in places
                line = f"{program.source}:{p.line}"
                self._invariants.append(MonitoredProperty(p.kind, p.name, line, action, p, reads, needs, senses))
        for a in found.assumptions:
            if (action := self._action(f"assume {a.module}")) != "off":
                self._assumptions.append(
                    MonitoredProperty("assume", a.module, f"{program.source}:{a.line}", action, a, frozenset(a.reads))
                )
        # Invariants and assumptions have separate budgets, so that neither group uses all the CPU time.
        share = SHARE / 2 if self._invariants and self._assumptions else SHARE
        self._invariant_time, self._assumption_time = CpuBudget(self._cpu, share), CpuBudget(self._cpu, share)
        names = sorted(frozenset[str]().union(*(watched.reads for watched in self._invariants)))
        self._reading = [(name, place.get(name, OWN)) for name in names]
        self._values: dict[str, Any] = {}  # name -> value read last
        self._rows = {name: [UNKNOWN] * n for name in self._known.each}
        one = self._step.one
        primed = frozenset[str]().union(*(watched.reads for watched in self._assumptions))
        self._clears = program.clears
        self._ports = [
            (p.name, p.direction == "sensor", one[p.name], one[f"{p.name}'"])
            for p in program.ports
            if p.name in primed or f"{p.name}'" in primed
        ]

    def _action(self, name: str) -> Action:
        return self._actions.get(name) or self._actions.get("default") or "log"

    @property
    def watched(self) -> list[MonitoredProperty]:
        """All properties that have a verdict or may get a verdict."""
        noted = (watched for watched, _ in (*self._contracts.values(), *self._loops.values()))
        return [*self._invariants, *self._assumptions, *self._off, *noted]

    @property
    def wanted(self) -> bool:
        """True if a property needs observations of rounds."""
        return bool(self._invariants or self._assumptions)

    def look(self, observation: Observation | None) -> None:
        """Evaluate the invariants on the observation of the present round. Repeated calls in a round do nothing.

        An exception is an internal error. It switches all invariants off and is raised again."""
        if observation is None or observation.round == self._round:
            return
        self._round = observation.round
        if self._invariants:
            try:
                self._look(observation)
            except Exception:
                self._invariants = []
                raise

    def _look(self, observation: Observation) -> None:
        if not self._invariant_time.begin() and not self._is_urgent(self._invariants):
            return
        changed = self._put(observation)
        old = observation.age(self._delta)
        due = []
        for watched in self._invariants:
            watched.due = watched.due or not changed.isdisjoint(watched.reads)
            if watched.needs > observation.committed:
                self._wait(watched, observation)
            elif watched.due:
                due.append(watched)
            else:  # all values that the property reads are unchanged, so its verdict is confirmed
                watched.true = observation.round - (old if watched.senses else 0)
        if due:
            self._judge(due, self._known, self._invariant_time, observation.time, observation.round, old)
        self._invariant_time.end()

    def _is_urgent(self, asked: list[MonitoredProperty]) -> bool:
        """Return whether at least one of the properties must be evaluated even without CPU budget."""
        return any(self._round - w.true >= LONGEST_WAIT or w.action != "log" for w in asked)

    def _wait(self, watched: MonitoredProperty, observation: Observation) -> None:
        """Set the verdict of a property to unknown if the values that it reads are uncommitted for too long."""
        age = observation.round - watched.true
        if age > self._stale_after and watched.outcome not in (None, "unknown"):
            watched.due = True
            self._become(watched, "unknown", f"the values it reads are {age} rounds old", observation.time, stale=True)

    def _put(self, observation: Observation) -> set[str]:
        """Update the known values. Return the names of the changed values; a new object counts as a change."""
        known, values, changed = self._known, self._values, set()
        for name, place in self._reading:
            if place > observation.committed:
                continue
            value = observation.value(name, place)
            if value is values.get(name):
                continue
            values[name] = value
            changed.add(name)
            if place == SHARED:
                known.put({name: value})
            else:
                row = self._rows[name]
                row[self._pid] = usable(value) if place == SENSED else value
                known.each[name].values = row
        return changed

    def hear(self, record: RoundRecord) -> None:
        """Evaluate the assumptions and contracts on the record of a committed round.

        The agent passes the records in the order of their rounds."""
        last, self._last = self._last, record
        actuators = self._actuators if record.frame is None else record.frame.actuators
        if record.restored is not None:
            actuators, last = record.restored.actuators, None
        following = last is not None and record.round == last.round + 1 and record.skipped != LEFT
        if self._assumptions and following and last is not None and actuators is not None:
            self._assume(last, record, actuators)
        if actuators is not None and record.effects is not None and record.effects.actuators:
            actuators = {**actuators, **record.effects.actuators}
        self._actuators = actuators
        self._contract(record)
        if record.effects is not None:
            self.ran(record.effects, record.event, record.round, record.time)

    def ran(self, effects: Effects, event: str | None, round_: int, time: float) -> None:
        """Update the verdicts on loop invariants after a committed event. `event`: its name; None denotes `init`."""
        where = f"the event {event}" if event is not None else "init"
        for line in effects.violated:
            action = self._action(LOOPS)
            if action == "off":
                return
            source = self._found.program.source if self._found is not None else ""
            made = MonitoredProperty("loop invariant", f"line {line}", f"{source}:{line}", action)
            watched, _ = self._loops.get(line, (made, None))
            self._loops[line] = watched, event
            watched.true = round_
            self._become(watched, "violated", f"in {where} it was false or had no value", time)
        for line, (watched, broke) in self._loops.items():
            if watched.outcome == "violated" and broke == event and line not in effects.violated:
                watched.true = round_
                self._become(watched, "held", f"{where} ran through again", time)

    def _assume(self, before: RoundRecord, after: RoundRecord, actuators: Mapping[str, Any]) -> None:
        """Evaluate the assumptions on one step of the environment.

        The step leads from the state after the event of round `before` to the sensor values of round `after`."""
        if not self._assumption_time.begin() and not self._is_urgent(self._assumptions):
            return
        commanded = before.effects.actuators if before.effects is not None else ()
        cleared = {sensor for name in commanded for sensor in self._clears.get(name, ())}
        for name, senses, first, then in self._ports:
            if senses:
                first.content = False if name in cleared else usable(before.sensors[name])
                then.content = usable(after.sensors[name])
            else:
                first.content = then.content = actuators[name]
        self._step.asked = before.calls
        self._judge(self._assumptions, self._step, self._assumption_time, after.time, after.round, 0)
        self._assumption_time.end()

    def _contract(self, record: RoundRecord) -> None:
        """Update the verdicts on contracts of extern functions after a round.

        A contract that an event broke is violated. It holds again when the same event runs without a fault."""
        fault = record.fault
        if fault is not None and fault.contract is not None:
            contract = fault.contract
            action = self._action(f"{contract.of} {contract.name}")
            if action == "off":
                return
            made = MonitoredProperty(contract.of, contract.name, f"{fault.file}:{contract.line}", action)
            watched, _ = self._contracts.get(contract, (made, None))
            self._contracts[contract] = watched, record.event
            watched.true = record.round
            self._become(watched, "violated", f"{fault}; the event is discarded", record.time)
        elif fault is None and record.frame is not None:
            for watched, event in self._contracts.values():
                if watched.outcome == "violated" and event in (None, record.event):
                    watched.true = record.round
                    self._become(watched, "held", f"{record.event or 'every guard'} ran through again", record.time)

    def _judge(
        self, due: list[MonitoredProperty], known: Known, budget: CpuBudget, time: float, round_: int, old: int
    ) -> None:
        """Evaluate properties within the time limit of a round, and within the CPU budget if they are only logged.

        `old`: age of the sensor values in rounds, at the start of round `round_`."""
        found: list[tuple[MonitoredProperty, Outcome, str]] = []
        begun: MonitoredProperty | None = None
        try:
            with self._limit(BUDGET * self._delta):
                for watched in sorted(due, key=_urgency):
                    patient = watched.action == "log" and round_ - watched.true < LONGEST_WAIT
                    if patient and budget.spent:
                        break
                    begun = watched
                    found.append((watched, *judged(watched.holds, known)))
        except Overrun:
            if begun is not None and (not found or found[-1][0] is not begun):
                self._overran(begun, time)
        for watched, outcome, why in found:
            watched.due, watched.true = False, round_ - (old if watched.senses else 0)
            if outcome == "violated" and watched.outcome != "violated":
                why = self._evidence(watched, known)
            self._become(watched, outcome, why, time)

    def _overran(self, late: MonitoredProperty, time: float) -> None:
        """Count an overrun of a property. Switch the property off after more than MOST_OVERRUNS overruns."""
        late.overruns += 1
        if late.overruns > MOST_OVERRUNS:
            self._invariants = [w for w in self._invariants if w is not late]
            self._assumptions = [w for w in self._assumptions if w is not late]
            self._off.append(late)
            self._become(late, "no value", f"it takes more than {BUDGET * self._delta * 1e3:.3g} ms: it is off", time)

    def _evidence(self, watched: MonitoredProperty, known: Known) -> str:
        """Return a text with the quantified names and the values that made a property false."""
        trail: Trail = []
        assert self._found is not None
        make = self._found.step if isinstance(watched.what, Assumption) else self._found.fleet
        again = make(len(self._names), trail)
        again.copy_from(known)
        judged(watched.holds, again)
        return evidence(trail, self._names)[1]

    def _become(self, watched: MonitoredProperty, outcome: Outcome, why: str, time: float, stale: bool = False) -> None:
        change = watched.become(outcome, why, self._round, time, stale)
        if change is not None:
            self.verdict = self._demanded()
            self._report(change)

    def _demanded(self) -> SafetyVerdict:
        acting = [watched for watched in self.watched if watched.acting]
        for watched in acting:
            if watched.action in FOR_GOOD:
                return SafetyVerdict("stop", f"{watched.word} is violated: {watched.why}")
        return SafetyVerdict("hold", f"{acting[0].word} is violated") if acting else GO

    def report(self) -> dict[str, Any]:
        """Return the number of properties with each verdict, and the violated properties, for the status report."""
        counts: dict[str, int] = {}
        for watched in self.watched:
            outcome = watched.outcome or "unknown"
            counts[outcome] = counts.get(outcome, 0) + 1
        violated = [watched.report(self._round) for watched in self.watched if watched.outcome == "violated"]
        return {"counts": counts, "violated": violated}

    def summary(self) -> tuple[bool, str]:
        """Return whether a property was ever violated, and a text with all verdicts; "" without properties."""
        counts = ", ".join(f"{count} {outcome}" for outcome, count in self.report()["counts"].items())
        broken = [
            f"{w.word}, {w.violations} times" if w.violations > 1 else w.word for w in self.watched if w.violations
        ]
        return bool(broken), counts + (f"; violated: {'; '.join(broken)}" if broken else "")


def _urgency(watched: MonitoredProperty) -> tuple[bool, int]:
    return watched.action == "log", watched.true


# The functions below explain a false property as text.

MOST_READ = 8  # largest number of values in the text
LONGEST = 120  # largest number of characters in the text of one value


def evidence(trail: Trail, names: tuple[str, ...], why: str = "", pid: int = -1) -> tuple[tuple[str, ...], str]:
    """Return the robots that a false formula is about, and a text with its quantified names and the values it read.

    `why`: end of the text. `pid`: robot of an assumption, or -1."""
    bound = [step for step in trail if isinstance(step, BoundName)]
    robots = [names[b.value] for b in bound if b.robot and _is_pid(b.value, names)]
    if pid >= 0:
        robots = [names[pid]]
    read = list(dict.fromkeys(_read(step) for step in trail if isinstance(step, Read)))
    if len(read) > MOST_READ:
        read = [*read[:MOST_READ], f"and {len(read) - MOST_READ} more"]
    parts = [", ".join(_bound(b, names) for b in bound), "; ".join(read), why]
    return tuple(dict.fromkeys(robots)), ": ".join(part for part in parts if part)


def _is_pid(value: Any, names: tuple[str, ...]) -> bool:
    return isinstance(value, int) and 0 <= value < len(names)


def _bound(bound: BoundName, names: tuple[str, ...]) -> str:
    name = f" ({names[bound.value]})" if bound.robot and _is_pid(bound.value, names) else ""
    return f"{bound.name} = {shown(bound.value)}{name}"


def _read(read: Read) -> str:
    place = "" if read.robot is None else f"[{read.robot}]"
    return f"{read.name}{place} = {shown(read.value)}"


def shown(value: Any) -> str:
    """Return a value as text in Koord's syntax; floats are rounded to six digits."""
    text = _shown(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


def _shown(value: Any) -> str:
    match value:
        case Point(x, y, z):
            return f"({x:.6g}, {y:.6g}, {z:.6g})"
        case bool():
            return str(value)
        case float():
            return f"{value:.6g}"
        case str():
            return f'"{value}"'
        case tuple() | list():
            return f"[{', '.join(map(_shown, value))}]"
        case msgspec.Struct():
            fields = (f"{name}={_shown(getattr(value, name))}" for name in value.__struct_fields__)
            return f"{type(value).__name__}({', '.join(fields)})"
        case _:
            return str(value)


# CPU budget of work with low priority: a share of the CPU time that all other work uses.

MOST = 0.001  # largest budget in seconds of CPU time; unused budget is saved only up to this value
Cpu = Callable[[], float]  # seconds of CPU time used by this thread


class CpuBudget:
    """CPU budget of work with low priority. The caller calls `begin` before the work and `end` after it.

    Without a clock `cpu` the budget is unlimited. Simulations use this, because the behaviour of a simulated robot must
    not depend on the computer."""

    def __init__(self, cpu: Cpu | None, share: float) -> None:
        self._cpu, self._share = cpu, share
        self._left = 0.0
        self._began = self._ended = 0.0 if cpu is None else cpu()

    def begin(self) -> bool:
        """Return whether CPU budget is left. If the caller does no work, it need not call `end`."""
        if self._cpu is None:
            return True
        self._began = self._cpu()
        self._left = min(MOST, self._left + self._share * (self._began - self._ended))
        self._ended = self._began
        return self._left > 0.0

    @property
    def spent(self) -> bool:
        """True if the work has used up the CPU budget."""
        return self._cpu is not None and self._cpu() - self._began >= self._left

    def end(self) -> None:
        if self._cpu is not None:
            self._ended = self._cpu()
            self._left -= self._ended - self._began
