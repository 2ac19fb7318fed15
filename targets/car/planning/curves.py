"""Shortest curves of a car between two poses: Reeds-Shepp curves use both gears, Dubins curves only go forwards.

Formulas: J. A. Reeds and L. A. Shepp, Optimal paths for a car that goes both forwards and backwards, Pacific Journal of
Mathematics 145 (1990), (8.1) to (8.11), whose misprints are corrected as in OMPL's ReedsSheppStateSpace; A. M. Shkel
and V. Lumelsky, Classification of the Dubins set (2001). This module computes the curves itself, because OMPL's Python
binding returns the length of a curve but not its pieces. Metres, radians, local ENU.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator

from targets.car.base.bicycle import wrap

Triple = tuple[float, float, float]  # x, y (metres), yaw (radians)
Piece = tuple[float, float]  # curvature (1/m, positive to the left) and length (m, negative in reverse)
Word = tuple[str, tuple[float, ...]]  # turns (L, S, R) and their lengths, for a radius of 1

HALF = math.pi / 2
SAME = 1e-7  # metres: tolerance between a curve's computed length and the length that a caller passes
NOTHING = 1e-9  # metres; shorter pieces are left out of a curve
_SWAP = str.maketrans("LR", "RL")


class Curve:
    """Curve from the pose `start` along pieces of constant curvature. `length` (m) counts both gears as positive."""

    __slots__ = ("_places", "_stations", "length", "pieces", "start")

    def __init__(self, start: Triple, pieces: tuple[Piece, ...]) -> None:
        self.start, self.pieces = start, pieces
        self._places, self._stations = [start], [0.0]
        for curvature, way in pieces:
            self._places.append(along(self._places[-1], curvature, way))
            self._stations.append(self._stations[-1] + abs(way))
        self.length = self._stations[-1]

    @property
    def end(self) -> Triple:
        return self._places[-1]

    @property
    def ends(self) -> list[Triple]:
        """Poses at which the pieces end."""
        return self._places[1:]

    def at(self, station: float) -> Triple:
        """Return the pose at this arc length (metres); yaw is continuous."""
        i = min(max(bisect_right(self._stations, station) - 1, 0), len(self.pieces) - 1)
        if i < 0:
            return self.start
        curvature, way = self.pieces[i]
        return along(self._places[i], curvature, math.copysign(station - self._stations[i], way))

    def between(self, begin: float, end: float) -> tuple[Piece, ...]:
        """Return the pieces of the stretch between two stations (arc lengths from the start, m)."""
        found = []
        for (curvature, way), at in zip(self.pieces, self._stations, strict=False):
            share = min(end, at + abs(way)) - max(begin, at)
            if share > NOTHING:
                found.append((curvature, math.copysign(share, way)))
        return tuple(found)


def along(start: Triple, curvature: float, way: float) -> Triple:
    """Return the exact pose after driving `way` metres (negative: in reverse) at a constant curvature (1/m)."""
    x, y, yaw = start
    half = curvature * way / 2
    chord = way * math.sin(half) / half if half else way
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + 2 * half


def reeds_shepp(start: Triple, goal: Triple, radius: float, length: float | None = None) -> Curve:
    """Return the shortest curve between two poses that may use both gears.

    `length`: length of this curve (m), if it is known; the search then ends at the first curve of this length."""
    x, y, phi = seen_from(start, goal, radius)
    wanted = -math.inf if length is None else (length + SAME) / radius
    best, turns = math.inf, ("", ())  # type: tuple[float, Word]
    for word in _words(x, y, phi):
        total = sum(map(abs, word[1]))
        if total < best:
            best, turns = total, word
            if total <= wanted:
                break
    return Curve(start, _pieces(turns, radius))


def dubins(start: Triple, goal: Triple, radius: float, length: float | None = None) -> Curve:
    """Return the shortest curve between two poses that only goes forwards. `length` is not used."""
    x, y, phi = seen_from(start, goal, radius)
    d, theta = math.hypot(x, y), math.atan2(y, x)
    words = _forward_words(d, -theta, phi - theta)
    return Curve(start, _pieces(min(words, key=lambda word: sum(word[1])), radius))


def seen_from(start: Triple, goal: Triple, unit: float = 1.0) -> Triple:
    """Return the pose `goal` in the frame of `start`: ahead and to the left in multiples of `unit`, yaw in radians."""
    x, y = (goal[0] - start[0]) / unit, (goal[1] - start[1]) / unit
    c, s = math.cos(start[2]), math.sin(start[2])
    return c * x + s * y, c * y - s * x, wrap(goal[2] - start[2])


def _pieces(word: Word, radius: float) -> tuple[Piece, ...]:
    bend = {"L": 1 / radius, "S": 0.0, "R": -1 / radius}
    found = ((bend[turn], way * radius) for turn, way in zip(*word, strict=True))
    return tuple(piece for piece in found if abs(piece[1]) > NOTHING)


def _words(x: float, y: float, phi: float) -> Iterator[Word]:
    """Yield all candidate words: those of each formula unchanged, time-reversed, mirrored, and both."""
    c, s = math.cos(phi), math.sin(phi)
    backx, backy = x * c + y * s, x * s - y * c
    for family, px, py, backwards in ((_FORWARD, x, y, False), (_BACKWARD, backx, backy, True)):
        for formula, turns in family:
            for sign in (1.0, -1.0):
                for mirror in (1.0, -1.0):
                    ways = formula(sign * px, mirror * py, sign * mirror * phi)
                    if ways is None:
                        continue
                    order = ways[::-1] if backwards else ways
                    yield (
                        turns if mirror > 0 else turns.translate(_SWAP),
                        order if sign > 0 else tuple(-way for way in order),
                    )


Ways = tuple[float, ...] | None


def _lsl(x: float, y: float, phi: float) -> Ways:
    east, north = x - math.sin(phi), y - 1 + math.cos(phi)
    t = math.atan2(north, east)
    v = wrap(phi - t)
    return (t, math.hypot(east, north), v) if t >= 0 and v >= 0 else None


def _lsr(x: float, y: float, phi: float) -> Ways:
    east, north = x + math.sin(phi), y - 1 - math.cos(phi)
    square = east * east + north * north
    if square < 4:
        return None
    u = math.sqrt(square - 4)
    t = wrap(math.atan2(north, east) + math.atan2(2, u))
    v = wrap(t - phi)
    return (t, u, v) if t >= 0 and v >= 0 else None


def _lrl(x: float, y: float, phi: float) -> Ways:
    xi, eta = x - math.sin(phi), y - 1 + math.cos(phi)
    away = math.hypot(xi, eta)
    if away > 4:
        return None
    u = -2 * math.asin(away / 4)
    t = wrap(math.atan2(eta, xi) + u / 2 + math.pi)
    return (t, u, wrap(phi - t + u)) if t >= 0 else None


def _tau_omega(u: float, v: float, xi: float, eta: float, phi: float) -> tuple[float, float]:
    delta = wrap(u - v)
    a, b = math.sin(u) - math.sin(delta), math.cos(u) - math.cos(delta) - 1
    t = math.atan2(eta * a - xi * b, xi * a + eta * b)
    if 2 * (math.cos(delta) - math.cos(v) - math.cos(u)) + 3 < 0:
        t += math.pi
    tau = wrap(t)
    return tau, wrap(tau - u + v - phi)


def _lrlr(x: float, y: float, phi: float) -> Ways:
    xi, eta = x + math.sin(phi), y - 1 - math.cos(phi)
    rho = (2 + math.hypot(xi, eta)) / 4
    if rho > 1:
        return None
    u = math.acos(rho)
    t, v = _tau_omega(u, -u, xi, eta, phi)
    return (t, u, -u, v) if t >= 0 and v <= 0 else None


def _lrlr_equal(x: float, y: float, phi: float) -> Ways:
    xi, eta = x + math.sin(phi), y - 1 - math.cos(phi)
    rho = (20 - xi * xi - eta * eta) / 16
    if not 0 <= rho <= 1:
        return None
    u = -math.acos(rho)
    t, v = _tau_omega(u, u, xi, eta, phi)
    return (t, u, u, v) if t >= 0 and v >= 0 else None


def _lrsl(x: float, y: float, phi: float) -> Ways:
    xi, eta = x - math.sin(phi), y - 1 + math.cos(phi)
    rho = math.hypot(xi, eta)
    if rho < 2:
        return None
    r = math.sqrt(rho * rho - 4)
    t = wrap(math.atan2(eta, xi) + math.atan2(r, -2))
    v = wrap(phi - HALF - t)
    return (t, -HALF, 2 - r, v) if t >= 0 and r >= 2 and v <= 0 else None


def _lrsr(x: float, y: float, phi: float) -> Ways:
    xi, eta = x + math.sin(phi), y - 1 - math.cos(phi)
    rho, t = math.hypot(xi, eta), math.atan2(xi, -eta)
    v = wrap(t + HALF - phi)
    return (t, -HALF, 2 - rho, v) if rho >= 2 and t >= 0 and v <= 0 else None


def _lrslr(x: float, y: float, phi: float) -> Ways:
    xi, eta = x + math.sin(phi), y - 1 - math.cos(phi)
    square = xi * xi + eta * eta
    if square < 4:
        return None
    u = 4 - math.sqrt(square - 4)
    if u > 0:
        return None
    t = wrap(math.atan2((4 - u) * xi - 2 * eta, -2 * xi + (u - 4) * eta))
    v = wrap(t - phi)
    return (t, -HALF, u, -HALF, v) if t >= 0 and v >= 0 else None


_Formula = Callable[[float, float, float], Ways]
_FORWARD: tuple[tuple[_Formula, str], ...] = (
    (_lsl, "LSL"), (_lsr, "LSR"), (_lrl, "LRL"), (_lrsl, "LRSL"), (_lrsr, "LRSR"), (_lrslr, "LRSLR"),
    (_lrlr, "LRLR"), (_lrlr_equal, "LRLR"),
)  # fmt: skip
_BACKWARD: tuple[tuple[_Formula, str], ...] = ((_lrl, "LRL"), (_lrsl, "LSRL"), (_lrsr, "RSRL"))


def _forward_words(d: float, alpha: float, beta: float) -> Iterator[Word]:
    sa, ca, sb, cb = math.sin(alpha), math.cos(alpha), math.sin(beta), math.cos(beta)
    both = ca * cb + sa * sb
    square = 2 + d * d - 2 * (both - d * (sa - sb))
    theta = math.atan2(cb - ca, d + sa - sb)
    yield "LSL", (_turn(theta - alpha), math.sqrt(max(0.0, square)), _turn(beta - theta))
    square = 2 + d * d - 2 * (both - d * (sb - sa))
    theta = math.atan2(ca - cb, d - sa + sb)
    yield "RSR", (_turn(alpha - theta), math.sqrt(max(0.0, square)), _turn(theta - beta))
    square = d * d - 2 + 2 * (both - d * (sa + sb))
    if square >= 0:
        p = math.sqrt(square)
        theta = math.atan2(ca + cb, d - sa - sb) - math.atan2(2, p)
        yield "RSL", (_turn(alpha - theta), p, _turn(beta - theta))
    square = d * d - 2 + 2 * (both + d * (sa + sb))
    if square >= 0:
        p = math.sqrt(square)
        theta = math.atan2(-ca - cb, d + sa + sb) - math.atan2(-2, p)
        yield "LSR", (_turn(theta - alpha), p, _turn(theta - beta))
    cosine = (6 - d * d + 2 * (both + d * (sa - sb))) / 8
    if abs(cosine) < 1:
        p = 2 * math.pi - math.acos(cosine)
        t = _turn(alpha - math.atan2(ca - cb, d - sa + sb) + p / 2)
        yield "RLR", (t, p, _turn(alpha - beta - t + p))
    cosine = (6 - d * d + 2 * (both - d * (sa - sb))) / 8
    if abs(cosine) < 1:
        p = 2 * math.pi - math.acos(cosine)
        t = _turn(math.atan2(cb - ca, d + sa - sb) - alpha + p / 2)
        yield "LRL", (t, p, _turn(beta - alpha - t + p))


def _turn(angle: float) -> float:
    """Return the angle within 0 to 2 pi. An angle that rounding made slightly negative becomes 0, not a full circle."""
    found = angle % (2 * math.pi)
    return 0.0 if 2 * math.pi - found < 1e-9 else found
