"""Share of monitors in the CPU time of an agent's round: `python benchmarks/monitors.py`.

Agents of the examples' programs run in one process, on the in-memory transport, over bodies that move to their targets
and are polled once a round. Two equal fleets, one with monitors and one without, take turns, so other load on the
computer affects both. The CPU time of a round is that of all the agent's work: events, shared memory, MAC, polls of the
body. Also measured is the same invariant in `rtamt` (https://github.com/nickovic/rtamt), if it is installed: one
robot's position within a box, one sample at a time.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples/mapping"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.fixtures.fleet import Fleet, Robot, settings
from koordgen.build.emit.program import program_text
from koordgen.build.emit.property import properties_text
from koordgen.build.pipeline import check_file
from koordgen.lang.analyze.params import with_params
from koordgen.lang.ir.decl import Program
from koordgen.runtime.monitor.monitor import Monitors
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.program.property import Properties
from koordgen.runtime.program.runner import unlimited
from koordgen.runtime.trace.monitored import SHARED, Change, Observation
from koordgen.runtime.values.containers import last
from koordgen.runtime.values.points import Point, Scan, distance
from koordgen.runtime.vehicle.platform import Finding, Sensed

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = ("task/task", "lineform/geofence", "election/election", "mapping/mapping")
SIZES = (4, 16)
DELTA = 0.1
CHUNK = 20  # rounds of one fleet before its twin runs
SPEED = 0.02  # metres in a round: no robot ever arrives
TASKS = [{"target": [float(k % 5), float(k // 5), 0.0], "id": k + 1} for k in range(20)]


class Moving:
    """Body with the ports of any module. It moves slowly to its targets, which are a step away and never reached."""

    period = DELTA
    ready = stopped = True
    progress = "moving"
    stall = ""

    def __init__(self, ports: list[str], pid: int) -> None:
        self._ports = ports
        self._position = Point(float(pid % 4) - 2, float(pid // 4) - 2, 0.0)
        self._goal = self._position

    def diagnose(self) -> list[Finding]:
        return []

    def start(self, now: float) -> None: ...

    def poll(self, now: float) -> None:
        away = distance(self._goal, self._position)
        if away > 2 * SPEED:
            self._position = self._position + (self._goal - self._position) * (SPEED / away)
        else:
            self._position = Point(self._position.x, self._position.y, 1e-6 * (now % 7))

    def sense(self, now: float) -> Sensed:
        values = {
            "position": self._position,
            "reached": False,
            "velocity": Point(),
            "pscan": ((self._position, Scan()),),
        }
        return Sensed({name: values[name.rpartition(".")[2]] for name in self._ports}, now)

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        for value in actuators.values():
            self._goal = value if isinstance(value, Point) else last(value) if value else self._position

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        return (self._position, args[0])

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None: ...

    def log_lines(self) -> list[str]:
        return []

    def hold(self, on: bool, now: float) -> None: ...

    def stop(self, now: float) -> None: ...

    def close(self) -> None: ...


def generated(name: str, params: dict[str, Any]) -> Properties:
    """Return an example's program and properties."""
    return compiled(with_params(check_file(str(ROOT / f"examples/{name}.koord")).program, params))


def compiled(program: Program) -> Properties:
    """Return the modules of a program in the form of a bundle."""
    functions = f"{program.name}_functions"
    sys.modules.pop(functions, None)
    for module, text in (("program", program_text(program)), ("properties", properties_text(program))):
        made = ModuleType(module)
        made.__file__ = f"{module}.py"
        sys.modules[module] = made
        exec(compile(text, f"{module}.py", "exec"), vars(made))
    found: Properties = sys.modules["properties"].__dict__["PROPERTIES"]
    if found.program.library is not None:
        found.program.library.load()
    return found


class Own:
    """CPU time of one agent among many in this process."""

    def __init__(self) -> None:
        self._before = self._since = 0.0

    def poll(self, robot: Robot) -> None:
        """Measure the CPU time of a robot's agent: from now on each of its polls is timed."""
        poll = robot.agent.poll

        def timed(now: float) -> float:
            self._since = time.process_time()
            wake = poll(now)
            self._before += time.process_time() - self._since
            return wake

        robot.agent.poll = timed  # type: ignore[method-assign]

    def __call__(self) -> float:
        return self._before + time.process_time() - self._since


def fleet(found: Properties, n: int, watched: bool) -> Fleet:
    made = Fleet(n=n, conditions=Conditions(delay=0.001), program=found.program, delta=DELTA)
    ports = [port.name for port in found.program.ports if port.direction == "sensor"]
    for pid in range(n):
        own = Own()
        robot = made.boot(pid, Moving(ports, pid), properties=found if watched else None, cpu=own)  # type: ignore[arg-type]
        own.poll(robot)
        robot.agent._journal._trace.close()  # most robots write none
    made.run_rounds(1)
    return made


def spent(made: Fleet, rounds: int) -> float:
    """Return the CPU seconds of all agents for so many more rounds."""
    through = min(robot.agent.round for robot in made.robots.values()) + rounds
    began = time.process_time()
    made.run_rounds(through)
    return time.process_time() - began


def measure(name: str, n: int, chunks: int) -> dict[str, float]:
    """Return CPU microseconds of one agent's round without and with monitors, and the share of the monitors."""
    found = generated(name, {"tasks": TASKS} if name == "task/task" else {})
    took: tuple[list[float], list[float]] = [], []
    twins: tuple[Fleet, Fleet] | None = None
    for chunk in range(chunks):
        if twins is None or any(r.agent.done or r.agent.round > 200 for f in twins for r in f.robots.values()):
            twins = fleet(found, n, False), fleet(found, n, True)
        for which in (0, 1) if chunk % 2 else (1, 0):
            took[which].append(spent(twins[which], CHUNK) / CHUNK / n)
    without, with_ = statistics.median(took[0]) * 1e6, statistics.median(took[1]) * 1e6
    # Twins run the same rounds one right after the other, so other load on the computer affects both.
    share = statistics.median(w / b for b, w in zip(*took, strict=True)) - 1
    return {"without_us": without, "with_us": with_, "share": share}


BOX = """\
using Motion:
  sensors: Point position
E:
  pre: True
  eff: pass
invariant Yard: forall i in ID: Motion.position[i] in Rect(Point(-6, -5, -0.5), Point(6, 5, 4))
"""


def one_invariant(samples: int) -> dict[str, float | str]:
    """Return CPU microseconds for one sample of a robot's position, checked against a box: ours, and rtamt's."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "box.koord"
        path.write_text(BOX)
        found = compiled(check_file(str(path)).program)
    changes: list[Change] = []
    monitors = Monitors(found, settings(0, 1), changes.append, unlimited)
    places = [Point(k % 700 / 100, 0.5, 0.1) for k in range(samples)]
    began = time.process_time()
    for k, place in enumerate(places):
        monitors.look(Observation(k + 1, 0.1 * k, SHARED, 0.1 * k, {"Motion.position": place}, {}, {}, {}))
    took: dict[str, float | str] = {"ours_us": (time.process_time() - began) / samples * 1e6}
    violated = sum(change.outcome == "violated" for change in changes)
    try:
        import rtamt  # type: ignore[import-untyped, import-not-found, unused-ignore]
    except ImportError:
        return {**took, "rtamt": "not installed: pip install rtamt"}
    spec = rtamt.StlDiscreteTimeSpecification()
    for axis in "xyz":
        spec.declare_var(axis, "float")
    spec.spec = "(x >= -6) and (x <= 6) and (y >= -5) and (y <= 5) and (z >= -0.5) and (z <= 4)"
    spec.parse()
    began = time.process_time()
    robust = [spec.update(k, [("x", p.x), ("y", p.y), ("z", p.z)]) for k, p in enumerate(places)]
    took["rtamt_us"] = (time.process_time() - began) / samples * 1e6
    turns = sum(after < 0 <= before for before, after in pairwise([0.0, *robust]))
    assert turns == violated, f"rtamt sees {turns} violations begin, we {violated}"
    return took


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="4 turns of each fleet instead of 16")
    parser.add_argument("--only", choices=PROGRAMS, help="one program alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    arguments = parser.parse_args()
    chunks = 4 if arguments.quick else 16
    figures: dict[str, Any] = {"rounds": CHUNK * chunks}
    print(f"CPU of one agent's round, {CHUNK * chunks} rounds each")
    for name in [arguments.only] if arguments.only else PROGRAMS:
        for n in SIZES:
            found = figures[f"{name}, N = {n}"] = measure(name, n, chunks)
            times = f"without {found['without_us']:8.1f} us  with {found['with_us']:8.1f} us"
            print(f"  {name:20} N = {n:2}  {times}  {found['share']:+.1%}")
    one = figures["one invariant"] = one_invariant(2_000 if arguments.quick else 20_000)
    print(f"One robot's place held against a box, a sample: {one['ours_us']:.2f} us", end="")
    print(f", rtamt {one['rtamt_us']:.2f} us" if "rtamt_us" in one else f" (rtamt is {one['rtamt']})")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
