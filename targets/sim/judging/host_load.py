"""Host load: how long processes of a real-time run waited for a core, and violations due to it.

Linux counts, for each thread, the time in which it could run but had no core (`/proc/PID/schedstat`, second field, ns).
This module reads the count of a process's main thread, which runs the agent or the simulator's world. The kernel adds a
wait when the wait ends. It does not count the time that a hypervisor takes from the whole machine. If the file is
missing, nothing is measured and no violation is explained."""

from __future__ import annotations

import os
from bisect import bisect_right
from collections import deque
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import msgspec

from koordgen.runtime.agent.rounds import PUBLISH
from koordgen.runtime.agent.squad import APPLICATION
from koordgen.runtime.agent.squad import SHARE as OUTER_SHARE
from koordgen.runtime.program.runner import LATE
from koordgen.runtime.trace.schema import Mark, Round, TraceRecord, Violation
from targets.sim.base.bodies import BodyState
from targets.sim.run.run_interface import AgentHandle

if TYPE_CHECKING:
    from targets.sim.run.run import Run

SIMULATOR = "the simulator"
SHARE = 0.5  # share of an event's time; an event that had no core for longer was late because of the host
STARVED = 0.5  # seconds without a core after which bodies may leave their intended motion
AFTER = 1.0  # seconds for which a time of STARVED seconds without a core explains the motion of bodies
KEPT = 5.0  # seconds of samples kept: a round is recorded some rounds after it happened
SAMPLES = 4  # per round
LEAST_PERIOD, MOST_PERIOD = 0.005, 0.05  # seconds between two samples


def waited(process: int) -> float | None:
    """Return the seconds for which a process's main thread has waited for a core; None if unknown."""
    try:
        with open(f"/proc/{process}/schedstat", "rb", buffering=0) as file:
            return int(file.read(64).split()[1]) / 1e9
    except (OSError, ValueError, IndexError):
        return None


class _Process:
    """Samples of one process: time (s, of the run's clock) and total wait until then (s)."""

    def __init__(self) -> None:
        self.total = 0.0  # over all starts of a robot's agent
        self.starved: list[tuple[float, float]] = []  # (start, end) of long waits for a core
        self._samples: deque[tuple[float, float]] = deque()
        self._life: tuple[int, float] = (-1, 0.0)  # process id, and its counter at the last sample

    def sample(self, at: float, process: int, counter: float) -> None:
        """Add a sample of the process's counter. The counter of a restarted agent begins at 0."""
        known, last = self._life
        before = last if known == process else counter if known < 0 else 0.0
        wait = max(0.0, counter - before)
        self.total += wait
        self._life = (process, counter)
        # A wait that began after the last sample is no longer than the time since then.
        if self._samples and wait - (at - self._samples[-1][0]) >= STARVED:
            self.starved.append((at - wait, at))
        self._samples.append((at, self.total))
        while self._samples[0][0] < at - KEPT:
            self._samples.popleft()

    def between(self, since: float, until: float) -> float:
        """Return the seconds of waiting between two times, as far as samples show; at most `until - since`."""
        samples = self._samples
        first = max(0, bisect_right(samples, since, key=_time) - 1)
        last = max(first, bisect_right(samples, until, key=_time) - 1)
        lost = samples[last][1] - samples[first][1]
        for k in range(last + 1, len(samples)):  # a wait that goes on at `until` is counted when it ends
            if (wait := samples[k][1] - samples[k - 1][1]) > 0:
                return min(until - since, lost + max(0.0, wait - max(0.0, samples[k - 1][0] - until)))
        return min(until - since, lost)


def _time(sample: tuple[float, float]) -> float:
    return sample[0]


class HostLoad:
    """Companion of a real-time run that measures host load.

    `delta`: seconds in the shortest round of the run's fleets. `moving`: lines ("app.koord:12") of the properties that
    read positions of bodies. Only those depend on the host."""

    def __init__(self, delta: float, moving: Collection[str]) -> None:
        self._moving = moving
        self._period = min(MOST_PERIOD, max(LEAST_PERIOD, delta / SAMPLES))
        self._next = 0.0
        self._found: dict[str, _Process] = {}
        self._late: dict[str, str] = {}  # robot -> why the host caused its first late event
        self._slow: set[str] = set()  # robots with a late event that the host did not cause
        self._marked: set[str] = set()  # robots whose fault after the first late event was marked

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

    def heard(self, agent: AgentHandle, records: list[TraceRecord]) -> None:
        name = agent.robot.name
        for record in records:
            if not isinstance(record, Round) or record.fault is None:
                continue
            if record.fault.reason != LATE:
                if name in self._late and name not in self._marked:  # the run itself reports only a robot's first fault
                    self._marked.add(name)
                    self._run.mark(Violation(record.time, "fault", (name,), str(record.fault)))
            elif why := self._why_late(agent, record):
                self._late.setdefault(name, why)
            else:
                self._slow.add(name)

    def _why_late(self, agent: AgentHandle, record: Round) -> str:
        """Return why the host made an event late; "" if the agent had a core for most of the time."""
        self.sample(self._run.conduct.now())
        name, tick, window = agent.robot.name, record.time - record.late, PUBLISH * agent.delta
        found = self._found.get(name)
        lost = 0.0 if found is None else found.between(tick, tick + window)
        hosts_squad = record.application == APPLICATION and "." in name  # names of robots in squads have a dot
        available = window * OUTER_SHARE if hosts_squad else window
        if lost < SHARE * available:
            return ""
        lack = f"{1e3 * min(lost, available):.0f} of the {1e3 * available:.0f} ms that its event had"
        return f"the host gave {name}'s agent no core for {lack}"

    def end(self, at: float) -> None:
        pass

    @property
    def totals(self) -> dict[str, float]:
        """Seconds for which each process waited for a core, from its launch to its end."""
        return {name: round(found.total, 3) for name, found in self._found.items()}

    def explained(self, marks: Sequence[Mark], zero: float) -> list[Mark]:
        """Return the marks, with `host` set in each violation that the host caused.

        `zero` is the time of t = 0."""
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
        """Return why the host caused a violation at a time of the run's clock.

        "" if no process concerned was starved."""
        for name in (*robots, SIMULATOR):
            process = self._found.get(name)
            waits = [] if process is None else process.starved
            lost = max((b - a for a, b in waits if a <= at and at - b <= AFTER), default=0.0)
            if lost:
                whose = name if name == SIMULATOR else f"{name}'s agent"
                return f"the host gave {whose} no core for {lost:.1f} s"
        return ""
