"""Interface between a run and its clock: agent handles, and the clock that drives agents and world.

There are two clocks. In real time (realtime.py) each agent is a process, and the world follows the host's clock. In
lockstep (lockstep/) all agents live in this process on a simulated clock. `Run` (run.py) and its companions (faults,
watcher, live view) use only this interface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from koordgen.runtime.trace.schema import LogLine, Mark, Phase, Round, TraceRecord
from koordgen.runtime.trace.writer import Observe
from targets.sim.base.medium import Medium
from targets.sim.base.scenario import Robot

if TYPE_CHECKING:
    from targets.sim.run.scene import SimulationScene


class AgentHandle(ABC):
    """Handle of one robot's agent, with its state as far as its trace shows it.

    Its files are in `folder`. Times are those of the run's clock (`AgentsAndClock.now`)."""

    def __init__(self, robot: Robot, folder: Path, delta: float) -> None:
        self.robot = robot
        self.trace_file = folder / "trace.jsonl"
        self.log_file = folder / "log.txt"
        self.delta = delta  # seconds in a round of the robot's fleet
        self.asked_to_end = False  # told to stop safely and end
        self.killed = False  # killed by the run, because it did not stop in time
        self.crashed = False  # crashed by `crash` and not restarted yet
        self.phase = Phase("launched")
        self.stopping: Phase | None = None  # the beginning of a safe stop that was not commanded
        self.round = 0
        self.events = 0
        self.first_faults: dict[str, Round] = {}  # the first fault of each application
        self.first_round_start: float | None = None  # start of round 1
        self.last_error = ""
        # Callbacks. In lockstep each is called with every round's record once it is committed; in real time use `look`.
        self.monitors: list[Observe] = []

    @property
    @abstractmethod
    def alive(self) -> bool:
        """True if the agent runs, even if frozen."""

    @property
    @abstractmethod
    def status(self) -> int | None:
        """The exit status, negative for a signal; None while it runs or before its launch."""

    @property
    def process_id(self) -> int | None:
        """Process id while it runs as a process of its own; otherwise None."""
        return None

    @abstractmethod
    def request_end(self) -> None:
        """Command the agent to stop safely and to end."""

    @abstractmethod
    def kill(self) -> None:
        """End the agent and all that it started, at once. Idempotent."""

    @abstractmethod
    def crash(self) -> None:
        """Inject a crash: the agent and its links vanish at once; its persistent state remains.

        It then counts as `crashed`, not as failed. No effect if the agent does not run."""

    @abstractmethod
    def restart(self) -> None:
        """Restart the agent with its persistent state; it appends to its trace.

        A running agent is crashed first."""

    @abstractmethod
    def freeze(self, seconds: float) -> None:
        """Inject a freeze for `seconds`: the agent does not run, and datagrams to it wait or are lost.

        An infinite freeze lasts until `thaw`, at most until `request_end`."""

    @property
    @abstractmethod
    def frozen(self) -> bool:
        """True while the agent is frozen."""

    @abstractmethod
    def thaw(self) -> None:
        """End the agent's freeze, if there is one."""

    @abstractmethod
    def _failed(self, status: int) -> str | None:
        """Return a text for an abnormal exit status, None for a normal one."""

    @abstractmethod
    def look(self) -> list[TraceRecord]:
        """Return the records traced since the last call."""

    def note(self, line: str) -> None:
        """Write a line of the simulator into the robot's log. Raises OSError."""
        with self.log_file.open("ab") as log:
            log.write(f"{line}\n".encode())

    def failure(self) -> str | None:
        """Return why the agent failed, or None.

        None if it runs, ended normally, was told to end before its first record, or was crashed on purpose."""
        status = self.status
        if status is None or self.crashed:
            return None
        self.look()
        if self.killed:
            return "did not stop in time and was killed"
        if status == 0 and not self.asked_to_end and self.round == 0:
            return "ended by itself before round 1"
        return self._failed(status)

    def _record(self, record: TraceRecord) -> None:
        match record:
            case Phase():
                self.phase = record
                if record.phase == "stopping" and not self.asked_to_end and self.stopping is None:
                    self.stopping = record
            case Round():
                if self.first_round_start is None:
                    self.first_round_start = record.time - record.late - (record.round - 1) * self.delta
                self.round = record.round
                if record.fault is not None:
                    self.first_faults.setdefault(record.application, record)
                elif record.event is not None:
                    self.events += 1
            case LogLine(level="error"):
                self.last_error = record.message
            case _:
                pass

    def waiting_for(self) -> str:
        """Return the agent's phase as text."""
        if self.phase.phase == "launched" and not self.alive:
            return self.failure() or "not launched"
        return f"{self.phase.phase}: {self.phase.detail}" if self.phase.detail else self.phase.phase

    def last_lines(self, count: int) -> list[str]:
        """Return the last lines of its log."""
        try:
            with self.log_file.open("rb") as file:
                file.seek(max(0, self.log_file.stat().st_size - 8192))
                text = file.read().decode("utf-8", "replace")
        except OSError:
            return []
        return [line for line in text.splitlines() if line.strip()][-count:]


WorldStep = Callable[[float], None]  # one step of the world, at a time of the run's clock


class AgentsAndClock(Protocol):
    """Agents and clock of a run."""

    @property
    def agents(self) -> Sequence[AgentHandle]:
        """Agent handles of all physical robots, in the order of the scenario."""
        ...

    @property
    def squads(self) -> Mapping[str, AgentHandle]:
        """Agent handle of each squad by its name; the agent of a squad runs on one of its robots."""
        ...

    @property
    def steps(self) -> int:
        """Number of the world's steps so far."""
        ...

    @property
    def late(self) -> int:
        """Number of steps that began more than one step too late."""
        ...

    def scene(self) -> SimulationScene:
        """Create the world, its bodies and the devices for these agents."""
        ...

    def launch(self, scene: SimulationScene) -> None:
        """Start all agents, and the clock. Raises OSError."""
        ...

    def disturb(self, medium: Medium) -> None:
        """Change the network between the agents.

        To change it during the run, call this before the launch, too. Raises OSError."""
        ...

    def now(self) -> float:
        """Return the time of the agents' clock in seconds."""
        ...

    def go_on(self, step: WorldStep) -> None:
        """Advance the run by some milliseconds: due steps of the world, and the agents' work meanwhile."""
        ...

    @property
    def factor(self) -> float:
        """World seconds per host second so far."""
        ...

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the processor's time, by part; empty if unknown."""
        ...

    def close(self) -> None:
        """End all agents and their companions. Idempotent."""
        ...


class WatchedAgents(Protocol):
    """Agents of a fleet, as its watchers see them."""

    @property
    def agents(self) -> Sequence[AgentHandle]:
        """Agent handles by pid."""
        ...

    def now(self) -> float:
        """Return the time of the agents' clock in seconds."""
        ...


class WatchedRun(Protocol):
    """Run of one fleet, as its watchers see it. Times are those of the run's clock."""

    @property
    def conduct(self) -> WatchedAgents: ...

    @property
    def zero(self) -> float | None:
        """Start of the fleet's round 1; None before."""
        ...

    def mark(self, mark: Mark) -> None:
        """Add a record to the merged trace of the fleet; its `t` is a time of the run's clock here."""
        ...

    def finish(self, why: str) -> None:
        """End the mission with this reason."""
        ...
