"""Simulated drive of a car: a VESC behind a serial line. An ArduPilot rover is in rover.py.

It speaks the VESC protocol and drives a simulated body. Its gains are the robot's own settings, so a wrong gain in the
fleet file is not noticed here. Only a calibration on the real car finds it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from targets.car.base.settings import CarSettings, decode
from targets.car.drive import vesc
from targets.sim.base.bodies import CarBody, Device, DeviceContext
from targets.sim.base.fault_state import FaultState

TIMEOUT = 0.5  # seconds without a command after which the VESC brakes by itself; a request for values is no command
SUPPLY, EMPTY = 11.1, 9.0  # volts of a usual and of an empty battery
CUT_OFF = 9.2  # volts below which the VESC cuts off the motor
UNDER_VOLTAGE = 2  # mc_fault_code
FIRMWARE = 6, 5


class Controller:
    """A VESC without its cable: reads and returns bytes, and drives a body."""

    def __init__(self, body: CarBody, settings: CarSettings, fault_state: FaultState | None = None) -> None:
        self._body = body
        self._fault_state = fault_state or FaultState()
        self._settings = settings
        self._decoder = vesc.Decoder()
        self._speed: float | None = None  # m/s; None: braking
        self._braking = settings.braking
        self._steering = 0.0
        self._commanded = -math.inf

    def step(self, received: bytes, now: float) -> bytes:
        """Handle the received bytes, drive the body, and return the answers."""
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
                    pass  # an answer, not a request
        if now - self._commanded > TIMEOUT or self._empty:
            self._speed, self._braking = None, self._settings.braking
        self._body.drive(self._speed or 0.0, self._steering)
        if self._speed is None:
            self._body.brake(self._braking)
        return answers

    @property
    def _volts(self) -> float:
        return EMPTY + (SUPPLY - EMPTY) * self._fault_state.battery

    @property
    def _empty(self) -> bool:
        return self._volts < CUT_OFF

    def _wheel_speed(self) -> float:
        state = self._body.state()
        return state.velocity[0] * math.cos(state.yaw) + state.velocity[1] * math.sin(state.yaw)


class SimulatedDrive:
    """Device of a car: serial line to a simulated VESC."""

    def __init__(self, body: CarBody, context: DeviceContext) -> None:
        settings = decode(context.settings)
        self._controller = Controller(body, settings, context.fault_state)
        self._unsent = b""
        self._terminal = context.wiring.terminal()
        self.overrides: Mapping[str, Any] = {"drive": f"vesc:{self._terminal.device}"}

    def step(self, now: float) -> None:
        self._unsent = self._unsent + self._controller.step(self._terminal.read(), now)
        self._unsent = self._unsent[-4096:]  # bound the memory if an agent never reads its answers
        if self._unsent:
            self._unsent = self._unsent[self._terminal.write(self._unsent) :]

    def close(self) -> None:
        self._terminal.close()


def simulated(body: CarBody, context: DeviceContext) -> Device:
    """Return the device for the drive that the robot's settings name: a VESC or an ArduPilot rover."""
    if str(context.settings.get("drive", "")).startswith("rover:"):
        from targets.sim.autopilots.rover import SimulatedRover  # so that runs without a rover do not import pymavlink

        return SimulatedRover(body, context)
    return SimulatedDrive(body, context)
