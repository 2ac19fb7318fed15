"""Devices of robots of fidelity `simple`: bodies commanded without an autopilot.

For such a robot the agent's platform reads its position from a device here and commands the body through it. The device
adds errors of positions. It also does what a robot does whose agent has fallen silent: a quad stops, and lands later; a
car brakes. In lockstep the platform calls the device. In real time they exchange datagrams between processes
(simple_agent.py)."""

from __future__ import annotations

import importlib
import math
import random
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import msgspec

from targets.sim.base.bodies import BodyCommand, BodyState, DeviceContext, Vector
from targets.sim.base.ports import Loopback
from targets.sim.physics.first_order import SimpleCarBody, SimpleQuadrotor

HOVER_AFTER, LAND_AFTER = (
    0.5,
    5.0,
)  # s without a command after which a quad hovers, and later lands, as an autopilot does
BRAKE_AFTER = 0.15  # s without a command after which a car brakes, as its watchdog does
SINKING, GROUND = 0.5, 0.02  # m/s, m
SEND_PERIOD = 0.02  # s between two positions sent to the agent
_encode, _decode = msgspec.msgpack.Encoder().encode, msgspec.msgpack.Decoder(BodyCommand).decode


class SimpleDevice(ABC):
    """Device between an agent's platform and a simulated body, without an autopilot."""

    module: ClassVar[str]  # module of the platform; its function `inside` creates the platform in lockstep
    member: ClassVar[str]  # the platform's class
    answered_types: ClassVar[Mapping[str, int]]  # commands of the body -> number of their arguments

    def __init__(self, body: SimpleQuadrotor | SimpleCarBody, context: DeviceContext) -> None:
        self._seen = body
        self._noise = float(context.harness.get("position_noise", 0.0))
        self._dice = random.Random(f"{context.seed}/{context.robot}/simple")
        self._fault_state = context.fault_state
        self._now, self._commanded_at = 0.0, 0.0
        self.overrides: Mapping[str, Any] = {}
        self._port = context.wiring.port() if isinstance(context.wiring, Loopback) else None
        self._next = 0.0

    @property
    def agent(self) -> tuple[str, str] | None:
        """Platform and port to pass to simple_agent.py; None in lockstep."""
        return (f"{self.module}:{self.member}", str(self._port.number)) if self._port else None

    def platform(self, settings: Any, key: bytes | None, inside: Any) -> Any:
        """Create the agent's platform in this process. See koordgen.runtime.vehicle.simulator_services."""
        make: Callable[..., Any] = importlib.import_module(self.module).inside
        return make(settings, key, inside, self)

    def state(self) -> BodyState | None:
        """Return the measured state of the body; None while there is no position."""
        truth = self._fault_state.late(self._now, self._seen.state())
        place = self._fault_state.measured(truth.position, self._noise, self._dice)
        return None if place is None else BodyState(place, truth.velocity, truth.yaw, truth.yaw_rate)

    def step(self, now: float) -> None:
        """See Device."""
        self._now = now
        if self._port is None:
            return
        for datagram in self._port.receive():
            self._execute(datagram)
        if now >= self._next:
            self._next = max(self._next + SEND_PERIOD, now)
            seen = self.state()
            if seen is not None:
                self._port.send(_encode((seen.position, seen.velocity, seen.yaw, seen.yaw_rate)))

    def _execute(self, datagram: bytes) -> None:
        try:
            asked = _decode(datagram)
        except msgspec.DecodeError:
            return
        if self.answered_types.get(asked.what) == len(asked.values) and all(map(math.isfinite, asked.values)):
            self.execute(asked.what, asked.values)

    @abstractmethod
    def execute(self, what: str, values: tuple[float, ...]) -> None:
        """Pass a command of the agent on to the body."""

    def close(self) -> None:
        """See Device."""
        if self._port is not None:
            self._port.close()


class SimpleQuadDevice(SimpleDevice):
    """Device of a simple quad."""

    module, member = "targets.quad.platform.simple", "SimpleQuad"
    answered_types: ClassVar = {"fly": 4, "motors": 1}

    def __init__(self, body: SimpleQuadrotor, context: DeviceContext) -> None:
        super().__init__(body, context)
        self._body = body
        self._flying = False

    def fly(self, velocity: Vector, yaw_rate: float) -> None:
        self._commanded_at = self._now
        self._body.fly(velocity, yaw_rate)

    def motors(self, on: bool) -> None:
        self._commanded_at, self._flying = self._now, on
        self._body.motors(on)

    def execute(self, what: str, values: tuple[float, ...]) -> None:
        """See SimpleDevice."""
        if what == "fly":
            x, y, z, rate = values
            self.fly((x, y, z), rate)
        else:
            self.motors(values[0] > 0.5)

    def step(self, now: float) -> None:
        """See Device."""
        super().step(now)
        silent = now - self._commanded_at
        if not self._flying or silent <= HOVER_AFTER:
            return
        if silent > LAND_AFTER and self._body.state().position[2] < GROUND:
            self._flying = False
            self._body.motors(False)
        self._body.fly((0.0, 0.0, -SINKING if silent > LAND_AFTER else 0.0), 0.0)


class SimpleCarDevice(SimpleDevice):
    """Device of a simple car."""

    module, member = "targets.car.platform.simple", "SimpleCar"
    answered_types: ClassVar = {"drive": 2, "brake": 1}

    def __init__(self, body: SimpleCarBody, context: DeviceContext) -> None:
        super().__init__(body, context)
        self._body = body
        self._braking = float(context.settings.get("braking", 3.0))

    def drive(self, speed: float, steering: float) -> None:
        self._commanded_at = self._now
        self._body.drive(speed, steering)

    def brake(self, deceleration: float) -> None:
        self._commanded_at = self._now
        self._body.brake(deceleration)

    def execute(self, what: str, values: tuple[float, ...]) -> None:
        """See SimpleDevice."""
        if what == "drive":
            self.drive(*values)
        else:
            self.brake(*values)

    def step(self, now: float) -> None:
        """See Device."""
        super().step(now)
        if now - self._commanded_at > BRAKE_AFTER:
            self._body.brake(self._braking)
