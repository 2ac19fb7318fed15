"""CPU of a simulated autopilot at 240 Hz, as a share of a core: `python benchmarks/sim_autopilot.py`.

It flies a point mass and talks over loopback UDP to a client that behaves like an agent: setpoints at 20 Hz, the
agent's streams, a heartbeat a second. Only the steps of the autopilot are counted. Exit status 1: more than `BUDGET`.
"""

from __future__ import annotations

import argparse
import json
import socket
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import ORIGIN, STEP, PointMass
from targets.quad.autopilot.ardupilot import ARDUPILOT
from targets.sim.autopilots.autopilot import SimulatedAutopilot
from targets.sim.base.bodies import DeviceContext
from targets.sim.base.ports import UdpPort

BUDGET = 0.04  # share of a core
POSITION_VELOCITY = 0xDC0


class Client:
    """The autopilot, its body and the client that it talks to, on a simulated clock."""

    def __init__(self) -> None:
        port = UdpPort()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port.number))
        self._socket.settimeout(1.0)
        self._body = PointMass()
        context = DeviceContext("alice", {}, {"boot": 1.0, "position_noise": 0.005}, ORIGIN, 7, b"")
        self.autopilot = SimulatedAutopilot(self._body, context, port)
        self._packer = mavlink.MAVLink(None, 255, 190)
        self._steps = 0
        self.messages = 0

    def fly(self, seconds: float, setpoints: bool) -> float:
        """Return the CPU seconds of the autopilot."""
        spent = 0.0
        for _ in range(round(seconds / STEP)):
            self._steps += 1
            if setpoints and self._steps % 12 == 0:
                x = 0.1 * STEP * (self._steps % 2400)
                self.send(
                    mavlink.MAVLink_set_position_target_local_ned_message(
                        0, 1, 1, 1, POSITION_VELOCITY, x, 0, -2, 0.1, 0, 0, 0, 0, 0, 0, 0
                    )
                )
            if self._steps % 240 == 1 and self._steps > 240:
                self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            self._body.step(STEP)
            began = time.process_time()
            self.autopilot.step(self._steps * STEP)
            spent += time.process_time() - began
            self._drain()
        return spent

    def send(self, message: mavlink.MAVLink_message) -> None:
        self._socket.sendto(message.pack(self._packer), self._address)

    def command(self, command: int, *params: float) -> None:
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, *params, *(0.0,) * (7 - len(params))))
        self.fly(0.1, False)

    def greet(self) -> None:
        """Wait for the first heartbeat, and record its sender's address."""
        self.autopilot.step(STEP)
        self._address = self._socket.recvfrom(2048)[1]
        self._socket.setblocking(False)

    def _drain(self) -> None:
        try:
            while True:
                self._socket.recv(2048)
                self.messages += 1
        except BlockingIOError:
            return


def measured(seconds: float) -> dict[str, float]:
    """Return the share of a core, and the number of messages sent per second."""
    client = Client()
    client.greet()
    client.fly(3.0, False)
    client.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    client.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0)
    client.fly(6.0, False)
    for message, rate in ARDUPILOT.rates.items():
        client.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message, 1e6 / rate)
    assert client.autopilot.copter.following
    client.messages = 0
    spent = client.fly(seconds, True)
    return {"share_of_a_core": spent / seconds, "messages_per_second": client.messages / seconds}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="10 s of flight instead of 100")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    arguments = parser.parse_args()
    seconds = 10.0 if arguments.quick else 100.0
    figures = measured(seconds)
    print(f"a simulated autopilot at 240 Hz, {seconds:.0f} s of flight")
    print(f"  share of a core      {figures['share_of_a_core']:8.2%}  (at most {BUDGET:.0%})")
    print(f"  messages a second    {figures['messages_per_second']:8.1f}")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps({"seconds": seconds, "budget": BUDGET, **figures}, indent=2) + "\n")
    return 0 if figures["share_of_a_core"] <= BUDGET else 1


if __name__ == "__main__":
    raise SystemExit(main())
