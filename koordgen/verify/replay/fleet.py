"""Replay of a whole trace, instance by instance.

If the trace contains all robots of the fleet, the replay also compares the shared store.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from koordgen.lang.semantics.composition import System
from koordgen.verify.replay.hosted import HostReplay
from koordgen.verify.replay.robot import Counts, Difference, Replay, Unreplayable
from koordgen.verify.replay.store import RecordedWrites, Shown
from koordgen.verify.replay.trace import TraceLine, TraceParts
from koordgen.verify.replay.values import plain

Externs = Mapping[str, Callable[..., Any]]  # name of an extern function -> function by which the semantics calls it


def replay_trace(
    system: System, externs: Sequence[Externs | None], trace: TraceParts, counts: Counts
) -> Iterator[Difference]:
    """Yield every difference between trace and programs, in the trace's order.

    `externs`: the extern functions of each application; None for the application that hosts an outer robot, whose
    events are not run again. Raises BadTrace or Unreplayable."""
    instances = Instances(system, trace)
    replays: list[Replay | HostReplay] = []
    for instance in system.instances():
        own = externs[instance.application]
        replays.append(
            HostReplay(system, instance) if own is None else Replay(system, instance, own, counts, trace.followed)
        )
    stores = None if trace.own else Stores(system, instances, trace)
    views: dict[int, tuple[int, Any]] = {}
    last = 0
    for line in trace.lines():
        if line.record["kind"] == "view":
            yield from _view(line, views)
            continue
        if line.record["kind"] == "init":
            views.clear()  # the views known so far belong to an earlier mission
        number = instances.of(line)
        replay = replays[number]
        # The previous part of the trace ends in the middle of a record, so records are missing between the parts.
        if trace.cut and line.record["kind"] == "checkpoint":
            replay.skip()
        yield from instances.named(number, replay.line(line))
        if replay.saw is not None and stores is not None:
            yield from instances.named(number, stores.compared(number, line, replay.saw))
        last = line.number
    if not trace.cut:
        for number, replay in enumerate(replays):
            yield from instances.named(number, replay.end(last))


def _view(line: TraceLine, views: dict[int, tuple[int, Any]]) -> Iterator[Difference]:
    """Compare a view record with the views that the trace recorded before.

    All records with the same view number must agree."""
    try:
        number, since, members = int(line.record["number"]), int(line.record["since"]), line.record["members"]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise Unreplayable(line.number, f"a broken record: {error!r}") from None
    first = views.setdefault(number, (since, members))
    if (since, members) != first:
        texts = [f"{who} from round {begins} on" for begins, who in ((since, members), first)]
        yield Difference(line.number, since, line.pid, f"view {number}", *texts)


class Instances:
    """Instances of a fleet in the records of a trace: a record names its robot and its application."""

    def __init__(self, system: System, trace: TraceParts) -> None:
        self.all = system.instances()
        self._names = [application.name for application in system.applications]
        self._is_composed = len(self._names) > 1
        self._numbers = {(i.robot, self._names[i.application]): number for number, i in enumerate(self.all)}
        self._robots = trace.robots

    def of(self, line: TraceLine) -> int:
        """Return the number of the instance that a record is about. Raises Unreplayable."""
        # the only application need not be named
        name = str(line.record.get("application", "")) if self._is_composed else self._names[0]
        number = self._numbers.get((line.pid, name))
        if number is None:
            robot = self._robots[line.pid] or f"the robot with pid {line.pid}"
            raise Unreplayable(line.number, f"{robot} runs no application {name!r} in the fleet")
        return number

    def named(self, number: int, differences: Iterator[Difference]) -> Iterator[Difference]:
        """Yield the differences of an instance. Each gets its robot and, if the fleet has several, its application."""
        instance = self.all[number]
        name = self._names[instance.application] if self._is_composed else ""
        for each in differences:
            yield each._replace(pid=instance.robot, application=name)


class Stores:
    """Shared store after each round, computed from the writes that all robots recorded.

    The writes of commits are applied first, then the writes of plain events, both by instance. A robot whose process
    ended may have written without a record. So the store is unknown from that round on."""

    def __init__(self, system: System, instances: Instances, trace: TraceParts) -> None:
        self._instances = instances.all
        self._writes = RecordedWrites(system)
        ends = dict.fromkeys(range(len(self._instances)), 0)
        acted = dict(ends)  # instance -> last round in which the robot recorded an event of it
        missing: dict[int, int] = {}  # instance -> first round without a record since it last rejoined
        until = float("inf")
        for line in trace.lines():
            record = line.record
            if record["kind"] in ("stream", "view"):
                continue
            number, round_ = instances.of(line), int(record.get("round", 0))
            if round_ > ends[number] + 1:
                missing.setdefault(number, ends[number] + 1)
            restored = record.get("restored")
            if restored and restored["round"] != acted[number]:
                until = min(until, restored["round"] - 1, missing.get(number, round_) - 1)
            if restored:
                missing.pop(number, None)
            if record.get("event") is not None and not record.get("fault"):
                acted[number] = round_
            ends[number] = max(ends[number], round_)
            instance = self._instances[number]
            self._writes.add_record(instance.application, instance.pid, record)
        self._until = min(until, min(ends.values()))
        self._known: dict[int, Shown] = {
            0: self._writes.after(self._writes.first(), 0)
        }  # round -> shared store after this round

    def compared(self, number: int, line: TraceLine, copy: Mapping[str, Any]) -> Iterator[Difference]:
        """Compare an instance's copy of the store at a round's start with the store after the previous round."""
        round_, application = int(line.record["round"]), self._instances[number].application
        if round_ - 1 > self._until:
            return
        store = self._of(round_ - 1)
        for name, key in self._writes.keys(application).items():
            computed, found = store[key], copy[name]
            if key in self._writes.slots and isinstance(found, dict):
                for pid, own in enumerate(computed):
                    if plain(found[pid]) != own:
                        yield Difference(
                            line.number, round_, line.pid, f"copy of {name}[{pid}]", plain(found[pid]), own
                        )
            elif plain(found) != computed:
                yield Difference(line.number, round_, line.pid, f"copy of {name}", plain(found), computed)

    def _of(self, round_: int) -> Shown:
        latest = max(self._known)
        for r in range(latest + 1, round_ + 1):
            self._known[r] = self._writes.after(self._known[r - 1], r)
        return self._known[round_]
