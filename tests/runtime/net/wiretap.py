"""A fleet whose datagrams are heard and played back, and all that they could change in one of its robots."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from benchmarks.fixtures.fleet import KEY, Fleet, Robot
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.net import wire
from koordgen.runtime.net.wire import Message, Round, encoder
from koordgen.runtime.program.program import Program
from koordgen.runtime.replication.log import Log
from koordgen.runtime.replication.views import Vote

CLEO = 2
NOTED = ("view", "applied", "through", "wanting", "gap", "lacks")  # columns of the ledger beside `held` and `number`


def _later(log: Log) -> list[bytes]:
    return [encoder.encode(log.later[first].closing) for first in sorted(log.later)]


def snapshot(robot: Robot) -> Any:
    """All state that datagrams could change, as plain values; what was dropped is counted elsewhere."""
    agent = robot.agent
    replica = agent._replica
    assert replica is not None and replica.memory is not None
    memory = replica.memory
    ledger, columns = memory.ledger, vars(memory.ledger)
    logs = [(log.held, [encoder.encode(e.closing) for e in log.entries], _later(log)) for log in memory._logs]
    return (
        logs,
        (list(ledger.number), memory._words.sure, {k: str(v) for k, v in columns.items() if k in NOTED}),
        memory.settled(),
        memory.applied,
        memory.shared,
        str(agent._link.sessions),
        agent._link.epoch,
        list(agent._fleet_clock._exchanges),
        str(agent._joining._others),
        (replica.views.view, replica.views.vote, str(replica.views._proposal)),
        str({p: (peer.asked, peer.told, peer.partly) for p, peer in replica._peers.items()}),
        str(replica._assembly._begun),
        replica.emergency,
    )


class Wiretap:
    """A mission of three with everything that went over its air."""

    def __init__(self, program: Program = PROGRAM) -> None:
        self.fleet = Fleet(n=3, program=program)
        self.heard: list[tuple[int, int, bytes]] = []
        send = self.fleet.network.send

        def tapped(sender: int, receiver: int, datagram: bytes) -> None:
            self.heard.append((sender, receiver, datagram))
            send(sender, receiver, datagram)

        self.fleet.network.send = tapped  # type: ignore[method-assign]
        self.fleet.boot_all().run_rounds(20)
        self.fleet.run(0.05)  # between publishing and the next asking: nothing is under way
        self.victim = self.fleet.robots[0]
        self.before = snapshot(self.victim)

    def play(self, *datagrams: bytes) -> dict[str, int]:
        """Let them arrive now; what was dropped, by reason."""
        link = self.victim.agent._link
        counted = dict(link.rejected)
        queue = self.fleet.network._queues[0]
        queue[:] = [(self.fleet.time.time, i, d) for i, d in enumerate(datagrams)]
        self.victim.agent.poll(self.victim.clock.now())
        assert not queue
        assert not self.victim.agent._broken
        return {k: v - counted.get(k, 0) for k, v in link.rejected.items() if v != counted.get(k, 0)}

    def unharmed(self) -> bool:
        return bool(snapshot(self.victim) == self.before)

    def unbound(self) -> bool:
        """Whether the view and the vote on the next are what they were."""
        replica = self.victim.agent._replica
        return replica is not None and (replica.views.view.number, replica.views.vote) == (0, Vote())

    def forged(self, change: Callable[[Round], Message]) -> bytes:
        """A datagram that the genuine key sealed, from a robot gone wrong: the next one of cleo, changed."""
        sent = [wire.decode(d, KEY) for s, r, d in self.heard if s == CLEO and r == 0]
        last = [m for m in sent if isinstance(m, Round)][-1]
        head = msgspec.structs.replace(last.head, sequence=last.head.sequence + 1, echoes=())
        return wire.encode(change(msgspec.structs.replace(last, head=head, closings=())), KEY)
