"""One robot's shared memory as it talks to the others: words, closings, questions, ballots, and coming back.

Sends round messages, acknowledgements and retransmissions, and runs the failure detector and view changes.

`memory` is the store, or None while this robot has none that counts: after its process began anew, or after the others
went on without it. Time comes in as ticks, SLOTS in a round.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any

from koordgen.runtime.net.assembly import Assembly
from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.ledger import SETTLED, WANTING
from koordgen.runtime.net.link import Link
from koordgen.runtime.net.speech import Fields
from koordgen.runtime.net.wire import (
    Accept,
    Decided,
    Need,
    Partly,
    Piece,
    Prepare,
    Promise,
    Round,
    StatePiece,
    View,
    Want,
)
from koordgen.runtime.program.runner import NOT_CURRENT
from koordgen.runtime.replication.comeback import Comeback, Store
from koordgen.runtime.replication.memory import AHEAD, Memory
from koordgen.runtime.replication.news import News
from koordgen.runtime.replication.patience import asked, few, helps
from koordgen.runtime.replication.views import Out, Views, Vote, Word, fits, majority

SLOTS = 5  # moments in a round at which what is missing is asked for
ASKED = 3 * SLOTS  # ticks for which a request to be let in counts
HEARD = 2 * SLOTS  # ticks for which a robot counts as one that can be heard

Talk = Any  # one of wire.Message but Hello
Announce = Callable[[View, int, Vote], None]


@dataclass(slots=True)
class _Peer:
    asked: int = -ASKED  # ticks
    told: int = -1
    partly: dict[int, Partly] = field(default_factory=dict)


class Replica:
    """`announce` keeps a view, the last round said to have been applied in it, and a vote, for the time after a
    restart; it is called before any datagram that says so leaves."""

    def __init__(
        self,
        link: Link,
        layout: Layout,
        memory: Memory | None,
        view: View,
        vote: Vote,
        applied: int,
        peer_timeout: int,
        announce: Announce,
    ) -> None:
        self._link, self._speech = link, link.speech
        self._layout = layout
        self.pid, self._n = link.pid, layout.n_sys
        self._peer_timeout = peer_timeout
        self._announce = announce
        self._said = applied
        self._others = tuple([p for p in range(self._n) if p != self.pid])
        self._peers = {p: _Peer() for p in self._others}
        self._heard = [-HEARD] * self._n  # the last message of each; ticks
        self._assembly = Assembly()
        self._stores = Store()
        self._tick = 0
        self._turn = self.pid
        self._asked = -ASKED  # when one asked last to be let in
        self._news = News(self._n)
        self.memory = memory
        self._spare: Memory | None = None  # at the beginning of a view that left this robot out: all others may lose it
        self.comeback = None if memory is not None else Comeback(self.pid, view.number)
        self.views = Views(self.pid, view, vote, self._own_word, self._holds, self._follow, self._save)
        self.emergency = False  # heard of one
        self.returns = 0  # times that the store became another one, or none, instead of going on

    @property
    def out(self) -> bool:
        """Whether this robot does not count at present, or has no store."""
        return self.memory is None

    def busy(self) -> bool:
        """Whether there may be something to do at the next tick."""
        return self.comeback is not None or self.views.busy()

    @property
    def status(self) -> str:
        """Why there is no store, in words."""
        if self.comeback is not None and self.comeback.incarnation(self.views.view) >= 0:
            return f"{NOT_CURRENT}: let in again, gathers the shared store"
        return f"{NOT_CURRENT}: does not count in the fleet, asks to be let in"

    def begin(self, round_: int) -> bool:
        """From now on all is heard in this round, at its first tick; whether nothing is due at that, so no `poll`."""
        tick = (round_ - 1) * SLOTS
        self._tick = self.views.tick = tick
        return not self.emergency and self._calm(round_)

    def alarm(self) -> None:
        """Tell the others at once to come to rest, and from now on with each word."""
        self.emergency = True
        self._speech.round(self._others, self.word(0), ())

    def word(self, round_: int) -> Fields:
        """What this robot says of itself in `round_`; kept before it is said."""
        memory = self.memory
        if memory is None:
            return self.views.view.number, 0, self._said, 0, self.emergency, (0,) * self._n
        if memory.applied != self._said:
            self.keep()
        held = memory.held if memory.applied < round_ - 1 else ()  # else it would tell nothing more
        return memory.view.number, round_, memory.applied, memory.ledger.number[SETTLED], self.emergency, held

    def publish(self, first: int, round_: int, strained: bool) -> None:
        """The own closings from `first` on go to everyone, and to few what they lacked when they last spoke; to none
        where time is short, and what is lacking late rather than lost: see `patience`."""
        memory, word = self.memory, self.word(round_)
        if memory is None:
            closing = None if self.comeback is None else self.comeback.silence(round_, self.views.view)
            self._speech.round(self._others, word, () if closing is None else (closing,))
            return
        calm = strained or not memory.ledger.number[WANTING]
        own = memory.own(first)
        if calm:
            self._speech.round(self._others, word, own)
            return
        known, repeated = {c.round for c in own}, []
        for pid in few(memory.unanswered(), round_):
            repeats = memory.repeat(pid, helps(self.pid, pid, round_, self._n))
            if repeats:
                rest = [c for c in repeats if c.author != self.pid or c.round not in known]
                self._speech.round([pid], word, [*own, *rest], self._peers[pid].partly)
                repeated.append(pid)
        self._speech.round([p for p in self._others if p not in repeated], word, own)

    def tell(self, round_: int) -> None:
        """This robot's word, to everyone."""
        self._speech.round(self._others, self.word(round_), ())

    def confirm(self, round_: int) -> None:
        """Tell those who wait for it that this robot has applied a round."""
        memory = self.memory
        if memory is not None and memory.prompt and (waiting := [p for p in memory.prompt if p != self.pid]):
            self._speech.round(waiting, self.word(round_), ())

    def ask(self, missing: list[int], unaware: list[int], through: int) -> None:
        """Ask for others' closings up to `through` that are missing, of their authors and of one who may hold them, and
        for the word of those whose word is wanted."""
        memory = self.memory
        assert memory is not None
        self._turn += 1
        peers, each = asked(missing, unaware, self._others, self._turn)
        partly, (view, _, applied, *_) = self._assembly.partly(), self.word(through)
        for pid in peers:
            self._link.metrics.repeated(pid)
        for to in each:
            self._speech.say(to, Need, view, through, applied, memory.held, partly)

    def take(self, message: Talk, present: int) -> None:
        """A message of this mission, heard in round `present`."""
        sender = message.head.pid
        self._heard[sender] = self._tick
        if isinstance(message, Round):
            self._round(message, present)
            return
        match message:
            case Need():
                self._need(sender, message, present)
            case Piece():
                self._piece(message, present)
            case Want():
                self._want(sender, message)
            case StatePiece():
                self._state(message)
            case _:
                self._ballot(sender, message)

    def poll(self, tick: int, present: int) -> None:
        """What is due at the beginning of a tick in round `present`."""
        self._tick = self.views.tick = tick
        if self.emergency:
            self._speech.round(self._others, self.word(present), ())
        if tick % SLOTS == 0 and self._calm(present):
            return
        since = tick - HEARD
        heard = 1 + len([p for p in self._others if self._heard[p] > since])
        if heard >= majority(self._n):
            asking = [pid for pid, peer in self._peers.items() if peer.asked > tick - ASKED]
            self._send(self.views.poll(tick, self._doubted(present), asking))
            self._freeze()
        if self.comeback is not None:
            self._send(self.comeback.poll(tick, self.views.view))

    def _calm(self, present: int) -> bool:
        """Whether, as at the beginning of nearly all rounds, nobody is late, and nobody wants another view."""
        calm = not self.busy() and self._asked <= self._tick - ASKED
        return calm and self.memory is not None and self.memory.applied >= present - 1

    def complete(self, present: int) -> None:
        """Note that all closings of round `present` are here, in that round."""
        self._news.complete(present)

    def _doubted(self, present: int) -> list[int]:
        """The members of whom nothing new has come for too long."""
        memory = self.memory
        if memory is None:
            return []
        self._news.note(memory.held, present)
        last = present - self._peer_timeout
        return self._news.silent([p for p in memory.missing(last - 1) if p != self.pid], last)

    def keep(self) -> None:
        """Keep the last applied round, before anyone is told of it or acts on it."""
        memory = self.memory
        if memory is not None and memory.applied != self._said:
            self._said, announce, views = memory.applied, self._announce, self.views
            announce(views.view, self._said, views.vote)

    def _own_word(self) -> Word:
        self.keep()
        return Word(self.views.view.number, self._said, self.memory is not None or self._spare is not None)

    def _holds(self, value: View) -> bool:
        """Whether this robot's vote helps the view to last: who would lose its store by it gives none, nor who has none
        and is not let in. Else what such a view begins with could be in the hands of one robot alone."""
        memory, last = self.memory, value.since - 1
        if memory is None:
            return value.members[self.pid] >= 0
        stays = value.number == memory.view.number + 1 and value.members[self.pid] >= 0
        return stays and (memory.applied >= last or not memory.missing(last))

    def _save(self) -> None:
        self._announce(self.views.view, self._said, self.views.vote)

    def _send(self, outs: Collection[Out]) -> None:
        for to, kind, fields in outs:
            self._speech.say(to, kind, *fields)

    def _round(self, word: Round, present: int) -> None:
        self.emergency = self.emergency or word.emergency
        self._tell(word.head.pid, word.view)
        if self.memory is not None:
            for refused in self.memory.receive(word, present):
                self._link.reject(refused)

    def _need(self, sender: int, message: Need, present: int) -> None:
        self._tell(sender, message.view)
        memory, through = self.memory, message.through
        if memory is None:
            return
        refused = memory.heard(sender, message.view, message.applied, message.held, through, 0, present, asks=True)
        if refused is not None:
            self._link.reject(refused)
            return
        peer = self._peers[sender]
        peer.partly = {p.author: p for p in message.partly}
        ours = message.held[self.pid] >= through  # it wants only what others wrote
        closings = memory.repeat(sender, ours or helps(self.pid, sender, present, self._n))
        if closings or memory.held[self.pid] >= through:  # else ours is still to come, with our word, to all
            self._speech.round([sender], self.word(present), closings, peer.partly)

    def _piece(self, piece: Piece, present: int) -> None:
        memory = self.memory
        if memory is None or piece.author >= self._n:
            return
        found = self._assembly.take(piece, lambda author, round_: memory.held[author] < round_ <= present + AHEAD)
        if isinstance(found, str):
            self._link.reject(found)
        elif found is not None and (refused := memory.take(found, present)) is not None:
            self._link.reject(refused)

    def _want(self, sender: int, want: Want) -> None:
        view, memory = self.views.view, self.memory
        self._tell(sender, want.view)
        if want.incarnation < 0:
            if want.view >= view.members[sender]:
                self._peers[sender].asked = self._asked = self._tick
        elif memory is not None and want.incarnation == view.members[sender] and memory.applied >= view.since - 1:
            self._send(self._stores.answer(sender, want, memory.applied, memory.snapshot, self._speech.room))

    def _state(self, piece: StatePiece) -> None:
        comeback, view = self.comeback, self.views.view
        if comeback is None or comeback.incarnation(view) < 0 or self.views.frozen:
            return  # a promise holds for the store too: nothing beyond what was said in it
        found = comeback.take(piece, self._tick)
        if found is None:
            return
        if isinstance(found, str):
            self._link.reject(found)
            return
        memory = None
        if fits(found.view, self._n) and found.view.number == view.number and found.applied >= view.since - 1:
            memory = Memory.resume(self._layout, self.pid, found)
        if memory is None:
            self._link.reject("store does not fit")
            return
        if comeback.silent is not None and comeback.silent.round > memory.applied:
            memory.close(comeback.silent.round, {}, stopped=False)
        self._spare = self.comeback = None
        self.memory = memory
        self.returns += 1

    def _ballot(self, sender: int, message: Prepare | Promise | Accept | Decided) -> None:
        value = getattr(message, "value", None) or getattr(message, "accepted", None)
        if value is not None and not fits(value, self._n):
            self._link.reject("view does not fit")
            return
        self._send(self.views.take(sender, message))
        self._freeze()

    def _follow(self, before: View) -> None:
        """There is another view."""
        view, memory, own = self.views.view, self.memory, self.views.view.members[self.pid]
        following = view.number == before.number + 1
        if memory is not None and following and own == before.members[self.pid]:
            memory.adopt(view)
        else:
            self._change(view, before, following)
        self._assembly.clear()
        for pid, peer in self._peers.items():
            peer.asked = -ASKED
            if view.members[pid] != before.members[pid]:
                self._news.renew(pid)
        if self.memory is None:
            self._said = min(self._said, view.since - 1)
            if self.comeback is not None:
                self.comeback.silent = None

    def _change(self, view: View, before: View, following: bool) -> None:
        """The store does not go on: it is taken back to where the view begins, or kept aside, or gone."""
        last = self.memory or self._spare
        kept = last.rewound(view) if last is not None and following else None
        if self.memory is not None:
            self.comeback = Comeback(self.pid, before.number, news=self._tick)
        anew = kept is not None and view.members[self.pid] == view.number
        self.returns += anew or self.memory is not None
        self.memory, self._spare = (kept, None) if anew else (None, kept)
        if kept is not None:
            self._said = kept.applied
        if self.memory is not None:
            self.comeback = None

    def _freeze(self) -> None:
        if self.memory is not None:
            self.memory.frozen = self.views.frozen

    def _tell(self, sender: int, view: int) -> None:
        """Let one who is behind know the view."""
        peer = self._peers[sender]
        if view < self.views.view.number and peer.told != self._tick:
            peer.told = self._tick
            self._speech.say([sender], Decided, self.views.view)
