"""Replay of a whole trace, robot by robot.

If the trace contains all robots of the fleet, the replay also compares the shared store.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from koordgen.lang.ir import decl
from koordgen.verify.replay.robot import Counts, Difference, Replay, Unreplayable
from koordgen.verify.replay.store import RecordedWrites, Shown
from koordgen.verify.replay.trace import TraceLine, TraceParts
from koordgen.verify.replay.values import plain


def replay_trace(
    program: decl.Program, externs: Mapping[str, Callable[..., Any]], trace: TraceParts, counts: Counts
) -> Iterator[Difference]:
    """Yield every difference between trace and program, in the trace's order.

    Raises BadTrace or Unreplayable."""
    n_sys = len(trace.robots)
    robots = [Replay(program, externs, pid, n_sys, counts, trace.followed) for pid in range(n_sys)]
    stores = None if trace.own else Stores(program, n_sys, trace)
    views: dict[int, tuple[int, Any]] = {}
    last = 0
    for line in trace.lines():
        if line.record["kind"] == "view":
            yield from _view(line, views)
            continue
        if line.record["kind"] == "init":
            views.clear()  # the views known so far belong to an earlier mission
        robot = robots[line.pid]
        # The previous part of the trace ends in the middle of a record, so records are missing between the parts.
        if trace.cut and line.record["kind"] == "checkpoint":
            robot.skip()
        yield from robot.line(line)
        if robot.saw is not None and stores is not None:
            yield from stores.compared(line, robot.saw)
        last = line.number
    if not trace.cut:
        for robot in robots:
            yield from robot.end(last)


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


class Stores:
    """Shared store after each round, computed from the writes that all robots recorded.

    The writes of commits are applied first, then the writes of plain events by ascending pid. A robot whose process
    ended may have written without a record. So the store is unknown from that round on."""

    def __init__(self, program: decl.Program, n_sys: int, trace: TraceParts) -> None:
        self._writes = RecordedWrites(program, n_sys)
        ends = dict.fromkeys(range(n_sys), 0)
        acted = dict.fromkeys(range(n_sys), 0)  # pid -> last round in which the robot recorded an event
        until = float("inf")
        for line in trace.lines():
            record = line.record
            if record["kind"] in ("stream", "view"):
                continue
            round_ = int(record.get("round", 0))
            restored = record.get("restored")
            if restored and restored["round"] != acted[line.pid]:
                until = min(until, restored["round"] - 1)
            if record.get("event") is not None and not record.get("fault"):
                acted[line.pid] = round_
            ends[line.pid] = max(ends[line.pid], round_)
            self._writes.add_record(line.pid, record)
        self._until = min(until, min(ends.values()))
        self._known: dict[int, Shown] = {
            0: self._writes.after(self._writes.first(), 0)
        }  # round -> shared store after this round

    def compared(self, line: TraceLine, copy: Mapping[str, Any]) -> Iterator[Difference]:
        """Compare a robot's copy of the store at a round's start with the store after the previous round."""
        round_ = int(line.record["round"])
        if round_ - 1 > self._until:
            return
        store = self._of(round_ - 1)
        for name, computed in store.items():
            if name in self._writes.slots:
                for pid, own in enumerate(computed):
                    if plain(copy[name][pid]) != own:
                        yield Difference(
                            line.number, round_, line.pid, f"copy of {name}[{pid}]", plain(copy[name][pid]), own
                        )
            elif plain(copy[name]) != computed:
                yield Difference(line.number, round_, line.pid, f"copy of {name}", plain(copy[name]), computed)

    def _of(self, round_: int) -> Shown:
        latest = max(self._known)
        for r in range(latest + 1, round_ + 1):
            self._known[r] = self._writes.after(self._known[r - 1], r)
        return self._known[round_]
