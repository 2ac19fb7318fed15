"""Persistence: writes a robot's state during a mission, and reads the state of an earlier process."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from koordgen.runtime.agent.checkpoint import CheckpointStore, LocalsCodec
from koordgen.runtime.agent.records import Acceptor, Loaded, Mission
from koordgen.runtime.net.codec import encoder
from koordgen.runtime.net.wire import View
from koordgen.runtime.program.program import Life, Program
from koordgen.runtime.replication.messages import HardState, Vote


class Persistence:
    """Persistent state of one robot.

    programs: the program of each instance of the robot.
    past: records that an earlier process of this robot wrote; empty once a new mission begins.
    """

    def __init__(self, store: CheckpointStore, programs: Sequence[Program], n_sys: int) -> None:
        self._store = store
        self._codec = LocalsCodec(programs)
        self._n = n_sys
        self._epoch = b""  # epoch of the persisted mission

        # Last persisted view and vote, and their encodings.
        self._encoded: tuple[View | None, Vote | None, bytes, bytes] = None, None, b"", b""
        self.past = store.load()
        if self.past.mission is not None:
            self._epoch = self.past.mission.epoch

    @property
    def interrupted(self) -> bytes:
        """Epoch of the mission during which an earlier process of this robot died; b"" if there is none."""
        return self.past.mission.epoch if self.past.mission is not None else b""

    def forget(self) -> None:
        """Erase all persisted records of this robot."""
        self.past = Loaded()
        self._epoch = b""
        self._store.clear()

    def mission(self, epoch: bytes, init: Sequence[Life]) -> None:
        """Persist the mission's epoch and the private states after `init`. Call this before the epoch is sent."""
        if epoch not in (b"", self._epoch):
            self._epoch = epoch
            self._store.write(Mission(epoch, 0, b""))
            self.lives(init, 0)

    def lives(self, lives: Sequence[Life], incarnation: int) -> None:
        """Persist the private state of each instance after its last event, and the robot's incarnation."""
        self._store.write(self._codec.encode(lives, incarnation))

    def hard_state(self, state: HardState) -> None:
        """Persist the facts that this robot must not contradict after a restart; see HardState."""
        view, applied, vote = state.view, state.applied, state.vote
        known_view, known_vote, encoded, value = self._encoded
        if view is not known_view or vote is not known_vote:
            encoded, value = encoder.encode(view), b"" if vote.value is None else encoder.encode(vote.value)
            self._encoded = view, vote, encoded, value
        self._store.write(Acceptor(encoded, applied, vote.number, vote.promised, vote.voted, value))

    def past_lives(self) -> list[list[Life]]:
        """Return for each instance the private states that an earlier process has persisted, by ascending round.

        Return an empty list if there is no state."""
        decoded = [self._codec.decode(kept) for kept in self.past.locals]
        states = [lives for lives in decoded if lives is not None]
        found = [{life.round: life for life in of_instance} for of_instance in zip(*states, strict=True)]
        return [[lives[round_] for round_ in sorted(lives)] for lives in found]

    def last_hard_state(self) -> HardState:
        """Return the last hard state of an earlier process, or else the hard state of a new mission."""
        kept = self.past.acceptor
        if kept is None:
            return first_hard_state(self._n)
        view = msgspec.msgpack.decode(kept.view, type=View)
        value = msgspec.msgpack.decode(kept.accepted, type=View) if kept.accepted else None
        return HardState(view, kept.applied, Vote(kept.number, kept.promised, kept.accepted_ballot, value))


def first_hard_state(n_sys: int) -> HardState:
    """Return the hard state at the beginning of a mission: all robots are members."""
    return HardState(View(0, 1, (0,) * n_sys), 0, Vote())
