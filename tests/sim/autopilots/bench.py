"""A simulated autopilot whose agent is the test: commands and setpoints by hand, and what comes back."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import ORIGIN, Rig
from koordgen.runtime.values.geodesy import LocalFrame
from targets.mavlink.framing import Framer, Message

ARM, TAKEOFF, MODE = mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_DO_SET_MODE
INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
FRAME = LocalFrame(*ORIGIN)


class Bench:
    """An autopilot whose agent is the test."""

    def __init__(self, **how: Any) -> None:
        self.rig = Rig(**how)
        assert self.rig.autopilot is not None
        self.copter = self.rig.autopilot.copter
        self.heard: list[Message] = []
        self._packer = mavlink.MAVLink(None, 255, 190)
        self._framer = Framer()

    def send(self, message: Message) -> None:
        self.rig.wire.send(bytes(message.pack(self._packer)))

    def wait(self, seconds: float) -> list[Message]:
        self.rig.pass_time(seconds)
        self.heard = [m for data, _ in self.rig.wire.receive(0.0) for m in self._framer.datagram(data)]
        return self.heard

    def command(self, command: int, *params: float) -> int:
        """Its MAV_RESULT."""
        seven = (*params, *(0.0,) * (7 - len(params)))
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, *seven))
        acks = [m for m in self.wait(0.02) if m.get_msgId() == 77]
        assert len(acks) == 1 and acks[0].command == command
        return int(acks[0].result)

    def of(self, number: int) -> list[Message]:
        return [m for m in self.heard if m.get_msgId() == number]

    def fly(self, height: float = 2.0) -> None:
        self.wait(3.0)
        assert self.command(MODE, 1, 4) == 0
        assert self.command(ARM, 1) == 0
        assert self.command(TAKEOFF, 0, 0, 0, 0, 0, 0, height) == 0
        self.wait(8.0)
        assert self.rig.body.position[2] == pytest.approx(height, abs=0.1)

    def global_setpoint(self, mask: int, frame: int, x: float, y: float, alt: float, *velocity: float) -> None:
        latitude, longitude, _ = FRAME.geodetic(x, y, 0.0)
        self.send(
            mavlink.MAVLink_set_position_target_global_int_message(
                0, 1, 1, frame, mask, round(latitude * 1e7), round(longitude * 1e7), alt, *(velocity or (0, 0, 0)),
                0, 0, 0, 0, 0,
            )
        )  # fmt: skip

    def local_setpoint(
        self, mask: int, frame: int, north: float, east: float, down: float, *velocity: float,
        push: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, frame, mask, north, east, down, *(velocity or (0, 0, 0)), *push, 0, 0
            )
        )

    def heartbeats(self, seconds: float, *setpoint: float, mask: int = 0xDC7) -> None:
        """Time passes with the ground station alive; a local setpoint at its beginning."""
        if setpoint:
            self.local_setpoint(mask, 1, 0, 0, 0, *setpoint)
        self.wait(seconds)

    @property
    def at(self) -> tuple[float, float, float]:
        x, y, z = self.rig.body.position
        return x, y, z
