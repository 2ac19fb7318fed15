"""Distances of points and paths: uninterpreted functions, with lemmas about robots' computations.

A path is modelled by its length, its first point and its last point.

Facts about squares of distances make an obligation nonlinear. They are added only if coordinates occur in other
arithmetic (`measured`), or on request (`exact`). All other facts are linear.

With `brief`, fewer facts are added. They suffice for most proofs. A distance that a lemma introduces then gets no
lemmas of its own, except lemmas that relate it to existing distances. No fact states that a distance is symmetric.
Instead, the two arguments are always written in one order. The order is a heuristic: two pairs that are equal in a
model may be written in different orders, if their equality was unknown when they were written.
"""

from __future__ import annotations

from koordgen.lang.ir.types import POINT, list_of
from koordgen.verify.prove.encode.context import ProofContext
from koordgen.verify.prove.encode.lists import Lists
from koordgen.verify.prove.encode.values import Collection, ConditionalCollection, EnumeratedCollection, Val, build
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import FunctionSymbol, Term

_ZERO, _ONE, _NOTHING = t.integer(0), t.integer(1), t.real(0)
DISTANCES = "distance of points: never negative; zero between equal points only; squares of coordinates where needed"
PATHS = (
    "path_distance: symmetric; never negative; the distance of the points if both paths have one point; not above the "
    "distance of an end of the path; changes by at most d if a path of one point moves by d; not above the "
    "sum of the distances to a third point"
)
Triple = tuple[Term, ...]


class Geometry:
    """Distances of points and of paths that occur in one proof context."""

    def __init__(self, context: ProofContext, lists: Lists) -> None:
        self.context, self.lists = context, lists
        self.distances: dict[tuple[Triple, Triple], Term] = {}
        # point -> other point -> the distance of both, for pairs whose distance the program computes
        self.neighbours: dict[Triple, dict[Triple, Term]] = {}
        # (path, other path) -> the distance of both, stored for both orders of the pair
        self.paths: dict[tuple[Term, Term], Term] = {}
        self.points: dict[Term, Triple] = {}  # path with exactly one point -> the point
        self.given: set[Term] = set()  # paths whose distance the program computes
        self.singles: dict[Triple, Term] = {}
        # (path, other path, number of known neighbours and single points at that time) of each pair that has lemmas
        self.done: set[tuple[Term, Term, int]] = set()
        # term of a path -> the path, for paths that may have several points
        self.others: dict[Term, Collection] = {}
        self.measured = False
        self.squared: set[Term] = set()
        self.brief = False
        self.settled = False  # True if lemmas must not introduce further distances
        self.ranks: dict[Term, int] = {}

    def distance(self, a: Val, b: Val) -> Term:
        """Return the distance of two points, in metres."""
        return self.of_points(self.lists.leaves(a), self.lists.leaves(b))

    def of_points(self, p: Triple, q: Triple) -> Term:
        for one, other in ((p, q), (q, p)):
            ways = _split(one)
            if ways is not None:
                condition, (then, orelse) = ways
                return t.ite(condition, self.of_points(then, other), self.of_points(orelse, other))
        found = self._distance(p, q)
        self.neighbours.setdefault(p, {})[q] = found
        self.neighbours.setdefault(q, {})[p] = found
        return found

    def _distance(self, p: Triple, q: Triple) -> Term:
        if p == q:
            return _NOTHING
        found = self.distances.get((p, q))
        if found is None:
            self.context.note(DISTANCES)
            name = FunctionSymbol("distance@points", (t.REAL,) * 6, t.REAL)
            one, other = self._ordered(p, q)
            found = self.distances[p, q] = self.distances[q, p] = t.apply(name, *one, *other)
            with self.context.about("distance of two points", 0):
                self.context.fact(t.at_most(_NOTHING, found))
                self.context.fact(t.equals(t.equals(found, _NOTHING), _equal(p, q)))
                if not self.brief:
                    self.context.fact(t.equals(found, t.apply(name, *q, *p)))
        return found

    def _ordered(self, p: Triple, q: Triple) -> tuple[Triple, Triple]:
        """Return two points in the order in which their distance is written.

        With `brief`, the point whose robots were registered earlier comes first. So equal pairs get equal terms more
        often. Any order is sound."""
        return (q, p) if self.brief and max(map(self._rank, q)) < max(map(self._rank, p)) else (p, q)

    def _rank(self, term: Term) -> int:
        """Return the greatest position of a term's robots in the context's list of robots.

        Returns -1 for a term without a robot."""
        if isinstance(term, t.LiteralTerm):
            return -1
        found = self.ranks.get(term)
        if found is None:
            own = list(self.context.indices).index(term) if term in self.context.indices else -1
            found = self.ranks[term] = max([own, *map(self._rank, term.args)])
        return found

    def path_distance(self, a: Collection, b: Collection) -> Term:
        """Return the distance of two paths, in metres.

        The distance from a path without points is infinite. The encoding leaves this distance an unknown number."""
        for one, other in ((a, b), (b, a)):
            if isinstance(one, ConditionalCollection):
                then, orelse = self.path_distance(one.then, other), self.path_distance(one.orelse, other)
                return t.ite(one.condition, then, orelse)
        p, q = self._point(a), self._point(b)
        for point, other in ((p, b), (q, a)):
            parts = _split(point) if point is not None else None
            if parts is not None:
                then, orelse = [self.path_distance(_single(way), other) for way in parts[1]]
                return t.ite(parts[0], then, orelse)
        if p is not None and q is not None:
            return self._distance(p, q)
        first, second = self._path(a, p), self._path(b, q)
        self.given |= {first, second}
        return self._apart(first, second)

    def _point(self, path: Collection) -> Triple | None:
        one = isinstance(path, EnumeratedCollection) and len(path.items) == 1
        return self.lists.leaves(path.items[0]) if one and isinstance(path, EnumeratedCollection) else None

    def _path(self, path: Collection, point: Triple | None) -> Term:
        found = self.lists.term(path)
        if point is not None:
            self.points[found] = point
            self.singles[point] = found
        else:
            self.others[found] = path
        return found

    def _apart(self, p: Term, q: Term) -> Term:
        found = self.paths.get((p, q))
        if found is None:
            self.context.note(PATHS)
            name = FunctionSymbol("path_distance@paths", (p.sort, q.sort), t.REAL)
            (one,), (other,) = self._ordered((p,), (q,))
            found = self.paths[p, q] = self.paths[q, p] = t.apply(name, one, other)
            with self.context.about("distance of two paths", 0):
                self.context.fact(t.at_most(_NOTHING, found))
                if not self.brief:
                    self.context.fact(t.equals(found, t.apply(name, q, p)))
        return found

    def _from_point(self, point: Triple, q: Term) -> Term | None:
        """Return the distance of a point from a path.

        Returns None if the distance does not exist yet and lemmas must not introduce further distances."""
        if q in self.points:
            met = point == self.points[q] or (point, self.points[q]) in self.distances
            return self._distance(point, self.points[q]) if met or not self.settled else None
        found = self.singles.get(point)
        if self.settled:
            return self.paths.get((found, q)) if found is not None else None
        if found is None:
            found = self._path(_single(point), point)
        return self._apart(found, q)

    # Lemmas about distances

    def lemmas(self, exact: bool) -> None:
        """Add the lemmas about the distances in the context.

        With `exact`, also add facts about the squares of these distances."""
        with self.context.about("distances of paths", 0):
            for (p, q), found in list(self.paths.items()):
                round_ = (p, q, sum(map(len, self.neighbours.values())) + len(self.points))
                if round_ in self.done:
                    continue
                self.done.add(round_)
                if p in self.others:
                    self._ends(p, q, found)
                    self._past_points(p, q, found)
                else:
                    self._near(t.TRUE, self.points[p], q, found)
            if self.measured or exact:
                self._squares()
        self.settled = self.brief

    def _ends(self, p: Term, q: Term, found: Term) -> None:
        """Bound the distance of two paths by the distances of the ends of `p` from `q`.

        A path of one point is exactly as far from `q` as its point."""
        path, fact = self.others[p], self.context.fact
        long = self.lists.length(path)
        some, one = t.less(_ZERO, long), t.equals(long, _ONE)
        first = self.lists.leaves(self.lists.element(path, _ZERO))
        last = self.lists.leaves(self.lists.element(path, t.subtract(long, _ONE)))
        if q in self.points:
            for end in (first, last):
                there = self._from_point(end, q)
                if there is not None:
                    fact(t.implies(some, t.at_most(found, there)))
            there = self._from_point(first, q)
            if there is not None:
                fact(t.implies(one, t.equals(found, there)))
        else:
            for single, point in list(self.points.items()):
                if (single, q) in self.paths and (single in self.given or point in (first, last)):
                    ends = [
                        t.all_of([t.equals(x, y) for x, y in zip(point, end, strict=True)]) for end in (first, last)
                    ]
                    fact(t.implies(t.and_(some, t.or_(*ends)), t.at_most(found, self.paths[single, q])))
        if one is not t.FALSE:
            self._near(one, first, q, found)

    def _past_points(self, p: Term, q: Term, found: Term) -> None:
        """Add the triangle inequality for two paths.

        The distance of two paths is at most the sum of their distances from a third point."""
        for single in list(self.points) if q in self.others else ():
            there, back = self.paths.get((single, p)), self.paths.get((single, q))
            if there is not None and back is not None:
                self.context.fact(t.at_most(found, t.add(there, back)))

    def _near(self, one: Term, point: Triple, q: Term, found: Term) -> None:
        """Add triangle inequalities for two points and the path `q`.

        The distances of the two points from `q` differ by at most the distance of the points. `one` is the condition
        under which `found` is the distance of `point` from `q`."""
        some = t.less(_ZERO, self.lists.length(self.others[q])) if q in self.others else t.TRUE
        for other, apart in list(self.neighbours.get(point, {}).items()):
            there = self._from_point(other, q)
            if there is not None:
                bounds = t.at_most(found, t.add(there, apart)), t.at_most(there, t.add(found, apart))
                self.context.fact(t.implies(t.and_(one, some), t.and_(*bounds)))

    def _squares(self) -> None:
        for (p, q), found in list(self.distances.items()):
            if found not in self.squared:
                self.squared.add(found)
                gaps = [t.subtract(x, y) for x, y in zip(p, q, strict=True)]
                squares = [t.multiply(gap, gap) for gap in gaps]
                whole = t.add(t.add(squares[0], squares[1]), squares[2])
                self.context.fact(t.equals(t.multiply(found, found), whole), "distance of two points", 0)


def _equal(p: Triple, q: Triple) -> Term:
    return t.all_of([t.equals(x, y) for x, y in zip(p, q, strict=True)])


def _single(point: Triple) -> EnumeratedCollection:
    return EnumeratedCollection((build(POINT, iter(point)),), list_of(POINT))


def _split(point: Triple) -> tuple[Term, tuple[Triple, Triple]] | None:
    """Return the condition and both alternatives of a conditional point; None for any other point."""
    if not all(isinstance(x, t.Op) and x.name == "ite" for x in point):
        return None
    ways = [x.args for x in point if isinstance(x, t.Op)]
    if any(way[0] is not ways[0][0] for way in ways):
        return None
    return ways[0][0], (tuple([way[1] for way in ways]), tuple([way[2] for way in ways]))


def path_of(value: Val) -> Collection:
    assert not isinstance(value, (tuple, t.LiteralTerm, t.Apply, t.Op))
    return value
