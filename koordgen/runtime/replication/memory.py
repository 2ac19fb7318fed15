"""One robot's replica of the shared store: a pure state machine over closings, without I/O and without a clock.

S_r is S_1 (initial values and everyone's `init`) with the closings of rounds 1 to r-1 applied, of those who count in
each (`View`): first one commit for each lock, then the plain writes by ascending pid. Who has applied r-1 has S_r, as
all have. A round is stable once a majority has said to have applied it: no later view leaves it out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.ledger import LACKING, SETTLED, Ledger
from koordgen.runtime.net.wire import Closing, Round, State, View
from koordgen.runtime.replication.log import GAPS, Entry, Log, detached
from koordgen.runtime.replication.outcome import Past, all_of, counting
from koordgen.runtime.replication.views import Course
from koordgen.runtime.replication.words import Words

AHEAD = 8  # rounds that a peer's clock may be ahead of ours
RECENT = 8  # so many closings of one author may keep the datagrams that they came in: most are soon forgotten
FORGET_EVERY = 4  # rounds: to go through all logs costs more than to keep some closings a little longer
SETTLE_AFTER = 3  # rounds: so far may be behind what is known of what all hold
WINDOW = 256  # closings of one author that not everyone holds; its author writes no more then


class Memory:
    """One robot's replica, beginning with a store that all rounds up to `applied` are in."""

    def __init__(
        self,
        layout: Layout,
        pid: int,
        view: View,
        shared: Mapping[str, Any],
        applied: int = 0,
        stopped: Mapping[int, int] | None = None,
        acted: Sequence[int] = (),
    ) -> None:
        self._layout = layout
        self._pid = pid
        self._course = Course(view)
        self.view = view  # the latest
        n = self._n = layout.n_sys
        self.ledger = Ledger(pid, n, applied)
        self._number = self.ledger.number  # LACKING: members whose closing of round applied + 1 is not here
        self._logs = [Log(self.ledger, p) for p in range(n)]
        self._words = Words(self.ledger)
        self.frozen = False
        self._forgotten = 0  # what all hold was dropped up to here
        self.applied = applied  # `shared` is S_{applied + 1}
        self.shared = shared
        self.stopped = dict(stopped or {})  # pid -> the round it stopped in
        self.acted = list(acted) or [0] * n  # the last round in which an event counted
        self.won = 0  # the last round in which a commit of ours counted
        self.unfit = 0  # patches that fitted no value: a fault of their author's, dropped by everyone alike
        self._past = Past(applied, shared, self.acted)
        self.prompt: tuple[int, ...] = ()  # who waits to hear that the last applied round was applied
        self._look()

    @classmethod
    def begin(cls, layout: Layout, pid: int, view: View, inits: Sequence[Closing]) -> Memory:
        """At round 1, from the round-0 closings of all robots, already read once by the same layout."""
        memory = cls(layout, pid, view, layout.initial())
        memory._apply([Entry(c, layout.read(c) or ()) for c in sorted(inits, key=lambda c: c.author)], 0)
        return memory

    @classmethod
    def resume(cls, layout: Layout, pid: int, state: State) -> Memory | None:
        """From what another robot handed over; None when it does not fit the program."""
        n = layout.n_sys
        shared = layout.unpack(state.values)
        if shared is None or len(state.stopped) != n or len(state.acted) != n or len(state.view.members) != n:
            return None
        stopped = {p: r for p, r in enumerate(state.stopped) if r >= 0}
        return cls(layout, pid, state.view, shared, state.applied, stopped, state.acted)

    @property
    def held(self) -> tuple[int, ...]:
        """For each robot the last round up to which its closings are held without a gap."""
        return tuple(self.ledger.held)

    def settled(self) -> int:
        """All members hold everything up to here."""
        return self._number[SETTLED]

    def unanswered(self) -> Sequence[int]:
        """The peers that by their last word lack something, and were not sent it yet."""
        return self._words.unanswered()

    def crowded(self) -> bool:
        """Whether this robot must write nothing because others lag too far behind to be repeated more."""
        return (
            self.ledger.held[self._pid] - self._number[SETTLED] > WINDOW // 2 and len(self._logs[self._pid]) >= WINDOW
        )

    @property
    def laggard(self) -> int:
        """The member that, by its own words, has applied least."""
        applied = self._words.applied(self.view)
        return min(applied, key=lambda p: applied[p], default=self._pid)

    @property
    def all_stopped(self) -> int | None:
        """The round by which every member had stopped, as far as closings are applied."""
        rounds = [self.stopped.get(p) for p, m in enumerate(self.view.members) if m >= 0]
        return None if None in rounds else max(r for r in rounds if r is not None)

    def lacking(self) -> int:
        """How many closings are missing that the next round to be applied needs."""
        return self._number[LACKING]

    def rewound(self, view: View) -> Memory | None:
        """The replica as it was when the rounds before `view` had been applied, for one that had gone further; None
        when that is not known any more."""
        last = view.since - 1
        known = self._past.at(last)
        if known is None or self.applied < last:
            return None
        stopped = {p: r for p, r in self.stopped.items() if r <= last}
        memory = Memory(self._layout, self._pid, view, known[0], last, stopped, known[1])
        memory.ledger, memory._number, memory._logs, memory._words = self.ledger, self._number, self._logs, self._words
        memory._words.renew()
        memory._forget(self.view, view)
        for log in memory._logs:
            log.skip(last)  # also of those who did not count
        memory._look()
        return memory

    def adopt(self, view: View) -> None:
        """Go by the next view. Closings of those who no longer count, or count anew, are dropped from its beginning
        on."""
        self._forget(self.view, view)
        self._course.append(view)
        self.view = view
        self.frozen = False
        self._words.renew()
        self._look()

    def _forget(self, before: View, view: View) -> None:
        """Drop what was heard of those who no longer count, or count anew, beyond the beginning of a view."""
        for pid, (old, new) in enumerate(zip(before.members, view.members, strict=True)):
            if old != new:
                self._logs[pid].cut(view.since - 1)
                if pid != self._pid:
                    self._words.forget(pid)

    def close(self, round_: int, shared: Mapping[str, Any], *, stopped: bool, acted: bool = False, prompt: bool = False,
              lock: int = -1) -> None:  # fmt: skip
        """Close the own rounds up to `round_`, in which an event (`lock` is -1 for a plain one) wrote `shared`; earlier
        ones not closed yet had none."""
        before, single = self.ledger.held[self._pid], bool(shared) or acted or lock >= 0
        if single and round_ > before + 1:
            self.close(before := round_ - 1, {}, stopped=stopped)
        first = round_ if single else before + 1
        incarnation = self.view.members[self._pid]
        writes, values = self._layout.written(shared, self.shared, self._pid) if shared else ((), ())
        closing = Closing(self._pid, incarnation, first, round_, stopped, acted, prompt, lock, writes)
        self._logs[self._pid].take(Entry(closing, values or ()))
        self._heard(self._pid, before)

    def _heard(self, author: int, before: int) -> None:
        """More of an author's closings is held than `before`."""
        if before <= self.applied < self.ledger.held[author] and author in self._course.members:
            self._number[LACKING] -= 1

    def take(self, closing: Closing, present: int) -> str | None:
        """Take a closing heard in round `present`; None, or why it is refused. A known one is no news, no error."""
        author, round_ = closing.author, closing.round
        if author >= self._n:
            return "closing does not fit"
        log, before = self._logs[author], self.ledger.held[author]
        if round_ <= before:
            return None
        if not 1 <= closing.first <= round_:
            return "closing does not fit"
        if round_ > present + AHEAD:
            return "closing too far ahead"
        if not self._course.single or self.view.members[author] != closing.incarnation:
            fitting = self._course.of_this_life(closing)
            if fitting is None:
                return "closing of another view"
            closing = fitting
        if author == self._pid:
            return "closing of ours that we did not write"
        values = self._layout.read(closing)
        if values is None:
            return "closing does not fit"
        count, next_ = len(log), closing.first <= before + 1
        if count >= 2 * WINDOW or (not next_ and len(log.later) >= GAPS):
            return "no room for a closing"
        few = count < RECENT and next_
        log.take(Entry(closing if few else detached(closing), values))
        self._heard(author, before)
        return None

    def receive(self, message: Round, present: int) -> list[str]:
        """Take the closings and the word of a round message; returns why any of them is refused."""
        sender, round_ = message.head.pid, message.round
        refused = [self.take(closing, present) for closing in message.closings]
        through, plain = round_ - 1 if round_ else 0, self._course.single and message.view == self.view.number
        plain = plain and not message.held and message.applied <= present + AHEAD
        plain = plain and message.settled <= self._number[SETTLED]
        if not plain or not self._words.content(sender, message.view, message.applied, through):
            refused.append(
                self.heard(
                    sender, message.view, message.applied, message.held, through, message.settled, present, asks=False
                )
            )
        return [why for why in refused if why is not None]

    def heard(self, pid: int, view: int, applied: int, held: Sequence[int], through: int, settled: int, present: int,
              asks: bool) -> str | None:  # fmt: skip
        """Note a peer's word (an empty `held`: everyone's up to `applied`); `asks`: it wants what it lacks at once.
        None, or why the word cannot be."""
        last = present + AHEAD
        if through > last or settled > last or applied > last or (held and (len(held) != self._n or max(held) > last)):
            return "word does not fit"
        ours = view == self.view.number
        self._words.hear(pid, ours, view, applied, held, through, asks)
        if ours and settled > self._number[SETTLED]:
            self._settle(min(settled, self.applied))
        return None

    def advance(self, round_: int) -> bool:
        """Go through the boundaries before `round_` as far as closings are held; True iff an event may run in it: all
        before it is there, and it is not itself behind this robot, as for one that was let in within a round."""
        number = self._number
        while self.applied < round_ - 1 and not number[LACKING]:
            if self.frozen and self.applied >= self.view.since - 1:
                break
            self._pass_each(self.applied + 1, round_ - 1)
        return self.applied == round_ - 1 and not self.frozen and self.view.members[self._pid] >= 0

    def stable(self, round_: int) -> bool:
        """Whether no view can leave out what was done up to this round."""
        return round_ <= self._words.sure or self._words.stable(round_, self.applied, self.view)

    def unaware(self, round_: int) -> list[int]:
        """The members that have not said to have applied a round."""
        return self._words.unaware(round_, self.view)

    def missing(self, through: int) -> list[int]:
        """The members whose closings up to `through` are not all held."""
        if through <= self.applied and self._course.single:
            return []
        members = self.view.members
        return [p for p, held in enumerate(self.ledger.held) if held < through and members[p] >= 0]

    def own(self, first: int) -> list[Closing]:
        """The own closings from `first` on."""
        return self._logs[self._pid].between(first, self.ledger.held[self._pid])

    def repeat(self, pid: int, helps: bool = True) -> list[Closing]:
        """What a peer lacked when it last spoke, and we hold: once for each time it says so; unless this robot `helps`,
        only its own. Those are first, so that several robots that answer at once begin with different ones."""
        wanted = self._words.answer(pid) if self.view.members[pid] >= 0 else None
        if wanted is None:
            return []
        held, through = wanted
        found: list[Closing] = []
        for author in (*range(self._pid, self._n), *range(self._pid)) if helps else (self._pid,):
            low = max(held[author], self._number[SETTLED]) + 1
            if low <= through:
                found += self._logs[author].between(low, through)
        return found

    def snapshot(self) -> State:
        """The store for one who comes in."""
        stopped = tuple([self.stopped.get(p, -1) for p in range(self._n)])
        return State(self._course.first, self.applied, self._layout.pack(self.shared), stopped, tuple(self.acted))

    def _settle(self, through: int) -> None:
        """Forget what everyone holds."""
        if through > self._number[SETTLED]:
            self._number[SETTLED] = through
            if through >= self._forgotten + FORGET_EVERY:
                self._forgotten = through
                for log in self._logs:
                    if log.entries:
                        log.forget(through)

    def _look(self) -> None:
        """After a round was applied or the view has changed: what is lacking now, and who is in from when."""
        if not self._course.single:
            self._course.pass_over(self._logs)
            self._course.drop(self.applied)
        self._count()

    def _count(self) -> None:
        """How many closings of the next round are lacking."""
        number, held, applied = self._number, self.ledger.held, self.applied
        number[LACKING] = len([p for p in self._course.members if held[p] <= applied])

    def _pass_each(self, through: int, last: int) -> None:
        """Go on by a round, of which each closing is looked at; if nothing happened in it, by all such up to `last`."""
        entries = [self._logs[p].at(through) for p in self._course.members]
        if not entries[0].closing.acted and not any(e.single for e in entries):
            through = min(last, self._course.end(through), min([e.closing.round for e in entries]))
        self._apply(entries, through)

    def _apply(self, entries: Sequence[Entry], through: int) -> None:
        """Apply one closing of each member, given in ascending pid: first the commits, then the plain writes, so that
        the highest pid wins a plain conflict, also over that round's commit."""
        waiting, contended = list[int](), False
        for entry in entries:
            closing = entry.closing
            if closing.prompt and closing.round == through:
                waiting.append(closing.author)
            if closing.lock >= 0:
                contended = True
        self.prompt = tuple(waiting)
        if contended:
            commits, others = counting(entries, through, self._n)
            if any(e.closing.author == self._pid for e in commits):
                self.won = through
            entries = [*commits, *others]
        shared, acted, unfit = all_of(self._layout, entries, self.shared, self.acted)
        self.unfit += unfit
        for closing in [e.closing for e in entries if e.closing.stopped]:
            self.stopped.setdefault(closing.author, max(closing.first, self.applied + 1) if through else 0)
        self._pass(through, shared, acted)
        if self._course.single:
            self._count()
        else:
            self._look()
        if through >= self._number[SETTLED] + SETTLE_AFTER:
            self._settle(min([through, *self._words.applied(self.view).values()]))

    def _pass(self, through: int, shared: Mapping[str, Any], acted: list[int]) -> None:
        """Go on to the store after a round."""
        self.applied = through
        if shared is not self.shared or acted is not self.acted:
            self.shared, self.acted = shared, acted
            self._past.add(through, shared, acted, self.stable)
