"""Fault injection: executes a schedule during a run, and records each fault in the trace as a cause."""

from __future__ import annotations

import heapq
import importlib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from koordgen.runtime.net.network import Conditions
from koordgen.runtime.trace.schema import Cause, Moved, TraceRecord
from targets.sim.base.bodies import BodyState
from targets.sim.base.fault_state import NO_POSITIONING_FAULT
from targets.sim.base.medium import medium, partition
from targets.sim.base.scenario import BadScenario, Robot
from targets.sim.base.schedule import CONDITIONS, LONGER, Event, Mistake, Schedule, read, too_late
from targets.sim.run.run_interface import AgentHandle
from targets.sim.sensing.station import fed

if TYPE_CHECKING:
    from targets.sim.run.run import Run


def load(path: Path, robots: Sequence[str]) -> tuple[Schedule, Any]:
    """Read a schedule from JSON or YAML (by the file's extension). Return it with its plain values.

    Raises BadScenario that lists all mistakes."""
    read_plain = _yaml if path.suffix in (".yaml", ".yml") else json.loads
    try:
        data = read_plain(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        hint = "a YAML file must have the extension .yaml or .yml"
        raise BadScenario(f"{path}:{error.lineno}:{error.colno}: invalid JSON: {error.msg}", hint) from None
    except (OSError, ValueError, RecursionError) as error:
        raise BadScenario(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    schedule, mistakes = read(data, robots)
    if mistakes:
        text = "\n".join(f"{path}: {_place(mistake)}{mistake.message}" for mistake in mistakes)
        raise BadScenario(text, next((m.hint for m in mistakes if m.hint), ""))
    return schedule, data


def _yaml(text: str) -> Any:
    """Parse YAML. PyYAML is optional in a bundle. Raises ValueError."""
    try:
        yaml = importlib.import_module("yaml")
    except ModuleNotFoundError:
        raise ValueError("YAML needs the Python package PyYAML; JSON works without it") from None
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(f"invalid YAML: {error}") from None


def _place(mistake: Mistake) -> str:
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in mistake.path)
    return f"{text.lstrip('.')}: " if text else ""


def with_network(schedule: Schedule, given: Mapping[str, float | None]) -> Schedule:
    """Return the schedule with conditions of all links overridden by `given`; None: unchanged."""
    said = {key: given[key] for key in CONDITIONS if given.get(key) is not None}
    if not said:
        return schedule
    before = {key: getattr(schedule.network or Conditions(), key) for key in CONDITIONS}
    return msgspec.structs.replace(schedule, network=Conditions(**{**before, **said}))


def check_times(schedule: Schedule, duration: float) -> None:
    """Check that all events are within the run's duration. Raises BadScenario."""
    late = [event for event in schedule.events if event.at >= duration]
    if late:
        raise BadScenario(too_late(late[0], duration), LONGER)


def check_robots(schedule: Schedule, robots: Sequence[Robot]) -> None:
    """Refuse faults that cannot be injected: GPS of an external autopilot, missing battery.

    Raises BadScenario."""
    own_gps = {r.name for r in robots if r.external and not fed(r.settings)}
    simple = {r.name for r in robots if r.sim.fidelity == "simple"}
    for event in schedule.events:
        what = f"{event.kind} at {event.at:g} s"
        if event.kind == "positioning" and event.robots[0] in own_gps:
            raise BadScenario(
                f"{what}: the GPS of {event.robots[0]} is that of its external autopilot",
                "set ArduPilot's own SIM_GPS parameters, or feed it: `positioning: gps_input` in its settings",
            )
        if event.kind == "battery" and event.robots[0] in simple:
            raise BadScenario(
                f"{what}: {event.robots[0]} is simulated without a battery",
                "set `fidelity: full` in its `sim:`, or remove this fault",
            )


def check_obstacles(schedule: Schedule, count: int) -> None:
    """Check that the world has the obstacles that move. Raises BadScenario."""
    for event in schedule.events:
        if event.kind == "obstacle" and event.number >= count:
            there = f"they are numbered 0 to {count - 1}" if count else "this world has none"
            raise BadScenario(f"obstacle at {event.at:g} s: there is no obstacle {event.number}", there)


class Faults:
    """Companion that injects faults. With `open`, more faults may be added during the run (`give`)."""

    def __init__(self, schedule: Schedule, open: bool = False) -> None:
        self._schedule = schedule
        self._open = open
        self._network = schedule.network  # present conditions of all links
        self._groups: tuple[tuple[str, ...], ...] = ()
        self._cuts: set[tuple[int, int]] = set()
        self._due: list[tuple[float, int, int, Event]] = []  # by time; at equal times, ends before beginnings
        self._count = 0
        for event in schedule.events:
            self._plan(event)

    def _plan(self, event: Event) -> None:
        for at, order in ((event.at, 1), (None if event.lasts is None else event.at + event.lasts, 0)):
            if at is not None:
                self._count += 1
                heapq.heappush(self._due, (at, order, self._count, event))

    def launched(self, run: Run) -> None:
        """See Companion."""
        self._run = run
        self._names = [robot.name for robot in run.scenario.robots]
        if self._schedule.networked or self._open:
            self._disturb()
        now = run.conduct.now()
        if self._schedule.network is not None:
            self._stamp(now, "network", tuple(self._names), _conditions(self._schedule.network))
        for link in self._schedule.links:
            conditions = link.over(self._schedule.network or Conditions())
            text = f"from {link.sender} to {link.receiver}: {_conditions(conditions)}"
            self._stamp(now, "link", (link.sender, link.receiver), text)

    def step(self, at: float, states: list[BodyState]) -> None:
        """See Companion."""
        t = self._run.t(at)
        while t is not None and self._due and self._due[0][0] <= t:
            _, begins, _, event = heapq.heappop(self._due)
            (self._begin if begins else self._finish)(event, at)

    def give(self, event: Event, at: float) -> None:
        """Inject one more event now: its time must be the run's t of `at`."""
        self._plan(event)
        self.step(at, [])

    def impossible(self, event: Event) -> str:
        """Return why a valid event cannot be injected now; "" if it can."""
        match event.kind:
            case "crash" | "freeze" | "continue" | "restart":
                agent, name = self._agent(event), event.robots[0]
                if event.kind == "restart":
                    return "" if agent.alive or agent.crashed else f"{name} has ended by itself and did not crash"
                if not agent.alive:
                    return f"{name} does not run"
                if event.kind == "continue" and not agent.frozen:
                    return f"{name} is not frozen"
                return f"{name} is frozen already" if event.kind == "freeze" and agent.frozen else ""
            case "cut" | "restore":
                is_cut = self._link(event) in self._cuts
                names = " and ".join(event.robots)
                if is_cut == (event.kind == "cut"):
                    return f"the link between {names} is {'cut already' if is_cut else 'not cut'}"
        return ""

    def heard(self, agent: AgentHandle, records: list[TraceRecord]) -> None:
        """Do nothing: agents' records do not change the schedule. See Companion."""

    def end(self, at: float) -> None:
        """See Companion."""

    def _stamp(self, at: float, what: str, robots: tuple[str, ...], detail: str, lasts: float | None = None) -> None:
        self._run.mark(Cause(at, what, robots, detail, lasts))

    def _concerned(self, event: Event) -> tuple[str, ...]:
        return () if event.kind == "obstacle" else event.robots or tuple(self._names)

    def _begin(self, event: Event, at: float) -> None:
        self._stamp(at, event.kind, self._concerned(event), event_text(event), event.lasts)
        run = self._run
        match event.kind:
            case "partition":
                self._groups = event.groups
                self._disturb()
            case "cut" | "restore":
                (self._cuts.add if event.kind == "cut" else self._cuts.discard)(self._link(event))
                self._disturb()
            case "network":
                self._network = event.network
                self._disturb()
            case "crash":
                self._agent(event).crash()
            case "restart":
                self._restart(event)
            case "freeze":
                self._agent(event).freeze(math.inf if event.lasts is None else event.lasts)
            case "continue":
                self._agent(event).thaw()
            case "positioning":
                self._fault_state(event).positioning = event.positioning
            case "battery":
                self._fault_state(event).battery = event.level
            case "lag":
                self._fault_state(event).lag = event.lag
            case "wind":
                run.scene.world.blow(event.wind)
            case "obstacle":
                run.mark(Moved(at, event.number, run.scene.world.move(event.number, event.by)))

    def _finish(self, event: Event, at: float) -> None:
        run = self._run
        match event.kind:
            case "partition":
                self._groups = ()
                self._disturb()
            case "cut":
                self._cuts.discard(self._link(event))
                self._disturb()
            case "network":
                self._network = self._schedule.network
                self._disturb()
            case "crash":
                self._stamp(at, "restart", event.robots, f"{event.lasts:g} s after its crash")
                self._restart(event)
            case "positioning":
                self._fault_state(event).positioning = NO_POSITIONING_FAULT
            case "lag":
                self._fault_state(event).lag = 0.0
            case "wind":
                run.scene.world.blow(run.scenario.world.wind)
            case _:
                pass  # a freeze ends by itself

    def _disturb(self) -> None:
        """Apply the present conditions and partitions to the network between the agents."""
        whole = medium(msgspec.structs.replace(self._schedule, network=self._network), self._names)
        whole = msgspec.structs.replace(whole, cuts=tuple(sorted(self._cuts)))
        self._run.conduct.disturb(partition(whole, self._groups, self._names) if self._groups else whole)

    def _link(self, event: Event) -> tuple[int, int]:
        """Return the pids of the two robots of a cut, the lower one first."""
        one, other = sorted(map(self._names.index, event.robots))
        return one, other

    def _restart(self, event: Event) -> None:
        agent = self._agent(event)
        if not agent.asked_to_end:  # an agent that was asked to end must not start again: it is asked only once
            agent.restart()

    def _agent(self, event: Event) -> AgentHandle:
        return self._run.conduct.agents[self._names.index(event.robots[0])]

    def _fault_state(self, event: Event) -> Any:
        return self._run.scene.actors[self._names.index(event.robots[0])].fault_state


def _conditions(conditions: Conditions) -> str:
    return ", ".join(f"{key} {getattr(conditions, key):g}" for key in CONDITIONS if getattr(conditions, key))


def event_text(event: Event) -> str:
    """Return a fault's details as text."""
    match event.kind:
        case "partition":
            return " | ".join(", ".join(group) for group in event.groups)
        case "positioning":
            wrong = event.positioning
            parts = [f"{key} {getattr(wrong, key):g}" for key in ("noise", "delay", "dropout") if getattr(wrong, key)]
            parts += [f"bias ({', '.join(f'{v:g}' for v in wrong.bias)})"] if any(wrong.bias) else []
            return ", ".join(parts)
        case "cut" | "restore":
            return f"between {' and '.join(event.robots)}"
        case "network":
            return _conditions(event.network)
        case "obstacle":
            return f"number {event.number} by ({', '.join(f'{v:g}' for v in event.by)}) m"
        case "battery":
            return f"level {event.level:g}"
        case "lag":
            return f"{event.lag:g} s"
        case "wind":
            mean = ", ".join(f"{v:g}" for v in event.wind.mean)
            return f"mean ({mean}) m/s, gust {event.wind.gust:g} m/s"
    return ""
