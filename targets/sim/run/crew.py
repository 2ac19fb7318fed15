"""The seam between a run and its clock: what a run needs of its agents, and of what moves time.

There are two: real time (realtime.py), where each agent is a process and the world keeps up with the host's clock, and
lockstep (lockstep/), where all agents live in this process on a clock that the run owns. `Run` (run.py) knows no more
than what stands here; so do those who go along with a run (`Companion`): faults, watching, the live view.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from koordgen.runtime.trace.schema import Log, Phase, Round, TraceRecord
from koordgen.runtime.trace.writer import Observe
from targets.sim.base.medium import Medium
from targets.sim.base.scenario import Robot

if TYPE_CHECKING:
    from targets.sim.run.stage import Stage


class Agent(ABC):
    """One robot's agent, and what is known of it by what it traced; its files are in `folder`. Times are those of the
    run's clock (`Conduct.now`)."""

    def __init__(self, robot: Robot, folder: Path, delta: float) -> None:
        self.robot = robot
        self.trace_file = folder / "trace.jsonl"
        self.log_file = folder / "log.txt"
        self._delta = delta
        self.told = False  # to come to rest
        self.killed = False  # by the run, for it did not come to rest
        self.crashed = False  # on purpose, by `crash`, and not restarted yet
        self.phase = Phase("launched")
        self.resting: Phase | None = None  # when it came to rest unasked
        self.round = 0
        self.events = 0
        self.first_fault: Round | None = None
        self.first_round_start: float | None = None  # of round 1
        self.last_error = ""
        # In lockstep each gets every round's record as soon as it is certain; in real time there is only `look`.
        self.monitors: list[Observe] = []

    @property
    @abstractmethod
    def alive(self) -> bool:
        """Whether it runs (a frozen one does)."""

    @property
    @abstractmethod
    def status(self) -> int | None:
        """The exit status, negative for a signal that ended it; None while it runs or was never launched."""

    @property
    def process_id(self) -> int | None:
        """Of a process of its own, while it runs; else None."""
        return None

    @abstractmethod
    def tell_end(self) -> None:
        """Tell it to come to rest and end."""

    @abstractmethod
    def kill(self) -> None:
        """End it and what it started, at once. Idempotent."""

    @abstractmethod
    def crash(self) -> None:
        """A fault: it is gone from one moment to the next, its links with it, and leaves what it kept on its disk. It
        counts as `crashed`, and not as failed. Nothing happens to one that does not run."""

    @abstractmethod
    def restart(self) -> None:
        """After a crash: its process begins anew, with what it kept, and appends to its trace. A fault, too: one that
        runs is crashed first."""

    @abstractmethod
    def freeze(self, seconds: float) -> None:
        """A fault: it does not run for so long, while the world goes on and what is sent to it waits or is lost. An
        infinite freeze lasts until `thaw`, at most until it is told to end."""

    @property
    @abstractmethod
    def frozen(self) -> bool:
        """True if a freeze goes on."""

    @abstractmethod
    def thaw(self) -> None:
        """End its freeze, if there is one."""

    @abstractmethod
    def _failed(self, status: int) -> str | None:
        """What a status other than a good one says, in words; None: it was a good one."""

    @abstractmethod
    def look(self) -> list[TraceRecord]:
        """Take what it traced since the last look."""

    def note(self, line: str) -> None:
        """Write a line of the simulator's into the robot's log. Raises OSError."""
        with self.log_file.open("ab") as log:
            log.write(f"{line}\n".encode())

    def failure(self) -> str | None:
        """Why its end was not a good one, or None: it runs on, ended well, was told to before it traced anything, or
        was crashed on purpose."""
        status = self.status
        if status is None or self.crashed:
            return None
        self.look()
        if self.killed:
            return "did not come to rest in time and was killed"
        if status == 0 and not self.told and self.round == 0:
            return "ended by itself before round 1"
        return self._failed(status)

    def _take(self, record: TraceRecord) -> None:
        match record:
            case Phase():
                self.phase = record
                if record.phase == "resting" and not self.told and self.resting is None:
                    self.resting = record
            case Round():
                if self.first_round_start is None:
                    self.first_round_start = record.time - record.late - (record.round - 1) * self._delta
                self.round = record.round
                if record.fault is not None:
                    self.first_fault = self.first_fault or record
                elif record.event is not None:
                    self.events += 1
            case Log(level="error"):
                self.last_error = record.message
            case _:
                pass

    def waiting_for(self) -> str:
        """Where it stands, in words."""
        if self.phase.phase == "launched" and not self.alive:
            return self.failure() or "not launched"
        return f"{self.phase.phase}: {self.phase.detail}" if self.phase.detail else self.phase.phase

    def last_lines(self, count: int) -> list[str]:
        """The end of its log."""
        try:
            with self.log_file.open("rb") as file:
                file.seek(max(0, self.log_file.stat().st_size - 8192))
                text = file.read().decode("utf-8", "replace")
        except OSError:
            return []
        return [line for line in text.splitlines() if line.strip()][-count:]

    def fault_text(self) -> str:
        return str(self.first_fault.fault) if self.first_fault else ""


Step = Callable[[float], None]  # one step of the world at a time of the run's clock


class Conduct(Protocol):
    """A run's agents and its clock."""

    @property
    def agents(self) -> Sequence[Agent]:
        """By pid."""
        ...

    @property
    def steps(self) -> int:
        """How many the world has made."""
        ...

    @property
    def late(self) -> int:
        """How many of them were made more than a step too late."""
        ...

    def stage(self) -> Stage:
        """Make the world, its bodies and the devices that these agents will find."""
        ...

    def launch(self, stage: Stage) -> None:
        """Start all agents, and the clock. Raises OSError."""
        ...

    def disturb(self, medium: Medium) -> None:
        """From now on the network between the agents is like that. Whoever wants to do so later does it before the
        launch, too. Raises OSError."""
        ...

    def now(self) -> float:
        """Seconds on the clock by which agents live."""
        ...

    def go_on(self, step: Step) -> None:
        """Some milliseconds of the run: the steps of the world that are due, and what agents do meanwhile."""
        ...

    @property
    def factor(self) -> float:
        """World seconds per host second so far."""
        ...

    @property
    def shares(self) -> dict[str, float]:
        """What the processor's time went to, by part, as shares of all; empty where that is not known."""
        ...

    def close(self) -> None:
        """End all agents and what belongs to them. Idempotent."""
        ...
