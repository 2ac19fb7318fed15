"""What a robot keeps of itself during a mission, and what it finds of an earlier process of its own."""

from __future__ import annotations

import msgspec

from koordgen.runtime.agent.records import Acceptor, Loaded, Locals, Mission
from koordgen.runtime.agent.store import Keeper, LocalsCodec
from koordgen.runtime.net.codec import encoder
from koordgen.runtime.net.wire import View
from koordgen.runtime.program.program import Life, Program
from koordgen.runtime.replication.messages import HardState, Vote


class Keeping:
    """`past` is what an earlier process of this robot has kept; empty once a mission of one's own begins."""

    def __init__(self, store: Keeper, program: Program, n_sys: int) -> None:
        self._store = store
        self._codec = LocalsCodec(program)
        self._n = n_sys
        self._epoch = b""  # the mission that is kept
        self._said: tuple[View | None, Vote | None, bytes, bytes] = None, None, b"", b""  # and their encodings
        self.past = store.load()
        if self.past.mission is not None:
            self._epoch = self.past.mission.epoch

    @property
    def interrupted(self) -> bytes:
        """The mission that an earlier process was in when it died; empty for none."""
        return self.past.mission.epoch if self.past.mission is not None else b""

    def forget(self) -> None:
        """Nothing of an earlier process, or of a mission that is over, counts any more."""
        self.past = Loaded()
        self._epoch = b""
        self._store.clear()

    def mission(self, epoch: bytes, init: Life) -> None:
        """Keep to which mission this robot belongs, before it says so."""
        if epoch not in (b"", self._epoch):
            self._epoch = epoch
            self._store.write(Mission(epoch, 0, b""))
            self.life(init, 0)

    def life(self, life: Life, incarnation: int) -> None:
        """Persist the robot's own variables after an event, and the incarnation that ran it."""
        own, actuators = self._codec.encode(life.locals, life.actuators)
        self._store.write(Locals(life.round, incarnation, own, actuators, life.stopped))

    def hard_state(self, state: HardState) -> None:
        """Persist what this robot has committed itself to."""
        view, applied, vote = state.view, state.applied, state.vote
        known_view, known_vote, encoded, value = self._said
        if view is not known_view or vote is not known_vote:
            encoded, value = encoder.encode(view), b"" if vote.value is None else encoder.encode(vote.value)
            self._said = view, vote, encoded, value
        self._store.write(Acceptor(encoded, applied, vote.number, vote.promised, vote.voted, value))

    def lives(self) -> list[Life]:
        """Those that an earlier process has kept, ascending; may be empty."""
        found = []
        for kept in self.past.locals:
            decoded = self._codec.decode(kept.locals, kept.actuators)
            if decoded is not None:
                found.append(Life(kept.round, *decoded, kept.stopped))
        return found

    def last_hard_state(self) -> HardState:
        """Return what an earlier process of this robot has persisted, or the hard state of a new mission."""
        kept = self.past.acceptor
        if kept is None:
            return first_hard_state(self._n)
        view = msgspec.msgpack.decode(kept.view, type=View)
        value = msgspec.msgpack.decode(kept.accepted, type=View) if kept.accepted else None
        return HardState(view, kept.applied, Vote(kept.number, kept.promised, kept.accepted_ballot, value))


def first_hard_state(n_sys: int) -> HardState:
    """Return the hard state at the beginning of a mission: all robots count."""
    return HardState(View(0, 1, (0,) * n_sys), 0, Vote())
