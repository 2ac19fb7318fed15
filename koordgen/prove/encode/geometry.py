"""Distances of points and of paths: functions of which some lemmas are told, each true of koordgen/runtime/geometry.py.

A distance d of two points has d >= 0 and, where products are wanted at all, d * d = the sum of the squares. A path is
not looked into: only its first and last points are, and paths of one point.
"""

from __future__ import annotations

from koordgen.ir.types import POINT, list_of
from koordgen.prove import term as t
from koordgen.prove.encode.lists import Lists
from koordgen.prove.encode.room import Room
from koordgen.prove.encode.values import Choice, Collection, Known, Val
from koordgen.prove.term import Function, Term

_ZERO, _NOTHING = t.integer(0), t.real(0)
_PATH = list_of(POINT)
LEMMAS = (
    "path_distance: symmetric; never negative; of two points their distance; not above the distance of an end; "
    "1-Lipschitz in a point"
)
Triple = tuple[Term, ...]


class Geometry:
    def __init__(self, room: Room, lists: Lists) -> None:
        self.room, self.lists = room, lists
        self.distances: dict[tuple[Triple, Triple], Term] = {}
        self.paths: dict[tuple[Term, Term], Term] = {}  # pairs of paths -> their distance
        self.points: dict[Term, Triple] = {}  # paths of one point
        self.others: dict[Term, Collection] = {}  # paths that are but terms

    def distance(self, a: Val, b: Val) -> Term:
        """Of two points, in metres."""
        p, q = self.lists.leaves(a), self.lists.leaves(b)
        if p == q:
            return _NOTHING
        found = self.distances.get((p, q))
        if found is None:
            name = Function("distance@points", (t.REAL,) * 6, t.REAL)
            found = self.distances[p, q] = self.distances[q, p] = t.apply(name, *p, *q)
            with self.room.about("distance of two points", 0):
                self.room.fact(t.at_most(_NOTHING, found))
                gaps = [t.subtract(x, y) for x, y in zip(p, q, strict=True)]
                squares = [t.multiply(gap, gap) for gap in gaps]
                whole = t.add(t.add(squares[0], squares[1]), squares[2])
                self.room.fact(t.equals(t.multiply(found, found), whole))
        return found

    def path_distance(self, a: Collection, b: Collection) -> Term:
        """Of two paths, in metres. Of a path without points it is infinite: a number of which nothing is told."""
        for one, other in ((a, b), (b, a)):
            if isinstance(one, Choice):
                then, orelse = self.path_distance(one.then, other), self.path_distance(one.orelse, other)
                return t.ite(one.condition, then, orelse)
        points = [self._point(path) for path in (a, b)]
        if points[0] is not None and points[1] is not None:
            return self.distance(points[0], points[1])
        p, q = self.lists.term(a), self.lists.term(b)
        for path, point, term in zip((a, b), points, (p, q), strict=True):
            if point is not None:
                self.points[term] = self.lists.leaves(point)
            else:
                self.others[term] = path
        found = self.paths.get((p, q))
        if found is None:
            self.room.note(LEMMAS)
            found = t.apply(Function("path_distance@paths", (p.sort, q.sort), t.REAL), p, q)
            self.paths[p, q] = self.paths[q, p] = found
            self.room.fact(t.at_most(_NOTHING, found), "no distance is negative", 0)
        return found

    def _point(self, path: Collection) -> Val | None:
        return path.items[0] if isinstance(path, Known) and len(path.items) == 1 else None

    def lemmas(self) -> None:
        """What is true of the distances of paths that were met."""
        with self.room.about("distances of paths", 0):
            for (p, q), found in list(self.paths.items()):
                if p in self.others:
                    self._ends(p, q, found)
                if p in self.points:
                    self._near(p, q, found)

    def _ends(self, p: Term, q: Term, found: Term) -> None:
        """A path is not farther away than its first and its last point are."""
        path = self.others[p]
        long = self.lists.length(path)
        some = t.less(_ZERO, long)
        ends = (self.lists.element(path, _ZERO), self.lists.element(path, t.subtract(long, t.integer(1))))
        for end in ends:
            point = self.lists.leaves(end)
            if q in self.points:
                there = self._distance(point, self.points[q])
                self.room.fact(t.implies(some, t.at_most(found, there)))
            for single, place in self.points.items():
                apart = self.paths.get((single, q))
                if apart is not None:
                    same = [t.equals(x, y) for x, y in zip(place, point, strict=True)]
                    self.room.fact(t.implies(t.and_(some, *same), t.at_most(found, apart)))

    def _near(self, p: Term, q: Term, found: Term) -> None:
        """A point that moves by d comes nearer to a path by d at most."""
        for other, place in list(self.points.items()):
            apart = self.paths.get((other, q))
            if other is not p and apart is not None:
                moved = self._distance(place, self.points[p])
                some = t.less(_ZERO, self.lists.length(self.others[q])) if q in self.others else t.TRUE
                self.room.fact(t.implies(some, t.at_most(found, t.add(apart, moved))))

    def _distance(self, p: Triple, q: Triple) -> Term:
        return self.distance(p, q)


def path_of(value: Val) -> Collection:
    assert not isinstance(value, (tuple, t.Value, t.Apply, t.Op))
    return value
