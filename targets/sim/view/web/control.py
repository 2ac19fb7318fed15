"""Control of a live run: pause, step and speed in lockstep, and faults injected by hand.

Commands arrive from the live page as JSON objects (serve.py, guard.py) and are executed here. `do` is `pause`, `go`,
`step` (to the beginning of the next round, then pause), `speed` with `factor` (times real time; null: as fast as
possible), or `fault` with `event`: an event of a scenario file without `at`.

A fault injected by hand becomes an event of the run's schedule. All such events, after those of the run's own scenario,
are written to the file GIVEN of the run folder, a scenario file: a lockstep run with it repeats the run."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from koordgen.runtime.trace.schema import TraceRecord
from targets.sim.base.bodies import BodyState
from targets.sim.base.folder import GIVEN
from targets.sim.base.scenario import BadScenario
from targets.sim.base.schedule import Event, Schedule, read
from targets.sim.run.faults import Faults, check_obstacles, check_robots, event_text
from targets.sim.run.run_interface import AgentHandle
from targets.sim.view.web.live import Live, PaceLimit

if TYPE_CHECKING:
    from targets.sim.run.run import Run

REAL_TIME = "only with --lockstep: in real time the robots' own clocks go on"
FOLLOWING = "a run that follows a counterexample takes no faults: all that happens is the counterexample's"
LEAST_FACTOR, MOST_FACTOR = 0.001, 1000.0
PATIENCE = 0.1  # seconds of the host between two checks during a pause for other reasons to end it


class ImpossibleCommand(Exception):
    """A command that cannot be executed; the message says why."""


class ManualFaults:
    """Faults injected by hand.

    `scenario`: plain values of the run's own scenario file, which these faults continue. `folder`: the run's."""

    def __init__(self, faults: Faults, scenario: Any, folder: Path) -> None:
        self.faults = faults
        self._scenario: dict[str, Any] = {**(scenario or {})}
        self._events: list[Any] = list(self._scenario.pop("events", None) or ())
        self._file = folder / GIVEN
        self.count = 0

    def give(self, run: Run, event: Any, at: float) -> str:
        """Inject an event of a scenario file now, at `at` of the run's clock. Return its description.

        Raises Impossible, and OSError if the file cannot be written."""
        t = run.t(at)
        if t is None or t < 0:
            raise ImpossibleCommand("faults can be injected only after round 1 has begun")
        if any(agent.asked_to_end for agent in run.conduct.agents):
            raise ImpossibleCommand("the mission is over")
        if not isinstance(event, dict) or "at" in event:
            raise ImpossibleCommand("a fault is an event of a scenario file without `at`, because it begins now")
        data = {"at": t, **event}
        found = self._checked(run, data)
        self._events.append(data)
        self._write()
        self.count += 1
        self.faults.give(found.events[0], at)
        (brought,) = found.events
        return _described(brought, t)

    def _checked(self, run: Run, data: Any) -> Schedule:
        """Return a schedule with the event alone. Raises Impossible."""
        robots = run.scenario.robots
        names = [robot.name for robot in robots]
        _, mistakes = read({**self._scenario, "events": [*self._events, data]}, names)
        if mistakes:
            texts = (f"{m.message} ({m.hint})" if m.hint else m.message for m in mistakes)
            raise ImpossibleCommand("; ".join(texts).replace(f"event {len(self._events)}", "this fault"))
        found, _ = read({"events": [data]}, names)
        try:
            check_robots(found, robots)
            check_obstacles(found, len(run.scenario.obstacles))
        except BadScenario as error:
            raise ImpossibleCommand(f"{error} ({error.hint})") from None
        why = self.faults.impossible(found.events[0])
        if why:
            raise ImpossibleCommand(why)
        return found

    def _write(self) -> None:
        lines = ["# The faults of a run, ending with those injected by hand; for `koordgen sim ... --scenario`"]
        lines += [f"{key}: {_yaml(value)}" for key, value in self._scenario.items()]
        lines += ["events:", *(f"  - {_yaml(event)}" for event in self._events)]
        self._file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _described(event: Event, t: float) -> str:
    """Return an injected fault as text."""
    who = event.robots[0] if len(event.robots) == 1 else ""  # the detail names several robots
    lasts = "" if event.lasts is None else f" for {event.lasts:g} s"
    return f"{' '.join(filter(None, (event.kind, who, event_text(event))))}, at {t:.2f} s{lasts}"


class Control:
    """Companion that executes commands of the live page.

    `given` is None for a run without faults, `paced` for one in real time."""

    def __init__(self, view: Live, given: ManualFaults | None, paced: PaceLimit | None) -> None:
        self._view, self._given, self._paced = view, given, paced
        self._paused = False
        self._stop_at = math.inf  # time of the run's clock at which to pause

    def launched(self, run: Run) -> None:
        """See Companion."""
        self._run = run
        if self._given is not None:
            self._given.faults.launched(run)
        if self._paced is not None:
            self._paced.launched(run)
        self._report()

    def step(self, at: float, states: list[BodyState]) -> None:
        """Execute commands, and wait during a pause, which takes no simulated time. See Companion."""
        if self._given is not None:
            self._given.faults.step(at, states)
        self._obey(self._view.commands(), at)
        if self._paced is None:
            return
        if at >= self._stop_at:
            self._paused = True
        if self._paused:
            self._hold(self._paced, at, states)
        self._paced.step(at, states)

    def heard(self, agent: AgentHandle, records: list[TraceRecord]) -> None:
        """See Companion."""

    def end(self, at: float) -> None:
        """See Companion."""

    def _hold(self, paced: PaceLimit, at: float, states: list[BodyState]) -> None:
        """Wait until the pause is over, or until the page's server or the run ends."""
        self._stop_at, paced.waited = math.inf, True
        self._view.show(at, states)
        self._report()
        while self._paused and not (self._view.is_closed or self._run.interrupted):
            self._obey(self._view.commands(PATIENCE), at)
            self._view.show(at, [])
        self._paused = False
        paced.go(paced.factor, at)
        self._report()

    def _obey(self, commands: Sequence[Any], at: float) -> None:
        for command in commands:
            try:
                message, bad = self._command(command, at), False
            except ImpossibleCommand as error:
                message, bad = str(error), True
            self._report(message, bad)

    def _command(self, command: dict[str, Any], at: float) -> str:
        """Execute a command. Return a description. Raises Impossible."""
        match command:
            case {"do": "fault", "event": event}:
                if self._given is None:
                    raise ImpossibleCommand(FOLLOWING)
                return self._given.give(self._run, event, at)
            case {"do": "pause" | "go" | "step" | "speed" as what}:
                if self._paced is None:
                    raise ImpossibleCommand(f"{what}: {REAL_TIME}")
                return self._pace(self._paced, what, command.get("factor"), at)
        raise ImpossibleCommand(f"unknown command {json.dumps(command):.60}; there are: pause, go, step, speed, fault")

    def _pace(self, paced: PaceLimit, what: str, factor: Any, at: float) -> str:
        match what:
            case "pause":
                self._paused = True
            case "go":
                self._paused, self._stop_at = False, math.inf
            case "step":
                self._paused, self._stop_at = False, self._next_round(at)
            case "speed":
                sound = type(factor) in (int, float) and LEAST_FACTOR <= factor <= MOST_FACTOR
                if factor is not None and not sound:
                    raise ImpossibleCommand(f"speed: factor must be {LEAST_FACTOR:g} to {MOST_FACTOR:g}, or null")
                paced.go(factor, at)
        return ""

    def _next_round(self, at: float) -> float:
        """Return the start of the next round on the run's clock. Before round 1, return one delta later."""
        delta, t = self._run.scenario.delta, self._run.t(at)
        return at + delta if t is None else at - t + (math.floor(t / delta + 1e-6) + 1) * delta - 1e-9

    def _report(self, message: str = "", bad: bool = False) -> None:
        factor = None if self._paced is None else self._paced.factor
        self._view.report({"paused": self._paused, "factor": factor, "message": message, "bad": bad})


def _yaml(value: Any) -> str:
    """Return a value as one line of YAML, which reads back as the same value."""
    match value:
        case dict():
            return "{" + ", ".join(f"{json.dumps(str(key))}: {_yaml(each)}" for key, each in value.items()) + "}"
        case list():
            return "[" + ", ".join(map(_yaml, value)) + "]"
        case float():
            text = repr(value)
            return text.replace("e", ".0e") if "e" in text and "." not in text else text  # 1e-05 is a string in YAML
    return json.dumps(value)
