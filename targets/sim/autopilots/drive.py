"""The simulated drive of a car: a VESC behind a serial line (or a rover: rover.py).

It talks the VESC protocol and drives a simulated body; its own numbers (gains) are those of the robot's settings, so
that a wrong gain in the fleet file is no more noticed here than a right one: calibration is for the real car.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from targets.car.base.settings import CarSettings, decode
from targets.car.drive import vesc
from targets.sim.base.bodies import Car, Device, DeviceContext
from targets.sim.base.upset import Upset

TIMEOUT = 0.5  # seconds without a command after which the VESC brakes by itself; asking for values is none
SUPPLY, EMPTY = 11.1, 9.0  # volts, of a usual and of an empty battery
CUT_OFF = 9.2  # volts below which the VESC gives up
UNDER_VOLTAGE = 2  # mc_fault_code
FIRMWARE = 6, 5


class Controller:
    """The VESC itself, without its cable: bytes in, bytes out, a body driven."""

    def __init__(self, body: Car, settings: CarSettings, upset: Upset | None = None) -> None:
        self._body = body
        self._upset = upset or Upset()
        self._settings = settings
        self._decoder = vesc.Decoder()
        self._speed: float | None = None  # None: it brakes
        self._braking = settings.braking
        self._steering = 0.0
        self._commanded = -math.inf

    def step(self, received: bytes, now: float) -> bytes:
        """Take what arrived, drive the body, and return the answers."""
        answers = b""
        for message in self._decoder.feed(received):
            match message:
                case vesc.SetErpm(erpm):
                    self._speed, self._commanded = erpm / self._settings.speed_to_erpm_gain, now
                case vesc.Brake(current):
                    self._speed, self._commanded = None, now
                    self._braking = self._settings.braking * current / self._settings.brake_current
                case vesc.SetServo(position):
                    off = min(1.0, max(0.0, position)) - self._settings.steering_to_servo_offset
                    angle = off / self._settings.steering_to_servo_gain
                    self._steering = max(-self._settings.max_steering, min(self._settings.max_steering, angle))
                case vesc.AskValues():
                    erpm = self._wheel_speed() * self._settings.speed_to_erpm_gain
                    answers += vesc.encode(vesc.Values(erpm, self._volts, UNDER_VOLTAGE if self._empty else 0))
                case vesc.AskVersion():
                    answers += vesc.encode(vesc.Version(*FIRMWARE))
                case vesc.Values() | vesc.Version():
                    pass  # an answer is no question
        if now - self._commanded > TIMEOUT or self._empty:
            self._speed, self._braking = None, self._settings.braking
        self._body.drive(self._speed or 0.0, self._steering)
        if self._speed is None:
            self._body.brake(self._braking)
        return answers

    @property
    def _volts(self) -> float:
        return EMPTY + (SUPPLY - EMPTY) * self._upset.battery

    @property
    def _empty(self) -> bool:
        return self._volts < CUT_OFF

    def _wheel_speed(self) -> float:
        state = self._body.state()
        return state.velocity[0] * math.cos(state.yaw) + state.velocity[1] * math.sin(state.yaw)


class SimulatedDrive:
    """targets.sim.base.bodies.Device for a car: the serial line to a controller."""

    def __init__(self, body: Car, context: DeviceContext) -> None:
        settings = decode(context.settings)
        self._controller = Controller(body, settings, context.upset)
        self._unsent = b""
        self._terminal = context.wiring.terminal()
        self.overrides: Mapping[str, Any] = {"drive": f"vesc:{self._terminal.device}"}

    def step(self, now: float) -> None:
        self._unsent = self._unsent + self._controller.step(self._terminal.read(), now)
        self._unsent = self._unsent[-4096:]  # an agent that does not read its answers does not fill our memory
        if self._unsent:
            self._unsent = self._unsent[self._terminal.write(self._unsent) :]

    def close(self) -> None:
        self._terminal.close()


def simulated(body: Car, context: DeviceContext) -> Device:
    """What stands in for the drive that the robot's settings name: a VESC, or an ArduPilot rover."""
    if str(context.settings.get("drive", "")).startswith("rover:"):
        from targets.sim.autopilots.rover import SimulatedRover  # others do not pay for pymavlink

        return SimulatedRover(body, context)
    return SimulatedDrive(body, context)
