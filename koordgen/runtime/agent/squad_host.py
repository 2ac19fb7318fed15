"""Host of an outer robot: one inner robot runs the outer agent and keeps its checkpoint in the inner store.

A robot that counts in the view and has not stopped can be the host. If the host is no such robot any more, the one with
the lowest pid takes its place. It claims the record (see squad_record), and starts the outer agent once its claim is
committed. From then on every write of a checkpoint record makes a new version, which the next inner round writes.
Messages of the outer agent that depend on a version leave once that write is committed. Two writes of one round are
ordered by pid, so a host that lost the round to a claim finds another host in the record: it then drops its outer agent
and all messages that wait."""

from __future__ import annotations

import math
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from hashlib import blake2s
from typing import Any, NamedTuple

from koordgen.runtime.agent.held_sender import HeldSender
from koordgen.runtime.agent.machine import Agent
from koordgen.runtime.agent.squad import MODULE, RECORD, STORED, WRITTEN, SensorValues, Squad
from koordgen.runtime.agent.squad_platform import SquadPlatform
from koordgen.runtime.agent.squad_record import HostRecord, RecordStore, claimed, read_record
from koordgen.runtime.config.settings import Settings
from koordgen.runtime.net.sender import Sending
from koordgen.runtime.net.transport import Transport
from koordgen.runtime.ops.journal import Emit
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Transaction
from koordgen.runtime.program.runner import Limit, unlimited
from koordgen.runtime.replication.apply import Store
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.trace.writer import Observe, Trace
from koordgen.runtime.values.clock import Clock
from koordgen.runtime.vehicle.drivers import Drivers

RECEIVE_EVERY = 0.01  # seconds between two polls of the outer agent: the process waits at the inner socket only
LATE = 3  # rounds by which the inner store may lag behind before the outer robot counts as not ready
LONGEST_EVENT = 0.2  # rounds of the inner fleet; time limit of an event of the outer program


class HostSurroundings(NamedTuple):
    """Surroundings of the outer agents on one inner robot.

    settings, key: those of the outer robot. robot: name of the inner robot. boot: boot id of the inner agent. trace:
    function that opens the trace of one outer agent. monitors: see Agent. limit: the time limit of the process for
    events. polls: the process does not wake when a datagram arrives for the outer robot, so it must poll.
    """

    settings: Settings
    key: bytes | None
    robot: str
    boot: bytes
    clock: Clock
    transport: Transport
    trace: Callable[[], Trace]
    emit: Emit
    limit: Limit = unlimited
    monitors: tuple[Observe, ...] = ()
    polls: bool = False


class SquadHost:
    """Second task of an inner agent's process: it runs the outer agent while this robot is the host.

    fleet: the inner fleet with the application `outer`. Call `attach` with the inner agent, then `poll` as often as the
    inner agent's `poll`. `outer` is the outer agent; None if another robot is the host.
    """

    def __init__(self, squad: Squad, inner: FleetProgram, pid: int, delta: float, around: HostSurroundings) -> None:
        self.squad, self.around = squad, around
        self.fleet = squad.with_outer(inner, len(around.settings.peers), self)
        self.outer: Agent | None = None
        self._pid, self._delta = pid, delta
        self._first = self.fleet.instances[-1].number + 1 - inner.robots  # instance of robot 0
        self._sensors = SensorValues(squad, self.fleet)
        self._inner: Agent | None = None
        self._store: RecordStore | None = None
        self._sender: HeldSender | None = None
        self._platform: SquadPlatform | None = None
        self._over = False  # the outer robot has ended
        self._trace: Trace | None = None
        self._stores: deque[tuple[int, Store]] = deque()  # last round in a store, and the store: see _committed_store
        self._known: tuple[Any, HostRecord] = None, HostRecord()

    def attach(self, inner: Agent) -> None:
        """Set the inner agent, which runs `fleet`."""
        self._inner = inner

    @property
    def drivers(self) -> Drivers:
        """Driver of the application's module, for `with_drivers`."""
        return {MODULE: lambda: self}

    def report(self, now: float) -> dict[str, Any]:
        """Return the state of the outer robot for the status report of this robot.

        robot: its name. host: inner pid of its host; -1 if unknown. phase, round, pose, goal: only on the host.
        """
        record = self._record()
        found: dict[str, Any] = {"robot": self.around.settings.robot, "host": -1 if record is None else record.pid}
        if self.outer is not None:
            found |= {"phase": self.outer.phase, "round": self.outer.round, **self.outer.snapshot(now)}
        return found

    def close(self) -> None:
        """End the outer agent, and close its transport and trace. Idempotent."""
        self._drop()
        self.around.transport.close()

    # Driver of the module that the application commands.

    def sense(self) -> dict[str, Any]:
        return {}

    def command(self, actuators: Mapping[str, Any]) -> None:
        """Act on a write of this robot that is committed: start the outer agent, or release its messages."""
        record, version = self._record(), next(iter(actuators.values()))
        if record is None or record.boot != self.around.boot or self._over:
            return
        if self._store is None or self._store.term != record.term:
            self._begin(record)
        if self._sender is not None and self._platform is not None:
            self._sender.release(version)
            self._platform.committed(version)

    # Guards and effects of the application's events; see HostEvents.

    def may_claim(self, s: Transaction) -> bool:
        return self.outer is None and not self._over and self._is_next(read_record(s.shared(RECORD).value))

    def claim(self, s: Transaction) -> None:
        record = read_record(s.shared(RECORD).value)
        s.shared(RECORD).value = claimed(record, self._pid, self.around.boot)
        s.actuator(WRITTEN).value = record.version

    def has_unwritten(self, s: Transaction) -> bool:
        record = read_record(s.shared(RECORD).value)
        store = self._store
        return store is not None and store.is_of(record) and record.version != store.version

    def write(self, s: Transaction) -> None:
        assert self._store is not None and self._platform is not None
        s.shared(RECORD).value = self._store.value()
        for name, value in self._platform.writes().items():
            s.shared(name).value = value
        s.actuator(WRITTEN).value = self._store.version

    # The outer agent.

    def poll(self, now: float) -> float:
        """Poll the outer agent at local time `now` (s). Return the local time by which to call again.

        Never raises: after an error all inner robots stop safely."""
        try:
            return self._poll(now)
        except Exception:
            self._over = True
            self._drop()
            self.around.emit("error", "internal error, please report it:\n" + traceback.format_exc())
            self.stop("internal error of the outer robot")
            return math.inf

    def _poll(self, now: float) -> float:
        state = self._state()
        if state is not None:
            self._committed_store(state)
        if self.outer is not None and self._inner is not None and self._inner.has_emergency:
            self._spread_stop(self.outer)
        elif self.outer is not None and self._is_replaced():
            self._drop()
        if self.outer is None:
            self.around.transport.receive()  # datagrams to the squad are for its host
            return math.inf
        before = self.outer.incarnation
        wake = self.outer.poll(now)
        if self._is_readmitted(before):
            self._drop()
            return math.inf
        if self.outer.done:
            self._over = True
            self._drop()
        return min(wake, now + RECEIVE_EVERY) if self.around.polls else wake

    def _spread_stop(self, outer: Agent) -> None:
        """Announce an emergency stop of the inner fleet to the outer one, unless the outer robot itself stops.

        The inner robots commit nothing any more, so the messages must not wait for that. The outer agent stays until
        this robot's process ends, because it repeats the announcement."""
        if outer.phase == "running" and self._sender is not None:
            self._sender.hold_nothing()
            outer.stop_all("emergency stop of its robots")

    def _begin(self, record: HostRecord) -> None:
        """Start the outer agent with the checkpoint of a record that this robot has claimed."""
        self._drop()
        around = self.around
        store = self._store = RecordStore(record)
        self._platform = SquadPlatform(self.squad, self, self._touched)

        def outlet(sender: Sending) -> Sending:
            self._sender = HeldSender(sender, lambda: store.version, record.version)
            return self._sender

        self._trace = around.trace()
        boot = blake2s(around.boot + record.term.to_bytes(8, "big"), digest_size=8).digest()
        around.transport.receive()
        self.outer = Agent(
            self.squad.program, around.settings, around.key, self._platform, around.clock, around.transport,
            self._trace, around.emit, boot, store, monitors=around.monitors, limit=self._limit,
            properties=self.squad.properties, outlet=outlet,
        )  # fmt: skip
        around.emit("info", f"{around.settings.robot}: hosted by {around.robot} (term {record.term})")

    def _drop(self) -> None:
        """End the outer agent at once. The bodies go on: they belong to the inner fleet."""
        if self.outer is not None:
            self.outer = None
            self.around.emit("info", f"{self.around.settings.robot}: no longer hosted by {self.around.robot}")
        if self._trace is not None:
            self._trace.close()
        self._trace = self._store = self._sender = self._platform = None

    def _touched(self) -> int:
        assert self._store is not None
        self._store.touch()
        return self._store.version

    def _limit(self, seconds: float) -> AbstractContextManager[None]:
        return self.around.limit(min(seconds, LONGEST_EVENT * self._delta))

    def _is_replaced(self) -> bool:
        """Return whether this robot must not host the outer robot any longer."""
        record, store = self._record(), self._store
        if record is None or store is None or self._inner is None or self._inner.phase != "running":
            return True
        return not store.is_of(record)

    def _is_readmitted(self, before: int | None) -> bool:
        """Return whether the outer fleet has admitted this robot again, and another host must have asked for that.

        before: the outer robot's last incarnation. This host cannot have asked while the inner fleet is behind, because
        its messages wait. It would go on with a store without the events of the other host."""
        outer, inner, state = self.outer, self._inner, self._state()
        if outer is None or inner is None or state is None or before is None:
            return False
        return outer.incarnation not in (None, -1, before) and _lag(inner, state) > LATE

    def _record(self) -> HostRecord | None:
        """Return the record in the inner store; None without a store."""
        state = self._state()
        if state is None:
            return None
        value = state.shared[STORED]
        if value is not self._known[0]:
            self._known = value, read_record(value)
        return self._known[1]

    def _state(self) -> StateMachine | None:
        return None if self._inner is None else self._inner.state

    def _is_next(self, record: HostRecord) -> bool:
        """Return whether this robot is to be the host: the present one if it still can, else that of lowest pid."""
        state = self._state()
        if state is None:
            return False
        able = [p for p, m in enumerate(state.view.members) if m >= 0 and self._first + p not in state.stopped]
        return self._pid == (record.pid if record.pid in able else min(able, default=-1))

    # What the outer robot sees of the inner fleet; see squad_platform.InnerFleet.

    def values(self) -> tuple[Mapping[str, Any], float]:
        state, inner = self._state(), self._inner
        found = None if state is None else self._committed_store(state)
        if found is None or inner is None:
            return dict.fromkeys(self.squad.sensors), -math.inf
        applied, store = found
        return self._sensors.of(store), inner.began(applied)

    def _committed_store(self, state: StateMachine) -> tuple[int, Store] | None:
        """Return the newest committed store that this robot has seen, and the last round in it; None without one.

        The store of a round that is not committed may be discarded by a view change, so the outer robot reads none."""
        stores = self._stores
        while stores and stores[-1][0] >= state.applied and stores[-1][1] is not state.shared:
            stores.pop()
        if not stores or stores[-1][0] < state.applied:
            stores.append((state.applied, state.shared))
        while len(stores) > 1 and stores[1][0] <= state.committed:
            stores.popleft()
        return stores[0] if stores[0][0] <= state.committed else None

    def trouble(self) -> str:
        state, inner = self._state(), self._inner
        if state is None or inner is None:
            return "the inner robots have not begun"
        lag = _lag(inner, state)
        return f"the inner fleet is {lag} rounds behind: {inner.hindrance}" if lag > LATE else ""

    def stop(self, why: str) -> None:
        if self._inner is not None and not self._inner.has_emergency:
            self._inner.stop_all(f"{self.around.settings.robot}: {why}")

    @property
    def stopped(self) -> bool:
        return self._inner is not None and self._inner.phase == "stopped"


def _lag(inner: Agent, state: StateMachine) -> int:
    """Return the number of rounds by which the store of an inner robot is behind."""
    return inner.round - 1 - state.applied
