"""How closely a quad follows its targets: `python benchmarks/quad_tracking.py [--connect URL] [--quick] [--json FILE]`.

Without --connect: against the simulated autopilot, in this process and in simulated time. With it: against the
autopilot at that URL (as the quad's setting `autopilot`), in real time. It connects, arms, takes off to 2 m above where
the vehicle stands, flies within 8 m of there, and lands; Ctrl-C lands at once.

First the autopilot itself: what plain setpoints make of it, beside what was observed on ArduPilot 4.7. Then our layer
over the same autopilot. An error is the distance between where the target is and where the newest telemetry puts the
vehicle, 20 times a second, without the first seconds of a run, in which the vehicle catches up. The last row is the CPU
time of this process within the agent's polls (MAVLink parsing at the streams that it asks for, telemetry, trajectory,
setpoints) over the seconds flown. Ends with 1 when a row is off.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Unready
from targets.mavlink.link import Link
from targets.mavlink.transport import opened
from targets.quad.autopilot.flight import Flight, FlightPhase
from targets.quad.autopilot.telemetry import Telemetry
from targets.quad.motion.motion import Motion
from targets.quad.motion.setpoint import ARDUPILOT, Aim, Shaping, setpoint

HEIGHT, ROOM = 2.0, 12.0
CLIMB = 0.7  # m/s
TICK = 0.05
RADIUS, SPEED = 2.0, 0.8
Way = Callable[[float], tuple[Point, Point]]  # time -> position and velocity, relative to the take-off


@dataclass(frozen=True)
class Row:
    """One figure, with ArduPilot 4.7's in `observed`. `most`, `least`: allowed range; None if it is only reported."""

    name: str
    value: float
    unit: str = "m"
    observed: float | None = None
    least: float | None = None
    most: float | None = None

    @property
    def good(self) -> bool:
        return (self.least is None or self.value >= self.least) and (self.most is None or self.value <= self.most)


class Simulated:
    """The simulated autopilot and its clock."""

    def __init__(self) -> None:
        from benchmarks.fixtures.quad_rig import ORIGIN, Rig  # not needed with --connect

        self.rig = Rig(position=(0.0, 0.0, 0.0))
        self.link = Link(self.rig.wire)
        self.frame = LocalFrame(*ORIGIN)

    def now(self) -> float:
        return self.rig.now

    def tick(self) -> None:
        self.rig.pass_time(TICK)


class Connected:
    """An autopilot at a URL and the computer's clock. The frame's origin is the initial position of the vehicle."""

    def __init__(self, url: str) -> None:
        self.link = Link(opened(url))
        self._next = time.monotonic()
        self.frame = self._found(url)

    def now(self) -> float:
        return time.monotonic()

    def tick(self) -> None:
        self._next = max(self._next + TICK, time.monotonic() - TICK)
        time.sleep(max(0.0, self._next - time.monotonic()))

    def _found(self, url: str) -> LocalFrame:
        position, asked = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, -math.inf
        for _ in range(round(90 / TICK)):
            self.tick()
            now = self.now()
            self.link.greet(now)
            for message in self.link.receive(now):
                if message.get_msgId() == position and (message.lat or message.lon):
                    return LocalFrame(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
            if self.link.vehicle is not None and now - asked > 1.0:
                asked = now
                self.link.send_once(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, position, 1e6 / 20)
        raise Unready(f"no autopilot with a position on {url} within 90 s")


class Pilot:
    """One flight, with the rows measured on it."""

    def __init__(self, world: Simulated | Connected, url: str) -> None:
        self.world, self.link, self.frame = world, world.link, world.frame
        self.fence = Box(Point(-ROOM, -ROOM, -3.0), Point(ROOM, ROOM, HEIGHT + 6.0))
        self.telemetry = Telemetry(self.frame)
        self.flight = Flight(
            url, self.link, self.telemetry, self.fence, HEIGHT, CLIMB, lambda p: self.send(Aim(p)),
            lambda firmware: tuple(replace(w, vital=False) for w in firmware.parameters), world.now(),
        )  # fmt: skip
        self.cpu = self.flown = 0.0

    def motion(self, shaping: Shaping = ARDUPILOT, speed: float = 1.0) -> Motion:
        return Motion(self.frame, self.fence, HEIGHT, speed, 1.0, CLIMB, 0.15, 0.3, shaping=shaping)

    def send(self, aim: Aim) -> None:
        if self.link.vehicle is not None:
            self.link.send(setpoint(self.link.vehicle, self.frame, self.fence, aim))

    @property
    def at(self) -> Point:
        return self.telemetry.position or Point()

    def tick(self, motion: Motion | None = None) -> None:
        """Advance the world, then run one poll of an agent."""
        self.world.tick()
        began, now = time.process_time(), self.world.now()
        self.flight.poll(now)
        if motion is not None and self.telemetry.fresh(now):
            motion.steer(self.link, self.telemetry, now)
            self.cpu, self.flown = self.cpu + time.process_time() - began, self.flown + TICK

    def command(self, motion: Motion, *points: Point) -> None:
        """Command a target as a program does."""
        began = time.process_time()
        motion.command(points, self.world.now())
        self.cpu += time.process_time() - began

    def take_off(self) -> None:
        said = ""
        for _ in range(round(180 / TICK)):
            self.tick()
            if self.flight.progress != said:
                said = self.flight.progress
                print(f"  {said}", file=sys.stderr)
            if self.flight.phase is FlightPhase.FLYING:
                return
        raise Unready(f"not in the air after 180 s: {said}")

    def land(self) -> None:
        self.flight.stop(self.world.now())
        for _ in range(round(90 / TICK)):
            self.tick()
            if self.flight.phase is FlightPhase.STOPPED:
                return
        raise Unready(f"not landed after 90 s: {self.flight.progress}")

    def go(self, p: Point, motion: Motion | None = None) -> None:
        """Fly to a point with our own layer, and wait until the vehicle is still."""
        motion = motion or self.motion()
        self.command(motion, p)
        for _ in range(round(40 / TICK)):
            self.tick(motion)
            if motion.reached:
                break
        for _ in range(round(3 / TICK)):
            self.tick(motion)

    def errors(self, way: Way, seconds: float, each: Callable[[int, Point, Point], Motion | None]) -> list[float]:
        """Return the distances from the reference at each tick. `each` sends or commands its position and velocity."""
        found = []
        for i in range(round(seconds / TICK)):
            p, v = way(i * TICK)
            found.append(math.hypot(self.at.x - p.x, self.at.y - p.y))
            self.tick(each(i, p, v))
        return found

    def plain(self, way: Way, seconds: float, moving: bool, every: int = 1) -> list[float]:
        """Send setpoints directly, one in so many ticks."""
        self.go(way(0.0)[0])

        def each(i: int, p: Point, v: Point) -> None:
            if i % every == 0:
                self.send(Aim(p, v if moving else None))

        found = self.errors(way, seconds, each)
        self.send(Aim(self.at))
        return found

    def ours(self, way: Way, seconds: float, shaping: Shaping = ARDUPILOT, every: int = 1) -> list[float]:
        """Command a target to our layer, one in so many ticks, as a program does."""
        motion = self.motion(shaping)
        self.go(way(0.0)[0], motion)

        def each(i: int, p: Point, v: Point) -> Motion:
            if i % every == 0:
                self.command(motion, p)
            return motion

        return self.errors(way, seconds, each)

    def lap(self) -> list[float]:
        """Fly a circle as a path of 48 points. Return the distances from the circle."""
        motion = self.motion(speed=SPEED)
        self.go(circle(0.0)[0], motion)
        points = tuple(circle(i / 48 * math.tau * RADIUS / SPEED)[0] for i in range(1, 49))
        self.command(motion, *points)
        found: list[float] = []
        while not motion.reached and len(found) < 40 / TICK:
            self.tick(motion)
            found.append(abs(math.hypot(self.at.x + RADIUS, self.at.y) - RADIUS))
        return found

    def step(self, shaping: Shaping = ARDUPILOT) -> tuple[float, float]:
        """Command a target 1 m away. Return the overshoot (m), and the seconds until it is `reached`."""
        motion = self.motion(shaping)
        self.go(Point(0.0, 0.0, HEIGHT), motion)
        began, start = self.world.now(), self.at
        self.command(motion, start + Point(1.0))
        furthest, reached = 0.0, 0.0
        for _ in range(round(8 / TICK)):
            self.tick(motion)
            furthest = max(furthest, self.at.x - start.x)
            reached = reached or (self.world.now() - began if motion.reached else 0.0)
        return furthest - 1.0, reached

    def stopped(self) -> float:
        """Command a target that moves at 0.5 m/s and stops at once. Return the overshoot (m)."""
        motion = self.motion()
        self.go(carrot(0.0)[0], motion)
        for i in range(round(6 / TICK)):
            self.command(motion, carrot(i * TICK)[0])
            self.tick(motion)
        furthest, end = 0.0, carrot(6.0 - TICK)[0]
        for _ in range(round(4 / TICK)):
            self.tick(motion)
            furthest = max(furthest, end.x - self.at.x)
        return furthest


def carrot(t: float) -> tuple[Point, Point]:
    """Move at 0.5 m/s to the west, from 3 m east of the start."""
    return Point(3.0 - 0.5 * t, 0.0, HEIGHT), Point(-0.5)


def circle(t: float) -> tuple[Point, Point]:
    """Move on a circle through the start; its centre is west of it."""
    turn = t * SPEED / RADIUS
    return (
        Point(RADIUS * math.cos(turn) - RADIUS, RADIUS * math.sin(turn), HEIGHT),
        Point(-SPEED * math.sin(turn), SPEED * math.cos(turn)),
    )


def mean(values: list[float]) -> float:
    return sum(values) / len(values)


def measured(pilot: Pilot, quick: bool) -> list[Row]:
    """Return all rows, in the order of the flight."""
    straight, turns = (9.0, 16.0) if quick else (12.0, 32.0)

    def told(row: Row) -> Row:
        print(line(row), flush=True)
        return row

    def laps(errors: list[float]) -> float:
        return mean(errors[round(4 / TICK) :])

    def lag(errors: list[float]) -> float:
        return mean(errors[-round(4 / TICK) :])

    def observed(name: str, value: float, there: float) -> Row:
        return told(Row(name, value, "m", there, there * 0.85, there * 1.15))

    rows = [
        observed("plain position 20 Hz, 0.5 m/s: lag", lag(pilot.plain(carrot, straight, False)), 0.54),
        told(Row("plain position 1 Hz, 0.5 m/s: lag", lag(pilot.plain(carrot, straight, False, 20)), observed=0.82)),
        observed("plain position and velocity, 2 m circle: error", laps(pilot.plain(circle, turns, True)), 0.26),
        told(Row("ours, target 20 Hz, 0.5 m/s: lag", lag(pilot.ours(carrot, straight)), most=0.15)),
        told(Row("ours, target 5 Hz, 0.5 m/s: lag", lag(pilot.ours(carrot, straight, every=4)))),
        told(Row("ours, target 20 Hz, 2 m circle: error", laps(pilot.ours(circle, turns)), most=0.12)),
        told(Row("ours, circle as a path of 48 points: distance from it", mean(pilot.lap()), most=0.12)),
    ]
    over, reached = pilot.step()
    rows.append(told(Row("ours, step of 1 m: overshoot", over, most=0.05)))
    rows.append(told(Row("ours, step of 1 m: reached after", reached, "s")))
    rows.append(told(Row("ours, target stops dead at 0.5 m/s: overshoot", pilot.stopped())))
    for share in () if quick else (0.7, 1.3):
        off = scaled(ARDUPILOT, share)
        words = f"lead {share - 1:+.0%}"
        rows.append(told(Row(f"{words}, target 0.5 m/s: lag", lag(pilot.ours(carrot, straight, off)))))
        rows.append(told(Row(f"{words}, 2 m circle: error", laps(pilot.ours(circle, turns, off)))))
        rows.append(told(Row(f"{words}, step of 1 m: overshoot", pilot.step(off)[0])))
    rows.append(told(Row("agent's CPU at 20 Hz, of one core", pilot.cpu / pilot.flown * 100, "%", most=6.0)))
    return rows


def scaled(shaping: Shaping, share: float) -> Shaping:
    """Scale our model of the autopilot, as if it were that much faster or slower than assumed."""
    late, lead = ((a * share, b * share) for a, b in (shaping.late, shaping.lead))
    return Shaping(late, lead, shaping.delay * share, shaping.ahead)


def line(row: Row) -> str:
    observed = "" if row.observed is None else f"{row.observed:.2f}"
    within = "" if row.most is None else f"<= {row.most:.2f}"
    if row.least is not None:
        within = f"{row.least:.2f} to {row.most:.2f}"
    off = "" if row.good else "OFF"
    return f"{row.name:<56} {row.value:7.3f} {row.unit:<2} {observed:>9} {within:>13} {off}".rstrip()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connect", metavar="URL", help="an autopilot, instead of the simulated one")
    parser.add_argument("--quick", action="store_true", help="shorter runs, no rows with a wrong lead")
    parser.add_argument("--json", metavar="FILE", help="write the rows there as well")
    options = parser.parse_args()
    try:
        if options.connect:
            print(
                f"This arms the vehicle on {options.connect}, takes off to {HEIGHT:g} m, flies within 8 m of there, "
                "and lands. Ctrl-C lands at once.",
                file=sys.stderr,
            )
        pilot = Pilot(Connected(options.connect) if options.connect else Simulated(), options.connect or "simulation")
        print(f"{'':<56} {'measured':>10} {'ArduPilot':>9} {'wanted':>13}")
        try:
            pilot.take_off()
            rows = measured(pilot, options.quick)
        finally:
            pilot.land()
            pilot.link.close()
    except KeyboardInterrupt:
        return 130
    except Unready as fault:
        print(f"{fault.message}{'; ' if fault.hint else ''}{fault.hint}", file=sys.stderr)
        return 5
    if options.json:
        Path(options.json).write_text(json.dumps([{**asdict(r), "good": r.good} for r in rows], indent=2) + "\n")
    return 0 if all(r.good for r in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
