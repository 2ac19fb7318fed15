"""A sim bundle of trivial agents, and devices that do nothing, for tests of the harness. As a program it runs such a
bundle: `fake_fleet.py ROOT ARGUMENTS...`."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from koordgen.build.emit.program import program_text
from koordgen.build.emit.property import properties_text
from targets.sim import harness
from targets.sim.base.bodies import DeviceContext
from targets.sim.run import scene
from tests.build.emit.generated import checked


def wait_for_a_round(out: Path) -> None:
    """Wait until an agent has recorded a round in the run folder `out`."""
    while not any(b'"round"' in trace.read_bytes() for trace in out.glob("robots/*/trace.jsonl")):
        time.sleep(0.02)


AGENT = """
import json, os, signal, sys, time
settings = json.load(open(sys.argv[sys.argv.index("--settings") + 1]))
how, pid = settings["body"]["how"], settings["body"]["pid"]
assert os.stat(settings["key_file"]).st_mode & 0o777 == 0o600 and os.stat(settings["key_file"]).st_size == 32
out = open(settings["trace"], "ab", buffering=0)
def write(**record):
    out.write(json.dumps({"kind": "", "time": time.monotonic(), **record}).encode() + b"\\n")
def phase(name, detail=""):
    write(kind="phase", phase=name, detail=detail)
def end(number, frame):
    phase("stopping", "told to end")
    if how == "stubborn":
        return
    phase("stopped")
    if how == "leaving":  # as Python on its way out, which heeds signals no longer
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTERM)
    sys.exit(0)
signal.signal(signal.SIGTERM, end)
signal.signal(signal.SIGINT, signal.SIG_IGN)
write(kind="header", format="koord-trace/1", app="fake", robot="r", pid=pid, n_sys=2, delta=0.1, program_hash="0")
phase("starting", "looking for the <stars>")
if how == "unborn":
    print("no autopilot answers", file=sys.stderr)
    sys.exit(5)
while how == "waiting":
    time.sleep(0.05)
phase("running")
for round_ in range(1, 10_000):
    fault, began = None, time.monotonic()
    if how.startswith("late") and round_ == 8:  # the simulator has measured for a while, on a busy computer too
        time.sleep(0.06)
        fault = {"file": "a.koord", "line": 0, "reason": "not finished by the round's publish deadline"}
    if how.endswith("faulty") and round_ == (9 if how.startswith("late") else 4):
        fault = {"file": "a.koord", "line": 3, "reason": "1 / 0"}
    write(kind="round", round=round_, event="Move" if pid == 0 and not fault else None,
          skipped=None if pid == 0 and not fault else "fault" if fault else "no event enabled", fault=fault,
          sensors={}, shared={}, actuators={}, late=0.001, time=began)
    if how == "dying" and round_ == 5:
        print("Traceback\\nValueError: <b>ouch</b>", file=sys.stderr)
        sys.exit(70)
    if how == "shot" and round_ == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "stopping" and round_ == 5:
        phase("stopping", "all robots have stopped")
        sys.exit(0)
    time.sleep(0.1)
"""

PROGRAM = """\
using Motion:
  sensors: Point position
Move:
  pre: True
  eff: pass
invariant Here: forall i in ID: Motion.position[i] in Ball(Point(0, 0, 0), 50)
"""


class Telling:
    """A device that never commands its body. It passes the robot's settings on as overrides, as a real device passes
    its port: they tell the agent what to play."""

    def __init__(self, body: Any, context: DeviceContext) -> None:
        self.context = context
        self.overrides: Mapping[str, Any] = dict(context.settings)

    def step(self, now: float) -> None: ...

    def close(self) -> None: ...


def bundle(root: Path, how: list[str], starts: list[list[float]] | None = None, **settings: Any) -> Path:
    """Write a sim bundle whose robots play `how`: good, dying, faulty, late, late and faulty, shot, stopping, stubborn,
    unborn, waiting."""
    places = starts or [[2.0 * pid, 0.0, 0.0] for pid in range(len(how))]
    for pid in range(len(how)):
        agent = root / "agents" / f"r{pid}"
        agent.mkdir(parents=True)
        (agent / "__main__.py").write_text(AGENT)
    robots = [
        {
            "name": f"r{pid}", "pid": pid, "target": "quad", "bundle": f"agents/r{pid}", "body": "quadrotor",
            "device": "idle", "start": {"position": places[pid], "yaw": 0.0}, "settings": {"how": each, "pid": pid},
        }
        for pid, each in enumerate(how)
    ]  # fmt: skip
    scenario = {
        "app": "fake", "source": "fake.koord", "program_hash": "0123456789abcdef", "delta": 0.1,
        "origin": {"latitude": 47.0, "longitude": 8.0, "altitude": 400.0},
        "geofence": {"lo": [-6, -5, -0.5], "hi": [6, 5, 4]},
        "harness": {"min_separation": 0.3, "boot": 0.0, "position_noise": 0.0, "start_timeout": 10.0, **settings},
        "robots": robots,
    }  # fmt: skip
    (root / "scenario.json").write_text(json.dumps(scenario))
    beside(root, PROGRAM)
    return root


def beside(root: Path, text: str) -> None:
    """What a sim bundle holds of its program."""
    program = checked(text)
    (root / "program.py").write_text(program_text(program))
    (root / "properties.py").write_text(properties_text(program))
    (root / "source").mkdir(exist_ok=True)
    (root / "source/fake.koord").write_text(text)
    (root / "source/params.json").write_text("{}")


def enlist() -> None:
    """Make the scene know the device."""
    scene.DEVICES["idle"] = f"{Telling.__module__}:{Telling.__qualname__}"


if __name__ == "__main__":
    enlist()
    raise SystemExit(harness.main(Path(sys.argv[1]), sys.argv[2:]))
