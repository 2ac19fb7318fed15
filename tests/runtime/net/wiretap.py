"""A fleet whose datagrams are heard and played back, and all that they could change in one of its robots."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from benchmarks.fixtures.fleet import KEY, Fleet, Robot
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.net import codec
from koordgen.runtime.net.codec import encoder
from koordgen.runtime.net.wire import Message, RoundMessage
from koordgen.runtime.program.program import Program
from koordgen.runtime.replication.log import EntryLog
from koordgen.runtime.replication.messages import Vote
from koordgen.runtime.replication.progress import Progress
from tests.runtime.replication.agents import replica_of

CLEO = 2


def _entries(log: EntryLog) -> Any:
    """Return the entries of one robot: those without a gap, and those behind one."""
    later = [encoder.encode(log.later[first].entry) for first in sorted(log.later)]
    return log.held, [encoder.encode(logged.entry) for logged in log.kept], later


def _reports(peer: Progress) -> Any:
    """Return what messages could change of a peer's progress, without the time at which it was heard last."""
    reported = peer.view, peer.applied, peer.wanted, peer.lacks, tuple(peer.held)
    return reported, peer.informed, peer.asked_to_join, str(peer.received)


def snapshot(robot: Robot) -> Any:
    """Return all state that datagrams could change, as plain values. Dropped datagrams are counted elsewhere."""
    agent = robot.agent
    replica = replica_of(robot)
    assert replica is not None and replica.state is not None
    state = replica.state
    return (
        [_entries(log) for log in state.logs],
        (state.committed, {pid: _reports(peer) for pid, peer in replica.peers.items()}),
        state.settled,
        state.applied,
        state.shared,
        str(agent._link.sessions),
        agent._link.epoch,
        list(agent._fleet_clock._exchanges),
        str(agent._joining._others),
        (replica.views.view, replica.views.vote, replica.is_busy),
        str(replica._assembly.received()),
        replica.emergency,
        [peer.heard for peer in replica.peers.values()],  # refused but authentic messages count here
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
        """Let datagrams arrive now. Return how many were dropped, by reason."""
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
        """Return whether the view and the vote are what they were."""
        replica = replica_of(self.victim)
        return replica is not None and (replica.views.view.number, replica.views.vote) == (0, Vote())

    def forged(self, change: Callable[[RoundMessage], Message]) -> bytes:
        """A datagram that the genuine key sealed, from a robot gone wrong: the next one of cleo, changed."""
        sent = [codec.decode(d, KEY) for s, r, d in self.heard if s == CLEO and r == 0]
        last = [m for m in sent if isinstance(m, RoundMessage)][-1]
        head = msgspec.structs.replace(last.head, sequence=last.head.sequence + 1, echoes=())
        return codec.encode(change(msgspec.structs.replace(last, head=head, entries=())), KEY)
