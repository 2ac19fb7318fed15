"""Instance: one application at work on a robot, with its private variables and the outputs that wait for a commit.

A robot with one application has one instance, which sees all values of the robot. With several, each sees the variables
and ports of its own program, by the program's names."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import msgspec

from koordgen.runtime.agent.output_commit import OutputCommit
from koordgen.runtime.program.fleet_program import FleetProgram, RobotInstance
from koordgen.runtime.program.program import Calls, Effects, Frame, Life
from koordgen.runtime.program.runner import STOPPED, Call, EventResult, Limit, Runner
from koordgen.runtime.trace.monitored import Observation
from koordgen.runtime.values.clock import Clock
from koordgen.runtime.vehicle.interface import unusable


class InstanceRun(msgspec.Struct, gc=False):
    """Event of instance number `place` of a robot in the present round.

    life: private state after an event with effects; None before it is known, or without effects."""

    place: int
    instance: AgentInstance
    frame: Frame
    result: EventResult
    calls: Calls
    life: Life | None = None


class AgentInstance:
    """Instance of an application on this robot.

    number: number of the instance in the fleet; see RobotInstance.
    application: name of the application; "" if the fleet has only one.
    drives: the application commands the vehicle, so the vehicle holds if this instance fails or stops.
    share: weight of this instance when the time for events is divided.
    now: returns the present local time, in seconds.
    stopped: the program has stopped in this instance.
    is_faulty: its last event was discarded.
    watched: True if monitors need `observation`: what the instance knew at the beginning of the last closed round.
    """

    def __init__(self, runner: Runner, number: int, now: Callable[[], float]) -> None:
        self.runner, self.number, self.now = runner, number, now
        self.outputs = OutputCommit(Life(-1, runner.locals, {}, False), number)
        self.application, self.share, self.drives = "", 1.0, True
        self.stopped = self.is_faulty = self.watched = False
        self.observation: Observation | None = None
        self.restored: Life | None = None  # private state that a rejoin has restored; the next record reports it
        self.counts: dict[
            str, int
        ] = {}  # outcome, such as "faults" -> number of this instance's events with this outcome
        self._is_positioned = True  # the program reads the robot's position, or is the only one
        # Names that the program knows; None: the program is the only one, so it knows all names of the robot.
        self._views: tuple[tuple[str, str], ...] | None = None
        self._sensors: tuple[str, ...] = ()
        self._actuators: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, fleet: FleetProgram, instance: RobotInstance, clock: Clock, limit: Limit, driven: Collection[str] = ()
    ) -> AgentInstance:
        """Return an instance of a fleet's application. `driven`: modules that drivers serve, not the vehicle."""
        application = fleet.applications[instance.application]
        program, n_sys = application.program, len(application.members)
        runner = Runner(program, instance.pid, n_sys, clock, limit, fleet.constants(instance), application.locks)
        made = cls(runner, instance.number, clock.now)
        if fleet.is_composed:
            made.outputs.rival = "another transaction"  # which may be one of the same robot
            made.application, made.share = application.name, fleet.share(instance)
            made._views = fleet.views(instance.application)
            made._sensors = tuple([p.name for p in program.ports if p.direction == "sensor"])
            made._actuators = tuple([p.name for p in program.ports if p.direction == "actuator"])
            made._is_positioned = any(p.is_position for p in program.ports)
            made.drives = any(name.partition(".")[0] not in driven for name in made._actuators)
        return made

    def begin(self, lives: list[Life]) -> None:
        """Continue from private states, by ascending round. The first state is committed."""
        self.outputs.lives = lives
        self.stopped = self.outputs.life.stopped

    def shared(self, store: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the shared variables of the program, by its names."""
        if self._views is None:
            return store
        return {name: store[stored] for name, stored in self._views}

    def sensors(self, sensors: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the program's sensors, of all sensors of the robot."""
        return sensors if self._views is None else {name: sensors[name] for name in self._sensors}

    def actuators(self, actuators: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the program's actuators, of all actuators of the robot that have a value."""
        if self._views is None:
            return actuators
        return {name: actuators[name] for name in self._actuators if name in actuators}

    def frame(
        self, store: Mapping[str, Any], sensors: Mapping[str, Any], actuators: Mapping[str, Any], call: Call
    ) -> Frame:
        """Return the input of an event. Store, sensors and actuators are those of the whole robot."""
        if self._views is None:
            return self.runner.frame(store, sensors, actuators, call)
        return self.runner.frame(self.shared(store), self.sensors(sensors), self.actuators(actuators), call)

    def hindrance(self, sensors: Mapping[str, Any], unready: str | None) -> str | None:
        """Return the reason why this instance cannot run an event; None if it can.

        unready: reason why the vehicle does not allow an event; None if it does. It concerns only programs that read
        the robot's position.
        """
        if self.stopped:
            return STOPPED
        return unusable(self.sensors(sensors)) or (unready if self._is_positioned else None)

    def life(self, round_: int, effects: Effects, actuators: Mapping[str, Any]) -> Life:
        """Return the private state after an event. `actuators`: those of the robot before the event."""
        after = {**(actuators if self._views is None else self.actuators(actuators)), **effects.actuators}
        return Life(round_, effects.locals, after, effects.stopped or self.stopped)

    def count(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1
