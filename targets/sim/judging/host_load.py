"""Host load: how long each process of a real-time run waited for a processor core, and which violations that explains.

Linux counts, for each thread, the time in which it could run but had no core (`/proc/PID/schedstat`, second field, ns;
of a process here: its main thread, which runs the agent, or the simulator's world). It adds a wait when the wait ends.
It does not count what a hypervisor takes from the whole machine. Where the file is missing nothing is measured, and
nothing is explained.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections import deque
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import msgspec

from koordgen.runtime.agent.rounds import PUBLISH
from koordgen.runtime.program.runner import LATE
from koordgen.runtime.trace.schema import Mark, Round, TraceRecord, Violation
from targets.sim.base.bodies import BodyState
from targets.sim.run.crew import Agent

if TYPE_CHECKING:
    from targets.sim.run.run import Run

SIMULATOR = "the simulator"
SHARE = 0.5  # of the time that an event has: one that had no core for longer was late by the host
STARVED = 0.5  # seconds at a stretch without a core, after which bodies do what no agent wants
AFTER = 1.0  # seconds for which that explains what bodies do
KEPT = 5.0  # seconds of samples: a round is recorded some rounds after it happened
SAMPLES = 4  # in a round
LEAST_PERIOD, MOST_PERIOD = 0.005, 0.05  # seconds between two samples


def waited(process: int) -> float | None:
    """Return the seconds for which the main thread of a process has waited for a core; None where that is unknown."""
    try:
        with open(f"/proc/{process}/schedstat", "rb", buffering=0) as file:
            return int(file.read(64).split()[1]) / 1e9
    except (OSError, ValueError, IndexError):
        return None


class _Process:
    """The samples of one process: when (s, of the run's clock), and how long it had waited until then, in all."""

    def __init__(self) -> None:
        self.total = 0.0  # over all lives of a robot's agent
        self.starved: list[tuple[float, float]] = []  # since when, until when
        self._samples: deque[tuple[float, float]] = deque()
        self._life: tuple[int, float] = (-1, 0.0)  # process id, and its counter at the last sample

    def sample(self, at: float, process: int, counter: float) -> None:
        """Take in what the process's counter says now. A restarted agent's counter begins anew."""
        known, last = self._life
        before = last if known == process else counter if known < 0 else 0.0
        wait = max(0.0, counter - before)
        self.total += wait
        self._life = (process, counter)
        # Waits that began since the last sample are no longer than the time since then.
        if self._samples and wait - (at - self._samples[-1][0]) >= STARVED:
            self.starved.append((at - wait, at))
        self._samples.append((at, self.total))
        while self._samples[0][0] < at - KEPT:
            self._samples.popleft()

    def between(self, since: float, until: float) -> float:
        """Seconds of waiting between two times, as far as samples tell: at most so many."""
        samples = self._samples
        first = max(0, bisect_right(samples, since, key=_time) - 1)
        last = max(first, bisect_right(samples, until, key=_time) - 1)
        lost = samples[last][1] - samples[first][1]
        for k in range(last + 1, len(samples)):  # a wait that goes on at `until` shows when it has ended
            if (wait := samples[k][1] - samples[k - 1][1]) > 0:
                return min(until - since, lost + max(0.0, wait - max(0.0, samples[k - 1][0] - until)))
        return min(until - since, lost)


def _time(sample: tuple[float, float]) -> float:
    return sample[0]


class HostLoad:
    """A companion of a run in real time. `moving` are the lines ("app.koord:12") of the properties that read where
    bodies are: no other depends on the host."""

    def __init__(self, delta: float, moving: Collection[str]) -> None:
        self._delta, self._moving = delta, moving
        self._period = min(MOST_PERIOD, max(LEAST_PERIOD, delta / SAMPLES))
        self._next = 0.0
        self._found: dict[str, _Process] = {}
        self._late: dict[str, str] = {}  # robot -> why the host caused its first late event
        self._slow: set[str] = set()  # robots with a late event that the host did not cause
        self._marked: set[str] = set()  # robots with another fault behind their first late event

    def launched(self, run: Run) -> None:
        self._run = run

    def step(self, at: float, states: list[BodyState]) -> None:
        now = self._run.conduct.now()
        if now >= self._next:
            self._next = now + self._period
            self.sample(now)

    def sample(self, now: float) -> None:
        """Read the counters of all processes that run."""
        processes = {a.robot.name: a.process_id for a in self._run.conduct.agents} | {SIMULATOR: os.getpid()}
        for name, process in processes.items():
            counter = None if process is None else waited(process)
            if process is not None and counter is not None:
                self._found.setdefault(name, _Process()).sample(now, process, counter)

    def heard(self, agent: Agent, records: list[TraceRecord]) -> None:
        name = agent.robot.name
        for record in records:
            if not isinstance(record, Round) or record.fault is None:
                continue
            if record.fault.reason != LATE:
                if name in self._late and name not in self._marked:  # the run reports only the first fault of a robot
                    self._marked.add(name)
                    self._run.mark(Violation(record.time, "fault", (name,), str(record.fault)))
            elif why := self._why_late(name, record):
                self._late.setdefault(name, why)
            else:
                self._slow.add(name)

    def _why_late(self, name: str, record: Round) -> str:
        """Why the host caused an event to miss its deadline; "" when the agent had a core for most of the time."""
        self.sample(self._run.conduct.now())
        found, tick = self._found.get(name), record.time - record.late
        available = PUBLISH * self._delta
        lost = 0.0 if found is None else found.between(tick, tick + available)
        if lost < SHARE * available:
            return ""
        lack = f"{1e3 * lost:.0f} of the {1e3 * available:.0f} ms that its event had"
        return f"the host gave {name}'s agent no core for {lack}"

    def end(self, at: float) -> None:
        pass

    @property
    def totals(self) -> dict[str, float]:
        """Seconds for which each process waited for a core, from its launch to its end."""
        return {name: round(found.total, 3) for name, found in self._found.items()}

    def explained(self, marks: Sequence[Mark], zero: float) -> list[Mark]:
        """Return the marks, with `host` set in each violation that the host caused; `zero` is the time of t = 0."""
        return [
            msgspec.structs.replace(mark, host=self._why(mark, zero)) if isinstance(mark, Violation) else mark
            for mark in marks
        ]

    def _why(self, violation: Violation, zero: float) -> str:
        match violation.what:
            case "fault" if violation.detail.endswith(LATE):
                (name,) = violation.robots
                return "" if name in self._slow else self._late.get(name, "")
            case "separation" | "collision":
                return self._starved(violation.robots, violation.t + zero)
            case "property" if violation.line in self._moving:
                return self._starved(violation.robots or tuple(self._found), violation.t + zero)
        return ""

    def _starved(self, robots: tuple[str, ...], at: float) -> str:
        """Why a violation at a time of the run's clock is the host's; "" when no process concerned was starved."""
        for name in (*robots, SIMULATOR):
            process = self._found.get(name)
            waits = [] if process is None else process.starved
            lost = max((b - a for a, b in waits if a <= at and at - b <= AFTER), default=0.0)
            if lost:
                whose = name if name == SIMULATOR else f"{name}'s agent"
                return f"the host gave {whose} no core for {lost:.1f} s"
        return ""
