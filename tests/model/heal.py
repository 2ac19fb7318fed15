"""What comes after all trouble: three robots that hear one another, and nothing is lost any more. From every state they
must come together (P7) and go on (P6), in a bounded number of view changes."""

from __future__ import annotations

from dataclasses import dataclass, field

from koordgen.runtime.replication.progress import majority
from tests.model.protocol import Protocol
from tests.model.state import AS_THEY_ARE, Bounds, N, Rules, State, Violation

CHANGES = 4  # view changes after a heal
BEYOND = 2  # rounds that all must have applied beyond those of which anything is known


@dataclass
class Healing:
    """`judge` is for `explore`; every `stride`-th state is healed. Where fewer than a majority have kept a store, the
    mission may end: those states are counted as `poor`."""

    rules: Rules = AS_THEY_ARE
    stride: int = 1
    stores: int = majority(N)
    healed: int = 0
    poor: int = 0
    changes: int = 0  # the most that it took
    _protocol: Protocol = field(init=False)

    def __post_init__(self) -> None:
        self._protocol = Protocol(Bounds(rounds=99, views=99, ballots=99, crashes=0), self.rules)

    def judge(self, state: State, index: int) -> None:
        if index % self.stride:
            return
        if sum(r.store for r in state.robots) < self.stores:
            self.poor += 1
            return
        rounds = max(
            *(len(life.kinds) + life.first - 1 for known in state.lives for life in known),
            *(len(history) for history in state.histories),
        )
        for changes in range(CHANGES + 1):
            state = self._talk(state, rounds + BEYOND)
            if all(r.store and r.applied >= rounds + BEYOND and not r.pending for r in state.robots):
                self.healed += 1
                self.changes = max(self.changes, changes)
                return
            state = self._change(state)
        raise Violation(f"P6, P7: all three talk, {self.stores} have a store, and they get nowhere: {state.robots}")

    def _talk(self, state: State, goal: int) -> State:
        protocol, latest = self._protocol, len(state.decided) - 1
        for pid in range(N):
            if state.robots[pid].view < latest:
                state = protocol.adopt(state, pid, latest)
        for _ in range(2):
            for pid in range(N):
                for _, after in protocol.stores(state, pid):
                    state = after
                    break
                while state.robots[pid].store and state.robots[pid].applied < goal:
                    after_ = next(protocol.apply(state, pid), None)
                    if after_ is None:
                        break
                    state = after_
        return state

    def _change(self, state: State) -> State:
        """One view change, in which all promise and vote, by the first robot that brings one about."""
        for proposer, robot in enumerate(state.robots):
            if robot.store:
                known = len(state.decided)
                state = self._ballot(state, proposer)
                if len(state.decided) > known:
                    break
        return state

    def _ballot(self, state: State, proposer: int) -> State:
        protocol = self._protocol
        number = state.robots[proposer].view + 1
        while True:
            begun = protocol.begin(state, proposer)
            if begun is None:
                return state
            state, ballot = begun, begun.robots[proposer].ballot
            if ballot >= max(r.vote.promised for r in state.robots if r.vote.number == number):
                break
        for pid in range(N):
            state = (protocol.promise(state, pid, ballot) if pid != proposer else None) or state
        values = list(protocol.put(state, proposer))
        if not values:
            return state
        state = values[-1][1]
        for put in list(state.puts):
            if put[:2] == (number, ballot):
                for pid in range(N):
                    state = protocol.vote(state, pid, *put) or state
        return state
