"""Reference trajectory: straight legs between waypoints, with limited speed and acceleration.

A trajectory is a chain of pieces of constant acceleration. So its velocity is continuous, its speed is largest at an
end of a piece, and its state can be computed for any time ahead.

A corner is passed on a parabola, on which the velocity turns at the acceleration limit a. The speed v is the same at
both ends. The parabola begins at the distance d = v^2 |du| / 2a before the corner and ends at the same distance behind
it. It passes the corner at the distance v^2 |du|^2 / 8a. Here du is the difference of the unit vectors of the two legs.
Source: L. Biagiotti, C. Melchiorri, "Trajectory Planning for Automatic Machines and Robots", section 3.2.2 and
chapter 8.

Metres and seconds; any Cartesian frame whose z is up.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.safety import inside

CORNER = 0.1  # m; maximum distance from the polyline of waypoints, on a cut corner and when braking within the corner
BULGE = 0.005  # m; maximum distance of the trajectory from its chords
CLOSE = 1e-3  # m; successive waypoints nearer to each other than this count as one
_STILL = 1e-9  # speeds (m/s) and lengths (m) below this count as zero
_BISECTIONS = 10  # bisection steps in the search for the fastest turn towards the first waypoint
ZERO = Point()


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of a trajectory.

    `speed`: m/s, of the velocity in three dimensions.
    `climb`: m/s, of the vertical speed, up or down.
    `acceleration`: m/s^2, in three dimensions.
    `box`: contains every position of the trajectory, and every place at which braking from the trajectory ends. So the
    vehicle stays inside the box even if the trajectory changes later.
    """

    speed: float
    climb: float
    acceleration: float
    box: Box

    def top(self, direction: Point, drift: Point = ZERO) -> float:
        """Return the largest s >= 0 at which the velocity s * direction + drift is within the limits.

        `direction` is a unit vector; `drift` itself is within the limits."""
        return self.most(_dot(direction, drift), direction.z, drift.z, self.speed**2 - _dot(drift, drift))

    def most(self, along: float, up: float, drift_up: float, room: float) -> float:
        """Return the same result as `top`, from precomputed numbers.

        `along`: dot product of direction and drift. `up`, `drift_up`: vertical components of direction and drift.
        `room`: speed^2 - drift^2."""
        s = math.sqrt(max(0.0, along * along + room)) - along
        if up > _STILL:
            s = min(s, (self.climb - drift_up) / up)
        elif up < -_STILL:
            s = min(s, (-self.climb - drift_up) / up)
        return max(0.0, s)

    def limited(self, velocity: Point) -> Point:
        """Return the velocity, scaled down to the limits."""
        size = norm(velocity)
        return velocity if size < _STILL else velocity * min(1.0, self.top(velocity / size) / size)

    def stop(self, state: MotionState) -> Point:
        """Return the position at which braking from this state ends."""
        return state.position + state.velocity * (norm(state.velocity) / (2 * self.acceleration))

    def safe(self, state: MotionState) -> bool:
        """Return whether braking from this state ends within the box."""
        return inside(self.box, self.stop(state))


@dataclass(frozen=True, slots=True)
class MotionState:
    """Position (m) and velocity (m/s) at one time."""

    position: Point
    velocity: Point = ZERO


@dataclass(frozen=True, slots=True)
class Piece:
    """Piece of a trajectory with constant acceleration. `ahead`: index of the next waypoint."""

    seconds: float
    start: MotionState
    acceleration: Point
    ahead: int

    def at(self, t: float) -> MotionState:
        """Return the state t seconds after the piece's beginning."""
        v = self.start.velocity
        return MotionState(self.start.position + v * t + self.acceleration * (t * t / 2), v + self.acceleration * t)


class Trajectory:
    """Chain of pieces of constant acceleration, which ends in the state `end`.

    The velocity of `end` is kept after the last piece. It is zero unless the goal moves."""

    def __init__(self, pieces: Sequence[Piece], end: MotionState, waypoints: int) -> None:
        self.pieces = tuple(pieces)
        self.end = end
        self._waypoints = waypoints
        self._ends = tuple(accumulate(p.seconds for p in self.pieces))
        self.seconds = self._ends[-1] if self._ends else 0.0
        self.peak = max(norm(s.velocity) for s in (end, *(p.start for p in self.pieces)))  # m/s, largest speed

    def at(self, t: float) -> MotionState:
        """Return the state `t` seconds after the beginning of the trajectory, t >= 0."""
        i = bisect_right(self._ends, t)
        if i == len(self.pieces):
            return MotionState(self.end.position + self.end.velocity * (t - self.seconds), self.end.velocity)
        return self.pieces[i].at(t - self._ends[i] + self.pieces[i].seconds)

    def chords(self, t: float) -> list[Point]:
        """Return places on the trajectory, from t seconds after its beginning to `end`.

        The trajectory is within BULGE of the straight lines between them."""
        found = [self.at(t).position]
        for piece, behind in zip(self.pieces, self._ends, strict=True):
            begun = behind - piece.seconds
            if behind <= t:
                continue
            v, a = piece.start.velocity, piece.acceleration
            straight = norm(Point(v.y * a.z - v.z * a.y, v.z * a.x - v.x * a.z, v.x * a.y - v.y * a.x)) < _STILL
            steps = 1 if straight else math.ceil(piece.seconds * math.sqrt(norm(a) / (8 * BULGE)))
            times = (begun + piece.seconds * i / steps for i in range(1, steps + 1))
            found += [self.at(time).position for time in times if time > t]
        return found

    def ahead(self, t: float) -> int:
        """Return the index of the next waypoint after `t` seconds. At the end, it is the number of waypoints."""
        i = bisect_right(self._ends, t)
        return self.pieces[i].ahead if i < len(self.pieces) else self._waypoints


def standing(at: Point, waypoints: int = 0) -> Trajectory:
    """Return a trajectory that stands at a place, with all waypoints passed."""
    return Trajectory((), MotionState(at), waypoints)


def plan(start: MotionState, waypoints: Sequence[Point], limits: MotionLimits, drift: Point = ZERO) -> Trajectory:
    """Return a trajectory from a state along the waypoints (at least one) to a stand at the last one.

    The velocity of `start` must be within the limits. Waypoints and start must be finite.

    `drift`: velocity of a moving waypoint (m/s, within the limits). A moving waypoint must be the only waypoint. The
    trajectory meets the waypoint and then moves with it. The trajectory is planned in the frame that moves with the
    waypoint. In that frame, the limit of acceleration is the same, and `Limits.top` gives the limits of speed."""
    ahead = [i for i, p in enumerate(waypoints) if i + 1 == len(waypoints) or distance(p, waypoints[i + 1]) > CLOSE]
    pieces = _entered(MotionState(start.position, start.velocity - drift), waypoints[ahead[0]], limits, drift, ahead[0])
    entry = pieces[-1].at(pieces[-1].seconds) if pieces else MotionState(start.position)
    if len(ahead) > 1 and norm(entry.velocity) < _STILL and distance(entry.position, waypoints[ahead[0]]) <= CLOSE:
        ahead = ahead[1:]  # the trajectory has reached the first waypoint already
    nodes = [entry.position, *(waypoints[i] for i in ahead)]
    pieces += _legs(nodes, [ahead[0], *ahead], norm(entry.velocity), limits, drift)
    goal = waypoints[-1]
    if drift == ZERO:
        return Trajectory(pieces, MotionState(goal), len(waypoints))
    moved, t = [], 0.0
    for p in pieces:
        moved.append(
            Piece(
                p.seconds, MotionState(p.start.position + drift * t, p.start.velocity + drift), p.acceleration, p.ahead
            )
        )
        t += p.seconds
    return Trajectory(moved, MotionState(goal + drift * t, drift), len(waypoints))


def _entered(start: MotionState, goal: Point, limits: MotionLimits, drift: Point, ahead: int) -> list[Piece]:
    """Return the first piece, which turns the present velocity towards the goal; [] if the vehicle stands.

    The new velocity is the fastest one from which the vehicle can stop at the goal. If no velocity towards the goal can
    be reached within the limits, the piece brakes."""
    speed = norm(start.velocity)
    if speed < _STILL:
        return []
    brake = Piece(speed / limits.acceleration, start, start.velocity * (-limits.acceleration / speed), ahead)
    best, low, high = brake, 0.0, limits.speed + norm(drift)
    for trial in range(_BISECTIONS):
        s = high if trial == 0 else (low + high) / 2
        found = _turned(start, goal, s, limits, drift, ahead)
        if found is None:
            high = s
        else:
            best, low = found, s
            if trial == 0:
                break
    return [best]


def _turned(
    start: MotionState, goal: Point, fast: float, limits: MotionLimits, drift: Point, ahead: int
) -> Piece | None:
    """Return a piece at whose end the velocity points to the goal.

    The speed at its end is `fast`, or less if the limits of speed require it.

    Return None if the distance is too short to stop at the goal, or if braking within the piece would leave the
    box of `limits`.

    Let p, v be position and velocity at the start, a the acceleration limit, s and u speed and direction at the end.
    With T = |s u - v| / a, the piece ends at p + (v + s u) T / 2. So the unit vector u must point from c = p + v T / 2
    to the goal. Fixed-point iteration solves this for u. The first u points to the goal from the place where braking
    would end.
    """
    a, v = limits.acceleration, start.velocity
    u = goal - limits.stop(start)
    far = norm(u)
    if far < CLOSE:
        return None
    # Plain numbers instead of Points, for speed: a program that commands a new target each round runs this each round.
    x, y, z = u.x / far, u.y / far, u.z / far
    vx, vy, vz, dx, dy, dz = v.x, v.y, v.z, drift.x, drift.y, drift.z
    away, room, hypot = goal - start.position, limits.speed**2 - _dot(drift, drift), math.hypot
    for _ in range(25):
        s = min(fast, limits.most(x * dx + y * dy + z * dz, z, dz, room))
        seconds = hypot(x * s - vx, y * s - vy, z * s - vz) / a
        half = seconds / 2
        to_x, to_y, to_z = away.x - vx * half, away.y - vy * half, away.z - vz * half
        far = hypot(to_x, to_y, to_z)
        if far < CLOSE:
            return None
        to_x, to_y, to_z = to_x / far, to_y / far, to_z / far
        turned = hypot(to_x - x, to_y - y, to_z - z)
        x, y, z = to_x, to_y, to_z
        if turned < 1e-11:
            break
    else:
        return None
    if far - s * seconds / 2 < s * s / (2 * a):
        return None
    u = Point(x, y, z)
    push = (u * s - v) / seconds if seconds > _STILL else ZERO
    if not all(_stays(start, push, seconds * i / 8, drift, limits) for i in range(9)):
        return None
    return Piece(seconds, start, push, ahead)


def _stays(start: MotionState, push: Point, t: float, drift: Point, limits: MotionLimits) -> bool:
    """Return whether braking from a piece's state after `t` seconds ends inside the box.

    `start` and `push` are in the frame that moves with `drift`."""
    p, v, half = start.position, start.velocity, t * t / 2
    vx, vy, vz = v.x + push.x * t + drift.x, v.y + push.y * t + drift.y, v.z + push.z * t + drift.z
    far = math.hypot(vx, vy, vz) / (2 * limits.acceleration)
    x, y, z = (
        p.x + v.x * t + push.x * half + drift.x * t + vx * far,
        p.y + v.y * t + push.y * half + drift.y * t + vy * far,
        p.z + v.z * t + push.z * half + drift.z * t + vz * far,
    )
    return inside(limits.box, Point(x, y, z))


def _legs(nodes: list[Point], ahead: list[int], entry: float, limits: MotionLimits, drift: Point) -> list[Piece]:
    """Return straight legs between the nodes, with parabolas at the inner nodes.

    The speed is `entry` at the first node, and 0 at the last one."""
    a, last = limits.acceleration, len(nodes) - 1
    lengths = [distance(nodes[i], nodes[i + 1]) for i in range(last)]
    if lengths[0] < _STILL:
        return []  # only one leg is left, and the vehicle is already at its end
    units = [(nodes[i + 1] - nodes[i]) / lengths[i] for i in range(last)]
    tops = [limits.top(u, drift) for u in units]
    bends = [0.0, *(distance(units[i], units[i + 1]) for i in range(last - 1)), 0.0]
    squares = _speeds(lengths, tops, bends, entry, a)
    pieces: list[Piece] = []
    for i, u in enumerate(units):
        cut, cut_next = (squares[k] * bends[k] / (2 * a) for k in (i, i + 1))
        pieces += _straight(
            nodes[i] + u * cut, u, max(0.0, lengths[i] - cut - cut_next), squares[i], squares[i + 1], tops[i], a,
            ahead[i + 1],
        )  # fmt: skip
        speed = math.sqrt(squares[i + 1])
        if bends[i + 1] > _STILL and speed > _STILL:
            seconds = speed * bends[i + 1] / a
            turn = (units[i + 1] - u) * (speed / seconds)
            pieces.append(Piece(seconds, MotionState(nodes[i + 1] - u * cut_next, u * speed), turn, ahead[i + 2]))
    return pieces


def _speeds(lengths: list[float], tops: list[float], bends: list[float], entry: float, a: float) -> list[float]:
    """Return the squares w of the speeds at the nodes.

    First, each corner's own limits apply. Then one pass backward and one forward reduce the speeds until each straight
    is long enough: |w' - w| <= 2 a (length - cut - cut'), where cut = w * bend / 2a."""
    last = len(lengths)
    w = [entry * entry, *(0.0 for _ in range(last))]
    for i in range(1, last):
        # `within`: limit that keeps the vehicle within CORNER of the polyline when it cuts the corner, and when it
        # brakes in the corner, which leads to the corner's outside. In a gentle bend at high speed, braking leads
        # farther outside than cutting leads inside.
        within = 8 * a * CORNER / max(bends[i] ** 2, min(1.0, 4 * bends[i]), _STILL)
        halves = a * min(lengths[i - 1], lengths[i]) / max(bends[i], _STILL)
        w[i] = min(tops[i - 1] ** 2, tops[i] ** 2, within, halves)
    for i in range(last - 1, 0, -1):
        w[i] = min(w[i], (2 * a * lengths[i] + w[i + 1] * (1 - bends[i + 1])) / (1 + bends[i]))
    if bends[1] > 1.0:  # a slower corner has a shorter parabola, which leaves more room to brake
        w[1] = min(w[1], max(0.0, (2 * a * lengths[0] - w[0]) / (bends[1] - 1)))
    for i in range(last):
        w[i + 1] = min(w[i + 1], (2 * a * lengths[i] + w[i] * (1 - bends[i])) / (1 + bends[i + 1]))
    return w


def _straight(
    start: Point, u: Point, length: float, w: float, w_end: float, top: float, a: float, ahead: int
) -> list[Piece]:
    """Return up to three pieces over a straight: accelerate, keep the speed, brake.

    The speed goes from sqrt(w) to sqrt(w_end), and is `top` at most."""
    first, final = math.sqrt(w), math.sqrt(w_end)
    peak = max(first, final, min(top, math.sqrt(max(0.0, (w + w_end) / 2 + a * length))))
    up, down = (peak**2 - w) / (2 * a), (peak**2 - w_end) / (2 * a)
    flat = max(0.0, length - up - down)
    parts = (
        ((peak - first) / a, 0.0, first, a),
        (flat / max(peak, _STILL), up, peak, 0.0),
        ((peak - final) / a, length - down, peak, -a),
    )
    return [Piece(t, MotionState(start + u * s, u * v), u * push, ahead) for t, s, v, push in parts if t > 0.0]


def norm(v: Point) -> float:
    """Return the length of a vector."""
    return math.hypot(v.x, v.y, v.z)


def _dot(p: Point, q: Point) -> float:
    return p.x * q.x + p.y * q.y + p.z * q.z
