"""Lengths, elements and equality of collections, derived from how each collection was built.

A length or an element that cannot be derived becomes a function of the collection's term, such as `List<Task>.len` and
`List<Task>.at.id`. `Lists.term` returns the term of a collection that is an argument of a function.
"""

from __future__ import annotations

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir.types import BOOL, INT, MapOf, PerRobot, Sequence, TupleOf, Type
from koordgen.verify.prove.encode.context import ProofContext
from koordgen.verify.prove.encode.values import (
    Collection,
    ConditionalCollection,
    EnumeratedCollection,
    FleetValue,
    OpaqueCollection,
    UpdatedCollection,
    Val,
    as_term,
    is_collection,
    parts_of,
    pick,
    sort_of,
)
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Sort, Term

_ZERO, _ONE = t.integer(0), t.integer(1)
_STEPS = {"appended": 1, "inserted": 1, "removed": -1, "without": -1, "popped": -1, "updated": 0, "sorted": 0,
          "reversed": 0, "set_without": -1, "map_without": -1, "keys": 0, "values": 0, "items": 0}  # fmt: skip
_COLLECTIONS = (OpaqueCollection, EnumeratedCollection, ConditionalCollection, UpdatedCollection, FleetValue)


def element_type(type_: Type) -> Type:
    match type_:
        case Sequence(_, element) | PerRobot(element):
            return element
        case MapOf(key, value):
            return TupleOf((key, value))
        case _:
            raise InternalError(f"a {type_} has no elements")


class Lists:
    def __init__(self, context: ProofContext) -> None:
        self.context = context
        self.terms: dict[Collection, Term] = {}
        self.fleets: dict[Term, FleetValue] = {}
        self.lengths: dict[Collection, Term] = {}
        self.reads: dict[Term, list[tuple[Term, Val]]] = {}  # collection -> index and element of each read.
        # Collection -> item and result of each test whether the collection contains the item.
        self.asked: dict[Term, list[tuple[Val, Term]]] = {}
        self.elements: dict[tuple[Collection, Term], Val] = {}

    def length(self, xs: Collection) -> Term:
        found = self.lengths.get(xs)
        if found is None:
            found = self.lengths[xs] = self._long(xs) if type(xs) is OpaqueCollection else self._length(xs)
        return found

    def _length(self, xs: Collection) -> Term:
        match xs:
            case FleetValue():
                return self.context.size
            case EnumeratedCollection(items, type_) if not _unordered(type_) or len(items) < 2:
                return t.integer(len(items))
            case ConditionalCollection(condition, then, orelse):
                return t.ite(condition, self.length(then), self.length(orelse))
            case UpdatedCollection("cleared"):
                return _ZERO
            case UpdatedCollection("extended", base, (other,)):
                return t.add(self.length(base), self.length(_collection(other)))
            case UpdatedCollection(update, base) if update in _STEPS:
                return t.add(self.length(base), t.integer(_STEPS[update]))
            case _:
                return self._long(xs)

    def _long(self, xs: Collection) -> Term:
        found = as_term(self.context.function(f"{xs.type}.len", (self.term(xs),), INT))
        self.context.fact(t.at_most(_ZERO, found), "a list's length is not negative")
        return found

    def element(self, xs: Collection, index: Term) -> Val:
        """Return the term `xs[index]`. If the index is out of range, the term is an arbitrary value.

        The elements of a set or a map have an arbitrary but fixed order."""
        found = self.elements.get((xs, index))
        if found is None:
            plain = type(xs) is OpaqueCollection
            found = self._read(self.term(xs), xs.type, index) if plain else self._element(xs, index)
            self.elements[xs, index] = found
        return found

    def _element(self, xs: Collection, index: Term) -> Val:
        match xs:
            case FleetValue(slot=slot):
                self.context.robot(index)
                return slot(index)
            case EnumeratedCollection(items, type_) if items and (not _unordered(type_) or len(items) < 2):
                return self._one_of(items, index)
            case ConditionalCollection(condition, then, orelse):
                return pick(condition, self.element(then, index), self.element(orelse, index))
            case UpdatedCollection("updated", base, (place, value)):
                return pick(t.equals(index, as_term(place)), value, self.element(base, index))
            case UpdatedCollection("appended", base, (value,)):
                return pick(t.equals(index, self.length(base)), value, self.element(base, index))
            case UpdatedCollection("popped", base):
                return self.element(base, index)
            case UpdatedCollection("without" | "removed" as update, base, (what,)):
                place = as_term(what) if update == "without" else self.place(base, what)
                later = t.add(index, _ONE)
                return pick(t.less(index, place), self.element(base, index), self.element(base, later))
            case UpdatedCollection("extended", base, (other,)):
                many = self.length(base)
                rest = self.element(_collection(other), t.subtract(index, many))
                return pick(t.less(index, many), self.element(base, index), rest)
            case UpdatedCollection("inserted", base, (place, value)):
                at = as_term(place)
                behind = pick(t.equals(index, at), value, self.element(base, t.subtract(index, _ONE)))
                return pick(t.less(index, at), self.element(base, index), behind)
            case UpdatedCollection("reversed", base):
                return self.element(base, t.subtract(t.subtract(self.length(base), _ONE), index))
            case _:
                return self._read(self.term(xs), xs.type, index)

    def _read(self, xs: Term, type_: Type, index: Term) -> Val:
        """Return an element of an opaque collection. A fact states that the collection contains the element."""
        found = self.context.function(f"{type_}.at", (xs, index), element_type(type_))
        if not isinstance(type_, PerRobot):
            self.context.element(index, robots=False, places=not _end(index))
            self.reads.setdefault(xs, []).append((index, found))
            for item, held in self.asked.get(xs, ()):
                self._member(xs, type_, index, found, item, held)
        return found

    def _asked(self, xs: Term, type_: Type, item: Val) -> Term:
        found = as_term(self.context.function(f"{type_}.has", (xs, *self.leaves(item)), BOOL))
        if isinstance(type_, Sequence) and (item, found) not in self.asked.get(xs, ()):
            self.asked.setdefault(xs, []).append((item, found))
            for index, element in self.reads.get(xs, ()):
                self._member(xs, type_, index, element, item, found)
        return found

    def _member(self, xs: Term, type_: Type, index: Term, element: Val, item: Val, held: Term) -> None:
        inside = t.and_(t.at_most(_ZERO, index), t.less(index, self.length(OpaqueCollection(xs, type_))))
        self.context.fact(t.implies(t.and_(inside, self.same(element, item)), held), "an element is in its list", 0)

    def _one_of(self, items: tuple[Val, ...], index: Term) -> Val:
        at = t.number(index)
        if at is not None:
            return items[min(max(int(at), 0), len(items) - 1)]
        found = items[-1]
        for place in range(len(items) - 2, -1, -1):
            found = pick(t.equals(index, t.integer(place)), items[place], found)
        return found

    def place(self, xs: Collection, item: Val) -> Term:
        """Return the position of an item's first occurrence; an arbitrary int if the list lacks the item."""
        found = as_term(self.context.function(f"{xs.type}.index", (self.term(xs), *self.leaves(item)), INT))
        here = t.and_(t.at_most(_ZERO, found), t.less(found, self.length(xs)))
        self.context.fact(
            t.implies(self.has(xs, item), t.and_(here, self.same(self.element(xs, found), item))), "index"
        )
        return found

    def has(self, xs: Collection, item: Val) -> Term:
        """Return the term "the collection contains the item"; for a map, "the item is a key of the map"."""
        match xs:
            case EnumeratedCollection(items, type_):
                keys = [pair[0] if isinstance(type_, MapOf) else pair for pair in items]  # type: ignore[index]
                return t.any_of([self.same(key, item) for key in keys])
            case ConditionalCollection(condition, then, orelse):
                return t.ite(condition, self.has(then, item), self.has(orelse, item))
            case UpdatedCollection("cleared"):
                return t.FALSE
            case UpdatedCollection("appended" | "set_with" | "map_with", base, (value, *_)):
                return t.or_(self.same(value, item), self.has(base, item))
            case UpdatedCollection("set_without" | "map_without", base, (value,)):
                return t.and_(t.not_(self.same(value, item)), self.has(base, item))
            case UpdatedCollection("sorted" | "reversed" | "keys", base):
                return self.has(base, item)
            case UpdatedCollection("extended" | "union", base, (other,)):
                return t.or_(self.has(base, item), self.has(_collection(other), item))
            case UpdatedCollection("intersection", base, (other,)):
                return t.and_(self.has(base, item), self.has(_collection(other), item))
            case UpdatedCollection("difference", base, (other,)):
                return t.and_(self.has(base, item), t.not_(self.has(_collection(other), item)))
            case _:
                return self._asked(self.term(xs), xs.type, item)

    def value(self, xs: Collection, key: Val) -> Val:
        """Return the value that a map holds for a key. The caller ensures that the map has the key."""
        match xs:
            case ConditionalCollection(condition, then, orelse):
                return pick(condition, self.value(then, key), self.value(orelse, key))
            case UpdatedCollection("map_with", base, (own, held)):
                return pick(self.same(own, key), held, self.value(base, key))
            case UpdatedCollection("map_without", base):
                return self.value(base, key)
            case EnumeratedCollection(items, MapOf()) if items:
                pairs = [pair for pair in items if isinstance(pair, tuple)]
                found = pairs[0][1]
                for own, held in pairs[1:]:
                    found = pick(self.same(own, key), held, found)
                return found
            case _:
                assert isinstance(xs.type, MapOf)
                return self.context.function(f"{xs.type}.value", (self.term(xs), *self.leaves(key)), xs.type.value)

    # Equality of values

    def same(self, a: Val, b: Val) -> Term:
        """Return the term `a == b` for two values of the same type."""
        if a is b:
            return t.TRUE
        if isinstance(a, tuple) and isinstance(b, tuple):
            return t.all_of([self.same(x, y) for x, y in zip(a, b, strict=True)])
        if isinstance(a, _COLLECTIONS) and isinstance(b, _COLLECTIONS):
            return self._equal(a, b)
        one, other = as_term(a), as_term(b)
        if one.sort is t.INT and self.context.own in (one, other):
            return self.context.same(
                other if one is self.context.own else one, one if one is self.context.own else other
            )
        return t.equals(one, other)

    def _equal(self, a: Collection, b: Collection) -> Term:
        for one, other in ((a, b), (b, a)):
            if isinstance(one, ConditionalCollection):
                return t.ite(one.condition, self.same(one.then, other), self.same(one.orelse, other))
        for one, other in ((a, b), (b, a)):
            if isinstance(one, EnumeratedCollection) and (not one.items or not _unordered(one.type)):
                long = t.equals(self.length(other), t.integer(len(one.items)))
                elements = [self.same(item, self.element(other, t.integer(i))) for i, item in enumerate(one.items)]
                return t.and_(long, *elements)
        return t.equals(self.term(a), self.term(b))

    # Terms of collections

    def leaves(self, value: Val) -> tuple[Term, ...]:
        """Return the terms of a value's parts. Each collection in the value is one term."""
        if isinstance(value, tuple):
            flat: list[Term] = []
            for part in value:
                if isinstance(part, (t.Apply, t.Op, t.LiteralTerm)):
                    flat.append(part)
                else:
                    flat += self.leaves(part)
            return tuple(flat)
        return (self.term(value) if isinstance(value, _COLLECTIONS) else as_term(value),)

    def term(self, xs: Collection) -> Term:
        """Return the term that represents a collection as an argument of a function."""
        if isinstance(xs, OpaqueCollection):
            return xs.term
        found = self.terms.get(xs)
        if found is None:
            found = self.terms[xs] = self._term(xs)
        return found

    def _term(self, xs: Collection) -> Term:
        sort = sort_of(xs.type)
        match xs:
            case ConditionalCollection(condition, then, orelse):
                return t.ite(condition, self.term(then), self.term(orelse))
            case EnumeratedCollection(items, type_):
                found = self._made(f"{type_}.of{len(items)}", self.leaves(items), sort)
                if not _unordered(type_):
                    self._add_facts(found, xs, [t.integer(i) for i in range(len(items))])
                return found
            case UpdatedCollection(update, base, args):
                found = self._made(f"{xs.type}.{update}", (self.term(base), *self.leaves(args)), sort)
                places = (
                    [as_term(args[0])] if update == "updated" else [self.length(base)] if update == "appended" else []
                )
                self._add_facts(found, xs, places)
                return found
            case FleetValue(name):
                return self._fleet(name, xs, sort)
            case _:
                raise InternalError("an opaque collection already has a term")

    def _made(self, name: str, args: tuple[Term, ...], sort: Sort) -> Term:
        return t.apply(t.FunctionSymbol(name, tuple([a.sort for a in args]), sort), *args)

    def _add_facts(self, made: Term, xs: EnumeratedCollection | UpdatedCollection, places: list[Term]) -> None:
        """Add facts about the length and some elements of a collection for which a new term was made.

        SOUND: no fact is added if the update that made the collection is undefined. An example is the removal of an
        element from an empty list."""
        named = OpaqueCollection(made, xs.type)
        possible: Term = t.TRUE
        if isinstance(xs, UpdatedCollection):
            if xs.update not in _STEPS and xs.update not in ("cleared", "extended"):
                return
            least = 1 if xs.update == "updated" else -_STEPS.get(xs.update, 0)
            possible = t.at_most(t.integer(least), self.length(xs.base)) if least > 0 else t.TRUE
        with self.context.about("definition of a list", 0):
            self.context.fact(t.implies(possible, t.equals(self.length(named), self.length(xs))))
            for place in places:
                there = t.and_(t.at_most(_ZERO, place), t.less(place, self.length(named)))
                same = self.same(self.element(named, place), self.element(xs, place))
                self.context.fact(t.implies(t.and_(possible, there), same))

    def _fleet(self, name: str, xs: FleetValue, sort: Sort) -> Term:
        """Return one term for all robots' slots of an allread variable, in one state.

        Two such terms are equal, or some robot has different slots in both states."""
        found: Term = t.constant(f"{name}@all", sort)
        for other, fleet in self.fleets.items():
            if other is found:
                return found
            if other.sort is sort or other.sort == sort:
                apart = t.constant(f"{fleet.name}@apart@{name}", t.INT)
                self.context.robot(apart)
                differ = t.and_(self.context.within(apart), t.not_(self.same(fleet.slot(apart), xs.slot(apart))))
                self.context.fact(t.or_(t.equals(other, found), differ), "variables that differ do so in some robot")
        self.fleets[found] = xs
        return found


def _end(index: Term) -> bool:
    """Return whether an index has a constant distance from the beginning or the end of its list."""
    while isinstance(index, t.Op) and index.name == "+" and t.number(index.args[1]) is not None:
        index = index.args[0]
    return isinstance(index, t.LiteralTerm) or (isinstance(index, t.Apply) and index.function.name.endswith(".len"))


def default(type_: Type, records: dict[str, Val]) -> Val | None:
    """Return the default value of a type; None if the default is not known."""
    if is_collection(type_):
        return EnumeratedCollection((), type_)
    name = str(type_)
    if name in records:
        return records[name]
    if name == "Grid":
        return (_ZERO, _ZERO, t.real(1))
    parts = parts_of(type_)
    if parts is None:
        return {t.INT: _ZERO, t.REAL: t.real(0), t.BOOL: t.FALSE}.get(sort_of(type_))
    found = [default(part, records) for _, part in parts]
    return None if None in found else tuple(found)  # type: ignore[arg-type]


def _unordered(type_: Type) -> bool:
    return isinstance(type_, MapOf) or (isinstance(type_, Sequence) and type_.name == "Set")


def _collection(value: Val) -> Collection:
    assert isinstance(value, _COLLECTIONS)
    return value
