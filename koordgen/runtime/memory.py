"""The replicated shared store of one robot: a pure state machine over closings, without I/O and without a clock.

S_r, the store in round r, is S_1 (initial values and everyone's `init`) with the closings of rounds 1 to r-1 applied
round by round: within a round first the commits, then the plain writes by ascending pid. A robot is current for r when
it holds all of them; then its `shared` is S_r, the same on every robot. What another robot said it lacks is handed out
again, whoever wrote it.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from koordgen.runtime.layout import Layout
from koordgen.runtime.wire import Closing, Write

AHEAD = 8  # rounds that a peer's clock may be ahead of ours
GAPS = 64  # closings kept while one before them is missing, for each author
WINDOW = 256  # closings of one author that not everyone holds; its author writes no more then


@dataclass(frozen=True, slots=True)
class _Entry:
    closing: Closing
    values: Sequence[tuple[int, Any]]


@dataclass(slots=True)
class _Log:
    """One author's closings: `entries` without a gap up to `held`, `later` by their first round beyond a gap."""

    held: int = 0
    entries: list[_Entry] = field(default_factory=list)
    later: dict[int, _Entry] = field(default_factory=dict)

    def append(self, entry: _Entry) -> None:
        closing = entry.closing
        if closing.first <= self.held:
            closing = msgspec.structs.replace(closing, first=self.held + 1)
        if self.entries and not closing.writes:
            last = self.entries[-1].closing
            if not last.writes and last.stopped == closing.stopped:
                closing = msgspec.structs.replace(closing, first=last.first)
                self.entries.pop()
        self.entries.append(_Entry(closing, entry.values))
        self.held = closing.round

    def absorb(self) -> None:
        """Append what is no longer beyond a gap."""
        while self.later:
            first = min(self.later)
            if first > self.held + 1:
                return
            entry = self.later.pop(first)
            if entry.closing.round > self.held:
                self.append(entry)

    def at(self, round_: int) -> _Entry:
        """The entry that covers a round which is held and not forgotten."""
        return self.entries[bisect_left(self.entries, round_, key=lambda e: e.closing.round)]

    def between(self, low: int, high: int) -> list[Closing]:
        start = bisect_left(self.entries, low, key=lambda e: e.closing.round)
        found = []
        for entry in self.entries[start:]:
            closing = entry.closing
            if closing.first > high:
                break
            found.append(closing if closing.first >= low else msgspec.structs.replace(closing, first=low))
        return found

    def forget(self, through: int) -> None:
        count = 0
        while count < len(self.entries) and self.entries[count].closing.round <= through:
            count += 1
        del self.entries[:count]


@dataclass(slots=True)
class _Statement:
    """What a peer last said about itself: held everyone's closings up to `held`, wanted them up to `through`."""

    held: list[int]
    through: int = 0
    answered: bool = True


class Memory:
    """One robot's replica. `inits` are the round-0 closings of all robots, already read once by the same layout."""

    def __init__(self, layout: Layout, pid: int, inits: Sequence[Closing]) -> None:
        self._layout = layout
        self._pid = pid
        n = layout.n_sys
        self._logs = [_Log() for _ in range(n)]
        self._statements = {p: _Statement([0] * n) for p in range(n) if p != pid}
        self._settled = 0
        self.applied = 0  # `shared` is S_{applied + 1}
        self.shared: Mapping[str, Any] = layout.initial()
        self.stopped: dict[int, int] = {}  # pid -> the round it stopped in
        self._apply([_Entry(c, layout.read(c) or ()) for c in sorted(inits, key=lambda c: c.author)], 0)

    @property
    def held(self) -> tuple[int, ...]:
        """For each robot the last round up to which its closings are held without a gap."""
        return tuple(log.held for log in self._logs)

    @property
    def settled(self) -> int:
        """A round up to which all robots hold everything."""
        return self._settled

    @property
    def crowded(self) -> bool:
        """Whether this robot must write nothing because others lag too far behind to be repeated more."""
        return len(self._logs[self._pid].entries) >= WINDOW

    @property
    def laggard(self) -> int:
        """The peer that, by its own words, holds least."""
        return min(self._statements, key=lambda p: min(self._statements[p].held), default=self._pid)

    @property
    def all_stopped(self) -> int | None:
        """The round by which every robot had stopped, as far as closings are applied."""
        return max(self.stopped.values()) if len(self.stopped) == self._layout.n_sys else None

    def close(self, round_: int, shared: Mapping[str, Any], stopped: bool, commit: bool = False) -> None:
        """Close the own rounds up to `round_`, which wrote `shared`, as a commit or plainly; earlier ones not closed
        yet had no writes."""
        writes = self._layout.writes(shared)
        log = self._logs[self._pid]
        if round_ > log.held + 1 and writes:
            log.append(_Entry(Closing(self._pid, 0, log.held + 1, round_ - 1, stopped), ()))
        first = round_ if writes else log.held + 1
        closing = Closing(self._pid, 0, first, round_, stopped, lock=0 if commit and writes else -1, writes=writes)
        log.append(_Entry(closing, self._layout.read(closing) or ()))

    def take(self, closing: Closing, present: int) -> str | None:
        """Take a closing heard in round `present`; None, or why it is refused. A known one is no news, no error."""
        values = self._layout.read(closing)
        if values is None or closing.first < 1:
            return "closing does not fit"
        if closing.author == self._pid:
            return None if closing.round <= self._logs[self._pid].held else "closing of ours that we did not write"
        if closing.round > present + AHEAD:
            return "closing too far ahead"
        log = self._logs[closing.author]
        if closing.round <= log.held:
            return None
        if len(log.entries) >= 2 * WINDOW or (closing.first > log.held + 1 and len(log.later) >= GAPS):
            return "no room for a closing"
        kept = tuple(Write(w.index, msgspec.Raw(bytes(w.value))) for w in closing.writes)  # not the whole datagram
        entry = _Entry(msgspec.structs.replace(closing, writes=kept), values)
        if closing.first > log.held + 1:
            known = log.later.get(closing.first)
            if known is None or known.closing.round < closing.round:
                log.later[closing.first] = entry
            return None
        log.append(entry)
        log.absorb()
        return None

    def heard(self, pid: int, held: Sequence[int], through: int, settled: int, present: int) -> str | None:
        """Note what a peer said it holds; None, or why that cannot be."""
        if len(held) != self._layout.n_sys or max(*held, through, settled) > present + AHEAD:
            return "statement does not fit"
        statement = self._statements[pid]
        statement.held = [max(old, new) for old, new in zip(statement.held, held, strict=True)]
        if through >= statement.through:
            statement.through = through
            statement.answered = False
        self._settle(settled)
        return None

    def advance(self, round_: int) -> bool:
        """Go through the boundaries before `round_` as far as closings are held; True iff current for it."""
        while self.applied < round_ - 1 and all(log.held > self.applied for log in self._logs):
            entries = [log.at(self.applied + 1) for log in self._logs]
            silent = all(not e.closing.writes for e in entries)
            through = min(round_ - 1, min(e.closing.round for e in entries)) if silent else self.applied + 1
            self._apply(entries, through)
        if not self._statements:
            self._settle(self.applied)
        return self.applied >= round_ - 1

    def missing(self, through: int) -> list[int]:
        """The robots whose closings up to `through` are not all held."""
        return [p for p, log in enumerate(self._logs) if log.held < through]

    def own(self, first: int) -> list[Closing]:
        """The own closings from `first` on."""
        log = self._logs[self._pid]
        return log.between(first, log.held)

    def repeat(self, pid: int) -> list[Closing]:
        """What a peer lacked when it last spoke, and we hold: once for each time it says so. Its turn begins with our
        own closings, so that several robots that answer at once begin with different ones."""
        statement = self._statements[pid]
        if statement.answered:
            return []
        statement.answered = True
        n = len(self._logs)
        found: list[Closing] = []
        for author in (*range(self._pid, n), *range(self._pid)):
            low = max(statement.held[author], self._settled) + 1
            found += self._logs[author].between(low, statement.through)
        return found

    def _settle(self, told: int) -> None:
        """Forget what everyone holds, by the peers' own statements or (`told`) by one who knows it from all."""
        least = min((min(s.held) for s in self._statements.values()), default=self.applied)
        self._settled = max(self._settled, min(max(least, told), min(self.held)))
        for log in self._logs:
            log.forget(min(self._settled, self.applied))

    def _apply(self, entries: Sequence[_Entry], through: int) -> None:
        """Apply one closing of each robot, given in ascending pid: first the commits, then the plain writes, so that
        the highest pid wins a plain conflict, also over that round's commit."""
        names, is_slots = self._layout.names, self._layout.is_slots
        changed: dict[str, Any] = {}
        for entry in sorted(entries, key=lambda e: e.closing.lock < 0):
            author = entry.closing.author
            for index, value in entry.values:
                name = names[index]
                if not is_slots[index]:
                    changed[name] = value
                else:
                    slots = changed.get(name)
                    if slots is None:
                        slots = changed[name] = list(self.shared[name])
                    slots[author] = value
            if entry.closing.stopped:
                self.stopped.setdefault(author, max(entry.closing.first, self.applied + 1) if through else 0)
        if changed:
            frozen = {k: tuple(v) if is_slots[names.index(k)] else v for k, v in changed.items()}
            self.shared = {**self.shared, **frozen}
        self.applied = through
