"""Meaning of ports in a module of the user's own: all back ends follow it."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.fixtures.fleet import FakePlatform
from koordgen.build.emit.program import program_text
from koordgen.cli import main
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import initial, round_, run_init
from koordgen.runtime.config.settings import Box, Safety
from koordgen.runtime.program.program import Program
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.interface import VehicleInterface
from koordgen.runtime.vehicle.platform import Sensed
from koordgen.runtime.vehicle.safety import SafetyGuard, own_position
from tests.lang.semantics.programs import compiled
from tests.sim.follow.test_follow import found
from tests.verify.audit.test_followed import agrees

ARM = """\
using Arm:
  sensors:
    Point tip as position
    bool there
  actuators: Point grip at tip clears there
  assume there' or not there
local:
  bool asked
  bool began_there
  bool began_at_tip
init:
  began_there = Arm.there
  began_at_tip = Arm.grip == Arm.tip
Grip:
  pre: not asked
  eff:
    Arm.grip = Point(1, 0, 0)
    asked = True
End:
  pre: asked
  eff: stop
"""
ENVIRONMENT = "Arm.tip: {grid: {lo: [2, 0, 0], hi: [2, 0, 0], step: 1}}\n"
DRIVER = """\
class Arm:
    sensors = {"tip": "Point", "there": "bool"}
    actuators = {"grip": "Point"}

    def sense(self):
        return {"tip": (2, 0, 0), "there": True}

    def command(self, values):
        pass
"""
BEGINNING = "invariant There: forall i in ID: began_there[i]\ninvariant AtTip: forall i in ID: began_at_tip[i]\n"
STILL_THERE = "invariant StillThere: forall i in ID: not asked[i] or Arm.there[i]\n"
TIP, THERE, GRIP = "Arm.tip", "Arm.there", "Arm.grip"


def state_after_a_command() -> State:
    program = compiled(ARM)
    first = initial(program, 1, [{TIP: Point(2, 0, 0), THERE: True}])
    state, _ = run_init(program, first)
    assert state.robots[0].locals["began_at_tip"] is True
    state, steps = round_(program, state)
    assert isinstance(steps[0].outcome, Writes)
    return state


def generated() -> Program:
    scope: dict[str, object] = {"__file__": "program.py"}
    exec(program_text(compiled(ARM)), scope)
    program = scope["PROGRAM"]
    assert isinstance(program, Program)
    return program


def test_semantics() -> None:
    assert state_after_a_command().robots[0].ports == {TIP: Point(2, 0, 0), THERE: False, GRIP: Point(1, 0, 0)}


def test_robots() -> None:
    box = Box(Point(-9, -9, -9), Point(9, 9, 9))
    body = VehicleInterface(generated(), FakePlatform(Point()), box, 1.0, pytest.fail)
    body.begin(Sensed({TIP: Point(2, 0, 0), THERE: False}, 0.5))
    assert body.actuators == {GRIP: Point(2, 0, 0)}
    assert body.sensors(Sensed({TIP: Point(2, 0, 0), THERE: False}, 0.5))[THERE] is True
    body.command({GRIP: Point(1, 0, 0)}, 1.0)
    assert body.sensors(Sensed({TIP: Point(2, 0, 0), THERE: True}, 0.9))[THERE] is False
    assert body.sensors(Sensed({TIP: Point(1, 0, 0), THERE: True}, 1.1))[THERE] is True


def test_geofence() -> None:
    sensed = Sensed({"Motion.position": Point(), TIP: Point(9, 0, 0)}, 1.0)
    guard = SafetyGuard(Safety(outside_fence=0.0), Box(Point(-1, -1, -1), Point(1, 1, 1)), (TIP,))
    assert own_position(sensed, (TIP,)) == Point(9, 0, 0)
    guard.judge(sensed, 1.0)
    assert guard.judge(sensed, 1.1).action == "stop"


def test_prover(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    app = tmp_path / "arm.koord"
    app.write_text(ARM + BEGINNING)
    assert main(["prove", str(app)]) == 0
    assert capsys.readouterr().out.count("PROVED") == 2


def test_explorer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    app, environment = tmp_path / "arm.koord", tmp_path / "env.yaml"
    app.write_text(ARM + BEGINNING)
    environment.write_text(ENVIRONMENT)
    command = ["explore", str(app), "--robots", "2", "--env", str(environment)]
    assert main(command) == 0
    app.write_text(ARM + STILL_THERE)
    assert main(command) == 3
    assert "StillThere" in capsys.readouterr().out


def test_agents_simulator_and_audit_agree_with_the_provers_counterexample(tmp_path: Path) -> None:
    (tmp_path / "arm.py").write_text(DRIVER)
    trace = found(tmp_path, ARM + STILL_THERE, 2, command="prove")
    agrees(tmp_path, trace, 2, served="modules: {Arm: arm:Arm}\n")
