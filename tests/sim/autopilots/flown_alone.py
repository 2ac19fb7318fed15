"""A simulated autopilot as a process of its own. `python -m tests.sim.autopilots.flown_alone FIRMWARE SPEED` prints the
UDP port to which it sends, and flies so many times faster than real time until its standard input ends."""

from __future__ import annotations

import select
import sys
import time

from benchmarks.fixtures.quad_rig import ORIGIN, STEP, PointMass
from targets.sim.autopilots.autopilot import SimulatedAutopilot
from targets.sim.base.bodies import DeviceContext
from targets.sim.base.ports import UdpPort


def main(firmware: str, speed: float) -> None:
    port = UdpPort()
    body = PointMass((0.0, 0.0, 0.0))
    context = DeviceContext("alice", {}, {"boot": 1.0, "spool_up": 0.5, "firmware": firmware}, ORIGIN, 7, b"")
    autopilot = SimulatedAutopilot(body, context, port)
    print(port.number, flush=True)
    begun, steps, ahead = time.monotonic(), 0, 0.0
    while not select.select([sys.stdin], [], [], max(0.0, ahead))[0]:
        steps += 1
        body.step(STEP)
        autopilot.step(steps * STEP)
        ahead = begun + steps * STEP / speed - time.monotonic()
        if ahead < -0.1:  # the host was busy: go on from here, rather than hurry past a client that was held up as well
            begun -= ahead
    autopilot.close()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
