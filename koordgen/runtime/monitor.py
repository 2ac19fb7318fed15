"""A robot's own monitors: what of the program's invariants, port assumptions and contracts it can tell by itself.

An invariant is evaluated at the start of a round, on what is certain then: the robot's own sensors and variables, and
the store as its replica holds it, all of that one moment; of other robots' ports and locals nothing is known. A port
assumption is evaluated from right after a round's event to the next round's sensors. Nothing here raises.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import is_
from typing import Any

from koordgen.runtime.extern import Contract
from koordgen.runtime.property import UNKNOWN, Assumption, Known, Outcome, Properties, Trail, judged
from koordgen.runtime.runner import Limit, Overrun
from koordgen.runtime.safety import GO, Verdict
from koordgen.runtime.settings import Action, Settings
from koordgen.runtime.told import told
from koordgen.runtime.trace import LEFT, Record
from koordgen.runtime.watched import FOR_GOOD, OWN, SENSED, SHARED, Change, Moment, Watched, usable

BUDGET = 0.1  # of delta: what the properties of one round may take, all together
MOST_OVERRUNS = 3  # then a property that takes too long is not looked at any more
GOALS = ("target", "path")

Tell = Callable[[Change], None]


class Monitors:
    """`look` at each round's moment once its closing has left, `hear` each round's record once it is certain. `verdict`
    is what the violated ones demand. `limit` interrupts what takes too long."""

    def __init__(self, found: Properties | None, settings: Settings, tell: Tell, limit: Limit) -> None:
        self.verdict = GO
        self._pid, self._names = settings.pid, tuple(p.name for p in settings.peers)
        self._delta, self._patience = settings.delta, settings.safety.peer_timeout
        self._actions = settings.monitors
        self._tell, self._limit = tell, limit
        self._round = 0
        self._invariants: list[Watched] = []
        self._assumptions: list[Watched] = []
        self._contracts: dict[Contract, tuple[Watched, str | None]] = {}  # broken ones, with the event that broke it
        self._off: list[Watched] = []
        self._last: Record | None = None
        self._actuators: Mapping[str, Any] | None = None  # after the last record's round
        self._found = found
        if found is not None:
            self._watch(found)

    def _watch(self, found: Properties) -> None:
        n, program = len(self._names), found.program
        self._known, self._step = found.fleet(n, None), found.step(n, None)
        self._rows = {name: [UNKNOWN] * n for name in self._known.each}
        self._ports = [p for p in program.ports if p.direction in ("sensor", "actuator")]
        places = {p.name: SENSED for p in program.ports if p.direction == "sensor"}
        places |= {v.name: SHARED for v in program.shared}
        for p in found.properties:
            if p.kind == "invariant" and (action := self._action(p.name)) != "off":
                reads = tuple((name, places.get(name, OWN)) for name in p.reads)
                self._invariants.append(Watched("invariant", p.name, f"{program.source}:{p.line}", action, p, reads))
        for a in found.assumptions:
            if (action := self._action(f"assume {a.module}")) != "off":
                self._assumptions.append(Watched("assume", a.module, f"{program.source}:{a.line}", action, a))

    def _action(self, name: str) -> Action:
        return self._actions.get(name) or self._actions.get("default") or "log"

    @property
    def watched(self) -> list[Watched]:
        """Everything that has an outcome or may get one."""
        contracts = (watched for watched, _ in self._contracts.values())
        return [*self._invariants, *self._assumptions, *self._off, *contracts]

    @property
    def wanted(self) -> bool:
        """Whether moments are to be looked at."""
        return bool(self._invariants or self._assumptions)

    def look(self, moment: Moment | None) -> None:
        """The present round's moment; the same one is looked at once."""
        if moment is None or moment.round == self._round:
            return
        self._round = moment.round
        due = [watched for watched in self._invariants if self._is_due(watched, moment)]
        if not due:
            return
        self._put(due)
        self._judge(due, self._known, moment.time)

    def _is_due(self, watched: Watched, moment: Moment) -> bool:
        """Whether something that it reads has become another; what has not is as true as it was before. What is not
        certain for too long is not known any more."""
        if watched.needs > moment.certain:
            age = moment.round - watched.true
            if age > self._patience and watched.outcome not in (None, "unknown"):
                watched.values = ()
                self._become(watched, "unknown", f"what it reads is {age} rounds old", moment.time)
            return False
        watched.true = moment.round - (moment.age(self._delta) if watched.senses else 0)
        before, watched.values = watched.values, tuple([moment.value(name, place) for name, place in watched.reads])
        same = len(before) == len(watched.values) and all(map(is_, before, watched.values))
        return not same or watched.outcome is None

    def _put(self, due: Sequence[Watched]) -> None:
        known, rows = self._known, self._rows
        for watched in due:
            for (name, place), value in zip(watched.reads, watched.values, strict=True):
                if place == SHARED:
                    known.put({name: value})
                else:
                    rows[name][self._pid] = value if place == OWN else usable(value)
                    known.each[name].values = rows[name]

    def hear(self, record: Record) -> None:
        """A round's record, in their order: it shows of assumptions about the round before, and of contracts."""
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

    def _assume(self, before: Record, after: Record, actuators: Mapping[str, Any]) -> None:
        """Of the round that `before` tells of: from right after its event to the sensors of the next round."""
        step = self._step
        step.pid, step.asked = self._pid, before.calls
        commanded = before.effects.actuators if before.effects is not None else ()
        moved = {module for module, _, port in (name.rpartition(".") for name in commanded) if port in GOALS}
        for port in self._ports:
            name = port.name
            if port.direction == "actuator":
                step.put({name: actuators[name], f"{name}'": actuators[name]})
            else:
                module, _, word = name.rpartition(".")
                first = False if word == "reached" and module in moved else usable(before.sensors[name])
                step.put({name: first, f"{name}'": usable(after.sensors[name])})
        for watched in self._assumptions:
            watched.true = after.round
        self._judge(self._assumptions, step, after.time)

    def _contract(self, record: Record) -> None:
        """An event that a broken contract discarded; or that ran through although one was broken in it before."""
        fault = record.fault
        if fault is not None and fault.contract is not None:
            contract = fault.contract
            action = self._action(f"{contract.of} {contract.name}")
            if action == "off":
                return
            made = Watched(contract.of, contract.name, f"{fault.file}:{contract.line}", action)
            watched, _ = self._contracts.get(contract, (made, None))
            self._contracts[contract] = watched, record.event
            watched.true = record.round
            self._become(watched, "violated", f"{fault}; the event is discarded", record.time)
        elif fault is None and record.frame is not None:
            for watched, event in self._contracts.values():
                if watched.outcome == "violated" and event in (None, record.event):
                    watched.true = record.round
                    self._become(watched, "held", f"{record.event or 'every guard'} ran through again", record.time)

    def _judge(self, due: Sequence[Watched], known: Known, time: float) -> None:
        """What each comes to, within the time that there is; one that takes too long again and again has no value."""
        found: list[tuple[Outcome, str]] = []
        try:
            with self._limit(BUDGET * self._delta):
                for watched in due:
                    found.append(judged(watched.holds, known))
        except Overrun:
            self._overran(due[len(found) :], time)
        for watched, (outcome, why) in zip(due, found, strict=False):
            if outcome == "violated" and watched.outcome != "violated":
                why = self._told(watched, known)
            self._become(watched, outcome, why, time)

    def _overran(self, left: Sequence[Watched], time: float) -> None:
        """The first of these took too long, the others are due again."""
        for watched in left:
            watched.values = ()
        if left and left[0].overruns < MOST_OVERRUNS:
            left[0].overruns += 1
        elif left:
            late = left[0]
            self._invariants = [w for w in self._invariants if w is not late]
            self._assumptions = [w for w in self._assumptions if w is not late]
            self._off.append(late)
            self._become(late, "no value", f"it takes more than {BUDGET * self._delta * 1e3:.3g} ms: it is off", time)

    def _told(self, watched: Watched, known: Known) -> str:
        """The robots and the values that made it false."""
        trail: Trail = []
        assert self._found is not None
        make = self._found.step if isinstance(watched.what, Assumption) else self._found.fleet
        again = make(len(self._names), trail)
        again.take(known)
        judged(watched.holds, again)
        return told(trail, self._names)[1]

    def _become(self, watched: Watched, outcome: Outcome, why: str, time: float) -> None:
        change = watched.become(outcome, why, self._round, time)
        if change is not None:
            self.verdict = self._demanded()
            self._tell(change)

    def _demanded(self) -> Verdict:
        acting = [watched for watched in self.watched if watched.acting]
        for watched in acting:
            if watched.action in FOR_GOOD:
                return Verdict("rest", f"{watched.word} is violated: {watched.why}")
        return Verdict("hold", f"{acting[0].word} is violated") if acting else GO

    def report(self) -> dict[str, Any]:
        """For the status: how many have come to what, and those that are violated."""
        counts: dict[str, int] = {}
        for watched in self.watched:
            outcome = watched.outcome or "unknown"
            counts[outcome] = counts.get(outcome, 0) + 1
        violated = [watched.report(self._round) for watched in self.watched if watched.outcome == "violated"]
        return {"counts": counts, "violated": violated}

    def summary(self) -> tuple[bool, str]:
        """At the robot's end: whether any was ever violated, and what all came to; "" without any."""
        counts = ", ".join(f"{count} {outcome}" for outcome, count in self.report()["counts"].items())
        broken = [
            f"{w.word}, {w.violations} times" if w.violations > 1 else w.word for w in self.watched if w.violations
        ]
        return bool(broken), counts + (f"; violated: {'; '.join(broken)}" if broken else "")
